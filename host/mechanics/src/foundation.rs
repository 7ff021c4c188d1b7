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

/// Foundation modulus against depth: layers from the surface down, the last one as deep as the needle reaches; and a gradient
/// over all of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Foundation {
    upper: Vec<Layer>,
    deepest_pa: f64,
    /// Relative growth of the modulus with depth: every modulus is times `1 + gradient depth`.
    gradient_per_m: f64,
    /// Depth above which nothing supports the needle.
    gap_m: f64,
}

/// A modulus that grows with depth is constant over slices of this thickness: an error of the order of `gradient^2
/// SLICE^2 / 24`.
const SLICE_M: f64 = 0.5e-3;
/// Thickness of slices for any other function of depth.
const SHAPED_SLICE_M: f64 = 1e-3;
/// A modulus that decreases with depth goes no further down than to this share of that at the surface: a straight line reaches zero
/// somewhere, tissue does not.
const MIN_GROWTH: f64 = 0.1;

impl Foundation {
    /// The same modulus everywhere.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] where the modulus is negative or not finite.
    pub fn uniform(modulus_pa: f64) -> Result<Self, ModelError> {
        Self::layered(Vec::new(), modulus_pa)
    }

    /// Mean of the modulus from the surface to a depth, Pa.
    pub fn mean_pa(&self, depth_m: f64) -> f64 {
        let count = (depth_m / (0.2 * SLICE_M)).ceil().max(1.0) as usize;
        let middle_m = |i: usize| depth_m * (i as f64 + 0.5) / count as f64;
        (0..count).map(|i| self.modulus_pa(middle_m(i))).sum::<f64>() / count as f64
    }

    /// No tissue.
    pub fn none() -> Self {
        Self { upper: Vec::new(), deepest_pa: 0.0, gradient_per_m: 0.0, gap_m: 0.0 }
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
        Ok(Self { upper, deepest_pa, gradient_per_m: 0.0, gap_m: 0.0 })
    }

    /// The same tissue with a modulus that grows by `gradient_per_m` of its value at the surface per metre of depth; one that
    /// decreases ends at a tenth.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] where the gradient is not finite.
    pub fn graded(self, gradient_per_m: f64) -> Result<Self, ModelError> {
        check("gradient_per_m", gradient_per_m, "a finite number", true)?;
        Ok(Self { gradient_per_m, ..self })
    }

    /// The same tissue with every modulus down to a depth times a factor that varies with depth, slice by slice.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] where a factor is negative or not finite.
    pub fn shaped(&self, deepest_m: f64, factor: impl Fn(f64) -> f64) -> Result<Self, ModelError> {
        let count = (deepest_m / SHAPED_SLICE_M).ceil().max(1.0) as usize;
        let thickness_m = deepest_m.max(SHAPED_SLICE_M) / count as f64;
        let slice = |number: usize| {
            let (top_m, bottom_m) = (thickness_m * number as f64, thickness_m * (number + 1) as f64);
            let mut slice_start_m = top_m;
            // The faces of what is there already stay where they are.
            let faces_m = self.upper.iter().map(|layer| layer.bottom_m);
            let inner_faces =
                faces_m.filter(|face_m| *face_m > top_m && *face_m < bottom_m).chain([bottom_m]);
            let slices = inner_faces.map(|to_m| {
                let middle_m = 0.5 * (slice_start_m + to_m);
                slice_start_m = to_m;
                Layer { bottom_m: to_m, modulus_pa: self.layer_pa(middle_m) * factor(middle_m) }
            });
            slices.collect::<Vec<_>>()
        };
        let upper = (0..count).flat_map(slice).collect();
        let deepest_pa = self.layer_pa(deepest_m) * factor(deepest_m);
        let Self { gradient_per_m, gap_m, .. } = *self;
        Ok(Self { gradient_per_m, gap_m, ..Self::layered(upper, deepest_pa)? })
    }

