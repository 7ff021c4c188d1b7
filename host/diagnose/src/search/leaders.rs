//! Choice of the effects and laws with the best scores, which are fitted.

use super::super::found::{Candidate, Standing};
use super::super::layout::{Layout, Scale};
use super::super::posterior::{Fitted, Iteration, MAX_LN_STEP, MAX_ROUNDS, Metric, Problem};
use super::super::score::Score;
use super::super::weights::{ModelPrior, NO_WEIGHT, one_sided, stated_ln_odds};
use super::Search;
use mechanics::effects::Effect;
use mechanics::terms::{Regressor, Scope, Site};
use rayon::prelude::*;

/// Largest number of leading candidates that are fitted, of names and likewise of laws, and how far their scores may be behind the best one,
/// in nats and as a share of it: a score is exact for small effects only.
pub(super) const MAX_LEADERS: usize = 14;
const BEHIND: f64 = 15.0;
const BEHIND_SHARE: f64 = 0.7;
/// A score below which an effect is not fitted.
const MIN_SCORE: f64 = -2.0;
/// Rounds of the first fits, and number of the best fits that are continued until they converge; so are fits that are not far behind.
const FIRST_ROUNDS: usize = 2;
const MAX_SETTLED: usize = 5;
/// Shares of the likely size of an effect, and steps of the modulus, at which a further fit may start if the first one has less evidence than
/// its score promises. Every share is twice the one before; the modulus moves as far as in the first rounds.
const LIKELY_SHARES: [f64; 4] = [0.125, 0.25, 0.5, 1.0];
const MODULUS_STEPS: [f64; 5] = [-2.0, -1.0, 0.0, 1.0, 2.0];
/// Logarithm of odds of one in a thousand: a first fit that is less likely is not continued.
const NEGLIGIBLE: f64 = -7.0;
/// Site and regressor of a law of the grammar.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pair(Site, Scope, Regressor);

/// Laws of one kind differ only in their form; a named effect is a kind of its own.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Kind {
    Law(Pair),
    Name(&'static str),
}

impl Kind {
    pub fn of(effect: &'static dyn Effect) -> Self {
        Pair::of(effect).map_or_else(|| Self::Name(effect.id()), Self::Law)
    }
}

impl Pair {
    /// `None` for an effect with a name.
    pub fn of(effect: &dyn Effect) -> Option<Self> {
        let law = effect.as_law().filter(|_| effect.is_unnamed())?;
        Some(Self(law.site, law.scope, law.regressor))
    }
}

/// The lowest score for which a fit is tried if the best score is `best`.
pub(in super::super) fn leading(best: f64) -> f64 {
    best - BEHIND.max(BEHIND_SHARE * best)
}

