//! Force against depth of an indenter on tissue, per unit of Young's modulus.

use super::layer::{SphereFactor, punch_factor};
use super::{Contact, IndentationError, Indenter};
use std::f64::consts::PI;

/// `g` of the module.
pub(super) struct Curve {
    pub contact: Contact,
    flat_factor: f64,
    sphere_factor: Option<SphereFactor>,
}

impl Curve {
    /// For depths below contact of up to `most_m`; `depth_m` is that of the last row.
    pub fn new(contact: &Contact, most_m: f64, depth_m: f64) -> Result<Self, IndentationError> {
        let mut curve = Self { contact: *contact, flat_factor: 1.0, sphere_factor: None };
        let Some(thickness_m) = contact.thickness_m else { return Ok(curve) };
        if depth_m >= thickness_m {
            return Err(too_thin(thickness_m, depth_m));
        }
        match contact.indenter {
            Indenter::Flat => {
                let ratio = contact.radius_m / thickness_m;
                curve.flat_factor =
                    punch_factor(ratio, contact.poisson).ok_or_else(|| too_thin(thickness_m, depth_m))?;
            }
            Indenter::Sphere => {
                let factor = SphereFactor::new(contact.radius_m, thickness_m, most_m, contact.poisson);
                curve.sphere_factor = Some(factor.ok_or_else(|| too_thin(thickness_m, depth_m))?);
            }
            // No layer is solved for a cone: the half space, with the warning that others have without a thickness.
            Indenter::Cone => {}
        }
        Ok(curve)
    }

    /// Factor for the thickness.
    pub fn factor(&self, x_m: f64) -> f64 {
        match (&self.sphere_factor, self.contact.thickness_m) {
            (Some(factor), Some(thickness_m)) => factor.at(self.contact.radius_m * x_m / thickness_m.powi(2)),
            _ => self.flat_factor,
        }
    }

    /// Force per modulus at a depth below contact.
    pub fn at(&self, x_m: f64) -> f64 {
        let Contact { indenter, radius_m, half_angle_rad, poisson, .. } = self.contact;
        let x_m = x_m.max(0.0);
        let plain = match indenter {
            Indenter::Flat => 2.0 * radius_m * x_m,
            Indenter::Sphere => 4.0 / 3.0 * radius_m.sqrt() * x_m.powf(1.5),
            Indenter::Cone => 2.0 / PI * half_angle_rad.tan() * x_m * x_m,
        };
        plain * self.factor(x_m) / (1.0 - poisson * poisson)
    }
}

fn too_thin(thickness_m: f64, depth_m: f64) -> IndentationError {
    IndentationError::TooThin { thickness_mm: 1e3 * thickness_m, depth_mm: 1e3 * depth_m }
}
