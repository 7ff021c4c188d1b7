//! Steering runs of a simulated rig: a stage drives the needle's base along a planned path while the needle goes in, its force is
//! measured, and the tip is tracked.
//!
//! The truth is the steering model with ten modes, inertia and a stage with a position loop, in tissue of layers with inclusions
//! (inclusions, cavities); the online estimator has five modes, no inertia, and smooth segments.

use super::{Noise, Stream};
use formats::session::SteeringRun;
use mechanics::{BaseDrive, Dynamics, Experiment, Foundation, Layer, Model, ModelError, Rig, check, predict};
use std::f64::consts::TAU;

/// Modes of the truth.
const MODES: usize = 10;
/// Thickness of the slices in which inclusions are made.
const SLICE_M: f64 = 0.5e-3;

/// Tissue down to a depth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TissueLayer {
    /// Lower face; the last layer goes on below its own.
    pub bottom_mm: f64,
    /// Stiffness: lateral force per needle length and deflection.
    pub stiffness_n_per_m2: f64,
    /// Damping: lateral force per needle length and velocity.
    pub damping_n_s_per_m2: f64,
}

/// An inclusion or a cavity: stiffness and damping times `1 + (factor - 1)` of a bell of this width.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inclusion {
    /// Position of its middle.
    pub depth_mm: f64,
    /// Standard deviation of the bell.
    pub width_mm: f64,
    /// More than 1: an inclusion; less: a cavity.
    pub factor: f64,
}

/// True parameters of the tissue.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Tissue {
    /// From the surface down; at least one.
    pub layers: Vec<TissueLayer>,
    /// Anywhere in it.
    pub inclusions: Vec<Inclusion>,
}

impl Tissue {
    fn layer(&self, depth_mm: f64) -> Option<&TissueLayer> {
        self.layers.iter().find(|layer| depth_mm < layer.bottom_mm).or(self.layers.last())
    }

    /// Checks what the types cannot.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] naming the first value that no tissue has.
    pub fn check(&self) -> Result<(), ModelError> {
        check("layers", self.layers.len() as f64, "at least one", !self.layers.is_empty())?;
        let mut top_mm = 0.0;
        for layer in &self.layers {
            check("bottom_mm", layer.bottom_mm, "deeper than the layer above", layer.bottom_mm > top_mm)?;
            check(
                "stiffness_n_per_m2",
                layer.stiffness_n_per_m2,
                "0 to 1e8",
                (0.0..=1e8).contains(&layer.stiffness_n_per_m2),
            )?;
            check(
                "damping_n_s_per_m2",
                layer.damping_n_s_per_m2,
                "0 to 1e7",
                (0.0..=1e7).contains(&layer.damping_n_s_per_m2),
            )?;
            top_mm = layer.bottom_mm;
        }
        for one in &self.inclusions {
            check("depth_mm", one.depth_mm, "0 to 500", (0.0..=500.0).contains(&one.depth_mm))?;
            check("width_mm", one.width_mm, "0.1 to 100", (0.1..=100.0).contains(&one.width_mm))?;
            check("factor", one.factor, "0 to 100", (0.0..=100.0).contains(&one.factor))?;
        }
        Ok(())
    }

    fn factor(&self, depth_mm: f64) -> f64 {
        self.inclusions.iter().map(|one| 1.0 + (one.factor - 1.0) * bell(one, depth_mm)).product()
    }

    /// Stiffness, N/m^2, and damping, N s/m^2, at a depth.
    pub fn at(&self, depth_m: f64) -> [f64; 2] {
        let depth_mm = 1e3 * depth_m;
        let factor = self.factor(depth_mm);
        self.layer(depth_mm)
            .map_or([0.0; 2], |layer| [factor * layer.stiffness_n_per_m2, factor * layer.damping_n_s_per_m2])
    }

