//! The search: score, refit, accept, add, repeat; and which competing effects explain the data as well
//! (theory, eq. 65).

use super::Multiples;
use super::adequacy::Adequacy;
use super::determined::{is_determined, one_sided};
use super::discover;
use super::discrepancy::patterns;
use super::evidence::Patterns;
use super::layout::{Layout, Prepared, Scale};
use super::posterior::{Fitted, MAX_ROUNDS};
use super::score::{Score, Scores, stacked};
use super::split::Judge;
use super::start::Start;
use mechanics::effects::Effect;
use rayon::prelude::*;
use readings::FitError;

/// Share of parametric draws of a session that lacks nothing in which something may be named; [`MIN_GAIN`] is mostly above the margin
/// that follows, for outliers and rounding that the draws do not have.
const FALSE_ALARMS: f64 = 0.01;
/// Parametric draws for the margin.
const DRAWS: usize = 4000;
/// Log evidence without which nothing is named, independent of the draws.
const MIN_GAIN: f64 = 5.0;
/// An effect explains at least this share of what is left; one of strong evidence may be a part of several.
const SHARE: f64 = 0.5;
const SHARE_OF_STRONG: f64 = 0.15;
const STRONG_GAIN: f64 = 10.0;
/// Leaders that are refitted, in the search and among competitors of what was found, and how far behind the best they may be by score.
pub(super) const MAX_LEADERS: usize = 14;
const BEHIND: f64 = 15.0;
const BEHIND_SHARE: f64 = 0.7;
/// A score below which an effect is not refitted.
const MIN_SCORE: f64 = -2.0;
/// A first refit below which an effect that costs much is given up.
const MIN_OF_COSTLY: f64 = 1.0;
/// Rounds of the first refit; the best of these, and all that are not far behind them, go on until they settle.
const FIRST_ROUNDS: usize = 2;
const MAX_SETTLED: usize = 5;
const NEAR: f64 = 12.0;
/// Effects that may be missing at once; more explain anything.
const MAX_EFFECTS: usize = 3;
/// A competing effect within these odds of the best is as good, and, if its predictions are the same within noise, within the second ones.
const CLASS: f64 = 4.0;
const CLASS_ALIKE: f64 = 6.0;
/// A misfit (chi-square) that is smaller by this is clearly smaller.
const CLEARLY: f64 = 10.0;
/// Squared distance of predictions within noise.
const ALIKE: f64 = 6.0;

/// An effect tried beside a model.
#[derive(Debug, Clone)]
pub(super) struct Candidate {
    pub score: Score,
    /// The fit with it, and its log evidence over the fit without; nothing where it was not refitted.
    pub refit: Option<(Fitted, f64)>,
}

impl Candidate {
    pub fn id(&self) -> &'static str {
        self.score.effect.id()
    }

    /// Log evidence of the refit over the fit without it.
    pub fn gain(&self) -> f64 {
        self.refit.as_ref().map_or(f64::NEG_INFINITY, |(_, gain)| *gain)
    }
}

