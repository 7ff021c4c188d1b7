//! Force of guide 2 and bending of the needle at rest: what a move would do to both, from the one forward model.

use crate::history::{History, Place};
use crate::tables::{self, Path};
use crate::unknowns::{CuttingLaw, Unknowns};
use mechanics::elements::{Elements, Guide2};
use mechanics::{BeamProblem, ModelError};

/// Length of the elements, m.
const ELEMENT_M: f64 = 2e-3;

/// Force and bending.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Statics {
    /// Force of guide 2 on the needle, x and y, N.
    pub force_n: [f64; 2],
    /// Largest bending strain of the needle.
    pub strain: f64,
}

/// The needle at rest at the deepest node reached.
pub(crate) struct AtRest<'a> {
    unknowns: &'a Unknowns,
    values: &'a [f64],
    elements: Elements,
    problem: BeamProblem,
    depth_m: f64,
    nodes_m: &'a [f64],
    /// Cut paths without what is straight.
    paths: [Path; 2],
    load_n: [f64; 2],
    radius_m: f64,
}

impl<'a> AtRest<'a> {
    pub fn new(
        unknowns: &'a Unknowns,
        values: &'a [f64],
        history: &'a History,
        paths: &[Path; 2],
        radius_m: f64,
    ) -> Result<Self, ModelError> {
        let depth_m = history.depths_m[history.reached].max(1e-4);
        let problem = BeamProblem { depth_m, ..unknowns.problem(values)? };
        let elements = Elements::new(&problem, ELEMENT_M)?;
        let straight = |plane: usize, m: f64| {
            unknowns.value(values, unknowns.offset() + plane)
                + m * unknowns.value(values, unknowns.slope() + plane)
        };
        let mut paths = paths.clone();
        for (plane, path) in paths.iter_mut().enumerate() {
            for (at, m) in path.iter_mut().zip(&history.depths_m) {
                *at = at.map(|tip_m| tip_m - straight(plane, *m));
            }
        }
        let own = [0, 1].map(|direction| {
            let hats = tables::hats(depth_m, unknowns.knots);
            hats.iter()
                .map(|(knot, weight)| weight * unknowns.value(values, unknowns.tip(direction, *knot)))
                .sum()
        });
        let bevel_rad = history.nodes[history.reached].bevel_rad[1];
        let load_n = match unknowns.law {
            CuttingLaw::Load => [0, 1].map(|plane| tables::turned(own, bevel_rad, plane)),
            CuttingLaw::Angle => [0.0; 2],
        };
        Ok(Self {
            unknowns,
            values,
            elements,
            problem,
            depth_m,
            nodes_m: &history.depths_m,
            paths,
            load_n,
            radius_m,
        })
    }

    /// With the guide at this position, m.
    pub fn at(&self, guide_m: [f64; 2]) -> Result<Statics, ModelError> {
        let mut force_n = [0.0; 2];
        let mut bent = Vec::new();
        for plane in 0..2 {
            let offset_m = self.unknowns.value(self.values, self.unknowns.guide_offset() + plane);
            let path_m = |z_m: f64| {
                let depth_m = (z_m - self.problem.entry_m).clamp(0.0, self.depth_m);
                let next = self.nodes_m.partition_point(|m| *m <= depth_m).min(self.nodes_m.len() - 1);
                let from = next.saturating_sub(1);
                let share =
                    (depth_m - self.nodes_m[from]) / (self.nodes_m[next] - self.nodes_m[from]).max(1e-9);
                tables::at(&self.paths[plane], Place::Between(from, share.clamp(0.0, 1.0)))
            };
            let held = Guide2::Held(guide_m[plane] + offset_m);
            let shape = self.elements.solve(&self.problem.foundation, path_m, held, self.load_n[plane])?;
            force_n[plane] = shape.guide2_force_n;
            let length_m = self.problem.entry_m + self.depth_m;
            let count = 60;
            let places = (0..=count).map(|i| length_m * f64::from(i) / f64::from(count));
            let curvature: Vec<f64> =
                places.chain([self.problem.guide2_m]).map(|z_m| shape.curvature_per_m(z_m)).collect();
            bent.push(curvature);
        }
        let strain =
            bent[0].iter().zip(&bent[1]).map(|(x, y)| self.radius_m * x.hypot(*y)).fold(0.0, f64::max);
        Ok(Statics { force_n, strain })
    }
}
