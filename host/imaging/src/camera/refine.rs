//! Translation of a template to hundredths of a pixel by Gauss-Newton steps (Baker and Matthews, International Journal of Computer Vision
//! 56:221, 2004).
//!
//! The model is `I(x + d) = a T(x) + b + noise`. With the gradients `J` of the template, without what a factor and an offset explain, `d`
//! solves `sum J I(x + d) = 0`. Both images have noise, that of the gradient of `I` is independent of that of `J`; so
//! `H = sum J grad I(x + d)` is what it would be without, and `H^-1 S H^-T` with the variance `S` of `sum J r` is the covariance of `d`. `S`
//! comes from the residuals `r` and their correlation from pixel to pixel: a compressed or interpolated image has noise that is not white.

use super::super::frame::{Frame, Region};
use super::spline::{Sample, Spline};
use super::texture::{Directions, ROUNDING, directions, noise};
use super::{CameraError, MAX_SD_PX};
use nalgebra::{Matrix2, Vector2};

/// Most steps.
const MAX_STEPS: usize = 40;
/// A shorter step is the last, pixels.
const SETTLED_PX: f64 = 1e-4;
/// Farthest from what correlation found, pixels.
const MAX_AWAY_PX: f64 = 1.5;
/// Distance over which residuals may be correlated, pixels.
const CORRELATED: i64 = 2;
/// Error by interpolation, pixels: the error on a real image that is shifted without noise.
const INTERPOLATION_PX: f64 = 8e-4;

/// Translation of a template.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Translation {
    /// Pixels from its place in its own frame, along rows and columns; 0 along a direction without texture.
    pub shift_px: [f64; 2],
    /// Covariance; 0 along a direction without texture.
    pub covariance_px2: [[f64; 2]; 2],
    /// Correlation coefficient there.
    pub score: f64,
    /// Brightness over that in the template.
    pub gain: f64,
    /// Root mean square of what the template does not explain, grey levels.
    pub residual: f64,
}

/// Why a translation is not found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum RefineError {
    /// A part of the template would be outside the frame.
    Outside,
    /// No end of the steps, or an uncertain one.
    NotConverged,
}

/// A template with its gradients.
pub(super) struct Patch {
    region: Region,
    /// Brightness without its mean.
    values: Vec<f64>,
    squares: f64,
    /// Gradients without what brightness explains.
    gradients: Vec<Vector2<f64>>,
    products: Matrix2<f64>,
    pub(super) directions: Directions,
}

impl Patch {
    /// Template from a region of a frame.
    ///
    /// # Errors
    /// [`CameraError::NoTexture`].
    pub(super) fn new(frame: &Frame, region: Region, option: &'static str) -> Result<Self, CameraError> {
        let spline =
            Spline::new(frame, [region.x, region.y], [region.x + region.width, region.y + region.height]);
        let samples = sampled(&spline, region, [0.0; 2]).unwrap_or_default();
        let count = samples.len().max(1) as f64;
        let mean = samples.iter().map(|sample| sample.value).sum::<f64>() / count;
        let values: Vec<f64> = samples.iter().map(|sample| sample.value - mean).collect();
        let squares: f64 = values.iter().map(|value| value * value).sum();
        let raw: Vec<Vector2<f64>> = samples.iter().map(|sample| Vector2::from(sample.gradient)).collect();
        let mean_gradient: Vector2<f64> = raw.iter().sum::<Vector2<f64>>() / count;
        let explained: Vector2<f64> =
            values.iter().zip(&raw).map(|(value, gradient)| *gradient * *value).sum::<Vector2<f64>>()
                / squares.max(1e-9);
        let gradients: Vec<Vector2<f64>> = values
            .iter()
            .zip(&raw)
            .map(|(value, gradient)| gradient - mean_gradient - explained * *value)
            .collect();
        let products: Matrix2<f64> = gradients.iter().map(|gradient| gradient * gradient.transpose()).sum();
        let directions = directions(&products, values.len(), noise(frame, region), option)?;
        Ok(Self { region, values, squares, gradients, products, directions })
    }

