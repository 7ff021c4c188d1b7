//! The motion of guide 2 between two holds, of readings that have noise.
//!
//! The model is driven by the position of guide 2, not by its sensor's reading: taken as true, white noise of the
//! readings makes a force that follows them late fit better than one that follows at once, because a delay averages
//! them. So the course is an unknown of its own: its second differences are normal with a size that the readings
//! determine by their marginal likelihood, and the readings are normal about it. Its begin and end are free: guide 2
//! starts and stops as abruptly as its actuator can. A sensor without noise is followed exactly.
//!
//! Whittaker, "On a new method of graduation" (1923); Wahba, "A comparison of GCV and GML for choosing the smoothing parameter" (1985).

use nalgebra::{DMatrix, DVector};

/// Sizes of the second differences, in standard deviations of the readings: from a straight line to twice the largest that was read.
const SIZES: i32 = 24;
const SMALLEST: f64 = 1e-3;
/// Noise is nothing beside second differences of so many of its standard deviations.
const NO_NOISE: f64 = 1e3;

/// A course, and the share of the variance of a reading that is left in every place of it.
pub(super) struct Course {
    pub places_m: Vec<f64>,
    pub left: Vec<f64>,
}

/// The course of equally spaced readings of this standard deviation.
pub(super) fn course(readings_m: &[f64], sd_m: f64) -> Course {
    let as_read = || Course { places_m: readings_m.to_vec(), left: vec![1.0; readings_m.len()] };
    let count = readings_m.len();
    // The first and the last second difference are those of starting and stopping.
    let Some(inner) = count.checked_sub(4).filter(|inner| *inner > 0 && sd_m > 0.0) else { return as_read() };
    let second = DMatrix::from_fn(inner, count, |i, j| match j.checked_sub(i + 1) {
        Some(0 | 2) => 1.0,
        Some(1) => -2.0,
        _ => 0.0,
    });
    let read = DVector::from_iterator(count, readings_m.iter().map(|m| m / sd_m));
    let largest = (&second * &read).amax();
    if largest > NO_NOISE {
        return as_read();
    }
    let step = (2.0 * largest.max(1.0) / SMALLEST).powf(1.0 / f64::from(SIZES - 1));
    let penalty = second.transpose() * &second;
    // The size with the largest marginal likelihood, integrated over the course.
    let fit = |size: f64| {
        let normal = &penalty / (size * size) + DMatrix::identity(count, count);
        let factor = normal.cholesky()?;
        let solution = factor.solve(&read);
        let half_ln_determinant: f64 = factor.l_dirty().diagonal().iter().map(|value| value.ln()).sum();
        let ln_likelihood =
            -0.5 * (read.dot(&read) - solution.dot(&read)) - half_ln_determinant - inner as f64 * size.ln();
        Some((ln_likelihood, solution, factor))
    };
    let sizes = (0..SIZES).map(|number| SMALLEST * step.powi(number));
    let best = sizes.filter_map(fit).max_by(|a, b| a.0.total_cmp(&b.0));
    let Some((_, smoothed, factor)) = best else { return as_read() };
    Course {
        places_m: smoothed.iter().map(|value| sd_m * value).collect(),
        left: factor.inverse().diagonal().iter().copied().collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use noise::Noise;

    /// A ramp that begins and ends in the middle of a cell.
    fn ramp(count: usize) -> Vec<f64> {
        (0..count).map(|i| 1e-3 * ((i as f64 + 0.5) / count as f64).clamp(0.0, 1.0)).collect()
    }

    #[test]
    fn noise_is_taken_off_as_far_as_stated_and_motion_is_not() {
        let truth = ramp(30);
        let mut random = Noise::new(7);
        let (mut squares, mut stated, mut of_readings) = (0.0, 0.0, 0.0);
        let sd_m = 0.05e-3;
        for _ in 0..200 {
            let readings: Vec<f64> = truth.iter().map(|m| m + sd_m * random.normal()).collect();
            let smoothed = course(&readings, sd_m);
            for (((smoothed, left), truth), read) in
                smoothed.places_m.iter().zip(&smoothed.left).zip(&truth).zip(&readings)
            {
                squares += (smoothed - truth).powi(2);
                stated += left * sd_m * sd_m;
                of_readings += (read - truth).powi(2);
            }
        }
        assert!(squares < 0.3 * of_readings, "{}", squares / of_readings);
        assert!((0.6..1.5).contains(&(squares / stated)), "{}", squares / stated);
    }

    #[test]
    fn a_sensor_without_noise_is_followed() {
        let truth = ramp(12);
        let smoothed = course(&truth, 1e-9);
        assert!(
            smoothed.places_m.iter().zip(&truth).all(|(a, b)| (a - b).abs() < 2e-9),
            "{:?}",
            smoothed.places_m
        );
        assert_eq!(course(&truth, 0.0).places_m, truth);
    }
}
