//! Effects of the tissue.

use super::{Effect, EffectInfo, MM, ParameterInfo, RunKinds, first};
use crate::predict::Plane;
use crate::problem::Give;
use crate::{BeamProblem, Foundation, Layer, ModelError, check};

/// `tissue.layers`.
#[derive(Debug)]
pub(super) struct Layers;

impl Effect for Layers {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "tissue.layers",
                physics: "the modulus changes at a depth: K above the boundary, K times a ratio below it",
                signature: "shape against depth below the surface; force against insertion depth",
                observable_in: RunKinds::BOTH,
                is_costly: false,
                parameters: &[
                    ParameterInfo::amplitude("k_ratio", 1.0, [0.02, 50.0], [0.1, 10.0], 1.0),
                    ParameterInfo::location(
                        "boundary_mm",
                        15.0,
                        [1.0, 200.0],
                        [2.0, 100.0],
                        10.0,
                        &[4.0, 7.0, 10.0, 13.0, 16.0, 19.0, 22.0, 26.0, 30.0, 35.0, 45.0, 60.0, 80.0],
                    ),
                ],
            }
        }
    }

    fn beam(&self, values: &[f64], _plane: Plane, problem: &mut BeamProblem) -> Result<(), ModelError> {
        let &[ratio, boundary_mm] = values else { return Ok(()) };
        if ratio == 1.0 {
            return Ok(());
        }
        let bottom_m = boundary_mm * MM;
        let mut layers = problem.foundation.layers_above(bottom_m);
        let upper_pa = problem.foundation.layer_pa(bottom_m * (1.0 - 1e-12));
        layers.push(Layer { bottom_m, modulus_pa: upper_pa });
        let lower_pa = ratio * problem.foundation.layer_pa(bottom_m);
        let changed = Foundation::layered(layers, lower_pa)?;
        problem.foundation =
            changed.graded(problem.foundation.gradient_per_m())?.with_gap(problem.foundation.gap_m())?;
        Ok(())
    }
}

/// `tissue.gradient`.
#[derive(Debug)]
pub(super) struct Gradient;

impl Effect for Gradient {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "tissue.gradient",
                physics: "the modulus grows in proportion to depth: K(s) = K (1 + gradient s)",
                signature: "shape and force as with layers, but smooth",
                observable_in: RunKinds::BOTH,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude(
                    "gradient_per_mm",
                    0.0,
                    [-0.1, 1.0],
                    [-0.02, 0.1],
                    0.01,
                )],
            }
        }
    }

    fn beam(&self, values: &[f64], _plane: Plane, problem: &mut BeamProblem) -> Result<(), ModelError> {
        let gradient_per_m = problem.foundation.gradient_per_m() + first(values) / MM;
        problem.foundation = problem.foundation.clone().graded(gradient_per_m)?;
        Ok(())
    }
}

/// `tissue.stiffening`.
#[derive(Debug)]
pub(super) struct Stiffening;

impl Effect for Stiffening {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "tissue.stiffening",
                physics: "the reaction grows faster than the deflection: K u (1 + (u/u0)^2)",
                signature: "force against displacement: odd curvature",
                observable_in: RunKinds::LATERAL,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude(
                    "inverse_u0_per_mm",
                    0.0,
                    [0.0, 20.0],
                    [0.0, 3.0],
                    0.3,
                )],
            }
        }
    }

    fn beam(&self, values: &[f64], _plane: Plane, problem: &mut BeamProblem) -> Result<(), ModelError> {
        problem.law.inverse_u0_per_m = problem.law.inverse_u0_per_m.hypot(first(values) / MM);
        Ok(())
    }
}

/// `tissue.relaxation`.
#[derive(Debug)]
pub(super) struct Relaxation;

impl Effect for Relaxation {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "tissue.relaxation",
                physics: "the tissue relaxes while it is held: K(t) = K_inf + (K_0 - K_inf) e^(-t/tau), relaxing fraction (K_0 - K_inf)/K_0",
                signature: "force decays in holds; depends on the rate of ramps",
                observable_in: RunKinds::LATERAL,
                is_costly: false,
                parameters: &[
                    ParameterInfo::amplitude("relaxing_fraction", 0.0, [0.0, 0.98], [0.0, 0.9], 0.2),
                    ParameterInfo::location(
                        "tau_s",
                        2.0,
                        [0.02, 1000.0],
                        [0.1, 50.0],
                        2.0,
                        &[0.3, 0.8, 2.0, 5.0, 15.0],
                    ),
                ],
            }
        }
    }

    fn beam(&self, values: &[f64], _plane: Plane, problem: &mut BeamProblem) -> Result<(), ModelError> {
        let &[relaxing_fraction, tau_s] = values else { return Ok(()) };
        if relaxing_fraction > 0.0 {
            problem.law.relaxing_share = relaxing_fraction;
            problem.law.relaxation_s = tau_s;
        }
        Ok(())
    }
}

/// `tissue.shear`.
#[derive(Debug)]
pub(super) struct Shear;

impl Effect for Shear {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "tissue.shear",
                physics: "the tissue resists shear between its layers (Pasternak): - G u''",
                signature: "shape near the surface and near the tip",
                observable_in: RunKinds::BOTH,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude("shear_n", 0.0, [0.0, 1000.0], [0.0, 20.0], 1.0)],
            }
        }
    }

    fn beam(&self, values: &[f64], _plane: Plane, problem: &mut BeamProblem) -> Result<(), ModelError> {
        problem.shear_n += first(values);
        Ok(())
    }
}

/// `tissue.entry_gap`.
#[derive(Debug)]
pub(super) struct EntryGap;

