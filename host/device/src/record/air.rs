//! Runs in air: what guide 2 does so that the rig's own mechanics show themselves, and which of these runs a session has already.
//!
//! The needle is in both guides and in nothing else. Guide 2 makes small holds on both sides of zero, which show what is loose and what
//! rubs, and large ones, which show what gives way, each level approached from both sides. The needle is the spring; how far it is bent is
//! limited by the force and by the strain that it bears without staying bent.

use crate::link::program::{PlannedStep, Program, milliseconds, move_to};
use formats::session::{LateralRun, Session, Setup};
use protocol::Step;
use std::fmt;

/// Levels as a share of the largest: up, down and back.
const LEVELS: [f64; 19] = [
    0.0, 0.0375, 0.075, 0.15, 0.5, 1.0, 0.5, 0.15, 0.075, 0.0375, 0.0, -0.0375, -0.075, -0.15, -0.5, -1.0,
    -0.5, -0.15, 0.0,
];
/// Largest level, force and strain of the needle there, and distance from the end of the travel.
const MAX_LEVEL_MM: f64 = 4.0;
const MAX_FORCE_N: f64 = 1.0;
const MAX_STRAIN: f64 = 0.0025;
const MARGIN_MM: f64 = 0.5;
/// Largest level where nothing is known of what guide 2 bends: a needle in one guide.
const ONE_GUIDE_MM: f64 = 2.0;
/// Below this the small levels are lost in the play of any guide.
const MIN_LEVEL_MM: f64 = 0.8;
const HOLD_S: f64 = 1.5;
const TARE_S: f64 = 1.0;
const SPEED_MM_S: f64 = 2.0;
/// Share of the last hold that makes a run complete.
const COMPLETE: f64 = 0.9;
/// Time of the device for a run beyond its holds and its way: each of its moves settles.
const SETTLING_S: f64 = 1.0;
const BETWEEN_S: f64 = 5.0;

/// A run in air: an axis, and which of its runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AirRun {
    /// 0 for x, 1 for y.
    pub axis: usize,
    /// From 1.
    pub number: usize,
}

impl fmt::Display for AirRun {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "air-{}-{}", ["x", "y"][self.axis.min(1)], self.number)
    }
}

impl AirRun {
    /// Those of a characterisation: both axes, each so often.
    pub fn all(repeats: usize) -> Vec<Self> {
        (1..=repeats).flat_map(|number| [1, 0].map(|axis| Self { axis, number })).collect()
    }

    /// Whether a run is an attempt at this one: it has its name, or that with a number after it.
    fn is_attempt(self, id: &str) -> bool {
        let name = self.to_string();
        let again = |rest: &str| rest.strip_prefix('.').is_some_and(|number| number.parse::<u32>().is_ok());
        id.strip_prefix(&name).is_some_and(|rest| rest.is_empty() || again(rest))
    }

    /// Whether a session has it whole.
    pub fn is_in(self, session: &Session) -> bool {
        session.lateral.iter().any(|run| self.is_attempt(&run.id) && run.is_in_air() && is_whole(run))
    }

    /// A name for the next attempt, which the session does not have.
    pub fn free_id(self, session: Option<&Session>) -> String {
        let is_taken =
            |id: &String| session.is_some_and(|session| session.lateral.iter().any(|run| run.id == *id));
        let again = (2..).map(|number: u32| format!("{self}.{number}"));
        let mut names = std::iter::once(self.to_string()).chain(again);
        names.find(|id| !is_taken(id)).unwrap_or_default()
    }

    /// What guide 2 does in it, on a device with this travel. Nothing where the needle cannot be bent far enough for it.
    pub fn program(self, setup: &Setup, travel_mm: f64) -> Option<Program> {
        let largest_mm = largest_level_mm(setup, travel_mm);
        if largest_mm < MIN_LEVEL_MM {
            return None;
        }
        let at = |level_mm: f64| {
            let mut to_mm = [0.0; 2];
            *to_mm.get_mut(self.axis)? = level_mm;
            move_to(to_mm, SPEED_MM_S).ok()
        };
        let hold = Step::Hold { duration_ms: milliseconds(HOLD_S).ok()? };
        let tare = Step::Tare { duration_ms: milliseconds(TARE_S).ok()? };
        let plain = |step| PlannedStep { step, sweep: false };
        let mut steps = vec![plain(at(0.0)?), plain(hold), plain(tare)];
        for (number, share) in LEVELS.iter().enumerate() {
            let sweep = share.abs() == 1.0 || number == 0;
            steps.extend([plain(at(share * largest_mm)?), PlannedStep { step: hold, sweep }]);
        }
        Some(Program { name: self.to_string(), steps })
    }
}

