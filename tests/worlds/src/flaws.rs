//! A background at work: what its imperfections are in every run, plane and place.

use super::background::{Background, Imperfection as I, si};
use super::random::{normal, uniform};
use super::world::{Inhomogeneity, Wave, World};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// Ranges that places, lengths and times of imperfections are drawn from, metres, seconds and hertz.
const RIPPLE_M: [f64; 2] = [5e-3, 20e-3];
const WOBBLE_M: [f64; 2] = [12e-3, 60e-3];
const PATTERN_M: [f64; 2] = [3e-3, 10e-3];
const PROPORTIONAL_M: [f64; 2] = [30e-3, 80e-3];
const SOFT_SPOT_M: [f64; 2] = [5e-3, 25e-3];
const SOFT_SPOT_SD_M: [f64; 2] = [1.5e-3, 3e-3];
const HUM_HZ: [f64; 2] = [0.03, 3.0];
/// As shares of a run.
const DRIFT_PERIOD: [f64; 2] = [0.8, 3.0];
const CREEP_S: [f64; 2] = [3.0, 20.0];
const WARMING_S: [f64; 2] = [10.0, 60.0];
const SCREW_M: [f64; 2] = [0.5e-3, 1.5e-3];
/// Random numbers of normal imperfections end here, in standard deviations.
const MAX_SD: f64 = 2.5;
/// The stream of what all runs share.
const SHARED: u64 = u32::MAX as u64;

/// The imperfections of one run.
#[derive(Debug, Clone, Copy)]
pub(super) struct Flaws<'a> {
    background: &'a Background,
    run: u64,
}

/// Random numbers of one kind.
struct Draw(ChaCha8Rng);

impl Draw {
    fn within(&mut self, [low, high]: [f64; 2]) -> f64 {
        uniform(low, high, &mut self.0)
    }

    fn sign(&mut self) -> f64 {
        if self.0.random::<f64>() < 0.5 { -1.0 } else { 1.0 }
    }

    fn normal(&mut self) -> f64 {
        normal(&mut self.0).clamp(-MAX_SD, MAX_SD)
    }

    /// Waves of these lengths with a root mean square of 1 together.
    fn waves(&mut self, count: usize, lengths: [f64; 2]) -> Vec<Wave> {
        let amplitude = (2.0 / count as f64).sqrt();
        (0..count)
            .map(|_| Wave {
                amplitude,
                per_length: TAU / self.within(lengths),
                phase: TAU * self.within([0.0, 1.0]),
            })
            .collect()
    }
}

fn sum(waves: &[Wave], at: f64) -> f64 {
    waves.iter().map(|wave| wave.at(at)).sum()
}

impl<'a> Flaws<'a> {
    /// Those of the run of this number in its list.
    pub fn new(background: &'a Background, run: u64) -> Self {
        Self { background, run }
    }

    /// SI size of a kind that is there.
    fn size(&self, kind: I) -> Option<f64> {
        let size = self.background.size(kind);
        (size != 0.0).then_some(si(kind) * size)
    }

    fn draw(&self, kind: I, part: u64) -> Draw {
        let mut random = ChaCha8Rng::seed_from_u64(self.background.seed ^ 0x6c62_272e_07bb_0142);
        random.set_stream((kind as u64) << 48 | (part & 0xff) << 40 | self.run);
        Draw(random)
    }

    /// Draw that all runs share.
    fn shared(&self, kind: I, part: u64) -> Draw {
        Self { run: SHARED, ..*self }.draw(kind, part)
    }

