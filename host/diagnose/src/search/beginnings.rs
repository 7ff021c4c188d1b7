//! Other beginnings of a search. An effect that imitates two others is found before each of them, and no exchange of a single
//! effect leads from it to the two.

use super::super::adequacy::Adequacy;
use super::super::found::Candidate;
use super::super::posterior::{Fitted, MAX_ROUNDS};
use super::super::score::Score;
use super::super::weights::ModelPrior;
use super::leaders::Kind;
use super::{Search, Set};
use mechanics::effects::Effect;
use rayon::prelude::*;
use readings::FitError;
use std::sync::PoisonError;

/// Models from which the search begins again, at most: each costs the whole search.
const MAX_BEGINNINGS: usize = 4;

/// A model with one effect from which the search begins again.
pub(super) struct Beginning {
    pub fitted: Fitted,
    /// Logarithm of the weight of a set to which it may lead.
    pub promise: f64,
}

impl Search<'_> {
    /// Models with one effect from which the search may come to a likelier set than this one, most promising first. An effect that imitates
    /// two others is found before each of them, and no exchange of one effect leads from it to the two. A model promises what it has, with
    /// the best score beside it: that is the weight of a set of two, as far as the second is small.
    pub(super) fn beginnings(
        &self,
        set: &Set,
        first: &[Candidate],
        prior: &ModelPrior,
    ) -> Result<Vec<Beginning>, FitError> {
        let added: Vec<&'static dyn Effect> =
            set.fitted.layout.effects.iter().skip(set.fitted.layout.given).copied().collect();
        // Names have their physics besides their fit: where they leave nothing no other set is asked for.
        let has_law = added.iter().any(|effect| effect.is_unnamed());
        let is_left = || -> Result<bool, FitError> {
            let adequacy = Adequacy::of(&set.fitted, self.runs, self.patterns)?;
            Ok(!adequacy.is_adequate() || !self.judge.is_chance(&set.fitted))
        };
        if added.is_empty() || !has_law && !is_left()? {
            return Ok(Vec::new());
        }
        // The best law of a site and regressor is enough: the search exchanges its form.
        let mut kinds: Vec<Kind> = Vec::new();
        let mut is_new = |candidate: &&Candidate| {
            let kind = Kind::of(candidate.score.effect);
            let is_new = !added.iter().any(|effect| effect.id() == candidate.id()) && !kinds.contains(&kind);
            if is_new {
                kinds.push(kind);
            }
            is_new
        };
        let mut by_gain: Vec<&Candidate> = first.iter().collect();
        by_gain.sort_by(|a, b| b.gain().total_cmp(&a.gain()));
        let candidates = by_gain.into_iter().filter(|other| other.gain() > 0.0).filter(&mut is_new);
        let fits: Vec<&Fitted> =
            candidates.filter_map(|other| other.refit.as_ref().map(|(fit, _)| fit)).collect();
        let beginning = |fit: &&Fitted| -> Result<Option<Beginning>, FitError> {
            let Some(fitted) = self.fit(&fit.layout, fit.values(), &fit.sizes, MAX_ROUNDS) else {
                return Ok(None);
            };
            let promise = self.promise_of(&fitted, prior)?;
            let is_usable = !fitted.at_bound.contains(&true) && promise > prior.ln_weight(&set.fitted);
            Ok(is_usable.then_some(Beginning { fitted, promise }))
        };
        let beginnings: Vec<Option<Beginning>> = fits.par_iter().map(beginning).collect::<Result<_, _>>()?;
        let mut beginnings: Vec<Beginning> = beginnings.into_iter().flatten().collect();
        beginnings.sort_by(|a, b| b.promise.total_cmp(&a.promise));
        beginnings.truncate(MAX_BEGINNINGS);
        Ok(beginnings)
    }

    /// Logarithm of the weight of a set of two with this one: that of the best name or law beside it, as it is fitted or, which is more
    /// where the first rounds of a fit go wrong, by its score. Scores are beside discrepancy of everyday sizes at most, and a fit whose
    /// discrepancy is larger has less evidence there.
    fn promise_of(&self, fitted: &Fitted, prior: &ModelPrior) -> Result<f64, FitError> {
        let [names, laws] = self.foreseen(fitted)?;
        let sizes = self.at_most_everyday(&fitted.sizes);
        let cost = fitted.ln_cost_of_sizes(self.patterns, &sizes).ok_or(FitError::Undetermined)?;
        let alone = prior.ln_weight(fitted);
        let by_score = |score: &Score| alone + score.log_evidence + prior.ln_odds(score.effect) - cost;
        let as_fitted = |score: &Score| {
            let (pair, _) = self.refit(fitted, score)?;
            let pair = self.fit(&pair.layout, pair.values(), &pair.sizes, MAX_ROUNDS)?;
            Some(prior.ln_weight(&pair))
        };
        let promise = |score: &Score| match self.pair_beside(score.effect, fitted) {
            Some(pair) => [pair.map(|pair| prior.ln_weight(&pair)), None],
            None => [Some(by_score(score)), as_fitted(score)],
        };
        let best = [names.first(), laws.first()].into_iter().flatten();
        Ok(best.flat_map(promise).flatten().fold(alone, f64::max))
    }

    /// The pair of an effect with that of a model, where the search has asked already for what is missing beside the former; nothing in it where others were ahead.
    fn pair_beside(&self, effect: &dyn Effect, with: &Fitted) -> Option<Option<Fitted>> {
        let second = with.layout.effects.last()?;
        let mut effects: Vec<&'static str> = self.start.layout.effects.iter().map(|own| own.id()).collect();
        effects.push(effect.id());
        effects.sort_unstable();
        let memo = self.memo.lock().unwrap_or_else(PoisonError::into_inner);
        let asked = memo
            .iter()
            .filter(|asked| asked.effects == effects && (asked.with_laws || !second.is_unnamed()))
            .max_by_key(|asked| asked.with_laws)?;
        let candidate = asked.candidates.iter().find(|candidate| candidate.id() == second.id());
        Some(candidate.and_then(|candidate| candidate.refit.as_ref()).map(|(fitted, _)| fitted.clone()))
    }

    /// Whether a set is likelier than another one, by its evidence, its prior and what was held out.
    pub(super) fn is_likelier(&self, new: &Set, known: &Set, prior: &ModelPrior) -> bool {
        let start = prior.ln_weight(self.start);
        let judged = self.by_held_out(
            [known, new].into_iter().map(|set| Some((prior.ln_weight(&set.fitted) - start, &set.fitted))),
        );
        let [old_odds, new_odds] = judged.as_slice() else { return false };
        !new_odds.is_refuted && (old_odds.is_refuted || new_odds.ln_odds > old_odds.ln_odds)
    }
}