    /// In its own frame it is where it is, to the rounding of brightness.
    pub(super) fn own(&self) -> Translation {
        let mut self_match = Translation {
            shift_px: [0.0; 2],
            covariance_px2: [[0.0; 2]; 2],
            score: 1.0,
            gain: 1.0,
            residual: 0.0,
        };
        let variance = 2.0 * ROUNDING * ROUNDING;
        if let Some(inverse) = self.limited(self.products).try_inverse() {
            self_match.covariance_px2 = self.reported(inverse * variance);
        }
        self_match
    }

    /// Refuses a template of which the residuals of its frames show that its gradients are those of noise.
    ///
    /// # Errors
    /// [`CameraError::NoTexture`].
    pub(super) fn check_noise(&self, option: &'static str, residuals: &[f64]) -> Result<(), CameraError> {
        let mut sorted = residuals.to_vec();
        sorted.sort_by(f64::total_cmp);
        let Some(median) = sorted.get(sorted.len() / 2) else { return Ok(()) };
        // A residual has the noise of two images.
        let noise = (median / 2f64.sqrt()).max(ROUNDING);
        let texture = directions(&self.products, self.values.len(), noise, option)?;
        let lost = self.directions.free().iter().zip(texture.free()).any(|(was, is)| *was && !is);
        if !lost {
            return Ok(());
        }
        let direction = if texture == Directions::Vertical { "rows" } else { "columns" };
        let direction = format!("the {direction} of the image");
        Err(CameraError::NoTexture { option, direction, sd_px: f64::INFINITY })
    }

    /// Translation near what correlation found.
    pub(super) fn refine(&self, frame: &Frame, near: [i64; 2]) -> Result<Translation, RefineError> {
        let Region { x, y, width, height } = self.region;
        let reach = MAX_AWAY_PX.ceil() as i64;
        let first_shift = [shifted_bound(x, near[0] - reach, 0), shifted_bound(y, near[1] - reach, 0)];
        let end_shift =
            [shifted_bound(x, near[0] + reach + 1, width), shifted_bound(y, near[1] + reach + 1, height)];
        let spline = Spline::new(frame, first_shift, end_shift);
        let mut shift = Vector2::new(near[0] as f64, near[1] as f64);
        let start = shift;
        for _ in 0..MAX_STEPS {
            let samples = sampled(&spline, self.region, shift.into()).ok_or(RefineError::Outside)?;
            let (mut right, mut slope) = (Vector2::zeros(), Matrix2::zeros());
            for (gradient, sample) in self.gradients.iter().zip(&samples) {
                right += gradient * sample.value;
                slope += gradient * Vector2::from(sample.gradient).transpose();
            }
            let inverse = self.limited(slope).try_inverse().ok_or(RefineError::NotConverged)?;
            let mut step = -(inverse * self.only_free(right));
            let length = step.norm();
            if !length.is_finite() {
                return Err(RefineError::NotConverged);
            }
            if length < SETTLED_PX {
                return self.finish(&samples, shift, inverse);
            }
            if length > 1.0 {
                step /= length;
            }
            shift += step;
            if (shift - start).amax() > MAX_AWAY_PX {
                return Err(RefineError::NotConverged);
            }
        }
        Err(RefineError::NotConverged)
    }

    fn finish(
        &self,
        samples: &[Sample],
        shift: Vector2<f64>,
        inverse: Matrix2<f64>,
    ) -> Result<Translation, RefineError> {
        let count = samples.len() as f64;
        let mean = samples.iter().map(|sample| sample.value).sum::<f64>() / count;
        let products: f64 =
            samples.iter().zip(&self.values).map(|(sample, value)| sample.value * value).sum();
        let squares: f64 = samples.iter().map(|sample| (sample.value - mean).powi(2)).sum();
        let gain = products / self.squares.max(1e-9);
        let residuals: Vec<f64> = samples
            .iter()
            .zip(&self.values)
            .map(|(sample, value)| sample.value - mean - gain * value)
            .collect();
        // Factor, offset and translation are fitted.
        let freedom = (count - 4.0).max(1.0);
        let residual = (residuals.iter().map(|r| r * r).sum::<f64>() / freedom).sqrt();
        let variance = self.variance(&residuals, (residual * residual).max(2.0 * ROUNDING * ROUNDING));
        let interpolation = Matrix2::identity() * INTERPOLATION_PX.powi(2);
        let covariance_px2 = self.reported(inverse * variance * inverse.transpose() + interpolation);
        let is_certain = (0..2).all(|axis| {
            let sd_px = covariance_px2.get(axis).and_then(|row| row.get(axis)).map_or(f64::NAN, |v| v.sqrt());
            sd_px <= MAX_SD_PX
        });
        if gain <= 0.0 || !is_certain {
            return Err(RefineError::NotConverged);
        }
        let score = products / (self.squares * squares).max(1e-9).sqrt();
        let free = self.directions.free();
        let shift_px = [0, 1].map(|axis: usize| if free[axis] { shift[axis] } else { 0.0 });
        Ok(Translation { shift_px, covariance_px2, score, gain, residual })
    }

