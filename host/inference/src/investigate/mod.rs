//! An investigation: diagnose, choose the most informative run per minute, measure, and diagnose again, until one explanation
//! is left or no run would be informative.
//!
//! [`Menu`] has the runs that the rig can make, [`decide`] chooses, [`Log`] is the file in the session's folder that makes the investigation
//! resumable and shows how the probabilities moved.

mod log;
mod menu;

pub use log::{Log, LogError, Step};
pub use menu::{Menu, PlannedRun};

use diagnose::{Diagnosis, Prospect, Prospects, Verdict};
use serde::{Deserialize, Serialize};
use std::fmt::{self, Display};
use std::str::FromStr;

/// Probability from which on a diagnosis makes a statement, a named effect among them.
const DECIDED: f64 = 0.95;
/// Entropy of a statement of that probability, `-0.95 ln 0.95 - 0.05 ln 0.05` nats: a question with a smaller entropy is
/// decided.
const DECIDED_NATS: f64 = 0.198_515;

/// Goal of an investigation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Goal {
    /// Naming the missing effect.
    Name,
    /// A half-width of the 95 % interval of the modulus below this fraction of the modulus.
    Modulus(f64),
}

impl FromStr for Goal {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "name" {
            return Ok(Self::Name);
        }
        let percent: f64 =
            text.strip_prefix("k:").and_then(|number| number.parse().ok()).ok_or_else(expected_goal)?;
        if (0.1..=50.0).contains(&percent) { Ok(Self::Modulus(0.01 * percent)) } else { Err(expected_goal()) }
    }
}

fn expected_goal() -> String {
    "expected `name`, or `k:PERCENT` with 0.1 to 50, as k:3".to_owned()
}

/// Why an investigation ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum End {
    /// The missing effect has a name.
    Named,
    /// No effect is missing, and no run of the menu is expected to show one.
    NothingMissing,
    /// An effect is missing, and no run of the menu is expected to identify it.
    NothingWouldTell,
    /// The modulus is known with the requested accuracy.
    ModulusKnown,
    /// The allowed number of runs is reached.
    MaxRuns,
    /// The person does not want to go on.
    Stopped,
}

impl Display for End {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Named => "the missing effect is named",
            Self::NothingMissing => {
                "no effect is missing, and no further run of this rig is expected to show one"
            }
            Self::NothingWouldTell => {
                "an effect is missing, and no further run of this rig is expected to identify it"
            }
            Self::ModulusKnown => "the modulus is known with the requested accuracy",
            Self::MaxRuns => "the allowed number of runs is reached",
            Self::Stopped => "stopped on request",
        })
    }
}

/// Next step.
#[derive(Debug, Clone, PartialEq)]
pub enum Decision {
    /// Make this run.
    Measure(Box<ChosenRun>),
    /// Stop.
    Stop(End),
}

/// A run and what is expected of it.
#[derive(Debug, Clone, PartialEq)]
pub struct ChosenRun {
    /// The run.
    pub run: PlannedRun,
    /// Expected information of the run.
    pub prospect: Prospect,
}

/// Bounds of an investigation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Runs that may still be made.
    pub runs_left: u32,
    /// Largest lateral force that a run may be expected to reach, N.
    pub force_limit_n: f64,
}

