//! Two actuators, a guide and a needle in tissue, as the documents of the rig describe them. It shares nothing with the simulated rig, so
//! that an error in one of the two does not hide in the other: what the device is told by its sensors is made here, and what is true
//! is compared with the limits.
//!
//! | property | value | source |
//! |---|---|---|
//! | speed without a load at full duty | 20 mm/s | data sheet of the L16-50-63-12 |
//! | lag of the speed | 12 ms | the overshoot that `control::limits` states |
//! | least duty that moves it, and what brakes it when its bridge is off | 15 % | assumed: geared motors of this size take 10 to 20 % of their stall current without a load |
//! | force at which it stalls | 100 N | data sheet |
//! | not driven back by a load | at any duty | data sheet: 46 N of back-driving force |
//! | potentiometer | 50 mm over 4096 codes, 0 in the middle | calibration of the rig as designed |
//! | force channel | 1,117,587 pN per code, +-8,388,607 codes | the same |

use crate::random::Random;

/// Simulated time of one step, seconds: a control period.
const STEP_S: f64 = 1e-3;
/// Time in which the speed follows the duty, seconds; the winding brakes with the same.
const LAG_S: f64 = 0.012;
/// Force that stops a motor at full duty, newtons.
const STALL_N: f64 = 100.0;
/// Stops of the actuator, millimetres from the middle of its stroke.
pub const STOP_MM: f64 = 25.0;
/// Newtons per code of the force converter.
pub const N_PER_CODE: f64 = 1_117_587e-12;
/// Codes per millimetre of the potentiometer.
const CODES_PER_MM: f64 = 4096.0 / 50.0;
/// Greatest code of a force channel.
pub const FORCE_CODE_MAX: f64 = 8_388_607.0;

/// The two inputs of a bridge over one period, as shares of the time in which each is high; a timer raises both at the same moment.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Inputs {
    /// High share of the input that drives outwards.
    pub forward: f64,
    /// High share of the other.
    pub backward: f64,
}

impl Inputs {
    /// Both low: the motor coasts.
    pub const OFF: Self = Self { forward: 0.0, backward: 0.0 };

    /// The inputs of a duty from -1 to 1 against brake.
    pub fn of_duty(duty: f64) -> Self {
        let duty = duty.clamp(-1.0, 1.0);
        Self { forward: 1.0 - (-duty).max(0.0), backward: 1.0 - duty.max(0.0) }
    }

    /// Share of the time in which the motor is driven, with its sign.
    pub fn drive(self) -> f64 {
        self.forward - self.backward
    }

    /// Share of the time in which its winding is connected: driven, or shorted by both inputs high.
    fn connected(self) -> f64 {
        self.forward.max(self.backward)
    }

    /// The bridge does nothing.
    pub fn is_off(self) -> bool {
        self.connected() == 0.0
    }
}

/// One actuator with its guide.
#[derive(Debug, Clone, Copy, Default)]
struct Actuator {
    speed_mm_s: f64,
    nut_mm: f64,
    guide_mm: f64,
    /// Force that has relaxed away, as a displacement, millimetres.
    relaxed_mm: f64,
}

/// Needle, tissue and mechanics of one rig.
#[derive(Debug, Clone, Copy)]
pub struct Build {
    /// Stiffness of needle and tissue along x and y, newtons per millimetre.
    pub stiffness_n_per_mm: [f64; 2],
    /// Share of the force along one axis that acts along the other.
    pub cross_talk: f64,
    /// Play between nut and guide, millimetres.
    pub play_mm: f64,
    /// Share of the force that relaxes, and its time, seconds.
    pub relaxing: (f64, f64),
    /// Standard deviation of a force reading, newtons.
    pub force_noise_n: f64,
    /// Amplitude of the mains in a force reading, newtons, and its frequency, hertz.
    pub hum: (f64, f64),
    /// Standard deviation of a potentiometer's reading, codes.
    pub potentiometer_noise_codes: f64,
    /// Force that the converter reads without a load, newtons.
    pub zero_n: [f64; 2],
    /// Direction in which a motor moves its guide, 1 or -1: leads may be reversed.
    pub polarity: [f64; 2],
    /// Speed at full duty without a load, millimetres per second.
    pub full_speed_mm_s: f64,
    /// Duty that the screw's friction takes.
    pub friction_duty: f64,
}

