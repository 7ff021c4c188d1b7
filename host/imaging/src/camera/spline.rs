//! A part of a frame as cubic B-splines: brightness and its gradient between pixels (Unser, IEEE Signal Processing Magazine 16(6):22, 1999).

use super::super::frame::Frame;

/// Pole of the filter from samples to coefficients, `sqrt(3) - 2`.
const POLE: f64 = -0.267_949_192_431_122_7;
/// Pixels around a part that its coefficients are computed from: the pole to this power is below a thousandth of a grey level.
const MARGIN: usize = 10;

/// Coefficients of a part of a frame.
pub(super) struct Spline {
    from: [usize; 2],
    width: usize,
    height: usize,
    coefficients: Vec<f64>,
}

/// Brightness and gradient at a place.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Sample {
    pub(super) value: f64,
    pub(super) gradient: [f64; 2],
}

impl Spline {
    /// Spline of columns and rows `from..to`, and the margin that the frame has around them.
    pub(super) fn new(frame: &Frame, from: [usize; 2], to: [usize; 2]) -> Self {
        let margin_start = from.map(|from| from.saturating_sub(MARGIN));
        let margin_end = [(to[0] + MARGIN).min(frame.width), (to[1] + MARGIN).min(frame.height)];
        let (width, height) =
            (margin_end[0].saturating_sub(margin_start[0]), margin_end[1].saturating_sub(margin_start[1]));
        let mut coefficients = Vec::with_capacity(width * height);
        for y in margin_start[1]..margin_end[1] {
            let row = frame
                .pixels
                .get(y * frame.width + margin_start[0]..y * frame.width + margin_end[0])
                .unwrap_or_default();
            let mut row: Vec<f64> = row.iter().map(|pixel| f64::from(*pixel)).collect();
            smooth(&mut row);
            filter(&mut row);
            coefficients.extend(row);
        }
        for x in 0..width {
            let mut column: Vec<f64> = coefficients.iter().skip(x).step_by(width.max(1)).copied().collect();
            smooth(&mut column);
            filter(&mut column);
            coefficients
                .iter_mut()
                .skip(x)
                .step_by(width.max(1))
                .zip(column)
                .for_each(|(margin_end, margin_start)| *margin_end = margin_start);
        }
        Self { from: margin_start, width, height, coefficients }
    }

    /// Brightness and gradient at a place of the frame; nothing outside of what there are coefficients for. A place on the last pixel
    /// of the frame is between it and its mirror image.
    pub(super) fn at(&self, x: f64, y: f64) -> Option<Sample> {
        let (x, y) = (x - self.from[0] as f64, y - self.from[1] as f64);
        let is_inside = x >= 0.0 && y >= 0.0 && x <= self.width as f64 - 1.0 && y <= self.height as f64 - 1.0;
        if !is_inside {
            return None;
        }
        let (column, row) = (x.floor(), y.floor());
        let (row_weights, slope_x) = weights(x - column);
        let (column_weights, slope_y) = weights(y - row);
        let mut sample = Sample::default();
        for ((weight_y, slope_y), dy) in column_weights.iter().zip(slope_y).zip(-1i64..) {
            let start = mirrored(row as i64 + dy, self.height) * self.width;
            let (mut value, mut slope) = (0.0, 0.0);
            for ((weight_x, slope_x), dx) in row_weights.iter().zip(slope_x).zip(-1i64..) {
                let coefficient = *self.coefficients.get(start + mirrored(column as i64 + dx, self.width))?;
                value += weight_x * coefficient;
                slope += slope_x * coefficient;
            }
            sample.value += weight_y * value;
            sample.gradient[0] += weight_y * slope;
            sample.gradient[1] += slope_y * value;
        }
        Some(sample)
    }
}

/// A number reflected at the first and last of so many.
fn mirrored(at: i64, count: usize) -> usize {
    let last = count as i64 - 1;
    let reflected = if at < 0 { -at } else { at };
    (if reflected > last { 2 * last - reflected } else { reflected }).max(0) as usize
}

