//! Single readings that are far from their neighbours: interference on a cable, a bit that is wrong.
//!
//! A reading is compared with the median of its neighbours (as by Hampel), so that what changes slowly, as the force of tissue that relaxes
//! after a ramp, has none. One reading of nine standard deviations among sixty moves their mean by more than its standard error.

use super::median::median;
use crate::outliers::farthest;

/// Neighbours on either side.
const BESIDE: usize = 3;
/// Fewest readings whose distances have a standard deviation.
const MIN_READINGS: usize = 20;

/// The readings without spikes, in order.
pub fn without_spikes(values: &[f64]) -> Vec<f64> {
    if values.len() < MIN_READINGS {
        return values.to_vec();
    }
    let neighbour_medians = windows(values).map(|window| {
        let (preceding, remainder) = window.split_at(BESIDE);
        let (centre, following) = remainder.split_at(1);
        (centre.iter().sum::<f64>() - median([preceding, following].concat())).abs()
    });
    let farthest = farthest(neighbour_medians);
    // Readings that are rounded to few values have none: nothing is known of their noise.
    if farthest <= 0.0 {
        return values.to_vec();
    }
    // With the reading itself: where readings step, the ones beside the step are close to those on their side.
    let middles: Vec<f64> = windows(values).map(|window| median(window.to_vec())).collect();
    values
        .iter()
        .enumerate()
        .filter(|(at, value)| {
            let middle = at.checked_sub(BESIDE).and_then(|place| middles.get(place));
            middle.is_none_or(|middle| (*value - middle).abs() <= farthest)
        })
        .map(|(_, value)| *value)
        .collect()
}

/// The first and last ones are kept: what drifts is far from the median of neighbours on one side.
fn windows(values: &[f64]) -> std::slice::Windows<'_, f64> {
    values.windows(2 * BESIDE + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use noise::Noise;

    fn noisy(seed: u64, count: usize) -> Vec<f64> {
        let mut noise = Noise::new(seed);
        (0..count).map(|_| noise.normal()).collect()
    }

    #[test]
    fn single_readings_far_off_are_spikes_and_normal_noise_has_none() {
        let mut values = noisy(1, 60);
        assert_eq!(without_spikes(&values), values);
        let clean = values.clone();
        values.insert(20, 9.0);
        values.insert(41, -11.0);
        assert_eq!(without_spikes(&values), clean);
        let unspiked_count: usize = (2..200).map(|seed| without_spikes(&noisy(seed, 60)).len()).sum();
        assert!(198 * 60 - unspiked_count <= 3, "{} of {}", 198 * 60 - unspiked_count, 198 * 60);
    }

    #[test]
    fn what_relaxes_drifts_or_steps_has_no_spikes() {
        let noise = noisy(3, 200);
        for values in [
            with_noise(&|i| 50.0 * (-i / 10.0).exp(), &noise),
            with_noise(&|i| 0.5 * i, &noise),
            with_noise(&|i| if i < 80.0 { 0.0 } else { 30.0 }, &noise),
        ] {
            assert_eq!(without_spikes(&values), values);
        }
    }

    fn with_noise(shape: &dyn Fn(f64) -> f64, noise: &[f64]) -> Vec<f64> {
        noise.iter().enumerate().map(|(i, n)| shape(i as f64) + n).collect()
    }

    #[test]
    fn readings_that_hardly_change_and_short_series_are_left_as_they_are() {
        let mut rounded = vec![2.0; 50];
        rounded[10] = 2.5;
        assert_eq!(without_spikes(&rounded), rounded);
        assert_eq!(without_spikes(&[0.0, 0.1, 90.0]), [0.0, 0.1, 90.0]);
        assert!(without_spikes(&[]).is_empty());
    }
}
