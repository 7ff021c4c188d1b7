//! The tare: a new zero of the force channels, and its quality.
//!
//! The sums are exact integers of the deviations from the first reading; the result is computed once, at the end.

use super::round;
use crate::calibration::counts_of_mn;
use protocol::{TARE_CHANGE_PERCENT, TARE_ZERO_PERCENT, Tare, TareProblem, UNIQUE_CODES};

/// Problem of a tare on a cell of this rated range. A zero under load would hide that load from the measured force; a force that
/// still settles gives a zero that is not repeatable.
pub fn problem(tare: &Tare, range_mn: u32, periods_per_s: f64) -> Option<TareProblem> {
    let range = f64::from(counts_of_mn(range_mn));
    let exceeds = |counts: f64, percent: u32| counts.abs() > range * f64::from(percent) * 1e-2;
    let lasted_s = f64::from(tare.periods) / periods_per_s;
    if tare.zero_counts.iter().any(|zero| exceeds(f64::from(*zero), TARE_ZERO_PERCENT)) {
        Some(TareProblem::FarFromZero)
    } else if tare
        .drift_counts_per_s
        .iter()
        .any(|drift| exceeds(f64::from(*drift) * lasted_s, TARE_CHANGE_PERCENT))
    {
        Some(TareProblem::Settling)
    } else {
        None
    }
}

/// One channel's sums.
#[derive(Debug, Default, Clone)]
struct Channel {
    first: i64,
    sum: i64,
    sum_squares: i64,
    /// Sum of the products of period number and deviation.
    sum_moments: i64,
    codes: heapless::Vec<i32, { UNIQUE_CODES as usize }>,
}

/// The readings of a tare under way.
#[derive(Debug, Default, Clone)]
pub struct Taring {
    periods: u32,
    readings: u32,
    /// Sum and sum of squares of the numbers of the periods with a reading.
    sum_times: i64,
    sum_squared_times: i64,
    channels: [Channel; 2],
}

/// Mean, standard deviation about the drift, and drift per period, in counts.
struct LineFit {
    mean: f64,
    sd: f64,
    drift: f64,
}

impl Taring {
    /// Counts a period without a valid reading.
    pub fn miss(&mut self) {
        self.periods = self.periods.saturating_add(1);
    }

    /// Adds the reading of a period: force relative to the present zero, and the converter's codes.
    pub fn add(&mut self, relative_counts: [i32; 2], codes: [i32; 2]) {
        let time = i64::from(self.periods);
        for ((channel, counts), code) in self.channels.iter_mut().zip(relative_counts).zip(codes) {
            let counts = i64::from(counts);
            if self.readings == 0 {
                channel.first = counts;
            }
            let deviation = counts - channel.first;
            channel.sum += deviation;
            channel.sum_squares = channel.sum_squares.saturating_add(deviation.saturating_mul(deviation));
            channel.sum_moments = channel.sum_moments.saturating_add(time.saturating_mul(deviation));
            if !channel.codes.contains(&code) {
                // Codes beyond a full list are not needed.
                let _ = channel.codes.push(code);
            }
        }
        self.sum_times += time;
        self.sum_squared_times += time * time;
        self.periods = self.periods.saturating_add(1);
        self.readings = self.readings.saturating_add(1);
    }

    /// The result, given the present zeros, which stay if there was no reading.
    pub fn finish(&self, zero_counts: [i32; 2], periods_per_s: f64) -> Tare {
        let mut tare = Tare {
            zero_counts,
            sd_counts: [0; 2],
            drift_counts_per_s: [0; 2],
            periods: self.periods,
            readings: self.readings,
            unique_codes: [0; 2],
        };
        if self.readings == 0 {
            return tare;
        }
        let [x, y] = &self.channels;
        let (x, y) = ((self.line_fit(x), x), (self.line_fit(y), y));
        let zero = |before: i32, (fit, channel): &(LineFit, &Channel)| {
            before.saturating_add(channel.first as i32).saturating_add(round(fit.mean as f32))
        };
        let [zero_x, zero_y] = zero_counts;
        tare.zero_counts = [zero(zero_x, &x), zero(zero_y, &y)];
        tare.sd_counts = [&x, &y].map(|(fit, _)| round(fit.sd as f32) as u32);
        tare.drift_counts_per_s = [&x, &y].map(|(fit, _)| round((fit.drift * periods_per_s) as f32));
        tare.unique_codes = [&x, &y].map(|(_, channel)| channel.codes.len() as u8);
        tare
    }

