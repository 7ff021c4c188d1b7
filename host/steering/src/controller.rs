//! The run: push, rest, estimate, plan, move, until the target's depth is reached or the supervisor stops.

mod compare;
mod decide;
mod error;
mod forecast;
mod limits;
mod motion;
mod offline;
mod rotate;

use crate::estimator::{AtTarget, Hypothesis};
use crate::history::History;
use crate::known::KnownEffect;
use crate::planner::{self, Weighted};
use crate::plant::Plant;
use crate::protocol::{Command, End, Statement};
use crate::readings::Readings;
use crate::results::{Decision, Event, LimitRisk, Outcome, Probability, Run};
use crate::tables::Path;
use crate::unknowns::{CuttingLaw, Unknowns};
use compare::Predicted;
pub use error::SteerError;
use nalgebra::DMatrix;
pub use offline::plan_path;

/// Radii for which probabilities are stated, mm.
const RADII_MM: [f64; 5] = [0.25, 0.5, 1.0, 2.0, 4.0];
/// Share of a limit that is used.
const SHARE_OF_TRAVEL: f64 = 0.98;
const SHARE_OF_SPEED: f64 = 0.9;
const SHARE_OF_FORCE: f64 = 0.8;
/// Share of the force limit at which the needle is stopped and the force relieved.
const SHARE_THAT_STOPS: f64 = 0.9;
/// Moves below this are not made, mm.
const SMALLEST_MOVE_MM: f64 = 0.02;
/// Silence of the tip sensor while the needle is pushed that leads to a hold, and what is then waited, s of the plant.
const SILENCE_S: f64 = 2.0;
/// Difference of commanded and reported depth beyond which the needle is not where it was pushed: it was released, or it is stuck, mm.
const DEPTH_ERROR_MM: f64 = 2.0;

/// Time for coming to rest, s: a guide move that is one step ([`RigStatement::guide_moves_in_one_step`](crate::RigStatement)) lasts
/// so much longer than its way takes at the speed at which it is made.
pub const GUIDE_SETTLING_S: f64 = 0.3;

/// A plan that misses by less never stops a run, mm.
const MISS_THAT_STOPS_MM: f64 = 2.0;

/// Options of a steered insertion.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Options {
    /// Target: x, y, depth, mm.
    pub target_mm: [f64; 3],
    /// Distance of rests, mm.
    pub rest_every_mm: f64,
    /// Speed of pushing, mm/s, where the plant allows it.
    pub push_speed_mm_s: f64,
    /// Weight of the uncertain part of the squared miss.
    pub caution: f64,
    /// Squared miss per squared move at the start; it falls towards the target's depth, where little is left to be corrected.
    pub effort: f64,
    /// Largest move at one rest, mm.
    pub largest_move_mm: f64,
    /// Whether the tissue is taken as the prior's mean, whatever the readings are: what a controller without identification does.
    #[serde(default)]
    pub tissue_known: bool,
    /// Number of turns of the needle that are allowed, if the plant can; 0: guide moves only.
    #[serde(default)]
    pub rotations: usize,
    /// Whether tip cutting at an angle is considered.
    pub cut_angle: bool,
    /// Whether anything is moved.
    pub steered: bool,
    /// Rig as characterized by its runs in air.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rig: Vec<KnownEffect>,
}

impl Options {
    /// For a target: x, y, depth, mm.
    pub fn new(target_mm: [f64; 3]) -> Self {
        Self {
            target_mm,
            rest_every_mm: 5.0,
            push_speed_mm_s: 4.0,
            caution: 1.5,
            effort: 0.2,
            largest_move_mm: 3.0,
            tissue_known: false,
            rotations: 0,
            cut_angle: true,
            steered: true,
            rig: Vec::new(),
        }
    }
}

/// Steers a plant to a target; `on_event` is called for everything that happens, in order.
///
/// # Errors
/// [`SteerError`]; the plant is then left where it is.
pub fn steer(
    plant: &mut dyn Plant,
    options: &Options,
    on_event: &mut dyn FnMut(&Event),
) -> Result<Run, SteerError> {
    let stated = plant.start()?;
    stated.check()?;
    on_event(&Event::Statement(&stated));
    check_target(&stated, options)?;
    let mut controller = Controller::new(plant, &stated, options, on_event)?;
    controller.run()
}

