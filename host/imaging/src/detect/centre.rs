//! Centre of an echo to a fraction of a pixel, by adaptive moments: the centroid under a Gaussian weight that has the
//! echo's own size and place (Bernstein and Jarvis, Astronomical Journal 123:583, 2002). Pixels far from the core, such
//! as a tail or a neighbour, have no weight.

use crate::frame::Frame;

/// Error of brightness by rounding to whole levels and by a lossy recording, as a fraction of the
/// echo's.
const ROUNDING: f64 = 0.003;
/// Range of the logarithm that scanners show, decibels; usual ones are 45 to 70.
const RANGE_DB: f64 = 50.0;
/// Iterations until the centre moves by less than [`SETTLED_PX`].
const ITERATIONS: usize = 40;
const SETTLED_PX: f64 = 1e-3;
/// A weight below this one is none: beyond three standard deviations.
const REACH: f64 = 9.0;

/// An echo's centre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Centre {
    /// Column, pixels; 0 is the middle of the first.
    pub x_px: f64,
    /// Row, pixels.
    pub y_px: f64,
    /// Standard deviation of the centre across the beam, from the scatter of brightness beside the echo and its correlation length.
    pub sd_x_px: f64,
    /// The same along the beam.
    pub sd_y_px: f64,
    /// Size of the echo across the beam as the standard deviation of its brightness, pixels.
    pub width_px: f64,
    /// The same along the beam.
    pub height_px: f64,
    /// Brightness above what is beside it, over the least brightness there is, without the scanner's logarithm.
    pub amplitude: f64,
    /// Share of its core that has the greatest brightness there is.
    pub saturated: f64,
}

/// Brightness without the scanner's logarithm. There speckle adds to an echo; in the logarithm the weak flanks of an
/// echo count as much as its core, and speckle moves them most. If the range is not the assumed one the centre is still
/// that of an even echo.
pub(super) struct Linear([f64; 256]);

impl Linear {
    pub(super) fn new() -> Self {
        Self(std::array::from_fn(|level| 10f64.powf(level as f64 * RANGE_DB / (20.0 * 255.0)) - 1.0))
    }

    fn of(&self, level: u8) -> f64 {
        self.0[usize::from(level)]
    }
}

/// Correlation lengths of brightness, pixels: as standard deviations of a Gaussian correlation.
pub(super) struct Speckle {
    length_px: [f64; 2],
}

impl Speckle {
    /// From neighbouring pixels of the whole frame that are not black, every eighth row.
    pub(super) fn of(frame: &Frame) -> Self {
        let mut squares = [0.0f64; 2];
        let (mut sum, mut sum_squares, mut count) = (0.0f64, 0.0f64, 0.0f64);
        let rows = frame.pixels.chunks_exact(frame.width.max(1));
        for (row, below) in rows.clone().zip(rows.skip(1)).step_by(8) {
            for ((pixel, right), below) in row.iter().zip(row.iter().skip(1)).zip(below) {
                if *pixel == 0 || *pixel == 255 {
                    continue;
                }
                let value = f64::from(*pixel);
                sum += value;
                sum_squares += value * value;
                count += 1.0;
                squares[0] += (value - f64::from(*right)).powi(2);
                squares[1] += (value - f64::from(*below)).powi(2);
            }
        }
        let variance = if count > 1.0 { sum_squares / count - (sum / count).powi(2) } else { 0.0 };
        Self {
            length_px: squares.map(|squares| {
                // E (a - b)^2 = 2 variance (1 - rho), rho = exp(-1 / (2 l^2)).
                let rho = if variance > 0.0 { 1.0 - squares / count / (2.0 * variance) } else { 0.0 };
                if rho <= 0.01 { 0.3 } else { (-0.5 / rho.min(0.995).ln()).sqrt() }
            }),
        }
    }
}

