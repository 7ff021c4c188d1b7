//! Needle in tissue: geometry, stiffness and supports.

use super::terms::ActingLaw;
use super::{Foundation, ModelError, Rig, Support, check};

/// Problem that is solved: geometry, stiffness and supports of the needle in the tissue.
#[derive(Debug, Clone, PartialEq)]
pub struct BeamProblem {
    /// Bending stiffness of the needle.
    pub bending_stiffness_n_m2: f64,
    /// Position of guide 2, where the lateral force acts.
    pub guide2_m: f64,
    /// Position of the tissue surface.
    pub entry_m: f64,
    /// Length of the needle inside the tissue.
    pub depth_m: f64,
    /// Whether guide 2 is the only guide, at 0.
    pub only_guide: bool,
    /// Rotation of the needle in guide 1, or in its only guide, per moment; 0 is a perfect clamp.
    pub clamp_compliance_rad_per_n_m: f64,
    /// Compliance of the frame that carries guide 2, if guide 2 holds the needle during an insertion
    /// ([`GrowingBeam`](super::growth::GrowingBeam)). Per unit force at guide 2 ([`BeamProblem::solve`]) it makes no
    /// difference; lateral runs have it in series with the needle ([`Drive`](super::Drive)).
    pub guide2_compliance_m_per_n: f64,
    /// Compressive axial load of the needle, P: energy `-P/2 int_0^L u'^2`.
    pub axial_load_n: f64,
    /// Shear layer of the tissue, G (Pasternak): energy `G/2 int_c^L u'^2`.
    pub shear_n: f64,
    /// Spring at the surface, k.
    pub skin_n_per_m: f64,
    /// Moment of guide 2 per rotation of the needle in it; 0 is a guide that lets it turn. Insertions leave it out.
    pub guide2_turn_n_m_per_rad: f64,
    /// Spring at the tip, by which what lies there holds it. Insertions leave it out.
    pub tip_support_n_per_m: f64,
    /// The tissue: K of springs, or E of a body.
    pub foundation: Foundation,
    /// Support of the needle by the tissue.
    pub support: Support,
    /// Radius of the needle, on which the stiffness of a body depends.
    pub radius_m: f64,
    /// Motion of a body as a whole, or its support by walls.
    pub give: Give,
    /// Departure of the tissue from a linear spring; [`BeamProblem::solve`] leaves it out.
    pub law: TissueLaw,
    /// Laws that act on the reaction of the tissue in lateral runs; [`BeamProblem::solve`] leaves it out.
    pub reaction: Vec<ActingLaw>,
    /// Laws that act on the bending stiffness along the needle in lateral runs; [`BeamProblem::solve`] leaves it out.
    pub stiffness: Vec<ActingLaw>,
}

/// Uniform effect of walls far from the needle: the tissue around it moves by `per_m F/E` per lateral force F and turns
/// about a depth. Springs have no walls.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Give {
    /// Displacement of the tissue around the needle per force, times Young's modulus, at the surface: negative where a box holds it.
    pub per_m: f64,
    /// One over the depth that does not move.
    pub turn_per_m: f64,
}

impl Give {
    /// A half space.
    pub const NONE: Self = Self { per_m: 0.0, turn_per_m: 0.0 };
}

/// Departure of the tissue from a linear spring.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TissueLaw {
    /// Stiffening, `1/u0`: the reaction is `K u (1 + (u/u0)^2)`.
    pub inverse_u0_per_m: f64,
    /// Share of K that relaxes while the needle is held: a standard linear solid.
    pub relaxing_share: f64,
    /// Time in which it relaxes.
    pub relaxation_s: f64,
    /// Yielding, 1 over the line load at the surface that the reaction does not exceed, m/N.
    pub inverse_yield_m_per_n: f64,
    /// Depth over which that load grows by e; beside a yield of more than 0 it is more than 0.
    pub yield_depth_m: f64,
}

impl BeamProblem {
    /// The needle of `rig`, inserted to `depth_m`, perfectly clamped in guide 1 or held in its only guide as it is vertically.
    pub fn new(rig: &Rig, foundation: Foundation, depth_m: f64) -> Self {
        Self {
            bending_stiffness_n_m2: rig.needle.bending_stiffness_n_m2(),
            guide2_m: rig.guide2_m,
            entry_m: rig.entry_m,
            depth_m,
            only_guide: rig.has_one_guide(),
            clamp_compliance_rad_per_n_m: rig.rear_compliance_rad_per_n_m(0),
            guide2_compliance_m_per_n: 0.0,
            axial_load_n: 0.0,
            shear_n: 0.0,
            skin_n_per_m: 0.0,
            guide2_turn_n_m_per_rad: 0.0,
            tip_support_n_per_m: 0.0,
            foundation,
            support: Support::Springs,
            radius_m: 0.5 * rig.needle.outer_diameter_m,
            give: Give::NONE,
            law: TissueLaw::default(),
            reaction: Vec::new(),
            stiffness: Vec::new(),
        }
    }

    /// The same in insertions, of which what holds guide 2's rotation and the tip is no part.
    pub(super) fn inserted(&self) -> Self {
        Self { guide2_turn_n_m_per_rad: 0.0, tip_support_n_per_m: 0.0, ..self.clone() }
    }

    /// Whether force and shape are not in proportion to the displacement of guide 2.
    pub(super) fn is_nonlinear(&self) -> bool {
        self.law.is_nonlinear() || !self.reaction.is_empty()
    }

    /// Refuses what no needle can be.
    pub(super) fn check(&self) -> Result<(), ModelError> {
        let stiffness = self.bending_stiffness_n_m2;
        let compliance = self.clamp_compliance_rad_per_n_m;
        check("bending_stiffness_n_m2", stiffness, "more than 0", stiffness > 0.0)?;
        if self.only_guide {
            check("guide2_m", self.guide2_m, "0, as it is the only guide", self.guide2_m == 0.0)?;
        } else {
            check("guide2_m", self.guide2_m, "more than 0", self.guide2_m > 0.0)?;
        }
        check("entry_m", self.entry_m, "guide2_m or more", self.entry_m >= self.guide2_m)?;
        check("depth_m", self.depth_m, "0 or more", self.depth_m >= 0.0)?;
        check("clamp_compliance_rad_per_n_m", compliance, "0 or more", compliance >= 0.0)?;
        let frame = self.guide2_compliance_m_per_n;
        check("guide2_compliance_m_per_n", frame, "0 or more", frame >= 0.0)?;
        check("axial_load_n", self.axial_load_n, "a finite number", true)?;
        check("shear_n", self.shear_n, "0 or more", self.shear_n >= 0.0)?;
        check("skin_n_per_m", self.skin_n_per_m, "0 or more", self.skin_n_per_m >= 0.0)?;
        let turn = self.guide2_turn_n_m_per_rad;
        check("guide2_turn_n_m_per_rad", turn, "0 or more", turn >= 0.0)?;
        check("tip_support_n_per_m", self.tip_support_n_per_m, "0 or more", self.tip_support_n_per_m >= 0.0)?;
        check("radius_m", self.radius_m, "more than 0", self.radius_m > 0.0)?;
        check("give_per_m", self.give.per_m, "a finite number", true)?;
        check("turn_per_m", self.give.turn_per_m, "a finite number", true)?;
        self.support.check()
    }
}
