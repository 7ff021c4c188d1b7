//! Candidates for the needle's cross-section in one frame: places that are brighter than what is beside and above them, at the sizes
//! that the echo of a needle can have, each with its centre to a fraction of a pixel and the covariance of that centre.
//!
//! The sequence decides which of them is the needle ([`crate::track`]). Pixels below are not used as background: a
//! comet tail or a second echo is there.

mod centre;
mod integral;

pub use centre::Centre;

use crate::frame::{Frame, Region};
use centre::{Linear, Speckle};
use integral::Integral;
use std::sync::Arc;

/// Most candidates of a frame.
pub const MAX_CANDIDATES: usize = 12;
/// Sizes of an echo's core, in outer diameters of the needle: across and along the beam of the probe.
const SCALES: [[f64; 2]; 3] = [[0.5, 0.25], [1.0, 0.4], [2.0, 0.7]];
/// Least contrast, grey levels.
const MIN_CONTRAST: f64 = 8.0;
/// Added to the scatter beside an echo, grey levels: what a recording without speckle still has.
const FLOOR: f64 = 5.0;
/// An echo of a frame that counts is at most so many times weaker than the strongest.
const MAX_RATIO: f64 = 8.0;

/// A place that may be the needle's cross-section.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// Its centre.
    pub centre: Centre,
    /// Contrast over the scatter beside it.
    pub score: f64,
}

/// Finds candidates in frames of one geometry.
#[derive(Clone)]
pub struct Detector {
    /// Half sizes of the cores, pixels.
    cores: Vec<[usize; 2]>,
    region: Option<Region>,
    linear: Arc<Linear>,
}

impl Detector {
    /// For a needle of this outer diameter in frames with pixels of this size; only in a region, where one is given.
    pub fn new(needle_mm: f64, spacing_mm: [f64; 2], region: Option<Region>) -> Self {
        let mut cores: Vec<[usize; 2]> = SCALES
            .iter()
            .map(|[x, y]| {
                [half_width(*x, spacing_mm[0], needle_mm), half_width(*y, spacing_mm[1], needle_mm)]
            })
            .collect();
        cores.dedup();
        Self { cores, region, linear: Arc::new(Linear::new()) }
    }

    /// Candidates of a frame, best first.
    pub fn candidates(&self, frame: &Frame) -> Vec<Candidate> {
        let integral = Integral::new(frame);
        let mut peaks: Vec<(f64, [usize; 2], [usize; 2])> = Vec::new();
        for core in &self.cores {
            self.peaks(&integral, *core, &mut peaks);
        }
        peaks.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut peaks_kept: Vec<(f64, [usize; 2], [usize; 2])> = Vec::new();
        for peak in peaks {
            // The best of overlapping positions counts, of whatever size.
            let overlaps = peaks_kept.iter().any(|(_, at, core)| {
                (0..2).all(|axis| at[axis].abs_diff(peak.1[axis]) <= core[axis] + peak.2[axis])
            });
            if !overlaps {
                peaks_kept.push(peak);
            }
            if peaks_kept.len() == MAX_CANDIDATES {
                break;
            }
        }
        let Some(best) = peaks_kept.first().map(|(score, ..)| *score) else { return Vec::new() };
        let speckle = Speckle::of(frame);
        let mut candidates: Vec<Candidate> = Vec::new();
        for (score, at, core) in peaks_kept.into_iter().filter(|(score, ..)| *score * MAX_RATIO >= best) {
            let Some(centre) = centre::refine(frame, at, core, &speckle, &self.linear) else { continue };
            // Two starts may lead to one echo.
            let is_duplicate = candidates.iter().any(|other| {
                let distance_px = [centre.x_px - other.centre.x_px, centre.y_px - other.centre.y_px];
                (distance_px[0] / centre.width_px).hypot(distance_px[1] / centre.height_px) < 1.0
            });
            if !is_duplicate {
                candidates.push(Candidate { centre, score });
            }
        }
        candidates
    }

    /// Local maxima of the contrast at one size of core.
    fn peaks(&self, integral: &Integral, core: [usize; 2], peaks: &mut Vec<(f64, [usize; 2], [usize; 2])>) {
        let [half_x, half_y] = core;
        let stride = [half_x.div_ceil(2), half_y.div_ceil(2)];
        let margin = [3 * half_x + 2, 3 * half_y + 2];
        let region =
            self.region.unwrap_or(Region { x: 0, y: 0, width: integral.width, height: integral.height });
        let (from_x, to_x) = inner_range(region.x, region.width, margin[0], integral.width);
        let (from_y, to_y) = inner_range(region.y, region.height, margin[1], integral.height);
        if from_x >= to_x || from_y >= to_y {
            return;
        }
        let columns = (to_x - from_x).div_ceil(stride[0]);
        let rows = (to_y - from_y).div_ceil(stride[1]);
        let mut scores = vec![0.0f32; columns * rows];
        for (row, scores) in scores.chunks_exact_mut(columns).enumerate() {
            let y = from_y + row * stride[1];
            for (column, score) in scores.iter_mut().enumerate() {
                *score = contrast(integral, from_x + column * stride[0], y, core) as f32;
            }
        }
        for row in 0..rows {
            for column in 0..columns {
                let peak_value = score_at(column, row, &scores, columns);
                if peak_value <= 1.0 {
                    continue;
                }
                let is_peak = (row.saturating_sub(1)..=(row + 1).min(rows - 1)).all(|r| {
                    (column.saturating_sub(1)..=(column + 1).min(columns - 1))
                        .all(|c| score_at(c, r, &scores, columns) <= peak_value)
                });
                if is_peak {
                    let position = [from_x + column * stride[0], from_y + row * stride[1]];
                    peaks.push((f64::from(peak_value), position, core));
                }
            }
        }
    }
}

fn score_at(column: usize, row: usize, scores: &[f32], columns: usize) -> f32 {
    scores.get(row * columns + column).copied().unwrap_or(0.0)
}

fn inner_range(from: usize, size: usize, margin: usize, most: usize) -> (usize, usize) {
    let end = from.saturating_add(size).min(most.saturating_sub(margin));
    (from.max(margin), end)
}

fn half_width(scale: f64, spacing_mm: f64, needle_mm: f64) -> usize {
    ((0.5 * scale * needle_mm / spacing_mm).round() as usize).clamp(1, 60)
}

/// Brightness of a core above the brightest of what is left, right and above, over the scatter there.
fn contrast(integral: &Integral, x: usize, y: usize, [half_x, half_y]: [usize; 2]) -> f64 {
    let core_mean = integral.mean(x - half_x, y - half_y, 2 * half_x + 1, 2 * half_y + 1);
    let sides = [
        (x - 3 * half_x - 1, y - half_y, 2 * half_x, 2 * half_y + 1),
        (x + half_x + 2, y - half_y, 2 * half_x, 2 * half_y + 1),
        (x - half_x, y - 3 * half_y - 1, 2 * half_x + 1, 2 * half_y),
    ];
    let mut brightest = 0.0f64;
    for (x, y, width, height) in sides {
        brightest = brightest.max(integral.mean(x, y, width, height));
        // The first side already excludes most places.
        if core_mean - brightest < MIN_CONTRAST {
            return 0.0;
        }
    }
    let variances = sides.iter().map(|(x, y, width, height)| integral.variance(*x, *y, *width, *height));
    (core_mean - brightest) / ((variances.sum::<f64>() / 3.0).sqrt() + FLOOR)
}

#[cfg(test)]
mod tests;
