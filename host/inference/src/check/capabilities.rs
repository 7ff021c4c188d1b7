//! The runs of a session that each workflow can use, by the workflow's own checks and without a fit.

use super::{Capability, Skipped};
use diagnose::{DiagnoseError, data_split};
use formats::session::Session;
use identify::examine;
use insertion::TipPath;
use track::dynamics;

/// Smallest depth up to which an insertion can be observed, millimetres: the smallest `guide predict --until`.
const MIN_UNTIL_MM: f64 = 5.0;
/// Smallest number of depth bins for a prediction.
const MIN_BINS: usize = 3;

/// The workflows, in the order in which they are used.
pub fn of(session: &Session) -> Vec<Capability> {
    let mut abilities = vec![identify(session), predict(session), track(session), diagnose(session)];
    let able: Vec<String> =
        abilities.iter().filter(|ability| ability.usable).map(|ability| ability.command.to_owned()).collect();
    let mut report = Capability::new("report");
    report.usable = !able.is_empty();
    if able.is_empty() {
        report.lacks("nothing to report".to_owned());
    } else {
        report.remarks.push(format!("includes {}", able.join(", ")));
    }
    abilities.push(report);
    abilities
}

impl Capability {
    fn new(command: &'static str) -> Self {
        Self { command, usable: false, runs: Vec::new(), skipped: Vec::new(), remarks: Vec::new() }
    }

    fn lacks(&mut self, reason: String) {
        self.skipped.push(Skipped { id: None, reason });
    }

    fn skips(&mut self, id: &str, reason: String) {
        self.skipped.push(Skipped { id: Some(id.to_owned()), reason });
    }
}

fn identify(session: &Session) -> Capability {
    let mut ability = Capability::new("identify");
    if session.lateral.is_empty() && session.indentation.is_empty() {
        ability.lacks("no [[lateral]] runs".to_owned());
    }
    for run in &session.lateral {
        match examine(session, run, &identify::Options::default()) {
            Ok(warnings) => {
                ability.runs.push(run.id.clone());
                ability.remarks.extend(warnings.iter().map(|warning| format!("{}: {warning}", run.id)));
            }
            Err(why) => ability.skips(&run.id, why.to_string()),
        }
    }
    if session.tissue.walls.is_none() && session.lateral.iter().any(|run| run.depth_m > 0.0) {
        ability.remarks.push(
            "E depends on the walls of the tissue: without them, E of a gel of 60 mm is wrong by a third in a box and by half or more if the gel stands free; state body_mm, needle_at_mm, \
             sides and far_side in [tissue], or sides = \"far\" where no wall is near (K does not need them)"
                .to_owned(),
        );
    }
    ability.usable = !ability.runs.is_empty();
    let references = session.indentation.len();
    if session.lateral.is_empty() && references > 0 {
        // Young's modulus from the indentations alone.
        ability.usable = true;
        ability.runs = session.indentation.iter().map(|run| run.id.clone()).collect();
    } else if references > 0 {
        let plural = if references == 1 { "" } else { "s" };
        ability.remarks.push(format!("compares with {references} indentation{plural}"));
    }
    ability
}

fn predict(session: &Session) -> Capability {
    let mut ability = Capability::new("predict");
    if session.insertion.is_empty() {
        ability.lacks("no [[insertion]]".to_owned());
    }
    // The first and last depth up to which every insertion can be observed.
    let (mut from_depth_mm, mut to_depth_mm) = (MIN_UNTIL_MM, f64::INFINITY);
    for run in &session.insertion {
        let path = match TipPath::new(run) {
            Ok(path) => path,
            Err(why) => {
                ability.skips(&run.id, format!("{}: {why}", run.path.display()));
                continue;
            }
        };
        let Some(begins) = path.bins.get(MIN_BINS - 1) else {
            let bin_count = path.bins.len();
            ability.skips(&run.id, format!("{bin_count} depths, expected {MIN_BINS} or more"));
            continue;
        };
        from_depth_mm = from_depth_mm.max((1e3 * begins.depth_m).ceil());
        to_depth_mm = to_depth_mm.min((1e3 * path.deepest_m).floor());
        ability.runs.push(run.id.clone());
    }
    ability.usable = !ability.runs.is_empty();
    if ability.usable && from_depth_mm < to_depth_mm {
        ability.remarks.push(format!(
            "with --until {from_depth_mm:.0} to {:.0} mm every insertion has later readings to compare with",
            (to_depth_mm - 1.0).max(from_depth_mm)
        ));
    } else if ability.usable {
        ability.remarks.push("the insertions have no depth in common for --until".to_owned());
    }
    if ability.usable && session.lateral.is_empty() {
        ability
            .remarks
            .push("no lateral runs: the modulus has to come from the insertions, or --k-kpa".to_owned());
    }
    ability
}

fn track(session: &Session) -> Capability {
    let mut ability = Capability::new("track");
    if session.steering.is_empty() {
        ability.lacks("no [[steering]] runs".to_owned());
        return ability;
    }
    match dynamics(session, &track::Options::default()) {
        Ok(_) => ability.runs = session.steering.iter().map(|run| run.id.clone()).collect(),
        Err(why) => ability.lacks(why.to_string()),
    }
    ability.usable = !ability.runs.is_empty();
    if session.fixture_mass_kg.is_none() {
        ability.remarks.push("[rig] fixture_mass_kg is not stated: its inertia is neglected".to_owned());
    }
    ability
}

fn diagnose(session: &Session) -> Capability {
    let mut ability = Capability::new("diagnose");
    match data_split(session) {
        Ok(division) => {
            ability.usable = true;
            ability.runs = division.used;
            division.skipped.into_iter().for_each(|reason| ability.lacks(reason));
            ability.remarks.push(division.rule);
            if division.held_out.is_empty() {
                ability.remarks.push("too little to hold anything out: nothing can be named".to_owned());
            }
        }
        Err(DiagnoseError::NoRuns { .. }) => ability.lacks("no [[lateral]] or [[insertion]]".to_owned()),
        Err(DiagnoseError::AllFailed { reasons }) => {
            reasons.into_iter().for_each(|reason| ability.lacks(reason));
        }
        Err(other) => ability.lacks(other.to_string()),
    }
    ability
}
