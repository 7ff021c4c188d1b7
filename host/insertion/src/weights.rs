//! Weights of a finite set of draws that stand for a posterior.

/// Draws that have to count, at least, for their spread to be that of a posterior and not of the drawing.
const MIN_EFFECTIVE: f64 = 6.0;
/// Halvings of the bracket of an exponent.
const BISECTIONS: usize = 40;

/// Effective number of draws for these logarithms of weights, `(sum w)^2 / sum w^2` (Kish), if all are raised to a
/// power.
fn effective(ln_weights: &[f64], power: f64) -> f64 {
    let most = ln_weights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let (mut sum, mut squares) = (0.0, 0.0);
    for ln in ln_weights.iter().filter(|ln| ln.is_finite()) {
        let weight = (power * (ln - most)).exp();
        sum += weight;
        squares += weight * weight;
    }
    if squares > 0.0 { sum * sum / squares } else { 0.0 }
}

/// The power, at most 1, to which weights have to be raised so that at least six of the draws count; all of them where there are fewer.
///
/// Draws that are made for one set of recordings collapse onto a single one where another recording is far from what any of them
/// explains: its value would then appear as certain as nothing is. A likelihood to a power below 1 is what a model that is not exact
/// supports (Bissiri, Holmes and Walker 2016), and leaves the spread of the draws.
pub(super) fn tempering(ln_weights: &[f64]) -> f64 {
    let finite = ln_weights.iter().filter(|ln| ln.is_finite()).count() as f64;
    let least = MIN_EFFECTIVE.min(0.9 * finite);
    if effective(ln_weights, 1.0) >= least {
        return 1.0;
    }
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (low + high);
        if effective(ln_weights, middle) >= least { low = middle } else { high = middle }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_that_are_spread_stay_and_collapsed_ones_leave_six() {
        let even = [0.0; 20];
        assert_eq!((effective(&even, 1.0).round(), tempering(&even)), (20.0, 1.0));
        let collapsed: Vec<f64> = (0..40).map(|i| -15.0 * f64::from(i)).collect();
        assert!(effective(&collapsed, 1.0) < 1.01);
        let power = tempering(&collapsed);
        assert!(power < 0.1 && (effective(&collapsed, power) - MIN_EFFECTIVE).abs() < 1e-3, "{power}");
        // Fewer than six cannot be six, and what is no number is no draw.
        let few = [0.0, -100.0, f64::NEG_INFINITY];
        assert!((effective(&few, tempering(&few)) - 1.8).abs() < 1e-3);
    }
}
