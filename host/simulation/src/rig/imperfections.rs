//! Small imperfections of every rig: no effect to be named, and not in the forward model.

use super::{Noise, Stream};
use serde::Deserialize;
use std::f64::consts::TAU;

/// The table `[simulation.imperfections]` of a rig's file; without it there are none.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Imperfections {
    /// The tissue's modulus at this start as a multiple of the one that the seed draws.
    pub modulus_factor: f64,
    /// Change of the unloaded bridge from start to end, along x and y, newtons: what a tare at the start is off by.
    pub force_drift_n: [f64; 2],
    /// Time constant of that, seconds.
    pub force_drift_s: f64,
    /// Amplitude of an error of the sweeps that repeats, millimetres.
    pub shape_pattern_mm: f64,
    /// Its period along the needle, millimetres.
    pub shape_pattern_period_mm: f64,
    /// Its phases along x and y, radians.
    pub shape_pattern_phase_rad: [f64; 2],
}

impl Default for Imperfections {
    fn default() -> Self {
        Self {
            modulus_factor: 1.0,
            force_drift_n: [0.0; 2],
            force_drift_s: 10.0,
            shape_pattern_mm: 0.0,
            shape_pattern_period_mm: 8.0,
            shape_pattern_phase_rad: [0.0; 2],
        }
    }
}

/// Sizes in an ordinary laboratory: standard deviation of the modulus from start to start, of the drift, and the range of the
/// pattern's amplitude and period.
const MODULUS_SD: f64 = 0.012;
const DRIFT_SD_N: f64 = 0.008;
const PATTERN_MM: [f64; 2] = [0.008, 0.015];
const PERIOD_MM: [f64; 2] = [4.0, 10.0];
/// Draws end here, in standard deviations.
const MAX_SD: f64 = 2.0;

impl Imperfections {
    /// Those of a rig of this seed at one of its starts: the pattern stays, zero and modulus differ from start to start.
    pub fn of_seed(seed: u64, start: u64) -> Self {
        let mut rig = Noise::numbered(seed, Stream::Imperfections, 0);
        let mut imperfections = Noise::numbered(seed, Stream::Imperfections, start + 1);
        Self {
            modulus_factor: 1.0 + MODULUS_SD * truncated_normal(&mut imperfections),
            force_drift_n: [(); 2].map(|()| DRIFT_SD_N * truncated_normal(&mut imperfections)),
            force_drift_s: uniform_within([5.0, 20.0], &mut rig),
            shape_pattern_mm: uniform_within(PATTERN_MM, &mut rig),
            shape_pattern_period_mm: uniform_within(PERIOD_MM, &mut rig),
            shape_pattern_phase_rad: [(); 2].map(|()| uniform_within([0.0, TAU], &mut rig)),
        }
    }

    /// Added to the unloaded bridge of x and y so long after the start, newtons.
    pub(super) fn drift_n(&self, time_s: f64) -> [f64; 2] {
        let fraction = 1.0 - (-time_s / self.force_drift_s).exp();
        self.force_drift_n.map(|drift_n| drift_n * fraction)
    }

    /// Added to the deflections along x and y at a position along the needle, metres.
    pub(super) fn pattern_m(&self, z_m: f64) -> [f64; 2] {
        let turns = z_m / (1e-3 * self.shape_pattern_period_mm);
        self.shape_pattern_phase_rad.map(|phase| 1e-3 * self.shape_pattern_mm * (TAU * turns + phase).sin())
    }

    /// The first value that makes no sense, with what is possible.
    pub(super) fn fault(&self) -> Option<(&'static str, f64, &'static str)> {
        let Self { modulus_factor, force_drift_n, force_drift_s, shape_pattern_mm, .. } = *self;
        let Self { shape_pattern_period_mm, shape_pattern_phase_rad, .. } = *self;
        [
            (
                "imperfections.modulus_factor",
                modulus_factor,
                is_positive(modulus_factor),
                "a positive number",
            ),
            ("imperfections.force_drift_n", force_drift_n[0], force_drift_n[0].is_finite(), "a number"),
            ("imperfections.force_drift_n", force_drift_n[1], force_drift_n[1].is_finite(), "a number"),
            ("imperfections.force_drift_s", force_drift_s, is_positive(force_drift_s), "a positive number"),
            ("imperfections.shape_pattern_mm", shape_pattern_mm, shape_pattern_mm.is_finite(), "a number"),
            (
                "imperfections.shape_pattern_period_mm",
                shape_pattern_period_mm,
                is_positive(shape_pattern_period_mm),
                "a positive number",
            ),
            (
                "imperfections.shape_pattern_phase_rad",
                shape_pattern_phase_rad[0],
                shape_pattern_phase_rad.iter().all(|phase| phase.is_finite()),
                "two numbers",
            ),
        ]
        .into_iter()
        .find(|(_, _, sound, _)| !sound)
        .map(|(field, value, _, expected)| (field, value, expected))
    }
}

