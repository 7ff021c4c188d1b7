//! Parameters of the hardware: the needle and where the guides and the tissue are.

use super::unknowns::{Unknown, rig, tissue};
use super::{ModelError, check};
use std::f64::consts::PI;

/// A needle with an annular cross-section.
#[derive(Debug, Clone, PartialEq)]
pub struct Needle {
    /// Young's modulus of its material.
    pub youngs_modulus_pa: f64,
    /// Outer diameter.
    pub outer_diameter_m: f64,
    /// Inner diameter; 0 for a solid needle.
    pub inner_diameter_m: f64,
    /// Bevel angle of the tip, where known.
    pub bevel_angle_rad: Option<f64>,
    /// Length of the whole needle, where known.
    pub length_m: Option<f64>,
    /// Whether modulus and diameters are those of the needle. If they are not known, they are those of a reference
    /// needle: shapes and paths determine no more than the ratio of the foundation's modulus to the bending stiffness,
    /// `K/(E I)`, and every modulus and force that is computed refers to the bending stiffness of the reference.
    pub stiffness_known: bool,
}

impl Needle {
    /// The 18 gauge steel needle of Paper A (Lehmann et al.): 1.27 mm outside, 1.0 mm inside, 200 GPa.
    pub fn gauge_18() -> Self {
        Self {
            youngs_modulus_pa: 200e9,
            outer_diameter_m: 1.27e-3,
            inner_diameter_m: 1.0e-3,
            bevel_angle_rad: None,
            length_m: None,
            stiffness_known: true,
        }
    }

    /// Bending stiffness `E I` with `I = pi/64 (OD^4 - ID^4)`, in N m^2.
    pub fn bending_stiffness_n_m2(&self) -> f64 {
        self.youngs_modulus_pa * PI / 64.0 * (self.outer_diameter_m.powi(4) - self.inner_diameter_m.powi(4))
    }
}

/// Mounting of the needle outside the tissue.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Guides {
    /// Guide 1, in which the needle is clamped, and the actuated guide 2.
    #[default]
    Two,
    /// The actuated guide alone. The needle's rear is held by what pushes it: with the slope it happens to have, against which an
    /// elastic moment works, `EI u''(0) = k_r (u'(0) - slope)`. The slope tilts needle and path as a whole: it is the angle of entry
    /// of an insertion ([`TipLaw::entry_angle_rad`](super::TipLaw)).
    One {
        /// Moment per slope k_r, vertical and horizontal; `None` where it is not known.
        rear_rotation_n_m_per_rad: [Option<f64>; 2],
    },
}

/// The needle in its guides in front of the tissue. Positions are measured along the needle from guide 1, or from the only guide.
#[derive(Debug, Clone, PartialEq)]
pub struct Rig {
    /// The needle.
    pub needle: Needle,
    /// Position of the actuated guide 2; 0 where it is the only one.
    pub guide2_m: f64,
    /// Position of the tissue surface; not before guide 2.
    pub entry_m: f64,
    /// Mounting of the needle.
    pub guides: Guides,
    /// Uncertainty of these parameters.
    pub tolerances: Tolerances,
}

/// Standard deviations of the statements about a rig; without a statement they are those of a rule or a caliper in the
/// hands of a careful person.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Tolerances {
    /// Standard deviation of the position of guide 2 from guide 1.
    pub guide2_m: Option<f64>,
    /// Standard deviation of the position of the tissue surface.
    pub entry_m: Option<f64>,
    /// Standard deviation of the outer diameter of the needle.
    pub outer_diameter_m: Option<f64>,
    /// Standard deviation of the inner diameter of the needle.
    pub inner_diameter_m: Option<f64>,
}

impl Tolerances {
    /// Standard deviation of the position of guide 2.
    pub fn guide2_sd_m(&self) -> f64 {
        self.guide2_m.unwrap_or(rig::GUIDE2_POSITION.sd())
    }

    /// Standard deviation of the position of the surface.
    pub fn entry_sd_m(&self) -> f64 {
        self.entry_m.unwrap_or(tissue::SURFACE.sd())
    }