impl Effect for EntryGap {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "tissue.entry_gap",
                physics: "nothing supports the needle from the surface down to a depth",
                signature: "shape near the surface, most in shallow runs",
                observable_in: RunKinds::BOTH,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude("gap_mm", 0.0, [0.0, 100.0], [0.0, 10.0], 1.0)],
            }
        }
    }

    fn beam(&self, values: &[f64], _plane: Plane, problem: &mut BeamProblem) -> Result<(), ModelError> {
        let gap_m = problem.foundation.gap_m().max(first(values) * MM);
        problem.foundation = problem.foundation.clone().with_gap(gap_m)?;
        Ok(())
    }
}

/// `tissue.skin`.
#[derive(Debug)]
pub(super) struct Skin;

impl Effect for Skin {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "tissue.skin",
                physics: "a stiff skin: a spring at the surface",
                signature: "force and shape at shallow depth",
                observable_in: RunKinds::BOTH,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude(
                    "stiffness_n_per_mm",
                    0.0,
                    [0.0, 100.0],
                    [0.0, 3.0],
                    0.2,
                )],
            }
        }
    }

    fn beam(&self, values: &[f64], _plane: Plane, problem: &mut BeamProblem) -> Result<(), ModelError> {
        problem.skin_n_per_m += first(values) / MM;
        Ok(())
    }
}

/// `tissue.anisotropy`.
#[derive(Debug)]
pub(super) struct Anisotropy;

impl Effect for Anisotropy {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "tissue.anisotropy",
                physics: "the tissue is stiffer in one direction: K_x = ratio K_y",
                signature: "horizontal runs against vertical runs",
                observable_in: RunKinds::BOTH,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude("ratio", 1.0, [0.02, 50.0], [0.2, 5.0], 0.3)],
            }
        }
    }

    fn beam(&self, values: &[f64], plane: Plane, problem: &mut BeamProblem) -> Result<(), ModelError> {
        if let (Plane::X, Some(ratio)) = (plane, values.first()) {
            problem.foundation = problem.foundation.scaled(*ratio)?;
        }
        Ok(())
    }
}

/// `tissue.yield`.
#[derive(Debug)]
pub(super) struct Yield;

impl Effect for Yield {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "tissue.yield",
                physics: "the tissue yields near the surface: K u / sqrt(1 + (K u / p_y)^2), p_y = exp(depth / d) / inverse yield",
                signature: "the tip responds less than proportionally to large motions of guide 2, most at shallow depth",
                observable_in: RunKinds::BOTH,
                is_costly: true,
                parameters: &[
                    ParameterInfo::amplitude(
                        "inverse_yield_mm_per_n",
                        0.0,
                        [0.0, 1000.0],
                        [0.0, 100.0],
                        10.0,
                    ),
                    ParameterInfo::location(
                        "depth_mm",
                        10.0,
                        [0.5, 200.0],
                        [2.0, 50.0],
                        5.0,
                        &[5.0, 10.0, 20.0],
                    ),
                ],
            }
        }
    }

    fn beam(&self, values: &[f64], _plane: Plane, problem: &mut BeamProblem) -> Result<(), ModelError> {
        let &[inverse_yield_mm_per_n, depth_mm] = values else { return Ok(()) };
        if inverse_yield_mm_per_n != 0.0 {
            check(
                "inverse_yield_mm_per_n",
                inverse_yield_mm_per_n,
                "0 or more",
                inverse_yield_mm_per_n > 0.0,
            )?;
            check("depth_mm", depth_mm, "more than 0", depth_mm > 0.0)?;
            problem.law.inverse_yield_m_per_n = inverse_yield_mm_per_n * MM;
            problem.law.yield_depth_m = depth_mm * MM;
        }
        Ok(())
    }
}

/// Give of walls that hold a needle as nearly as any box does, one of 25 mm; what stands free gives up to thirty times as much, so that the
/// parameter is a logarithm.
const NEAREST_GIVE_PER_M: f64 = 30.0;

/// `tissue.finite_body`.
#[derive(Debug)]
pub(super) struct FiniteBody;

impl Effect for FiniteBody {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "tissue.finite_body",
                physics: "the tissue is a block: the tissue around the needle moves by (exp(give_ln) - 1) 30/m F/E under a lateral force F, turning about a \
                          fixed foot; give_ln is negative for tissue held in a box (elastic body)",
                signature: "force and shape as in softer or stiffer tissue, the more the deeper the needle",
                observable_in: RunKinds::BOTH,
                is_costly: false,
                parameters: &[
                    ParameterInfo::amplitude("give_ln_y", 0.0, [-3.0, 6.0], [-1.0, 4.0], 0.5),
                    ParameterInfo::amplitude("give_ln_x", 0.0, [-3.0, 6.0], [-1.0, 4.0], 0.5),
                    ParameterInfo::location(
                        "foot_mm",
                        150.0,
                        [20.0, 5000.0],
                        [40.0, 1000.0],
                        50.0,
                        &[60.0, 120.0, 400.0],
                    ),
                ],
            }
        }
    }

    fn beam(&self, values: &[f64], plane: Plane, problem: &mut BeamProblem) -> Result<(), ModelError> {
        let &[give_ln_y, give_ln_x, foot_mm] = values else { return Ok(()) };
        let give_ln = match plane {
            Plane::Y => give_ln_y,
            Plane::X => give_ln_x,
        };
        let give_per_m = NEAREST_GIVE_PER_M * give_ln.exp_m1();
        if give_per_m != 0.0 {
            check("foot_mm", foot_mm, "more than 0", foot_mm > 0.0)?;
            problem.give = Give { per_m: give_per_m, turn_per_m: 1.0 / (foot_mm * MM) };
        }
        Ok(())
    }
}
