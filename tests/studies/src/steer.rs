//! Steering to a target: misses of several controllers on the same plants, which share no computation with the forward model and
//! hide layers, skin, yielding or relaxation, slope, play, process noise of the load and bad readings; and with one more effect each.

pub mod limits;
mod published;

pub use published::Jacobian;

use published::{Aim, Given};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use serde::Serialize;
use steering::{KnownEffect, Options, Outcome, PlantError, Run, SteerError, steer};
use worlds::steering::{Kind, SimulatedPlant, reachable_target, target_by_rotations, world};

/// Depth of the targets, mm.
const DEPTH_MM: f64 = 100.0;

/// Standard deviations that runs in air leave of play, frame and clamp, in the units of their parameters: those of the table of rigs in air.
const KNOWN_SD: [f64; 3] = [0.006, 0.01, 0.02];

/// Who steers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum Controller {
    /// Nobody: the needle is pushed.
    None,
    /// Guide moved in proportion to how far the tip is from the straight way to the target.
    Proportional,
    /// A Jacobian by Broyden's rule and a plan over four steps, as published: towards the target's x and y at once.
    Broyden,
    /// The same along the straight line from the entry point to the target.
    BroydenLine,
    /// The published loop with the Jacobian that it learns taken from the plant itself, without error.
    BroydenNextStop,
    /// The same with what a move does at the target's depth.
    BroydenAtTarget,
    /// The same with where the tip ends there if the guide stays, too.
    BroydenAtTargetWithPath,
    /// The plan at the prior's tissue; readings determine slope and load alone.
    Nominal,
    /// The likeliest tissue, taken for the true one.
    Identified,
    /// The posterior of everything.
    Posterior,
    /// The same with what runs in air have determined of the rig.
    Characterized,
    /// Nobody, with targets for [`Self::HandHeld`].
    HandHeldNone,
    /// The posterior of everything; the needle is held by hand and turned twice at most, guide 2 stands still.
    HandHeld,
    /// Nobody, with targets straight ahead.
    StraightNone,
    /// The published controller with targets straight ahead, as its experiments had them.
    StraightBroyden,
    /// The posterior of everything with targets straight ahead.
    StraightPosterior,
}

impl Controller {
    /// All, the worst first.
    pub const ALL: [Self; 16] = [
        Self::None,
        Self::Proportional,
        Self::Broyden,
        Self::BroydenLine,
        Self::BroydenNextStop,
        Self::BroydenAtTarget,
        Self::BroydenAtTargetWithPath,
        Self::Nominal,
        Self::Identified,
        Self::Posterior,
        Self::Characterized,
        Self::HandHeldNone,
        Self::HandHeld,
        Self::StraightNone,
        Self::StraightBroyden,
        Self::StraightPosterior,
    ];

    /// Whether its targets lie straight ahead of the entry point.
    fn is_straight(self) -> bool {
        matches!(self, Self::StraightNone | Self::StraightBroyden | Self::StraightPosterior)
    }

    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Proportional => "proportional",
            Self::Broyden => "Broyden, as published",
            Self::BroydenLine => "Broyden, along a line",
            Self::BroydenNextStop => "Broyden's loop, the plant's own effect at the next stop",
            Self::BroydenAtTarget => "Broyden's loop, the plant's own effect at the target",
            Self::BroydenAtTargetWithPath => "Broyden's loop, the plant's own effect and path to the target",
            Self::Nominal => "model at the prior's K",
            Self::Identified => "model, likeliest K",
            Self::Posterior => "model, posterior",
            Self::Characterized => "model, posterior, rig characterised",
            Self::HandHeldNone => "hand-held: none",
            Self::HandHeld => "hand-held: model, two rotations",
            Self::StraightNone => "straight ahead: none",
            Self::StraightBroyden => "straight ahead: Broyden, as published",
            Self::StraightPosterior => "straight ahead: model, posterior",
        }
    }
}

