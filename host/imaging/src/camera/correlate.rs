//! Normalised correlation to the nearest pixel.

use super::super::frame::{Frame, Region};

/// Distance from the last place in which the template is looked for first, pixels.
const NEAR: i64 = 16;
/// Least side of a template in a frame of reduced size.
const REDUCED_SIDE: usize = 6;
/// Most times that a frame is reduced.
const MAX_REDUCTION: usize = 16;

/// A place where the template fits best.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Match {
    /// Pixels from the template's own place.
    pub(super) shift: [i64; 2],
    /// Correlation coefficient.
    pub(super) score: f64,
    /// Whether it is the last place that was tried in some direction, so that a better one may lie beyond.
    pub(super) is_at_edge: bool,
}

/// A part of a frame, without its mean.
struct Values {
    width: usize,
    height: usize,
    values: Vec<f32>,
    norm: f32,
}

impl Values {
    fn new(image: &Image, region: Region) -> Self {
        let mut values: Vec<f32> = (region.y..region.y + region.height)
            .filter_map(|y| image.row(y).get(region.x..region.x + region.width))
            .flatten()
            .copied()
            .collect();
        let mean = values.iter().sum::<f32>() / values.len().max(1) as f32;
        values.iter_mut().for_each(|value| *value -= mean);
        let norm = values.iter().map(|value| value * value).sum::<f32>().sqrt();
        Self { width: region.width, height: region.height, values, norm }
    }

    /// Correlation coefficient at a place; 0 where there is no contrast.
    fn at(&self, image: &Image, x: usize, y: usize) -> f64 {
        let (mut sum, mut squares, mut products) = (0.0f32, 0.0f32, 0.0f32);
        for (row, own) in self.values.chunks_exact(self.width.max(1)).enumerate() {
            let Some(pixels) = image.row(y + row).get(x..x + self.width) else { return 0.0 };
            for (pixel, own) in pixels.iter().zip(own) {
                sum += pixel;
                squares += pixel * pixel;
                products += pixel * own;
            }
        }
        let variance = squares - sum * sum / (self.width * self.height).max(1) as f32;
        let norm = self.norm * variance.max(0.0).sqrt();
        if norm > 1e-3 { f64::from(products / norm) } else { 0.0 }
    }
}

/// A frame, or one of reduced size.
struct Image {
    width: usize,
    height: usize,
    pixels: Vec<f32>,
}

impl Image {
    /// Means of squares of so many pixels.
    fn reduced(frame: &Frame, by: usize) -> Self {
        let (width, height) = (frame.width / by, frame.height / by);
        let mut pixels = vec![0.0f32; width * height];
        for (row, of_row) in pixels.chunks_exact_mut(width.max(1)).enumerate() {
            for y in row * by..(row + 1) * by {
                let row_pixels = frame.pixels.get(y * frame.width..(y + 1) * frame.width).unwrap_or_default();
                for (pixel, part) in of_row.iter_mut().zip(row_pixels.chunks_exact(by)) {
                    *pixel += part.iter().map(|value| f32::from(*value)).sum::<f32>();
                }
            }
        }
        let count = (by * by) as f32;
        pixels.iter_mut().for_each(|pixel| *pixel /= count);
        Self { width, height, pixels }
    }

    fn row(&self, y: usize) -> &[f32] {
        self.pixels.get(y * self.width..(y + 1) * self.width).unwrap_or_default()
    }
}

/// A template, at full and at reduced size.
pub(super) struct Template {
    region: Region,
    full: Values,
    by: usize,
    reduced_at: [usize; 2],
    reduced: Values,
}

impl Template {
    pub(super) fn new(frame: &Frame, region: Region) -> Self {
        let image = Image::reduced(frame, 1);
        let side = region.width.min(region.height);
        let factor = (side / REDUCED_SIDE).clamp(1, MAX_REDUCTION);
        let small = Image::reduced(frame, factor);
        // Whole squares inside the template.
        let reduced_corner = [region.x.div_ceil(factor), region.y.div_ceil(factor)];
        let size = [
            (region.x + region.width) / factor - reduced_corner[0],
            (region.y + region.height) / factor - reduced_corner[1],
        ];
        let reduced_region =
            Region { x: reduced_corner[0], y: reduced_corner[1], width: size[0], height: size[1] };
        Self {
            region,
            full: Values::new(&image, region),
            by: factor,
            reduced_at: reduced_corner,
            reduced: Values::new(&small, reduced_region),
        }
    }