    /// Variance of `sum J r`, with the residuals' correlation over distances up to [`CORRELATED`]. Residuals are taken as equally large
    /// everywhere: at the edges, where the gradients are, the fit takes up a part of them.
    fn variance(&self, residuals: &[f64], variance: f64) -> Matrix2<f64> {
        let Region { width, height, .. } = self.region;
        let squares = residuals.iter().map(|r| r * r).sum::<f64>() / residuals.len().max(1) as f64;
        let white = self.products * variance;
        let mut sum = white;
        for dy in 0..=CORRELATED {
            for dx in -CORRELATED..=CORRELATED {
                if dy == 0 && dx <= 0 {
                    continue;
                }
                let (mut correlation, mut products, mut count) = (0.0, Matrix2::zeros(), 0.0);
                let columns = (-dx).max(0) as usize..width.saturating_sub(dx.max(0) as usize);
                for row in 0..height.saturating_sub(dy as usize) {
                    for column in columns.clone() {
                        let pixel_index = row * width + column;
                        let neighbour_index =
                            ((row as i64 + dy) * width as i64 + column as i64 + dx) as usize;
                        let (Some(a), Some(b)) = (residuals.get(pixel_index), residuals.get(neighbour_index))
                        else {
                            continue;
                        };
                        let (Some(j), Some(k)) =
                            (self.gradients.get(pixel_index), self.gradients.get(neighbour_index))
                        else {
                            continue;
                        };
                        correlation += a * b;
                        products += j * k.transpose();
                        count += 1.0;
                    }
                }
                if count > 0.0 {
                    let noise_fraction = correlation / (count * squares.max(1e-9));
                    sum += (products + products.transpose()) * (noise_fraction * variance);
                }
            }
        }
        // A sum over some distances may be too small by chance, or no covariance at all.
        let is_possible =
            (0..2).all(|axis| sum[(axis, axis)] >= 0.25 * white[(axis, axis)]) && sum.determinant() > 0.0;
        if is_possible { sum } else { white }
    }

    /// A matrix for the directions with texture: along others nothing moves.
    fn limited(&self, matrix: Matrix2<f64>) -> Matrix2<f64> {
        match self.directions {
            Directions::Both => matrix,
            Directions::Horizontal => Matrix2::new(matrix[(0, 0)], 0.0, 0.0, 1.0),
            Directions::Vertical => Matrix2::new(1.0, 0.0, 0.0, matrix[(1, 1)]),
        }
    }

    fn only_free(&self, vector: Vector2<f64>) -> Vector2<f64> {
        let free = self.directions.free().map(|free| f64::from(u8::from(free)));
        vector.component_mul(&Vector2::from(free))
    }

    fn reported(&self, covariance: Matrix2<f64>) -> [[f64; 2]; 2] {
        let [x, y] = self.directions.free().map(|free| f64::from(u8::from(free)));
        [
            [x * covariance[(0, 0)], x * y * covariance[(0, 1)]],
            [x * y * covariance[(1, 0)], y * covariance[(1, 1)]],
        ]
    }
}

fn shifted_bound(from: usize, shift: i64, size: usize) -> usize {
    (from as i64 + shift + size as i64).max(0) as usize
}

/// Brightness and gradient at all pixels of a part that is shifted; nothing where some lie outside.
fn sampled(spline: &Spline, region: Region, shift: [f64; 2]) -> Option<Vec<Sample>> {
    let mut samples = Vec::with_capacity(region.width * region.height);
    for y in region.y..region.y + region.height {
        for x in region.x..region.x + region.width {
            samples.push(spline.at(x as f64 + shift[0], y as f64 + shift[1])?);
        }
    }
    Some(samples)
}