    /// Their means over the first `depth_m`.
    pub fn mean(&self, depth_m: f64) -> [f64; 2] {
        let slices = (depth_m / SLICE_M).ceil().max(1.0) * 4.0;
        let mut sum = [0.0; 2];
        for i in 0..slices as usize {
            let [stiffness, damping] = self.at(depth_m * (i as f64 + 0.5) / slices);
            sum = [sum[0] + stiffness, sum[1] + damping];
        }
        sum.map(|sum| sum / slices)
    }

    /// Stiffness and damping for the model, in slices where there are inclusions.
    fn foundations(&self, reach_m: f64) -> Result<[Foundation; 2], ModelError> {
        let mut faces_m: Vec<f64> = self.layers.iter().map(|layer| 1e-3 * layer.bottom_mm).collect();
        if !self.inclusions.is_empty() {
            faces_m.extend((1..=(reach_m / SLICE_M).ceil() as usize).map(|i| i as f64 * SLICE_M));
        }
        faces_m.sort_by(f64::total_cmp);
        faces_m.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
        Ok([self.foundation_of(0, &faces_m)?, self.foundation_of(1, &faces_m)?])
    }

    fn foundation_of(&self, part: usize, faces_m: &[f64]) -> Result<Foundation, ModelError> {
        let mut top_m = 0.0;
        let mut layers = Vec::new();
        for &bottom_m in faces_m {
            layers.push(Layer { bottom_m, modulus_pa: self.at(0.5 * (top_m + bottom_m))[part] });
            top_m = bottom_m;
        }
        Foundation::layered(layers, self.at(top_m + SLICE_M)[part])
    }
}

/// Gaussian profile of an inclusion over the depth.
fn bell(one: &Inclusion, depth_mm: f64) -> f64 {
    (-0.5 * ((depth_mm - one.depth_mm) / one.width_mm).powi(2)).exp()
}

/// Motion of one run.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Name of the run.
    pub id: String,
    /// Speed of insertion.
    pub speed_mm_s: f64,
    /// Final depth.
    pub depth_mm: f64,
    /// Final sideways displacement of the base, reached evenly during the insertion.
    pub lateral_mm: f64,
    /// The needle is supported: it goes in straight this far before it is moved sideways.
    pub straight_mm: f64,
    /// The base moves to and fro by this much too, which separates damping from stiffness.
    pub wobble_mm: f64,
    /// Frequency of the sideways oscillation.
    pub wobble_hz: f64,
    /// Time between samples.
    pub period_ms: f64,
    /// Disturbances, at random depths: the tip jerks and rings, the force jumps for a moment.
    pub disturbances: usize,
}

/// Standard deviations of the sensors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sensors {
    /// Position of the base, from the motors.
    pub base_m: f64,
    /// Force at the base.
    pub force_n: f64,
    /// Position of the tip.
    pub tip_m: f64,
}

/// Needle and tissue of steering runs.
#[derive(Debug, Clone)]
pub struct SteeringRig {
    model: Model,
}

/// A run: what really happened, free of noise.
#[derive(Debug, Clone)]
pub struct Truth {
    /// Times, depths, base, force and tip.
    pub run: SteeringRun,
    period_s: f64,
    disturbances: usize,
}

impl SteeringRig {
    /// A needle of `length_m` on a fixture in this tissue.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] where tissue or needle are impossible.
    pub fn new(rig: Rig, length_m: f64, fixture_mass_kg: f64, tissue: &Tissue) -> Result<Self, ModelError> {
        let [stiffness, damping] = tissue.foundations(length_m)?;
        let dynamics =
            Dynamics { damping, modes: MODES, ..Dynamics::steel(&rig.needle, length_m, fixture_mass_kg) };
        let mut model = Model::uniform(rig, 0.0)?;
        model.foundation = stiffness;
        model.dynamics = Some(dynamics);
        Ok(Self { model })
    }

