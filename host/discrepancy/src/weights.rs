//! Probabilities of models, and tests on held-out data.
//!
//! A model's weight is its evidence times its prior. If the model is complete, the Bayes factor of any effect has mean 1,
//! whatever the noise. By Markov's inequality, effects with prior odds `q` in total then reach posterior odds `r` in at most a
//! fraction `q / r` of data sets.

use statrs::distribution::{ContinuousCDF, StudentsT};

/// Smallest probability at which a statement is made: that an effect is missing, or that one member of a class is, which is the
/// smallest set of explanations with this probability.
pub const STATED_PROBABILITY: f64 = 0.95;
/// Logarithm of the weight, relative to the largest one, below which a model is ignored: 6e-6 changes no printed digit of an interval.
pub const NO_WEIGHT: f64 = -12.0;

/// Logarithm of the odds at [`STATED_PROBABILITY`].
pub fn stated_ln_odds() -> f64 {
    (STATED_PROBABILITY / (1.0 - STATED_PROBABILITY)).ln()
}

/// Squared distance of two predictions, in variances of the noise, below which the data cannot distinguish them: the log odds
/// between them are half of the squared distance, and would have to reach those of [`STATED_PROBABILITY`].
pub fn indistinct() -> f64 {
    2.0 * stated_ln_odds()
}

/// Squared distance of two predictions, in variances of the noise, below which they count as equal: the likelihood ratio between
/// them is above [`STATED_PROBABILITY`].
pub fn same() -> f64 {
    -2.0 * STATED_PROBABILITY.ln()
}

/// `ln sum exp`; minus infinity for an empty list.
pub fn ln_sum(ln_weights: impl Iterator<Item = f64> + Clone) -> f64 {
    let largest = ln_weights.clone().fold(f64::NEG_INFINITY, f64::max);
    if largest.is_finite() {
        largest + ln_weights.map(|ln| (ln - largest).exp()).sum::<f64>().ln()
    } else {
        largest
    }
}

/// Number of the largest weights that together have [`STATED_PROBABILITY`]; the weights are in descending order.
pub fn smallest_set(ln_weights: &[f64]) -> usize {
    let total = ln_sum(ln_weights.iter().copied());
    let mut sum = 0.0;
    ln_weights
        .iter()
        .position(|ln| {
            sum += (ln - total).exp();
            sum >= STATED_PROBABILITY
        })
        .map_or(ln_weights.len(), |last| last + 1)
}

/// Lowers the weights of models that were refused for other reasons than their weight, so that together they are no more probable than the
/// weight `taken`. The largest weights become equal, and smaller ones stay as they are: every model is lowered as little as possible, and no
/// weight changes by a step when another one passes the limit.
pub fn limit_refused<'a>(ln_weights: impl Iterator<Item = &'a mut f64>, taken: f64) {
    let mut refused: Vec<&mut f64> = ln_weights.collect();
    refused.sort_by(|a, b| a.total_cmp(b));
    // The fraction of `taken` that smaller weights leave to the others.
    let mut remaining = 1.0;
    for index in 0..refused.len() {
        let equal = remaining / (refused.len() - index) as f64;
        let weight = (*refused[index] - taken).exp();
        if weight > equal {
            refused.iter_mut().skip(index).for_each(|ln| **ln = taken + equal.ln());
            return;
        }
        remaining -= weight;
    }
}

/// Whether one model predicts held-out data significantly worse than another. Student's t test over the parts of the data
/// decides whether the mean difference of the losses is above 0 with the stated probability, so that correlations within a part
/// do not matter (Vuong, "Likelihood ratio tests for model selection and non-nested hypotheses", Econometrica 57:307, 1989).
/// A total difference below [`indistinct`] refutes no model.
pub fn is_refuted(losses: &[f64], by: &[f64]) -> bool {
    let differences: Vec<f64> = losses.iter().zip(by).map(|(worse, better)| worse - better).collect();
    let count = differences.len() as f64;
    let sum: f64 = differences.iter().sum();
    let Ok(student) = StudentsT::new(0.0, 1.0, count - 1.0) else { return false };
    let squares: f64 = differences.iter().map(|one| (one - sum / count).powi(2)).sum();
    let sd_of_sum = (squares * count / (count - 1.0)).sqrt();
    sum > indistinct() && sum > student.inverse_cdf(STATED_PROBABILITY) * sd_of_sum
}

