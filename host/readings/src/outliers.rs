//! The rule for outliers, the same for readings of a series, points of a shape, points of a sweep and depths of a path.
//!
//! A value is an outlier where it is further from what its neighbours lead to expect than [`OUTLIER_SDS`] standard
//! deviations of such distances. The data determine how far a point may be from its neighbours: a median where a series
//! changes slowly, a line or a curve where the course bends, the residuals of a fit where a model is at hand. The
//! standard deviation is that of the median of the distances, to which outliers add nothing.
//!
//! Two things look alike and are others: runs that cannot belong to a session, whose misfit has no distribution that the
//! other runs would show (`identify::belong`), and residuals of a model that is not exact, which are weighted by Student's t
//! and not dropped (steering, populations).

use crate::holds::{SD_OF_MEDIAN, median};

/// Distances beyond so many standard deviations are outliers. Normal noise has one in 1.7 million, and one of this size among the readings
/// of a hold moves their mean by less than its standard error.
pub const OUTLIER_SDS: f64 = 5.0;

/// Largest size of a distance that is no outlier, of the distances of all values; NaN where there are none.
pub fn farthest(distances: impl Iterator<Item = f64>) -> f64 {
    OUTLIER_SDS * SD_OF_MEDIAN * median(distances.map(f64::abs).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use noise::Noise;

    #[test]
    fn normal_noise_has_none_and_outliers_do_not_hide_each_other() {
        for seed in 0..50 {
            let mut noise = Noise::new(seed);
            let mut values: Vec<f64> = (0..200).map(|_| noise.normal()).collect();
            let clean = farthest(values.iter().copied());
            assert!(values.iter().all(|value| value.abs() < clean), "{clean}");
            assert!((3.5..6.5).contains(&clean), "{clean}");
            // A fifth of them far off.
            values.iter_mut().step_by(5).for_each(|value| *value += 1e3);
            let with_outliers = farthest(values.iter().copied());
            assert!(
                with_outliers < 2.0 * clean
                    && values.iter().filter(|value| value.abs() > with_outliers).count() == 40
            );
        }
        assert!(farthest(std::iter::empty()).is_nan());
    }
}
