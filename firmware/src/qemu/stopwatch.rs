//! Counts instructions in QEMU, where time is proportional to their number: SysTick, calibrated by a loop of known length. SysTick
//! must not be in use for anything else.

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;

/// SysTick counts down from this.
const RELOAD: u32 = 0x00FF_FFFF;
/// Instructions of the loop that is timed for comparison: two per turn.
const KNOWN_INSTRUCTIONS: u32 = 2_000_000;

/// A running stopwatch.
pub struct Stopwatch {
    /// Ticks of the known loop.
    known: u32,
}

impl Stopwatch {
    /// Starts SysTick and times the known loop.
    pub fn start(timer: &mut SYST) -> Self {
        timer.set_clock_source(SystClkSource::Core);
        timer.set_reload(RELOAD);
        timer.clear_current();
        timer.enable_counter();
        let mut stopwatch = Self { known: 1 };
        let (_, ticks) = stopwatch.ticks(|| cortex_m::asm::delay(KNOWN_INSTRUCTIONS));
        stopwatch.known = ticks.max(1);
        stopwatch
    }

    /// Duration of a call in ticks, at most 16 million, with its result.
    pub fn ticks<R>(&self, work: impl FnOnce() -> R) -> (R, u32) {
        let start = SYST::get_current();
        let result = work();
        (result, start.wrapping_sub(SYST::get_current()) & RELOAD)
    }

    /// Number of instructions in this number of ticks.
    pub fn instructions(&self, ticks: u64) -> u32 {
        (ticks * u64::from(KNOWN_INSTRUCTIONS) / u64::from(self.known)) as u32
    }
}
