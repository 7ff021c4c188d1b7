//! The constants of a simulated rig.

use super::imperfections::Imperfections;
use super::scanner::ScannerConfig;
use formats::session::{SessionError, Setup, read_text};
use mechanics::{Needle, Rig};
use serde::Deserialize;
use std::path::Path;

/// A range from which a value is drawn uniformly.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Range {
    /// Smallest value.
    pub low: f64,
    /// Largest value.
    pub high: f64,
}

/// Everything about a rig that is not drawn from the seed, and the ranges of what is.
#[derive(Debug, Clone)]
pub struct RigConfig {
    /// Needle, guides and tissue surface: known to the user of the rig too.
    pub rig: Rig,
    /// The rest.
    pub simulation: Simulation,
}

/// The table `[simulation]` of a rig's file: tissue, depth and electronics.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Simulation {
    /// Insertion depth of the needle, millimetres; 0 in air.
    pub depth_mm: f64,
    /// Foundation modulus of the tissue, kilopascals.
    pub modulus_kpa: Range,
    /// Both actuators.
    pub actuator: ActuatorConfig,
    /// Force sensor and its converter.
    pub force: ForceConfig,
    /// Ultrasound.
    pub ultrasound: UltrasoundConfig,
    /// The same as frames.
    pub scanner: ScannerConfig,
    /// Effects that are hidden from the user of the rig.
    pub effects: Vec<HiddenEffect>,
    /// Small imperfections beside them.
    pub imperfections: Imperfections,
}

/// An effect that the rig has: of the tissue, the guides or the ultrasound; what needs a history or acts on the force sensor's
/// reading is not simulated.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HiddenEffect {
    /// Its id.
    pub id: String,
    /// Values of its parameters, in their order.
    pub values: Vec<f64>,
}

/// Effects that a rig can hide, each with values that a careful laboratory might overlook.
const HIDDEN: [(&str, &[f64]); 6] = [
    ("tissue.layers", &[2.2, 14.0]),
    ("tissue.skin", &[0.25]),
    ("rig.clamp_compliance", &[0.4]),
    ("rig.backlash", &[0.12]),
    ("tissue.gradient", &[0.04]),
    ("sensor.shape_scale", &[0.12]),
];

impl HiddenEffect {
    /// The one that a seed picks.
    pub fn of_seed(seed: u64) -> Self {
        // A few draws apart, so that neighbouring seeds do not follow the order of the list.
        let number = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 32;
        let (id, values) = HIDDEN[(number % HIDDEN.len() as u64) as usize];
        Self { id: id.to_owned(), values: values.to_vec() }
    }
}

impl Default for RigConfig {
    fn default() -> Self {
        let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
        Self { rig, simulation: Simulation::default() }
    }
}

impl Default for Simulation {
    fn default() -> Self {
        Self {
            depth_mm: 30.0,
            modulus_kpa: Range { low: 8.0, high: 24.0 },
            actuator: ActuatorConfig::default(),
            force: ForceConfig::default(),
            ultrasound: UltrasoundConfig::default(),
            scanner: ScannerConfig::default(),
            effects: Vec::new(),
            imperfections: Imperfections::default(),
        }
    }
}

/// An Actuonix L16-50-63-12-P.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ActuatorConfig {
    /// Stroke, which is also the potentiometer's track, millimetres.
    pub stroke_mm: f64,
    /// Duty below which the motor does not turn, 0 to 1.
    pub dead_band: Range,
    /// Speed at full duty, millimetres per second.
    pub full_speed_mm_s: Range,
    /// Time constant of the speed, seconds.
    pub lag_s: f64,
    /// Largest distance of the rod from the middle at the start, millimetres.
    pub start_spread_mm: f64,
    /// Standard deviation of one potentiometer reading, converter codes.
    pub potentiometer_noise_codes: f64,
}

impl Default for ActuatorConfig {
    fn default() -> Self {
        Self {
            stroke_mm: 50.0,
            dead_band: Range { low: 0.12, high: 0.24 },
            full_speed_mm_s: Range { low: 18.0, high: 22.0 },
            lag_s: 0.012,
            start_spread_mm: 1.5,
            potentiometer_noise_codes: 1.2,
        }
    }
}

/// A 5 N two-axis cell of 2 mV/V at 2.5 V on a 24-bit converter with 9.375 mV full scale.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ForceConfig {
    /// Rated range, newtons.
    pub range_n: f64,
    /// Output at the rated range as a share of the converter's full scale.
    pub share_of_full_scale: f64,
    /// Standard deviation of one reading, newtons.
    pub noise_n: f64,
    /// Offset of the unloaded bridge, newtons.
    pub offset_n: Range,
}

