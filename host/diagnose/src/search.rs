//! The search for the sets of effects that explain the runs, with their probabilities (theory, eq. 65).
//!
//! Around a model every effect of the catalogue and every law of the grammar is scored, the best are fitted, and each gets its
//! weight ([`super::weights`]). While some effect is missing with the stated probability, the most probable one is added.
//! Held-out runs have a veto: an effect that does not reduce their misfit is refused.

mod beginnings;
mod leaders;
mod rivals;
mod scored;

use beginnings::Beginning;
use rivals::Judged;

use super::adequacy::Adequacy;
use super::determined::is_determined;
use super::discover;
use super::evidence::Patterns;
use super::found::{Candidate, Explanation, Found, Member, Standing};
use super::layout::Prepared;
use super::posterior::{Fitted, MAX_ROUNDS};
use super::score::Scores;
use super::split::Judge;
use super::weights::{ModelPrior, NO_WEIGHT, ln_sum, smallest_set, stated_ln_odds};
use mechanics::effects::{Effect, all};
use readings::FitError;
use scored::AroundStart;
use std::sync::{Mutex, PoisonError};

/// Largest number of effects that are added: every further one costs the whole search again.
const MAX_EFFECTS: usize = 3;

pub(super) use leaders::leading;

/// Inputs of a search.
pub(super) struct Search<'a> {
    pub start: &'a Fitted,
    pub runs: &'a [Prepared],
    pub patterns: &'a Patterns,
    pub judge: &'a Judge,
    pub catalogue: Catalogue<'a>,
    /// Candidates beside the models around which the search has already been. The alternatives to an effect are candidates beside the
    /// model without it, which is usually one of these models.
    memo: Mutex<Vec<Asked>>,
    around_start: AroundStart,
}

/// Candidates beside a model of these effects.
struct Asked {
    effects: Vec<&'static str>,
    with_laws: bool,
    candidates: Vec<Candidate>,
}

/// A set of effects beside the start.
struct Set {
    fitted: Fitted,
    /// The effects of this fit that were added.
    members: Vec<Member>,
    /// All candidates beside this fit, none of which was added; empty if the search ended for another reason.
    last: Vec<Candidate>,
}

/// Effects that the search may find.
#[derive(Debug, Clone, Copy)]
pub(super) struct Catalogue<'a> {
    /// Whether laws are searched for, too.
    pub laws: bool,
    /// Effects that are excluded.
    pub left_out: &'a [&'static str],
}

impl Catalogue<'_> {
    /// The whole catalogue and grammar.
    pub const WHOLE: Self = Self { laws: true, left_out: &[] };

    fn names(&self) -> Vec<&'static dyn Effect> {
        all().into_iter().filter(|effect| !self.left_out.contains(&effect.id())).collect()
    }
}

impl<'a> Search<'a> {
    /// A search around a start.
    pub fn new(
        start: &'a Fitted,
        runs: &'a [Prepared],
        patterns: &'a Patterns,
        judge: &'a Judge,
        catalogue: Catalogue<'a>,
    ) -> Self {
        Self {
            start,
            runs,
            patterns,
            judge,
            catalogue,
            memo: Mutex::default(),
            around_start: AroundStart::default(),
        }
    }

    /// Candidates beside a fit, most probable first: all named effects, and if `with_laws` all laws.
    ///
    /// # Errors
    /// Where the model cannot be evaluated.
    fn candidates(
        &self,
        base: &Fitted,
        prior: &ModelPrior,
        with_laws: bool,
    ) -> Result<Vec<Candidate>, FitError> {
        let mut effects: Vec<&'static str> = base.layout.effects.iter().map(|effect| effect.id()).collect();
        effects.sort_unstable();
        let memo = || self.memo.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(asked) =
            memo().iter().find(|asked| asked.effects == effects && asked.with_laws == with_laws)
        {
            return Ok(asked.candidates.clone());
        }
        let known = memo().iter().find(|asked| asked.effects == effects).map(|asked| {
            let is_name = |candidate: &&Candidate| !candidate.score.effect.is_unnamed();
            asked.candidates.iter().filter(is_name).cloned().collect()
        });
        let names = match known {
            Some(names) => names,
            None => self.weigh(base, self.scored_names(base)?, prior),
        };
        let candidates = self.judged(base, names, prior, with_laws)?;
        memo().push(Asked { effects, with_laws, candidates: candidates.clone() });
        Ok(candidates)
    }

