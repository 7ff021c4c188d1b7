//! Values of several hypotheses as one: what they differ by is in the intervals.

use estimator::{Estimate, Identifiability, Value};
use formats::NORMAL_975;

/// Weights that sum to 1 from logarithms.
pub(super) fn weights(logs: &[f64]) -> Vec<f64> {
    let most = logs.iter().copied().filter(|log| log.is_finite()).fold(f64::NEG_INFINITY, f64::max);
    let raw: Vec<f64> =
        logs.iter().map(|log| if log.is_finite() { (log - most).exp() } else { 0.0 }).collect();
    let total: f64 = raw.iter().sum();
    let even = 1.0 / logs.len().max(1) as f64;
    raw.into_iter().map(|weight| if total > 0.0 { weight / total } else { even }).collect()
}

/// Estimates as one; what is simulated is that of the most probable.
pub(super) fn mixed(estimates: &[Estimate<f64>], weights: &[f64]) -> Option<Estimate<f64>> {
    let heaviest = weights.iter().zip(estimates).max_by(|a, b| a.0.total_cmp(b.0));
    let (_, first) = heaviest?;
    let stiffness: Vec<Value<f64>> = estimates.iter().map(|one| one.stiffness).collect();
    let damping: Vec<Value<f64>> = estimates.iter().map(|one| one.damping).collect();
    let sum = |of: fn(&Estimate<f64>) -> f64| estimates.iter().zip(weights).map(|(e, w)| w * of(e)).sum();
    Some(Estimate {
        stiffness: mixed_stiffness(&stiffness, weights),
        damping: mixed_damping(&damping, weights, first.damping.identifiability),
        correlation: sum(|one| one.correlation),
        ..*first
    })
}

/// Stiffness: in logarithms.
pub(super) fn mixed_stiffness(values: &[Value<f64>], weights: &[f64]) -> Value<f64> {
    let mean: f64 = values.iter().zip(weights).map(|(value, weight)| weight * value.value.ln()).sum();
    let variance: f64 = values
        .iter()
        .zip(weights)
        .map(|(value, weight)| {
            let ln_sd = 0.5 * (value.high / value.low).ln() / NORMAL_975;
            weight * (ln_sd.powi(2) + (value.value.ln() - mean).powi(2))
        })
        .sum();
    let sd = variance.sqrt();
    let factor = (NORMAL_975 * sd.min(20.0)).exp();
    let identifiability = if sd < 0.5 { Identifiability::Identified } else { Identifiability::NotIdentified };
    Value { value: mean.exp(), low: mean.exp() / factor, high: mean.exp() * factor, identifiability }
}

/// Damping, which may be nothing; `identifiability` is that of the most probable.
fn mixed_damping(values: &[Value<f64>], weights: &[f64], identifiability: Identifiability) -> Value<f64> {
    let sum = |of: &dyn Fn(&Value<f64>) -> f64| -> f64 {
        values.iter().zip(weights).map(|(value, weight)| weight * of(value)).sum()
    };
    let mean = sum(&|value| value.value);
    let lower_sd = sum(&|value| (value.value - value.low).powi(2) + squared_half_width(value, mean)).sqrt();
    let upper_sd = sum(&|value| (value.high - value.value).powi(2) + squared_half_width(value, mean)).sqrt();
    let low = (mean - lower_sd).max(0.0);
    let identifiability = if identifiability == Identifiability::Identified && low <= 0.0 {
        Identifiability::UpperBound
    } else {
        identifiability
    };
    Value { value: mean, low, high: mean + upper_sd, identifiability }
}

fn squared_half_width(value: &Value<f64>, mean: f64) -> f64 {
    (NORMAL_975 * (value.value - mean)).powi(2)
}
