//! A simulated rig: two actuators, the needle in tissue by the forward model, the force chain and an ultrasound sweep.
//!
//! It stands on the far side of the electronics: bridge inputs in, converter codes out, one call of
//! [`SimulatedRig::step`] per control period. Everything random comes from one seed, each part from its own stream, so
//! that a rig repeats exactly and more noise drawn in one part changes nothing in another. The tissue's modulus, which
//! the estimator is to find, is drawn from the seed too and available only from [`SimulatedRig::truth`].
//!
//! | part | models |
//! |---|---|
//! | [`actuator`] | dead band, speed limit, lag, end stops, potentiometer with noise |
//! | [`imperfections`] | what is a little off in every rig |
//! | [`scanner`] | ultrasound frames of the needle in speckle |
//! | [`insertions`] | the needle inserted by hand, its tip tracked |
//! | [`steering`] | the needle steered at its base while it goes in |
//! | [`config`] | every constant, from a TOML file or by default |

pub mod actuator;
pub mod config;
pub mod imperfections;
pub mod insertions;
pub mod scanner;
pub mod steering;

use actuator::Actuator;
use config::{ConfigError, Range, RigConfig, Simulation};
use mechanics::effects::{Effect, ObservationContext, effect};
use mechanics::{Beam, Channels, Drive, Model, ModelError, Series};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use scanner::Scan;

/// Largest code of the 24-bit bridge converter.
const BRIDGE_CODE_MAX: f64 = 8_388_607.0;

/// A scan begins and ends at this distance from surface and tip.
pub const SCAN_MARGIN_MM: f64 = 0.5;
/// Distance of the points of the axis that it is rendered from.
const SCAN_STEP_MM: f64 = 0.25;

/// Inputs of the bridges in one period: share of the period that IN1 and IN2 of x and y were high, 0 to 1.
pub type BridgeInputs = [[f64; 2]; 2];

/// Codes of the converters at the end of one period.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Codes {
    /// Potentiometers of x and y, 12 bit.
    pub potentiometer: [u16; 2],
    /// Force bridge of x and y, 24 bit, signed.
    pub bridge: [i32; 2],
}

/// One point of an ultrasound sweep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShapeSample {
    /// Position along the needle from guide 1, metres.
    pub z_m: f64,
    /// Lateral deflection along x and y, metres.
    pub deflection_m: [f64; 2],
}

/// True parameters of the rig.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth {
    /// Foundation modulus of the tissue, pascals.
    pub modulus_pa: f64,
    /// Insertion depth, metres.
    pub depth_m: f64,
    /// Lateral stiffness at guide 2, newtons per metre.
    pub stiffness_n_per_m: f64,
}

/// Load on guide 2 by a needle that another program computes, about a position: its force is linear
/// there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NeedleLoad {
    /// Position of guide 2 along x and y, metres.
    pub at_m: [f64; 2],
    /// Force of guide 2 on the needle there, newtons.
    pub force_n: [f64; 2],
    /// Its growth with the position, newtons per metre.
    pub stiffness_n_per_m: f64,
}

impl NeedleLoad {
    fn force_n(&self, position_m: [f64; 2]) -> [f64; 2] {
        let [x_m, y_m] = position_m;
        let ([at_x_m, at_y_m], [x_n, y_n]) = (self.at_m, self.force_n);
        [x_n + self.stiffness_n_per_m * (x_m - at_x_m), y_n + self.stiffness_n_per_m * (y_m - at_y_m)]
    }
}

