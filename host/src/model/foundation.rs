//! The tissue as an elastic (Winkler) foundation: lateral force per needle length and deflection.

use super::{ModelError, check};

/// Tissue of one foundation modulus down to some depth below the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Layer {
    /// Depth of the layer's lower face below the tissue surface.
    pub bottom_m: f64,
    /// Foundation modulus K: lateral force per length and deflection (N/m per m). Not Young's modulus.
    pub modulus_pa: f64,
}

/// Foundation modulus against depth: layers from the surface down; the last one reaches as deep as the needle does.
#[derive(Debug, Clone, PartialEq)]
pub struct Foundation {
    upper: Vec<Layer>,
    deepest_pa: f64,
}

impl Foundation {
    /// The same modulus everywhere.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] where the modulus is negative or not finite.
    pub fn uniform(modulus_pa: f64) -> Result<Self, ModelError> {
        Self::layered(Vec::new(), modulus_pa)
    }

    /// Layers from the surface down, then `deepest_pa` for all that is below them.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] where a modulus is negative or the faces do not get deeper.
    pub fn layered(upper: Vec<Layer>, deepest_pa: f64) -> Result<Self, ModelError> {
        let mut top_m = 0.0;
        for layer in &upper {
            check("bottom_m", layer.bottom_m, "deeper than the layer above", layer.bottom_m > top_m)?;
            check("modulus_pa", layer.modulus_pa, "0 or more", layer.modulus_pa >= 0.0)?;
            top_m = layer.bottom_m;
        }
        check("modulus_pa", deepest_pa, "0 or more", deepest_pa >= 0.0)?;
        Ok(Self { upper, deepest_pa })
    }

    /// The parts of the foundation between the surface and `depth_m`: thickness and modulus, from the surface down.
    pub(super) fn parts(&self, depth_m: f64) -> impl Iterator<Item = (f64, f64)> {
        let mut top_m = 0.0;
        let deepest = Layer { bottom_m: f64::INFINITY, modulus_pa: self.deepest_pa };
        self.upper.iter().copied().chain([deepest]).map(move |layer| {
            let bottom_m = layer.bottom_m.min(depth_m);
            let thickness_m = bottom_m - top_m;
            top_m = bottom_m;
            (thickness_m, layer.modulus_pa)
        })
    }

    /// The layers that end above a depth.
    pub(super) fn layers_above(&self, depth_m: f64) -> Vec<Layer> {
        self.upper.iter().filter(|layer| layer.bottom_m < depth_m).copied().collect()
    }

    /// The same tissue with every modulus times a factor.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] where the factor is negative or not finite.
    pub fn scaled(&self, factor: f64) -> Result<Self, ModelError> {
        check("modulus factor", factor, "0 or more", factor >= 0.0)?;
        let scaled = |layer: &Layer| Layer { modulus_pa: factor * layer.modulus_pa, ..*layer };
        Ok(Self { upper: self.upper.iter().map(scaled).collect(), deepest_pa: factor * self.deepest_pa })
    }

    /// Foundation modulus at a depth below the surface.
    pub fn modulus_pa(&self, depth_m: f64) -> f64 {
        self.upper
            .iter()
            .find(|layer| depth_m < layer.bottom_m)
            .map_or(self.deepest_pa, |layer| layer.modulus_pa)
    }
}