    /// These named effects, and the laws beside the fit if `with_laws`, with their odds and their standing.
    fn judged(
        &self,
        base: &Fitted,
        names: Vec<Candidate>,
        prior: &ModelPrior,
        with_laws: bool,
    ) -> Result<Vec<Candidate>, FitError> {
        let mut all = names;
        if with_laws && self.catalogue.laws {
            all.extend(self.weigh(base, self.scored_laws(base)?, prior));
        }
        for candidate in &mut all {
            candidate.ln_odds = candidate.gain() + prior.ln_odds(candidate.score.effect);
            let is_possible = self.is_possible(candidate, base);
            candidate.standing = if is_possible { Standing::Possible } else { Standing::Refused };
        }
        let judged = self.by_held_out(all.iter().map(|candidate| {
            let (fitted, _) =
                candidate.refit.as_ref().filter(|_| candidate.standing == Standing::Possible)?;
            Some((candidate.ln_odds, fitted))
        }));
        let possible = all.iter_mut().zip(judged).filter(|(one, _)| one.standing == Standing::Possible);
        for (candidate, Judged { ln_odds, is_refuted }) in possible {
            candidate.ln_odds = ln_odds;
            if is_refuted {
                candidate.standing = Standing::Refuted;
            }
        }
        all.sort_by(|a, b| b.ln_odds.total_cmp(&a.ln_odds));
        Ok(all)
    }

    /// Log evidence of the start, and the log evidence of the best effect over it by its score.
    ///
    /// # Errors
    /// Where the model cannot be evaluated.
    pub fn promise(&self) -> Result<[f64; 2], FitError> {
        let [names, laws] = self.foreseen(self.start)?;
        let best = names.iter().chain(&laws).map(|score| score.log_evidence).fold(0.0, f64::max);
        Ok([self.start.log_evidence, best])
    }

    /// A fit with one more effect, from the start values of its score, and its log evidence over the fit without it; `None` if
    /// there is no such fit.
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

    /// Whether laws are tried beside a fit. With a reference none is: an effect that both sessions share is not named, and one by which they
    /// differ needs a name of the catalogue.
    fn may_have_laws(&self, fitted: &Fitted) -> bool {
        self.catalogue.laws && fitted.layout.reference.is_none()
    }

    /// Prior of the models that the search may come to.
    fn prior(&self) -> Result<ModelPrior, FitError> {
        let scores = self.scored_names(self.start)?;
        let names = scores.iter().filter(|score| score.is_identifiable).count();
        Ok(ModelPrior::new(names, discover::shown(self.start, self.catalogue.left_out).len()))
    }

    /// Logarithm of the largest weight of the start and of the models with one possible named effect beside it.
    ///
    /// # Errors
    /// [`FitError`] if the model cannot be evaluated.
    pub fn ln_weight_of_names(&self) -> Result<f64, FitError> {
        let prior = self.prior()?;
        let candidates = self.candidates(self.start, &prior, false)?;
        let explanations = explanations_of(&candidates);
        let weights = explanations.iter().map(|one| prior.ln_weight(&one.fitted));
        Ok(weights.fold(prior.ln_weight(self.start), f64::max))
    }

    /// Adds the missing effects to the start, one after the other; and again from other first effects, if these may lead to a
    /// more probable set.
    ///
    /// # Errors
    /// Where the model cannot be evaluated.
    pub fn run(&self, mut report: impl FnMut(&str)) -> Result<Found, FitError> {
        let prior = self.prior()?;
        let mut first = Vec::new();
        let mut set = self.grown(self.start.clone(), &prior, &mut first, &mut report)?;
        for Beginning { fitted, ln_weight } in self.beginnings(&set, &first, &prior)? {
            if ln_weight <= prior.ln_weight(&set.fitted) {
                break;
            }
            report("a set of other effects may be likelier: the search begins again");
            let other = self.grown(fitted, &prior, &mut first, &mut report)?;
            if self.is_likelier(&other.fitted, &set.fitted, &prior) {
                set = other;
            }
        }
        let Set { mut fitted, mut members, last } = set;
        let described = self.described(&fitted)?;
        if let Some(names) = described.as_ref().map(|_| self.without_laws(&fitted)) {
            fitted = names;
            members = self.members(&fitted, &first, &prior)?;
            members.iter_mut().for_each(|member| member.keep_own(&fitted, &prior));
        }
        Ok(Found { fitted, members, described, first, last, prior })
    }

