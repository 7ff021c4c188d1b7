//! Sums over rectangles in constant time.

use crate::frame::Frame;

/// Sums of brightness and of its square over everything above and left of a pixel, modulo 2^32: what a rectangle of up to 66 000 pixels
/// has is below that, so that differences are exact, and half of the memory is read.
pub(super) struct Integral {
    pub(super) width: usize,
    pub(super) height: usize,
    sums: Vec<[u32; 2]>,
}

impl Integral {
    pub(super) fn new(frame: &Frame) -> Self {
        let (width, height) = (frame.width, frame.height);
        let stride = width + 1;
        let mut sums = vec![[0u32; 2]; stride * (height + 1)];
        for (row, pixels) in frame.pixels.chunks_exact(width.max(1)).enumerate() {
            let (upper_rows, lower_rows) = sums.split_at_mut((row + 1) * stride);
            let upper_row = upper_rows.get(row * stride + 1..).unwrap_or_default();
            let mut of_row = [0u32; 2];
            for ((sum, upper_row), pixel) in lower_rows.iter_mut().skip(1).zip(upper_row).zip(pixels) {
                let value = u32::from(*pixel);
                of_row[0] = of_row[0].wrapping_add(value);
                of_row[1] = of_row[1].wrapping_add(value * value);
                *sum = [upper_row[0].wrapping_add(of_row[0]), upper_row[1].wrapping_add(of_row[1])];
            }
        }
        Self { width, height, sums }
    }

    /// Mean of brightness in a rectangle inside the frame; zero for an empty one or one that is not inside.
    #[inline]
    pub(super) fn mean(&self, x: usize, y: usize, width: usize, height: usize) -> f64 {
        self.means(x, y, width, height).map_or(0.0, |[mean, _]| mean)
    }

    /// Its variance there.
    pub(super) fn variance(&self, x: usize, y: usize, width: usize, height: usize) -> f64 {
        self.means(x, y, width, height).map_or(0.0, |[mean, squares]| (squares - mean * mean).max(0.0))
    }

    /// Means of brightness and of its square.
    #[inline]
    fn means(&self, x: usize, y: usize, width: usize, height: usize) -> Option<[f64; 2]> {
        let stride = self.width + 1;
        let count = width * height;
        if count == 0 || x + width > self.width {
            return None;
        }
        let (a, b) = (self.sums_at(x, y, stride)?, self.sums_at(x + width, y, stride)?);
        let (c, d) = (self.sums_at(x, y + height, stride)?, self.sums_at(x + width, y + height, stride)?);
        Some([0, 1].map(|i: usize| f64::from(corner_sum(i, d, a, b, c)) / count as f64))
    }

    fn sums_at(&self, x: usize, y: usize, stride: usize) -> Option<[u32; 2]> {
        self.sums.get(y * stride + x).copied()
    }
}

fn corner_sum(i: usize, d: [u32; 2], a: [u32; 2], b: [u32; 2], c: [u32; 2]) -> u32 {
    d[i].wrapping_add(a[i]).wrapping_sub(b[i]).wrapping_sub(c[i])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_that_have_passed_the_largest_number_still_give_the_mean_of_a_rectangle() {
        // 300 x 300 pixels of 250: the squares sum up to 5.6e9.
        let mut frame = Frame { width: 300, height: 300, pixels: vec![250; 300 * 300] };
        frame.pixels[299 * 300 + 299] = 50;
        let integral = Integral::new(&frame);
        assert_eq!((integral.mean(290, 290, 9, 9), integral.variance(290, 290, 9, 9)), (250.0, 0.0));
        assert_eq!(integral.mean(298, 298, 2, 2), 200.0);
        assert!((integral.variance(298, 298, 2, 2) - 7500.0).abs() < 1e-9);
        assert_eq!(integral.mean(299, 0, 2, 1), 0.0, "not inside");
    }
}