fn is_positive(value: f64) -> bool {
    value > 0.0 && value.is_finite()
}

fn uniform_within([low, high]: [f64; 2], rig: &mut Noise) -> f64 {
    low + (high - low) * rig.uniform()
}

fn truncated_normal(imperfections: &mut Noise) -> f64 {
    imperfections.draw().clamp(-MAX_SD, MAX_SD)
}

#[cfg(test)]
mod tests {
    use super::super::config::{Range, RigConfig};
    use super::super::{BridgeInputs, SimulatedRig};
    use super::*;

    const REST: BridgeInputs = [[0.0; 2]; 2];

    fn rig(imperfections: Imperfections) -> SimulatedRig {
        let mut config = RigConfig::default();
        config.simulation.imperfections = imperfections;
        config.simulation.modulus_kpa = Range { low: 15.0, high: 15.0 };
        config.simulation.ultrasound.noise_mm = 0.0;
        config.simulation.ultrasound.pixel_mm = 1e-6;
        config.simulation.force.noise_n = 0.0;
        SimulatedRig::new(config, 3).expect("sound")
    }

    #[test]
    fn each_imperfection_acts_where_it_should() {
        let imperfections = Imperfections {
            modulus_factor: 1.02,
            force_drift_n: [0.01, -0.02],
            shape_pattern_mm: 0.012,
            ..Imperfections::default()
        };
        let (mut plain, mut imperfect) = (rig(Imperfections::default()), rig(imperfections));
        assert!((imperfect.truth().modulus_pa / plain.truth().modulus_pa - 1.02).abs() < 1e-12);
        // The zero is off in the end by the drift, and not at the start; a stiffer tissue pushes back a little more.
        let code_per_n = 5.0 / 9.375 / 5.0 * 8_388_607.0;
        let mut gap_n = |steps: usize| {
            let mut codes = [imperfect.step(REST, 1e-3), plain.step(REST, 1e-3)];
            (1..steps).for_each(|_| codes = [imperfect.step(REST, 1e-3), plain.step(REST, 1e-3)]);
            [0, 1].map(|i| f64::from(codes[0].bridge[i] - codes[1].bridge[i]) / code_per_n)
        };
        let (first_n, last_n) = (gap_n(1), gap_n(60_000));
        for (i, drift_n) in [0.01, -0.02].into_iter().enumerate() {
            assert!((last_n[i] - first_n[i] - drift_n).abs() < 1e-4, "{first_n:?} {last_n:?}");
        }
        // The pattern is in every sweep alike.
        let mut softer = rig(Imperfections { shape_pattern_mm: 0.0, ..imperfections });
        let (a, b, c) = (imperfect.sweep(), imperfect.sweep(), softer.sweep());
        assert_eq!(a, b);
        let largest =
            a.iter().zip(&c).map(|(a, c)| (a.deflection_m[1] - c.deflection_m[1]).abs()).fold(0.0, f64::max);
        assert!((0.9e-5..1.3e-5).contains(&largest), "{largest}");
    }

    #[test]
    fn a_seed_repeats_and_starts_differ_in_zero_and_modulus_only() {
        let [first, second] = [0, 1].map(|start| Imperfections::of_seed(7, start));
        assert_eq!(first, Imperfections::of_seed(7, 0));
        assert_ne!(first, Imperfections::of_seed(8, 0));
        assert_ne!(first.modulus_factor, second.modulus_factor);
        assert_ne!(first.force_drift_n, second.force_drift_n);
        assert_eq!(first.shape_pattern_phase_rad, second.shape_pattern_phase_rad);
        assert_eq!(first.shape_pattern_mm, second.shape_pattern_mm);
        assert!((first.modulus_factor - 1.0).abs() < 0.025 && first.force_drift_n[0].abs() < 0.017);
    }

    #[test]
    fn impossible_values_are_named() {
        let mut config = RigConfig::default();
        config.simulation.imperfections.shape_pattern_period_mm = 0.0;
        let error = config.simulation.check().unwrap_err().to_string();
        assert!(error.contains("imperfections.shape_pattern_period_mm is 0"), "{error}");
    }
}
