//! A lateral run as data for [`fit`](super::fit): shared `ln K`, own true displacement of every level and, where there
//! is a hold at zero displacement, the force sensor's offset (theory, eq. 24).
//!
//! The measured displacement of a level is data like any other, not the truth: the true one is an unknown, so its
//! uncertainty is in the interval of K. Force and displacement at zero displacement are a level too; together with the
//! offset they are the zero of the run, with the uncertainty of their own.

use super::{Block, Parameter, Prior};
use crate::holds::reversal_of_means_m;
use formats::session::SHARED_ERRORS;
use mechanics::effects::Effect;
use mechanics::{
    DriveSample, Model, ModelError, ObservationPlan, PreparedNeedle, Rig, Series, ShapeImage, ShapePoint,
    Support,
};
use smallvec::SmallVec;
use std::borrow::Cow;

mod channels;
mod history;
mod shared;

pub use channels::{ChannelFit, ShapeFit, channel_fits, shape_fits};
pub use history::{DisplacementHistory, Fixed};
use shared::NO_ERRORS;
pub use shared::SharedErrors;

/// A true displacement is not expected further beyond a measured one than this, standard deviations.
const FAR_SD: f64 = 4.0;
/// Step of the difference that gives the slope of the needle.
const SLOPE_STEP_M: f64 = 1e-4;

/// A measured value and its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured {
    /// The value.
    pub value: f64,
    /// Its standard deviation.
    pub sd: f64,
}

/// A point of the measured shape, `[y, x]`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShapeDatum {
    /// Position along the needle from guide 1.
    pub z_m: f64,
    /// Deflection in each plane; the second is not used in a one-plane run.
    pub deflection_m: [f64; 2],
    /// Standard deviation in each plane over that of the run, [`LateralData::shape_sd_m`].
    pub sd_ratio: [f64; 2],
    /// Image from which the shape was taken, if that is known.
    pub image: Option<ShapeImage>,
    /// Standard deviation of an error of its position that all points of the run share; 0 for none.
    pub z_shared_sd_m: f64,
    /// Errors of the deflections that all points of the run share, in each plane: what one standard deviation of each does here.
    pub shared_m: [[f64; SHARED_ERRORS]; 2],
}

impl ShapeDatum {
    /// A point with the standard deviation of its run.
    pub fn new(z_m: f64, deflection_m: [f64; 2]) -> Self {
        Self { z_m, deflection_m, sd_ratio: [1.0; 2], image: None, z_shared_sd_m: 0.0, shared_m: NO_ERRORS }
    }
}

/// Measurements at one level; one entry per plane, `[y]` or `[y, x]`.
#[derive(Debug, Clone, PartialEq)]
pub struct HoldData {
    /// Displacement of guide 2.
    pub displacement_m: Vec<Measured>,
    /// Force of guide 2.
    pub force_n: Vec<Measured>,
    /// Shape points.
    pub shape: Vec<ShapeDatum>,
}

/// Knowledge of the zero of a run's force, before its readings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ForceZero {
    /// It is right.
    Exact,
    /// A hold at zero displacement determines it.
    Measured,
    /// The run has no measurement of it: what is assumed of both planes, N, counts as one more reading of
    /// each.
    Assumed([Measured; 2]),
}

impl ForceZero {
    /// Right, with this standard deviation.
    pub fn assumed(sd_n: f64) -> Self {
        Self::Assumed([Measured { value: 0.0, sd: sd_n }; 2])
    }

    /// Zero of a run of one plane alone.
    fn in_plane(self, plane: usize) -> Self {
        match self {
            Self::Assumed([_, x]) if plane == 1 => Self::Assumed([x; 2]),
            other => other,
        }
    }
}