    /// The best place near one; along directions that are not free, only that one.
    pub(super) fn near(&self, frame: &Frame, at: [i64; 2], free: [bool; 2]) -> Option<Match> {
        self.around(&Image::reduced(frame, 1), at, free, NEAR, None)
    }

    /// The best place in the frame.
    pub(super) fn anywhere(&self, frame: &Frame, free: [bool; 2]) -> Option<Match> {
        let small = Image::reduced(frame, self.by);
        let coarse = best(&self.reduced, &small, self.reduced_at, free, |_| true)?;
        let factor = self.by as i64;
        let shift = coarse.shift.map(|shift| shift * factor);
        self.around(&Image::reduced(frame, 1), shift, free, factor.max(2), None)
    }

    /// The best place in the template's own frame that does not overlap it by more than half.
    pub(super) fn elsewhere(&self, frame: &Frame) -> Option<Match> {
        let small = Image::reduced(frame, self.by);
        let half = [self.reduced.width as i64 / 2, self.reduced.height as i64 / 2];
        let coarse = best(&self.reduced, &small, self.reduced_at, [true; 2], |shift: [i64; 2]| {
            shift.iter().zip(half).any(|(shift, half)| shift.abs() > half.max(1))
        })?;
        let factor = self.by as i64;
        self.around(
            &Image::reduced(frame, 1),
            coarse.shift.map(|shift| shift * factor),
            [true; 2],
            factor.max(2),
            Some(NEAR / 8),
        )
    }

    /// The best place within a distance of one; at least so far from the template's own place.
    fn around(
        &self,
        image: &Image,
        at: [i64; 2],
        free: [bool; 2],
        reach: i64,
        apart: Option<i64>,
    ) -> Option<Match> {
        let mut best_match: Option<Match> = None;
        let [reach_x, reach_y] = [span(0, free, reach), span(1, free, reach)];
        for dy in -reach_y..=reach_y {
            for dx in -reach_x..=reach_x {
                let shift = [at[0] + dx, at[1] + dy];
                if apart.is_some_and(|apart| shift.iter().all(|shift| shift.abs() <= apart)) {
                    continue;
                }
                let x = usize::try_from(self.region.x as i64 + shift[0]);
                let y = usize::try_from(self.region.y as i64 + shift[1]);
                let (Ok(x), Ok(y)) = (x, y) else { continue };
                if x + self.full.width > image.width || y + self.full.height > image.height {
                    continue;
                }
                let score = self.full.at(image, x, y);
                if best_match.is_none_or(|best_match| score > best_match.score) {
                    let is_at_edge =
                        (reach_x > 0 && dx.abs() == reach_x) || (reach_y > 0 && dy.abs() == reach_y);
                    best_match = Some(Match { shift, score, is_at_edge });
                }
            }
        }
        best_match
    }
}

fn span(axis: usize, free: [bool; 2], reach: i64) -> i64 {
    if free.get(axis).copied().unwrap_or(true) { reach } else { 0 }
}

/// The best of all places of a frame.
fn best(
    values: &Values,
    image: &Image,
    own: [usize; 2],
    free: [bool; 2],
    is_allowed: impl Fn([i64; 2]) -> bool,
) -> Option<Match> {
    let range = |axis: usize, size: usize, own: usize, all: usize| {
        let last = all.checked_sub(size)?;
        Some(if free.get(axis).copied().unwrap_or(true) { 0..=last } else { own.min(last)..=own.min(last) })
    };
    let columns = range(0, values.width, own[0], image.width)?;
    let rows = range(1, values.height, own[1], image.height)?;
    let mut best_match: Option<Match> = None;
    for y in rows {
        for x in columns.clone() {
            let shift = [x as i64 - own[0] as i64, y as i64 - own[1] as i64];
            if !is_allowed(shift) {
                continue;
            }
            let score = values.at(image, x, y);
            if best_match.is_none_or(|best_match| score > best_match.score) {
                best_match = Some(Match { shift, score, is_at_edge: false });
            }
        }
    }
    best_match
}
