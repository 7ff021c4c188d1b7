//! Frames that `guide acquire` has taken while it recorded a run.

use anyhow::{Context, ensure};
use formats::session::{FrameSweep, LateralRun, Session};
use inference::holds::{Hold, HoldCriteria, Path as LevelPath, holds};
use std::path::{Path, PathBuf};

/// A run of the session whose frames were taken while it was recorded.
pub struct RecordedRun {
    /// The run as it is.
    pub run: LateralRun,
    /// Frames of the undisplaced needle, of the first hold at zero displacement, and where guide 2 stood in it.
    pub straight: Option<(PathBuf, [f64; 2])>,
    /// All others.
    pub sweeps: Vec<FrameSweep>,
    /// Where guide 2 stood in each of these, `[x, y]`; nothing outside of every hold.
    pub displacements_mm: Vec<Option<[f64; 2]>>,
}

impl RecordedRun {
    /// Finds the run and its frames.
    pub fn read(session: &Path, id: &str) -> anyhow::Result<Self> {
        let known = Session::read(session)?.lateral;
        let ids: Vec<String> = known.iter().map(|run| run.id.clone()).collect();
        let run = known.into_iter().find(|run| run.id == id);
        let run = run.with_context(|| {
            format!(
                "--run: \"{id}\" is no lateral run of {}, expected one of: {}",
                session.display(),
                ids.join(", ")
            )
        })?;
        let frames_file = session.join(format!("{id}.frames.json"));
        ensure!(
            run.shape.z_m.is_empty() || frames_file.exists(),
            "--run: {id} has a shape that was not measured from frames, expected a run of guide acquire --frames-command"
        );
        let mut sweeps = FrameSweep::read(session, id)?;
        let levels = holds(&run, &HoldCriteria::default());
        let level = |sweep: &FrameSweep| {
            levels.iter().find(|level| (level.time_s[0]..=level.time_s[1]).contains(&sweep.time_s))
        };
        let at_mm = |level: &Hold| {
            let [y_m, x_m] = level.displacement_m();
            [1e3 * x_m, 1e3 * y_m]
        };
        let zero = sweeps.iter().enumerate().find_map(|(at, sweep)| {
            level(sweep).filter(|level| level.path == LevelPath::Zero).map(|level| (at, at_mm(level)))
        });
        let straight = zero.map(|(at, displacement_mm)| (sweeps.remove(at).frames, displacement_mm));
        ensure!(
            !sweeps.is_empty(),
            "--run: {id} has frames of the undisplaced needle only, expected some of a displaced one"
        );
        let displacements_mm = sweeps.iter().map(|sweep| level(sweep).map(at_mm)).collect();
        Ok(Self { run, straight, sweeps, displacements_mm })
    }
}
