//! Frames that `guide acquire` has taken while it recorded a run.

use anyhow::{Context, ensure};
use formats::session::{ForceSeries, FrameSweep, LateralRun, Session};
use inference::holds::{Hold, HoldCriteria, Mean, Path as LevelPath, holds};
use std::path::{Path, PathBuf};

/// Position of guide 2 in a hold, `[x, y]`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ZeroHold {
    /// Displacement, millimetres.
    pub at_mm: [f64; 2],
    /// Its standard deviation; 0 where the displacement is not measured.
    pub sd_mm: [f64; 2],
}

/// A run of the session whose frames were taken while it was recorded.
pub struct RecordedRun {
    /// The run as it is.
    pub run: LateralRun,
    /// Frames of the undisplaced needle, of the first hold at zero displacement, and where guide 2 stood in it.
    pub straight: Option<(PathBuf, ZeroHold)>,
    /// All others.
    pub sweeps: Vec<FrameSweep>,
    /// Position of guide 2 in each of these, `[x, y]`; `None` outside of every hold.
    pub displacements_mm: Vec<Option<[f64; 2]>>,
}

impl RecordedRun {
    /// Finds the run and its frames.
    pub fn read(session: &Path, id: &str) -> anyhow::Result<Self> {
        let read = Session::read(session)?;
        let stated_m = read.noise.displacement_m;
        let known_runs = read.lateral;
        let ids: Vec<String> = known_runs.iter().map(|run| run.id.clone()).collect();
        let run = known_runs.into_iter().find(|run| run.id == id);
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
        let origin_s = ForceSeries::clock_origin_s(&run.force_path)?;
        let level = |sweep: &FrameSweep| {
            let time_s = sweep.time_s - origin_s;
            levels.iter().find(|level| (level.time_s[0]..=level.time_s[1]).contains(&time_s))
        };
        let stated_m = run.force.typical_displacement_sd_m().or(stated_m);
        let sd_mm = |level: &Hold| {
            let sd_mm = |mean: Mean| 1e3 * mean.error(stated_m);
            [level.displacement_x_m.map_or(0.0, sd_mm), sd_mm(level.displacement_y_m)]
        };
        let zero = sweeps.iter().enumerate().find_map(|(at, sweep)| {
            level(sweep).filter(|level| level.path == LevelPath::Zero).map(|level| {
                let zero_hold = ZeroHold { at_mm: at_mm(level), sd_mm: sd_mm(level) };
                (at, zero_hold)
            })
        });
        let straight = zero.map(|(at, zero_hold)| (sweeps.remove(at).frames, zero_hold));
        ensure!(
            !sweeps.is_empty(),
            "--run: {id} has frames of the undisplaced needle only, expected some of a displaced one"
        );
        let displacements_mm = sweeps.iter().map(|sweep| level(sweep).map(at_mm)).collect();
        Ok(Self { run, straight, sweeps, displacements_mm })
    }
}

fn at_mm(level: &Hold) -> [f64; 2] {
    let [y_m, x_m] = level.displacement_m();
    [1e3 * x_m, 1e3 * y_m]
}
