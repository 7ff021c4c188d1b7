//! K and E by the other models of a model file: a class of effects that explain the runs alike need not agree on them.

use super::{Identification, IdentifyError, Options, OtherResult, identify};
use diagnose::models::OtherModel;
use formats::session::Session;
use rayon::prelude::*;

impl OtherResult {
    fn new(model: &OtherModel, found: Identification) -> Self {
        let youngs = found.youngs_modulus_kpa;
        Self {
            effects: found.effects,
            probability: model.probability,
            k_kpa: found.pooled.k_kpa,
            k_ci95_kpa: found.pooled.ci95_kpa,
            youngs_modulus_kpa: youngs.value,
            youngs_modulus_ci95_kpa: youngs.ci95,
        }
    }
}

/// K and E by each of the other models, and what cannot be computed.
pub(super) fn others(session: &Session, options: &Options) -> (Vec<OtherResult>, Vec<String>) {
    let other_fits: Vec<_> = options
        .others
        .par_iter()
        .map(|other| -> Result<OtherResult, IdentifyError> {
            let options = Options {
                fixed: other.effects.clone(),
                others: Vec::new(),
                layers: false,
                profile: false,
                bootstrap: 0,
                prior: None,
                ..options.clone()
            };
            identify(session, &options).map(|found| OtherResult::new(other, found))
        })
        .collect();
    let (mut results, mut warnings) = (Vec::new(), Vec::new());
    for (other, result) in options.others.iter().zip(other_fits) {
        match result {
            Ok(result) => results.push(result),
            Err(why) => {
                warnings.push(format!("the model with {} is skipped: {why}", effect_ids(&other.effects)))
            }
        }
    }
    (results, warnings)
}

fn effect_ids(effects: &[(&'static dyn mechanics::effects::Effect, Vec<f64>)]) -> String {
    effects.iter().map(|(effect, _)| effect.id()).collect::<Vec<_>>().join(", ")
}