/// A lateral run ready for the fit.
#[derive(Debug, Clone)]
pub struct LateralData {
    /// Needle, guides and tissue surface.
    pub rig: Rig,
    /// Support of the needle by the tissue: the shared modulus is K of springs or E of a body.
    pub support: Support,
    /// Length of the needle inside the tissue.
    pub depth_m: f64,
    /// Number of planes with data: 1 or 2.
    pub planes: usize,
    /// Its levels; the zero holds among them.
    pub levels: Vec<HoldData>,
    /// Standard deviation of a deflection; of single ones a multiple of it ([`ShapeDatum::sd_ratio`]).
    pub shape_sd_m: f64,
    /// Knowledge of the force sensor's zero.
    pub force_zero: ForceZero,
    /// Errors that its points share.
    pub shared: SharedErrors,
    /// Whether the force is used; displacement and shape alone determine K as well.
    pub uses_force: bool,
    /// Effects whose parameters are unknown too, shared by all runs: after `ln K`, in this order.
    pub effects: Vec<&'static dyn Effect>,
    /// Effects whose values are known, and the run's course, on which they may depend; none is the plain model.
    pub fixed: Option<Fixed>,
}

/// Unknowns that effects bring: in the order of [`LateralData::effects`], with the priors of the effects.
pub fn effect_parameters(effects: &[&'static dyn Effect]) -> Vec<Parameter> {
    let parameters = effects.iter().flat_map(|effect| effect.parameters());
    parameters
        .map(|info| {
            let [least, most] = info.range;
            let prior = Some(Prior { mean: info.neutral, sd: info.prior_sd });
            // Off a bound, so that both differences of the derivative exist.
            let start = (info.neutral + 0.1 * info.prior_sd).clamp(least, most);
            Parameter { start, step: 1e-4 * info.prior_sd, least, most, prior }
        })
        .collect()
}

impl LateralData {
    /// The same run without its force.
    pub fn without_force(&self) -> Self {
        Self { uses_force: false, ..self.clone() }
    }

    /// One plane of the run alone, 0 for y and 1 for x; nothing where guide 2 was not displaced in it by more than `least_m`.
    pub fn in_plane(&self, plane: usize, least_m: f64) -> Option<Self> {
        fn one(values: &[Measured], plane: usize) -> Vec<Measured> {
            values.get(plane).copied().into_iter().collect::<Vec<_>>()
        }
        let levels: Vec<HoldData> = self
            .levels
            .iter()
            .map(|level| HoldData {
                displacement_m: one(&level.displacement_m, plane),
                force_n: one(&level.force_n, plane),
                shape: level
                    .shape
                    .iter()
                    .map(|point| ShapeDatum {
                        z_m: point.z_m,
                        deflection_m: [point.deflection_m.get(plane).copied().unwrap_or(f64::NAN), 0.0],
                        sd_ratio: [point.sd_ratio.get(plane).copied().unwrap_or(1.0), 1.0],
                        image: point.image,
                        z_shared_sd_m: point.z_shared_sd_m,
                        shared_m: [point.shared_m.get(plane).copied().unwrap_or_default(), NO_ERRORS[1]],
                    })
                    .collect(),
            })
            .collect();
        let displaced =
            levels.iter().flat_map(|level| &level.displacement_m).any(|u| u.value.abs() > least_m);
        let fixed = self.fixed.as_ref().map(|fixed| Fixed { first_plane: plane, ..fixed.clone() });
        let force_zero = self.force_zero.in_plane(plane);
        let [y, x] = self.shared.deflection;
        let shared = SharedErrors { deflection: [if plane == 0 { y } else { x }, y], ..self.shared };
        displaced.then(|| Self { planes: 1, levels, fixed, force_zero, shared, ..self.clone() })
    }

    fn offsets(&self) -> usize {
        if self.force_zero != ForceZero::Exact && self.uses_force { self.planes } else { 0 }
    }

    /// Number of deflections that were measured, over all planes.
    pub fn shape_values(&self) -> usize {
        self.planes * self.points()
    }

    /// Number of shape points of all levels.
    fn points(&self) -> usize {
        self.levels.iter().map(|level| level.shape.len()).sum()
    }

    /// Tissue and effects of these shared parameters.
    fn model(&self, shared: &[f64]) -> Result<Model, ModelError> {
        let (ln_k, mut values) =
            shared.split_first().map_or((f64::NAN, shared), |(ln_k, rest)| (*ln_k, rest));
        let mut model = Model::on(self.rig.clone(), self.support, ln_k.exp())?;
        if let Some(fixed) = &self.fixed {
            model.effects.extend(fixed.effects.iter().cloned());
        }
        for effect in &self.effects {
            let (effect_values, remaining_values) =
                values.split_at(effect.parameters().len().min(values.len()));
            model.effects.push((*effect, effect_values.to_vec()));
            values = remaining_values;
        }
        Ok(model)
    }

    /// Motion of guide 2 through these true displacements of the levels.
    fn drive(&self, displacements_m: &[f64]) -> SmallVec<[DriveSample; 8]> {
        if let Some(fixed) = &self.fixed {
            return fixed.drive(self.planes, displacements_m).into();
        }
        let of_levels = displacements_m.chunks(self.planes).enumerate();
        of_levels
            .map(|(level, of_level)| DriveSample {
                time_s: level as f64,
                y_m: of_level.first().copied().unwrap_or_default(),
                x_m: of_level.get(1).copied().unwrap_or_default(),
            })
            .collect()
    }

    /// When and where the shape is predicted: at its points, and a little before each where the slope there is needed.
    fn shape(&self) -> Vec<ShapePoint> {
        let mut shape = self.measured();
        if self.shares_z() {
            fn before(point: &ShapePoint) -> ShapePoint {
                ShapePoint { z_m: point.z_m - SLOPE_STEP_M, ..*point }
            }
            shape.extend_from_within(..);
            let points = shape.len() / 2;
            shape.iter_mut().skip(points).for_each(|point| *point = before(point));
        }
        shape
    }

    /// When and where the shape was measured.
    fn measured(&self) -> Vec<ShapePoint> {
        if let Some(fixed) = &self.fixed {
            return fixed.shape(&self.levels);
        }
        let mut shape = Vec::with_capacity(self.points());
        for (level, data) in self.levels.iter().enumerate() {
            let time_s = level as f64;
            shape.extend(data.shape.iter().map(|point| ShapePoint {
                time_s,
                z_m: point.z_m,
                image: point.image,
            }));
        }
        shape
    }

    /// Motion back by less is noise of the displacement: of the course, or of the means of the holds.
    fn reversal_m(&self) -> [f64; 2] {
        if let Some(fixed) = &self.fixed {
            return fixed.course.reversal_m;
        }
        [0, 1].map(|plane| {
            let of_levels = self.levels.iter().filter_map(|level| level.displacement_m.get(plane));
            reversal_of_means_m(&of_levels.map(|measured| measured.sd).collect::<Vec<_>>())
        })
    }

    /// Largest displacement of guide 2 in each plane; true displacements are not far from the measured
    /// ones.
    fn most_m(&self) -> [f64; 2] {
        let measured = self.levels.iter().flat_map(|level| &level.displacement_m);
        let farthest_m = measured.map(|m| m.value.abs() + FAR_SD * m.sd).fold(0.0, f64::max);
        let rows_m = self.fixed.as_ref().map_or(0.0, Fixed::farthest_m);
        [farthest_m.max(rows_m); 2]
    }
}

/// The values of one plane.
fn of_plane(series: &Series, plane: usize) -> &[f64] {
    if plane == 0 { &series.y } else { series.x.as_deref().unwrap_or_default() }
}

impl Block for LateralData {
    type Prepared<'a> = PreparedNeedle<'a>;

    fn nuisances(&self) -> Vec<Parameter> {
        let offsets = (0..self.offsets()).map(|_| Parameter::free(0.0, 1e-3));
        let true_m = self.levels.iter().flat_map(|level| &level.displacement_m);
        let shared = self.expected().chain(self.shares_z().then_some(self.shared.z));
        let shared = shared.map(|expected| Parameter::free(expected, 1e-3));
        offsets.chain(true_m.map(|measured| Parameter::free(measured.value, 1e-6))).chain(shared).collect()
    }

    fn prepare(&self, shared: &[f64]) -> Result<PreparedNeedle<'_>, ModelError> {
        // A course is one of both planes, whichever of them the data are of.
        let planes = if self.fixed.is_some() { 2 } else { self.planes };
        let sight = ObservationPlan {
            shape: &self.shape(),
            most_m: self.most_m(),
            planes,
            reversal_m: self.reversal_m(),
            order: self.fixed.as_ref().map_or(0.0, |fixed| fixed.order),
        };
        PreparedNeedle::new(Cow::Owned(self.model(shared)?), self.depth_m, sight, None)
    }

    /// Plane by plane: displacements, forces, shape points; then the assumed zeros of the force, and the shared errors of the deflections
    /// and of the positions.
    fn residuals(&self, ready: &PreparedNeedle<'_>, nuisances: &[f64]) -> Result<Vec<f64>, ModelError> {
        let (nuisances, z_shared) = match nuisances.split_last() {
            Some((z_shared, others)) if self.shares_z() => (others, *z_shared),
            _ => (nuisances, 0.0),
        };
        let of_deflections = self.shared_deflections();
        let (nuisances, errors) = nuisances.split_at(nuisances.len().saturating_sub(of_deflections.len()));
        fn shared_m(
            plane: usize,
            point: &ShapeDatum,
            of_deflections: &SmallVec<[(usize, usize); 6]>,
            errors: &&[f64],
        ) -> f64 {
            let of_plane = of_deflections.iter().zip(*errors).filter(|((of, _), _)| *of == plane);
            of_plane.map(|((plane, error), by)| by * point.shared_m[*plane][*error]).sum()
        }
        let (offsets_n, displacements_m) = nuisances.split_at(self.offsets().min(nuisances.len()));
        let mut predicted = ready.moved(&self.drive(displacements_m))?;
        if let Some(fixed) = &self.fixed {
            predicted = fixed.at_levels(predicted);
        }
        let mut residuals = Vec::with_capacity(self.planes * (2 * self.levels.len() + self.points()));
        for plane in 0..self.planes {
            let offset_n = offsets_n.get(plane).copied().unwrap_or_default();
            fn against(predicted: f64, measured: Option<&Measured>) -> f64 {
                measured.map_or(f64::NAN, |measured| (measured.value - predicted) / measured.sd)
            }
            for (predicted, level) in of_plane(&predicted.displacement_m, plane).iter().zip(&self.levels) {
                residuals.push(against(*predicted, level.displacement_m.get(plane)));
            }
            let forces = of_plane(&predicted.force_n, plane);
            for (predicted, level) in forces.iter().zip(&self.levels).filter(|_| self.uses_force) {
                residuals.push(against(predicted + offset_n, level.force_n.get(plane)));
            }
            let shape_m = of_plane(&predicted.shape_m, plane);
            let (shape_m, shape_part_m) = shape_m.split_at(self.points().min(shape_m.len()));
            let points = self.levels.iter().flat_map(|level| &level.shape);
            residuals.extend(points.zip(shape_m).enumerate().map(|(i, (point, predicted_m))| {
                fn of_plane([y, x]: [f64; 2], plane: usize) -> f64 {
                    if plane == 0 { y } else { x }
                }
                let slope = shape_part_m
                    .get(i)
                    .map_or(0.0, |shape_part_m| (predicted_m - shape_part_m) / SLOPE_STEP_M);
                let expected_m = predicted_m
                    + z_shared * point.z_shared_sd_m * slope
                    + shared_m(plane, point, &of_deflections, &errors);
                let point_residual_m = of_plane(point.deflection_m, plane) - expected_m;
                point_residual_m / (self.shape_sd_m * of_plane(point.sd_ratio, plane))
            }));
        }
        if let ForceZero::Assumed(zeros) = self.force_zero {
            residuals.extend(
                zeros.iter().zip(offsets_n).map(|(zero, offset_n)| (zero.value - offset_n) / zero.sd),
            );
        }
        residuals.extend(self.expected().zip(errors).map(|(expected, error)| expected - error));
        if self.shares_z() {
            residuals.push(self.shared.z - z_shared);
        }
        Ok(residuals)
    }
}

#[cfg(test)]
mod shared_tests;