impl Search<'_> {
    /// Fits the candidates with the best scores, best first, and weights them.
    pub fn weigh(&self, base: &Fitted, ranked: Vec<Score>, prior: &ModelPrior) -> Vec<Candidate> {
        let best = ranked.first().map_or(0.0, |score| score.log_evidence);
        // A candidate whose log evidence by its score exceeds the log odds of a statement is fitted, however far it is behind the best.
        let near = leading(best).min(stated_ln_odds());
        // An effect is costly if every evaluation iterates at every depth; it is tried only if its score is above 0.
        let least = |score: &Score| if score.effect.info().is_costly { 0.0 } else { MIN_SCORE };
        let is_promising =
            |score: &Score| score.is_identifiable && score.log_evidence > near.max(least(score));
        // Effects that the runs cannot show have a score of 0, above many that are worth a fit: they take no place among the leaders. Only
        // the best law of a site and regressor takes a place, so that laws at other sites are fitted, too.
        let mut pairs = Vec::new();
        let mut leads = |score: &Score| {
            let pair = Pair::of(score.effect);
            let is_first = !pair.is_some_and(|pair| pairs.contains(&Some(pair)));
            let leads = is_promising(score) && is_first && pairs.len() < MAX_LEADERS;
            pairs.extend(leads.then_some(pair));
            leads
        };
        let leaders: Vec<bool> = ranked.iter().map(&mut leads).collect();
        let mut candidates: Vec<Candidate> = ranked
            .into_par_iter()
            .zip(leaders)
            .map(|(score, leads)| {
                let refit = if leads { self.refit(base, &score) } else { None };
                Candidate { score, refit, ln_odds: f64::NEG_INFINITY, standing: Standing::Refused }
            })
            .collect();
        let by_promise = |a: &Candidate, b: &Candidate| b.promised_gain().total_cmp(&a.promised_gain());
        candidates.sort_by(by_promise);
        // The other forms of the laws that are not behind.
        let least_gain = candidates.first().map_or(0.0, Candidate::promised_gain) - BEHIND;
        let ahead: Vec<Pair> = candidates
            .iter()
            .take_while(|candidate| candidate.promised_gain() > least_gain)
            .filter_map(|candidate| Pair::of(candidate.score.effect))
            .collect();
        candidates
            .par_iter_mut()
            .filter(|candidate| {
                candidate.refit.is_none()
                    && is_promising(&candidate.score)
                    && Pair::of(candidate.score.effect).is_some_and(|pair| ahead.contains(&pair))
            })
            .for_each(|candidate| candidate.refit = self.refit(base, &candidate.score));
        candidates.sort_by(by_promise);
        // A fit is continued unless it is improbable or, behind the first `MAX_SETTLED`, promises far less than the best fit has reached. If
        // the score of a fit that has not converged promises more than any fit has reached, a further fit starts from another place.
        let best_gain = candidates.iter().map(Candidate::gain).fold(f64::NEG_INFINITY, f64::max);
        let near = best_gain + NO_WEIGHT;
        let promised_score = least_promised_score(&candidates, best_gain.max(0.0));
        let settled = |(rank, candidate): (usize, &mut Candidate)| {
            let is_costly = candidate.score.effect.info().is_costly;
            let promised_gain = candidate.promised_gain();
            let is_unlikely = promised_gain + prior.ln_odds(candidate.score.effect) < NEGLIGIBLE
                || is_costly && candidate.gain() < 0.0;
            let is_behind = is_unlikely || rank >= MAX_SETTLED && promised_gain < near;
            let is_promised = !is_costly && candidate.score.log_evidence >= promised_score;
            let effect = candidate.score.effect;
            let Some((fitted, gain)) = candidate.refit.as_mut() else { return };
            let mut ends = Vec::new();
            if !is_behind {
                ends.extend(self.fit(&fitted.layout, fitted.values(), &fitted.sizes, MAX_ROUNDS));
            }
            if is_promised {
                let sizes = self.at_most_everyday(&fitted.sizes);
                let start = self.best_of_likely(fitted, effect, &sizes);
                ends.extend(self.fit(&fitted.layout, &start, &sizes, MAX_ROUNDS));
            }
            // The further fit replaces the first one even if its evidence is lower: it begins off the bounds, on which the first may have ended.
            if let Some(again) = ends.into_iter().max_by(|a, b| a.log_evidence.total_cmp(&b.log_evidence)) {
                *gain += again.log_evidence - fitted.log_evidence;
                *fitted = again;
            }
        };
        candidates.par_iter_mut().enumerate().for_each(settled);
        candidates.iter_mut().for_each(|candidate| {
            candidate.ln_odds = candidate.gain() + prior.ln_odds(candidate.score.effect)
        });
        candidates.sort_by(|a, b| b.ln_odds.total_cmp(&a.ln_odds));
        candidates
    }

    pub(super) fn fit(
        &self,
        layout: &Layout,
        starts: &[f64],
        sizes: &[f64],
        rounds: usize,
    ) -> Option<Fitted> {
        Fitted::new(layout, self.runs, self.patterns, starts, sizes, rounds).ok()
    }

    /// Start of a further fit: on a grid of likely sizes of the last effect and of moduli, the values at which the objective with these
    /// sizes of the discrepancy is smallest.
    fn best_of_likely(&self, fitted: &Fitted, effect: &dyn Effect, sizes: &[f64]) -> Vec<f64> {
        let first = fitted.values().len() - effect.parameters().len();
        let mut starts = vec![fitted.values().to_vec()];
        for (number, info) in effect.parameters().iter().enumerate().filter(|(_, info)| info.nodes.is_empty())
        {
            let scale = Scale::of(info);
            let neutral = scale.inside(info.neutral);
            for (end, share) in info.likely.iter().flat_map(|end| LIKELY_SHARES.map(|share| (*end, share))) {
                for steps in MODULUS_STEPS {
                    let mut start = fitted.values().to_vec();
                    start[0] += steps * MAX_LN_STEP;
                    start[first + number] = neutral + share * (scale.inside(end) - neutral);
                    starts.push(start);
                }
            }
        }
        let Some(metric) = Metric::new(self.patterns, sizes) else { return fitted.values().to_vec() };
        let squares = starts.iter().map(|start| metric.squares_at(&fitted.layout, self.runs, start));
        let judged = squares.zip(&starts).filter_map(|(squares, start)| Some((squares?, start)));
        let best = judged.min_by(|a, b| a.0.total_cmp(&b.0));
        best.map_or_else(|| fitted.values().to_vec(), |(_, start)| start.clone())
    }

    pub(super) fn at_most_everyday(&self, sizes: &[f64]) -> Vec<f64> {
        sizes.iter().zip(self.patterns.everyday()).map(|(size, most)| size.min(most)).collect()
    }

    pub(super) fn refit(&self, base: &Fitted, score: &Score) -> Option<(Fitted, f64)> {
        let layout = base.layout.with(score.effect);
        let is_costly = score.effect.info().is_costly;
        // From large sizes the fit would stay where the discrepancy explains everything.
        let sizes = self.at_most_everyday(&base.sizes);
        let from = |values: &Vec<f64>| {
            let mut starts = base.values().to_vec();
            let infos = score.effect.parameters().iter().zip(values);
            starts.extend(infos.map(|(info, value)| Scale::of(info).inside(*value)));
            starts
        };
        let mut starts: Vec<Vec<f64>> = score.starts.iter().map(from).collect();
        if is_costly {
            starts.truncate(1);
        }
        // The effect changes the sensitivities to the other parameters little: those of the model without it suffice to judge its evidence.
        let problem =
            Problem { layout: &layout, runs: self.runs, patterns: self.patterns, known: &base.jacobian };
        let mut fits: Vec<Iteration> =
            starts.iter().filter_map(|from| Iteration::new(problem, from, &sizes).ok()).collect();
        for _ in 0..FIRST_ROUNDS {
            // The best place shows only after the other parameters have followed. A place is given up if the model linearised there promises
            // less evidence than another place has reached.
            let reached = fits.iter().filter_map(Iteration::reached).fold(f64::NEG_INFINITY, f64::max);
            fits.retain(|fit| fit.promised() >= reached);
            fits = fits.into_iter().filter_map(|fit| fit.after(1).ok()).collect();
        }
        let fits = fits.into_iter().filter_map(|fit| fit.finish().ok());
        let fitted = fits.max_by(|a, b| a.worth().total_cmp(&b.worth()))?;
        let gain = fitted.log_evidence - base.log_evidence + one_sided(score.effect);
        Some((fitted, gain))
    }
}

/// Score from which on a fit that has not converged is tried from another place. Such a score promises more than any fit has reached, for
/// example because the plain model has a modulus far from the true one and the first rounds did not reach it.
fn least_promised_score(candidates: &[Candidate], best_gain: f64) -> f64 {
    let mut promised_scores: Vec<f64> = candidates
        .iter()
        .filter(|candidate| candidate.refit.as_ref().is_some_and(|(fitted, _)| !fitted.settled))
        .map(|candidate| candidate.score.log_evidence)
        .filter(|score| *score > best_gain)
        .collect();
    promised_scores.sort_by(|a, b| b.total_cmp(a));
    promised_scores.truncate(MAX_SETTLED);
    promised_scores.last().copied().unwrap_or(f64::INFINITY)
}
