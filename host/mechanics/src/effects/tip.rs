//! Effects of the tip, in insertions.

use super::{Effect, EffectInfo, MM, ParameterInfo, RunKinds, first};
use crate::insertion::TipLaw;
use crate::terms::Conditions;

/// `tip.load_slope`.
#[derive(Debug)]
pub(super) struct LoadSlope;

impl Effect for LoadSlope {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "tip.load_slope",
                physics: "the tip load grows with depth",
                signature: "curvature of the path against depth",
                observable_in: RunKinds::INSERTION,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude(
                    "slope_n_per_mm",
                    0.0,
                    [-1.0, 1.0],
                    [-0.01, 0.01],
                    0.001,
                )],
            }
        }
    }

    fn tip(&self, values: &[f64], _conditions: &Conditions, law: &mut TipLaw) {
        law.along_bevel.slope_n_per_m += first(values) / MM;
    }
}

/// `tip.load_step`.
#[derive(Debug)]
pub(super) struct LoadStep;

impl Effect for LoadStep {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "tip.load_step",
                physics: "the tip load jumps at a depth: a membrane, a layer",
                signature: "kink of the curvature of the path",
                observable_in: RunKinds::INSERTION,
                is_costly: false,
                parameters: &[
                    ParameterInfo::amplitude("step_n", 0.0, [-50.0, 50.0], [-0.5, 0.5], 0.05),
                    ParameterInfo::location(
                        "depth_mm",
                        40.0,
                        [0.0, 500.0],
                        [5.0, 150.0],
                        20.0,
                        &[10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 75.0, 90.0, 110.0],
                    ),
                ],
            }
        }
    }

    fn tip(&self, values: &[f64], _conditions: &Conditions, law: &mut TipLaw) {
        let &[step_n, depth_mm] = values else { return };
        if step_n != 0.0 {
            law.along_bevel.steps.push([depth_mm * MM, step_n]);
        }
    }
}

/// `tip.entry_angle`.
#[derive(Debug)]
pub(super) struct EntryAngle;

impl Effect for EntryAngle {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "tip.entry_angle",
                physics: "the needle enters at an angle, in each plane; a tracker that is tilted relative to the rig gives the same readings",
                signature: "path, linear in depth",
                observable_in: RunKinds::INSERTION,
                is_costly: false,
                parameters: &[
                    ParameterInfo::amplitude("angle_rad", 0.0, [-0.7, 0.7], [-0.1, 0.1], 0.01),
                    ParameterInfo::amplitude("angle_x_rad", 0.0, [-0.7, 0.7], [-0.1, 0.1], 0.01),
                ],
            }
        }
    }

    fn tip(&self, values: &[f64], _conditions: &Conditions, law: &mut TipLaw) {
        law.entry_angle_rad.iter_mut().zip(values).for_each(|(angle, more)| *angle += more);
    }
}

/// `tip.bevel_roll`.
#[derive(Debug)]
pub(super) struct BevelRoll;

impl Effect for BevelRoll {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "tip.bevel_roll",
                physics: "the bevel is rotated about the needle's axis: part of the tip load acts in the other plane",
                signature: "deflection of the path in the horizontal plane",
                observable_in: RunKinds::INSERTION,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude("roll_rad", 0.0, [-3.2, 3.2], [-1.0, 1.0], 0.1)],
            }
        }
    }

    fn tip(&self, values: &[f64], _conditions: &Conditions, law: &mut TipLaw) {
        law.along_bevel.roll_rad += first(values);
    }
}

/// `tip.rate`.
#[derive(Debug)]
pub(super) struct Rate;

impl Effect for Rate {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "tip.rate",
                physics: "the tip load grows with the speed of insertion",
                signature: "runs at different speeds",
                observable_in: RunKinds::INSERTION,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude("n_s_per_mm", 0.0, [-10.0, 10.0], [-0.1, 0.1], 0.005)],
            }
        }
    }

    fn tip(&self, values: &[f64], _conditions: &Conditions, law: &mut TipLaw) {
        law.along_bevel.rate_n_s_per_m += first(values) / MM;
    }
}

/// `tip.cut_angle`.
#[derive(Debug)]
pub(super) struct CutAngle;

impl Effect for CutAngle {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "tip.cut_angle",
                physics: "the bevel makes the path depart from the needle's axis at an angle, in addition to the effect of the tip load",
                signature: "slope of the path against the needle's direction at the tip",
                observable_in: RunKinds::INSERTION,
                is_costly: false,
                parameters: &[
                    ParameterInfo::amplitude("angle_rad", 0.0, [-0.5, 0.5], [-0.1, 0.1], 0.02),
                    ParameterInfo::amplitude("angle_x_rad", 0.0, [-0.5, 0.5], [-0.1, 0.1], 0.02),
                ],
            }
        }
    }

    fn tip(&self, values: &[f64], _conditions: &Conditions, law: &mut TipLaw) {
        let &[y_rad, x_rad] = values else { return };
        law.cut_angle_rad[0] += y_rad;
        law.cut_angle_rad[1] += x_rad;
    }
}