impl Default for ForceConfig {
    fn default() -> Self {
        Self {
            range_n: 5.0,
            share_of_full_scale: 5.0 / 9.375,
            noise_n: 0.005,
            offset_n: Range { low: -0.3, high: 0.3 },
        }
    }
}

/// A linear probe swept along the needle.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct UltrasoundConfig {
    /// Distance between samples along the needle, millimetres.
    pub spacing_mm: f64,
    /// Pixel size, millimetres.
    pub pixel_mm: f64,
    /// Standard deviation of one deflection before it falls on a pixel, millimetres.
    pub noise_mm: f64,
}

impl Default for UltrasoundConfig {
    fn default() -> Self {
        Self { spacing_mm: 1.0, pixel_mm: 0.051, noise_mm: 0.02 }
    }
}

/// Why a configuration cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read, or its `[needle]` and `[rig]` make no sense.
    #[error(transparent)]
    Setup(#[from] SessionError),
    /// Its `[simulation]` makes no sense.
    #[error("{path}: {cause}")]
    Parse {
        /// The file.
        path: String,
        /// Place and cause.
        cause: Box<toml::de::Error>,
    },
    /// An effect that a rig cannot have.
    #[error("[simulation] effects: {id:?} with {count} values, expected one of {}", HIDDEN.map(|(id, values)| format!("{id} ({} values)", values.len())).join(", "))]
    Effect {
        /// Text that was given.
        id: String,
        /// Number of its values.
        count: usize,
    },
    /// A value is out of its range.
    #[error("[simulation] {field} is {value}, expected {expected}")]
    Value {
        /// Name as in the file.
        field: &'static str,
        /// Value that was given.
        value: f64,
        /// Possible values.
        expected: &'static str,
    },
}

impl RigConfig {
    /// Reads a TOML file with the session format's `[needle]` and `[rig]` and an optional `[simulation]`; what the latter leaves
    /// out is as in the default rig.
    ///
    /// # Errors
    /// [`ConfigError`] naming the file and the place or field.
    pub fn read(path: &Path) -> Result<Self, ConfigError> {
        #[derive(Deserialize)]
        struct File {
            #[serde(default)]
            simulation: Simulation,
        }
        // Read once: a pipe gives its text only once.
        let text = read_text(path)?;
        let Setup { rig, .. } = Setup::parse(path, &text)?;
        let name = || path.display().to_string();
        let File { simulation } = toml::from_str(&text)
            .map_err(|cause| ConfigError::Parse { path: name(), cause: Box::new(cause) })?;
        simulation.check()?;
        Ok(Self { rig, simulation })
    }
}

impl Simulation {
    /// Checks what the types cannot.
    ///
    /// # Errors
    /// [`ConfigError::Value`] for the first value out of its range.
    pub fn check(&self) -> Result<(), ConfigError> {
        let positive = "a positive number";
        let Self { depth_mm, modulus_kpa, actuator, force, ultrasound, scanner, effects, imperfections } =
            self;
        let is_known = |effect: &&HiddenEffect| {
            HIDDEN.iter().any(|(id, values)| *id == effect.id && values.len() == effect.values.len())
        };
        if let Some(HiddenEffect { id, values }) = effects.iter().find(|effect| !is_known(effect)) {
            return Err(ConfigError::Effect { id: id.clone(), count: values.len() });
        }
        let checks = [
            ("depth_mm", *depth_mm, (0.0..=500.0).contains(depth_mm), "0 (in air) to 500"),
            ("modulus_kpa.low", modulus_kpa.low, modulus_kpa.low > 0.0, positive),
            (
                "modulus_kpa.high",
                modulus_kpa.high,
                modulus_kpa.high >= modulus_kpa.low,
                "at least modulus_kpa.low",
            ),
            ("actuator.stroke_mm", actuator.stroke_mm, actuator.stroke_mm > 0.0, positive),
            ("actuator.lag_s", actuator.lag_s, actuator.lag_s > 0.0, positive),
            (
                "actuator.dead_band.high",
                actuator.dead_band.high,
                (0.0..1.0).contains(&actuator.dead_band.high),
                "0 to below 1",
            ),
            ("force.range_n", force.range_n, force.range_n > 0.0, positive),
            ("ultrasound.spacing_mm", ultrasound.spacing_mm, ultrasound.spacing_mm >= 0.01, "at least 0.01"),
            ("ultrasound.pixel_mm", ultrasound.pixel_mm, ultrasound.pixel_mm > 0.0, positive),
        ];
        let fault = checks.into_iter().find(|(_, _, sound, _)| !sound);
        let fault = fault.map(|(field, value, _, expected)| (field, value, expected));
        match fault.or_else(|| scanner.fault()).or_else(|| imperfections.fault()) {
            Some((field, value, expected)) => Err(ConfigError::Value { field, value, expected }),
            None => Ok(()),
        }
    }
}