    /// Adds missing effects to a model, and exchanges and removes those that have become improbable; `first` gets the candidates beside the
    /// start, once.
    fn grown(
        &self,
        beginning: Fitted,
        prior: &ModelPrior,
        first: &mut Vec<Candidate>,
        mut report: impl FnMut(&str),
    ) -> Result<Set, FitError> {
        let given_count = self.start.layout.effects.len();
        let mut current = beginning;
        let mut last = Vec::new();
        while current.layout.effects.len() < given_count + MAX_EFFECTS {
            let adequacy = Adequacy::of(&current, self.runs, self.patterns)?;
            // If only noise is left there is no misfit to be explained.
            if adequacy.is_within_noise() && !first.is_empty() {
                break;
            }
            // A law is supported by its fit alone, and some law describes the imperfections of every rig. Therefore laws are tried only if
            // the misfit of the training runs or of the held-out data exceeds such imperfections, or if an effect of the catalogue is
            // missing, in whose place a law may be better.
            let may_have_laws = self.may_have_laws(&current);
            let is_left = !adequacy.is_adequate() || !self.judge.is_chance(&current);
            let mut candidates = self.candidates(&current, prior, may_have_laws && is_left)?;
            let mut missing = self.missing(&candidates, &current);
            if may_have_laws && !is_left && missing.is_some() {
                candidates = self.candidates(&current, prior, true)?;
                missing = self.missing(&candidates, &current);
            }
            if first.is_empty() {
                first.clone_from(&candidates);
            }
            let Some((best, ln_odds)) = missing else {
                last = candidates;
                break;
            };
            report(&format!(
                "{} is missing: log odds {ln_odds:+.1}, more than {:+.1} needed",
                best.effect.id(),
                stated_ln_odds()
            ));
            current = self.without_needless(best.fitted, prior);
        }
        // An alternative to one of the first effects may become better only after the later ones were added, and a later effect may have made
        // an earlier one needless.
        let mut members = self.members(&current, first, prior)?;
        let mut visited = vec![current.layout.clone()];
        while let Some(better) = self.better(&current, &members) {
            // Held-out runs may prefer three models in a circle.
            if visited.iter().any(|known| known.has_effects_of(&better.layout)) {
                break;
            }
            visited.push(better.layout.clone());
            current = better;
            members = self.members(&current, first, prior)?;
        }
        members.iter_mut().for_each(|member| member.keep_own(&current, prior));
        Ok(Set { fitted: current, members, last })
    }

    /// The model, if it has laws and leaves a significant misfit of the training runs and of the held-out data. The laws then describe only
    /// a part of what is missing: the true model is none of those that were compared, so that their probabilities are not informative. An
    /// effect of the catalogue is also supported by its physics, a law only by its fit.
    fn described(&self, current: &Fitted) -> Result<Option<Fitted>, FitError> {
        let effects = current.layout.effects.iter().skip(current.layout.given);
        if !effects.clone().any(|effect| effect.is_unnamed()) {
            return Ok(None);
        }
        let adequacy = Adequacy::of(current, self.runs, self.patterns)?;
        let is_left = !adequacy.is_adequate() && !self.judge.is_chance(current);
        Ok(is_left.then(|| current.clone()))
    }

    /// The model without its laws, fitted again.
    fn without_laws(&self, fitted: &Fitted) -> Fitted {
        let mut current = fitted.clone();
        for index in (current.layout.given..current.layout.effects.len()).rev() {
            if current.layout.effects[index].is_unnamed()
                && let Some(less) = self.refitted_without(&current, index)
            {
                current = less;
            }
        }
        current
    }

    /// The most probable missing effect, and the log odds that any effect is missing; `None` if these are too low for a statement.
    fn missing(&self, candidates: &[Candidate], base: &Fitted) -> Option<(Explanation, f64)> {
        let explanations = explanations_of(candidates);
        let ln_odds = ln_sum(explanations.iter().map(|one| one.ln_odds));
        let best = explanations.into_iter().next()?;
        // With the sizes of the discrepancy in the fit with the effect, the model without the effect may fit better than before.
        let again = self.fit(&base.layout, base.values(), &best.fitted.sizes, MAX_ROUNDS);
        let better = again.map_or(0.0, |again| (again.log_evidence - base.log_evidence).max(0.0));
        let ln_odds = ln_odds - better;
        (ln_odds > stated_ln_odds()).then_some((best, ln_odds))
    }

