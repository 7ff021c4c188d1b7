//! Online estimate of the lateral stiffness: a straight line through force against displacement, one per axis.
//!
//! Least squares by a QR factorization: two Givens rotations add each new row `[1, u, f]` (displacement, force) to the triangular
//! factor `[R | z; 0 | r]`. The slope is `z₂ / R₂₂`, its standard error `s / R₂₂` with `s² = r² / (n - 2)`. The factor is the
//! square root of the normal equations, for which single precision has too few digits. Readings are every second output of the
//! decimating filters: their windows do not overlap, so that their noise is white.
//!
//! The slope checks the quality of a running measurement (needle clamped, tissue in contact, line straight). It is not the
//! measurement, as it includes relaxation, needle and guide. It restarts with every tare.

#![expect(clippy::indexing_slicing, reason = "matrices of fixed size at places known when compiling")]

use super::decimate::Decimator;
use crate::calibration::{FORCE_NN_PER_COUNT, POSITION_NM_PER_COUNT};
use crate::round;
use nalgebra::linalg::givens::GivensRotation;
use nalgebra::{Matrix3, RowVector3, Vector2};
use protocol::{Sample, Stiffness};

/// Periods per output of the decimating filters.
pub const DECIMATION: i32 = 10;
/// Standard deviation of the displacements below which the slope is not identifiable, millimetres.
const MIN_SPREAD_MM: f32 = 0.05;
/// Smallest number of readings for a slope.
const MIN_READINGS: u32 = 5;

type Filter = Decimator<DECIMATION>;

const MM_PER_SUM: f32 = POSITION_NM_PER_COUNT as f32 * 1e-6 / Filter::GAIN as f32;
const N_PER_SUM: f32 = FORCE_NN_PER_COUNT as f32 * 1e-9 / Filter::GAIN as f32;

/// The line of one axis.
#[derive(Debug, Clone)]
struct Line {
    triangle: Matrix3<f32>,
    readings: u32,
}

impl Line {
    const fn new() -> Self {
        Self { triangle: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), readings: 0 }
    }

    fn add(&mut self, displacement_mm: f32, force_n: f32) {
        let mut row = RowVector3::new(1.0, displacement_mm, force_n);
        for column in 0..2 {
            let pivot = Vector2::new(self.triangle[(column, column)], row[column]);
            let Some((rotation, norm)) = GivensRotation::cancel_y(&pivot) else { continue };
            for at in column..3 {
                let [upper, lower] = [self.triangle[(column, at)], row[at]];
                self.triangle[(column, at)] = rotation.c() * upper - rotation.s() * lower;
                row[at] = rotation.s() * upper + rotation.c() * lower;
            }
            self.triangle[(column, column)] = norm;
        }
        self.triangle[(2, 2)] = libm::hypotf(self.triangle[(2, 2)], row[2]);
        self.readings = self.readings.saturating_add(1);
    }

    /// Slope and its standard error, newtons per millimetre, where the displacements determine them.
    fn slope(&self) -> Option<(f32, f32)> {
        let spread_mm = self.triangle[(1, 1)].abs() / libm::sqrtf(self.readings as f32);
        if self.readings < MIN_READINGS || spread_mm < MIN_SPREAD_MM {
            return None;
        }
        let scatter_n = self.triangle[(2, 2)] / libm::sqrtf((self.readings - 2) as f32);
        Some((self.triangle[(1, 2)] / self.triangle[(1, 1)], scatter_n / self.triangle[(1, 1)].abs()))
    }
}

/// The lines of both axes, and the filters before them.
#[derive(Debug, Clone)]
pub struct StiffnessFit {
    position: [Filter; 2],
    force: [Filter; 2],
    lines: [Line; 2],
    every_second: bool,
}

impl StiffnessFit {
    /// No reading yet.
    #[expect(clippy::new_without_default, reason = "made in one place")]
    pub const fn new() -> Self {
        Self {
            position: [Filter::new(), Filter::new()],
            force: [Filter::new(), Filter::new()],
            lines: [Line::new(), Line::new()],
            every_second: false,
        }
    }

