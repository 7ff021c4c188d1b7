//! Errors of a measured shape by rounding.
//!
//! Pixels round deflections to whole steps q. If the noise is much larger than a step, the rounding errors of the points are
//! independent and part of the scatter. With less noise, of standard deviation s, points of the same deflection u have a common
//! error: the mean of their readings is biased by the harmonics of a sawtooth that the noise has smoothed, `(q / pi k) exp(-2
//! pi^2 k^2 s^2 / q^2) sin(2 pi k u / q + phase)` (Widrow and Kollar, Quantization Noise, 2008). Along a bent needle this bias
//! averages out. Along a straight needle it does not, however many points there are: near zero the needle then seems to lag
//! behind guide 2, as with a clearance.

use super::data::{Run, Source};
use super::noise::Noise;
use super::predicted::predicted;
use mechanics::{Model, ModelError, predict};
use std::f64::consts::{PI, TAU};

/// Number of harmonics of the sawtooth.
const HARMONICS: usize = 3;
/// Smallest variance of a harmonic, relative to that of the scatter, that is included.
const MIN_SHARE: f64 = 1e-3;

/// Amplitude of a harmonic of the error that points of the same deflection share, from the rounding step and the variance of the scatter.
fn amplitude_m(harmonic: usize, step_m: f64, scatter_m2: f64) -> f64 {
    let k = harmonic as f64;
    let noise_m2 = (scatter_m2 - step_m * step_m / 12.0).max(0.0);
    step_m / (PI * k) * (-2.0 * (PI * k).powi(2) * noise_m2 / (step_m * step_m)).exp()
}

/// Patterns of the rounding errors of a run's shape, each for one standard deviation: sines and cosines of the predicted deflections in
/// each plane. Empty if noise hides the rounding.
///
/// # Errors
/// Where the model cannot be evaluated.
pub(super) fn patterns(run: &Run, noise: &Noise, model: &Model) -> Result<Vec<Vec<f64>>, ModelError> {
    let scatter_m2 = noise.shape.white + noise.shape.correlated;
    let errors = (0..2).flat_map(|plane| (1..=HARMONICS).map(move |harmonic| (plane, harmonic)));
    let sized = errors.filter_map(|(plane, harmonic)| {
        let step_m = run.shape_step_m[plane];
        let sd_m = if step_m > 0.0 { amplitude_m(harmonic, step_m, scatter_m2) / 2f64.sqrt() } else { 0.0 };
        (sd_m * sd_m > MIN_SHARE * scatter_m2).then_some((plane, sd_m, TAU * harmonic as f64 / step_m))
    });
    let sized: Vec<(usize, f64, f64)> = sized.collect();
    if sized.is_empty() {
        return Ok(Vec::new());
    }
    let expected = predicted(run, &predict(model, &run.experiment)?);
    let mut patterns = Vec::with_capacity(2 * sized.len());
    for (plane, sd_m, per_m) in sized {
        for wave in [f64::sin, f64::cos] {
            let values = run.data.iter().zip(&expected).map(|(datum, expected_m)| match datum.source {
                Source::Shape(_) if datum.channel.plane() == plane => sd_m * wave(per_m * expected_m),
                _ => 0.0,
            });
            patterns.push(values.collect());
        }
    }
    Ok(patterns)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    fn normal(random: &mut ChaCha8Rng) -> f64 {
        StandardNormal.sample(random)
    }

    #[test]
    fn the_mean_of_rounded_readings_is_off_by_as_much_as_stated() {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let step_m = 50e-6;
        for noise_m in [8e-6, 12e-6, 16e-6] {
            let quarter_m = 0.25 * step_m;
            let readings: Vec<f64> = (0..200_000)
                .map(|_| ((quarter_m + noise_m * normal(&mut random)) / step_m).round() * step_m)
                .collect();
            let mean_m = readings.iter().sum::<f64>() / readings.len() as f64;
            // Averaged over all phases the scatter is the sum of noise and rounding.
            let stated_m = amplitude_m(1, step_m, noise_m * noise_m + step_m * step_m / 12.0);
            assert!(
                ((quarter_m - mean_m) / stated_m - 1.0).abs() < 0.06,
                "{} {stated_m}",
                quarter_m - mean_m
            );
        }
        assert!(amplitude_m(1, step_m, 40e-6 * 40e-6) < 1e-3 * step_m);
    }
}
