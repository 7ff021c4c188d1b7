//! When the shapes of a run were measured: as the user states it, or in the holds of the force series.

use super::ShapeArgs;
use anyhow::{Context, bail, ensure};
use formats::session::{ForceSeries, LateralRun, Provenance, ShapeSeries};
use inference::holds::{Hold, HoldCriteria, Path as LevelPath, holds};
use std::path::{Path, PathBuf};

/// When the shapes of a run were measured.
pub struct SweepTimes {
    /// A time for each; none where a single one belongs to the last hold.
    pub times_s: Option<Vec<f64>>,
    /// Remark on a hold that was chosen among others.
    pub note: Option<String>,
}

/// When each of the shapes was measured: as stated, or in the holds of the force series; a single one belongs to the last hold, and so needs
/// no time.
pub fn times_s(args: &ShapeArgs, id: &str, depth_m: f64, count: usize) -> anyhow::Result<SweepTimes> {
    // A force series is read in any case: its errors are reported before anything is written.
    let force = args
        .force
        .as_deref()
        .map(|path| Ok::<_, anyhow::Error>((path, ForceSeries::read(path)?)))
        .transpose()?;
    if !args.time_s.is_empty() {
        let (given_count, wrong) = (args.time_s.len(), args.time_s.iter().find(|time_s| !time_s.is_finite()));
        ensure!(given_count == count, "--time-s: {given_count} times, expected {count}: one for each file");
        ensure!(wrong.is_none(), "--time-s: {}, expected seconds", wrong.copied().unwrap_or_default());
        return Ok(SweepTimes { times_s: Some(args.time_s.clone()), note: None });
    }
    if count == 1 {
        let note = force.and_then(|(path, force)| {
            last_hold_note(path, force, depth_m, "--time-s SECONDS states when it was measured")
        });
        return Ok(SweepTimes { times_s: None, note });
    }
    let Some((path, force)) = force else {
        bail!(
            "--time-s: missing, expected a time for each of {count} files, or --force to take them from its holds"
        );
    };
    let (displaced, all_times_s) = hold_times_s(path, force, id, depth_m);
    let of_holds =
        [displaced.clone(), all_times_s.clone()].into_iter().find(|times_s| times_s.len() == count);
    let times_s = of_holds.with_context(|| {
        format!(
            "{}: {} holds, {} of them displaced, expected one for each of {count} files; or give --time-s",
            path.display(),
            all_times_s.len(),
            displaced.len()
        )
    })?;
    Ok(SweepTimes { times_s: Some(times_s), note: None })
}

/// Remark on the hold to which a shape without a time belongs, where it is one of several or there is none.
pub fn last_hold_note(path: &Path, force: ForceSeries, depth_m: f64, remedy: &str) -> Option<String> {
    let detected_holds = found_holds(path, force, "", depth_m);
    let displaced: Vec<&Hold> = detected_holds.iter().filter(|level| level.path != LevelPath::Zero).collect();
    let file = path.display();
    match displaced.as_slice() {
        [_] => None,
        [] => Some(format!(
            "{file}: no hold is displaced, and the shape has no time: it belongs to none, expected a rest of the displaced guide ({remedy})"
        )),
        [.., last] => {
            let [start_s, end_s] = last.time_s;
            let [y_mm, x_mm] = last.displacement_m().map(|m| 1e3 * m);
            let x = if x_mm == 0.0 { String::new() } else { format!(", x {x_mm:+.3} mm") };
            Some(format!(
                "{file}: the shape has no time and is taken as that of the last of {} displaced holds: {y_mm:+.3} mm{x}, {start_s:.2} to {end_s:.2} s \
                 ({remedy})",
                displaced.len()
            ))
        }
    }
}

/// The middle of every displaced hold, and of every hold.
fn hold_times_s(path: &Path, force: ForceSeries, id: &str, depth_m: f64) -> (Vec<f64>, Vec<f64>) {
    let detected_holds = found_holds(path, force, id, depth_m);
    let displaced = detected_holds.iter().filter(|level| level.path != LevelPath::Zero);
    (
        displaced.map(|level| middle_s(level.time_s)).collect(),
        detected_holds.iter().map(|level| middle_s(level.time_s)).collect(),
    )
}

/// The holds of a force series.
fn found_holds(path: &Path, force: ForceSeries, id: &str, depth_m: f64) -> Vec<Hold> {
    let run = LateralRun {
        id: id.to_owned(),
        depth_m,
        force_path: path.to_owned(),
        shape_path: PathBuf::new(),
        provenance: Provenance::default(),
        force,
        shape: ShapeSeries::default(),
    };
    holds(&run, &HoldCriteria::default())
}

fn middle_s([from_s, to_s]: [f64; 2]) -> f64 {
    0.5 * (from_s + to_s)
}
