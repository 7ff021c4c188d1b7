//! Effects of the needle.

use super::{Effect, EffectInfo, ParameterInfo, RunKinds, first};
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
                physics: "the needle is stiffer than stated: EI (1 + relative)",
                signature: "scale of force and shape together; on lateral runs alone the same as a gain of the force",
                observable_in: RunKinds::BOTH,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude("relative", 0.0, [-0.95, 20.0], [-0.5, 0.5], 0.05)],
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
                physics: "the needle is curved when free of stress, in each plane: EI (u'' - curvature); guide 2 holds it straight; the curvature turns with the needle",
                signature: "shape and force at zero displacement; a path that curves without a tip load, and turns with the needle",
                observable_in: RunKinds::BOTH,
                is_costly: false,
                parameters: &[
                    ParameterInfo::amplitude("curvature_per_m", 0.0, [-20.0, 20.0], [-1.0, 1.0], 0.1),
                    ParameterInfo::amplitude("curvature_x_per_m", 0.0, [-20.0, 20.0], [-1.0, 1.0], 0.1),
                ],
            }
        }
    }

    fn stress_free_curvature(&self, values: &[f64], curvature_per_m: &mut [f64; 2]) {
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
                signature: "lower lateral stiffness, the more so the longer the free length",
                observable_in: RunKinds::BOTH,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude("force_n", 0.0, [-100.0, 100.0], [-5.0, 5.0], 0.5)],
            }
        }
    }

    fn beam(&self, values: &[f64], _plane: Plane, problem: &mut BeamProblem) -> Result<(), ModelError> {
        problem.axial_load_n += first(values);
        Ok(())
    }
}
