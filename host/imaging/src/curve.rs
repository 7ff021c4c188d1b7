//! A smooth curve through positions along the needle: cubic B-splines under a prior on the bending of a beam.

use nalgebra::{DMatrix, DVector};

/// Distance of knots, millimetres: a third of the length over which the deflection of a needle in soft tissue decays
/// (`(4 E I / K)^(1/4)`, 28 mm for 18 gauge in 100 kPa).
const KNOT_MM: f64 = 10.0;
/// Most intervals between knots.
const MAX_INTERVALS: usize = 16;
/// Standard deviation of the curvature of a needle that guides and tissue bend, 1/mm: a radius of 100 mm.
const CURVATURE_PER_MM: f64 = 0.01;

/// A position with its weight.
#[derive(Debug, Clone, Copy)]
pub struct Knot {
    /// Place along the needle, millimetres.
    pub z_mm: f64,
    /// Value, millimetres.
    pub value_mm: f64,
    /// Its standard deviation, millimetres.
    pub sd_mm: f64,
}

/// Cubic B-splines over a stretch of the needle.
#[derive(Debug, Clone, Copy)]
pub struct Splines {
    from_mm: f64,
    step_mm: f64,
    count: usize,
}

impl Splines {
    /// With knots about as far apart as a needle in tissue bends, but no more than so many intervals; nothing for a stretch without a length.
    pub fn over(from_mm: f64, to_mm: f64, most_intervals: usize) -> Option<Self> {
        let length_mm = to_mm - from_mm;
        if !length_mm.is_finite() || length_mm < 0.0 {
            return None;
        }
        let most = most_intervals.clamp(1, MAX_INTERVALS);
        let intervals = ((length_mm / KNOT_MM).ceil() as usize).clamp(1, most);
        let step_mm = (length_mm / intervals as f64).max(1e-3);
        Some(Self { from_mm, step_mm, count: intervals + 3 })
    }

    /// Number of parameters.
    pub fn count(&self) -> usize {
        self.count
    }

    /// The four that are not zero at a place, and the number of the first.
    pub fn at(&self, z_mm: f64) -> (usize, [f64; 4]) {
        let position = ((z_mm - self.from_mm) / self.step_mm).clamp(0.0, (self.count - 3) as f64);
        let first = (position as usize).min(self.count - 4);
        let t = position - first as f64;
        let (t2, t3) = (t * t, t * t * t);
        let values = [(1.0 - t).powi(3), 3.0 * t3 - 6.0 * t2 + 4.0, -3.0 * t3 + 3.0 * t2 + 3.0 * t + 1.0, t3];
        (first, values.map(|value| value / 6.0))
    }
}

/// A fitted curve.
#[derive(Debug, Clone)]
pub struct Curve {
    splines: Splines,
    coefficients: DVector<f64>,
    covariance: DMatrix<f64>,
}

impl Curve {
    /// The curve with the least sum of weighted squares and bending; nothing without points.
    pub fn fit(points: &[Knot]) -> Option<Self> {
        let (start_mm, end_mm) =
            points.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), point| {
                (least.min(point.z_mm), most.max(point.z_mm))
            });
        let splines = Splines::over(start_mm, end_mm, MAX_INTERVALS)?;
        let count = splines.count();
        let mut normal = DMatrix::<f64>::zeros(count, count);
        let mut right = DVector::<f64>::zeros(count);
        for point in points {
            let (first, basis) = splines.at(point.z_mm);
            let weight = 1.0 / point.sd_mm.powi(2);
            for (i, a) in basis.iter().enumerate() {
                right[first + i] += weight * a * point.value_mm;
                for (j, b) in basis.iter().enumerate() {
                    normal[(first + i, first + j)] += weight * a * b;
                }
            }
        }
        // The second difference of coefficients over the square of the step is the curvature at a knot.
        let weight = 1.0 / (CURVATURE_PER_MM * splines.step_mm.powi(2)).powi(2);
        for first in 0..count - 2 {
            for (i, a) in [1.0, -2.0, 1.0].iter().enumerate() {
                for (j, b) in [1.0, -2.0, 1.0].iter().enumerate() {
                    normal[(first + i, first + j)] += weight * a * b;
                }
            }
        }
        let scale = normal.diagonal().max().max(f64::MIN_POSITIVE);
        (0..count).for_each(|i| normal[(i, i)] += 1e-12 * scale);
        let cholesky = normal.cholesky()?;
        let coefficients = cholesky.solve(&right);
        let finite = coefficients.iter().all(|value| value.is_finite());
        finite.then(|| Self { splines, coefficients, covariance: cholesky.inverse() })
    }

    /// Value at a place; at its end beyond it.
    pub fn at(&self, z_mm: f64) -> f64 {
        let (first, basis) = self.splines.at(z_mm);
        basis.iter().zip(self.coefficients.iter().skip(first)).map(|(a, b)| a * b).sum()
    }

    /// Variance of the value at a place, for standard deviations as given.
    pub fn variance(&self, z_mm: f64) -> f64 {
        let (first, basis) = self.splines.at(z_mm);
        let mut sum = 0.0;
        for (i, a) in basis.iter().enumerate() {
            for (j, b) in basis.iter().enumerate() {
                sum += a * b * self.covariance[(first + i, first + j)];
            }
        }
        sum.max(0.0)
    }

    /// Number of coefficients.
    pub fn parameters(&self) -> usize {
        self.coefficients.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn follows_a_needle_on_springs_between_its_points() {
        let points: Vec<Knot> = (0..60)
            .map(|i| 0.9 * f64::from(i))
            .map(|z_mm| Knot { z_mm, value_mm: deflection_mm(z_mm), sd_mm: 0.01 })
            .collect();
        let curve = Curve::fit(&points).expect("points determine a curve");
        for z in [0.4, 11.3, 27.0, 40.1, 52.9] {
            assert!(
                (curve.at(z) - deflection_mm(z)).abs() < 2e-3,
                "{z}: {} beside {}",
                curve.at(z),
                deflection_mm(z)
            );
        }
        assert!((0.001..0.01).contains(&curve.variance(25.0).sqrt()));
    }

    fn deflection_mm(z: f64) -> f64 {
        1.2 * (-z / 20.0).exp() * ((z / 20.0).cos() + 0.3 * (z / 20.0).sin())
    }

    #[test]
    fn bridges_a_gap_without_swinging() {
        let points: Vec<Knot> = [0.0, 1.0, 2.0, 60.0, 61.0, 62.0]
            .iter()
            .map(|z| Knot { z_mm: *z, value_mm: 0.01 * z, sd_mm: 0.01 })
            .collect();
        let curve = Curve::fit(&points).expect("points determine a curve");
        assert!((curve.at(30.0) - 0.3).abs() < 0.05, "{}", curve.at(30.0));
        assert!(curve.variance(30.0) > curve.variance(1.0));
        assert!(Curve::fit(&[]).is_none());
    }
}