    /// Adds the sample of one period.
    pub fn add(&mut self, sample: &Sample) {
        let position = push(&mut self.position, sample.position_counts);
        let force = push(&mut self.force, sample.force_counts);
        let (Some(position), Some(force)) = (position, force) else { return };
        self.every_second = !self.every_second;
        if self.every_second {
            for ((line, position), force) in self.lines.iter_mut().zip(position).zip(force) {
                line.add(position as f32 * MM_PER_SUM, force as f32 * N_PER_SUM);
            }
        }
    }

    /// The lines so far, x and y.
    pub fn result(&self) -> [Option<Stiffness>; 2] {
        // Newtons per millimetre to millinewtons per metre.
        const SCALE: f32 = 1e6;
        self.lines.each_ref().map(|line| {
            line.slope().map(|(slope, sd)| Stiffness {
                slope_mn_per_m: round(slope * SCALE),
                sd_mn_per_m: (sd * SCALE + 0.5) as u32,
                readings: line.readings,
            })
        })
    }
}

fn push(filters: &mut [Filter; 2], [x, y]: [i32; 2]) -> Option<[i32; 2]> {
    let [filter_x, filter_y] = filters;
    // Both take their value in every period, so that they stay in step.
    let (x, y) = (filter_x.push(x), filter_y.push(y));
    Some([x?, y?])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Noise of the sum of twelve uniform draws.
    struct Noise(u64);

    impl Noise {
        fn draw(&mut self) -> f64 {
            let mut uniform = || {
                self.0 =
                    self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (self.0 >> 33) as f64 / (1_u64 << 31) as f64
            };
            (0..12).map(|_| uniform()).sum::<f64>() - 6.0
        }
    }

    /// A ramp to 1 mm and back in 2 s against 1.5 N/mm along y, with force noise of 5 mN.
    fn run(seed: u64, seconds: u32) -> [Option<Stiffness>; 2] {
        let (mut fit, mut noise) = (StiffnessFit::new(), Noise(seed));
        for period in 0..seconds * 1_000 {
            let phase = f64::from(period % 2_000) / 1_000.0;
            let um = 1_000.0 * (1.0 - (phase - 1.0).abs());
            let force_counts = um * 1.5e-3 / 50e-6 + 100.0 * noise.draw();
            fit.add(&Sample {
                position_counts: [3, um.round() as i32],
                force_counts: [0, force_counts.round() as i32],
                repeats_force: false,
            });
        }
        fit.result()
    }

    #[test]
    fn the_slope_and_its_error_are_those_of_the_readings() {
        // The filter passes the ramp's corners rounded, in both channels alike.
        let (mut squares, mut stated, runs) = (0.0, 0.0, 200);
        for seed in 1..=runs {
            let [x, y] = run(seed, 4);
            assert_eq!(x, None, "an axis that does not move has no slope");
            let y = y.expect("a slope");
            let z = (f64::from(y.slope_mn_per_m) - 1.5e6) / f64::from(y.sd_mn_per_m);
            squares += z * z;
            stated += f64::from(y.sd_mn_per_m) / runs as f64;
            assert!((190..=200).contains(&y.readings), "{}", y.readings);
        }
        // The mean of 200 squares has a standard error of 10 %.
        let ratio = squares / runs as f64;
        assert!((0.75..1.3).contains(&ratio), "squared error in squared standard errors: {ratio}");
        // 5 mN times the noise gain 0.259, over 199 readings with a spread of 0.29 mm: 0.32 N/m.
        assert!((250.0..400.0).contains(&stated), "{stated} mN/m");
    }

    #[test]
    fn a_long_run_keeps_its_precision() {
        let [_, y] = run(7, 1_200);
        let y = y.expect("a slope");
        assert!((y.slope_mn_per_m - 1_500_000).abs() < 200, "{}", y.slope_mn_per_m);
        assert!((10..40).contains(&y.sd_mn_per_m), "{}", y.sd_mn_per_m);
    }
}
