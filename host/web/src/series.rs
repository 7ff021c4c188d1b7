//! Measurements, thinned for drawing.

use crate::answer::AnswerError;
use formats::session::{InsertionRun, LateralRun, Session};
use serde::Serialize;
use std::path::Path;

/// Points of a series that are drawn.
const POINTS: usize = 600;

#[derive(Serialize)]
struct SessionSeries {
    name: Option<String>,
    guide2_mm: f64,
    entry_mm: f64,
    outer_diameter_mm: f64,
    lateral: Vec<LateralSeries>,
    insertion: Vec<InsertionSeries>,
    steering: Vec<String>,
    indentation: Vec<String>,
}

#[derive(Serialize)]
struct LateralSeries {
    id: String,
    depth_mm: f64,
    samples: usize,
    time_s: Vec<f64>,
    displacement_y_mm: Vec<f64>,
    force_y_n: Vec<f64>,
    shape_z_mm: Vec<f64>,
    shape_y_mm: Vec<f64>,
}

#[derive(Serialize)]
struct InsertionSeries {
    id: String,
    samples: usize,
    depth_mm: Vec<f64>,
    tip_y_mm: Vec<f64>,
    tip_x_mm: Option<Vec<f64>>,
}

/// Series and shapes of a session.
pub fn session(dir: &Path) -> Result<String, AnswerError> {
    let session = Session::read(dir)?;
    let series = SessionSeries {
        name: session.name,
        guide2_mm: 1e3 * session.rig.guide2_m,
        entry_mm: 1e3 * session.rig.entry_m,
        outer_diameter_mm: 1e3 * session.rig.needle.outer_diameter_m,
        lateral: session.lateral.iter().map(LateralSeries::from).collect(),
        insertion: session.insertion.iter().map(InsertionSeries::from).collect(),
        steering: session.steering.into_iter().map(|run| run.id).collect(),
        indentation: session.indentation.into_iter().map(|run| run.id).collect(),
    };
    Ok(serde_json::to_string(&series)?)
}

/// Every n-th value times a factor, so that at most [`POINTS`] remain.
pub(crate) fn thinned(values: &[f64], factor: f64) -> Vec<f64> {
    let every = values.len().div_ceil(POINTS).max(1);
    values.iter().step_by(every).map(|value| factor * value).collect()
}

impl From<&LateralRun> for LateralSeries {
    fn from(run: &LateralRun) -> Self {
        Self {
            id: run.id.clone(),
            depth_mm: 1e3 * run.depth_m,
            samples: run.force.time_s.len(),
            time_s: thinned(&run.force.time_s, 1.0),
            displacement_y_mm: thinned(&run.force.displacement_y_m, 1e3),
            force_y_n: thinned(&run.force.force_y_n, 1.0),
            shape_z_mm: thinned(&run.shape.z_m, 1e3),
            shape_y_mm: thinned(&run.shape.y_m, 1e3),
        }
    }
}

impl From<&InsertionRun> for InsertionSeries {
    fn from(run: &InsertionRun) -> Self {
        Self {
            id: run.id.clone(),
            samples: run.depth_m.len(),
            depth_mm: thinned(&run.depth_m, 1e3),
            tip_y_mm: thinned(&run.tip_y_m, 1e3),
            tip_x_mm: run.tip_x_m.as_ref().map(|tip_m| thinned(tip_m, 1e3)),
        }
    }
}