/// Adaptive moments from a start; nothing where they lead to no echo of about this size.
pub(super) fn refine(
    frame: &Frame,
    start: [usize; 2],
    core: [usize; 2],
    speckle: &Speckle,
    linear: &Linear,
) -> Option<Centre> {
    let [mut x, mut y] = start.map(|at| at as f64);
    let [mut sx, mut sy] = core.map(|half| (0.7 * half as f64).max(1.0));
    let (background, scatter) = around(frame, start, core, linear)?;
    let mut amplitude = 0.0;
    let mut saturated = 0.0;
    for _ in 0..ITERATIONS {
        let reach = [3.0 * sx, 3.0 * sy];
        let columns = span(x, reach[0], frame.width)?;
        let rows = span(y, reach[1], frame.height)?;
        let (mut sum, mut weights, mut clipped, mut inner) = (0.0, 0.0, 0.0, 0.0);
        let (mut first, mut second) = ([0.0; 2], [0.0; 2]);
        // Distance, its square in standard deviations, and weight of every column: the same in all rows.
        let normalized: Vec<[f64; 3]> = columns
            .clone()
            .map(|column| {
                let dx = column as f64 - x;
                [dx, (dx / sx).powi(2), (-0.5 * (dx / sx).powi(2)).exp()]
            })
            .collect();
        for row in rows {
            let dy = row as f64 - y;
            let start = row * frame.width;
            let pixels = frame.pixels.get(start + columns.start..start + columns.end)?;
            let of_row = (-0.5 * (dy / sy).powi(2)).exp();
            let y_term = (dy / sy).powi(2);
            for ([dx, squared, of_column], pixel) in normalized.iter().zip(pixels) {
                let squared = squared + y_term;
                if squared > REACH {
                    continue;
                }
                let weight = of_row * of_column;
                let bright = weight * (linear.of(*pixel) - background);
                sum += bright;
                weights += weight * weight;
                first[0] += bright * dx;
                first[1] += bright * dy;
                second[0] += bright * dx * dx;
                second[1] += bright * dy * dy;
                if squared < 1.0 {
                    inner += 1.0;
                    clipped += f64::from(u8::from(*pixel == u8::MAX));
                }
            }
        }
        if sum <= 0.0 || weights <= 0.0 {
            return None;
        }
        amplitude = sum / weights;
        saturated = clipped / f64::max(inner, 1.0);
        // Under a weight of the echo's own size the centroid is half way.
        let step = first.map(|moment| 2.0 * moment / sum);
        x += step[0].clamp(-sx, sx);
        y += step[1].clamp(-sy, sy);
        (sx, sy) = (grown_sd(second[0], sx, sum).max(0.6), grown_sd(second[1], sy, sum).max(0.6));
        let shift = [x - start[0] as f64, y - start[1] as f64];
        let is_near = (0..2).all(|axis| shift[axis].abs() <= 3.0 * core[axis] as f64 + 3.0);
        if !is_near || sx > 4.0 * core[0] as f64 + 4.0 || sy > 4.0 * core[1] as f64 + 4.0 {
            return None;
        }
        if step[0].hypot(step[1]) < SETTLED_PX {
            break;
        }
    }
    let residual = residual(frame, [x, y], [sx, sy], amplitude, background, linear)?;
    let [sd_x_px, sd_y_px] = deviations(amplitude, scatter.max(residual), [sx, sy], speckle.length_px);
    (amplitude > 0.0).then_some(Centre {
        x_px: x,
        y_px: y,
        sd_x_px,
        sd_y_px,
        width_px: sx,
        height_px: sy,
        amplitude,
        saturated,
    })
}

fn grown_sd(second: f64, sd: f64, sum: f64) -> f64 {
    (2.0 * second / sum).max(0.25 * sd * sd).sqrt().clamp(0.7 * sd, 1.4 * sd)
}