/// One effect that was added to the model.
#[derive(Debug, Clone)]
pub(super) struct Member {
    /// Its number among the effects of the fit that it is a member of.
    pub index: usize,
    /// Log evidence over the model without it.
    pub gain: f64,
    /// The fit without it.
    pub without: Fitted,
    /// Fits with a competing effect in its place; itself first.
    pub class: Vec<(&'static dyn Effect, Fitted)>,
}

impl Member {
    /// How many explanations the class has: effects that predict the same within noise are one.
    pub fn explanations(&self) -> usize {
        let mut distinct: Vec<&Fitted> = Vec::new();
        for (_, fitted) in &self.class {
            let apart =
                |other: &&Fitted| (stacked(&other.residuals) - stacked(&fitted.residuals)).norm_squared();
            if distinct.iter().all(|other| apart(other) >= ALIKE) {
                distinct.push(fitted);
            }
        }
        distinct.len()
    }
}

/// What the search found.
#[derive(Debug, Clone)]
pub(super) struct Found {
    pub fitted: Fitted,
    /// The effects of this fit that were added.
    pub members: Vec<Member>,
    /// All effects beside the starting model.
    pub first: Vec<Candidate>,
    /// All effects beside the last model to which none of them was added; empty where the search ended otherwise.
    pub last: Vec<Candidate>,
    pub margin: f64,
}

/// Rounds of the last fit, and how far it may be from the one before, in standard deviations.
const LAST_ROUNDS: usize = 8;
const NEAR_SD: f64 = 6.0;

impl Found {
    /// The same with the discrepancy's patterns made around what was found: those of the start are of a model that lacks it. The evidence
    /// stays that of the search, in which all hypotheses have the same patterns. As every step of the search, this one must leave the misfit
    /// of what was held out smaller than the start does.
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
        let is_near = |new: &Fitted| {
            (0..old.values().len())
                .all(|i| (new.values()[i] - old.values()[i]).abs() <= NEAR_SD * new.sd(i).max(old.sd(i)))
        };
        let is_usable = |new: &Fitted| {
            new.settled && !new.at_bound.contains(&true) && is_near(new) && judge.held_out_shrinks(start, new)
        };
        if let Some(new) = again.filter(is_usable) {
            self.fitted = new.with_evidence_of(old);
        } else {
            self.fitted = self.fitted.over_sizes(of_start);
        }
        self
    }
}

/// What a search works on.
pub(super) struct Search<'a> {
    pub start: &'a Fitted,
    pub runs: &'a [Prepared],
    pub patterns: &'a Patterns,
    pub judge: &'a Judge,
    pub seed: u64,
}