/// Whether a target and what is requested for it can be begun with.
fn check_target(stated: &Statement, options: &Options) -> Result<(), SteerError> {
    let depth_mm = options.target_mm[2];
    for (name, value, good, expected) in [
        ("x", options.target_mm[0], true, "a finite number".to_owned()),
        ("y", options.target_mm[1], true, "a finite number".to_owned()),
        (
            "depth",
            depth_mm,
            depth_mm >= 5.0 && depth_mm <= stated.max_depth_mm + 1e-9,
            format!("5 to {} mm", stated.max_depth_mm),
        ),
    ] {
        if !good || !value.is_finite() {
            return Err(SteerError::Target { name, value, expected });
        }
    }
    if options.rotations > 0 && !stated.rig.can_rotate {
        return Err(SteerError::CannotRotate);
    }
    Ok(())
}

/// Predictions of all laws.
struct Posterior {
    at: Vec<(f64, AtTarget)>,
}

impl Posterior {
    fn weighted(&self) -> Vec<Weighted<'_>> {
        self.at.iter().map(|(weight, at)| Weighted { weight: *weight, at }).collect()
    }
}

struct Controller<'a> {
    plant: &'a mut dyn Plant,
    stated: &'a Statement,
    options: &'a Options,
    on_event: &'a mut dyn FnMut(&Event),
    laws: Vec<Hypothesis>,
    history: History,
    readings: Readings,
    /// Paths as last expected by the likeliest law.
    expected: [Path; 2],
    last: Command,
    /// Force at guide 2 before anything was done, as the mean of so many readings, N.
    zero_force: ([f64; 2], f64),
    /// Squared deviations of these readings from their mean, summed over both axes, N^2.
    zero_squares_n2: f64,
    force_n: Option<[f64; 2]>,
    /// The same since something last moved, as the mean of so many readings, N.
    still_force: ([f64; 2], f64),
    peak_force_n: Option<f64>,
    decisions: Vec<Decision>,
    rests: Vec<usize>,
    within_before: Vec<Probability>,
    limits_before: Vec<LimitRisk>,
    reachable_m: Vec<[f64; 2]>,
    replans_s: Vec<f64>,
    /// Time for which the needle was pushed since the last good reading of the tip, s.
    pushed_blind_s: f64,
    /// Rotations made so far.
    rotations_made: usize,
    /// Covariance of the likeliest law's unknowns, by the last posterior.
    covariance: Option<DMatrix<f64>>,
    /// What is expected of the readings up to the next stop.
    predicted: Option<Predicted>,
}

impl<'a> Controller<'a> {
    fn new(
        plant: &'a mut dyn Plant,
        stated: &'a Statement,
        options: &'a Options,
        on_event: &'a mut dyn FnMut(&Event),
    ) -> Result<Self, SteerError> {
        let target_m = 1e-3 * options.target_mm[2];
        let mut laws =
            vec![Hypothesis::new(Unknowns::new(stated, &options.rig, CuttingLaw::Load, target_m)?, 0.9)];
        if options.cut_angle {
            laws.push(Hypothesis::new(
                Unknowns::new(stated, &options.rig, CuttingLaw::Angle, target_m)?,
                0.1,
            ));
        }
        laws.iter_mut().for_each(|law| law.tissue_known = options.tissue_known);
        let bevel_rad = stated.bevel_deg.to_radians();
        let history = History::new(target_m, 0.5e-3 * options.rest_every_mm, bevel_rad);
        let expected = laws[0].paths(&history)?;
        let every_m = 1e-3 * options.rest_every_mm;
        let mut rest_nodes: Vec<usize> = Vec::new();
        let mut stop_m = every_m;
        while stop_m < target_m - 0.5 * every_m {
            let node = history.depths_m.partition_point(|m| *m < stop_m - 1e-6);
            if node < history.depths_m.len() - 1 {
                rest_nodes.push(node);
            }
            stop_m += every_m;
        }
        rest_nodes.dedup();
        Ok(Self {
            plant,
            stated,
            options,
            on_event,
            laws,
            history,
            readings: Readings::new(1e-3 * stated.tip_noise_mm, stated.tip_delay_s, 1.0 / stated.tip_rate_hz),
            expected,
            last: Command { bevel_deg: stated.bevel_deg, ..Command::default() },
            zero_force: ([0.0; 2], 0.0),
            zero_squares_n2: 0.0,
            force_n: None,
            still_force: ([0.0; 2], 0.0),
            peak_force_n: None,
            decisions: Vec::new(),
            rests: rest_nodes,
            within_before: Vec::new(),
            limits_before: Vec::new(),
            reachable_m: Vec::new(),
            replans_s: Vec::new(),
            pushed_blind_s: 0.0,
            rotations_made: 0,
            covariance: None,
            predicted: None,
        })
    }

