//! Probabilities of models and of what is held out.
//!
//! A model's weight is its evidence times its prior. Under a model that lacks nothing the Bayes factor of any effect has mean 1 whatever the
//! noise is, so that by Markov's inequality the effects of prior odds `q` together reach posterior odds `r` in at most a fraction `q / r` of
//! data sets.

use statrs::distribution::{ContinuousCDF, StudentsT};

/// Probability from which on something is said to be so: a name is one where the effect is missing with this probability, and a class
/// holds the smallest set of explanations with it.
pub const STATED_PROBABILITY: f64 = 0.95;
/// A model whose weight is a smaller share of the largest than `exp` of this shows in no digit of an interval: 6e-6.
pub const NO_WEIGHT: f64 = -12.0;

/// Logarithm of the odds at [`STATED_PROBABILITY`].
pub fn stated_ln_odds() -> f64 {
    (STATED_PROBABILITY / (1.0 - STATED_PROBABILITY)).ln()
}

/// Squared distance, in standard deviations of the noise, of predictions that no run tells apart: it gives odds of `exp` of its half,
/// which would have to be those of [`STATED_PROBABILITY`].
pub fn indistinct() -> f64 {
    2.0 * stated_ln_odds()
}

/// Squared distance, in standard deviations of the noise, of predictions that are the same: the evidence of the two differs by less than the
/// probability that is not stated.
pub fn same() -> f64 {
    -2.0 * STATED_PROBABILITY.ln()
}

/// `ln sum exp`; minus infinity of nothing.
pub fn ln_sum(ln_weights: impl Iterator<Item = f64> + Clone) -> f64 {
    let largest = ln_weights.clone().fold(f64::NEG_INFINITY, f64::max);
    if largest.is_finite() {
        largest + ln_weights.map(|ln| (ln - largest).exp()).sum::<f64>().ln()
    } else {
        largest
    }
}

/// Count of the first of these weights, largest first, that have [`STATED_PROBABILITY`] together.
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

/// Lowers the weights of models that were refused for other reasons than their weight: all of them together are no more likely than the
/// model that was taken, whose weight is `taken`.
pub fn limit_refused<'a>(ln_weights: impl Iterator<Item = &'a mut f64>, taken: f64) {
    let mut refused: Vec<&mut f64> = ln_weights.filter(|ln| **ln > taken).collect();
    let even = taken - (refused.len().max(1) as f64).ln();
    refused.iter_mut().for_each(|ln| **ln = even);
}

/// Whether one model predicts what was held out worse than another beyond chance, by its losses part by part: the mean difference is above
/// 0 with the stated probability, by Student's t over the parts, whatever correlates the readings within one (Vuong, "Likelihood ratio
/// tests for model selection and non-nested hypotheses", Econometrica 57:307, 1989). Models that no run tells apart do not refute each other.
pub fn is_refuted(losses: &[f64], by: &[f64]) -> bool {
    let differences: Vec<f64> = losses.iter().zip(by).map(|(worse, better)| worse - better).collect();
    let count = differences.len() as f64;
    let sum: f64 = differences.iter().sum();
    let Ok(student) = StudentsT::new(0.0, 1.0, count - 1.0) else { return false };
    let squares: f64 = differences.iter().map(|one| (one - sum / count).powi(2)).sum();
    let sd_of_sum = (squares * count / (count - 1.0)).sqrt();
    sum > indistinct() && sum > student.inverse_cdf(STATED_PROBABILITY) * sd_of_sum
}

/// Logarithm of what a p-value of data that were not fitted is worth as a Bayes factor: the calibrator `(1 - p + p ln p) / (p ln^2 p)`, whose
/// mean without an effect is 1, so that it multiplies odds and Markov's bound stays (Vovk and Wang, "E-values: calibration, combination and
/// applications", Ann. Stat. 49:1736, 2021).
pub fn ln_e_value(p: f64) -> f64 {
    let p = p.clamp(f64::MIN_POSITIVE, 1.0);
    let ln = p.ln();
    // Both vanish at 1, where the quotient is a half.
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
        // A single part tells nothing of chance.
        assert!(!is_refuted(&[90.0], &[20.0]) && !is_refuted(&[], &[]));
    }

    #[test]
    fn a_calibrated_p_value_has_a_mean_of_one() {
        // Over uniform p, on a grid in their logarithms.
        let step = 1e-3;
        let mean: f64 = (0..60_000)
            .map(|i| step * (f64::from(i) + 0.5))
            .map(|u| (ln_e_value((-u).exp()) - u).exp() * step)
            .sum();
        // Behind the grid are less than one in sixty.
        assert!((0.97..1.0).contains(&mean), "{mean}");
        assert!((ln_e_value(0.9989) - ln_e_value(0.9991)).abs() < 1e-3);
    }

    #[test]
    fn refused_models_together_are_as_likely_as_the_one_taken() {
        let mut weights = [3.0, 5.0, -1.0];
        limit_refused(weights.iter_mut(), 1.0);
        assert!((weights[0].exp() + weights[1].exp() - 1f64.exp()).abs() < 1e-12);
        assert_eq!(weights[2], -1.0);
    }
}
