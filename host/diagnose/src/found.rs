//! Result of a search: the effects that were tried, those that were added to the model, and their alternatives.

use super::Multiples;
use super::discrepancy::patterns;
use super::posterior::Fitted;
use super::score::Score;
use super::split::Judge;
use super::start::Start;
use super::weights::{ModelPrior, NO_WEIGHT, limit_refused, stated_ln_odds};
use mechanics::effects::Effect;

/// An effect that was tried in addition to a model.
#[derive(Debug, Clone)]
pub(super) struct Candidate {
    pub score: Score,
    /// The fit with it, and the log evidence of this fit over the one without it; `None` if it was not fitted.
    pub refit: Option<(Fitted, f64)>,
    /// Logarithm of the odds of the model with it over the model without it; minus infinity if it was not fitted.
    pub ln_odds: f64,
    /// Whether it can be the missing effect.
    pub standing: Standing,
}

/// Whether a candidate can be the missing effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Standing {
    /// It can.
    Possible,
    /// It is at the end of its range, too small to matter, or does not reduce the misfit of the held-out runs.
    Refused,
    /// Another effect predicts the held-out runs significantly better.
    Refuted,
}

impl Standing {
    /// Log odds over the chosen model to which all candidates of this standing together are limited: 0 for refused ones, and the log
    /// odds of 5 % for refuted ones.
    pub fn most_ln_odds(self) -> f64 {
        match self {
            Self::Possible => f64::INFINITY,
            Self::Refused => 0.0,
            Self::Refuted => -stated_ln_odds(),
        }
    }
}

impl Candidate {
    pub fn id(&self) -> &'static str {
        self.score.effect.id()
    }

    /// Log evidence of the fit, or its expected value at convergence if the fit has not converged.
    pub fn promised_gain(&self) -> f64 {
        let promised = |(fitted, gain): &(Fitted, f64)| gain + fitted.worth() - fitted.log_evidence;
        self.refit.as_ref().map_or(f64::NEG_INFINITY, promised)
    }

    /// Log evidence of the fit over the fit without it.
    pub fn gain(&self) -> f64 {
        self.refit.as_ref().map_or(f64::NEG_INFINITY, |(_, gain)| *gain)
    }
}

/// One effect that was added to the model.
#[derive(Debug, Clone)]
pub(super) struct Member {
    /// Index of the effect in its fit.
    pub index: usize,
    /// Log evidence over the model without it.
    pub gain: f64,
    /// Logarithm of the odds that this effect or one of its alternatives is missing.
    pub ln_odds: f64,
    /// The fit without it.
    pub without: Fitted,
    /// The class: the smallest set of explanations with the stated probability, itself among them, most probable first.
    pub class: Vec<Explanation>,
    /// Whether the other foundation explains the data without it, so that it is not missing with the stated probability.
    pub is_needless_elsewhere: bool,
}

impl Member {
    /// Adds the effect to its own class if it is not there, because it was refuted by models that did not replace it.
    pub fn keep_own(&mut self, fitted: &Fitted, prior: &ModelPrior) {
        let Some(effect) = fitted.layout.effects.get(self.index).copied() else { return };
        if self.class.iter().all(|one| one.effect.id() != effect.id()) {
            let ln_odds = self.gain + prior.ln_odds(effect);
            self.class.push(Explanation { effect, fitted: fitted.clone(), ln_odds });
            self.class.sort_by(|a, b| b.ln_odds.total_cmp(&a.ln_odds));
        }
    }

    /// Whether it has no alternative.
    pub fn is_the_only_explanation(&self) -> bool {
        self.class.len() == 1 && !self.is_needless_elsewhere
    }
}

/// An effect as an explanation, with its fit.
#[derive(Debug, Clone)]
pub(super) struct Explanation {
    pub effect: &'static dyn Effect,
    pub fitted: Fitted,
    /// Logarithm of the odds of the model with it over the model without it.
    pub ln_odds: f64,
}

