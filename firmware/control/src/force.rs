//! Force from converter codes: calibration, zero, and what to do with readings that are not there or cannot be.

use super::mutation::Mutation;
use super::tare::{self, Taring};
use crate::ads131m02::ForceFault;
use crate::calibration::Calibration;
use protocol::{Counters, Tare, TareProblem};

/// Number of [`Loads`].
pub const LOADS: usize = 4;
/// What the limits are about, force counts: size of the force along x and y from the converter's own zero, and of both from the tare.
pub type Loads = [i32; LOADS];

/// Force of both axes, with its history.
#[derive(Debug, Clone)]
pub struct ForceChannel {
    zero_counts: [i32; 2],
    latest_counts: [i32; 2],
    latest_codes: [i32; 2],
    stale_periods: u16,
    saturated_periods: u16,
    /// Consecutive readings with the same code, per channel.
    unchanged: [u16; 2],
    counters: Counters,
    taring: Taring,
    tared: bool,
}

impl ForceChannel {
    /// No tare, no reading yet.
    #[expect(clippy::new_without_default, reason = "`ForceChannel::new()` is clearer at its only use")]
    pub fn new() -> Self {
        Self {
            zero_counts: [0; 2],
            latest_counts: [0; 2],
            latest_codes: [i32::MIN; 2],
            stale_periods: 0,
            saturated_periods: 0,
            unchanged: [0; 2],
            counters: Counters::default(),
            taring: Taring::default(),
            tared: false,
        }
    }

    /// Takes this period's reading; returns force relative to the tare, in force counts. A period without a valid reading
    /// repeats the last one and is counted; [`Self::stale_periods`] bounds how long that may go on.
    pub fn update(&mut self, calibration: &Calibration, reading: &Result<[i32; 2], ForceFault>) -> [i32; 2] {
        match reading {
            Ok(codes) => {
                for ((unchanged, before), code) in
                    self.unchanged.iter_mut().zip(self.latest_codes).zip(*codes)
                {
                    *unchanged = if before == code { unchanged.saturating_add(1) } else { 0 };
                }
                self.latest_codes = *codes;
                self.latest_counts = calibration.force_counts(*codes);
                self.stale_periods = 0;
                self.saturated_periods = 0;
            }
            Err(fault) => self.miss(*fault),
        }
        self.relative_counts()
    }

    fn miss(&mut self, fault: ForceFault) {
        self.stale_periods = self.stale_periods.saturating_add(1);
        if !matches!(fault, ForceFault::Saturated { .. }) && !Mutation::SilentAfterSaturation.is_out() {
            // A load that was there once must not pass for one that is there while nothing is measured.
            self.saturated_periods = 0;
        }
        let counters = &mut self.counters;
        counters.force_readings_bad = counters.force_readings_bad.saturating_add(1);
        let counter = match fault {
            ForceFault::Bus => return,
            ForceFault::Crc => &mut counters.force_corrupt,
            ForceFault::NotReady => &mut counters.force_missing,
            ForceFault::DeviceReset => &mut counters.force_resets,
            ForceFault::Saturated { .. } => {
                self.saturated_periods = self.saturated_periods.saturating_add(1);
                &mut counters.force_saturated
            }
        };
        *counter = counter.saturating_add(1);
    }

    /// Force relative to the tare, in force counts.
    pub fn relative_counts(&self) -> [i32; 2] {
        let ([x, y], [zero_x, zero_y]) = (self.latest_counts, self.zero_counts);
        [x.saturating_sub(zero_x), y.saturating_sub(zero_y)]
    }

    /// Periods since the last valid reading.
    pub fn stale_periods(&self) -> u16 {
        self.stale_periods
    }

    /// Consecutive periods in which the converter was saturated.
    pub fn saturated_periods(&self) -> u16 {
        self.saturated_periods
    }

    /// Consecutive readings in which the code of a channel has not changed; the larger of both.
    pub fn unchanged_readings(&self) -> u16 {
        let [x, y] = self.unchanged;
        x.max(y)
    }

    /// What went wrong with readings since start.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// Force from the converter's own zero, in force counts: what the range limit is about.
    pub fn absolute_counts(&self) -> [i32; 2] {
        self.latest_counts
    }

    /// Begins a tare again.
    pub fn begin_tare(&mut self) {
        self.taring = Taring::default();
    }

    /// Adds this period to the tare; a repeated reading is none.
    pub fn tare_on(&mut self) {
        if self.stale_periods > 0 {
            self.taring.miss();
        } else {
            self.taring.add(self.relative_counts(), self.latest_codes);
        }
    }

