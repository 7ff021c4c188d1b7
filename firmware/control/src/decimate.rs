//! A decimating filter: two running means in a row (a cascaded integrator-comb filter of second order), exact in integers.
//!
//! Every `R`-th period it returns the sum of the last `2 R - 1` values with the triangular weights 1, 2, .. `R`, .. 2, 1, which
//! add up to `R²` ([`Decimator::GAIN`]).
//!
//! | property | value | for R = 10 |
//! |---|---|---|
//! | delay, periods ([`Decimator::DELAY_PERIODS`]) | `R - 1` | 9 |
//! | gain of white noise ([`Decimator::noise_gain`]) | `sqrt((2 R² + 1) / (3 R³))` | 0.259 |
//! | zeros of the response | multiples of the input rate divided by `R` | 100 Hz, 200 Hz, .. at 1 kHz |
//!
//! The sums wrap around; the output is exact as long as it fits 32 bits: for values up to `2^31 / R²`.

/// The filter of one channel.
#[derive(Debug, Clone)]
pub struct Decimator<const R: i32> {
    sums: [i32; 2],
    before: [i32; 2],
    phase: i32,
    /// Number of outputs to omit until the window has been filled for the first time.
    filling: u8,
}

impl<const R: i32> Decimator<R> {
    /// Delay of the output, periods.
    pub const DELAY_PERIODS: i32 = R - 1;
    /// Ratio of the output to the weighted mean.
    pub const GAIN: i32 = R * R;

    /// An empty filter.
    #[expect(clippy::new_without_default, reason = "a filter is made in one place")]
    pub const fn new() -> Self {
        Self { sums: [0; 2], before: [0; 2], phase: 0, filling: 1 }
    }

    /// Standard deviation of the weighted mean of white noise of standard deviation 1.
    pub fn noise_gain() -> f32 {
        let r = R as f32;
        libm::sqrtf((2.0 * r * r + 1.0) / (3.0 * r * r * r))
    }

    /// Takes one value. Returns the weighted sum of the window every `R`-th time, once the window is full.
    pub fn push(&mut self, value: i32) -> Option<i32> {
        let [first, second] = self.sums;
        let first = first.wrapping_add(value);
        self.sums = [first, second.wrapping_add(first)];
        self.phase += 1;
        if self.phase < R {
            return None;
        }
        self.phase = 0;
        let [_, second] = self.sums;
        let [comb_one, comb_two] = self.before;
        let once = second.wrapping_sub(comb_one);
        self.before = [second, once];
        let decimated = once.wrapping_sub(comb_two);
        if self.filling > 0 {
            self.filling -= 1;
            return None;
        }
        Some(decimated)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    type Ten = Decimator<10>;

    #[test]
    fn the_delay_is_as_stated() {
        let mut filter = Ten::new();
        for period in 0..1_000 {
            // A ramp of 7 per period comes out as the ramp of DELAY_PERIODS ago.
            if let Some(sum) = filter.push(7 * period - 300) {
                assert_eq!(sum, (7 * (period - Ten::DELAY_PERIODS) - 300) * Ten::GAIN);
            }
        }
    }

    #[test]
    fn noise_is_reduced_as_stated() {
        let mut filter = Ten::new();
        let (mut squares, mut count) = (0.0_f64, 0.0_f64);
        let mut state = 1_u64;
        for _ in 0..2_000_000 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let value = (state >> 48) as i32 - 32_768;
            if let Some(sum) = filter.push(value) {
                squares += (f64::from(sum) / f64::from(Ten::GAIN)).powi(2);
                count += 1.0;
            }
        }
        // A uniform value of 2^16 steps has the standard deviation 2^16 / sqrt(12).
        let gain = (squares / count).sqrt() / (65_536.0 / 12.0_f64.sqrt());
        let stated = f64::from(Ten::noise_gain());
        assert!((stated - 0.2588).abs() < 1e-4);
        // 200,000 results that overlap by a half: their standard deviation is known to 0.2 %.
        assert!((gain / stated - 1.0).abs() < 0.01, "{gain} against {stated}");
    }

    proptest! {
        /// Compares the output with its definition, also after the sums have wrapped.
        #[test]
        fn every_result_is_the_weighted_sum(values in prop::collection::vec(-10_000_000..10_000_000, 40..200)) {
            let mut filter = Decimator::<5>::new();
            for end in 0..values.len() {
                if let Some(sum) = filter.push(values[end]) {
                    let weighted = (0..9).map(|back| {
                        let weight = 5 - (4 - back as i32).abs();
                        weight * values[end - back]
                    });
                    prop_assert_eq!(sum, weighted.sum::<i32>());
                }
            }
        }
    }
}