    /// Standard deviation of the logarithm of the bending stiffness of a needle: of its diameters, which enter with their fourth powers,
    /// and of Young's modulus.
    pub fn stiffness_sd_ln(&self, needle: &Needle) -> f64 {
        let Needle { outer_diameter_m: outer_m, inner_diameter_m: inner_m, .. } = *needle;
        let section = outer_m.powi(4) - inner_m.powi(4);
        let outer = variance_of(outer_m, self.outer_diameter_m, rig::OUTER_DIAMETER, section);
        let inner = variance_of(inner_m, self.inner_diameter_m, rig::INNER_DIAMETER, section);
        outer.hypot(inner).hypot(rig::YOUNGS_MODULUS.sd())
    }
}

/// Variance of the logarithm of the stiffness that an uncertain diameter brings.
fn variance_of(diameter_m: f64, stated: Option<f64>, unknown: Unknown, section: f64) -> f64 {
    4.0 * diameter_m.powi(3) / section * stated.unwrap_or(unknown.sd())
}

impl Rig {
    /// Checks that the numbers describe a needle and guides in the right order.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] naming the first offending quantity.
    pub fn validate(&self) -> Result<(), ModelError> {
        let Needle { youngs_modulus_pa: e, outer_diameter_m: od, inner_diameter_m: id, .. } = self.needle;
        check("youngs_modulus_pa", e, "more than 0", e > 0.0)?;
        check("outer_diameter_m", od, "more than 0", od > 0.0)?;
        check("inner_diameter_m", id, "0 or more, less than the outer diameter", id >= 0.0 && id < od)?;
        match self.guides {
            Guides::Two => check("guide2_m", self.guide2_m, "more than 0", self.guide2_m > 0.0)?,
            Guides::One { rear_rotation_n_m_per_rad } => {
                check("guide2_m", self.guide2_m, "0, as it is the only guide", self.guide2_m == 0.0)?;
                for stiffness in rear_rotation_n_m_per_rad.into_iter().flatten() {
                    check("rear_rotation_n_m_per_rad", stiffness, "more than 0", stiffness > 0.0)?;
                }
            }
        }
        check("entry_m", self.entry_m, "guide2_m or more", self.entry_m >= self.guide2_m)
    }

    /// Two guides, in the first of which the needle is clamped.
    pub fn two_guides(needle: Needle, guide2_m: f64, entry_m: f64) -> Self {
        Self { needle, guide2_m, entry_m, guides: Guides::Two, tolerances: Tolerances::default() }
    }

    /// Whether the actuated guide is the only one.
    pub fn has_one_guide(&self) -> bool {
        matches!(self.guides, Guides::One { .. })
    }

    /// Whether it has one guide and the rotational stiffness of the needle's rear is not known in one of the planes.
    pub fn rear_is_unknown(&self) -> bool {
        [0, 1].into_iter().any(|plane| self.rear_is_unknown_in(plane))
    }

    /// The same of one plane, vertical (0) or horizontal (1).
    pub fn rear_is_unknown_in(&self, plane: usize) -> bool {
        match self.guides {
            Guides::Two => false,
            Guides::One { rear_rotation_n_m_per_rad: stiffness } => {
                stiffness.get(plane).is_some_and(Option::is_none)
            }
        }
    }

    /// Rotation of the needle per moment at the beginning of the beam, rad/(N m), vertical (0) or horizontal (1):
    /// nothing in a clamp. An unknown rear is taken as one that does not turn; its rotation is
    /// `rig.rear_rotation` of the effects.
    pub fn rear_compliance_rad_per_n_m(&self, plane: usize) -> f64 {
        match self.guides {
            Guides::Two => 0.0,
            Guides::One { rear_rotation_n_m_per_rad: stiffness } => {
                stiffness.get(plane).copied().flatten().map_or(0.0, f64::recip)
            }
        }
    }
}

#[cfg(test)]
#[path = "rig_tests.rs"]
mod tests;