    fn line_fit(&self, channel: &Channel) -> LineFit {
        let readings = f64::from(self.readings);
        let [sum, squares, moments, times, squared_times] =
            [channel.sum, channel.sum_squares, channel.sum_moments, self.sum_times, self.sum_squared_times]
                .map(|sum| sum as f64);
        let mean = sum / readings;
        let spread = squared_times - times * times / readings;
        let moment = moments - times * mean;
        let drift = if spread > 0.0 { moment / spread } else { 0.0 };
        let residual = (squares - sum * mean - drift * moment).max(0.0);
        let sd = if self.readings > 2 { libm::sqrt(residual / (readings - 2.0)) } else { 0.0 };
        LineFit { mean, sd, drift }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::TARE_LIMIT_MS;

    #[test]
    fn mean_scatter_and_drift_of_a_far_off_zero_are_found() {
        let mut taring = Taring::default();
        for index in 0..1_000 {
            if index % 10 == 9 {
                taring.miss();
                continue;
            }
            let swing = if index % 2 == 0 { 100 } else { -100 };
            // Two counts per ten periods: 200 per second.
            taring.add([90_000 + swing + index / 5, -7], [index, 5]);
        }
        let tare = taring.finish([11, 20], 1_000.0);
        // Every fifth of the odd periods is missing, which shifts the mean of the swing by 100 / 9.
        assert!((tare.zero_counts[0] - 90_011 - 99 - 11).abs() <= 1, "{tare:?}");
        assert_eq!((tare.zero_counts[1], tare.sd_counts[1], tare.drift_counts_per_s[1]), (13, 0, 0));
        assert!((tare.drift_counts_per_s[0] - 200).abs() <= 1, "{tare:?}");
        assert!(tare.sd_counts[0].abs_diff(99) <= 1, "{tare:?}");
        assert_eq!((tare.periods, tare.readings, tare.unique_codes), (1_000, 900, [UNIQUE_CODES, 1]));
    }

    #[test]
    fn a_tare_under_load_or_while_the_force_settles_has_a_problem() {
        let tare = |zero, drift| Tare {
            zero_counts: [7, zero],
            sd_counts: [100; 2],
            drift_counts_per_s: [drift, -3],
            periods: 500,
            readings: 500,
            unique_codes: [UNIQUE_CODES; 2],
        };
        // 1 N of 5 N; 50 mN in the half second.
        assert_eq!(problem(&tare(20_000, 2_000), 5_000, 1_000.0), None);
        assert_eq!(problem(&tare(-20_001, 0), 5_000, 1_000.0), Some(TareProblem::FarFromZero));
        assert_eq!(problem(&tare(0, -2_002), 5_000, 1_000.0), Some(TareProblem::Settling));
    }

    #[test]
    fn without_a_reading_the_zero_stays() {
        let mut taring = Taring::default();
        taring.miss();
        let tare = taring.finish([4, -4], 1_000.0);
        assert_eq!((tare.zero_counts, tare.periods, tare.readings), ([4, -4], 1, 0));
    }

    #[test]
    fn the_longest_tare_of_the_largest_readings_stays_exact() {
        let mut taring = Taring::default();
        for index in 0..TARE_LIMIT_MS {
            let counts = if index % 2 == 0 { 2_000_000_000 } else { -2_000_000_000 };
            taring.add([counts, -counts], [0; 2]);
        }
        let tare = taring.finish([0; 2], 1_000.0);
        assert!(tare.zero_counts[0].abs() < 1_000, "{tare:?}");
    }
}
