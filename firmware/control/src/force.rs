//! Force from converter codes: calibration, zero, and the treatment of missing and impossible readings.

use super::limits::{
    FORCE_READINGS, JUMP_PERCENT, LatestTwo, Outliers, REMEMBERED_CODES, REPEATED_CODES, Recent,
};
use super::mutation::Mutation;
use super::tare::{self, Taring};
use crate::ads131m02::ForceFault;
use crate::calibration::{Calibration, counts_of_mn};
use protocol::{Counters, Tare, TareProblem};

/// Force of both axes, with its history.
#[derive(Debug, Clone)]
pub struct ForceChannel {
    zero_counts: [i32; 2],
    latest_counts: [i32; 2],
    /// The latest reading that was not rejected.
    accepted_counts: [i32; 2],
    /// Codes of the latest readings, the newest first.
    codes: [[i32; 2]; REMEMBERED_CODES],
    /// This period has a valid reading.
    is_fresh: bool,
    /// This period has a valid reading that does not jump from those before it.
    is_accepted: bool,
    missing: Recent,
    saturated: LatestTwo,
    /// Readings that are missing, or repeat one of the latest on either channel.
    doubtful: Recent,
    outliers: Outliers,
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
            accepted_counts: [0; 2],
            codes: [[i32::MIN; 2]; REMEMBERED_CODES],
            is_fresh: false,
            is_accepted: false,
            missing: Recent::default(),
            saturated: LatestTwo::default(),
            doubtful: Recent::default(),
            outliers: Outliers::default(),
            counters: Counters::default(),
            taring: Taring::default(),
            tared: false,
        }
    }

    /// Takes this period's reading; returns the force relative to the tare, in force counts. A period without a valid reading is
    /// counted, and returns the force of the last valid one.
    pub fn update(&mut self, calibration: &Calibration, reading: &Result<[i32; 2], ForceFault>) -> [i32; 2] {
        let is_saturated = matches!(reading, Err(ForceFault::Saturated { .. }));
        // Saturation is evidence of a load; a missing reading is not.
        let is_missing = reading.is_err() && !is_saturated;
        let is_repeated = reading.as_ref().is_ok_and(|codes| self.repeats(*codes));
        self.saturated.note(is_saturated, FORCE_READINGS);
        self.missing.note(is_missing);
        self.doubtful.note((is_missing || is_repeated) && !Mutation::FalseReadings.is_out());
        self.is_fresh = reading.is_ok();
        match reading {
            Ok(codes) => {
                let [first, second, third, _] = self.codes;
                self.codes = [*codes, first, second, third];
                self.latest_counts = calibration.force_counts(*codes);
                let jump = counts_of_mn(calibration.force_range_mn().saturating_mul(JUMP_PERCENT) / 100);
                let jumps = self.latest_counts.iter().zip(self.accepted_counts);
                let is_jump =
                    jumps.into_iter().any(|(now, before)| now.saturating_sub(before).saturating_abs() > jump);
                self.is_accepted = self.outliers.accepts(is_jump);
                if self.is_accepted {
                    self.accepted_counts = self.latest_counts;
                }
            }
            Err(fault) => {
                self.is_accepted = false;
                self.count(*fault);
            }
        }
        self.relative_counts()
    }

    /// Whether a channel repeats an earlier code, except for the last bit, which is rare for a converter with noise of many codes.
    fn repeats(&self, codes: [i32; 2]) -> bool {
        self.codes
            .iter()
            .any(|earlier| codes.into_iter().zip(*earlier).any(|(code, earlier)| repeats_code(code, earlier)))
    }

    fn count(&mut self, fault: ForceFault) {
        let counters = &mut self.counters;
        counters.force_readings_bad = counters.force_readings_bad.saturating_add(1);
        let counter = match fault {
            ForceFault::Bus => return,
            ForceFault::Crc => &mut counters.force_corrupt,
            ForceFault::NotReady => &mut counters.force_missing,
            ForceFault::DeviceReset => &mut counters.force_resets,
            ForceFault::Saturated { .. } => &mut counters.force_saturated,
        };
        *counter = counter.saturating_add(1);
    }

    /// Force relative to the tare, in force counts.
    pub fn relative_counts(&self) -> [i32; 2] {
        let ([x, y], [zero_x, zero_y]) = (self.latest_counts, self.zero_counts);
        [x.saturating_sub(zero_x), y.saturating_sub(zero_y)]
    }

    /// The latest reading that was not rejected, relative to the tare, in force counts.
    pub fn accepted_counts(&self) -> [i32; 2] {
        let ([x, y], [zero_x, zero_y]) = (self.accepted_counts, self.zero_counts);
        [x.saturating_sub(zero_x), y.saturating_sub(zero_y)]
    }

    /// Whether this period has a valid reading.
    pub fn is_fresh(&self) -> bool {
        self.is_fresh
    }

    /// Whether this period has a valid reading that does not jump from those before it.
    pub fn is_accepted(&self) -> bool {
        self.is_accepted
    }

    /// Number of missing readings among the latest.
    pub fn missing(&self) -> u32 {
        self.missing.count()
    }

    /// Whether the converter was saturated in two of the latest readings.
    pub fn is_saturated(&self) -> bool {
        self.saturated.are_within(FORCE_READINGS)
    }

    /// Number of missing or repeated readings among the latest.
    pub fn doubtful(&self) -> u32 {
        self.doubtful.count()
    }

    /// Number of missing or repeated readings among the latest [`super::limits::LATEST_READINGS`].
    pub fn latest_doubtful(&self) -> u32 {
        self.doubtful.latest_count()
    }

    /// Errors of readings since start.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// Force from the calibration's zero, in force counts.
    pub fn absolute_counts(&self) -> [i32; 2] {
        self.latest_counts
    }

    /// Begins a tare from its first period.
    pub fn begin_tare(&mut self) {
        self.taring = Taring::default();
    }

    /// Adds this period to the tare. A rejected reading counts as missing.
    pub fn tare_on(&mut self) {
        if self.is_accepted {
            self.taring.add(self.relative_counts(), self.codes[0]);
        } else {
            self.taring.miss();
        }
    }

    /// Makes the tare's mean the zero and reports its quality.
    ///
    /// # Errors
    /// The problem of the tare; the zero is then unchanged.
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

    /// Whether a tare was completed since the start.
    pub fn is_tared(&self) -> bool {
        self.tared
    }

    /// Zero of the tare, in force counts from the calibration's zero.
    pub fn zero_counts(&self) -> [i32; 2] {
        self.zero_counts
    }
}

