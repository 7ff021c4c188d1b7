//! Sums over rectangles in constant time.

use crate::frame::Frame;

/// Sums of brightness and of its square over everything above and left of a pixel.
pub(super) struct Integral {
    pub(super) width: usize,
    pub(super) height: usize,
    sums: Vec<[u64; 2]>,
}

impl Integral {
    pub(super) fn new(frame: &Frame) -> Self {
        let (width, height) = (frame.width, frame.height);
        let stride = width + 1;
        let mut sums = vec![[0; 2]; stride * (height + 1)];
        for (row, pixels) in frame.pixels.chunks_exact(width.max(1)).enumerate() {
            let (above, below) = sums.split_at_mut((row + 1) * stride);
            let above = above.get(row * stride + 1..).unwrap_or_default();
            let mut of_row = [0u64; 2];
            for ((sum, above), pixel) in below.iter_mut().skip(1).zip(above).zip(pixels) {
                let value = u64::from(*pixel);
                of_row[0] += value;
                of_row[1] += value * value;
                *sum = [above[0] + of_row[0], above[1] + of_row[1]];
            }
        }
        Self { width, height, sums }
    }

    /// Mean and variance of a rectangle inside the frame; zero for an empty one or one that is not inside.
    pub(super) fn mean(&self, x: usize, y: usize, width: usize, height: usize) -> (f64, f64) {
        let stride = self.width + 1;
        let at = |x: usize, y: usize| self.sums.get(y * stride + x).copied();
        let corners = (at(x, y), at(x + width, y), at(x, y + height), at(x + width, y + height));
        let (Some(a), Some(b), Some(c), Some(d)) = corners else { return (0.0, 0.0) };
        let count = (width * height) as f64;
        if count == 0.0 || x + width > self.width {
            return (0.0, 0.0);
        }
        let [sum, squares] = [0, 1].map(|i| (d[i] + a[i]).wrapping_sub(b[i] + c[i]) as f64 / count);
        (sum, (squares - sum * sum).max(0.0))
    }
}
