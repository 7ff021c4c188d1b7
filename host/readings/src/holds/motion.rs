//! Distance that guide 2 has to come back before a turn is distinguished from its sensor's noise.

use super::detection::noise;
use super::median::median;
use std::ops::Range;

/// Displacements are never known better than this.
const MIN_M: f64 = 1e-6;
/// Beyond the expected span of the noise, standard deviations.
const BEYOND_SD: f64 = 1.0;

/// Standard deviation of a plane's readings with its holds: that of second differences (which vanish on ramps) or the median scatter
/// within holds (which has slow noise too), whichever is larger.
pub fn reading_sd_m(readings_m: &[f64], holds: &[Range<usize>]) -> f64 {
    noise(readings_m).max(median(
        holds
            .iter()
            .filter_map(|hold| {
                let rows = readings_m.get(hold.clone()).unwrap_or_default();
                let n = rows.len() as f64;
                let mean = rows.iter().sum::<f64>() / n;
                (n > 1.0).then(|| (rows.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt())
            })
            .collect(),
    ))
}

/// Motion back by less than this is noise of the displacement, for a plane's readings with its holds: the largest and the least of `n`
/// normal readings lie `2 sqrt(2 ln n)` standard deviations apart.
pub fn reversal_m(readings_m: &[f64], holds: &[Range<usize>]) -> f64 {
    span(reading_sd_m(readings_m, holds), readings_m.len()).max(MIN_M)
}

/// The span of `count` normal values, and a little more.
fn span(sd: f64, count: usize) -> f64 {
    sd * (2.0 * (2.0 * (count.max(2) as f64).ln()).sqrt() + BEYOND_SD)
}

/// The same for means of holds with these standard deviations.
pub fn reversal_of_means_m(sds_m: &[f64]) -> f64 {
    span(sds_m.iter().copied().fold(0.0, f64::max), sds_m.len()).max(MIN_M)
}