/// Why a rig cannot be simulated.
#[derive(Debug, thiserror::Error)]
pub enum RigError {
    /// Its configuration makes no sense.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The forward model refuses it.
    #[error("the rig cannot be modelled: {0}")]
    Model(#[from] ModelError),
}

/// The rig.
#[derive(Debug)]
pub struct SimulatedRig {
    simulation: Simulation,
    entry_m: f64,
    truth: Truth,
    beam: Beam,
    /// Between the actuators and the needle.
    drive: Drive,
    /// Effects that are hidden from the user.
    effects: Vec<(&'static dyn Effect, Vec<f64>)>,
    actuators: [Actuator; 2],
    bridge_offset_n: [f64; 2],
    /// The needle of someone else, where it is not that of the configuration.
    load: Option<NeedleLoad>,
    /// Since the start.
    time_s: f64,
    seed: u64,
    needle_m: f64,
    /// Scans that were taken.
    scans: u64,
    force_noise: Noise,
    sweep_noise: Noise,
}

impl SimulatedRig {
    /// The rig that this seed makes of a configuration.
    ///
    /// # Errors
    /// [`RigError`] where the configuration or the forward model refuses a value.
    pub fn new(config: RigConfig, seed: u64) -> Result<Self, RigError> {
        let RigConfig { rig, simulation } = config;
        simulation.check()?;
        let mut random = stream(seed, Stream::Truth);
        let modulus_pa =
            within(&mut random, simulation.modulus_kpa) * 1e3 * simulation.imperfections.modulus_factor;
        let bridge_offset_n = [(); 2].map(|()| within(&mut random, simulation.force.offset_n));
        let actuators = [Stream::PotentiometerX, Stream::PotentiometerY]
            .map(|noise| Actuator::new(&simulation.actuator, &mut random, Noise::new(seed, noise)));
        let depth_m = simulation.depth_mm * 1e-3;
        let (entry_m, needle_m) = (rig.entry_m, rig.needle.outer_diameter_m);
        let mut model = Model::uniform(rig, modulus_pa)?;
        let hidden = simulation.effects.iter();
        model.effects =
            hidden.filter_map(|hidden| Some((effect(&hidden.id)?, hidden.values.clone()))).collect();
        let beam = model.beam(depth_m)?;
        let mut drive = Drive::default();
        model.effects.iter().for_each(|(effect, values)| effect.drive(values, &mut drive));
        let truth = Truth { modulus_pa, depth_m, stiffness_n_per_m: beam.lateral_stiffness_n_per_m() };
        Ok(Self {
            truth,
            beam,
            drive,
            effects: model.effects,
            actuators,
            bridge_offset_n,
            load: None,
            time_s: 0.0,
            seed,
            needle_m,
            scans: 0,
            force_noise: Noise::new(seed, Stream::Force),
            sweep_noise: Noise::new(seed, Stream::Sweep),
            entry_m,
            simulation,
        })
    }

    /// One control period with these bridge inputs; returns what the converters read at its end.
    pub fn step(&mut self, inputs: BridgeInputs, period_s: f64) -> Codes {
        for (actuator, inputs) in self.actuators.iter_mut().zip(inputs) {
            actuator.step(inputs, period_s);
        }
        let [force_x, force_y] = self.force_n();
        self.time_s += period_s;
        let [drift_x, drift_y] = self.simulation.imperfections.drift_n(self.time_s);
        let [offset_x, offset_y] = self.bridge_offset_n;
        Codes {
            potentiometer: self.actuators.each_mut().map(Actuator::potentiometer_code),
            bridge: [force_x + offset_x + drift_x, force_y + offset_y + drift_y]
                .map(|force_n| self.bridge_code(force_n)),
        }
    }

    /// Takes an ultrasound sweep along the needle inside the tissue, as it lies now; in air, where ultrasound has nothing to pass through,
    /// what a camera sees of the needle from guide 1 to its tip.
    pub fn sweep(&mut self) -> Vec<ShapeSample> {
        let Simulation { ultrasound, imperfections, .. } = &self.simulation;
        let (spacing_m, pixel_m) = (ultrasound.spacing_mm * 1e-3, ultrasound.pixel_mm * 1e-3);
        let is_in_air = self.truth.depth_m == 0.0;
        let (start_m, length_m) =
            if is_in_air { (0.0, self.entry_m) } else { (self.entry_m, self.truth.depth_m) };
        let count = (length_m / spacing_m + 1e-9) as usize;
        let positions_m: Vec<f64> = (1..=count).map(|index| start_m + index as f64 * spacing_m).collect();
        let noise_m = ultrasound.noise_mm * 1e-3;
        let bent_m = self.bent_m(&positions_m);
        bent_m
            .into_iter()
            .zip(positions_m)
            .map(|([x_m, y_m], z_m)| {
                let [x_off_m, y_off_m] = imperfections.pattern_m(z_m);
                let deflection_m = [x_m + x_off_m, y_m + y_off_m].map(|bent_m| {
                    let measured_m = bent_m + noise_m * self.sweep_noise.draw();
                    (measured_m / pixel_m).round() * pixel_m
                });
                ShapeSample { z_m, deflection_m }
            })
            .collect()
    }

    /// Deflection of the needle along x and y at these positions, as it lies now, with what images make of it.
    fn bent_m(&self, places_m: &[f64]) -> Vec<[f64; 2]> {
        let pressed_m = self.position_m().map(|position_m| self.drive.beyond_clearance_m(position_m));
        let shape_m = Series {
            x: Some(self.bent_in_plane(0, pressed_m, places_m)),
            y: self.bent_in_plane(1, pressed_m, places_m),
        };
        let mut channels = Channels { shape_m, ..Channels::default() };
        let context = ObservationContext::default();
        self.effects.iter().for_each(|(effect, values)| effect.observe(values, &context, &mut channels));
        let Series { y, x } = channels.shape_m;
        x.unwrap_or_default().into_iter().zip(y).map(|(x_m, y_m)| [x_m, y_m]).collect()
    }