/// Weights of the four coefficients around a place, and their derivatives.
fn weights(t: f64) -> ([f64; 4], [f64; 4]) {
    let s = 1.0 - t;
    let values = [
        s * s * s / 6.0,
        2.0 / 3.0 - t * t * (2.0 - t) / 2.0,
        2.0 / 3.0 - s * s * (2.0 - s) / 2.0,
        t * t * t / 6.0,
    ];
    let slopes = [-0.5 * s * s, 1.5 * t * t - 2.0 * t, -1.5 * s * s + 2.0 * s, 0.5 * t * t];
    (values, slopes)
}

/// Means of a sample and its neighbours with weights 1, 2, 1, reflected at both ends: without it the finest texture, of which a spline
/// between pixels is wrong, would move the result by up to a hundredth of a pixel.
fn smooth(values: &mut [f64]) {
    let Some(mut previous) = values.get(1).or(values.first()).copied() else { return };
    for at in 0..values.len() {
        let next = values.get(at + 1).copied().unwrap_or(previous);
        if let Some(value) = values.get_mut(at) {
            let current = *value;
            *value = 0.25 * previous + 0.5 * current + 0.25 * next;
            previous = current;
        }
    }
}

/// Samples to coefficients, with the samples reflected at both ends.
fn filter(values: &mut [f64]) {
    let count = values.len();
    if count < 2 {
        return;
    }
    let gain = (1.0 - POLE) * (1.0 - 1.0 / POLE);
    values.iter_mut().for_each(|value| *value *= gain);
    let mut power = 1.0;
    let mut start = 0.0;
    for at in 0..(3 * MARGIN) as i64 {
        start += power
            * values.get(at as usize % (2 * count - 2)).copied().unwrap_or_else(|| {
                let folded = 2 * (count - 1) - at as usize % (2 * count - 2);
                values.get(folded).copied().unwrap_or(0.0)
            });
        power *= POLE;
    }
    let mut last = start;
    for (at, value) in values.iter_mut().enumerate() {
        if at > 0 {
            last = *value + POLE * last;
        }
        *value = last;
    }
    let (Some(end), Some(previous)) = (values.last().copied(), values.get(count - 2).copied()) else {
        return;
    };
    let mut last = POLE / (POLE * POLE - 1.0) * (end + POLE * previous);
    for (at, value) in values.iter_mut().rev().enumerate() {
        if at > 0 {
            last = POLE * (last - *value);
        }
        *value = last;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave(x: f64, y: f64) -> f64 {
        100.0 + 50.0 * (0.7 * x).sin() * (0.4 * y + 0.3).cos()
    }

    /// Fraction of the wave's amplitude after a mean of neighbours with weights 1, 2, 1.
    fn smoothed() -> f64 {
        0.25 * (1.0 + 0.7f64.cos()) * (1.0 + 0.4f64.cos())
    }

    /// The samples are rounded to whole levels, which is what is left of the difference.
    #[test]
    fn a_smooth_image_and_its_gradient_are_known_between_its_pixels() {
        let (width, height) = (40, 30);
        let pixels = (0..width * height).map(|i| wave((i % width) as f64, (i / width) as f64).round() as u8);
        let frame = Frame { width, height, pixels: pixels.collect() };
        let spline = Spline::new(&frame, [5, 4], [36, 27]);
        for (x, y) in [(20.0, 15.0), (20.5, 15.5), (10.31, 21.77), (6.9, 5.2)] {
            let sample = spline.at(x, y).expect("inside");
            let value = 100.0 + smoothed() * (wave(x, y) - 100.0);
            assert!((sample.value - value).abs() < 0.5, "{x} {y}: {sample:?}, {value}");
            let slope = smoothed() * 50.0 * 0.7 * (0.7 * x).cos() * (0.4 * y + 0.3).cos();
            assert!((sample.gradient[0] - slope).abs() < 0.5, "{x} {y}: {sample:?}, {slope}");
        }
        assert!(spline.at(-0.1, 3.0).is_none() && spline.at(39.1, 3.0).is_none());
    }
}
