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

/// Leaders that are fitted, of names and of laws, and how far behind the best they may be by score: scores are those of small effects.
pub(super) const MAX_LEADERS: usize = 14;
const BEHIND: f64 = 15.0;
const BEHIND_SHARE: f64 = 0.7;
/// A score below which an effect is not fitted.
const MIN_SCORE: f64 = -2.0;
/// Rounds of the first fit; the best of these, and all that are not far behind them, go on until they settle.
const FIRST_ROUNDS: usize = 2;
const MAX_SETTLED: usize = 5;
/// Shares of the likely size of an effect, and steps of the modulus, from which a fit starts that first rounds have not brought to where its
/// score says that it is: each twice the one before, and as far as these rounds go.
const LIKELY_SHARES: [f64; 4] = [0.125, 0.25, 0.5, 1.0];
const MODULUS_STEPS: [f64; 5] = [-2.0, -1.0, 0.0, 1.0, 2.0];
/// Logarithm of odds of one in a thousand: a first fit that is less likely is not continued.
const NEGLIGIBLE: f64 = -7.0;
/// Site and regressor of a law of the grammar.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pair(Site, Scope, Regressor);

/// Effects of one kind are forms of each other.
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

/// The lowest score beside the best one for which a fit is tried.
pub(in super::super) fn leading(best: f64) -> f64 {
    best - BEHIND.max(BEHIND_SHARE * best)
}

impl Search<'_> {
    /// Fits the candidates with the best scores, best first, and weights them.
    pub fn weigh(&self, base: &Fitted, ranked: Vec<Score>, prior: &ModelPrior) -> Vec<Candidate> {
        let best = ranked.first().map_or(0.0, |score| score.log_evidence);
        // A hypothesis whose score has the evidence of a name is fitted however far behind it is.
        let near = leading(best).min(stated_ln_odds());
        // One of which every evaluation is an iteration at every depth is tried where its score is high enough.
        let least = |score: &Score| if score.effect.info().is_costly { 0.0 } else { MIN_SCORE };
        let is_promising =
            |score: &Score| score.is_identifiable && score.log_evidence > near.max(least(score));
        // Effects that the runs cannot show have a score of 0, above many that are worth a fit: they take no place among the leaders. Nor do
        // forms of one law beside the best of them, so that laws at other sites are fitted, too.
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
        // A fit that has not come to its end goes on where it promises no less than others have; and one whose score promises more than any fit
        // has, from another place, too.
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
            // The first rounds may have ended higher only where they ended beyond a range.
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

    /// The best place for a fit among likely sizes of its last effect and moduli that first rounds do not reach; at these sizes of the
    /// discrepancy.
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
        // The rest of the model changes little with the effect: good enough to judge what it is worth.
        let problem =
            Problem { layout: &layout, runs: self.runs, patterns: self.patterns, known: &base.jacobian };
        let mut fits: Vec<Iteration> =
            starts.iter().filter_map(|from| Iteration::new(problem, from, &sizes).ok()).collect();
        for _ in 0..FIRST_ROUNDS {
            // Which place is best shows only once the rest of the model has followed; a place whose linearised model promises less than
            // another one has reached is not.
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

/// The score from which on a first fit that was not at its end goes on although it is behind: its score promises more than any fit has
/// reached, as where the plain model was fitted far from the true modulus and the first rounds did not come back.
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