/// How far guide 2 goes: as far as force and strain of the needle, a beam clamped in guide 1, and the device's travel allow.
fn largest_level_mm(setup: &Setup, travel_mm: f64) -> f64 {
    let rig = &setup.rig;
    let length_m = rig.guide2_m;
    let of_needle_mm = if rig.has_one_guide() || length_m <= 0.0 {
        ONE_GUIDE_MM
    } else {
        let stiffness_n_per_m = 3.0 * rig.needle.bending_stiffness_n_m2() / length_m.powi(3);
        let strain_per_m = 1.5 * rig.needle.outer_diameter_m / length_m.powi(2);
        1e3 * (MAX_FORCE_N / stiffness_n_per_m).min(MAX_STRAIN / strain_per_m)
    };
    // Whole hundredths: what the file of a run states is what was commanded.
    (100.0 * of_needle_mm.min(MAX_LEVEL_MM).min(travel_mm - MARGIN_MM)).floor() / 100.0
}

/// Time of the device from the start of a run to that of the next, seconds.
pub fn interval_s(program: &Program) -> f64 {
    let mut at_um = [0; 2];
    let step_s = |planned: &PlannedStep| match planned.step {
        Step::Move { x_um, y_um, speed_um_s } => {
            let way_um = [x_um - at_um[0], y_um - at_um[1]].map(f64::from);
            at_um = [x_um, y_um];
            way_um[0].hypot(way_um[1]) / f64::from(speed_um_s) + SETTLING_S
        }
        Step::Ramp { duration_ms, .. } | Step::Hold { duration_ms } | Step::Tare { duration_ms } => {
            1e-3 * f64::from(duration_ms)
        }
    };
    (program.steps.iter().map(step_s).sum::<f64>() + BETWEEN_S).ceil()
}

/// Whether a run of this program was recorded to its end: its last hold has nearly all of its time.
fn is_whole(run: &LateralRun) -> bool {
    let last = 3 + 2 * LEVELS.len() as u32 - 1;
    let Some(marks) = &run.force.marks else { return false };
    let mut held = marks.iter().zip(&run.force.time_s).filter(|(mark, _)| mark.step == Some(last));
    let (first, end) = (held.next(), held.next_back());
    first.zip(end).is_some_and(|((_, from_s), (_, to_s))| to_s - from_s > COMPLETE * HOLD_S)
}

/// Removes the runs of a characterisation that ended early; their names.
pub fn take_partial(session: &mut Session) -> Vec<String> {
    let is_partial = |run: &LateralRun| {
        let of_plan = ["air-x-", "air-y-"].iter().any(|name| run.id.starts_with(name));
        // Runs of other origin have no marks.
        of_plan && run.is_in_air() && run.force.marks.is_some() && !is_whole(run)
    };
    let partial = session.lateral.iter().filter(|run| is_partial(run)).map(|run| run.id.clone()).collect();
    session.lateral.retain(|run| !is_partial(run));
    partial
}

#[cfg(test)]
mod tests {
    use super::*;
    use formats::session::{ForceSeries, Mark};
    use mechanics::{Needle, Rig};
    use protocol::MAX_STEPS;
    use std::path::PathBuf;

    fn setup(needle: Needle, guide2_m: f64) -> Setup {
        Setup {
            name: String::new(),
            rig: Rig::two_guides(needle, guide2_m, guide2_m + 0.01),
            fixture_mass_kg: None,
            noise: Default::default(),
            tissue: Default::default(),
        }
    }

    fn largest_mm(program: &Program) -> f64 {
        let of = |planned: &PlannedStep| match planned.step {
            Step::Move { x_um, y_um, .. } => f64::from(x_um.abs().max(y_um.abs())) * 1e-3,
            _ => 0.0,
        };
        program.steps.iter().map(of).fold(0.0, f64::max)
    }