    /// Makes the tare's mean the zero and reports its quality.
    ///
    /// # Errors
    /// What is wrong with it: the zero stays what it was.
    pub fn finish_tare(&mut self, range_mn: u32, periods_per_s: f64) -> Result<Tare, (Tare, TareProblem)> {
        let tare = self.taring.finish(self.zero_counts, periods_per_s);
        if let Some(problem) =
            tare::problem(&tare, range_mn, periods_per_s).filter(|_| !Mutation::LimitFromTare.is_out())
        {
            return Err((tare, problem));
        }
        self.zero_counts = tare.zero_counts;
        self.tared |= tare.readings > 0;
        Ok(tare)
    }

    /// A tare was completed since the start.
    pub fn is_tared(&self) -> bool {
        self.tared
    }

    /// Zero of the force, in force counts from the converter's own.
    pub fn zero_counts(&self) -> [i32; 2] {
        self.zero_counts
    }

    /// Loads that the limits are about: size of the force along both axes, from the converter's own zero and from the tare, counts;
    /// nothing where the last period had no reading.
    pub fn loads(&self) -> Option<Loads> {
        let ([x, y], [tared_x, tared_y]) = (self.absolute_counts(), self.relative_counts());
        let mut loads = [x, y, tared_x, tared_y].map(i32::saturating_abs);
        if Mutation::LargestLoadAlone.is_out() {
            loads = [loads.into_iter().max().unwrap_or(0); LOADS];
        }
        (self.stale_periods == 0).then_some(loads)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::CalibrationRecord;

    fn counts_as_codes() -> Calibration {
        let record = CalibrationRecord {
            force_pn_per_code: [[50_000_000, 0], [0, 50_000_000]],
            force_range_mn: 100_000,
            ..Calibration::nominal_record()
        };
        Calibration::new(record).expect("a sound calibration")
    }

    #[test]
    fn a_second_tare_starts_from_the_first() {
        let (calibration, mut force) = (counts_as_codes(), ForceChannel::new());
        for offset in [90_000, 90_050] {
            force.begin_tare();
            for index in 0..1_000 {
                let swing = if index % 2 == 0 { 100 } else { -100 };
                force.update(&calibration, &Ok([offset + swing, -7 + swing]));
                force.tare_on();
            }
            let tare = force.finish_tare(100_000, 1_000.0).expect("a good tare");
            assert_eq!((tare.zero_counts, tare.sd_counts), ([offset, -7], [100, 100]));
            assert_eq!(force.update(&calibration, &Ok([offset + 50, -7])), [50, 0]);
        }
    }

    #[test]
    fn a_tare_without_valid_readings_keeps_the_zero() {
        let mut force = ForceChannel::new();
        force.update(&Calibration::default(), &Err(ForceFault::NotReady));
        force.tare_on();
        let tare = force.finish_tare(5_000, 1_000.0).expect("nothing is wrong with it");
        assert!(!force.is_tared());
        assert_eq!((tare.zero_counts, tare.periods, tare.readings), ([0, 0], 1, 0));
    }

    #[test]
    fn each_kind_of_bad_reading_is_counted() {
        let (calibration, mut force) = (Calibration::default(), ForceChannel::new());
        let faults = [
            ForceFault::Crc,
            ForceFault::NotReady,
            ForceFault::DeviceReset,
            ForceFault::Saturated { channel: 1 },
            ForceFault::Bus,
        ];
        for fault in faults {
            force.update(&calibration, &Err(fault));
        }
        let expected = Counters {
            force_readings_bad: 5,
            force_corrupt: 1,
            force_missing: 1,
            force_resets: 1,
            force_saturated: 1,
            ..Counters::default()
        };
        assert_eq!(*force.counters(), expected);
        assert_eq!((force.stale_periods(), force.saturated_periods()), (5, 0), "only the latest counts");
        force.update(&calibration, &Ok([1, 2]));
        assert_eq!((force.stale_periods(), force.saturated_periods()), (0, 0));
    }

    #[test]
    fn codes_that_stand_still_are_noticed_on_either_channel() {
        let (calibration, mut force) = (Calibration::default(), ForceChannel::new());
        for index in 0..10 {
            force.update(&calibration, &Ok([index, 77]));
        }
        assert_eq!(force.unchanged_readings(), 9);
        force.update(&calibration, &Ok([10, 78]));
        assert_eq!(force.unchanged_readings(), 0);
    }
}
