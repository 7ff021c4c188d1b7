//! Effects of the needle.

use super::{Effect, EffectInfo, ParameterInfo, Shows, first};
use crate::predict::Plane;
use crate::{BeamProblem, ModelError};

/// `needle.stiffness`.
#[derive(Debug)]
pub(super) struct Stiffness;

impl Effect for Stiffness {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "needle.stiffness",
                physics: "the needle is stiffer than stated by a share: EI (1 + share)",
                signature: "scale of force and shape together; on lateral runs alone as a gain of the force",
                shows: Shows::BOTH,
                is_costly: false,
                parameters: &[ParameterInfo::new("relative", 0.0, [-0.95, 20.0], [-0.5, 0.5], 0.05)],
            }
        }
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
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "needle.prebend",
                physics: "the needle is bent by itself, in each plane: EI (u'' - curvature); guide 2 holds it straight; it turns with the needle",
                signature: "shape and force at zero displacement; a path that bends by itself, and turns with the needle",
                shows: Shows::BOTH,
                is_costly: false,
                parameters: &[
                    ParameterInfo::new("curvature_per_m", 0.0, [-20.0, 20.0], [-1.0, 1.0], 0.1),
                    ParameterInfo::new("curvature_x_per_m", 0.0, [-20.0, 20.0], [-1.0, 1.0], 0.1),
                ],
            }
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
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "needle.axial_load",
                physics: "the needle is pushed along its axis, as a beam-column: + P u''",
                signature: "softer, the more so the longer the free length",
                shows: Shows::BOTH,
                is_costly: false,
                parameters: &[ParameterInfo::new("force_n", 0.0, [-100.0, 100.0], [-5.0, 5.0], 0.5)],
            }
        }
    }

    fn beam(&self, values: &[f64], _plane: Plane, problem: &mut BeamProblem) -> Result<(), ModelError> {
        problem.axial_load_n += first(values);
        Ok(())
    }
}
