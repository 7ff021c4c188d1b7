//! Weights of models (theory, eq. 64).
//!
//! A model is a foundation, springs or a body, and a set of effects. Its weight is its evidence times its prior, which has
//! three parts. The prior probability that some effect of the catalogue is missing equals that of none, and all effects that
//! the runs can show have equal parts of it. A missing law outside the catalogue has prior odds `LAW_ODDS`, in equal parts for
//! all laws that the runs can show. A body has prior odds of `exp(-FOUNDATION_MARGIN)` over springs, the simpler model. A set of
//! effects has no further penalty, and no effect has a rule of its own.
//!
//! If the model is complete, the Bayes factor of any effect has mean 1, whatever the noise. By Markov's inequality, effects
//! with prior odds `q` in total then reach posterior odds `r` in at most a fraction `q / r` of sessions: effects of the
//! catalogue in 5 %, laws in 0.5 %.

use super::foundation::FOUNDATION_MARGIN;
use super::posterior::Fitted;
use mechanics::effects::Effect;

pub(super) use ::discrepancy::weights::{
    NO_WEIGHT, STATED_PROBABILITY, indistinct, is_refuted, limit_refused, ln_sum, same, smallest_set,
    stated_ln_odds,
};

/// Prior odds that a law outside the catalogue is missing. Laboratories find effects that nobody had thought of in perhaps one of ten setups;
/// by Markov's bound above there is then at most one false law in two hundred sessions.
const LAW_ODDS: f64 = 0.1;
/// Correction of the log evidence of an effect with one-sided parameters: the prior of such a parameter has all of its mass on one side of the
/// neutral value, that is, twice the density of the normal prior of the fits.
pub(super) fn one_sided(effect: &dyn Effect) -> f64 {
    let sides = effect.parameters().iter().filter(|info| info.nodes.is_empty() && !info.is_two_sided());
    sides.count() as f64 * std::f64::consts::LN_2
}

/// Prior of the models of a session.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ModelPrior {
    /// Number of named effects that the runs can show.
    names: usize,
    /// Number of laws that they can show.
    laws: usize,
}

impl ModelPrior {
    /// Prior for these numbers of effects and laws that the runs can show.
    pub fn new(names: usize, laws: usize) -> Self {
        Self { names: names.max(1), laws: laws.max(1) }
    }

    /// Logarithm of the prior odds of a model with an effect over the model without it.
    pub fn ln_odds(&self, effect: &dyn Effect) -> f64 {
        if effect.is_unnamed() { (LAW_ODDS / self.laws as f64).ln() } else { -(self.names as f64).ln() }
    }

    /// Smallest log evidence of a single effect that is named.
    pub fn needed(&self) -> f64 {
        (self.names as f64).ln() + stated_ln_odds()
    }

    /// Logarithm of the weight of a model, up to a constant that all models of a session share.
    pub fn ln_weight(&self, fitted: &Fitted) -> f64 {
        let added = fitted.layout.effects.iter().skip(fitted.layout.given);
        let body = if fitted.layout.support.is_body() { FOUNDATION_MARGIN } else { 0.0 };
        let effects = added.map(|effect| one_sided(*effect) + self.ln_odds(*effect));
        fitted.log_evidence - body + effects.sum::<f64>()
    }
}
