//! Choices of the user for a prediction.

use diagnose::models::{self, OtherModel};
use diagnose::{KnownParameter, Multiples};
use formats::model_file::ModelFile;
use formats::prior_file::ModulusPrior;
use mechanics::effects::Effect;
use readings::draws::DrawOptions;

/// Choices of the user.
#[derive(Debug, Clone)]
pub struct Options {
    /// Depth up to which an insertion is observed.
    pub until_m: f64,
    /// Depth to which it is predicted; the last recorded depth if it is not stated.
    pub to_m: Option<f64>,
    /// Whether the other insertions of the session are training data.
    pub learn: bool,
    /// Modulus and its standard deviation, Pa, instead of the one identified from the lateral runs.
    pub modulus_pa: Option<[f64; 2]>,
    /// Whether two layers are identified from the lateral runs.
    pub layers: bool,
    /// Effects with the values of their parameters.
    pub effects: Vec<(&'static dyn Effect, Vec<f64>)>,
    /// Other models that explain the same runs; the prediction is averaged over all of them.
    pub others: Vec<OtherModel>,
    /// Uncertainty of the rig's parameters, which widens the interval of the modulus from the lateral runs.
    pub known: Vec<KnownParameter>,
    /// Scales of the discrepancy relative to those of an ordinary rig, where they are larger.
    pub discrepancy: Multiples,
    /// Prior of K from many sessions; the result without it is reported too. It is not available for two layers.
    pub prior: Option<ModulusPrior>,
    /// Draws from the posterior beside the result.
    pub draws: Option<DrawOptions>,
    /// Depth from which the published method averages the tip load.
    pub published_from_m: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            until_m: 0.05,
            to_m: None,
            learn: true,
            modulus_pa: None,
            layers: false,
            effects: Vec::new(),
            others: Vec::new(),
            known: Vec::new(),
            discrepancy: Multiples::new(),
            prior: None,
            draws: None,
            published_from_m: 0.03,
        }
    }
}

impl Options {
    /// Adds the characterized rig (`guide characterize`): its effects with their intervals. Values that were stated before are
    /// kept.
    #[must_use]
    pub fn with_rig(mut self, rig: Option<&ModelFile>) -> Self {
        if let Some(rig) = rig {
            for other in &mut self.others {
                KnownParameter::take(&mut other.effects, &mut self.known, rig);
            }
            KnownParameter::take(&mut self.effects, &mut self.known, rig);
        }
        self
    }

    /// Adds a model from a file: its effects, its discrepancy, its modulus if `needs_modulus`, and its alternative models.
    /// Effects and a modulus that were stated before are kept, in all models.
    #[must_use]
    pub fn with_model(mut self, model: &ModelFile, needs_modulus: bool) -> Self {
        let stated = self.modulus_pa;
        (self.effects, self.others) = models::of_file(&self.effects, model);
        for other in &mut self.others {
            other.modulus_pa = modulus_from(other.modulus_pa, stated, needs_modulus);
        }
        self.modulus_pa = modulus_from(model.modulus_and_sd_pa(), stated, needs_modulus);
        self.discrepancy = model.discrepancy.clone();
        self
    }
}

fn modulus_from(
    of_model: Option<[f64; 2]>,
    stated: Option<[f64; 2]>,
    needs_modulus: bool,
) -> Option<[f64; 2]> {
    stated.or(of_model.filter(|_| needs_modulus))
}