    #[test]
    fn a_program_fits_the_device_and_bends_no_needle_for_good() {
        let run = AirRun { axis: 1, number: 2 };
        assert_eq!(run.to_string(), "air-y-2");
        for (diameter_mm, guide2_mm, travel_mm) in
            [(1.27, 60.0, 10.0), (0.7, 40.0, 10.0), (2.1, 50.0, 10.0), (1.27, 60.0, 3.0)]
        {
            let needle = Needle {
                outer_diameter_m: 1e-3 * diameter_mm,
                inner_diameter_m: 0.6e-3 * diameter_mm,
                ..Needle::gauge_18()
            };
            let setup = setup(needle, 1e-3 * guide2_mm);
            let program = run.program(&setup, travel_mm).expect("far enough");
            assert!(program.steps.len() <= MAX_STEPS);
            let far_m = 1e-3 * largest_mm(&program);
            let length_m = setup.rig.guide2_m;
            let force_n = 3.0 * setup.rig.needle.bending_stiffness_n_m2() * far_m / length_m.powi(3);
            let strain = 1.5 * setup.rig.needle.outer_diameter_m * far_m / length_m.powi(2);
            assert!(
                force_n <= 1.0 && strain <= 0.0025 && 1e3 * far_m <= travel_mm - 0.5,
                "{force_n} N, {strain}"
            );
            // One of the bounds is reached.
            assert!(force_n > 0.98 || strain > 0.00245 || 1e3 * far_m > travel_mm - 0.52 || far_m > 3.99e-3);
        }
        assert_eq!(
            run.program(&setup(Needle { outer_diameter_m: 3e-3, ..Needle::gauge_18() }, 0.03), 10.0),
            None
        );
    }

    #[test]
    fn the_next_run_starts_after_the_one_before_has_ended() {
        let program =
            AirRun { axis: 0, number: 1 }.program(&setup(Needle::gauge_18(), 0.06), 10.0).expect("one");
        // 20 holds of 1.5 s, a tare of 1 s, 16 mm at 2 mm/s, 20 moves that settle, 5 s between.
        let interval_s = interval_s(&program);
        assert!((63.0..=68.0).contains(&interval_s), "{interval_s}");
    }

    /// A run whose last step is so long, seconds.
    fn recorded(id: &str, steps: u32, last_s: f64) -> LateralRun {
        let rows = 1 + (last_s * 100.0) as usize;
        let mark = |step| Mark { step: Some(step), moving: Some(false) };
        let marks = (0..steps - 1).map(mark).chain((0..rows).map(|_| mark(steps - 1))).collect::<Vec<_>>();
        let time_s = (0..marks.len()).map(|row| 0.01 * row as f64).collect();
        let force = ForceSeries { time_s, marks: Some(marks), ..Default::default() };
        LateralRun {
            id: id.to_owned(),
            depth_m: 0.0,
            force_path: PathBuf::new(),
            shape_path: PathBuf::new(),
            provenance: Default::default(),
            force,
            shape: Default::default(),
        }
    }

    #[test]
    fn a_run_that_ended_early_counts_as_not_made_and_gets_another_name() {
        let steps = 3 + 2 * LEVELS.len() as u32;
        let mut session = Session {
            dir: PathBuf::new(),
            name: None,
            rig: setup(Needle::gauge_18(), 0.06).rig,
            fixture_mass_kg: None,
            noise: Default::default(),
            tissue: Default::default(),
            lateral: vec![
                recorded("air-y-1", steps, 1.5),
                recorded("air-x-1", steps - 6, 1.5),
                recorded("air-y-2", steps, 0.7),
                recorded("air-y-2.2", steps, 1.49),
                recorded("by-hand", 3, 1.0),
            ],
            insertion: Vec::new(),
            indentation: Vec::new(),
            steering: Vec::new(),
        };
        let made: Vec<bool> = AirRun::all(2).into_iter().map(|run| run.is_in(&session)).collect();
        assert_eq!(made, [true, false, true, false]);
        assert_eq!(AirRun { axis: 0, number: 1 }.free_id(Some(&session)), "air-x-1.2");
        assert_eq!(AirRun { axis: 0, number: 2 }.free_id(Some(&session)), "air-x-2");
        assert_eq!(take_partial(&mut session), ["air-x-1", "air-y-2"]);
        let left: Vec<&str> = session.lateral.iter().map(|run| run.id.as_str()).collect();
        assert_eq!(left, ["air-y-1", "air-y-2.2", "by-hand"]);
    }
}
