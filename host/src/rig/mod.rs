//! A simulated rig: two actuators, the needle in tissue by the forward model, the force chain and an ultrasound sweep.
//!
//! It stands on the far side of the electronics: bridge inputs in, converter codes out, one call of [`SimulatedRig::step`] per
//! control period. Everything random comes from one seed, each part from its own stream, so that a rig repeats exactly and
//! more noise drawn in one part changes nothing in another. What the estimator is to find (the tissue's modulus) is drawn
//! from the seed too and told to nobody but [`SimulatedRig::truth`].
//!
//! | part | models |
//! |---|---|
//! | [`actuator`] | dead band, speed limit, lag, end stops, potentiometer with noise |
//! | [`config`] | every constant, from a TOML file or by default |

pub mod actuator;
pub mod config;

use crate::model::{LateralResponse, Rig};
use actuator::Actuator;
use config::{Range, RigConfig};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

/// Largest code of the 24-bit bridge converter.
const BRIDGE_CODE_MAX: f64 = 8_388_607.0;

/// What the bridges' inputs were in one period: share of the period that IN1 and IN2 of x and y were high, 0 to 1.
pub type BridgeInputs = [[f64; 2]; 2];

/// What the converters read at the end of one period.
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

/// What the rig really is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth {
    /// Foundation modulus of the tissue, pascals.
    pub modulus_pa: f64,
    /// Insertion depth, metres.
    pub depth_m: f64,
    /// Lateral stiffness at guide 2, newtons per metre.
    pub stiffness_n_per_m: f64,
}

/// The rig.
#[derive(Debug)]
pub struct SimulatedRig {
    config: RigConfig,
    truth: Truth,
    response: LateralResponse,
    actuators: [Actuator; 2],
    bridge_offset_n: [f64; 2],
    force_noise: Noise,
    sweep_noise: Noise,
}

#[derive(Debug)]
struct Noise {
    random: ChaCha8Rng,
    normal: Normal<f64>,
}

impl Noise {
    fn new(random: ChaCha8Rng) -> Self {
        // A unit normal: its parameters are constants, so it always exists.
        Self { random, normal: Normal::new(0.0, 1.0).unwrap_or_else(|_| unreachable!()) }
    }

    fn draw(&mut self) -> f64 {
        self.normal.sample(&mut self.random)
    }
}

/// Independent streams of one seed.
#[derive(Clone, Copy)]
enum Stream {
    Truth = 0,
    Actuator = 1,
    Force = 3,
    Sweep = 4,
}

fn stream(seed: u64, stream: u64) -> ChaCha8Rng {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(stream);
    random
}

fn within(random: &mut impl Rng, range: Range) -> f64 {
    range.low + (range.high - range.low) * random.random::<f64>()
}
