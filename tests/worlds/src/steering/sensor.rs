//! Actuators, sensors and rules of the plant.

use super::needle::Needle;
use crate::random::normal;
use ::steering::{Answer, Command, End, LimitViolations, Plant, PlantError, Statement};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::collections::VecDeque;

/// A needle in its tissue, marched in time.
pub trait Body {
    /// Goes on to a depth in some time; guide and load (N, x and y) as at the end, the bevel's direction in rad.
    fn advance(&mut self, depth_m: f64, time_s: f64, guide_m: [f64; 2], load_n: [f64; 2], bevel_rad: f64);

    /// The tip, x and y, m.
    fn tip_m(&self) -> [f64; 2];

    /// Force of guide 2 on the needle, x and y, N.
    fn force_n(&self) -> [f64; 2];

    /// Largest bending strain of the needle.
    fn strain(&self) -> f64;
}

/// Errors of actuators and sensors, and the load of the tip.
#[derive(Debug, Clone, Default)]
pub struct Flaws {
    /// Constant error of the guide, mm.
    pub guide_offset_mm: [f64; 2],
    /// Half of the play of the guide, mm.
    pub play_mm: f64,
    /// Share by which the guide goes too far.
    pub lead: f64,
    /// Share of tip readings that are bad.
    pub bad: f64,
    /// Tilt of the tip sensor, rad.
    pub sensor_tilt: [f64; 2],
    /// Slow drift of the tip sensor, mm/s.
    pub sensor_drift_mm_s: [f64; 2],
    /// Scale error of the tip sensor.
    pub sensor_scale: f64,
    /// Offset of the force, N.
    pub force_offset_n: [f64; 2],
    /// Angle between needle and axis, rad.
    /// Slope of the needle at its tip, x and y.
    pub slope: [f64; 2],
    /// Load along and across the bevel at every millimetre, N.
    pub load_n: Vec<[f64; 2]>,
    /// Error of the bevel's stated direction, rad.
    pub roll_rad: f64,
    /// Growth of the load with the speed of pushing, share per mm/s.
    pub load_per_speed: f64,
}

/// The plant.
#[derive(Debug, Clone)]
pub struct SimulatedPlant<N = Needle> {
    /// Statement of the plant.
    pub stated: Statement,
    /// The needle in its tissue.
    pub needle: N,
    /// Errors of actuators and sensors.
    pub flaws: Flaws,
    rng: ChaCha8Rng,
    now: Command,
    /// True position of the guide, mm.
    true_guide_mm: [f64; 2],
    arriving: VecDeque<(f64, [f64; 2], bool)>,
    shown: (i64, f64, [f64; 2], bool),
    next_sample_s: f64,
    end: End,
    broken: LimitViolations,
    turns: f64,
}

impl SimulatedPlant {
    /// Parameters of its rig: half of the play of guide 2, what the frame gives, what the clamp gives; ids and units of
    /// the catalogue's parameters.
    pub fn rig(&self) -> [(&'static str, f64); 3] {
        [
            ("rig.play", self.flaws.play_mm),
            ("rig.frame_compliance", 1e3 * self.needle.frame_m_per_n),
            ("rig.clamp_compliance", self.needle.clamp_rad_per_n_m),
        ]
    }
}

impl<N: Body> SimulatedPlant<N> {
    /// At the surface, at time 0.
    pub fn new(stated: Statement, needle: N, flaws: Flaws, rng: ChaCha8Rng) -> Self {
        let now = Command { bevel_deg: stated.bevel_deg, ..Command::default() };
        Self {
            stated,
            needle,
            flaws,
            rng,
            now,
            true_guide_mm: [0.0; 2],
            arriving: VecDeque::new(),
            shown: (0, 0.0, [0.0; 2], false),
            next_sample_s: 0.0,
            end: End::default(),
            broken: LimitViolations::default(),
            turns: 0.0,
        }
    }

    /// The tip, mm.
    pub fn tip_mm(&self) -> [f64; 2] {
        [0, 1].map(|i: usize| 1e3 * self.needle.tip_m()[i] + self.now.depth_mm * self.flaws.slope[i])
    }