/// The run with the most information per minute, or the reason to stop. A run is worthwhile if the remaining runs, all of its
/// kind, could decide the open question: the information of several runs is at most the sum of that of each.
pub fn decide(
    goal: Goal,
    diagnosis: &Diagnosis,
    prospects: &Prospects,
    runs: Vec<PlannedRun>,
    bounds: Bounds,
) -> Decision {
    let Bounds { runs_left, force_limit_n } = bounds;
    let [low, high] = diagnosis.k_ci95_kpa;
    let reached = match goal {
        Goal::Name if diagnosis.verdict == Verdict::Named => Some(End::Named),
        Goal::Modulus(fraction) if 0.5 * (high - low) <= fraction * diagnosis.k_kpa => {
            Some(End::ModulusKnown)
        }
        Goal::Name if diagnosis.verdict == Verdict::Adequate && prospects.nothing_missing() > DECIDED => {
            Some(End::NothingMissing)
        }
        _ => None,
    };
    if let Some(end) = reached {
        return Decision::Stop(end);
    }
    if runs_left == 0 {
        return Decision::Stop(End::MaxRuns);
    }
    let choices = runs.into_iter().filter_map(|run| {
        let prospect = prospects.runs.iter().find(|prospect| prospect.run == run.plan.id)?.clone();
        (prospect.force_n <= force_limit_n).then_some(ChosenRun { run, prospect })
    });
    let best = choices
        .filter(|choice| match goal {
            Goal::Name => nats(choice, goal) * f64::from(runs_left) > DECIDED_NATS,
            Goal::Modulus(_) => nats(choice, goal) > 0.0,
        })
        .max_by(|a, b| per_minute(a, goal).total_cmp(&per_minute(b, goal)));
    match best {
        Some(choice) => Decision::Measure(Box::new(choice)),
        None if diagnosis.verdict == Verdict::Adequate => Decision::Stop(End::NothingMissing),
        None => Decision::Stop(End::NothingWouldTell),
    }
}

fn per_minute(choice: &ChosenRun, goal: Goal) -> f64 {
    nats(choice, goal) / choice.run.minutes
}

