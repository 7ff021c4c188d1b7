//! Evidence that a fault requires. It is counted over the latest readings and need not be consecutive: a loose contact gives a
//! false reading now and then, so that a rule that waits for two true readings in a row may wait for ever.
//!
//! | evidence | a fault | so that |
//! |---|---|---|
//! | a force that is beyond a limit, saturated, or jumps by more than any motion makes | the second among the latest [`FORCE_READINGS`] | one outlier is no fault; single true readings with a hundred false ones between them reveal a load |
//! | a position that is beyond the track or the travel, or jumps | the second among the latest [`WINDOW_READINGS`] | one outlier is no fault, nor is a wiper with a bad contact now and then |
//! | a force that is missing, or repeated except for the last bit | [`DOUBTFUL_READINGS`] of the latest [`LATEST_READINGS`] | the remaining readings reveal a load in time |
//! | the same | [`FREQUENT_READINGS`] of the latest [`WINDOW_READINGS`] | a channel that fails in every second reading is found without a load |
//! | a force that is missing | [`DOUBTFUL_READINGS`] of the latest [`WINDOW_READINGS`] | the same; no noise makes a reading missing |
//!
//! **Overshoot.** While nothing is latched, fewer than [`DOUBTFUL_READINGS`] of any [`LATEST_READINGS`] readings are missing or
//! repeated, and the first false one may pass as a true one, because it repeats nothing. So any [`LATEST_READINGS`] readings
//! contain two true ones. A load beyond the limit is detected in the tenth reading at the latest, whichever readings fail, and in
//! the second if none fails. At full speed a motor moves 20 um in a period: with a period of sampling and one until the bridge is
//! off that is 0.24 mm instead of 0.08 mm, and it then coasts by 0.24 mm (lag of 12 periods) in both cases. A motor whose gear has less
//! friction coasts further once its bridge is off, and the overshoot grows by the same distance
//! (`host/manual/src/on-a-board.md` has a row for its measurement).
//!
//! False readings that neither repeat nor jump look like those of a working channel without a load, for example if the input is
//! shorted now and then and the channel shows the noise of the converter. A load is detected when two readings are true and
//! beyond the limit, or jump from the others; where one reading in `n` is true, that takes up to `2 n` periods.
//!
//! **False faults.** Two spikes in the window are a fault: `n` spikes an hour cause `n * n * 128 / 3,600,000` false faults an
//! hour. One spike a minute causes one false fault in eight hours. A code counts as repeated if it is within [`REPEATED_CODES`] of
//! one of the [`REMEMBERED_CODES`] codes before it. A quiet
//! cell adds little to the converter's own noise (0.4 uV at this gain and rate, 350 codes). The difference of two such codes is at
//! most [`REPEATED_CODES`] with a probability of 0.24 %, so that a channel repeats one of four codes in 1.0 % of the readings, and one
//! channel or the other in `p` = 1.9 %. A number `k` of the latest `n` readings is reached, in each reading, with a probability of at most
//! `C(n - 1, k - 1) p^k (1 - p)^(n - k)`: 8 of 10 once in 50 years, 12 of 32 once in 200 years, but 8 of 32 every 9 hours. So eight
//! repeated readings are a fault only among the latest ten, from which the overshoot follows. Over 32 readings the number is
//! [`FREQUENT_READINGS`], the least one that noise reaches less often than eight of ten. With the noise of a cell of 5 mN (4,470 codes)
//! `p` is 0.15 %.
//!
//! Noise of 0.02 N with 0.1 N of hum changes a reading by 0.14 N (five standard deviations), and a jump ([`JUMP_PERCENT`]) is 0.5 N on
//! a range of 5 N.

use super::mutation::Mutation;

/// Readings over which evidence is counted.
pub const WINDOW_READINGS: u8 = 32;
/// Readings over which evidence of a load is counted.
pub const FORCE_READINGS: u8 = 128;
/// Number of readings beyond a limit, among the counted ones, that is a fault.
pub const EVIDENCE_READINGS: u32 = 2;
/// Number of missing or repeated readings among the latest [`LATEST_READINGS`], and of missing ones among the latest
/// [`WINDOW_READINGS`], that is a fault.
pub const DOUBTFUL_READINGS: u32 = 8;
/// Number of missing or repeated readings among the latest [`WINDOW_READINGS`] that is a fault.
pub const FREQUENT_READINGS: u32 = 12;
/// Number of readings within which a load beyond the limit is detected, whichever of them fail.
pub const LATEST_READINGS: u32 = DOUBTFUL_READINGS + EVIDENCE_READINGS;
/// Largest difference between repeated readings, codes: the last bit of a frozen channel may change.
pub const REPEATED_CODES: i32 = 1;
/// Number of earlier codes with which a reading is compared: a contact that fails in a pattern repeats an earlier code, which need
/// not be the last one.
pub const REMEMBERED_CODES: usize = 4;
/// Change of the force from one reading to the next that no motion makes, percent of the rated range: full speed is 20 um in a
/// period, which makes 0.3 N on a tissue and needle of 15 N/mm, and the noise adds 0.14 N.
pub const JUMP_PERCENT: u32 = 10;
/// Change of a position from one period to the next that no motor makes, micrometres: a motor moves by 25 in a period, and the
/// filtered position, from which the change counts, lags by up to 200.
pub const JUMP_UM: f32 = 1_000.0;