    /// Simulates the plan.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] for a plan that no rig can carry out.
    pub fn carry_out(&self, plan: &Plan) -> Result<Truth, ModelError> {
        check("speed_mm_s", plan.speed_mm_s, "0.1 to 100", (0.1..=100.0).contains(&plan.speed_mm_s))?;
        check("period_ms", plan.period_ms, "1 to 1000", (1.0..=1e3).contains(&plan.period_ms))?;
        check("depth_mm", plan.depth_mm, "1 to 300", (1.0..=300.0).contains(&plan.depth_mm))?;
        check("lateral_mm", plan.lateral_mm, "-100 to 100", (-100.0..=100.0).contains(&plan.lateral_mm))?;
        check("wobble_mm", plan.wobble_mm, "0 to 20", (0.0..=20.0).contains(&plan.wobble_mm))?;
        check("wobble_hz", plan.wobble_hz, "0.01 to 5", (0.01..=5.0).contains(&plan.wobble_hz))?;
        let straight = (0.0..plan.depth_mm).contains(&plan.straight_mm);
        check("straight_mm", plan.straight_mm, "0 or more, less than depth_mm", straight)?;
        let period_s = 1e-3 * plan.period_ms;
        let count = (plan.depth_mm / plan.speed_mm_s / period_s).floor() as usize;
        let time_s: Vec<f64> = (0..=count).map(|i| i as f64 * period_s).collect();
        let run = mechanics::Steering {
            depth_m: time_s
                .iter()
                .map(|time_s| 1e-3 * depth_mm(time_s, plan.speed_mm_s, plan.depth_mm))
                .collect(),
            drive: BaseDrive::Position(
                time_s
                    .iter()
                    .map(|time_s| {
                        let fraction = (depth_mm(time_s, plan.speed_mm_s, plan.depth_mm) - plan.straight_mm)
                            / (plan.depth_mm - plan.straight_mm);
                        let wobble_mm = if fraction > 0.0 {
                            plan.wobble_mm * (TAU * plan.wobble_hz * time_s).sin()
                        } else {
                            0.0
                        };
                        1e-3 * (plan.lateral_mm * fraction.max(0.0) + wobble_mm)
                    })
                    .collect(),
            ),
            time_s,
        };
        let depth_m = run.depth_m.clone();
        let time_s = run.time_s.clone();
        let channels = predict(&self.model, &Experiment::Steering(run))?;
        let run = SteeringRun {
            path: format!("{}.csv", plan.id).into(),
            id: plan.id.clone(),
            time_s,
            depth_m,
            base_y_m: channels.base_m.y,
            base_force_y_n: channels.force_n.y,
            tip_y_m: channels.tip_m.y,
        };
        Ok(Truth { run, period_s, disturbances: plan.disturbances })
    }
}

fn depth_mm(time_s: &f64, speed_mm_s: f64, depth_mm: f64) -> f64 {
    (speed_mm_s * time_s).min(depth_mm)
}

/// Disturbances: tip, m; force, N; how long they last, s; frequency of the ringing, 1/s.
const JERK_M: f64 = 1.5e-3;
const KNOCK_N: f64 = 0.4;
const RINGING_S: f64 = 0.25;
const RINGING_HZ: f64 = 6.0;

