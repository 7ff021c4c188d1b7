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

/// Largest number of models from which the search begins again: each costs the whole search.
const MAX_BEGINNINGS: usize = 4;

/// A model from which the search begins again.
pub(super) struct Beginning {
    pub fitted: Fitted,
    /// Logarithm of its weight.
    pub ln_weight: f64,
}

impl Search<'_> {
    /// Models from which the search may come to a likelier set than this one, likeliest first: each candidate beside the start, alone or
    /// with the best name or law beside it. An effect that imitates two others is found before each of them, and no exchange of one effect
    /// leads from it to the two. A model with a larger held-out misfit is no beginning, however well it fits the training runs.
    pub(super) fn beginnings(
        &self,
        set: &Set,
        first: &[Candidate],
        prior: &ModelPrior,
    ) -> Result<Vec<Beginning>, FitError> {
        let added: Vec<&'static dyn Effect> =
            set.fitted.layout.effects.iter().skip(set.fitted.layout.given).copied().collect();
        // Named effects are also supported by their physics: if they leave no significant misfit, no other set is tried.
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
        let begin = |fit: &&Fitted| -> Result<Option<Beginning>, FitError> {
            let alone = self.fit(&fit.layout, fit.values(), &fit.sizes, MAX_ROUNDS);
            let Some(alone) = alone.filter(|alone| !alone.at_bound.contains(&true)) else { return Ok(None) };
            let mut models = self.pairs_with(&alone)?;
            models.push(alone);
            let weighted = models.into_iter().map(|fitted| (prior.ln_weight(&fitted), fitted));
            let likelier = weighted.filter(|(_, fitted)| {
                self.is_likelier(fitted, &set.fitted, prior)
                    && self.judge.held_out_shrinks(&set.fitted, fitted)
            });
            let best = likelier.max_by(|(one, _), (other, _)| one.total_cmp(other));
            Ok(best.map(|(ln_weight, fitted)| Beginning { fitted, ln_weight }))
        };
        let beginnings: Vec<Option<Beginning>> = fits.par_iter().map(begin).collect::<Result<_, _>>()?;
        let mut beginnings: Vec<Beginning> = beginnings.into_iter().flatten().collect();
        beginnings.sort_by(|a, b| b.ln_weight.total_cmp(&a.ln_weight));
        beginnings.truncate(MAX_BEGINNINGS);
        Ok(beginnings)
    }

    /// A model with the named effect of the best score beside it, and one with the law of the best score.
    fn pairs_with(&self, fitted: &Fitted) -> Result<Vec<Fitted>, FitError> {
        let [names, laws] = self.foreseen(fitted)?;
        let best = [names.first(), laws.first()].into_iter().flatten();
        let pair = |score: &Score| match self.pair_beside(score.effect, fitted) {
            Some(pair) => pair,
            None => {
                let (pair, _) = self.refit(fitted, score)?;
                self.fit(&pair.layout, pair.values(), &pair.sizes, MAX_ROUNDS)
            }
        };
        Ok(best.filter_map(pair).collect())
    }

    /// The fit of an effect together with the last effect of a model, from the candidates beside the former; `None` if the search does not
    /// have these candidates yet, `Some(None)` if the effect of the model was not fitted among them because others were ahead.
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

    /// Whether a model is likelier than another one, by its evidence, its prior and what was held out.
    pub(super) fn is_likelier(&self, new: &Fitted, known: &Fitted, prior: &ModelPrior) -> bool {
        let start = prior.ln_weight(self.start);
        let judged = self.by_held_out(
            [known, new].into_iter().map(|fitted| Some((prior.ln_weight(fitted) - start, fitted))),
        );
        let [old_odds, new_odds] = judged.as_slice() else { return false };
        !new_odds.is_refuted && (old_odds.is_refuted || new_odds.ln_odds > old_odds.ln_odds)
    }
}