impl Build {
    /// Coasting distance of a guide from a speed when its bridge is off, millimetres: dry friction alone brakes
    /// it.
    pub fn rolls_on_mm(&self, speed_mm_s: f64) -> f64 {
        speed_mm_s.powi(2) / (2.0 * self.friction_duty * self.full_speed_mm_s / LAG_S)
    }
}

impl Default for Build {
    /// A rig as it should be, on tissue and needle of 2 N/mm.
    fn default() -> Self {
        Self {
            stiffness_n_per_mm: [2.0; 2],
            cross_talk: 0.0,
            play_mm: 0.02,
            relaxing: (0.0, 1.0),
            force_noise_n: 0.004,
            hum: (0.0, 50.0),
            potentiometer_noise_codes: 0.6,
            zero_n: [0.0; 2],
            polarity: [1.0; 2],
            full_speed_mm_s: 20.0,
            friction_duty: 0.15,
        }
    }
}

/// The rig, with what is true of it.
#[derive(Debug, Clone)]
pub struct Plant {
    /// Parameters of its build; may be changed at any time.
    pub build: Build,
    /// The needle's clamp is closed; open, nothing acts on the guide.
    pub clamped: bool,
    /// Force of something else on the guide, newtons.
    pub external_n: [f64; 2],
    actuators: [Actuator; 2],
    time_s: f64,
    random: Random,
}

impl Plant {
    /// At rest in the middle of its travel, on a straight needle.
    pub fn new(build: Build, random: Random) -> Self {
        Self {
            build,
            clamped: true,
            external_n: [0.0; 2],
            actuators: [Actuator::default(); 2],
            time_s: 0.0,
            random,
        }
    }

    /// One control period with these inputs of the bridges.
    pub fn step(&mut self, bridges: [Inputs; 2]) {
        self.time_s += STEP_S;
        let load_n = self.force_n();
        let (fraction, time_s) = self.build.relaxing;
        let full_mm_s = self.build.full_speed_mm_s;
        let friction = self.build.friction_duty * full_mm_s / LAG_S * STEP_S;
        for (axis, actuator) in self.actuators.iter_mut().enumerate() {
            let bridge = bridges[axis];
            let driven = bridge.drive() * self.build.polarity[axis];
            // A load opposes the motion towards it; one that helps is held by the thread.
            let opposed = (load_n[axis] * driven.signum() / STALL_N).max(0.0);
            let pulled = driven - driven.signum() * opposed.min(driven.abs());
            let force_speed =
                (pulled * full_mm_s - bridge.connected() * actuator.speed_mm_s) / LAG_S * STEP_S;
            let free = actuator.speed_mm_s + force_speed;
            actuator.speed_mm_s = free - free.clamp(-friction, friction);
            let reached_mm = actuator.nut_mm + actuator.speed_mm_s * STEP_S;
            actuator.nut_mm = reached_mm.clamp(-STOP_MM, STOP_MM);
            if actuator.nut_mm != reached_mm {
                actuator.speed_mm_s = 0.0;
            }
            let half_mm = self.build.play_mm / 2.0;
            actuator.guide_mm = actuator.guide_mm.clamp(actuator.nut_mm - half_mm, actuator.nut_mm + half_mm);
            actuator.relaxed_mm += (fraction * actuator.guide_mm - actuator.relaxed_mm) * STEP_S / time_s;
        }
    }

    /// True force on the guide along x and y, newtons.
    pub fn force_n(&self) -> [f64; 2] {
        let of_needle = |axis: usize| {
            let actuator = &self.actuators[axis];
            let bent_mm = if self.clamped { actuator.guide_mm - actuator.relaxed_mm } else { 0.0 };
            self.build.stiffness_n_per_mm[axis] * bent_mm
        };
        let [x, y] = [of_needle(0), of_needle(1)];
        let (cross_talk, [more_x, more_y]) = (self.build.cross_talk, self.external_n);
        [x + cross_talk * y + more_x, y + cross_talk * x + more_y]
    }

    /// True position of the guide along x and y, millimetres.
    pub fn position_mm(&self) -> [f64; 2] {
        self.actuators.map(|actuator| actuator.guide_mm)
    }

    /// True speed along x and y, millimetres per second.
    pub fn speed_mm_s(&self) -> [f64; 2] {
        self.actuators.map(|actuator| actuator.speed_mm_s)
    }

    /// Puts the guide somewhere, at rest: another hand, or a needle clamped there.
    pub fn place(&mut self, position_mm: [f64; 2]) {
        for (actuator, at_mm) in self.actuators.iter_mut().zip(position_mm) {
            *actuator = Actuator { nut_mm: at_mm, guide_mm: at_mm, ..Actuator::default() };
        }
    }

