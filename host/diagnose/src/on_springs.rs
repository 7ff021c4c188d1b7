//! Modulus K of springs for a tissue that is modelled as an elastic body, which has no K.
//!
//! K is that of springs fitted with the same effects: without these, springs would absorb an effect, such as a delay of the
//! readings, as a different stiffness.

use super::averaged::Averaged;
use super::choice::Beside;
use super::posterior::{Fitted, MAX_ROUNDS};
use super::start::Start;
use mechanics::Support;
use rayon::prelude::*;
use readings::FitError;

/// Fits on springs with the effects of every plausible model of a body.
pub(super) struct OnSprings {
    plain: Fitted,
    with_effects: Vec<Fitted>,
}

impl OnSprings {
    /// K for all models of a body, fitted to the runs of a start.
    ///
    /// # Errors
    /// If springs without effects cannot be fitted.
    pub fn of(start: &Start, averaged: &Averaged, beside: &[Beside]) -> Result<Self, FitError> {
        let chosen = std::iter::once(averaged.own()).chain(averaged.fits().iter().map(|(_, fit)| fit));
        let bodies = chosen.chain(beside.iter().map(|other| &other.fitted));
        let mut models: Vec<&Fitted> = Vec::new();
        for fit in bodies.filter(|fit| fit.layout.support.is_body()) {
            let is_plain = fit.layout.has_effects_of(&start.fitted.layout);
            if !is_plain && !models.iter().any(|known| known.layout.has_effects_of(&fit.layout)) {
                models.push(fit);
            }
        }
        if !start.fitted.layout.support.is_body() {
            let with_effects = start.beside_effects_of(&models, |_| averaged.own().ln_modulus());
            return Ok(Self { with_effects, plain: start.fitted.clone() });
        }
        let springs = start.on(Support::Springs)?;
        let ln_modulus = |model: &Fitted| springs.ln_modulus_beside(model, &start.fitted);
        Ok(Self { with_effects: springs.beside_effects_of(&models, ln_modulus), plain: springs.fitted })
    }

    /// The fit on springs that states K of a model.
    pub fn stating_k_of<'a>(&'a self, model: &'a Fitted) -> &'a Fitted {
        if !model.layout.support.is_body() {
            return model;
        }
        let same = self.with_effects.iter().find(|fit| fit.layout.has_effects_of(&model.layout));
        same.unwrap_or(&self.plain)
    }
}

impl Start {
    /// Fits on this foundation with the effects of models on another one: those that have converged inside the ranges.
    fn beside_effects_of(
        &self,
        models: &[&Fitted],
        ln_modulus: impl Fn(&Fitted) -> f64 + Sync,
    ) -> Vec<Fitted> {
        let fits = models.par_iter().filter_map(|model| {
            let (layout, values) = self.with_effects_of(model, ln_modulus(model));
            Fitted::new(&layout, &self.runs, &self.patterns, &values, &self.fitted.sizes, MAX_ROUNDS).ok()
        });
        let in_range = fits.filter(|fit| fit.settled && !fit.at_bound.contains(&true));
        in_range.map(|fit| fit.over_sizes(&self.patterns)).collect()
    }
}

#[cfg(test)]
mod tests {
    use crate::{FoundationChoice, Options, diagnose};
    use worlds::body::{Bodies, Body, Fineness};
    use worlds::{Background, Design};

    /// A compliant frame makes plain springs softer, although it is no property of the tissue. With the effect, K is that of the same body
    /// without the effect.
    #[test]
    fn k_of_a_body_is_that_beside_the_effects_that_were_found() {
        let bodies = Bodies::new(Fineness::COARSE);
        let k_kpa = |effects| {
            let body = Body { youngs_kpa: 12.0, poisson: 0.5, effects };
            let session = bodies.session(&body, &Background::default(), &Design::four_runs(), 5);
            let options = Options { foundation: FoundationChoice::Body, ..Options::default() };
            diagnose(&session.expect("a session"), &options, |_| {}).expect("a diagnosis")
        };
        let clean = k_kpa(Vec::new());
        let behind = k_kpa(vec![("rig.frame_compliance", vec![0.12])]);
        assert!(
            behind.effects.iter().any(|effect| effect.id == "rig.frame_compliance"),
            "{:?}",
            behind.effects
        );
        let [low, high] = behind.k_ci95_kpa;
        assert!((low..=high).contains(&clean.k_kpa), "{} {:?}", clean.k_kpa, behind.k_ci95_kpa);
        assert!(behind.foundation.k_of_plain_springs_kpa.value < low, "{:?}", behind.foundation);
    }
}
