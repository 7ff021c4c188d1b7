//! Synthetic measurement sessions for blind tests of the diagnosis, from a generator of its own.
//!
//! A test that makes its data with the model that later explains them shows little. So nothing here calls the forward
//! model: the beam is a chain of finite differences in energy form, the tissue a row of springs with state that is
//! marched through time, the needle grows through the tissue step by step, and the noise is correlated, rounded and has
//! outliers. The shared types are plain data: the recorded columns and the rig.
//!
//! | file | has |
//! |---|---|
//! | `design` | what is measured, how precisely |
//! | `effects` | ids and sizes of what can differ from the plain model |
//! | `world` | one truth in SI units, and its tissue |
//! | `chain` | the needle as a chain with its banded solver |
//! | `lateral` | a lateral run marched in time |
//! | `insertion` | the path of the tip |
//! | `sensors` | what the instruments make of it |
//! | [`random`] | normal and uniform random numbers |
//! | `background`, `flaws`, `ordinary` | small imperfections: kinds and sizes, what they are in each run, sets of them that pass unnoticed |
//! | `body` | tissue as an elastic body, from a solver of its own |
//! | [`finite_elements`] | the needle by Hermite finite elements |
//! | [`reciprocal`] | paths of insertions by influence lines |
//! | [`mod@steering`] | a needle that is pushed, moved and read step by step, to be steered |
//! | `gap` | how far a session lies from what a simpler truth would give |
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod background;
pub mod body;
mod chain;
mod cores;
mod design;
mod effects;
pub mod finite_elements;
mod flaws;
mod gap;
mod insertion;
mod lateral;
mod ordinary;
pub mod random;
pub mod reciprocal;
mod sensors;
pub mod steering;
mod world;

pub use background::{Background, Imperfection};
pub use cores::on_all_cores;
pub use design::{Design, GuideStep, ImagePlan, InsertionPlan, LateralPlan, NoisePlan};
pub use effects::{ids, imaging_ids, strengths};
pub use gap::{Misfit, misfit, misfit_of};

use chain::{STEP_M, node_at};
use flaws::Flaws;
use formats::session::{Noise, Session};
use mechanics::{Needle, Rig};
use sensors::LateralPart;
use world::World;

const MM: f64 = 1e-3;

/// Ground truth, hidden from everything but the test.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// Foundation modulus of the plane y.
    pub k_kpa: f64,
    /// Lateral load that the bevel takes at the tip.
    pub tip_load_n: f64,
    /// Effects by id with their values; omitted trailing values are neutral.
    pub effects: Vec<(&'static str, Vec<f64>)>,
    /// Something beyond these effects.
    pub foreign: Option<Foreign>,
}

/// Something that no effect describes, far beyond noise.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Foreign {
    /// The force sensor drifts to and fro, about three times per run.
    SinusoidalDrift,
    /// An inclusion: four times the modulus between 8 and 14 mm below the surface.
    StiffInclusion,
    /// Tissue gets softer, for the rest of the run, where it was deflected most so far.
    Damage,
    /// The force sensor reads a force plus a part of its square.
    QuadraticSensor,
    /// Tissue on one side of the needle is softer than on the other.
    OneSidedTissue,
    /// The image is distorted by a cubic along the needle.
    ImageWarp,
    /// Something hard at the tip holds it by a spring.
    HeldTip,
    /// Guide 2 is a sleeve: it resists a rotation of the needle.
    Sleeve,
}

impl Foreign {
    /// The effects that studies draw from.
    pub const ALL: [Foreign; 6] = [
        Self::SinusoidalDrift,
        Self::StiffInclusion,
        Self::Damage,
        Self::QuadraticSensor,
        Self::OneSidedTissue,
        Self::ImageWarp,
    ];

    /// Its name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::SinusoidalDrift => "sinusoidal_drift",
            Self::StiffInclusion => "stiff_inclusion",
            Self::Damage => "damage",
            Self::QuadraticSensor => "quadratic_sensor",
            Self::OneSidedTissue => "one_sided_tissue",
            Self::ImageWarp => "image_warp",
            Self::HeldTip => "held_tip",
            Self::Sleeve => "sleeve",
        }
    }
}

/// Session that a laboratory with this design would record. The same arguments give the same session on every machine.
///
/// # Panics
/// Where an effect has an unknown id, no value or too many values, or a plan has an axis other than 0 and 1: a blind test of a
/// misspelt truth would prove nothing.
pub fn session(truth: &Truth, design: &Design, seed: u64) -> Session {
    session_on(truth, &Background::default(), design, seed)
}

/// The same in a laboratory with small imperfections of its own.
///
/// # Panics
/// As [`session`].
pub fn session_on(truth: &Truth, background: &Background, design: &Design, seed: u64) -> Session {
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
    let world = World::new(truth, &rig);
    let noise = &design.noise;
    let lateral = (0..).zip(&design.lateral).map(|(run, plan)| {
        let flaws = Flaws::new(background, run);
        let world = flaws.world(&world, 0);
        let depth_m = STEP_M * node_at(MM * plan.depth_mm) as f64;
        let march = |plane: usize, commanded_m: &[f64], keep: &[usize]| {
            lateral::march(&world, plane, depth_m, commanded_m, 1.0 / noise.rate_hz, keep)
        };
        let images = design.images.as_ref();
        let lateral_part = LateralPart { world: &world, flaws: &flaws, plan, noise, images, seed, run };
        sensors::lateral_run(&lateral_part, &march)
    });
    let insertion = (0..).zip(&design.insertion).map(|(run, plan)| {
        let flaws = Flaws::new(background, run);
        sensors::insertion_run(&flaws.world(&world, 1), &flaws, plan, noise, seed, run)
    });
    Session {
        dir: "blind".into(),
        name: Some("blind".to_owned()),
        fixture_mass_kg: None,
        noise: if noise.stated { noise.statement() } else { Noise::default() },
        tissue: formats::session::Tissue {
            walls: Some(formats::session::Walls::Far),
            ..formats::session::Tissue::default()
        },
        lateral: lateral.collect(),
        insertion: insertion.collect(),
        indentation: Vec::new(),
        steering: Vec::new(),
        rig,
    }
}

/// Mean of the modulus over the tissue that the runs of a session touch, as a multiple of the stated one: at every depth by the
/// squared deflection there, which is what the force at guide 2 responds to; over lateral runs, or insertions where there are no others.
pub fn touched_modulus(truth: &Truth, background: &Background, design: &Design) -> f64 {
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
    let world = World::new(truth, &rig);
    let lateral = (0..).zip(&design.lateral).map(|(run, plan)| {
        let tissue = Flaws::new(background, run).tissue(0);
        lateral::touched(&world, plan.axis, MM * plan.depth_mm, &|depth_m| tissue.at(depth_m))
    });
    let insertion = (0..).zip(&design.insertion).map(|(run, plan)| {
        let tissue = Flaws::new(background, run).tissue(1);
        let steps = 200;
        (0..steps).map(|step| tissue.at(middle_depth_m(step, steps, plan.depth_mm))).sum::<f64>()
            / steps as f64
    });
    let factors: Vec<f64> = if design.lateral.is_empty() { insertion.collect() } else { lateral.collect() };
    factors.iter().sum::<f64>() / factors.len().max(1) as f64
}

fn middle_depth_m(step: usize, steps: usize, depth_mm: f64) -> f64 {
    (step as f64 + 0.5) / steps as f64 * MM * depth_mm
}

#[cfg(test)]
mod background_tests;
#[cfg(test)]
mod forward_tests;
#[cfg(test)]
mod tests;
