//! Fits of the models of a diagnosis to all runs of a session, including the data that were held out in the search.
//!
//! After the search the held-out data carry information about the modulus like all other readings. So a diagnosis states the
//! same modulus as [`fit_with_discrepancy`](super::fit_with_discrepancy) for the same runs and model. The weights of the models
//! remain those of the search.

use super::averaged::Averaged;
use super::choice::Beside;
use super::data::Run;
use super::discrepancy::patterns;
use super::evidence::Patterns;
use super::found::NEAR_SD;
use super::layout::{Layout, kinds};
use super::posterior::{Fitted, MAX_ROUNDS};
use super::results::FoundationResult;
use super::start::{Noises, Start, fit_start};
use super::{DiagnoseError, Multiples};
use mechanics::effects::Effect;
use readings::FitError;

/// All runs, with the plain model on springs.
pub(super) struct Whole {
    springs: Start,
}

/// The fits of a diagnosis from which values are reported.
pub(super) struct Stated {
    pub start: Start,
    pub final_fit: Fitted,
    pub averaged: Averaged,
    pub beside: Vec<Beside>,
    pub foundation: FoundationResult,
}

impl Whole {
    /// All runs, under the same layout.
    ///
    /// # Errors
    /// Where the plain model does not fit them.
    pub fn new(
        layout: &Layout,
        runs: &[Run],
        noises: &Noises,
        given: &[(&'static dyn Effect, Vec<f64>)],
        multiples: &Multiples,
    ) -> Result<Self, DiagnoseError> {
        let of_runs = Layout::new(&layout.rig, runs, Vec::new());
        let layout = Layout { kinds: kinds(runs), readings_m: of_runs.readings_m, ..layout.clone() };
        Ok(Self { springs: fit_start(&layout, runs, noises, given, multiples)? })
    }

    /// The final models, fitted to all runs.
    ///
    /// # Errors
    /// If a model cannot be fitted to all runs.
    pub fn stated(
        self,
        of_training: &Stated,
        is_named: bool,
        multiples: &Multiples,
    ) -> Result<Stated, DiagnoseError> {
        let own = &of_training.final_fit;
        let plain = |support| {
            if support == self.springs.fitted.layout.support {
                Ok(self.springs.fitted.clone())
            } else {
                self.springs.on(support).map(|start| start.fitted)
            }
        };
        let chosen = plain(own.layout.support)?;
        let final_fit = if is_named {
            self.around_itself(own, multiples)?
        } else {
            chosen.clone().over_sizes(&self.springs.patterns)
        };
        let averaged =
            of_training.averaged.refitted(&final_fit, &self.springs.patterns, |fit| self.refitted(fit))?;
        let other_models = of_training
            .beside
            .iter()
            .map(|other| Ok(Beside { fitted: self.refitted(&other.fitted)?, ..other.clone() }));
        let other_models = other_models.collect::<Result<_, FitError>>()?;
        let foundation = of_training.foundation.fitted_again(&final_fit, &self.springs.fitted);
        let start = Start { fitted: chosen, ..self.springs };
        Ok(Stated { start, final_fit, averaged, beside: other_models, foundation })
    }

    /// A model fitted to all runs, starting at its present values.
    fn refitted(&self, fit: &Fitted) -> Result<Fitted, FitError> {
        let sizes = if fit.sizes.len() == self.springs.patterns.groups.len() {
            fit.sizes.clone()
        } else {
            self.springs.patterns.everyday()
        };
        self.near(fit, &self.springs.patterns, &sizes)
    }

    /// The same with the discrepancy's patterns computed around the model.
    fn around_itself(&self, fit: &Fitted, multiples: &Multiples) -> Result<Fitted, DiagnoseError> {
        let patterns = patterns(&self.layout_of(fit), fit.values(), &self.springs.runs, multiples)?;
        let refitted = self.near(fit, &patterns, &patterns.everyday())?;
        Ok(refitted.over_sizes(&patterns).with_evidence_of(fit))
    }

    /// A fit to all runs if it has converged near the values of another fit; otherwise the model with those values.
    fn near(&self, fit: &Fitted, patterns: &Patterns, sizes: &[f64]) -> Result<Fitted, FitError> {
        let layout = self.layout_of(fit);
        let fitted = |rounds| Fitted::new(&layout, &self.springs.runs, patterns, fit.values(), sizes, rounds);
        let is_near = |refitted: &Fitted| {
            let moved = refitted.values().iter().zip(fit.values()).map(|(new, old)| (new - old).abs());
            let mut by_number = moved.enumerate();
            refitted.settled && by_number.all(|(i, moved)| moved <= NEAR_SD * refitted.sd(i).max(fit.sd(i)))
        };
        fitted(MAX_ROUNDS).ok().filter(is_near).map_or_else(|| fitted(0), Ok)
    }

    fn layout_of(&self, fit: &Fitted) -> Layout {
        let Layout { readings_m, kinds, cache, .. } = self.springs.fitted.layout.clone();
        Layout { readings_m, kinds, cache, ..fit.layout.clone() }
    }
}