/// Logarithm of the e-value for a p-value of held-out data: the calibrator `(1 - p + p ln p) / (p ln^2 p)`. Its mean is 1 under
/// the null hypothesis, so that it multiplies odds like a Bayes factor and Markov's bound remains valid (Vovk and Wang,
/// "E-values: calibration, combination and applications", Ann. Stat. 49:1736, 2021).
pub fn ln_e_value(p: f64) -> f64 {
    let p = p.clamp(f64::MIN_POSITIVE, 1.0);
    let ln = p.ln();
    // Numerator and denominator vanish at p = 1, where the quotient is a half.
    if p > 0.999 { -std::f64::consts::LN_2 } else { (1.0 - p + p * ln).ln() - ln - 2.0 * (-ln).ln() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_smallest_set_has_what_is_stated() {
        assert_eq!(smallest_set(&[0.0]), 1);
        assert_eq!(smallest_set(&[0.0, -4.0]), 1);
        assert_eq!(smallest_set(&[0.0, -2.0]), 2);
        assert_eq!(smallest_set(&[-700.0, -700.0, -710.0]), 2);
    }

    #[test]
    fn a_model_is_refuted_by_what_is_better_in_most_parts() {
        let [worse, better] = [[30.0, 28.0, 35.0, 31.0, 29.0], [20.0, 21.0, 19.0, 22.0, 20.0]];
        assert!(is_refuted(&worse, &better) && !is_refuted(&better, &worse));
        // Better in one part alone, or within noise.
        assert!(!is_refuted(&[90.0, 20.0, 20.0, 20.0], &[20.0, 20.0, 20.0, 20.0]));
        assert!(!is_refuted(&[21.0, 21.0, 21.1, 21.0], &[20.0, 20.0, 20.0, 20.0]));
        // From a single part no variance can be estimated.
        assert!(!is_refuted(&[90.0], &[20.0]) && !is_refuted(&[], &[]));
    }

    #[test]
    fn a_calibrated_p_value_has_a_mean_of_one() {
        // The mean over uniform p is a sum over a grid of its logarithm.
        let step = 1e-3;
        let mean: f64 = (0..60_000)
            .map(|i| step * (f64::from(i) + 0.5))
            .map(|u| (ln_e_value((-u).exp()) - u).exp() * step)
            .sum();
        // The tail beyond the grid has less than a sixtieth of the mean.
        assert!((0.97..1.0).contains(&mean), "{mean}");
        assert!((ln_e_value(0.9989) - ln_e_value(0.9991)).abs() < 1e-3);
    }

    #[test]
    fn refused_models_together_are_as_likely_as_the_one_taken() {
        let mut weights = [3.0, 5.0, -1.0];
        limit_refused(weights.iter_mut(), 1.0);
        let sum: f64 = weights.iter().map(|ln| ln.exp()).sum();
        assert!((sum - 1f64.exp()).abs() < 1e-12);
        assert_eq!((weights[0], weights[2]), (weights[1], -1.0));
    }

    #[test]
    fn refused_models_below_the_limit_cannot_exceed_it_together() {
        let mut weights = [-0.1, -0.1, -3.0];
        limit_refused(weights.iter_mut(), 0.0);
        assert!((weights.iter().map(|ln| ln.exp()).sum::<f64>() - 1.0).abs() < 1e-12, "{weights:?}");
        assert_eq!(weights[2], -3.0);
        // Models that do not exceed it together keep their weights.
        let mut unlikely = [-1.0, -1.0, f64::NEG_INFINITY];
        limit_refused(unlikely.iter_mut(), 0.0);
        assert_eq!(unlikely, [-1.0, -1.0, f64::NEG_INFINITY]);
    }

    /// A model that passes the limit changes no weight by a step.
    #[test]
    fn the_weights_of_refused_models_are_continuous() {
        let [lower, upper] = [-1e-9, 1e-9].map(|ln| {
            let mut weights = [ln; 2];
            limit_refused(weights.iter_mut(), 0.0);
            weights
        });
        assert!(
            lower.iter().zip(upper).all(|(lower, upper)| (lower - upper).abs() < 1e-6),
            "{lower:?} {upper:?}"
        );
    }
}