    /// Whether a candidate can be what is missing beside a fit.
    fn is_possible(&self, candidate: &Candidate, base: &Fitted) -> bool {
        let Some((fitted, _)) = &candidate.refit else { return false };
        let kinds = candidate.score.effect.info().observable_in;
        candidate.ln_odds > NO_WEIGHT
            && is_determined(fitted, fitted.layout.effects.len() - 1)
            && self.judge.held_out_shrinks_in(base, fitted, kinds)
    }

    /// The model without the first of the earlier effects that the last one has made improbable; unchanged if there is none.
    fn without_needless(&self, fitted: Fitted, prior: &ModelPrior) -> Fitted {
        let count = fitted.layout.effects.len();
        for index in fitted.layout.given..count.saturating_sub(1) {
            if let Some(less) = self.refitted_without(&fitted, index)
                && prior.ln_weight(&fitted) - prior.ln_weight(&less) < stated_ln_odds()
            {
                return less;
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

    /// For every effect that was added, what else may be in its place.
    fn members(
        &self,
        fitted: &Fitted,
        first: &[Candidate],
        prior: &ModelPrior,
    ) -> Result<Vec<Member>, FitError> {
        let given = fitted.layout.given;
        let count = fitted.layout.effects.len();
        let mut members = Vec::new();
        for index in given..count {
            let effect = fitted.layout.effects[index];
            let (base, candidates) = if count == given + 1 {
                (self.start.clone(), first.to_vec())
            } else {
                let Some(base) = self.refitted_without(fitted, index) else { continue };
                let candidates = self.candidates(&base, prior, effect.is_unnamed())?;
                (base, candidates)
            };
            let ln_odds = prior.ln_weight(fitted) - prior.ln_weight(&base);
            let gain = ln_odds - prior.ln_odds(effect);
            let mut explanations = vec![Explanation { effect, fitted: fitted.clone(), ln_odds }];
            let candidate_explanations = explanations_of(&candidates);
            explanations
                .extend(candidate_explanations.into_iter().filter(|other| other.effect.id() != effect.id()));
            let judged = self.by_held_out(explanations.iter().map(|one| Some((one.ln_odds, &one.fitted))));
            explanations.iter_mut().zip(&judged).for_each(|(one, judged)| one.ln_odds = judged.ln_odds);
            let unrefuted = explanations.into_iter().zip(judged).filter(|(_, judged)| !judged.is_refuted);
            let explanations = self.distinct(unrefuted.map(|(one, _)| one).collect());
            let weights: Vec<f64> = explanations.iter().map(|one| one.ln_odds).collect();
            let class = explanations.into_iter().take(smallest_set(&weights)).collect();
            members.push(Member {
                index,
                gain,
                ln_odds: ln_sum(weights.iter().copied()),
                without: base,
                class,
                is_needless_elsewhere: false,
            });
        }
        Ok(members)
    }

    /// A likelier model with another effect in the place of a member, or without one that is no longer likely.
    fn better(&self, current: &Fitted, members: &[Member]) -> Option<Fitted> {
        let in_place = members.iter().find_map(|member| {
            let best = member.class.first()?;
            let own = current.layout.effects.get(member.index)?;
            // The exchange must reduce the held-out misfit, unless the present effect is not in its own class: it is then refuted, is a law
            // that predicts the same as another explanation, or is one of the improbable explanations that the class omits.
            let is_explanation = member.class.iter().any(|one| one.effect.id() == own.id());
            let is_better = best.effect.id() != own.id()
                && (!is_explanation || self.judge.held_out_shrinks(current, &best.fitted));
            is_better.then(|| best.fitted.clone())
        });
        in_place.or_else(|| {
            let least = members
                .iter()
                .filter(|member| member.ln_odds < stated_ln_odds() || !is_determined(current, member.index))
                .min_by(|a, b| a.ln_odds.total_cmp(&b.ln_odds))?;
            self.refitted_without(current, least.index)
        })
    }
}

/// The candidates that can be what is missing, likeliest first.
fn explanations_of(candidates: &[Candidate]) -> Vec<Explanation> {
    candidates
        .iter()
        .filter(|candidate| candidate.standing == Standing::Possible)
        .filter_map(|candidate| {
            let (fitted, _) = candidate.refit.clone()?;
            Some(Explanation { effect: candidate.score.effect, fitted, ln_odds: candidate.ln_odds })
        })
        .collect()
}
