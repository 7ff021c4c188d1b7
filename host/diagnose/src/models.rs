//! The models of a file that `guide diagnose` wrote: the one that was found, and others that explain the same runs.

use formats::model_file::ModelFile;
use mechanics::effects::Effect;

/// Effects with the values of their parameters.
pub type Effects = Vec<(&'static dyn Effect, Vec<f64>)>;

/// Another model that explains what a model was learned from.
#[derive(Debug, Clone)]
pub struct OtherModel {
    /// Its probability; what those of all others leave is that of the model itself.
    pub probability: f64,
    /// Its effects with the values of their parameters.
    pub effects: Effects,
    /// Its modulus and the standard deviation, Pa.
    pub modulus_pa: Option<[f64; 2]>,
}

/// The effects of a model, and its alternatives; effects that are there already stay, in all of them.
pub fn of_file(stated: &Effects, model: &ModelFile) -> (Effects, Vec<OtherModel>) {
    let model_with = |of: &ModelFile| {
        let is_new = |id: &str| stated.iter().all(|(own, _)| own.id() != id);
        let new = of.effects().into_iter().filter(|(effect, _)| is_new(effect.id()));
        stated.iter().cloned().chain(new).collect::<Effects>()
    };
    let other_models = model.alternatives.iter().map(|other| OtherModel {
        probability: other.probability,
        effects: model_with(&other.model),
        modulus_pa: other.model.modulus_and_sd_pa(),
    });
    (model_with(model), other_models.collect())
}
