//! Rivals of a law: alternative explanations of the same data.
//!
//! A law is removed and replaced by others. The held-out runs compare the two explanations with each other, not each of them
//! with the model without both: if both predict far better than the model without, either may have the smaller p-value by chance.

use super::bench::Law;
use super::fit::Fitted;
use super::model::Error;
use super::search::{Member, Search};
use super::weights::{NO_WEIGHT, ln_e_value, ln_sum};

impl Search<'_> {
    /// Logarithm of the odds of one model over another; the models need not be nested. The odds are the ratio of their weights, times the
    /// e-value of the held-out runs for the model that predicts better.
    pub(super) fn ln_lead(&self, one: &Fitted, other: &Fitted) -> Result<f64, Error> {
        let for_one = self.judge(other, one)?.map_or(0.0, |judgement| ln_e_value(judgement.p).max(0.0));
        let for_other = self.judge(one, other)?.map_or(0.0, |judgement| ln_e_value(judgement.p).max(0.0));
        let by_runs = for_one - for_other;
        Ok(self.ln_weight(one) - self.ln_weight(other) + by_runs)
    }

    /// Odds, probability and rivals of a law of a model: the law is removed and replaced by others.
    pub(super) fn member(&self, current: &Fitted, member: usize) -> Result<Member, Error> {
        (self.on_step)(&format!("weighing law {} of {}", member + 1, current.laws.len()));
        let smaller = self.without(current, member)?;
        let standing = self.standing(&smaller, current)?;
        let mut rivals = Vec::new();
        // A pair of laws may be one explanation: for example, an offset and an asymmetry in place of a square.
        let singles = self.extensions(&smaller, false)?;
        for rival in singles.into_iter().chain(self.extensions(&smaller, true)?) {
            let added = rival.laws.get(smaller.laws.len()..).unwrap_or(&[]);
            if added.iter().any(|one| current.laws.get(member).is_some_and(|law| one.is_like(law))) {
                continue;
            }
            let ln_lead = self.ln_lead(&rival, current)?;
            if ln_lead > NO_WEIGHT && self.is_rival(&smaller, current, &rival)? {
                rivals.push((rival, standing.ln_odds + ln_lead));
            }
        }
        rivals.sort_by(|a, b| b.1.total_cmp(&a.1));
        let ln_odds: Vec<f64> = rivals.iter().map(|(_, ln)| *ln).collect();
        let total = ln_sum(ln_odds.into_iter().chain([standing.ln_odds, 0.0]));
        let rivals = rivals.into_iter().map(|(rival, ln)| (rival, (ln - total).exp())).collect();
        let (ln_odds, judgement) = (standing.ln_odds, standing.judgement);
        let probability = (ln_odds - total).exp();
        Ok(Member { ln_odds, probability, rivals, judgement })
    }

    /// Whether a model is an alternative to `current`: held-out runs do not refuse it, and the law of `current` is no longer missing in
    /// it. If the law is still missing, the two explain different parts of the misfit and are not rivals.
    fn is_rival(&self, smaller: &Fitted, current: &Fitted, rival: &Fitted) -> Result<bool, Error> {
        if self.standing(smaller, rival)?.judgement.is_some_and(|one| !one.is_confirmed()) {
            return Ok(false);
        }
        let added = rival.laws.get(smaller.laws.len()..).unwrap_or(&[]);
        let laws: Vec<Law> = current.laws.iter().chain(added).cloned().collect();
        let mut start = current.start();
        start.values.extend(rival.values.iter().skip(smaller.values.len()));
        match Fitted::new(self.bench, self.basis, &laws, &start) {
            Ok(both) => Ok(self.standing(rival, &both)?.refusal().is_some()),
            // The data cannot separate the two, or the model has no prediction with both.
            Err(Error::Undetermined(_)) => Ok(true),
            Err(error) if error.is_of_these_values() => Ok(true),
            Err(error) => Err(error),
        }
    }
}
