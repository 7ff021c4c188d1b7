//! The runs that a rig can make next.

use formats::session::Session;
use simulation::simulate::{Axis, LateralPlan, SweepLevels};

const MM: f64 = 1e-3;
/// Levels of a staircase as multiples of the largest: up, down and through zero, so that friction, clearance and creep have an
/// effect on the readings.
const STAIRCASE: [f64; 9] = [0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0, 2.0 / 3.0, 0.0, -0.5, -1.0, 0.0];
/// Duration of a hold in a staircase, and in a run that waits for creep, s.
const HOLD_S: f64 = 3.0;
const LONG_HOLD_S: f64 = 30.0;
/// Speeds of guide 2, m/s.
const SPEED_M_PER_S: f64 = 1e-3;
const FAST_M_PER_S: f64 = 10e-3;
/// Readings per second of a planned run where the session has none.
const RATE_HZ: f64 = 20.0;
/// Depths for a rig without any statement, mm: usual depths of laboratories.
const DEPTHS_MM: [f64; 3] = [20.0, 30.0, 40.0];
/// Largest displacement of guide 2 for such a rig, mm.
const DISPLACEMENT_MM: f64 = 1.2;
/// Distance by which another depth is proposed beyond those measured, mm.
const DEEPER_MM: f64 = 10.0;

/// Runs that the rig and the person can make.
#[derive(Debug, Clone, PartialEq)]
pub struct Menu {
    /// Depths to which the needle may be brought, mm.
    pub depths_mm: Vec<f64>,
    /// Axes along which guide 2 moves.
    pub axes: Vec<Axis>,
    /// Largest displacement of guide 2 in an ordinary run, and the largest that is allowed, mm.
    pub displacement_mm: [f64; 2],
    /// Minutes that a change of depth takes.
    pub change_min: f64,
    /// Whether only the present depth is possible, because no person is there to change it.
    pub stays: bool,
}

/// A run of the menu.
#[derive(Debug, Clone, PartialEq)]
pub struct PlannedRun {
    /// Plan of the run.
    pub plan: LateralPlan,
    /// Minutes that it takes, with the change of depth before it.
    pub minutes: f64,
    /// Whether the needle has to be brought to another depth.
    pub is_elsewhere: bool,
    /// In words.
    pub words: String,
}

impl Menu {
    /// Menu for a session, which may have no run yet. Stated bounds replace those that the session suggests.
    pub fn new(session: Option<&Session>, depths_mm: &[f64], displacement_mm: Option<f64>) -> Self {
        let measured =
            || session.into_iter().flat_map(|session| &session.lateral).filter(|run| !run.is_in_air());
        let mut depths: Vec<f64> = if depths_mm.is_empty() {
            measured().map(|run| run.depth_m / MM).collect()
        } else {
            depths_mm.to_vec()
        };
        depths.sort_by(f64::total_cmp);
        depths.dedup_by(|a, b| (*a - *b).abs() < 0.5);
        match depths.last().copied() {
            None => depths.extend(DEPTHS_MM),
            Some(deepest) if depths_mm.is_empty() => depths.push(deepest + DEEPER_MM),
            Some(_) => {}
        }
        let moved_mm = measured()
            .flat_map(|run| {
                run.force.displacement_y_m.iter().chain(run.force.displacement_x_m.iter().flatten())
            })
            .fold(0.0, |most: f64, moved_m| most.max(moved_m.abs() / MM));
        // Readings are noisy, so that a requested displacement is taken to be a multiple of a tenth of a millimetre.
        let usual_mm = (10.0 * moved_mm).round() / 10.0;
        let usual_mm = if usual_mm > 0.0 { usual_mm } else { DISPLACEMENT_MM };
        let most_mm = displacement_mm.unwrap_or(2.0 * usual_mm);
        Self {
            depths_mm: depths,
            axes: vec![Axis::Y, Axis::X],
            displacement_mm: [usual_mm.min(most_mm), most_mm],
            change_min: 3.0,
            stays: false,
        }
    }

