//! Times at which the device has to receive a command, so that its host timeout does not expire.
//!
//! The device counts silence by its own clock, and a simulated one may run faster than the wall clock: both count.

use std::time::{Duration, Instant};

/// Longest interval between two commands.
pub const INTERVAL: Duration = Duration::from_millis(250);
/// Part of the device's limit after which it receives something, by its own clock: three of four may be lost.
const SHARE: u64 = 4;

/// Counts of messages that the device has received, and the time of its clock.
#[derive(Debug, Clone, Copy)]
pub struct Keepalive {
    sent: Instant,
    sent_device_us: u64,
    /// Latest device time.
    device_us: u64,
    limit_us: u64,
}

impl Keepalive {
    /// Starts with an answer of the device at this time of its clock, and with its host timeout.
    pub fn new(now: Instant, device_us: u64, limit_ms: u32) -> Self {
        Self { sent: now, sent_device_us: device_us, device_us, limit_us: u64::from(limit_ms) * 1_000 }
    }

    /// Notes the time of the device's clock.
    pub fn clock(&mut self, device_us: u64) {
        self.device_us = self.device_us.max(device_us);
    }

    /// Notes the host timeout that the device has stated.
    pub fn limit(&mut self, limit_ms: u32) {
        self.limit_us = u64::from(limit_ms) * 1_000;
    }

    /// Notes that the device has received a command.
    pub fn sent(&mut self, now: Instant) {
        (self.sent, self.sent_device_us) = (now, self.device_us);
    }

    /// Whether a command has to be sent now.
    pub fn is_due(&self, now: Instant) -> bool {
        let every_us = self.limit_us / SHARE;
        self.device_us >= self.sent_device_us.saturating_add(every_us)
            || now.saturating_duration_since(self.sent) >= INTERVAL.min(Duration::from_micros(every_us))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn a_device_that_runs_fast_receives_something_by_its_own_clock() {
        let now = Instant::now();
        let mut keepalive = Keepalive::new(now, 100_000_000, 2_000);
        keepalive.clock(100_490_000);
        assert!(!keepalive.is_due(now + MS));
        keepalive.clock(100_500_000);
        assert!(keepalive.is_due(now + MS));
        keepalive.sent(now + MS);
        assert!(!keepalive.is_due(now + 2 * MS));
        keepalive.limit(400);
        keepalive.clock(100_600_000);
        assert!(keepalive.is_due(now + 2 * MS), "a quarter of a shorter limit");
    }

    #[test]
    fn a_device_that_runs_slow_receives_something_by_the_hosts_clock() {
        let now = Instant::now();
        let keepalive = Keepalive::new(now, 0, 60_000);
        assert!(!keepalive.is_due(now + 249 * MS));
        assert!(keepalive.is_due(now + 250 * MS));
    }
}
