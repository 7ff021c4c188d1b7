//! Whether a template has texture: what a translation would be known to in its worst direction.

use super::super::frame::{Frame, Region};
use super::{CameraError, MAX_SD_PX};
use nalgebra::{Matrix2, SymmetricEigen, Vector2};

/// Directions of the image in which motion of a template is identifiable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Directions {
    /// Both.
    Both,
    /// Along the rows only: the template has no texture along the columns.
    Horizontal,
    /// Along the columns only.
    Vertical,
}

impl Directions {
    /// Directions that are in both; none where none is.
    pub(super) fn both(self, other: Self) -> Option<Self> {
        match (self, other) {
            (Self::Both, one) | (one, Self::Both) => Some(one),
            (a, b) => (a == b).then_some(a),
        }
    }

    /// Along rows and along columns.
    pub fn free(self) -> [bool; 2] {
        [self != Self::Vertical, self != Self::Horizontal]
    }
}

/// Sum of squares of the gradient of white noise of variance 1 in one pixel, for gradients of cubic splines:
/// `(9 / 2 pi) integral sin^2 w / (2 + cos w)^2 = 9 (2 / sqrt 3 - 1)`.
pub(super) const GRADIENT_OF_NOISE: f64 = 1.392_304_845_413_264;
/// Sine of the largest angle between a direction without texture and an axis of the image at which motion along the other axis is
/// reported: of motion along the edge itself so much enters it.
const MAX_SLANT: f64 = 0.05;
/// Side of a block in which the noise is estimated.
const BLOCK: usize = 8;
/// Part of the blocks that have less noise than what is taken: flat ones, in which there is noise alone.
const QUIET: f64 = 0.1;
/// Standard deviation of rounding to whole levels.
pub(super) const ROUNDING: f64 = 0.288_675_134_594_812_9;

/// Directions in which a template's motion is identifiable: `gradients` is the sum of products of its gradients over `pixels` pixels,
/// `noise` the standard deviation of its brightness.
///
/// # Errors
/// [`CameraError::NoTexture`] where there is none, or only one that is not along an axis.
pub(super) fn directions(
    gradients: &Matrix2<f64>,
    pixels: usize,
    noise: f64,
    option: &'static str,
) -> Result<Directions, CameraError> {
    let of_noise = GRADIENT_OF_NOISE * pixels as f64 * noise * noise;
    let eigen = SymmetricEigen::new(*gradients);
    let weak = usize::from(eigen.eigenvalues[1] < eigen.eigenvalues[0]);
    let (weak_sd_px, strong_sd_px) = (
        texture_sd_px(eigen.eigenvalues[weak], of_noise, pixels, noise),
        texture_sd_px(eigen.eigenvalues[1 - weak], of_noise, pixels, noise),
    );
    if weak_sd_px <= MAX_SD_PX {
        return Ok(Directions::Both);
    }
    let weak_direction: Vector2<f64> = eigen.eigenvectors.column(weak).into_owned();
    if strong_sd_px > MAX_SD_PX {
        return no_texture("any direction".to_owned(), strong_sd_px, option);
    }
    if weak_direction.y.abs() <= MAX_SLANT {
        Ok(Directions::Vertical)
    } else if weak_direction.x.abs() <= MAX_SLANT {
        Ok(Directions::Horizontal)
    } else {
        let [x, y] = if weak_direction.x < 0.0 {
            [-weak_direction.x, -weak_direction.y]
        } else {
            [weak_direction.x, weak_direction.y]
        };
        no_texture(format!("the direction {x:.2},{y:.2} of the image"), weak_sd_px, option)
    }
}

fn no_texture(direction: String, sd_px: f64, option: &'static str) -> Result<Directions, CameraError> {
    Err(CameraError::NoTexture { option, direction, sd_px })
}

/// Noise has gradients too; what is left of a strength that is mostly noise is uncertain by its own scatter.
fn texture_sd_px(strength: f64, of_noise: f64, pixels: usize, noise: f64) -> f64 {
    let scatter = 3.0 * of_noise * (2.0 / pixels.max(1) as f64).sqrt();
    let signal = strength - of_noise - scatter;
    if signal > 0.0 { (2.0 * noise * noise / signal).sqrt() } else { f64::INFINITY }
}

/// Standard deviation of the noise of a frame: of what is no plane in the quietest of its blocks that are not clipped.
pub(super) fn noise(frame: &Frame, around: Region) -> f64 {
    let mut blocks: Vec<f64> = Vec::new();
    let grid = |from: usize, to: usize| (from + 1..to.saturating_sub(BLOCK)).step_by(BLOCK);
    let reach = 4 * BLOCK;
    let (left_edge, top) = (around.x.saturating_sub(reach), around.y.saturating_sub(reach));
    let right = (around.x + around.width + reach).min(frame.width);
    let bottom = (around.y + around.height + reach).min(frame.height);
    for y in grid(top, bottom) {
        for x in grid(left_edge, right) {
            let mut sum = 0.0;
            let mut is_clipped = false;
            for (column, row) in (0..BLOCK * BLOCK).map(|i| (x + i % BLOCK, y + i / BLOCK)) {
                is_clipped |= matches!(frame.at(column, row), 0 | u8::MAX);
                let corners = brightness_at(column - 1, row - 1, frame)
                    + brightness_at(column + 1, row - 1, frame)
                    + brightness_at(column - 1, row + 1, frame)
                    + brightness_at(column + 1, row + 1, frame);
                let sides = brightness_at(column - 1, row, frame)
                    + brightness_at(column + 1, row, frame)
                    + brightness_at(column, row - 1, frame)
                    + brightness_at(column, row + 1, frame);
                // Immerkaer, Computer Vision and Image Understanding 64:300, 1996.
                sum += (corners - 2.0 * sides + 4.0 * brightness_at(column, row, frame)).powi(2);
            }
            if !is_clipped {
                blocks.push((sum / (36 * BLOCK * BLOCK) as f64).sqrt());
            }
        }
    }
    blocks.sort_by(f64::total_cmp);
    blocks.get((QUIET * blocks.len() as f64) as usize).copied().unwrap_or(0.0).max(ROUNDING)
}

fn brightness_at(x: usize, y: usize, frame: &Frame) -> f64 {
    f64::from(frame.at(x, y))
}
