//! K and E by another model of a model file.

use serde::Serialize;
use std::fmt::{self, Display};

/// Result of another model for the same runs.
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