fn nats(choice: &ChosenRun, goal: Goal) -> f64 {
    match goal {
        Goal::Name => choice.prospect.information_nats,
        Goal::Modulus(_) => choice.prospect.modulus_nats,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use diagnose::{Options, diagnose};
    use formats::session::Session;
    use worlds::{Design, Truth};

    fn session(runs: usize) -> Session {
        let truth = Truth { k_kpa: 12.0, tip_load_n: 0.0, effects: Vec::new(), foreign: None };
        let whole = worlds::session(&truth, &Design::four_runs(), 5);
        Session { insertion: Vec::new(), lateral: whole.lateral[..runs].to_vec(), ..whole }
    }

    fn diagnosed(session: &Session, menu: &Menu) -> (Diagnosis, Prospects, Vec<PlannedRun>) {
        let planned = menu.runs(Some(session));
        let plans = planned.iter().map(|run| run.plan.clone()).collect();
        let mut diagnosis =
            diagnose(session, &Options { plans, ..Options::default() }, |_| {}).expect("a diagnosis");
        let prospects = diagnosis.prospects.take().expect("prospects");
        (diagnosis, prospects, planned)
    }

    #[test]
    fn goals_are_read() {
        assert_eq!("name".parse(), Ok(Goal::Name));
        assert_eq!("k:3".parse(), Ok(Goal::Modulus(0.03)));
        for wrong in ["", "k", "k:", "k:0", "k:x", "k:nan", "K:3", "k:51"] {
            assert!(wrong.parse::<Goal>().is_err_and(|why| why.contains("k:PERCENT")), "{wrong}");
        }
    }

    #[test]
    fn a_new_axis_tells_of_anisotropy_and_a_repeat_does_not() {
        let session = session(1);
        let menu = Menu::new(Some(&session), &[], None);
        let (diagnosis, prospects, planned) = diagnosed(&session, &menu);
        let first = &session.lateral[0];
        let [repeat, horizontal] =
            [simulation::simulate::Axis::Y, simulation::simulate::Axis::X].map(|axis| {
                prospect_where(
                    &|run| is_at_first_depth(run, first.depth_m) && run.plan.axis == axis,
                    &planned,
                    &prospects.runs,
                )
            });
        assert!(horizontal.reasons.contains(&"tissue.anisotropy".to_owned()), "{horizontal:?}");
        assert!(horizontal.information_nats > 2.0 * repeat.information_nats, "{horizontal:?} {repeat:?}");
        // Knowledge of the modulus grows with every run, and less than in proportion to noise alone.
        assert!(
            repeat.modulus_nats > 0.0 && repeat.modulus_nats < 0.5 * std::f64::consts::LN_2,
            "{repeat:?}"
        );
        let explained: f64 = prospects.explanations.iter().map(|set| set.probability).sum();
        assert!((0.9..=1.0 + 1e-9).contains(&explained) && prospects.unseen_probability < 1.0);

        let bounds = Bounds { runs_left: 5, force_limit_n: 4.0 };
        let Decision::Measure(choice) = decide(Goal::Name, &diagnosis, &prospects, planned.clone(), bounds)
        else {
            panic!("a run is worth making");
        };
        assert!(
            choice.prospect.information_nats >= horizontal.information_nats - 1e-12
                || choice.run.minutes < 1.0
        );
        assert_eq!(
            decide(Goal::Name, &diagnosis, &prospects, planned.clone(), Bounds { runs_left: 0, ..bounds }),
            Decision::Stop(End::MaxRuns)
        );
        // A force that no run may reach leaves nothing, and a modulus that is known well enough ends at once.
        let forceless = Bounds { force_limit_n: 0.0, ..bounds };
        assert_eq!(
            decide(Goal::Name, &diagnosis, &prospects, planned.clone(), forceless),
            Decision::Stop(End::NothingMissing)
        );
        assert_eq!(
            decide(Goal::Modulus(0.5), &diagnosis, &prospects, planned, bounds),
            Decision::Stop(End::ModulusKnown)
        );
    }

    fn is_at_first_depth(run: &PlannedRun, depth_m: f64) -> bool {
        (run.plan.depth_m - depth_m).abs() < 1e-4
    }

    fn prospect_where<'a>(
        is: &dyn Fn(&PlannedRun) -> bool,
        planned: &[PlannedRun],
        runs: &'a [Prospect],
    ) -> &'a Prospect {
        let run = planned.iter().find(|run| is(run)).expect("a run");
        runs.iter().find(|one| one.run == run.plan.id).expect("a prospect")
    }

    #[test]
    fn more_runs_leave_less_to_tell() {
        let (short, long) = (session(1), session(4));
        assert!(best_modulus_nats(&long) < best_modulus_nats(&short));
    }

    fn best_modulus_nats(session: &Session) -> f64 {
        let (_, prospects, _) = diagnosed(session, &Menu::new(Some(session), &[], None));
        prospects.runs.iter().map(|run| run.modulus_nats).fold(0.0, f64::max)
    }

    #[test]
    fn a_log_goes_on_where_it_was_left() {
        let session = session(1);
        let menu = Menu::new(Some(&session), &[], None);
        let (diagnosis, prospects, planned) = diagnosed(&session, &menu);
        let folder = tempfile::tempdir().expect("a folder");
        let mut log = Log::read(folder.path()).expect("a new log");
        log.push(1, &diagnosis, &prospects);
        let run = planned[0].clone();
        log.choose(&ChosenRun { prospect: prospects.runs[0].clone(), run });
        log.write(folder.path()).expect("written");
        let mut again = Log::read(folder.path()).expect("the same");
        assert_eq!(again.steps, log.steps);
        // The same runs once more take the place of the step.
        again.push(1, &diagnosis, &prospects);
        assert_eq!((again.steps.len(), again.steps[0].realised_nats), (1, None));
        again.push(2, &diagnosis, &prospects);
        assert_eq!(again.steps.len(), 2);
        assert!(
            again.steps[1].realised_nats.is_some_and(|nats| nats < 1e-9),
            "the same probabilities told nothing"
        );
        std::fs::write(folder.path().join("investigation.json"), "{\"steps\": 3}").expect("written");
        let error = Log::read(folder.path()).expect_err("no log").to_string();
        assert!(error.contains("investigation.json:1:") && error.contains("remove it"), "{error}");
    }
}
