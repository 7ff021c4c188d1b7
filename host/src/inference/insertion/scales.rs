//! How large the unknowns of an insertion are, and what that makes of standard normal numbers.

use super::basis::{LEADING, Layout};
use nalgebra::{DMatrix, DVector};
use std::f64::consts::FRAC_PI_2;

/// How large the unknowns are: standard deviations of what all insertions share, and of each insertion's own part.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scales {
    /// Shared and own offset of the tip sensor, m.
    pub offset_m: [f64; 2],
    /// Shared and own angle of entry, rad.
    pub entry_angle_rad: [f64; 2],
    /// Shared and own tip load at the surface, N.
    pub load_n: [f64; 2],
    /// Shared and own wander of the tip load, N per square root of a metre of depth.
    pub wander_n: [f64; 2],
    /// Depth over which the wander is forgotten, m.
    pub memory_m: f64,
    /// Of the tip about a smooth path at single depths, m.
    pub irregularity_m: f64,
    /// More of it while the needle is on its way, m.
    pub moving_m: f64,
    /// Of one reading of the tip sensor, m; known beforehand.
    pub reading_m: f64,
}

/// Scales that are found.
pub(super) const COUNT: usize = 11;
/// Their middles and the standard deviations of their logarithms: weak, physical.
const TYPICAL: [(f64, f64); COUNT] = [
    (1e-3, 2.0),
    (0.3e-3, 1.5),
    (0.02, 1.5),
    (0.005, 1.5),
    (0.3, 1.0),
    (0.05, 1.0),
    (0.05, 1.5),
    (0.05, 1.5),
    (0.1, 1.0),
    (0.04e-3, 0.7),
    (0.1e-3, 1.0),
];
/// No path is smoother than this, m: about what the finest tracker resolves. Below it the candidates of modulus and gap would be too
/// far apart.
const LEAST_IRREGULARITY_M: f64 = 20e-6;
impl Scales {
    /// Before anything is learned.
    pub fn typical(reading_m: f64) -> Self {
        Self::from_logarithms(&[0.0; COUNT], reading_m)
    }

    /// From distances to the typical ones, in standard deviations.
    pub(super) fn from_logarithms(x: &[f64], reading_m: f64) -> Self {
        let at = |i: usize| TYPICAL[i].0 * (x[i] * TYPICAL[i].1).clamp(-12.0, 12.0).exp();
        Self {
            offset_m: [at(0), at(1)],
            entry_angle_rad: [at(2), at(3)],
            load_n: [at(4), at(5)],
            wander_n: [at(6), at(7)],
            memory_m: at(8),
            irregularity_m: at(9).max(LEAST_IRREGULARITY_M),
            moving_m: at(10),
            reading_m,
        }
    }

    /// Variance of the median of so many readings at one depth, m^2.
    pub(super) fn variance_m2(&self, rows: f64, moving: bool) -> f64 {
        let moving_m = if moving { self.moving_m } else { 0.0 };
        self.irregularity_m.powi(2) + moving_m.powi(2) + self.reading_m.powi(2) * of_median(rows)
    }

    /// From independent standard normal numbers to an insertion's own unknowns: a row of the design times this is what each of these
    /// numbers does to the tip. In one plane: offset, angle, mean load, wander at the surface, push of the wander in each stretch.
    /// The wander is stationary: it forgets exponentially along the depth.
    pub(super) fn map(&self, layout: &Layout) -> DMatrix<f64> {
        let (of_plane, knots_m) = (layout.of_plane(), &layout.knots_m);
        let numbers = numbers(layout);
        let left = |from_m: f64, to_m: f64| (-(to_m - from_m) / self.memory_m).exp();
        // What is left of a push at `from_m` at the end of a stretch, less what was left at its start.
        let forgotten =
            |from_m: f64, stretch: usize| left(from_m, knots_m[stretch + 1]) - left(from_m, knots_m[stretch]);
        let mut map = DMatrix::zeros(layout.unknowns(), layout.unknowns() / of_plane * numbers);
        for plane in 0..layout.unknowns() / of_plane {
            let (row, column) = (plane * of_plane, plane * numbers);
            map[(row, column)] = self.offset_m[1];
            map[(row + 1, column + 1)] = self.entry_angle_rad[1];
            map[(row + 2, column + 2)] = self.load_n[1];
            let stationary_n = self.wander_n[1] * (0.5 * self.memory_m).sqrt();
            map[(row + 2, column + 3)] = stationary_n;
            for stretch in 0..knots_m.len() - 1 {
                map[(row + LEADING + stretch, column + 3)] = stationary_n * forgotten(knots_m[0], stretch);
                // Variance that makes the wander stationary whatever the stretch.
                let push_n =
                    stationary_n * (1.0 - left(knots_m[stretch], knots_m[stretch + 1]).powi(2)).sqrt();
                map[(row + LEADING + stretch, column + 4 + stretch)] = push_n;
                for later in stretch + 1..knots_m.len() - 1 {
                    map[(row + LEADING + later, column + 4 + stretch)] =
                        push_n * forgotten(knots_m[stretch + 1], later);
                }
            }
        }
        map
    }

    /// Standard deviation of the shared part over that of the own part.
    pub(super) fn shared_ratios(&self, layout: &Layout) -> DVector<f64> {
        let ratio = |[shared, own]: [f64; 2]| shared / own;
        let numbers = numbers(layout);
        DVector::from_fn(layout.unknowns() / layout.of_plane() * numbers, |i, _| match i % numbers {
            0 => ratio(self.offset_m),
            1 => ratio(self.entry_angle_rad),
            2 => ratio(self.load_n),
            _ => ratio(self.wander_n),
        })
    }
}

/// Variance of the median of so many readings over that of one.
pub(crate) fn of_median(readings: f64) -> f64 {
    if readings > 2.0 { FRAC_PI_2 / readings } else { 1.0 / readings }
}

/// Standard normal numbers behind the unknowns of one plane: the wander has one more than stretches, its value at the surface.
fn numbers(layout: &Layout) -> usize {
    layout.of_plane() + 1
}
