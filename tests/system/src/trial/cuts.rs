//! When the cable is cut, and when it is mended.

use crate::wire::NoisyWire;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::ops::Range;

/// Time between a mended cable and its next cut, milliseconds of the rig's.
const WHOLE_MS: Range<u64> = 2_000..20_000;
/// Time for which it is cut.
const CUT_MS: Range<u64> = 20..3_000;

/// A cable that is cut at random times for random times.
#[derive(Debug)]
pub struct Cuts {
    next_ms: u64,
    mend_ms: Option<u64>,
    count: u32,
}

impl Cuts {
    /// A whole cable.
    pub fn new(now_ms: u64, random: &mut ChaCha8Rng) -> Self {
        Self { next_ms: now_ms + random.random_range(WHOLE_MS), mend_ms: None, count: 0 }
    }

    /// Cuts or mends it where it is time to.
    pub fn step(&mut self, now_ms: u64, wire: &NoisyWire, random: &mut ChaCha8Rng) {
        match self.mend_ms {
            Some(mend_ms) if now_ms >= mend_ms => {
                wire.mend();
                (self.next_ms, self.mend_ms) = (now_ms + random.random_range(WHOLE_MS), None);
            }
            None if now_ms >= self.next_ms => {
                wire.cut();
                self.count += 1;
                self.mend_ms = Some(now_ms + random.random_range(CUT_MS));
            }
            _ => {}
        }
    }

    /// Whether it is cut now.
    pub fn is_cut(&self) -> bool {
        self.mend_ms.is_some()
    }

    /// How often it has been cut.
    pub fn count(&self) -> u32 {
        self.count
    }
}
