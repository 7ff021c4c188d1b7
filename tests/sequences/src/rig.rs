//! The plant with its sensors, as a sequence disturbs them: the same in this process and through QEMU.

use crate::plant::{Build, FORCE_CODE_MAX, Inputs, Plant};
use crate::random::Random;
use crate::sensors::Contacts;
use crate::{Converter, Disturbances};
use control::hal::{ForceFault, Readings};

/// Greatest code of a potentiometer.
const POTENTIOMETER_CODE_MAX: i32 = 4_095;
/// Frequency of the mains, hertz.
const MAINS_HZ: f64 = 50.0;

/// Codes of one period as they leave the sensors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Codes {
    /// Codes of the potentiometers.
    pub potentiometer: [u16; 2],
    /// Codes of the force channels.
    pub force: [i32; 2],
    /// The force converter has no new reading.
    pub silent: bool,
    /// The emergency stop is pressed.
    pub emergency_stop: bool,
}

impl Codes {
    /// Readings by a board's drivers: the end of the converter's range is a saturated reading.
    pub fn readings(&self) -> Readings {
        let most = FORCE_CODE_MAX as i32;
        let saturated = self.force.iter().position(|code| *code >= most || *code < -most);
        let fault = match saturated {
            _ if self.silent => Some(ForceFault::NotReady),
            Some(channel) => Some(ForceFault::Saturated { channel: channel as u8 }),
            None => None,
        };
        Readings {
            potentiometer_codes: self.potentiometer,
            force_codes: fault.map_or(Ok(self.force), Err),
            emergency_stop: self.emergency_stop,
        }
    }
}

/// A plant, its sensors and what fails of them.
#[derive(Debug, Clone)]
pub struct Rig {
    /// True plant.
    pub plant: Plant,
    causes: Disturbances,
    force: Contacts,
    potentiometers: Contacts,
    /// The converter has been saturated for its one reading.
    saturated: bool,
    periods: u64,
}

impl Rig {
    /// The rig of a seed: tissue, cell and motors are drawn.
    pub fn drawn(seed: u64) -> Self {
        let mut random = Random::new(seed ^ 0x5249_4700);
        let stiffness = random.pick([0.001, 0.3, 1.0, 1.1]);
        let build = Build {
            stiffness_n_per_mm: [stiffness; 2],
            cross_talk: random.pick([0.0, 0.0, 0.02, -0.02, 0.1, -0.1]),
            play_mm: random.pick([0.0, 0.02]),
            relaxing: (random.pick([0.0, 0.1]), 0.5),
            force_noise_n: random.pick([0.4e-3, 0.005]),
            zero_n: [random.pick([0.0, 0.05, -0.2]), random.pick([0.0, -0.05, 0.2])],
            full_speed_mm_s: random.pick([16.0, 20.0]),
            friction_duty: random.pick([0.15, 0.18, 0.22]),
            ..Build::default()
        };
        let mut rig = Self::new(build, random.bits());
        rig.plant.place([0.0, random.pick([0.0, 0.0, -0.8, 2.0])]);
        rig
    }

    /// A rig of this build, at rest in the middle of its travel.
    pub fn new(build: Build, seed: u64) -> Self {
        Self {
            plant: Plant::new(build, Random::new(seed)),
            causes: Disturbances::default(),
            force: Contacts::default(),
            potentiometers: Contacts::default(),
            saturated: false,
            periods: 0,
        }
    }

    /// Sets what acts on it from the next period on.
    pub fn set(&mut self, causes: Disturbances) {
        (self.causes, self.saturated) = (causes, false);
        self.force = Contacts::new(causes.force, self.periods);
        self.potentiometers = Contacts::new(causes.potentiometers, !self.periods);
        self.plant.build.hum = (causes.hum_n, MAINS_HZ);
    }

    /// Disturbances of the rig.
    pub fn causes(&self) -> &Disturbances {
        &self.causes
    }

    /// One period in which the bridges have these inputs.
    pub fn step(&mut self, bridges: [Inputs; 2]) {
        self.plant.step(bridges);
    }

    /// Present codes of the sensors.
    pub fn codes(&mut self) -> Codes {
        self.periods += 1;
        let potentiometers = self.plant.potentiometer_codes().map(i32::from);
        let mut potentiometers = self.potentiometers.read(potentiometers, POTENTIOMETER_CODE_MAX);
        if let Some(axis) = self.causes.potentiometer_open {
            potentiometers[axis] = POTENTIOMETER_CODE_MAX;
        }
        let mut force = self.force.read(self.plant.force_codes(), FORCE_CODE_MAX as i32);
        let mut silent = false;
        match self.causes.converter {
            Converter::Healthy => {}
            Converter::SaturatedOnce if self.saturated => silent = true,
            Converter::Silent => silent = true,
            Converter::Saturated | Converter::SaturatedOnce => {
                self.saturated = true;
                force[0] = FORCE_CODE_MAX as i32;
            }
        }
        Codes {
            potentiometer: potentiometers.map(|code| code.max(0) as u16),
            force,
            silent,
            emergency_stop: self.causes.emergency_stop,
        }
    }

    /// True position, micrometres.
    pub fn position_um(&self) -> [f32; 2] {
        self.plant.position_mm().map(|mm| (mm * 1e3) as f32)
    }

    /// Larger force of the two axes, as the cell has it from the calibration's zero, newtons.
    pub fn most_n(&self) -> f32 {
        let zero_n = self.plant.build.zero_n;
        self.plant
            .force_n()
            .into_iter()
            .zip(zero_n)
            .map(|(n, zero)| (n + zero).abs() as f32)
            .fold(0.0, f32::max)
    }

    /// Force per displacement, with the share of the other axis, newtons per micrometre.
    pub fn stiffness_n_per_um(&self) -> f32 {
        let Build { stiffness_n_per_mm: [x, y], cross_talk, .. } = self.plant.build;
        (x.max(y) * (1.0 + cross_talk.abs()) * 1e-3) as f32
    }
}