    /// Variation of the tissue, of a lateral run (0) or an insertion (1).
    pub fn tissue(&self, scope: usize) -> Inhomogeneity {
        let mut tissue = Inhomogeneity::default();
        if let Some(size) = self.size(I::ModulusOverDepth) {
            tissue.waves = self.shared(I::ModulusOverDepth, 0).waves(3, RIPPLE_M);
            tissue.waves.iter_mut().for_each(|wave| wave.amplitude *= size);
        }
        if let Some(size) = self.size(I::SoftSpot) {
            let mut draw = self.shared(I::SoftSpot, 0);
            tissue.soft_spot = [size, draw.within(SOFT_SPOT_M), draw.within(SOFT_SPOT_SD_M)];
        }
        let (modulus, entry) = match scope {
            0 => (I::ModulusPerRun, I::EntryPerRun),
            _ => (I::InsertionModulus, I::InsertionEntry),
        };
        if let Some(size) = self.size(modulus) {
            tissue.factor *= (1.0 + size * self.draw(modulus, 0).normal()).max(0.1);
        }
        if let Some(size) = self.size(entry) {
            tissue.surface_m += size * self.draw(entry, 0).within([-1.0, 1.0]);
        }
        if scope == 0 {
            if let Some(size) = self.size(I::Softening) {
                tissue.factor *= (1.0 - size).powi(self.run as i32);
            }
            if let Some(size) = self.size(I::Entry) {
                tissue.surface_m += size * self.shared(I::Entry, 0).sign();
            }
        }
        tissue
    }

    /// True world of the run, lateral (0) or insertion (1).
    pub fn world(&self, world: &World, scope: usize) -> World {
        let mut world = World { tissue: self.tissue(scope), ..world.clone() };
        if let Some(size) = self.size(I::BendingStiffness) {
            world.bending_n_m2 *= 1.0 + size * self.shared(I::BendingStiffness, 0).sign();
        }
        if let Some(size) = self.size(I::ForceGain) {
            world.gain += (1.0 + world.gain) * size * self.shared(I::ForceGain, 0).sign();
        }
        if scope == 1 {
            if let Some(size) = self.size(I::InsertionLoad) {
                let factor = 1.0 + size * self.draw(I::InsertionLoad, 0).normal();
                world.tip_load_n *= factor;
            }
            if let Some(size) = self.size(I::GuideOffset) {
                let mut draw = self.shared(I::GuideOffset, 0);
                world.guide_offset_m = [0, 1].map(|_| size * draw.within([-1.0, 1.0]));
            }
        }
        world
    }

    /// Mixes what moves in the two planes.
    pub fn mix(&self, planes: &mut [&mut [f64]; 2]) {
        let Some(size) = self.size(I::Axes) else { return };
        let mut draw = self.shared(I::Axes, 0);
        let mixing = [0, 1].map(|_| size * draw.sign() * draw.within([0.5, 1.0]));
        let [y, x] = planes;
        for (y, x) in y.iter_mut().zip(x.iter_mut()) {
            [*y, *x] = [*y + mixing[0] * *x, *x + mixing[1] * *y];
        }
    }

    /// Reading of the force sensor of a plane for its signal.
    pub fn force(&self, plane: u64, time_s: &[f64], force_n: &mut [f64]) {
        let largest_n = force_n.iter().fold(1e-9, |most: f64, force| most.max(force.abs()));
        let duration_s = time_s.last().copied().unwrap_or(0.0).max(1e-9);
        if let Some(size) = self.size(I::ForceNonlinearity) {
            let turn = TAU * self.shared(I::ForceNonlinearity, 0).within([0.0, 1.0]);
            for force in force_n.iter_mut() {
                let relative_force = *force / largest_n;
                *force += size
                    * largest_n
                    * (turn.cos() * relative_force.powi(2) + turn.sin() * relative_force.powi(3));
            }
        }
        if let Some(size) = self.size(I::ForceHysteresis) {
            let (play_n, mut hysteresis_n) = (size * largest_n, 0.0f64);
            for force in force_n.iter_mut() {
                hysteresis_n = hysteresis_n.clamp(*force - play_n, *force + play_n);
                *force = 2.0 * *force - hysteresis_n;
            }
        }
        if let Some(size) = self.size(I::ForceCreep) {
            let tau_s = self.shared(I::ForceCreep, 0).within(CREEP_S);
            let (mut previous_s, mut slow_n) = (0.0, 0.0);
            for (force, now_s) in force_n.iter_mut().zip(time_s) {
                slow_n += (*force - slow_n) * (1.0 - (-(now_s - previous_s) / tau_s).exp());
                previous_s = *now_s;
                *force += size * slow_n;
            }
        }
        let mut added: Vec<Vec<Wave>> = Vec::new();
        if let Some(size) = self.size(I::ForceHum) {
            let [low, high] = HUM_HZ;
            let hertz = low * (high / low).powf(self.shared(I::ForceHum, plane).within([0.0, 1.0]));
            let mut hum = self.draw(I::ForceHum, plane).waves(1, [1.0 / hertz, 1.0 / hertz]);
            hum.iter_mut().for_each(|wave| wave.amplitude *= size);
            added.push(hum);
        }
        if let Some(size) = self.size(I::ForceDrift) {
            let mut drift =
                self.draw(I::ForceDrift, plane).waves(2, DRIFT_PERIOD.map(|share| share * duration_s));
            drift.iter_mut().for_each(|wave| wave.amplitude *= size);
            added.push(drift);
        }
        let zero_n = self
            .size(I::ForceZero)
            .map_or(0.0, |size| size * self.draw(I::ForceZero, plane).within([-1.0, 1.0]));
        for (force, now_s) in force_n.iter_mut().zip(time_s) {
            *force += zero_n + added.iter().map(|waves| sum(waves, *now_s)).sum::<f64>();
        }
    }

