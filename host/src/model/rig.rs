//! What is known about the hardware: the needle and where the guides and the tissue are.

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
        }
    }

    /// Bending stiffness `E I` with `I = pi/64 (OD^4 - ID^4)`, in N m^2.
    pub fn bending_stiffness_n_m2(&self) -> f64 {
        self.youngs_modulus_pa * PI / 64.0 * (self.outer_diameter_m.powi(4) - self.inner_diameter_m.powi(4))
    }
}

/// The needle in its guides in front of the tissue. Positions are measured along the needle from guide 1.
#[derive(Debug, Clone, PartialEq)]
pub struct Rig {
    /// The needle.
    pub needle: Needle,
    /// Position of the actuated guide 2.
    pub guide2_m: f64,
    /// Position of the tissue surface; not before guide 2.
    pub entry_m: f64,
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
        check("guide2_m", self.guide2_m, "more than 0", self.guide2_m > 0.0)?;
        check("entry_m", self.entry_m, "guide2_m or more", self.entry_m >= self.guide2_m)
    }
}
