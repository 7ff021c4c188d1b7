//! The models of a file that `guide diagnose` wrote: the final one, and others that explain the same runs.

use formats::model_file::ModelFile;
use mechanics::effects::Effect;

/// Effects with the values of their parameters.
pub type Effects = Vec<(&'static dyn Effect, Vec<f64>)>;

/// Another model that explains the same runs.
#[derive(Debug, Clone)]
pub struct OtherModel {
    /// Its probability. The model itself has the remainder to 1.
    pub probability: f64,
    /// Its effects with the values of their parameters.
    pub effects: Effects,
    /// Its modulus and the standard deviation, Pa.
    pub modulus_pa: Option<[f64; 2]>,
}

/// The effects of a model and of its alternatives. Effects that were stated before are kept, in all models.
pub fn of_file(stated: &Effects, model: &ModelFile) -> (Effects, Vec<OtherModel>) {
    let other_models = model.alternatives.iter().map(|other| OtherModel {
        probability: other.probability,
        effects: with_stated(stated, &other.model),
        modulus_pa: other.model.modulus_and_sd_pa(),
    });
    (with_stated(stated, model), other_models.collect())
}

/// Stated effects, and those of a model that are not stated.
fn with_stated(stated: &Effects, model: &ModelFile) -> Effects {
    let mut effects = stated.clone();
    let learned = model.effects().into_iter();
    effects.extend(learned.filter(|(effect, _)| stated.iter().all(|(own, _)| own.id() != effect.id())));
    effects
}