/// Root mean square distance of brightness from the echo's Gaussian under its weight: speckle in the echo itself, and what its form has
/// that a Gaussian has not.
fn residual(
    frame: &Frame,
    [x, y]: [f64; 2],
    [sx, sy]: [f64; 2],
    amplitude: f64,
    beside: f64,
    linear: &Linear,
) -> Option<f64> {
    let (mut squares, mut weights) = (0.0, 0.0);
    let columns = span(x, 3.0 * sx, frame.width)?;
    for row in span(y, 3.0 * sy, frame.height)? {
        for column in columns.clone() {
            let (dx, dy) = ((column as f64 - x) / sx, (row as f64 - y) / sy);
            let weight = (-0.5 * (dx * dx + dy * dy)).exp();
            let residual = linear.of(frame.at(column, row)) - beside - amplitude * weight;
            squares += weight * residual * residual;
            weights += weight;
        }
    }
    Some((squares / weights).sqrt())
}

/// Standard deviations of the centroid of an echo of Gaussian form in noise of Gaussian correlation.
///
/// The centroid solves `sum w dx (I - b) = 0`, so its variance is that of the sum over the square of its derivative,
/// `a pi s_x s_y / 2`. The variance is a product of one integral for each axis, of `x x' exp(-(x^2 + x'^2) / 2 s^2) rho(x - x')` and
/// of the same without `x x'`.
fn deviations(amplitude: f64, scatter: f64, size: [f64; 2], length: [f64; 2]) -> [f64; 2] {
    let integrals = [0, 1].map(|axis| {
        let (s2, l2) = (size[axis].powi(2), length[axis].powi(2));
        let determinant = 1.0 / (s2 * s2) + 2.0 / (s2 * l2);
        let plain = std::f64::consts::TAU / determinant.sqrt();
        (plain, plain / (l2 * determinant))
    });
    let slope = 0.5 * amplitude * std::f64::consts::PI * size[0] * size[1];
    let [(plain_x, moved_x), (plain_y, moved_y)] = integrals;
    let sigma = scatter.hypot(ROUNDING * amplitude);
    [(moved_x * plain_y).sqrt() * sigma / slope, (plain_x * moved_y).sqrt() * sigma / slope]
}

/// Median brightness and its scatter beside and above a core.
fn around(
    frame: &Frame,
    [x, y]: [usize; 2],
    [half_x, half_y]: [usize; 2],
    linear: &Linear,
) -> Option<(f64, f64)> {
    let mut histogram = [0usize; 256];
    let rows = y.saturating_sub(4 * half_y + 2)..=(y + half_y).min(frame.height.checked_sub(1)?);
    let (first, last_pixel) =
        (x.saturating_sub(4 * half_x + 2), (x + 4 * half_x + 2).min(frame.width.checked_sub(1)?));
    for row in rows {
        let near_row = row.abs_diff(y) <= 2 * half_y;
        for column in (first..=last_pixel).filter(|column| !(near_row && column.abs_diff(x) <= 2 * half_x)) {
            if let Some(count) = histogram.get_mut(usize::from(frame.at(column, row))) {
                *count += 1;
            }
        }
    }
    let total: usize = histogram.iter().sum();
    let [low, middle, high] = [0.16, 0.5, 0.84].map(|share| {
        histogram_quantile(share, total, &histogram).and_then(|level| linear.0.get(level).copied())
    });
    Some((middle?, 0.5 * (high? - low?)))
}

fn histogram_quantile(share: f64, total: usize, histogram: &[usize; 256]) -> Option<usize> {
    let mut remaining_count = (share * total as f64) as usize;
    histogram.iter().position(|count| {
        let is_reached = *count > remaining_count;
        remaining_count = remaining_count.saturating_sub(*count);
        is_reached
    })
}

/// Pixels within a reach of a place.
fn span(at: f64, reach: f64, size: usize) -> Option<std::ops::Range<usize>> {
    let first_pixel = (at - reach).ceil().max(0.0) as usize;
    let end_pixel = ((at + reach).floor() + 1.0).clamp(0.0, size as f64) as usize;
    (first_pixel < end_pixel).then_some(first_pixel..end_pixel)
}
