//! When the device must be spoken to, so that it does not think its host has gone, and so that its state is known.
//!
//! The device counts silence by its own clock, and a simulated one runs faster than the wall clock.

use std::time::{Duration, Instant};

/// The device hears something at least this often.
const SPEAK: Duration = Duration::from_millis(250);
/// A status that has not come unasked for this long is asked for.
const STATUS: Duration = Duration::from_millis(100);
/// Part of the device's limit after which it hears something, by its own clock.
const SHARE: f64 = 0.25;
/// Limit of a device that has not told its own yet, seconds.
const LIMIT_S: f64 = 2.0;

/// What the device has heard, and what was heard from it.
#[derive(Debug, Clone, Copy)]
pub struct Pace {
    spoken: Instant,
    spoken_device_s: f64,
    device_s: f64,
    status: Instant,
    limit_s: f64,
}

impl Pace {
    /// The device has just answered, at this time of its clock.
    pub fn new(now: Instant, device_s: f64) -> Self {
        Self { spoken: now, spoken_device_s: device_s, device_s, status: now, limit_s: LIMIT_S }
    }

    /// The device's clock has been heard.
    pub fn clock(&mut self, device_s: f64) {
        self.device_s = self.device_s.max(device_s);
    }

    /// A status has been heard.
    pub fn status(&mut self, now: Instant, limit_ms: u32) {
        self.status = now;
        self.limit_s = f64::from(limit_ms) * 1e-3;
    }

    /// The device has heard a command.
    pub fn spoken(&mut self, now: Instant) {
        (self.spoken, self.spoken_device_s) = (now, self.device_s);
    }

    /// Whether it must be asked for its status now.
    pub fn is_due(&self, now: Instant) -> bool {
        now.saturating_duration_since(self.spoken) >= SPEAK
            || now.saturating_duration_since(self.status) >= STATUS
            || self.device_s - self.spoken_device_s >= SHARE * self.limit_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn a_device_that_runs_fast_is_spoken_to_by_its_own_clock() {
        let now = Instant::now();
        let mut pace = Pace::new(now, 100.0);
        pace.status(now, 2_000);
        pace.clock(100.49);
        assert!(!pace.is_due(now + MS));
        pace.clock(100.5);
        assert!(pace.is_due(now + MS));
        pace.spoken(now + MS);
        assert!(!pace.is_due(now + 2 * MS));
        pace.status(now, 200);
        pace.clock(100.6);
        assert!(pace.is_due(now + 2 * MS), "a quarter of a shorter limit");
    }

    #[test]
    fn a_device_that_runs_slow_is_spoken_to_by_the_hosts_clock() {
        let now = Instant::now();
        let mut pace = Pace::new(now, 0.0);
        // Statuses come unasked.
        pace.status(now + 249 * MS, 60_000);
        assert!(!pace.is_due(now + 249 * MS));
        assert!(pace.is_due(now + 250 * MS));
    }

    #[test]
    fn a_status_that_does_not_come_unasked_is_asked_for() {
        let now = Instant::now();
        let mut pace = Pace::new(now, 0.0);
        pace.spoken(now + 90 * MS);
        assert!(!pace.is_due(now + 99 * MS));
        assert!(pace.is_due(now + 100 * MS));
    }
}