/// One run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Ended {
    /// Miss, mm; nothing where the run ended by a fault.
    pub miss_mm: Option<f64>,
    /// Stopped or refused.
    pub stopped: bool,
    /// Limits exceeded.
    pub broken: u64,
    /// Radius, mm, and probability of a smaller miss, as stated before the first push.
    pub stated: Vec<[f64; 2]>,
    /// Slowest replan, s.
    pub slowest_s: f64,
    /// Median replan, s.
    pub median_s: f64,
    /// Decisions whose move was limited, and by what at first.
    pub limited: (usize, &'static str),
    /// Miss that the last plan expected, mm.
    pub expected_mm: f64,
    /// Guide 2 after each stop's decision, mm.
    pub guide_mm: Vec<[f64; 2]>,
}

impl Ended {
    /// Result of a run of which only the end is known.
    fn with_miss(miss_mm: Option<f64>, broken: u64) -> Self {
        Self {
            miss_mm,
            stopped: miss_mm.is_none(),
            broken,
            stated: Vec::new(),
            slowest_s: 0.0,
            median_s: 0.0,
            limited: (0, ""),
            expected_mm: f64::NAN,
            guide_mm: Vec::new(),
        }
    }
}

/// Runs of one controller on plants of one kind.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Further hidden effect.
    pub kind: &'static str,
    /// Who steered.
    pub controller: Controller,
    /// Its runs.
    pub runs: Vec<Ended>,
}

impl Row {
    /// Misses in increasing order, mm.
    pub fn misses_mm(&self) -> Vec<f64> {
        let mut misses: Vec<f64> = self.runs.iter().filter_map(|run| run.miss_mm).collect();
        misses.sort_by(f64::total_cmp);
        misses
    }

    /// Mean miss, mm.
    pub fn mean_mm(&self) -> f64 {
        let misses = self.misses_mm();
        misses.iter().sum::<f64>() / misses.len().max(1) as f64
    }

    /// Miss that this share of the runs does not exceed, mm.
    pub fn quantile_mm(&self, share: f64) -> f64 {
        let misses = self.misses_mm();
        let quantile_index = (share * misses.len().saturating_sub(1) as f64).round() as usize;
        misses.get(quantile_index).copied().unwrap_or(f64::NAN)
    }

    /// Share of misses above a size.
    pub fn above(&self, mm: f64) -> f64 {
        let misses = self.misses_mm();
        misses.iter().filter(|miss| **miss > mm).count() as f64 / misses.len().max(1) as f64
    }

    /// Stated and observed probability of a miss below each radius, mm.
    pub fn calibration(&self) -> Vec<[f64; 3]> {
        let radii = self.runs.iter().find(|run| !run.stated.is_empty()).map(|run| run.stated.clone());
        radii
            .unwrap_or_default()
            .into_iter()
            .enumerate()
            .map(|(i, [radius, _])| {
                let stated_and_miss: Vec<(f64, f64)> =
                    self.runs.iter().filter_map(|run| Some((run.miss_mm?, run.stated.get(i)?[1]))).collect();
                let count = stated_and_miss.len().max(1) as f64;
                let stated = stated_and_miss.iter().map(|(_, stated)| stated).sum::<f64>() / count;
                let observed =
                    stated_and_miss.iter().filter(|(miss, _)| *miss <= radius).count() as f64 / count;
                [radius, stated, observed]
            })
            .collect()
    }
}

/// Runs `count` plants of a kind under a controller, on all cores; every plant has its own stream of the seed. A force limit of the
/// rig's applies to the same targets, some of which are then out of reach.
///
/// # Errors
/// None that a simulated plant has.
pub fn study(
    kind: Kind,
    controller: Controller,
    count: u64,
    seed: u64,
    force_limit_n: Option<f64>,
) -> Result<Row, PlantError> {
    let runs: Result<Vec<Ended>, PlantError> = (0..count)
        .into_par_iter()
        .map(|number| {
            let mut plant = world(kind, seed, number);
            let target_mm = if matches!(controller, Controller::HandHeld | Controller::HandHeldNone) {
                plant.stated.limits.guide_travel_mm = 0.0;
                target_by_rotations(&plant, DEPTH_MM, seed, number)?
            } else if controller.is_straight() {
                [0.0, 0.0, DEPTH_MM]
            } else {
                reachable_target(&plant, DEPTH_MM, seed, number)?
            };
            if let Some(limit_n) = force_limit_n {
                plant.stated.limits.guide_force_n = Some(limit_n);
            }
            one(plant, target_mm, controller, seed, number)
        })
        .collect();
    Ok(Row { kind: kind.name(), controller, runs: runs? })
}