    fn run(&mut self) -> Result<Run, SteerError> {
        let refused = self.forecast()?;
        (self.on_event)(&Event::Forecast {
            reachable_mm: self.reachable_m.iter().map(|corner| corner.map(|m| 1e3 * m)).collect(),
            within: self.within_before.clone(),
            limits: self.limits_before.clone(),
        });
        if let Some(refused) = refused {
            let end = self.plant.end()?;
            (self.on_event)(&Event::End(&end));
            return Ok(self.result(refused, [0.0; 2], [0.0; 3], end));
        }
        self.rest(self.settling())?;
        self.expect(self.force_at_stop());
        let mut outcome = Outcome::Arrived;
        for node in 1..self.history.depths_m.len() {
            self.push_to(node)?;
            if !self.rests.contains(&node) {
                continue;
            }
            self.rest(self.settling())?;
            if let Some(stopped) = self.decide(node)? {
                outcome = stopped;
                break;
            }
        }
        self.rest(self.settling())?;
        let posterior = self.update(&[])?;
        let (tip_m, covariance_m2) = planner::outcome(&posterior.weighted(), [0.0; 2], &[]);
        let end = self.plant.end()?;
        (self.on_event)(&Event::End(&end));
        Ok(self.result(outcome, tip_m, covariance_m2, end))
    }

    /// Paths as they are now expected.
    fn refresh(&mut self) -> Result<(), SteerError> {
        let best = self.best();
        self.expected = self.laws[best].paths(&self.history)?;
        Ok(())
    }

    fn best(&self) -> usize {
        (0..self.laws.len())
            .max_by(|a, b| self.ln_evidence_of(a).total_cmp(&self.ln_evidence_of(b)))
            .unwrap_or(0)
    }

    fn ln_evidence_of(&self, i: &usize) -> f64 {
        self.laws[*i].ln_evidence
    }

    /// Takes all readings in; gains are those of the rests given.
    fn update(&mut self, rests: &[usize]) -> Result<Posterior, SteerError> {
        let mut posteriors = Vec::with_capacity(self.laws.len());
        for law in &mut self.laws {
            posteriors.push(law.update(&self.readings.bins, &self.history, rests)?);
        }
        self.covariance = posteriors.get(self.best()).map(|likeliest| likeliest.covariance.clone());
        let most = self.laws.iter().map(|law| law.ln_evidence).fold(f64::NEG_INFINITY, f64::max);
        let weights: Vec<f64> = self.laws.iter().map(|law| (law.ln_evidence - most).exp()).collect();
        let total: f64 = weights.iter().sum();
        let weighted =
            posteriors.into_iter().zip(weights).map(|(posteriors, weight)| (weight / total, posteriors));
        let weighted_posteriors = weighted.filter(|(weight, _)| *weight > 1e-3).collect();
        self.refresh()?;
        Ok(Posterior { at: weighted_posteriors })
    }

    fn result(&mut self, outcome: Outcome, tip_m: [f64; 2], covariance_m2: [f64; 3], end: End) -> Run {
        let target_mm = self.options.target_mm;
        let tip_mm = tip_m.map(|m| 1e3 * m);
        let truth = end.true_tip_x_mm.zip(end.true_tip_y_mm);
        let tip = truth.map_or(tip_mm, |(x, y)| [x, y]);
        let miss_mm = (tip[0] - target_mm[0]).hypot(tip[1] - target_mm[1]);
        let mut replans_s = std::mem::take(&mut self.replans_s);
        replans_s.sort_by(f64::total_cmp);
        Run {
            outcome,
            target_mm,
            depth_mm: end.depth_mm,
            miss_mm: Some(miss_mm),
            miss_is_measured: truth.is_none(),
            estimated_tip_mm: tip_mm,
            covariance_mm2: covariance_m2.map(|m2| 1e6 * m2),
            reachable_mm: self.reachable_m.iter().map(|corner| corner.map(|m| 1e3 * m)).collect(),
            within_before: std::mem::take(&mut self.within_before),
            limits_before: std::mem::take(&mut self.limits_before),
            within_after: self.within(tip_m, covariance_m2),
            unsteered_miss_mm: self.unsteered_miss_mm().unwrap_or(f64::NAN),
            readings: self.readings.counts[0],
            readings_rejected: self.readings.counts[1],
            peak_force_n: self.peak_force_n,
            rotations: self.rotations_made,
            duration_s: self.last.t_s,
            slowest_replan_s: replans_s.last().copied().unwrap_or(0.0),
            median_replan_s: replans_s.get(replans_s.len() / 2).copied().unwrap_or(0.0),
            end: Some(end),
            decisions: std::mem::take(&mut self.decisions),
        }
    }
}