    /// The runs, each with a name that the session does not have.
    pub fn runs(&self, session: Option<&Session>) -> Vec<PlannedRun> {
        let present_mm = session.and_then(|session| session.lateral.last()).map(|run| run.depth_m / MM);
        let present_mm = present_mm.filter(|depth_mm| *depth_mm > 0.0);
        let middle_mm = self.depths_mm.get(self.depths_mm.len() / 2).copied();
        let is_present =
            |depth_mm: f64| present_mm.is_none_or(|present_mm| (depth_mm - present_mm).abs() < 0.5);
        let rate_hz = session.and_then(rate_hz).unwrap_or(RATE_HZ);
        let [usual_mm, most_mm] = self.displacement_mm;
        let mut runs = Vec::new();
        let add = |depth_mm: f64, axis: Axis, kind: Kind, runs: &mut Vec<PlannedRun>| {
            let largest_mm = if kind == Kind::Larger { most_mm } else { usual_mm };
            let plan = plan(depth_mm, axis, kind, largest_mm, rate_hz);
            let is_elsewhere = !is_present(depth_mm);
            let change_min = if is_elsewhere { self.change_min } else { 0.0 };
            let words = words(&plan, kind);
            let minutes = duration_s(&plan) / 60.0 + change_min;
            let id = free_name(&plan.id, session, runs);
            runs.push(PlannedRun { plan: LateralPlan { id, ..plan }, minutes, is_elsewhere, words });
        };
        for depth_mm in
            self.depths_mm.iter().copied().chain(present_mm.filter(|depth_mm| !self.has(*depth_mm)))
        {
            if self.stays && !is_present(depth_mm) {
                continue;
            }
            for axis in &self.axes {
                add(depth_mm, *axis, Kind::Staircase, &mut runs);
            }
        }
        if let (Some(depth_mm), Some(axis)) = (present_mm.or(middle_mm), self.axes.first()) {
            if most_mm > usual_mm {
                add(depth_mm, *axis, Kind::Larger, &mut runs);
            }
            add(depth_mm, *axis, Kind::LongHold, &mut runs);
            add(depth_mm, *axis, Kind::Fast, &mut runs);
        }
        runs
    }

    /// The run to begin with: a staircase at the middle depth.
    pub fn first(&self) -> Option<PlannedRun> {
        let runs = self.runs(None);
        let middle_mm = self.depths_mm.get(self.depths_mm.len() / 2)?;
        runs.into_iter().find(|run| (run.plan.depth_m / MM - middle_mm).abs() < 0.5)
    }

    fn has(&self, depth_mm: f64) -> bool {
        self.depths_mm.iter().any(|one| (one - depth_mm).abs() < 0.5)
    }
}

/// Kinds of runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Staircase,
    Larger,
    LongHold,
    Fast,
}

fn plan(depth_mm: f64, axis: Axis, kind: Kind, largest_mm: f64, rate_hz: f64) -> LateralPlan {
    let largest_m = MM * largest_mm;
    let levels_m: Vec<f64> = match kind {
        Kind::LongHold => vec![0.0, largest_m, 0.0],
        _ => STAIRCASE.iter().map(|level| level * largest_m).collect(),
    };
    let letter = if axis == Axis::Y { "y" } else { "x" };
    let suffix = match kind {
        Kind::Staircase => "",
        Kind::Larger => "-large",
        Kind::LongHold => "-hold",
        Kind::Fast => "-fast",
    };
    LateralPlan {
        id: format!("{letter}{depth_mm:.0}{suffix}"),
        depth_m: MM * depth_mm,
        axis,
        levels_m,
        hold_s: if kind == Kind::LongHold { LONG_HOLD_S } else { HOLD_S },
        ramp_m_per_s: if kind == Kind::Fast { FAST_M_PER_S } else { SPEED_M_PER_S },
        rate_hz,
        sweep_levels: SweepLevels::Extremes,
        spacing_m: MM,
    }
}

fn words(plan: &LateralPlan, kind: Kind) -> String {
    let axis = if plan.axis == Axis::Y { "y" } else { "x" };
    let largest_mm = plan.levels_m.iter().fold(0.0, |most: f64, level_m| most.max(level_m.abs() / MM));
    let run = match kind {
        Kind::Staircase => "a staircase",
        Kind::Larger => "a larger staircase",
        Kind::LongHold => "holds of 30 s",
        Kind::Fast => "a staircase with ramps of 10 mm/s",
    };
    format!("{run} along {axis} to {largest_mm:.1} mm at {:.0} mm depth", plan.depth_m / MM)
}

/// Length of a run, s.
fn duration_s(plan: &LateralPlan) -> f64 {
    let path_m: f64 = plan.levels_m.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum();
    plan.hold_s * plan.levels_m.len() as f64 + path_m / plan.ramp_m_per_s
}

/// The first of `name-1`, `name-2` and so on that is free.
fn free_name(name: &str, session: Option<&Session>, planned: &[PlannedRun]) -> String {
    let is_taken = |id: &String| {
        session.is_some_and(|session| session.lateral.iter().any(|run| run.id == *id))
            || planned.iter().any(|run| run.plan.id == *id)
    };
    (1..).map(|number: usize| format!("{name}-{number}")).find(|id| !is_taken(id)).unwrap_or_default()
}

/// Readings of force per second in the last run.
fn rate_hz(session: &Session) -> Option<f64> {
    let time_s = &session.lateral.last()?.force.time_s;
    let length_s = time_s.last()? - time_s.first()?;
    (length_s > 0.0).then(|| ((time_s.len() - 1) as f64 / length_s).clamp(RATE_HZ, 1000.0))
}
