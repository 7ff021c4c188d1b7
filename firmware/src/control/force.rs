//! Force from converter codes: calibration, tare, and what to do with readings that are not there.

use crate::ads131m02::ForceFault;
use crate::calibration::Calibration;
use crate::control::round;

/// Force of both axes, with its history.
#[derive(Debug)]
pub struct ForceChannel {
    zero_counts: [i32; 2],
    latest_counts: [i32; 2],
    stale_periods: u16,
    saturated_periods: u16,
    bad_readings: u32,
    tare: [Tare; 2],
}

/// Running mean and variance of one channel, taken about the first reading: the squares stay small and exact.
#[derive(Debug, Default, Clone, Copy)]
struct Tare {
    first: i64,
    readings: i64,
    sum: i64,
    sum_squares: i64,
}

impl Tare {
    fn add(&mut self, counts: i32) {
        let counts = i64::from(counts);
        if self.readings == 0 {
            self.first = counts;
        }
        let deviation = counts - self.first;
        self.readings += 1;
        self.sum += deviation;
        self.sum_squares = self.sum_squares.saturating_add(deviation * deviation);
    }

    /// Mean and standard deviation of a single reading, in counts; nothing without readings.
    fn result(&self) -> Option<(i32, u32)> {
        let readings = (self.readings > 0).then_some(self.readings as f32)?;
        let mean = self.sum as f32 / readings;
        let variance = self.sum_squares as f32 / readings - mean * mean;
        Some((self.first as i32 + round(mean), round(libm::sqrtf(variance.max(0.0))) as u32))
    }
}

impl ForceChannel {
    /// No tare, no reading yet.
    #[expect(clippy::new_without_default, reason = "`ForceChannel::new()` says more at its only use")]
    pub fn new() -> Self {
        Self {
            zero_counts: [0; 2],
            latest_counts: [0; 2],
            stale_periods: 0,
            saturated_periods: 0,
            bad_readings: 0,
            tare: [Tare::default(); 2],
        }
    }

    /// Takes this period's reading; returns force relative to the tare, in force counts. A period without a valid reading
    /// repeats the last one and is counted; [`Self::stale_periods`] bounds how long that may go on.
    pub fn update(&mut self, calibration: &Calibration, reading: &Result<[i32; 2], ForceFault>) -> [i32; 2] {
        match reading {
            Ok(codes) => {
                self.latest_counts = calibration.force_counts(*codes);
                self.stale_periods = 0;
                self.saturated_periods = 0;
            }
            Err(fault) => {
                self.bad_readings = self.bad_readings.saturating_add(1);
                self.stale_periods = self.stale_periods.saturating_add(1);
                if matches!(fault, ForceFault::Saturated { .. }) {
                    self.saturated_periods = self.saturated_periods.saturating_add(1);
                }
            }
        }
        let [x, y] = self.latest_counts;
        let [zero_x, zero_y] = self.zero_counts;
        [x - zero_x, y - zero_y]
    }

    /// Periods since the last valid reading.
    pub fn stale_periods(&self) -> u16 {
        self.stale_periods
    }

    /// Consecutive periods in which the converter was saturated.
    pub fn saturated_periods(&self) -> u16 {
        self.saturated_periods
    }

    /// Readings that were missing, stale, corrupt or saturated since start.
    pub fn bad_readings(&self) -> u32 {
        self.bad_readings
    }

    /// Force from the converter's own zero, in force counts: what the range limit is about.
    pub fn absolute_counts(&self) -> [i32; 2] {
        self.latest_counts
    }

    /// Adds this period's force (relative to the present tare) to the running tare; repeated readings are left out.
    pub fn tare_with(&mut self, relative_counts: [i32; 2]) {
        if self.stale_periods > 0 {
            return;
        }
        for (tare, counts) in self.tare.iter_mut().zip(relative_counts) {
            tare.add(counts);
        }
    }

    /// Makes the running tare's mean the zero. Returns the new zero (force counts from the converter's own zero) and the
    /// standard deviation of a single reading.
    pub fn finish_tare(&mut self) -> ([i32; 2], [u32; 2]) {
        let tare = core::mem::take(&mut self.tare);
        let mut sd_counts = [0; 2];
        for ((zero, sd), tare) in self.zero_counts.iter_mut().zip(&mut sd_counts).zip(tare) {
            if let Some((mean, deviation)) = tare.result() {
                *zero += mean;
                *sd = deviation;
            }
        }
        (self.zero_counts, sd_counts)
    }

    /// Drops a tare that was not completed.
    pub fn abandon_tare(&mut self) {
        self.tare = Default::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tare_finds_mean_and_scatter_of_a_far_off_zero() {
        let calibration =
            Calibration { force_counts_per_code: [[1.0, 0.0], [0.0, 1.0]], ..Calibration::nominal() };
        let mut force = ForceChannel::new();
        for index in 0..1_000 {
            let swing = if index % 2 == 0 { 100 } else { -100 };
            let relative = force.update(&calibration, &Ok([90_000 + swing, -7 + swing]));
            force.tare_with(relative);
        }
        assert_eq!(force.finish_tare(), ([90_000, -7], [100, 100]));
        assert_eq!(force.update(&calibration, &Ok([90_050, -7])), [50, 0]);
        // A second tare starts from the first.
        force.tare_with([50, 0]);
        assert_eq!(force.finish_tare(), ([90_050, -7], [0, 0]));
    }

    #[test]
    fn a_tare_without_valid_readings_keeps_the_zero() {
        let calibration = Calibration::nominal();
        let mut force = ForceChannel::new();
        let relative = force.update(&calibration, &Err(ForceFault::NotReady));
        force.tare_with(relative);
        assert_eq!(force.finish_tare(), ([0, 0], [0, 0]));
        assert_eq!(force.bad_readings(), 1);
    }
}
