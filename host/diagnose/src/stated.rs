//! Detection of wrong statements about the rig: guide 2 or the surface is not at its stated position, by more than an ordinary error.
//!
//! Both positions are unknowns of every fit, so that no other effect absorbs their errors and the modulus stays unbiased
//! (theory, eq. 84). If the posterior excludes a stated position, this is reported as a named effect, and the misfit "before"
//! is that of the model with the stated position.

use super::adequacy::Adequacy;
use super::found::{Explanation, Found, Member};
use super::layout::{NORMAL_975, Scale, StatedPlace};
use super::posterior::{Fitted, MAX_ROUNDS};
use super::split::Judge;
use super::start::Start;
use super::weights::STATED_PROBABILITY;
use mechanics::effects::effect;
use readings::FitError;
use statrs::distribution::{ContinuousCDF, Normal};

const MM: f64 = 1e-3;
/// The stated position that is excluded most clearly, with its estimated error in m; `None` if none is excluded. It is excluded if the true
/// position is outside the 95 % interval of the stated one with a probability above 95 %, in the final model and averaged over all models
/// that were fitted around it.
fn excluded(found: &Found) -> Option<(StatedPlace, f64)> {
    let models = found.with_neighbours();
    let total: f64 = models.iter().map(|(ln, _)| ln.exp()).sum();
    let stated_probabilities = found.fitted.layout.stated().map(|place| {
        let own_probability = probability_beyond(&place, &found.fitted).unwrap_or_default();
        let weighted =
            models.iter().filter_map(|(ln, fitted)| Some(ln.exp() * probability_beyond(&place, fitted)?));
        (own_probability.min(weighted.sum::<f64>() / total), place)
    });
    let (probability, excluded_place) = stated_probabilities.max_by(|a, b| a.0.total_cmp(&b.0))?;
    let value_m = *found.fitted.values().get(excluded_place.parameter)?;
    (probability > STATED_PROBABILITY).then_some((excluded_place, value_m))
}

/// Probability in one model that a position is outside the 95 % interval of the stated one; `None` if the model does not have this parameter.
fn probability_beyond(place: &StatedPlace, fitted: &Fitted) -> Option<f64> {
    let value_m = fitted.values().get(place.parameter)?;
    let sds = (value_m.abs() - NORMAL_975 * place.scale_m) / fitted.sd(place.parameter);
    Some(Normal::standard().cdf(sds))
}

impl Start {
    /// The same start with all positions exactly as stated.
    ///
    /// # Errors
    /// Where the model cannot be evaluated.
    pub fn as_stated(&self) -> Result<Self, FitError> {
        Ok(Self {
            fitted: self.exactly(&self.fitted)?,
            runs: self.runs.clone(),
            patterns: self.patterns.clone(),
        })
    }

    /// A fit with the same effects, and all positions exactly as stated.
    fn exactly(&self, fitted: &Fitted) -> Result<Fitted, FitError> {
        let mut layout = fitted.layout.clone();
        layout.stated_is_exact = true;
        let parameters: Vec<usize> = fitted.layout.stated().map(|place| place.parameter).collect();
        let values = fitted.values().iter().enumerate().filter(|(at, _)| !parameters.contains(at));
        let values: Vec<f64> = values.map(|(_, value)| *value).collect();
        Fitted::new(&layout, &self.runs, &self.patterns, &values, &fitted.sizes, MAX_ROUNDS)
    }
}

impl Found {
    /// Names every stated position that the runs exclude, and returns whether there is any.
    ///
    /// # Errors
    /// Where the model cannot be evaluated.
    pub fn with_names_of_stated(mut self, start: &Start, judge: &Judge) -> Result<(Self, bool), FitError> {
        let mut is_named = false;
        // If the model is inadequate, its posterior of a position is not reliable.
        let adequacy = Adequacy::of(&self.fitted, &start.runs, &start.patterns)?;
        if !adequacy.is_adequate() && !judge.is_chance(&self.fitted) {
            return Ok((self, is_named));
        }
        while let Some((excluded_place, value_m)) = excluded(&self) {
            let Some(effect) = effect(excluded_place.effect) else { break };
            let mut values = self.fitted.values().to_vec();
            values.remove(excluded_place.parameter);
            let inside_values = effect.parameters().iter().map(|info| Scale::of(info).inside(value_m / MM));
            values.extend(inside_values);
            let layout = self.fitted.layout.with(effect);
            let Start { runs, patterns, .. } = start;
            let fitted = Fitted::new(&layout, runs, patterns, &values, &self.fitted.sizes, MAX_ROUNDS)?;
            let exact_fit = start.exactly(&self.fitted)?;
            // Like every name it has to be confirmed by the held-out data.
            if !judge.held_out_shrinks(&exact_fit, &fitted) {
                break;
            }
            let gain = fitted.log_evidence - exact_fit.log_evidence;
            let ln_odds = gain + self.prior.ln_odds(effect);
            let fitted = fitted.over_sizes(patterns);
            let index = layout.effects.len() - 1;
            let class = vec![Explanation { effect, fitted: fitted.clone(), ln_odds }];
            self.members.push(Member {
                index,
                gain,
                ln_odds,
                without: exact_fit,
                class,
                is_needless_elsewhere: false,
            });
            self.fitted = fitted;
            is_named = true;
        }
        Ok((self, is_named))
    }
}
