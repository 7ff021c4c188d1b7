//! Conversion of a fit to a model file.

use super::posterior::Fitted;
use formats::model_file::{LearnedEffect, ModelFile};
use mechanics::effects::Effect;

impl Fitted {
    /// Tissue, tip load and all effects with the values and intervals of this fit.
    pub fn model(&self) -> ModelFile {
        let (modulus_pa, modulus_ci95_pa) = self.modulus_pa();
        let (modulus_pa, modulus_ci95_pa) = (Some(modulus_pa), Some(modulus_ci95_pa));
        let support = self.layout.support;
        let tip = self.tip_load_n();
        let common = ModelFile {
            tip_load_n: tip.map(|(value, _)| value),
            tip_load_ci95_n: tip.map(|(_, ends)| ends),
            effects: self.layout.effects.iter().enumerate().map(|(at, of)| self.learned(at, *of)).collect(),
            ..ModelFile::default()
        };
        // On a body the modulus of a fit is Young's.
        if support.is_body() {
            ModelFile {
                support: Some(support),
                youngs_pa: modulus_pa,
                youngs_ci95_pa: modulus_ci95_pa,
                ..common
            }
        } else {
            ModelFile { modulus_pa, modulus_ci95_pa, ..common }
        }
    }

    fn learned(&self, at: usize, effect: &'static dyn Effect) -> LearnedEffect {
        let estimates = (0..effect.parameters().len()).map(|number| self.estimate(at, number));
        let (values, ci95) = estimates.map(|(value, ends)| (value, Some(ends))).unzip();
        LearnedEffect { effect, values, ci95, log_evidence_gain: None }
    }
}