    /// Reading of the displacement sensor of a plane for guide 2's position.
    pub fn displacement(&self, plane: u64, time_s: &[f64], at_m: &mut [f64]) {
        if let Some(size) = self.size(I::DisplacementPeriodic) {
            let mut draw = self.shared(I::DisplacementPeriodic, plane);
            let (length_m, phase) = (draw.within(SCREW_M), TAU * draw.within([0.0, 1.0]));
            at_m.iter_mut().for_each(|at_m| {
                *at_m += position_error_m(*at_m, size, length_m, phase)
                    - position_error_m(0.0, size, length_m, phase)
            });
        }
        if let Some(size) = self.size(I::DisplacementDrift) {
            let mut draw = self.draw(I::DisplacementDrift, plane);
            let (tau_s, end) = (draw.within(WARMING_S), size * draw.within([-1.0, 1.0]));
            for (at_m, now_s) in at_m.iter_mut().zip(time_s) {
                *at_m += end * (1.0 - (-now_s / tau_s).exp());
            }
        }
    }

    /// Image of a plane's deflections at depths below the surface.
    pub fn shape(&self, plane: u64, depths_m: &[f64], deflection_m: &mut [f64]) {
        let mut add = |kind: I, share: &dyn Fn(f64, f64) -> f64| {
            let Some(size) = self.size(kind) else { return };
            for (deflection, depth_m) in deflection_m.iter_mut().zip(depths_m) {
                *deflection += size * share(*depth_m, *deflection);
            }
        };
        let mut draw = self.shared(I::ShapeProportional, 0);
        let (even, waves) = (0.7 * draw.sign(), draw.waves(1, PROPORTIONAL_M));
        add(I::ShapeProportional, &|depth_m, now_m| now_m * (even + 0.7 * sum(&waves, depth_m)));
        let waves = self.draw(I::ShapeWobble, plane).waves(3, WOBBLE_M);
        add(I::ShapeWobble, &|depth_m, _| sum(&waves, depth_m));
        let waves = self.shared(I::ShapePattern, plane).waves(2, PATTERN_M);
        add(I::ShapePattern, &|depth_m, _| sum(&waves, depth_m));
    }

    /// Error of the tracker in a plane's tip positions at these depths.
    pub fn tip(&self, plane: u64, depths_m: &[f64], tip_m: &mut [f64]) {
        if let Some(size) = self.size(I::TrackerTilt) {
            let tilt_rad = size * self.shared(I::TrackerTilt, plane).within([-1.0, 1.0]);
            tip_m.iter_mut().zip(depths_m).for_each(|(tip, depth_m)| *tip += tilt_rad * depth_m);
        }
        if let Some(size) = self.size(I::TipDrift) {
            let end_m = depths_m.last().copied().unwrap_or(1.0).max(1e-9);
            let waves = self.draw(I::TipDrift, plane).waves(2, DRIFT_PERIOD.map(|share| share * end_m));
            tip_m.iter_mut().zip(depths_m).for_each(|(tip, at_m)| *tip += size * sum(&waves, *at_m));
        }
    }
}

fn position_error_m(at_m: f64, size: f64, length_m: f64, phase: f64) -> f64 {
    size * (TAU * at_m / length_m + phase).sin()
}
