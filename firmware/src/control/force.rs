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
    tare: Tare,
}

#[derive(Debug, Default)]
struct Tare {
    readings: i64,
    sum: [i64; 2],
    sum_squares: [i64; 2],
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
            tare: Tare::default(),
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
        self.tare.readings += 1;
        for axis in 0..2 {
            let value = i64::from(relative_counts[axis]);
            self.tare.sum[axis] += value;
            self.tare.sum_squares[axis] += value * value;
        }
    }

    /// Makes the running tare's mean the zero. Returns the new zero (force counts from the converter's own zero) and the
    /// standard deviation of a single reading.
    pub fn finish_tare(&mut self) -> ([i32; 2], [u32; 2]) {
        let tare = core::mem::take(&mut self.tare);
        let mut sd_counts = [0; 2];
        if tare.readings > 0 {
            for axis in 0..2 {
                let mean = tare.sum[axis] as f32 / tare.readings as f32;
                let variance = tare.sum_squares[axis] as f32 / tare.readings as f32 - mean * mean;
                self.zero_counts[axis] += round(mean);
                sd_counts[axis] = round(libm::sqrtf(variance.max(0.0))) as u32;
            }
        }
        (self.zero_counts, sd_counts)
    }

    /// Drops a tare that was not completed.
    pub fn abandon_tare(&mut self) {
        self.tare = Tare::default();
    }
}