impl Search<'_> {
    /// Tries all effects beside a fit, best first.
    pub fn weigh(&self, base: &Fitted, scores: &Scores, most: usize) -> Vec<Candidate> {
        self.weigh_ranked(base, scores.ranked(), most)
    }

    /// The same of effects that are scored already, best first.
    pub fn weigh_ranked(&self, base: &Fitted, ranked: Vec<Score>, most: usize) -> Vec<Candidate> {
        let best = ranked.first().map_or(0.0, |score| score.log_evidence);
        let behind = BEHIND.max(BEHIND_SHARE * best);
        // One of which every evaluation is an iteration at every depth is tried where its score is high enough.
        let least = |score: &Score| if score.effect.info().is_costly { 0.0 } else { MIN_SCORE };
        // Scores are those of small effects: what has the evidence of a name by its score is fitted however far behind it is.
        let near = (best - behind).min(MIN_GAIN);
        let is_promising =
            |score: &Score| score.is_identifiable && score.log_evidence > near.max(least(score));
        // Effects that the runs cannot show have a score of 0, above many that are worth a fit: they take no place among the leaders.
        let leaders: Vec<bool> = ranked
            .iter()
            .scan(0, |places, score| {
                let leads = is_promising(score) && *places < most;
                *places += usize::from(leads);
                Some(leads)
            })
            .collect();
        let mut candidates: Vec<Candidate> = ranked
            .into_par_iter()
            .zip(leaders)
            .map(|(score, leads)| {
                let refit = if leads { self.refit(base, &score) } else { None };
                Candidate { score, refit }
            })
            .collect();
        candidates.sort_by(|a, b| b.gain().total_cmp(&a.gain()));
        let near = candidates.first().map_or(0.0, Candidate::gain) - NEAR;
        let settled = |(rank, candidate): (usize, &mut Candidate)| {
            let is_costly = candidate.score.effect.info().is_costly;
            if rank >= MAX_SETTLED && candidate.gain() < near || is_costly && candidate.gain() < MIN_OF_COSTLY
            {
                return;
            }
            if let Some((fitted, gain)) = candidate.refit.as_mut() {
                let again = self.fit(&fitted.layout, fitted.values(), &fitted.sizes, MAX_ROUNDS);
                // The first rounds may have ended higher only where they ended beyond a range.
                if let Some(again) = again {
                    *gain += again.log_evidence - fitted.log_evidence;
                    *fitted = again;
                }
            }
        };
        candidates.par_iter_mut().enumerate().for_each(settled);
        candidates.sort_by(|a, b| b.gain().total_cmp(&a.gain()));
        candidates
    }

    fn fit(&self, layout: &Layout, starts: &[f64], sizes: &[f64], rounds: usize) -> Option<Fitted> {
        Fitted::new(layout, self.runs, self.patterns, starts, sizes, rounds).ok()
    }

    fn refit(&self, base: &Fitted, score: &Score) -> Option<(Fitted, f64)> {
        let layout = base.layout.with(score.effect);
        let is_costly = score.effect.info().is_costly;
        // From large sizes the fit would stay where the discrepancy explains everything.
        let everyday = self.patterns.everyday();
        let sizes: Vec<f64> = base.sizes.iter().zip(everyday).map(|(size, most)| size.min(most)).collect();
        let from = |values: &Vec<f64>| {
            let mut starts = base.values().to_vec();
            let infos = score.effect.parameters().iter().zip(values);
            starts.extend(infos.map(|(info, value)| Scale::of(info).inside(*value)));
            // What the rest of the model does is much the same with the effect: good enough to judge what it is worth.
            Fitted::beside(&layout, self.runs, self.patterns, &starts, &sizes, FIRST_ROUNDS, &base.jacobian)
                .ok()
        };
        let starts = if is_costly { 1 } else { score.starts.len() };
        let fits = score.starts.iter().take(starts).filter_map(from);
        let fitted = fits.max_by(|a, b| a.log_evidence.total_cmp(&b.log_evidence))?;
        let gain = fitted.log_evidence - base.log_evidence + one_sided(score.effect);
        Some((fitted, gain))
    }

    /// A fit with one effect more, from the places that its score names, and its log evidence over the fit without; nothing where there is
    /// no such fit.
    ///
    /// # Errors
    /// Where the model cannot be evaluated.
    pub fn with_effect(
        &self,
        base: &Fitted,
        effect: &'static dyn Effect,
    ) -> Result<Option<(Fitted, f64)>, FitError> {
        let scores = Scores::of(&[effect], base, self.runs, self.patterns)?;
        let Some(first) = scores.ranked().first().and_then(|score| self.refit(base, score)) else {
            return Ok(None);
        };
        let again = self.fit(&first.0.layout, first.0.values(), &first.0.sizes, MAX_ROUNDS);
        Ok(Some(again.map_or(first.clone(), |again| {
            let gain = first.1 + again.log_evidence - first.0.log_evidence;
            (again, gain)
        })))
    }

    /// Adds what is missing to the start, one effect after the other.
    ///
    /// # Errors
    /// Where the model cannot be evaluated.
    pub fn run(&self, mut report: impl FnMut(&str)) -> Result<Found, FitError> {
        let given = self.start.layout.effects.len();
        let mut current = self.start.clone();
        let (mut first, mut last, mut terms_alone) = (Vec::new(), Vec::new(), Vec::new());
        let mut margin = 0.0;
        while current.layout.effects.len() < given + MAX_EFFECTS {
            let scores = Scores::new(&current, self.runs, self.patterns)?;
            // With every step the search is repeated; the margin is that of its own directions.
            let needed = scores.margin(FALSE_ALARMS, DRAWS, self.seed).max(MIN_GAIN);
            let candidates = self.weigh(&current, &scores, MAX_LEADERS);
            let is_noise = Adequacy::of(&current, self.runs, self.patterns)?.is_within_noise();
            // Where nothing but noise is left there is nothing to be explained.
            if is_noise && !first.is_empty() {
                break;
            }
            // What two sessions share has no name beside a reference, and what differs is to have a plain one.
            let searches_laws = !is_noise && current.layout.reference.is_none();
            let (terms, needed_of_terms) =
                if searches_laws { self.terms(&current)? } else { (Vec::new(), f64::INFINITY) };
            // A name is as good as a law that needs as much more evidence as there are more laws.
            let chosen =
                [(&candidates, needed), (&terms, needed_of_terms)].into_iter().filter_map(|(of, needed)| {
                    let chosen = self.chosen(of, &current, needed)?;
                    let (fitted, gain) = chosen.refit.clone()?;
                    Some((chosen.id(), fitted, gain, needed))
                });
            let chosen = chosen.max_by(|a, b| (a.2 - a.3).total_cmp(&(b.2 - b.3)));
            if first.is_empty() {
                (first, margin, terms_alone) = (candidates.clone(), needed, terms);
            }
            let Some((id, fitted, gain, needed)) = chosen else {
                last = candidates;
                break;
            };
            report(&format!("{id} is missing: log evidence + {gain:.1}, needed {needed:.1}"));
            current = self.without_needless(fitted, given, needed);
        }
        let first_and_terms: Vec<Candidate> = first.iter().cloned().chain(terms_alone).collect();
        // A better effect in the place of one that was taken early shows only once the others are there.
        let mut members = self.members(&current, &first_and_terms, given, margin)?;
        for _ in 0..2 {
            let better = members.iter().find_map(|member| {
                let (best, fitted) = member.class.first()?;
                let own = current.layout.effects.get(member.index)?;
                // Nor may it make the held-out misfit grow.
                let is_better = best.id() != own.id() && self.judge.held_out_shrinks(&current, fitted);
                is_better.then(|| fitted.clone())
            });
            let Some(better) = better else { break };
            current = better;
            members = self.members(&current, &first_and_terms, given, margin)?;
        }
        // What another effect has made needless since is no longer a name.
        while let Some(index) = needless(&current, &members, margin) {
            let Some(less) = self.refitted_without(&current, index) else { break };
            current = less;
            members = self.members(&current, &first_and_terms, given, margin)?;
        }
        Ok(Found { fitted: current, members, first, last, margin })
    }

    /// The effect to add of those that may be: of several whose evidence is as good, the one whose physics leaves least to be explained.
    fn chosen<'c>(
        &self,
        candidates: &'c [Candidate],
        current: &Fitted,
        needed: f64,
    ) -> Option<&'c Candidate> {
        let mut accepted = candidates.iter().filter(|candidate| {
            self.is_accepted(candidate, current, needed) && self.gain_over_best(candidate, current) > needed
        });
        let first = accepted.next()?;
        let misfit = |candidate: &Candidate| {
            candidate.refit.as_ref().map_or(f64::INFINITY, |(fitted, _)| self.judge.misfit(fitted))
        };
        let as_good = accepted.filter(|other| first.gain() - other.gain() < CLASS);
        let all = std::iter::once(first).chain(as_good);
        all.min_by(|a, b| misfit(a).total_cmp(&misfit(b)))
    }

    /// Tries all terms of the grammar beside a fit, best first, and the evidence that a name among them needs.
    fn terms(&self, base: &Fitted) -> Result<(Vec<Candidate>, f64), FitError> {
        let (ranked, needed) = discover::ranked(base, self.runs, self.patterns)?;
        Ok((self.weigh_ranked(base, ranked, MAX_LEADERS), needed))
    }

    /// Whether an effect may be added: its evidence, its share of what is left, its interval, its range, the held-out misfit.
    fn is_accepted(&self, candidate: &Candidate, current: &Fitted, margin: f64) -> bool {
        let Some((fitted, gain)) = &candidate.refit else { return false };
        if *gain <= margin {
            return false;
        }
        let needed = if *gain >= STRONG_GAIN { SHARE_OF_STRONG } else { SHARE };
        is_determined(fitted, fitted.layout.effects.len() - 1)
            && self.judge.share(current, fitted) >= needed
            && self.judge.held_out_shrinks_in(current, fitted, candidate.score.effect.info().observable_in)
    }

    /// Log evidence over the fit without the effect, which may have a better one where the discrepancy has the sizes it has with the
    /// effect.
    fn gain_over_best(&self, candidate: &Candidate, current: &Fitted) -> f64 {
        let Some((fitted, gain)) = &candidate.refit else { return f64::NEG_INFINITY };
        let again = self.fit(&current.layout, current.values(), &fitted.sizes, MAX_ROUNDS);
        gain - again.map_or(0.0, |again| (again.log_evidence - current.log_evidence).max(0.0))
    }

    /// Skips what is no longer needed once something better is there.
    fn without_needless(&self, fitted: Fitted, given: usize, margin: f64) -> Fitted {
        let count = fitted.layout.effects.len();
        for index in given..count.saturating_sub(1) {
            if let Some(less) = self.refitted_without(&fitted, index) {
                let gain = fitted.log_evidence - less.log_evidence + one_sided(fitted.layout.effects[index]);
                if gain < margin {
                    return less;
                }
            }
        }
        fitted
    }

    fn refitted_without(&self, fitted: &Fitted, index: usize) -> Option<Fitted> {
        let layout = fitted.layout.without(index);
        let first = fitted.layout.first_of(index);
        let count = fitted.layout.effects[index].parameters().len();
        let mut starts = fitted.values().to_vec();
        starts.drain(first..first + count);
        self.fit(&layout, &starts, &self.start.sizes, MAX_ROUNDS)
    }

    /// For every effect that was added, its evidence and its class.
    fn members(
        &self,
        fitted: &Fitted,
        first: &[Candidate],
        given: usize,
        margin: f64,
    ) -> Result<Vec<Member>, FitError> {
        let count = fitted.layout.effects.len();
        let mut members = Vec::new();
        for index in given..count {
            let effect = fitted.layout.effects[index];
            let (base, candidates) = if count == given + 1 {
                (self.start.clone(), first.to_vec())
            } else {
                let Some(base) = self.refitted_without(fitted, index) else { continue };
                let scores = Scores::new(&base, self.runs, self.patterns)?;
                let mut candidates = self.weigh(&base, &scores, MAX_LEADERS);
                if effect.is_unnamed() {
                    candidates.extend(self.terms(&base)?.0);
                }
                (base, candidates)
            };
            let own = fitted.log_evidence - base.log_evidence + one_sided(effect);
            // A law is one of so many more than there are names: it costs as much more beforehand.
            let cost = |of: &dyn Effect| if of.is_unnamed() { discover::needed(&base) - margin } else { 0.0 };
            let own_cost = cost(effect);
            // Where a name leaves nearly all of the held-out misfit the model is far from exact, and odds that assume it exact separate
            // nothing: whatever the evidence supports is in the class.
            let is_weak =
                self.judge.held_out_share(&base, fitted).is_some_and(|share| share < SHARE_OF_STRONG);
            let mut class = vec![(effect, fitted.clone(), own)];
            for candidate in &candidates {
                let Some((other, gain)) = &candidate.refit else { continue };
                let competes = *gain > 0.5 * margin && !other.at_bound.iter().any(|at| *at);
                if candidate.id() == effect.id() || !competes {
                    continue;
                }
                let from = |of: &Fitted| (stacked(&other.residuals) - stacked(&of.residuals)).norm_squared();
                let apart = from(fitted);
                // A law that predicts what a name does is that name.
                let is_name =
                    |(of, fit, _): &(&'static dyn Effect, Fitted, f64)| !of.is_unnamed() && from(fit) < ALIKE;
                if candidate.score.effect.is_unnamed() && class.iter().any(is_name) {
                    continue;
                }
                let behind = own - own_cost - (gain - cost(candidate.score.effect));
                let is_supported = is_weak && *gain > margin && !candidate.score.effect.is_unnamed();
                if behind < CLASS || (behind < CLASS_ALIKE && apart < ALIKE) || is_supported {
                    class.push((candidate.score.effect, other.clone(), *gain));
                }
            }
            // First the one whose physics leaves least; a competitor counts as better only where it is clearly so.
            let own_misfit = self.judge.misfit(fitted);
            let misfit = |(other, fit, _): &(&'static dyn Effect, Fitted, f64)| {
                let misfit = self.judge.misfit(fit);
                if other.id() == effect.id() { misfit - CLEARLY.min(0.5 * own_misfit) } else { misfit }
            };
            class.sort_by(|a, b| misfit(a).total_cmp(&misfit(b)));
            let class = class.into_iter().map(|(effect, fitted, _)| (effect, fitted)).collect();
            members.push(Member { index, gain: own, without: base, class });
        }
        Ok(members)
    }
}

/// The effect that was added and is least needed, where it is not needed at all.
fn needless(fitted: &Fitted, members: &[Member], margin: f64) -> Option<usize> {
    let idle = members.iter().filter(|m| m.gain < margin || !is_determined(fitted, m.index));
    idle.min_by(|a, b| a.gain.total_cmp(&b.gain)).map(|member| member.index)
}