    fn load_n(&self, depth_mm: f64, bevel_rad: f64, speed_mm_s: f64) -> [f64; 2] {
        let first_mm = (depth_mm.floor() as usize).min(self.flaws.load_n.len().saturating_sub(2));
        let fraction = (depth_mm - first_mm as f64).clamp(0.0, 1.0);
        let factor = 1.0 + self.flaws.load_per_speed * speed_mm_s;
        let (sin, cos) = (bevel_rad + self.flaws.roll_rad).sin_cos();
        [
            cos * self.load_between(0, factor, first_mm, fraction)
                - sin * self.load_between(1, factor, first_mm, fraction),
            sin * self.load_between(0, factor, first_mm, fraction)
                + cos * self.load_between(1, factor, first_mm, fraction),
        ]
    }

    fn load_between(&self, i: usize, factor: f64, first_mm: usize, fraction: f64) -> f64 {
        factor
            * (self.flaws.load_n[first_mm][i] * (1.0 - fraction)
                + self.flaws.load_n[first_mm + 1][i] * fraction)
    }

    fn normal(&mut self) -> f64 {
        normal(&mut self.rng)
    }

    fn advance(&mut self, to: &Command) {
        let limits = self.stated.limits.clone();
        let time_s = to.t_s - self.now.t_s;
        let mut guide_mm = [to.guide_x_mm, to.guide_y_mm];
        let was_mm = [self.now.guide_x_mm, self.now.guide_y_mm];
        for (to_mm, was_mm) in guide_mm.iter_mut().zip(was_mm) {
            if to_mm.abs() > limits.guide_travel_mm + 1e-9 {
                self.broken.travel += 1;
            }
            *to_mm = to_mm.clamp(-limits.guide_travel_mm, limits.guide_travel_mm);
            let step_mm = *to_mm - was_mm;
            let most_mm = limits.guide_speed_mm_s * time_s;
            if step_mm.abs() > most_mm + 1e-9 {
                self.broken.speed += 1;
            }
            *to_mm = was_mm + step_mm.clamp(-most_mm, most_mm);
        }
        let pushed_mm = to.depth_mm - self.now.depth_mm;
        if pushed_mm > limits.push_speed_mm_s * time_s + 1e-9 {
            self.broken.push_speed += 1;
        }
        let moved = (0..2).any(|i| (guide_mm[i] - was_mm[i]).abs() > 1e-9);
        if pushed_mm > 1e-9 && moved && !self.stated.rig.move_while_pushing {
            self.broken.moved_while_pushed += 1;
        }
        let rotated_deg = (to.bevel_deg - self.now.bevel_deg).abs();
        if rotated_deg > limits.rotation_speed_deg_s * time_s + 1e-9 {
            self.broken.rotation_speed += 1;
        }
        if rotated_deg > 1e-9 {
            self.turns += rotated_deg / 180.0;
        }
        let play_mm = self.flaws.play_mm;
        for (i, to_mm) in guide_mm.into_iter().enumerate() {
            let driven_mm = to_mm * (1.0 + self.flaws.lead) + self.flaws.guide_offset_mm[i];
            self.true_guide_mm[i] = self.true_guide_mm[i].clamp(driven_mm - play_mm, driven_mm + play_mm);
        }
        let old_tip_mm = self.tip_mm();
        let (start_s, bevel_rad) = (self.now.t_s, to.bevel_deg.to_radians());
        let load_n = self.load_n(to.depth_mm, bevel_rad, pushed_mm / time_s);
        self.needle.advance(
            1e-3 * to.depth_mm,
            time_s,
            self.true_guide_mm.map(|mm| 1e-3 * mm),
            load_n,
            bevel_rad,
        );
        self.now = Command { guide_x_mm: guide_mm[0], guide_y_mm: guide_mm[1], ..*to };
        let new_tip_mm = self.tip_mm();
        let [force_x_n, force_y_n] = self.needle.force_n();
        let force = force_x_n.hypot(force_y_n);
        if limits.guide_force_n.is_some_and(|most| force > most) {
            self.broken.force += 1;
        }
        if limits.needle_strain.is_some_and(|most| self.needle.strain() > most) {
            self.broken.strain += 1;
        }
        self.end.peak_force_n = Some(self.end.peak_force_n.unwrap_or(0.0).max(force));
        self.end.peak_strain = Some(self.end.peak_strain.unwrap_or(0.0).max(self.needle.strain()));
        while self.next_sample_s <= to.t_s + 1e-9 {
            let sample_s = self.next_sample_s;
            self.next_sample_s += 1.0 / self.stated.tip_rate_hz;
            let fraction = ((sample_s - start_s) / time_s).clamp(0.0, 1.0);
            let depth_mm = self.now.depth_mm;
            let noise = self.stated.tip_noise_mm;
            let mut read_mm = [0, 1].map(|i: usize| {
                let tip = old_tip_mm[i] + fraction * (new_tip_mm[i] - old_tip_mm[i]);
                (1.0 + self.flaws.sensor_scale) * tip
                    + depth_mm * self.flaws.sensor_tilt[i]
                    + sample_s * self.flaws.sensor_drift_mm_s[i]
            });
            read_mm.iter_mut().for_each(|mm| *mm += noise * self.normal());
            let mut valid = true;
            if self.rng.random_range(0.0..1.0) < self.flaws.bad {
                match self.rng.random_range(0..3) {
                    0 => valid = false,
                    1 => {
                        let outlier_mm = self.rng.random_range(1.0..15.0);
                        let angle: f64 = self.rng.random_range(0.0..std::f64::consts::TAU);
                        read_mm =
                            [read_mm[0] + outlier_mm * angle.cos(), read_mm[1] + outlier_mm * angle.sin()];
                    }
                    _ => read_mm = self.arriving.back().map_or(read_mm, |(_, tip, _)| *tip),
                }
            }
            self.arriving.push_back((sample_s, read_mm, valid));
        }
        while self.arriving.front().is_some_and(|(at_s, ..)| at_s + self.stated.tip_delay_s <= to.t_s + 1e-9)
        {
            if let Some((sample_s, tip_mm, valid)) = self.arriving.pop_front() {
                self.shown = (self.shown.0 + 1, sample_s, tip_mm, valid);
            }
        }
    }
}

impl<N: Body> SimulatedPlant<N> {
    /// Force on guide 2 along one axis as its sensor gives it, where there is one.
    fn measured_force_n(&mut self, i: usize, force_noise_n: Option<f64>) -> Option<f64> {
        force_noise_n.map(|sd| self.needle.force_n()[i] + self.flaws.force_offset_n[i] + sd * self.normal())
    }
}

impl<N: Body> Plant for SimulatedPlant<N> {
    fn start(&mut self) -> Result<Statement, PlantError> {
        Ok(self.stated.clone())
    }

