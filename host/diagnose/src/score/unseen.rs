//! Posterior of effects that are not in the model and that no run has shown so far.

use super::directions::Hypothesis;
use super::{Scores, mean_of_exponentials};
use mechanics::effects::Effect;

/// One amplitude, at one place, of an effect that is not in the model.
#[derive(Debug, Clone)]
pub(crate) struct Unseen {
    pub effect: &'static dyn Effect,
    /// Posterior variance of the amplitude.
    pub variance: f64,
    /// Log evidence of the effect over the model without it, less the logarithm of the number of its amplitudes and places, so
    /// that together these have the evidence of the effect.
    pub log_evidence: f64,
}

impl Scores {
    /// Every amplitude of every hypothesis.
    pub fn unseen(&self) -> Vec<Unseen> {
        let of_effect = |(effect, hypotheses): &(&'static dyn Effect, Vec<Hypothesis>)| {
            let count: usize = hypotheses.iter().map(|hypothesis| hypothesis.columns.len()).sum();
            let evidences = hypotheses.iter().map(|hypothesis| {
                Self::log_evidence(hypothesis, self.prepared(hypothesis).as_ref(), &self.along)
            });
            let log_evidence = mean_of_exponentials(evidences) - (count.max(1) as f64).ln();
            hypotheses
                .iter()
                .flat_map(|hypothesis| {
                    let columns = hypothesis.columns.iter().zip(&hypothesis.precisions);
                    columns
                        .map(|(column, precision)| Unseen {
                            effect: *effect,
                            variance: 1.0 / (self.gram[(*column, *column)].max(0.0) + precision),
                            log_evidence,
                        })
                        .collect::<Vec<_>>()
                })
                .collect::<Vec<_>>()
        };
        self.hypotheses.iter().flat_map(of_effect).collect()
    }
}
