//! Device time at a multiple of the computer's, at most.

use std::time::{Duration, Instant};

/// The rig runs in bursts of this many periods and sleeps between them: a sleep per period would mostly be overhead.
const BURST_PERIODS: u32 = 5;
/// Delay of the rig that it can make up: sleeps end late by less than this. A longer delay, because it was given no
/// processor time or waited for a host, is not made up: a host that lost the same time would find the device racing
/// ahead.
const CATCH_UP: Duration = Duration::from_millis(5);

/// When the next burst is due.
#[derive(Debug)]
pub(super) struct Pace {
    /// Wall-clock time of a burst; zero for as fast as it goes.
    burst: Duration,
    periods: u32,
    due: Instant,
}

impl Pace {
    /// From now on, with so many seconds of the device per second; infinite for as fast as it goes.
    pub(super) fn new(period: Duration, speed: f64, now: Instant) -> Self {
        Self { burst: (period * BURST_PERIODS).div_f64(speed), periods: 0, due: now }
    }

    /// A period is over; how long to sleep before the next one.
    pub(super) fn period(&mut self, now: Instant) -> Duration {
        self.periods += 1;
        if self.periods < BURST_PERIODS {
            return Duration::ZERO;
        }
        self.periods = 0;
        self.due = (self.due + self.burst).max(now.checked_sub(CATCH_UP).unwrap_or(now));
        self.due.saturating_duration_since(now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    /// Runs so many periods, each of which takes `work`, with sleeps as requested; the total time.
    fn run(pace: &mut Pace, now: &mut Instant, periods: u32, work: Duration) -> Duration {
        let start_step = *now;
        for _ in 0..periods {
            *now += work;
            *now += pace.period(*now);
        }
        *now - start_step
    }

    #[test]
    fn device_time_runs_at_its_multiple_and_catches_up_small_delays() {
        let mut now = Instant::now();
        let mut pace = Pace::new(MS, 4.0, now);
        assert_eq!(run(&mut pace, &mut now, 4_000, MS / 100), 1_000 * MS);
        now += 4 * MS;
        assert_eq!(run(&mut pace, &mut now, 4_000, MS / 100), 996 * MS);
        assert_eq!(run(&mut Pace::new(MS, f64::INFINITY, now), &mut now, 4_000, MS / 100), 40 * MS);
    }

    #[test]
    fn does_not_catch_up_lost_time() {
        let mut now = Instant::now();
        let mut pace = Pace::new(MS, 4.0, now);
        run(&mut pace, &mut now, 400, MS / 100);
        now += 3_000 * MS;
        let took = run(&mut pace, &mut now, 4_000, MS / 100);
        // Two bursts begin before what was lost beyond that is forgotten.
        let least = 1_000 * MS - CATCH_UP - 2 * pace.burst;
        assert!((least..=1_000 * MS).contains(&took), "4 s of the device in {took:?}");
    }
}
