//! One actuator at its electrical interface: a gear motor on a lead screw, and the potentiometer on its rod.

use super::config::{ActuatorConfig, Range};
use super::{Noise, within};
use rand::Rng;

/// A rod slower than this stands, metres per second: friction in the screw.
const STICTION_M_PER_S: f64 = 2e-6;
/// Largest code of the 12-bit converter.
const POTENTIOMETER_CODE_MAX: f64 = 4_095.0;

/// One actuator with the constants of its own unit.
#[derive(Debug)]
pub struct Actuator {
    stroke_m: f64,
    zero_m: f64,
    dead_band: f64,
    full_speed_m_per_s: f64,
    lag_s: f64,
    noise_codes: f64,
    rod_m: f64,
    speed_m_per_s: f64,
    noise: Noise,
}

impl Actuator {
    /// A unit drawn from the configured spread, its rod somewhere near the middle.
    pub(super) fn new(config: &ActuatorConfig, random: &mut impl Rng, noise: Noise) -> Self {
        let stroke_m = config.stroke_mm * 1e-3;
        let start_mm = within(random, Range { low: -config.start_spread_mm, high: config.start_spread_mm });
        Self {
            stroke_m,
            zero_m: 0.5 * stroke_m,
            dead_band: within(random, config.dead_band),
            full_speed_m_per_s: within(random, config.full_speed_mm_s) * 1e-3,
            lag_s: config.lag_s,
            noise_codes: config.potentiometer_noise_codes,
            rod_m: (0.5 * stroke_m + start_mm * 1e-3).clamp(0.0, stroke_m),
            speed_m_per_s: 0.0,
            noise,
        }
    }

    /// One period with the bridge inputs IN1 and IN2 high for these shares of it. The difference is the mean motor voltage;
    /// equal inputs short the motor or leave it open, and the screw stops it either way.
    pub fn step(&mut self, inputs: [f64; 2], period_s: f64) {
        let [in1, in2] = inputs;
        let duty = in1 - in2;
        let drive_fraction = ((duty.abs() - self.dead_band) / (1.0 - self.dead_band)).max(0.0);
        let target_speed = drive_fraction.copysign(duty) * self.full_speed_m_per_s;
        // Exact solution of the first-order lag over the period.
        self.speed_m_per_s =
            target_speed + (self.speed_m_per_s - target_speed) * (-period_s / self.lag_s).exp();
        if target_speed == 0.0 && self.speed_m_per_s.abs() < STICTION_M_PER_S {
            self.speed_m_per_s = 0.0;
        }
        let rod_m = self.rod_m + self.speed_m_per_s * period_s;
        self.rod_m = rod_m.clamp(0.0, self.stroke_m);
        if self.rod_m != rod_m {
            self.speed_m_per_s = 0.0;
        }
    }

    /// Position of guide 2 relative to the straight needle, metres.
    pub fn position_m(&self) -> f64 {
        self.rod_m - self.zero_m
    }

    /// Code of the 12-bit converter at the potentiometer.
    pub fn potentiometer_code(&mut self) -> u16 {
        let ideal = self.rod_m / self.stroke_m * (POTENTIOMETER_CODE_MAX + 1.0);
        (ideal + self.noise_codes * self.noise.draw()).round().clamp(0.0, POTENTIOMETER_CODE_MAX) as u16
    }
}
