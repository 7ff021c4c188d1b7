//! Evidence that a fault requires: over the latest readings, not in runs of them. A loose contact gives a false
//! reading now and then, and a rule that waits for two true ones in a row never sees them.
//!
//! | evidence | a fault | so that |
//! |---|---|---|
//! | a force beyond a limit, saturated, or a jump of it that no motion makes | the second among the latest [`FORCE_READINGS`] | one outlying reading is none; true readings that come one by one, with a hundred false ones between them, show a load |
//! | a position beyond the track or the travel, or a jump of it | the second among the latest [`WINDOW_READINGS`] | one outlying reading is none, nor is a wiper that crackles now and then |
//! | a force that is missing, or repeated to the last bit | [`DOUBTFUL_READINGS`] of the latest [`WINDOW_READINGS`] | what is left of the readings shows a load in time |
//!
//! **Overshoot.** While nothing is latched, fewer than [`DOUBTFUL_READINGS`] of any [`WINDOW_READINGS`] readings are missing or
//! repeated, and a first false one may pass as a reading. So of any [`LATEST_READINGS`] readings two are true, and a load beyond the
//! limit is detected in the tenth at the latest, whichever readings fail; with sound sensors in the second. At full speed a motor
//! moves 20 um in a period: with a period of sampling and one until the bridge is off that is 0.24 mm instead of 0.08 mm, and it rolls on
//! by 0.24 mm (lag of 12 periods) in both cases. A motor whose gear has less friction rolls on further once its bridge is off (`host/manual/src/on-a-board.md` has
//! the row in which that is measured), and the overshoot is larger by as much.
//!
//! False readings that neither repeat nor jump are those of a sound channel without a load: a contact to a shorted input, with the noise of
//! the converter. Then two readings have to be true, beyond the limit or a jump from the others: where one in `n` is, that takes `2 n`
//! periods.
//!
//! **False faults.** Two spikes in the window are a fault: with `n` spikes an hour, `n * n * 128 / 3,600,000` false faults an hour, one in
//! eight hours at one a minute. A code is repeated where it is within [`REPEATED_CODES`] of one of the [`REMEMBERED_CODES`] before it. The
//! converter's own noise alone (0.4 uV at this gain and rate, 350 codes) does that to 1 % of the readings, so that eight of 32 come once
//! in a hundred hours; that of a cell (5 mN, 5,400 codes) to 0.07 %, and never. Noise of 0.02 N with 0.1 N of hum changes a reading by
//! 0.14 N (five standard deviations), and [`JUMP_PERCENT`] of a range of 5 N is 0.5 N: see there.

use super::mutation::Mutation;

/// Readings over which evidence is counted.
pub const WINDOW_READINGS: u8 = 32;
/// Readings over which evidence of a load is counted.
pub const FORCE_READINGS: u8 = 128;
/// Readings beyond a limit among them that are a fault.
pub const EVIDENCE_READINGS: u32 = 2;
/// Readings that are missing or repeated among them that are a fault.
pub const DOUBTFUL_READINGS: u32 = 8;
/// In so many readings a load beyond the limit is detected, whichever of them fail.
pub const LATEST_READINGS: u32 = DOUBTFUL_READINGS + EVIDENCE_READINGS;
/// Codes by which a repeated reading may differ: its last bit is alive.
pub const REPEATED_CODES: i32 = 1;
/// Codes before it that a reading is compared with: contacts that fail in a pattern repeat an earlier one, not the last.
pub const REMEMBERED_CODES: usize = 4;
/// Change of the force from one reading to the next that no motion makes, percent of the rated range: at full speed 20 um in a period,
/// on a tissue and needle of 15 N/mm 0.3 N, and the 0.14 N of the noise.
pub const JUMP_PERCENT: u32 = 10;
/// Jump of a position from one period to the next that no motor makes, micrometres: it makes 25 in a period, and the filtered
/// position that is compared with lags by up to 200.
pub const JUMP_UM: f32 = 1_000.0;

/// In which of the latest [`WINDOW_READINGS`] readings something was there.
#[derive(Debug, Clone, Copy, Default)]
pub struct Recent(u32);

impl Recent {
    /// Takes the next reading.
    pub fn note(&mut self, present: bool) {
        self.0 = self.0 << 1 | u32::from(present);
    }

    /// In how many it was there.
    pub fn count(self) -> u32 {
        self.0.count_ones()
    }
}

/// The latest two readings in which something was there, as readings since then.
#[derive(Debug, Clone, Copy)]
pub struct LatestTwo {
    later: u8,
    earlier: u8,
}

impl Default for LatestTwo {
    /// Never.
    fn default() -> Self {
        Self { later: u8::MAX, earlier: u8::MAX }
    }
}

impl LatestTwo {
    /// Takes the next reading; whether it was there in two of the latest `window`.
    pub fn note(&mut self, present: bool, window: u8) -> bool {
        if present {
            (self.later, self.earlier) = (0, self.later);
        } else {
            self.later = self.later.saturating_add(1);
        }
        self.earlier = self.earlier.saturating_add(1);
        self.are_within(window)
    }

    /// Both are among the latest `window` readings.
    pub fn are_within(self, window: u8) -> bool {
        if Mutation::TwoInARow.is_out() {
            (self.later, self.earlier) == (0, 1)
        } else {
            self.earlier < window
        }
    }
}

/// Accepts readings that continue those before them. One outlier is rejected; what lasts is accepted, and is a fault by then.
#[derive(Debug, Clone, Copy, Default)]
pub struct Outliers(u32);

impl Outliers {
    /// Takes the next reading, which is beyond a jump or not; whether it is accepted.
    pub fn accepts(&mut self, is_jump: bool) -> bool {
        self.0 = if is_jump { self.0.saturating_add(1) } else { 0 };
        !is_jump || self.0 > EVIDENCE_READINGS
    }
}