    /// Codes of both potentiometers, before any fault of theirs.
    pub fn potentiometer_codes(&mut self) -> [u16; 2] {
        self.actuators.map(|actuator| {
            let noise = self.build.potentiometer_noise_codes * self.random.normal();
            ((actuator.nut_mm + STOP_MM) * CODES_PER_MM + noise).round().clamp(0.0, 4_095.0) as u16
        })
    }

    /// Codes of both force channels, before any fault of theirs.
    pub fn force_codes(&mut self) -> [i32; 2] {
        let (amplitude_n, hertz) = self.build.hum;
        let hum_n = amplitude_n * (std::f64::consts::TAU * hertz * self.time_s).sin();
        let true_n = self.force_n();
        [0, 1].map(|axis: usize| {
            let noise_n = self.build.force_noise_n * self.random.normal();
            let read_n = true_n[axis] + self.build.zero_n[axis] + hum_n + noise_n;
            (read_n / N_PER_CODE).round().clamp(-FORCE_CODE_MAX - 1.0, FORCE_CODE_MAX) as i32
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plant(build: Build) -> Plant {
        Plant::new(build, Random::new(1))
    }

    fn run(plant: &mut Plant, bridge: Inputs, steps: usize) {
        (0..steps).for_each(|_| plant.step([bridge, Inputs::OFF]));
    }

    #[test]
    fn a_duty_moves_the_guide_and_it_rolls_on_by_less_than_the_overshoot_is_stated_of() {
        let mut free = plant(Build { stiffness_n_per_mm: [0.0; 2], play_mm: 0.0, ..Build::default() });
        run(&mut free, Inputs::of_duty(1.0), 200);
        let speed = free.speed_mm_s()[0];
        assert!((speed - 20.0 * (1.0 - 0.15)).abs() < 0.1, "{speed}");
        // Programs move at 10 mm/s at most, and 0.24 mm are stated.
        run(&mut free, Inputs::of_duty(0.5 + 0.15), 200);
        assert!((free.speed_mm_s()[0] - 10.0).abs() < 0.1, "{}", free.speed_mm_s()[0]);
        let start_mm = free.position_mm()[0];
        run(&mut free, Inputs::OFF, 200);
        let rolled_mm = free.position_mm()[0] - start_mm;
        assert!(rolled_mm > 0.1 && rolled_mm < 0.24, "{rolled_mm}");
        assert!((rolled_mm - free.build.rolls_on_mm(10.0)).abs() < 0.02, "{rolled_mm}");
        assert_eq!(free.speed_mm_s(), [0.0; 2]);
    }

    #[test]
    fn a_small_duty_and_a_load_move_nothing() {
        let mut loaded = plant(Build { stiffness_n_per_mm: [50.0; 2], ..Build::default() });
        loaded.place([1.0, 0.0]);
        assert_eq!(loaded.force_n()[0], 50.0);
        run(&mut loaded, Inputs::OFF, 1_000);
        run(&mut loaded, Inputs::of_duty(0.14), 1_000);
        assert_eq!(loaded.position_mm()[0], 1.0);
        loaded.clamped = false;
        assert_eq!(loaded.force_n()[0], 0.0);
    }

    #[test]
    fn codes_are_those_of_the_calibration_as_designed() {
        let mut quiet =
            plant(Build { force_noise_n: 0.0, potentiometer_noise_codes: 0.0, ..Build::default() });
        quiet.place([10.0, -5.0]);
        assert_eq!(quiet.potentiometer_codes(), [2_867, 1_638]);
        let [x, y] = quiet.force_codes().map(|code| f64::from(code) * N_PER_CODE);
        assert!((x - FORCE_CODE_MAX * N_PER_CODE).abs() < 1e-6, "beyond the converter's range: {x}");
        assert!(y < -7.8, "{y}");
    }

    #[test]
    fn tissue_relaxes_and_play_is_taken_up() {
        let mut soft = plant(Build { relaxing: (0.3, 0.1), play_mm: 0.2, ..Build::default() });
        soft.place([1.0, 0.0]);
        run(&mut soft, Inputs::OFF, 1_000);
        assert!((soft.force_n()[0] - 1.4).abs() < 1e-3, "{}", soft.force_n()[0]);
        run(&mut soft, Inputs::of_duty(-0.3), 20);
        assert_eq!(soft.position_mm()[0], 1.0, "within the play");
    }
}