/// Result of the search.
#[derive(Debug, Clone)]
pub(super) struct Found {
    pub fitted: Fitted,
    /// The effects of this fit that were added.
    pub members: Vec<Member>,
    /// The model with laws that describe the misfit in part, if a misfit remains.
    pub described: Option<Fitted>,
    /// All effects scored around the starting model, named effects before laws.
    pub first: Vec<Candidate>,
    /// All effects scored around the last model, to which none was added; empty if the search ended otherwise.
    pub last: Vec<Candidate>,
    pub prior: ModelPrior,
}

/// Largest number of rounds of the last fit, and largest distance of its values from the fit before, in standard deviations.
const LAST_ROUNDS: usize = 8;
pub(super) const NEAR_SD: f64 = 6.0;

impl Found {
    /// The laws that describe the misfit in part.
    pub fn descriptions(&self) -> impl Iterator<Item = &'static dyn Effect> {
        let layout = self.described.iter().map(|fitted| &fitted.layout);
        let effects = layout.flat_map(|layout| layout.effects.iter().skip(layout.given).copied());
        effects.filter(|effect| effect.is_unnamed())
    }

    /// The final model and those with one more effect, with the logarithms of their odds over the final model.
    pub fn with_neighbours(&self) -> Vec<(f64, &Fitted)> {
        let candidates = if self.members.is_empty() { &self.first } else { &self.last };
        let in_range = candidates.iter().filter_map(|candidate| {
            let (fit, _) = candidate.refit.as_ref()?;
            let is_in_range = candidate.ln_odds > NO_WEIGHT && !fit.at_bound.contains(&true);
            is_in_range.then_some(((candidate.ln_odds, candidate.standing), fit))
        });
        let (mut odds, fits): (Vec<(f64, Standing)>, Vec<&Fitted>) = in_range.unzip();
        for standing in [Standing::Refused, Standing::Refuted] {
            let of_standing = odds.iter_mut().filter(|(_, own_standing)| *own_standing == standing);
            limit_refused(of_standing.map(|(ln, _)| ln), standing.most_ln_odds());
        }
        let neighbours = odds.into_iter().zip(fits).map(|((ln, _), fit)| (ln, fit));
        // A law that describes the misfit only in part has even odds, like all refused models.
        let described = self.described.iter().map(|fit| (0.0, fit));
        std::iter::once((0.0, &self.fitted)).chain(described).chain(neighbours).collect()
    }

    /// The same result with the discrepancy's patterns computed around the final model, because those of the start belong to a
    /// model without the effects. The evidence is kept from the search, in which all hypotheses have the same patterns. The new
    /// fit is used only if it is close to the old one and reduces the misfit of the held-out runs compared with the start.
    pub fn around_itself(mut self, start: &Start, judge: &Judge, multiples: &Multiples) -> Self {
        if self.members.is_empty() {
            return self;
        }
        let Start { runs, patterns: of_start, fitted: start } = start;
        let old = &self.fitted;
        let again = patterns(&old.layout, old.values(), runs, multiples).ok().and_then(|patterns| {
            let everyday = patterns.everyday();
            Fitted::new(&old.layout, runs, &patterns, old.values(), &everyday, LAST_ROUNDS)
                .ok()
                .map(|fitted| fitted.over_sizes(&patterns))
        });
        let nearby_fit = again.filter(|new| {
            let is_near = (0..old.values().len())
                .all(|i| (new.values()[i] - old.values()[i]).abs() <= NEAR_SD * new.sd(i).max(old.sd(i)));
            new.settled && !new.at_bound.contains(&true) && is_near && judge.held_out_shrinks(start, new)
        });
        if let Some(new) = nearby_fit {
            self.fitted = new.with_evidence_of(old);
        } else {
            self.fitted = self.fitted.over_sizes(of_start);
        }
        self
    }
}
