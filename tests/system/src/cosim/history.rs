//! Exchange of rig and firmware in each of the last periods, for comparison with the firmware's reports.

use std::collections::VecDeque;

/// Periods that are kept: longer than any message of the firmware can be under way to its reader.
pub const KEPT_PERIODS: usize = 300_000;

/// One period.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Period {
    /// Codes of the potentiometers.
    pub potentiometer_codes: [u16; 2],
    /// Codes of the force channels.
    pub force_codes: [i32; 2],
    /// No input of a bridge was high.
    pub released: bool,
    /// The potentiometers' conversions took longer than they should.
    pub slow: bool,
    /// The force converter gave no valid reading: the one before stays.
    pub force_repeats: bool,
}

/// The last periods: a ring that never grows, so that a run of hours takes no more memory than one of minutes.
#[derive(Debug)]
pub struct History {
    /// Period after the newest.
    next: u64,
    /// Periods that the ring really has.
    kept: usize,
    ring: VecDeque<Period>,
}

impl History {
    /// History that begins with this period. All memory is taken and touched at once.
    pub fn new(from: u64) -> Self {
        let no_period = Period {
            potentiometer_codes: [u16::MAX; 2],
            force_codes: [i32::MIN; 2],
            released: true,
            slow: false,
            force_repeats: false,
        };
        Self { next: from, kept: 0, ring: VecDeque::from(vec![no_period; KEPT_PERIODS]) }
    }

    /// One more period.
    pub fn push(&mut self, period: Period) {
        self.ring.pop_front();
        self.ring.push_back(period);
        self.kept = (self.kept + 1).min(KEPT_PERIODS);
        self.next += 1;
    }

    /// A period, while it is kept.
    pub fn get(&self, period: u64) -> Option<Period> {
        let age = usize::try_from(self.next.checked_sub(period)?).ok()?;
        if (1..=self.kept).contains(&age) { self.ring.get(KEPT_PERIODS - age).copied() } else { None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn period(number: u64) -> Period {
        let force_codes = [number as i32, 0];
        Period { potentiometer_codes: [0; 2], force_codes, released: true, slow: false, force_repeats: false }
    }

    #[test]
    fn the_last_periods_are_there_and_no_others() {
        let mut history = History::new(7);
        assert_eq!((history.get(6), history.get(7)), (None, None));
        let last = 7 + KEPT_PERIODS as u64 + 5;
        (7..=last).for_each(|number| history.push(period(number)));
        assert_eq!(history.get(last), Some(period(last)));
        let oldest = last + 1 - KEPT_PERIODS as u64;
        assert_eq!((history.get(oldest), history.get(oldest - 1)), (Some(period(oldest)), None));
        assert_eq!(history.get(last + 1), None);
        assert_eq!(history.ring.capacity(), KEPT_PERIODS);
    }
}
