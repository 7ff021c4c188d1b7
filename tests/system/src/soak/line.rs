//! The line to the device over time: a share of bits that flips, which changes, and cuts.

use crate::trial::Cuts;
use crate::wire::{Direction, NoisyWire};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Most bits that flip: this share of them.
const WORST_RATE: f64 = 1e-4;
/// Time with the same share, milliseconds.
const SAME_MS: std::ops::Range<u64> = 5_000..60_000;

/// A cable with its troubles.
pub struct Line<'a> {
    wire: &'a NoisyWire,
    cuts: Cuts,
    rate: f64,
    change_ms: u64,
    /// Both rates have been zero since this time; a frame under way is over by then.
    good: bool,
}

impl<'a> Line<'a> {
    pub fn new(wire: &'a NoisyWire, now_ms: u64, random: &mut ChaCha8Rng) -> Self {
        Self { wire, cuts: Cuts::new(now_ms, random), rate: 0.0, change_ms: now_ms + 2_000, good: true }
    }

    pub fn port(&self) -> String {
        self.wire.port()
    }

    pub fn step(&mut self, now_ms: u64, random: &mut ChaCha8Rng) {
        self.cuts.step(now_ms, self.wire, random);
        if now_ms >= self.change_ms {
            self.change_ms = now_ms + random.random_range(SAME_MS);
            // Evenly over three decades, and none now and then.
            let decades = 3.0 * random.random::<f64>();
            self.rate = if random.random_bool(0.25) { 0.0 } else { WORST_RATE * 10f64.powf(-decades) };
            self.set(self.rate);
        }
    }

    fn set(&mut self, rate: f64) {
        for direction in [Direction::ToDevice, Direction::ToHost] {
            self.wire.bit_error_rate(direction, rate);
        }
        self.good = rate == 0.0;
    }

    /// Nothing is wrong with it any more.
    pub fn make_good(&mut self, now_ms: u64) {
        self.wire.mend();
        self.set(0.0);
        self.change_ms = now_ms + 3_600_000;
    }

    pub fn is_cut(&self) -> bool {
        self.cuts.is_cut()
    }

    /// A frame may be lost.
    pub fn is_bad(&self) -> bool {
        !self.good || self.is_cut()
    }

    pub fn cuts(&self) -> u32 {
        self.cuts.count()
    }

    /// Bits that flipped, to the device and to the host.
    pub fn flipped_bits(&self) -> [u64; 2] {
        [Direction::ToDevice, Direction::ToHost].map(|direction| self.wire.counters(direction).flipped_bits)
    }
}