impl Truth {
    /// Readings of the sensors. `seed` and `number` make the noise.
    pub fn measure(&self, sensors: Sensors, seed: u64, number: u64) -> SteeringRun {
        let mut noise = Noise::numbered(seed, Stream::Steering, number);
        let mut run = self.run.clone();
        let last_s = run.time_s.last().copied().unwrap_or(0.0);
        let jerks: Vec<(f64, f64)> =
            (0..self.disturbances).map(|_| (last_s * noise.uniform(), noise.draw().signum())).collect();
        for i in 0..run.time_s.len() {
            run.base_y_m[i] += sensors.base_m * noise.draw();
            run.base_force_y_n[i] += sensors.force_n * noise.draw();
            run.tip_y_m[i] += sensors.tip_m * noise.draw();
            for &(start_s, sign) in &jerks {
                let elapsed_s = run.time_s[i] - start_s;
                if elapsed_s >= 0.0 {
                    let ringing = (-elapsed_s / RINGING_S).exp() * (TAU * RINGING_HZ * elapsed_s).sin();
                    run.tip_y_m[i] += sign * JERK_M * ringing;
                    if elapsed_s < 2.0 * self.period_s {
                        run.base_force_y_n[i] += sign * KNOCK_N;
                    }
                }
            }
        }
        run
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mechanics::Needle;

    fn tissue() -> Tissue {
        let inclusions = vec![Inclusion { depth_mm: 20.0, width_mm: 2.0, factor: 2.0 }];
        Tissue { layers: vec![layer(40.0, 1e4, 1e3), layer(80.0, 3e4, 2e3)], inclusions }
    }

    fn layer(bottom_mm: f64, stiffness_n_per_m2: f64, damping_n_s_per_m2: f64) -> TissueLayer {
        TissueLayer { bottom_mm, stiffness_n_per_m2, damping_n_s_per_m2 }
    }

    fn rig(tissue: &Tissue) -> SteeringRig {
        let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
        SteeringRig::new(rig, 0.13, 0.3, tissue).expect("a rig")
    }

    fn plan(speed_mm_s: f64, lateral_mm: f64) -> Plan {
        Plan {
            id: "s".to_owned(),
            speed_mm_s,
            depth_mm: 60.0,
            lateral_mm,
            straight_mm: 0.0,
            wobble_mm: 0.0,
            wobble_hz: 0.5,
            period_ms: 20.0,
            disturbances: 0,
        }
    }

    #[test]
    fn means_are_of_what_the_needle_is_in() {
        // The inclusion adds its area: sqrt(2 pi) times its width.
        let width_mm = std::f64::consts::TAU.sqrt() * 2.0;
        let [stiffness, damping] = tissue().mean(0.08);
        assert!((stiffness / (1e4 * (40.0 + width_mm) / 80.0 + 1.5e4) - 1.0).abs() < 1e-4, "{stiffness}");
        assert!((damping / (1e3 * (40.0 + width_mm) / 80.0 + 1e3) - 1.0).abs() < 1e-4, "{damping}");
        let [stiffness, damping] = tissue().at(0.02);
        assert_eq!([stiffness, damping], [2e4, 2e3]);
        assert!(Tissue::default().check().is_err());
    }

    /// Moved straight in, nothing pushes; moved slowly, the needle's path depends on how deep it is and not on how fast it went.
    #[test]
    fn slow_paths_do_not_depend_on_speed() {
        let mut tissue = tissue();
        tissue.layers.iter_mut().for_each(|layer| layer.damping_n_s_per_m2 = 0.0);
        let rig = rig(&tissue);
        let straight = rig.carry_out(&plan(4.0, 0.0)).expect("a plan").run;
        assert!(straight.base_force_y_n.iter().chain(&straight.tip_y_m).all(|value| *value == 0.0));
        let ((fast_m, fast_n), (slow_m, slow_n)) = (end_of_run(4.0, &rig), end_of_run(2.0, &rig));
        assert!((fast_m - slow_m).abs() < 2e-5, "{fast_m} {slow_m}");
        assert!((fast_n / slow_n - 1.0).abs() < 5e-3, "{fast_n} {slow_n}");
    }

    fn end_of_run(speed_mm_s: f64, rig: &SteeringRig) -> (f64, f64) {
        let run = rig.carry_out(&plan(speed_mm_s, 15.0)).expect("a plan").run;
        (run.tip_y_m.last().copied().expect("samples"), run.base_force_y_n.last().copied().expect("samples"))
    }

    #[test]
    fn the_same_numbers_make_the_same_noise() {
        let truth = rig(&tissue()).carry_out(&plan(8.0, 15.0)).expect("a plan");
        let sensors = Sensors { base_m: 1e-5, force_n: 0.05, tip_m: 2e-4 };
        assert_eq!(truth.measure(sensors, 1, 2), truth.measure(sensors, 1, 2));
        assert_ne!(truth.measure(sensors, 1, 2), truth.measure(sensors, 1, 3));
        assert_ne!(truth.measure(sensors, 1, 2), truth.measure(sensors, 2, 2));
    }
}
