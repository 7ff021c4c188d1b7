//! Effects of the rig: guides, frame, actuators.

use super::{Effect, EffectInfo, MM, ObservationContext, ParameterInfo, RunKinds, first};
use crate::course::directions;
use crate::lateral::Drive;
use crate::predict::Plane;
use crate::{BeamProblem, Channels, ModelError, Rig};

/// `rig.guide2_position`.
#[derive(Debug)]
pub(super) struct Guide2Position;

impl Effect for Guide2Position {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "rig.guide2_position",
                physics: "guide 2 is further from guide 1 than stated",
                signature: "force per displacement, and the shape before and behind guide 2",
                observable_in: RunKinds::BOTH,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude("offset_mm", 0.0, [-20.0, 20.0], [-6.0, 6.0], 1.0)],
            }
        }
    }

    fn applies_to(&self, rig: &Rig) -> bool {
        !rig.has_one_guide()
    }

    fn beam(&self, values: &[f64], _plane: Plane, problem: &mut BeamProblem) -> Result<(), ModelError> {
        problem.guide2_m = (problem.guide2_m + first(values) * MM).min(problem.entry_m);
        Ok(())
    }
}

/// `rig.surface_position`.
#[derive(Debug)]
pub(super) struct SurfacePosition;

impl Effect for SurfacePosition {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "rig.surface_position",
                physics: "the tissue surface is further from guide 2 than stated, and the tip is further by the same distance",
                signature: "shape and force as those of a longer gap, the same at every depth",
                observable_in: RunKinds::BOTH,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude("offset_mm", 0.0, [-20.0, 20.0], [-6.0, 6.0], 1.0)],
            }
        }
    }

    fn beam(&self, values: &[f64], _plane: Plane, problem: &mut BeamProblem) -> Result<(), ModelError> {
        problem.entry_m = (problem.entry_m + first(values) * MM).max(problem.guide2_m);
        Ok(())
    }
}

/// `rig.clamp_compliance`.
#[derive(Debug)]
pub(super) struct ClampCompliance;

impl Effect for ClampCompliance {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "rig.clamp_compliance",
                physics: "the needle turns in guide 1 in proportion to the moment there: EI u''(0) = k u'(0)",
                signature: "force per displacement, the same at every depth",
                observable_in: RunKinds::BOTH,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude(
                    "compliance_rad_per_n_m",
                    0.0,
                    [0.0, 20.0],
                    [0.0, 5.0],
                    0.1,
                )],
            }
        }
    }

    /// A needle in one guide turns there by what is stated of the rig.
    fn applies_to(&self, rig: &Rig) -> bool {
        !rig.has_one_guide()
    }

    fn beam(&self, values: &[f64], _plane: Plane, problem: &mut BeamProblem) -> Result<(), ModelError> {
        problem.clamp_compliance_rad_per_n_m += first(values);
        Ok(())
    }
}

/// `rig.rear_rotation`.
#[derive(Debug)]
pub(super) struct RearRotation;

impl Effect for RearRotation {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "rig.rear_rotation",
                physics: "the needle turns where it is held, more in one plane: EI u''(0) = u'(0) / (compliance of the rig + this one)",
                signature: "force per displacement, or the response of the tip to guide 2, the same at every depth; in each plane",
                observable_in: RunKinds::BOTH,
                is_costly: false,
                parameters: &[
                    ParameterInfo::amplitude("compliance_y_rad_per_n_m", 0.0, [0.0, 100.0], [0.0, 10.0], 0.5),
                    ParameterInfo::amplitude("compliance_x_rad_per_n_m", 0.0, [0.0, 100.0], [0.0, 10.0], 0.5),
                ],
            }
        }
    }

    fn applies_to(&self, rig: &Rig) -> bool {
        rig.has_one_guide()
    }

    fn beam(&self, values: &[f64], plane: Plane, problem: &mut BeamProblem) -> Result<(), ModelError> {
        let axis = if plane == Plane::Y { 0 } else { 1 };
        problem.clamp_compliance_rad_per_n_m += values.get(axis).copied().unwrap_or_default();
        Ok(())
    }
}

/// `rig.frame_compliance`.
#[derive(Debug)]
pub(super) struct FrameCompliance;

impl Effect for FrameCompliance {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "rig.frame_compliance",
                physics: "the frame is compliant: guide 2 moves less than commanded, by force times compliance",
                signature: "commanded displacement against the needle's shape; in insertions the response of the tip to guide 2",
                observable_in: RunKinds::BOTH,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude(
                    "compliance_mm_per_n",
                    0.0,
                    [0.0, 10.0],
                    [0.0, 0.5],
                    0.03,
                )],
            }
        }
    }

    /// In insertions, where guide 2 holds the needle against the tip load and the tissue.
    fn beam(&self, values: &[f64], _plane: Plane, problem: &mut BeamProblem) -> Result<(), ModelError> {
        problem.guide2_compliance_m_per_n += first(values) * MM;
        Ok(())
    }

    /// In lateral runs, in series with the needle.
    fn drive(&self, values: &[f64], drive: &mut Drive) {
        drive.frame_compliance_m_per_n += first(values) * MM;
    }
}

/// `rig.backlash`.
#[derive(Debug)]
pub(super) struct Backlash;

impl Effect for Backlash {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "rig.backlash",
                physics: "guide 2 has clearance: the needle follows once the clearance is taken up, on either side",
                signature: "force flat about zero displacement; in insertions the tip stays until the clearance is taken up",
                observable_in: RunKinds::BOTH,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude("clearance_mm", 0.0, [0.0, 5.0], [0.0, 0.4], 0.05)],
            }
        }
    }

    fn drive(&self, values: &[f64], drive: &mut Drive) {
        drive.clearance_m += first(values) * MM;
    }
}

/// `rig.play`.
#[derive(Debug)]
pub(super) struct Play;

impl Effect for Play {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "rig.play",
                physics: "play between displacement sensor and guide 2: guide 2 stays in place until the play is taken up (a play operator)",
                signature: "a loop of force and shape against displacement, after every turn; in insertions the same as rig.backlash",
                observable_in: RunKinds::BOTH,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude("half_width_mm", 0.0, [0.0, 5.0], [0.0, 0.4], 0.05)],
            }
        }
    }

    fn drive(&self, values: &[f64], drive: &mut Drive) {
        drive.play_m += first(values) * MM;
    }
}

/// `rig.friction`.
#[derive(Debug)]
pub(super) struct Friction;

impl Effect for Friction {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "rig.friction",
                physics: "dry friction in guide 2: a force with the sign of the last motion, kept in holds",
                signature: "loading against unloading",
                observable_in: RunKinds::LATERAL,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude("force_n", 0.0, [0.0, 50.0], [0.0, 0.5], 0.05)],
            }
        }
    }

    fn observe(&self, values: &[f64], context: &ObservationContext<'_>, channels: &mut Channels) {
        let friction_n = first(values);
        let planes = [Some(&mut channels.force_n.y), channels.force_n.x.as_mut()];
        for ((force_n, commanded_m), reversal_m) in
            planes.into_iter().zip(context.commanded_m).zip(context.reversal_m)
        {
            let directions = directions(commanded_m, reversal_m);
            for (force_n, direction) in force_n.into_iter().flatten().zip(directions) {
                *force_n += friction_n * direction;
            }
        }
    }
}
