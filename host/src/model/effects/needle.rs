//! Effects of the needle.

use super::{Effect, ParameterInfo, first};
use crate::model::predict::Plane;
use crate::model::{BeamProblem, ModelError};

/// `needle.stiffness`.
#[derive(Debug)]
pub(super) struct Stiffness;

impl Effect for Stiffness {
    fn id(&self) -> &'static str {
        "needle.stiffness"
    }

    fn physics(&self) -> &'static str {
        "the needle is stiffer than stated by a share: EI (1 + share)"
    }

    fn signature(&self) -> &'static str {
        "scale of force and shape together; on lateral runs alone as a gain of the force"
    }

    fn parameters(&self) -> &'static [ParameterInfo] {
        const { &[ParameterInfo::new("relative", 0.0, [-0.95, 20.0], [-0.5, 0.5], 0.05)] }
    }

    fn beam(&self, values: &[f64], _plane: Plane, problem: &mut BeamProblem) -> Result<(), ModelError> {
        problem.bending_stiffness_n_m2 *= 1.0 + first(values);
        Ok(())
    }
}

/// `needle.prebend`.
#[derive(Debug)]
pub(super) struct Prebend;

impl Effect for Prebend {
    fn id(&self) -> &'static str {
        "needle.prebend"
    }

    fn physics(&self) -> &'static str {
        "the needle is bent by itself, in each plane: EI (u'' - curvature); guide 2 holds it straight; it turns with the needle"
    }

    fn signature(&self) -> &'static str {
        "shape and force at zero displacement; a path that bends by itself, and turns with the needle"
    }

    fn parameters(&self) -> &'static [ParameterInfo] {
        const {
            &[
                ParameterInfo::new("curvature_per_m", 0.0, [-20.0, 20.0], [-1.0, 1.0], 0.1),
                ParameterInfo::new("curvature_x_per_m", 0.0, [-20.0, 20.0], [-1.0, 1.0], 0.1),
            ]
        }
    }

    fn rest(&self, values: &[f64], curvature_per_m: &mut [f64; 2]) {
        curvature_per_m.iter_mut().zip(values).for_each(|(curvature, more)| *curvature += more);
    }
}

/// `needle.axial_load`.
#[derive(Debug)]
pub(super) struct AxialLoad;

impl Effect for AxialLoad {
    fn id(&self) -> &'static str {
        "needle.axial_load"
    }

    fn physics(&self) -> &'static str {
        "the needle is pushed along its axis, as a beam-column: + P u''"
    }

    fn signature(&self) -> &'static str {
        "softer, the more so the longer the free length"
    }

    fn parameters(&self) -> &'static [ParameterInfo] {
        const { &[ParameterInfo::new("force_n", 0.0, [-100.0, 100.0], [-5.0, 5.0], 0.5)] }
    }

    fn beam(&self, values: &[f64], _plane: Plane, problem: &mut BeamProblem) -> Result<(), ModelError> {
        problem.axial_load_n += first(values);
        Ok(())
    }
}