/// Occurrence of an event in each of the latest [`WINDOW_READINGS`] readings.
#[derive(Debug, Clone, Copy, Default)]
pub struct Recent(u32);

impl Recent {
    /// Takes the next reading.
    pub fn note(&mut self, present: bool) {
        self.0 = self.0 << 1 | u32::from(present);
    }

    /// Number of readings with the event.
    pub fn count(self) -> u32 {
        self.0.count_ones()
    }

    /// Number of readings with the event among the latest [`LATEST_READINGS`].
    pub fn latest_count(self) -> u32 {
        (self.0 & ((1 << LATEST_READINGS) - 1)).count_ones()
    }
}

/// Ages of the latest two readings with an event, in readings.
#[derive(Debug, Clone, Copy)]
pub struct LatestTwo {
    later: u8,
    earlier: u8,
}

impl Default for LatestTwo {
    /// No such reading so far.
    fn default() -> Self {
        Self { later: u8::MAX, earlier: u8::MAX }
    }
}

impl LatestTwo {
    /// Takes the next reading, and returns whether two of the latest `window` readings had the event.
    pub fn note(&mut self, present: bool, window: u8) -> bool {
        if present {
            (self.later, self.earlier) = (0, self.later);
        } else {
            self.later = self.later.saturating_add(1);
        }
        self.earlier = self.earlier.saturating_add(1);
        self.are_within(window)
    }

    /// Whether both are among the latest `window` readings.
    pub fn are_within(self, window: u8) -> bool {
        if Mutation::TwoInARow.is_out() {
            (self.later, self.earlier) == (0, 1)
        } else {
            self.earlier < window
        }
    }
}

/// Rejects readings that jump. The third jump in a row is accepted: by then it is a fault, except for a jump of the force at rest.
#[derive(Debug, Clone, Copy, Default)]
pub struct Outliers(u32);

impl Outliers {
    /// Takes the next reading, given whether it jumps, and returns whether it is accepted.
    pub fn accepts(&mut self, is_jump: bool) -> bool {
        self.0 = if is_jump { self.0.saturating_add(1) } else { 0 };
        !is_jump || self.0 > EVIDENCE_READINGS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Standard deviation of a converter's own noise, codes: 0.4 uV of 9.4 mV.
    const NOISE_CODES: f64 = 350.0;

    /// Probability that one of two channels with this noise repeats one of its earlier codes.
    fn repeats(noise_codes: f64) -> f64 {
        // Density at 0 of the difference of two codes.
        let density = 1.0 / (2.0 * noise_codes * std::f64::consts::PI.sqrt());
        let channel = REMEMBERED_CODES as f64 * f64::from(2 * REPEATED_CODES + 1) * density;
        1.0 - (1.0 - channel).powi(2)
    }

    /// Years until `least` of the latest `window` readings repeat by chance, with a reading every millisecond.
    fn years_until(least: u32, window: u32) -> f64 {
        let p = repeats(NOISE_CODES);
        let ways: f64 = (1..least).map(|k| f64::from(window - k) / f64::from(k)).product();
        let chance = ways * p.powi(least as i32) * (1.0 - p).powi((window - least) as i32);
        1e-3 / chance / (365.25 * 24.0 * 3_600.0)
    }

    /// A rig that is switched on for years meets no false fault, though its cell is as quiet as the converter.
    #[test]
    fn a_converters_own_noise_is_no_fault_for_years() {
        assert!((0.019..0.0195).contains(&repeats(NOISE_CODES)));
        let hours = years_until(DOUBTFUL_READINGS, WINDOW_READINGS.into()) * 365.25 * 24.0;
        assert!((8.5..9.5).contains(&hours), "eight of 32 every {hours} h would be a fault of a day");
        let latest = years_until(DOUBTFUL_READINGS, LATEST_READINGS);
        let frequent = years_until(FREQUENT_READINGS, WINDOW_READINGS.into());
        assert!(latest > 40.0 && frequent > latest, "{latest} and {frequent} years");
        assert!(years_until(FREQUENT_READINGS - 1, WINDOW_READINGS.into()) < latest, "the least such number");
    }
}
