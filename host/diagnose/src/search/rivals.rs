//! Comparison of rival models by held-out data, and by whether any run distinguishes them.

use super::super::found::Explanation;
use super::super::posterior::{Fitted, misfit};
use super::super::split::Losses;
use super::super::weights::{indistinct, is_refuted, ln_sum, same, stated_ln_odds};
use super::Search;

/// Judgement of a model by the held-out data.
#[derive(Debug, Clone, Copy)]
pub(super) struct Judged {
    /// Logarithm of its odds.
    pub ln_odds: f64,
    pub is_refuted: bool,
}

/// A model among others.
struct Rival<'a> {
    fitted: &'a Fitted,
    ln_odds: f64,
    losses: Losses,
}

fn is_refuted_beside_instruments(rival: &Rival<'_>, by: &Rival<'_>) -> bool {
    is_refuted(&rival.losses.beside_instruments, &by.losses.beside_instruments)
}

impl Search<'_> {
    /// Judges models, each with the logarithm of its odds, by the held-out data. A model is refuted by another one that could be stated
    /// alone, has no less evidence, is not refuted itself and gives the held-out data a significantly higher density. A model that only
    /// leaves a significantly larger misfit, with the errors of the instruments and differences between runs as nuisances, is not
    /// refuted, because other imperfections of an ordinary rig may be the cause; the evidence takes these into account. But the model
    /// loses any advantage of its prior over that of the other model, so that the evidence decides. Two models that no run distinguishes
    /// do not affect each other, whatever sizes of the discrepancy their fits have.
    pub(super) fn by_held_out<'f>(
        &self,
        models: impl Iterator<Item = Option<(f64, &'f Fitted)>>,
    ) -> Vec<Judged> {
        let rivals: Vec<Option<Rival<'f>>> = models
            .map(|model| {
                let (ln_odds, fitted) = model?;
                Some(Rival { fitted, ln_odds, losses: self.judge.losses(fitted)? })
            })
            .collect();
        let mut judged = vec![Judged { ln_odds: f64::NEG_INFINITY, is_refuted: false }; rivals.len()];
        let mut by_evidence: Vec<(usize, &Rival<'f>)> =
            rivals.iter().enumerate().filter_map(|(index, rival)| Some((index, rival.as_ref()?))).collect();
        by_evidence.sort_by(|(_, a), (_, b)| b.fitted.log_evidence.total_cmp(&a.fitted.log_evidence));
        let mut stated: Vec<(f64, &Rival<'f>)> = Vec::new();
        for (index, rival) in by_evidence {
            let is_other =
                |(_, by): &&(f64, &Rival<'f>)| !self.is_near(rival.fitted, by.fitted, indistinct());
            let is_refuted = stated
                .iter()
                .filter(|(_, by)| is_refuted(&rival.losses.of_density, &by.losses.of_density))
                .any(|by| is_other(&by));
            let without_prior = stated
                .iter()
                .filter(|(_, by)| is_refuted_beside_instruments(rival, by))
                .filter(is_other)
                .map(|(ln_odds, by)| ln_odds + rival.fitted.log_evidence - by.fitted.log_evidence)
                .fold(rival.ln_odds, f64::min);
            judged[index] = Judged { ln_odds: without_prior, is_refuted };
            if !is_refuted && rival.ln_odds > stated_ln_odds() {
                stated.push((without_prior, rival));
            }
        }
        judged
    }

    /// Whether the squared distance of the predictions of two models for the training runs is below `least`. The metric has noise and
    /// imperfections, each with the smaller of its sizes in the two fits, and at most the size of an ordinary rig.
    fn is_near(&self, one: &Fitted, other: &Fitted, least: f64) -> bool {
        let differences: Vec<Vec<f64>> = one
            .residuals
            .iter()
            .zip(&other.residuals)
            .map(|(one, other)| one.iter().zip(other).map(|(one, other)| one - other).collect())
            .collect();
        // Imperfections can only reduce the distance in the metric of noise alone.
        if differences.iter().flatten().map(|difference| difference * difference).sum::<f64>() < least {
            return true;
        }
        let sizes: Vec<f64> = self
            .at_most_everyday(&one.sizes)
            .into_iter()
            .zip(&other.sizes)
            .map(|(size, most)| size.min(*most))
            .collect();
        misfit(self.patterns, &sizes, &differences).is_some_and(|apart| apart < least)
    }

    /// The explanations, in which a named effect or a simpler law replaces every law that predicts the same; the odds of both are added.
    pub(super) fn distinct(&self, all: Vec<Explanation>) -> Vec<Explanation> {
        let (mut explanations, mut laws): (Vec<Explanation>, Vec<Explanation>) =
            all.into_iter().partition(|one| !one.effect.is_unnamed());
        laws.sort_by(|a, b| {
            let by_odds = b.ln_odds.total_cmp(&a.ln_odds);
            a.effect.parameters().len().cmp(&b.effect.parameters().len()).then(by_odds)
        });
        for law in laws {
            // Two laws extrapolate differently. Therefore both stay in a class unless their predictions are equal, like those of a constant
            // and of a step beyond all runs.
            let is_that = |other: &&mut Explanation| {
                let least = if other.effect.is_unnamed() { same() } else { indistinct() };
                self.is_near(&other.fitted, &law.fitted, least)
            };
            match explanations.iter_mut().find(is_that) {
                Some(other) => other.ln_odds = ln_sum([other.ln_odds, law.ln_odds].into_iter()),
                None => explanations.push(law),
            }
        }
        explanations.sort_by(|a, b| b.ln_odds.total_cmp(&a.ln_odds));
        explanations
    }
}

#[cfg(test)]
mod tests {
    use crate::found_in;
    use crate::tests::truth;
    use worlds::Design;

    /// A step that begins before all runs predicts the same as the named effect, which has a second plane besides.
    #[test]
    fn a_name_is_not_refuted_by_a_law_of_the_same_predictions() {
        for seed in [1, 2, 3] {
            let hidden =
                truth(vec![("sensor.force_bias", vec![0.2, 0.0]), ("sensor.shape_scale", vec![0.2])]);
            let (_, search_result) = found_in(&worlds::session(&hidden, &Design::four_runs(), seed));
            let names: Vec<Vec<&str>> = search_result
                .members
                .iter()
                .map(|member| member.class.iter().map(|one| one.effect.id()).collect())
                .collect();
            let is_found = |id: &str| names.iter().any(|class| class.first() == Some(&id));
            assert!(is_found("sensor.force_bias") && is_found("sensor.shape_scale"), "{seed}: {names:?}");
        }
    }
}
