//! Figures of a run: path and plan, and the plane of the target.

use crate::cli::output::{Output, figures_file};
use crate::figures;
use std::path::Path;
use steering::{Answer, Run};

/// Tip readings of a run as they arrive.
#[derive(Debug, Default)]
pub struct Readings {
    last_seq: Option<i64>,
    /// Depth, x, y, mm.
    at_mm: Vec<[f64; 3]>,
}

impl Readings {
    /// Takes in an answer, whose reading may be the one before again.
    pub fn take(&mut self, answer: &Answer) {
        if answer.valid && self.last_seq != Some(answer.tip_seq) {
            self.last_seq = Some(answer.tip_seq);
            self.at_mm.push([answer.depth_mm, answer.tip_x_mm, answer.tip_y_mm]);
        }
    }
}

/// Writes the figures of a run, where they are requested.
pub fn draw(run: &Run, readings: &Readings, folder: Option<&Path>, out: &mut Output) -> anyhow::Result<()> {
    let Some(folder) = out.figures_folder(folder).map(Path::to_owned) else { return Ok(()) };
    let half_way = run.decisions.iter().rfind(|one| one.depth_mm <= 0.5 * run.target_mm[2]);
    let drawn = figures::Steered {
        target_mm: run.target_mm,
        readings_mm: readings.at_mm.clone(),
        planned_mm: half_way
            .map(|one| {
                one.path.iter().map(|at| [at.depth_mm, at.tip_mm[0], at.tip_mm[1], at.sd_mm]).collect()
            })
            .unwrap_or_default(),
        guide_mm: run
            .decisions
            .iter()
            .map(|one| [one.depth_mm, one.guide_to_mm[0], one.guide_to_mm[1]])
            .collect(),
        reachable_mm: run.reachable_mm.clone(),
        expected_mm: run
            .decisions
            .iter()
            .map(|one| [one.expected_tip_mm[0], one.expected_tip_mm[1], sd_mm(one.covariance_mm2)])
            .collect(),
        tip_mm: Some(run.estimated_tip_mm),
    };
    figures_file(&folder, "steer.path", &figures::steered_path(&drawn)?, out)?;
    figures_file(&folder, "steer.target", &figures::steered_target(&drawn)?, out)?;
    Ok(())
}

fn sd_mm([xx, _, yy]: [f64; 3]) -> f64 {
    (0.5 * (xx + yy)).max(0.0).sqrt()
}