    /// The same tissue that does not support the needle above a depth.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] where the depth is negative or not finite.
    pub fn with_gap(self, gap_m: f64) -> Result<Self, ModelError> {
        check("gap_m", gap_m, "0 or more", gap_m >= 0.0)?;
        Ok(Self { gap_m, ..self })
    }

    /// The gradient over all layers.
    pub fn gradient_per_m(&self) -> f64 {
        self.gradient_per_m
    }

    /// Depth above which nothing supports the needle.
    pub fn gap_m(&self) -> f64 {
        self.gap_m
    }

    /// The parts of the foundation between the surface and `depth_m`: thickness and modulus, from the surface down.
    pub(super) fn parts(&self, depth_m: f64) -> impl Iterator<Item = (f64, f64)> {
        let mut top_m = 0.0;
        let deepest = Layer { bottom_m: f64::INFINITY, modulus_pa: self.deepest_pa };
        let gap = (self.gap_m > 0.0).then_some(Layer { bottom_m: self.gap_m, modulus_pa: 0.0 });
        let below_gap = self.upper.iter().copied().filter(|layer| layer.bottom_m > self.gap_m);
        gap.into_iter().chain(below_gap).chain([deepest]).flat_map(move |layer| {
            let start_m = top_m;
            let thickness_m = layer.bottom_m.min(depth_m) - start_m;
            top_m = start_m + thickness_m;
            let graded = self.gradient_per_m != 0.0 && layer.modulus_pa > 0.0;
            let slices = if graded { (thickness_m / SLICE_M).ceil().max(1.0) } else { 1.0 };
            let slice_m = thickness_m / slices;
            (0..slices as usize)
                .map(move |i| (slice_m, layer.modulus_pa * self.growth(start_m + (i as f64 + 0.5) * slice_m)))
        })
    }

    /// As [`Foundation::parts`], between two depths.
    pub(super) fn parts_between(&self, from_m: f64, to_m: f64) -> impl Iterator<Item = (f64, f64)> {
        let mut top_m = 0.0;
        self.parts(to_m).filter_map(move |(thickness_m, modulus_pa)| {
            let start_m: f64 = top_m;
            top_m += thickness_m;
            let top_in_part_m = top_m - start_m.max(from_m);
            (top_in_part_m > 0.0).then_some((top_in_part_m, modulus_pa))
        })
    }

    /// Depths at which the modulus jumps, from the surface down.
    pub(super) fn faces_m(&self) -> impl Iterator<Item = f64> {
        let gap_m = (self.gap_m > 0.0).then_some(self.gap_m);
        gap_m.into_iter().chain(self.upper.iter().map(|layer| layer.bottom_m).filter(|m| *m > self.gap_m))
    }

    /// The same tissue without its gradient.
    pub(super) fn ungraded(&self) -> Self {
        Self { gradient_per_m: 0.0, ..self.clone() }
    }

    /// Factor of the gradient for a modulus at a depth.
    pub(super) fn growth(&self, depth_m: f64) -> f64 {
        (1.0 + self.gradient_per_m * depth_m).max(MIN_GROWTH)
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
        let upper = self
            .upper
            .iter()
            .map(|layer| Layer { modulus_pa: factor * layer.modulus_pa, ..*layer })
            .collect();
        Ok(Self { upper, deepest_pa: factor * self.deepest_pa, ..*self })
    }

    /// Foundation modulus at a depth below the surface.
    pub fn modulus_pa(&self, depth_m: f64) -> f64 {
        if depth_m < self.gap_m { 0.0 } else { self.layer_pa(depth_m) * self.growth(depth_m) }
    }

    /// Modulus of the layer at a depth, without the gradient.
    pub(super) fn layer_pa(&self, depth_m: f64) -> f64 {
        self.upper
            .iter()
            .find(|layer| depth_m < layer.bottom_m)
            .map_or(self.deepest_pa, |layer| layer.modulus_pa)
    }
}
