//! K and E by the other models of a model file: a class of effects that explain the runs alike need not agree on them.

use super::{Identification, IdentifyError, Options, identify};
use crate::OtherModel;
use formats::session::Session;
use rayon::prelude::*;
use serde::Serialize;
use std::fmt::{self, Display};

/// What another model makes of the same runs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OtherResult {
    /// Ids of its effects.
    pub effects: Vec<&'static str>,
    /// Its probability, given the runs that it was learned from.
    pub probability: f64,
    /// Foundation modulus of all runs together.
    pub k_kpa: f64,
    /// Its 95 % interval.
    pub k_ci95_kpa: [f64; 2],
    /// Young's modulus; `None` where it is refused.
    pub youngs_modulus_kpa: Option<f64>,
    /// Its 95 % interval.
    pub youngs_modulus_ci95_kpa: Option<[f64; 2]>,
}

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

impl Display for OtherResult {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { probability, k_kpa, k_ci95_kpa: [low, high], .. } = self;
        let name =
            if self.effects.is_empty() { "no effects".to_owned() } else { self.effects.join(" with ") };
        write!(f, "K {k_kpa:.2} ({low:.2} to {high:.2}) kPa")?;
        if let (Some(youngs), Some([low, high])) = (self.youngs_modulus_kpa, self.youngs_modulus_ci95_kpa) {
            write!(f, ", E {youngs:.2} ({low:.2} to {high:.2}) kPa")?;
        }
        write!(f, " by the model with {name} (probability {:.0} %)", 100.0 * probability)
    }
}

/// K and E by each of the other models, and what cannot be computed.
pub(super) fn others(session: &Session, options: &Options) -> (Vec<OtherResult>, Vec<String>) {
    let of = |other: &OtherModel| -> Result<OtherResult, IdentifyError> {
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
    };
    let found: Vec<_> = options.others.par_iter().map(of).collect();
    let (mut results, mut warnings) = (Vec::new(), Vec::new());
    for (other, result) in options.others.iter().zip(found) {
        let ids = || other.effects.iter().map(|(effect, _)| effect.id()).collect::<Vec<_>>().join(", ");
        match result {
            Ok(result) => results.push(result),
            Err(why) => warnings.push(format!("the model with {} is skipped: {why}", ids())),
        }
    }
    (results, warnings)
}