fn one(
    mut plant: SimulatedPlant,
    target_mm: [f64; 3],
    controller: Controller,
    seed: u64,
    number: u64,
) -> Result<Ended, PlantError> {
    let options = Options::new(target_mm);
    let options = match controller {
        Controller::None | Controller::HandHeldNone | Controller::StraightNone => {
            Options { steered: false, ..options }
        }
        Controller::Nominal => Options { tissue_known: true, ..options },
        Controller::Identified => Options { caution: 0.0, ..options },
        Controller::Posterior | Controller::StraightPosterior => options,
        Controller::Characterized => Options { rig: known(&plant, seed, number), ..options },
        Controller::HandHeld => Options { rotations: 2, ..options },
        Controller::Proportional => return published::proportional(plant, target_mm, seed, number),
        Controller::Broyden | Controller::StraightBroyden => {
            return published::broyden(plant, target_mm, Aim::Target, Given::Nothing);
        }
        Controller::BroydenLine => return published::broyden(plant, target_mm, Aim::Line, Given::Nothing),
        Controller::BroydenNextStop => {
            return published::broyden(plant, target_mm, Aim::Target, Given::NextStop);
        }
        Controller::BroydenAtTarget => {
            return published::broyden(plant, target_mm, Aim::Target, Given::AtTarget);
        }
        Controller::BroydenAtTargetWithPath => {
            return published::broyden(plant, target_mm, Aim::Target, Given::AtTargetWithPath);
        }
    };
    match steer(&mut plant, &options, &mut |_| {}) {
        Ok(run) => Ok(ended(&run)),
        Err(SteerError::Plant(error)) => Err(error),
        Err(_) => Ok(Ended::with_miss(None, 0)),
    }
}

/// Parameters of a plant's rig that runs in air have determined: the truth within standard deviations that
/// they have.
fn known(plant: &SimulatedPlant, seed: u64, number: u64) -> Vec<KnownEffect> {
    let mut random = ChaCha8Rng::seed_from_u64(seed ^ number.wrapping_mul(0x9E37_79B9_7F4A_7C15));
    plant.rig().into_iter().zip(KNOWN_SD).map(|(effect, sd)| known_effect(effect, sd, &mut random)).collect()
}

fn known_effect((id, value): (&str, f64), sd: f64, random: &mut ChaCha8Rng) -> KnownEffect {
    let error: f64 = StandardNormal.sample(random);
    KnownEffect { id: id.to_owned(), values: vec![(value + sd * error).max(0.0)], sds: vec![sd] }
}

fn ended(run: &Run) -> Ended {
    Ended {
        miss_mm: run.miss_mm.filter(|_| !matches!(run.outcome, Outcome::Refused { .. })),
        stopped: run.outcome != Outcome::Arrived,
        broken: run.end.as_ref().and_then(|end| end.limits_broken).map_or(0, |broken| broken.total()),
        stated: run.within_before.iter().map(|one| [one.radius_mm, one.probability]).collect(),
        slowest_s: run.slowest_replan_s,
        median_s: run.median_replan_s,
        limited: {
            let mut limited = run.decisions.iter().filter_map(|one| one.limited_by);
            let first = limited.next();
            (first.map_or(0, |_| 1 + limited.count()), first.unwrap_or(""))
        },
        expected_mm: run.decisions.last().map_or(f64::NAN, |last| {
            miss_in(0, last.expected_tip_mm, run.target_mm).hypot(miss_in(
                1,
                last.expected_tip_mm,
                run.target_mm,
            ))
        }),
        guide_mm: run.decisions.iter().map(|one| one.guide_to_mm).collect(),
    }
}

fn miss_in(plane: usize, expected_tip_mm: [f64; 2], target_mm: [f64; 3]) -> f64 {
    expected_tip_mm[plane] - target_mm[plane]
}