    fn bent_in_plane(&self, plane: usize, pressed_m: [f64; 2], places_m: &[f64]) -> Vec<f64> {
        places_m.iter().map(|z_m| self.beam.deflection_m(pressed_m[plane], *z_m)).collect()
    }

    /// Takes the ultrasound frames of a probe that goes along the needle inside the tissue and back, as it lies now; frames are rendered
    /// from the scan ([`Scan::frames`]).
    pub fn scan(&mut self) -> Scan {
        self.scans += 1;
        let start_mm = 1e3 * self.entry_m + SCAN_MARGIN_MM;
        let length_mm = (1e3 * self.truth.depth_m - 2.0 * SCAN_MARGIN_MM).max(SCAN_STEP_MM);
        let steps = (length_mm / SCAN_STEP_MM + 1e-9) as usize;
        let positions_m: Vec<f64> =
            (0..=steps).map(|step| 1e-3 * (start_mm + SCAN_STEP_MM * step as f64)).collect();
        let imperfections = &self.simulation.imperfections;
        Scan {
            scanner: self.simulation.scanner.clone(),
            // Apart from those of other scans and rigs.
            seed: stream(self.seed.wrapping_add(self.scans << 32), Stream::Scans).random(),
            needle_mm: 1e3 * self.needle_m,
            axis_mm: self
                .bent_m(&positions_m)
                .into_iter()
                .zip(&positions_m)
                .map(|([x_m, y_m], z_m)| {
                    let [x_off_m, y_off_m] = imperfections.pattern_m(*z_m);
                    [1e3 * z_m, 1e3 * (x_m + x_off_m), 1e3 * (y_m + y_off_m)]
                })
                .collect(),
        }
    }

    /// Position of guide 2 along x and y, metres.
    pub fn position_m(&self) -> [f64; 2] {
        self.actuators.each_ref().map(Actuator::position_m)
    }

    /// From now on guide 2 has a needle that someone else computes; `None`: that of the configuration.
    pub fn set_load(&mut self, load: Option<NeedleLoad>) {
        self.load = load;
    }

    /// Force on guide 2 along x and y, newtons.
    pub fn force_n(&self) -> [f64; 2] {
        if let Some(load) = &self.load {
            return load.force_n(self.position_m());
        }
        self.position_m().map(|position_m| self.beam.force_n(self.drive.beyond_clearance_m(position_m)))
    }

    /// True parameters of the rig.
    pub fn truth(&self) -> Truth {
        self.truth
    }

    fn bridge_code(&mut self, force_n: f64) -> i32 {
        let force = &self.simulation.force;
        let measured_n = force_n + force.noise_n * self.force_noise.draw();
        let relative_force = measured_n / force.range_n * force.share_of_full_scale;
        // The cast saturates at nothing: the clamp keeps it within the converter's 24 bits.
        (relative_force * BRIDGE_CODE_MAX).round().clamp(-BRIDGE_CODE_MAX - 1.0, BRIDGE_CODE_MAX) as i32
    }
}

/// One source of unit normal noise.
#[derive(Debug)]
pub(crate) struct Noise(ChaCha8Rng);

impl Noise {
    fn new(seed: u64, part: Stream) -> Self {
        Self(stream(seed, part))
    }

    /// One of many of the same part.
    pub(crate) fn numbered(seed: u64, part: Stream, number: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(part as u64 | (number + 1) << 8);
        Self(random)
    }

    fn uniform(&mut self) -> f64 {
        self.0.random::<f64>()
    }

    /// One draw.
    pub(crate) fn draw(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }
}

/// Independent streams of one seed.
#[derive(Clone, Copy)]
pub(crate) enum Stream {
    Truth,
    PotentiometerX,
    PotentiometerY,
    Force,
    Sweep,
    Insertions,
    Steering,
    LateralPlans,
    InsertionPlans,
    Imperfections,
    Scans,
}

fn stream(seed: u64, part: Stream) -> ChaCha8Rng {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(part as u64);
    random
}

fn within(random: &mut impl Rng, range: Range) -> f64 {
    range.low + (range.high - range.low) * random.random::<f64>()
}

#[cfg(test)]
mod tests;