fn repeats_code(code: i32, earlier: i32) -> bool {
    code.saturating_sub(earlier).saturating_abs() <= REPEATED_CODES
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
        Calibration::new(record).expect("a valid calibration")
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
        let tare = force.finish_tare(5_000, 1_000.0).expect("no problem");
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
        assert_eq!((force.missing(), force.is_saturated(), force.is_fresh()), (4, false, false));
        force.update(&calibration, &Ok([1_000, 2_000]));
        assert!(force.is_fresh() && force.is_accepted());
    }

    #[test]
    fn codes_that_are_frozen_except_for_their_last_bit_are_doubtful_on_either_channel() {
        let (calibration, mut force) = (Calibration::default(), ForceChannel::new());
        for index in 0..10 {
            force.update(&calibration, &Ok([1_000 * index, 77 + index % 2]));
        }
        assert_eq!(force.doubtful(), 9);
        force.update(&calibration, &Ok([20_000, 700]));
        assert_eq!(force.doubtful(), 9, "a reading that repeats none is not doubtful");
    }

    #[test]
    fn a_reading_that_jumps_is_rejected_and_one_that_stays_is_accepted() {
        let (calibration, mut force) = (counts_as_codes(), ForceChannel::new());
        let mut read = |code: i32| {
            force.update(&calibration, &Ok([code, 5]));
            (force.is_accepted(), force.accepted_counts()[0])
        };
        // 10 % of 100 N are 200,000 counts.
        assert_eq!(read(100_000), (true, 100_000));
        assert_eq!(read(400_000), (false, 100_000));
        assert_eq!(read(101_000), (true, 101_000));
        assert_eq!((read(401_000).0, read(402_000).0), (false, false));
        assert_eq!(read(403_000), (true, 403_000));
    }
}