    fn step(&mut self, command: &Command) -> Result<Answer, PlantError> {
        self.advance(command);
        let force_noise_n = self.stated.force_noise_n;
        let (force_x_n, force_y_n) =
            (self.measured_force_n(0, force_noise_n), self.measured_force_n(1, force_noise_n));
        let (tip_seq, sample_s, tip_mm, valid) = self.shown;
        Ok(Answer {
            t_s: self.now.t_s,
            depth_mm: self.now.depth_mm,
            guide_x_mm: self.now.guide_x_mm,
            guide_y_mm: self.now.guide_y_mm,
            bevel_deg: self.now.bevel_deg,
            force_x_n,
            force_y_n,
            tip_seq,
            tip_x_mm: tip_mm[0],
            tip_y_mm: tip_mm[1],
            tip_t_s: Some(sample_s),
            valid,
            tip_slope_x_mrad: None,
            tip_slope_y_mrad: None,
        })
    }

    fn end(&mut self) -> Result<End, PlantError> {
        let [x, y] = self.tip_mm();
        Ok(End {
            true_tip_x_mm: Some(x),
            true_tip_y_mm: Some(y),
            depth_mm: self.now.depth_mm,
            limits_broken: Some(self.broken),
            rotations: Some(self.turns),
            ..self.end.clone()
        })
    }
}
