//! A run's whole course: what some effects depend on.
//!
//! Levels are means over holds, but tissue relaxes, sensors drift and lag, and friction and clearance depend on the
//! path. If such effects are given, the forward model is driven along the recorded displacement, the rows of every hold
//! at that hold's true displacement, and its force is averaged over the rows of the hold as the measured one was.

use super::HoldData;
use mechanics::effects::Effect;
use mechanics::{Channels, DriveSample, Series, ShapePoint};
use std::ops::Range;

/// Effects whose values are known.
#[derive(Debug, Clone)]
pub struct Fixed {
    /// Effects with the values of their parameters.
    pub effects: Vec<(&'static dyn Effect, Vec<f64>)>,
    /// Motion of guide 2 in the run.
    pub course: DisplacementHistory,
    /// Plane that the first plane of the data is: 0 for y, and 1 where the data are those of x alone.
    pub first_plane: usize,
    /// Number of the run among the lateral ones of its session, 0 for the first: an effect may depend on it.
    pub order: f64,
}

/// Motion of guide 2 in a run, and the rows of each level.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DisplacementHistory {
    /// Time of every row.
    pub time_s: Vec<f64>,
    /// Recorded displacement of guide 2, vertical and horizontal.
    pub displacement_m: [Vec<f64>; 2],
    /// Motion back by this or less is noise of that displacement.
    pub reversal_m: [f64; 2],
    /// Rows of every level, in the order of the levels.
    pub holds: Vec<Range<usize>>,
    /// Time of every shape point, level by level.
    pub shape_time_s: Vec<f64>,
}

impl Fixed {
    /// The recorded motion of guide 2 with its holds at the true displacements of the levels, of so many planes.
    pub(super) fn drive(&self, planes: usize, displacements_m: &[f64]) -> Vec<DriveSample> {
        let course = &self.course;
        let mut planes_m = course.displacement_m.clone();
        for (plane, column) in planes_m.iter_mut().enumerate() {
            for (level, hold) in course.holds.iter().enumerate() {
                let Some(rows) = column.get_mut(hold.clone()) else { continue };
                let effect_plane = plane.checked_sub(self.first_plane).filter(|own| *own < planes);
                let unknown = effect_plane.and_then(|own| displacements_m.get(level * planes + own));
                // A plane that is no part of the data rests at the mean of what was read.
                let level_m = unknown.copied().unwrap_or_else(|| mean(rows));
                rows.fill(level_m);
            }
        }
        let [y_m, x_m] = &planes_m;
        let rows = course.time_s.iter().zip(y_m.iter().zip(x_m));
        rows.map(|(time_s, (y_m, x_m))| DriveSample { time_s: *time_s, y_m: *y_m, x_m: *x_m }).collect()
    }

    /// When and where the shape of these levels was measured.
    pub(super) fn shape(&self, levels: &[HoldData]) -> Vec<ShapePoint> {
        let points = levels.iter().flat_map(|level| &level.shape).zip(&self.course.shape_time_s);
        points
            .map(|(point, time_s)| ShapePoint { time_s: *time_s, z_m: point.z_m, image: point.image })
            .collect()
    }

    /// Furthest recorded displacement.
    pub(super) fn farthest_m(&self) -> f64 {
        self.course.displacement_m.iter().flatten().fold(0.0, |most: f64, m| most.max(m.abs()))
    }

    /// Expected readings at the levels, from the expected readings of all rows.
    pub(super) fn at_levels(&self, observed: Channels) -> Channels {
        let holds = &self.course.holds;
        let levels = |series: Series| {
            self.ordered(Series {
                y: level_means(&series.y, holds),
                x: series.x.as_deref().map(|values| level_means(values, holds)),
            })
        };
        Channels {
            displacement_m: levels(observed.displacement_m),
            force_n: levels(observed.force_n),
            shape_m: self.ordered(observed.shape_m),
            ..Channels::default()
        }
    }

    /// The planes in the order of the data.
    fn ordered(&self, series: Series) -> Series {
        match (self.first_plane, series.x) {
            (1, Some(x)) => Series { y: x, x: Some(series.y) },
            (_, x) => Series { y: series.y, x },
        }
    }
}

fn level_means(values: &[f64], holds: &[Range<usize>]) -> Vec<f64> {
    holds.iter().map(|hold| mean(values.get(hold.clone()).unwrap_or_default())).collect()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Block, ForceZero, LateralData, Measured, ShapeDatum, SharedErrors};
    use mechanics::{Needle, Rig};

    /// A course that no effect uses changes nothing, whichever plane the data are of.
    #[test]
    fn a_course_without_effects_is_its_holds() {
        let level = HoldData {
            displacement_m: unit_measured(1e-3),
            force_n: unit_measured(1.0),
            shape: vec![ShapeDatum::new(0.09, [1e-3, 0.0])],
        };
        let holds = LateralData {
            support: mechanics::Support::Springs,
            rig: Rig::two_guides(Needle::gauge_18(), 0.06, 0.07),
            depth_m: 0.03,
            planes: 1,
            levels: vec![level],
            shape_sd_m: 1.0,
            force_zero: ForceZero::Exact,
            shared: SharedErrors::default(),
            uses_force: true,
            effects: Vec::new(),
            fixed: None,
        };
        let plain = residuals_at(&holds);
        for first_plane in [0, 1] {
            let mut displacement_m = [vec![0.0; 3], vec![0.0; 3]];
            displacement_m[first_plane] = vec![0.0, 1e-3, 1e-3];
            let course = DisplacementHistory {
                time_s: vec![0.0, 1.0, 2.0],
                displacement_m,
                reversal_m: [0.0; 2],
                holds: std::iter::once(1..3).collect(),
                shape_time_s: vec![1.5],
            };
            let fixed = Some(Fixed { effects: Vec::new(), course, first_plane, order: 0.0 });
            assert_eq!(residuals_at(&LateralData { fixed, ..holds.clone() }), plain, "{first_plane}");
        }
    }

    fn residuals_at(data: &LateralData) -> Vec<f64> {
        let ready = data.prepare(&[16e3_f64.ln()]).expect("solves");
        data.residuals(&ready, &[1.1e-3]).expect("moves")
    }

    fn unit_measured(value: f64) -> Vec<Measured> {
        vec![Measured { value, sd: 1.0 }]
    }
}
