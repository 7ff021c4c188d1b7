//! Condition of the link: rates over the last second, and what was lost since the monitor began.

use crate::link::LinkLosses;
use std::collections::VecDeque;

/// Time over which rates are taken, seconds.
const RATE_S: f64 = 1.0;
/// Time between two entries of the history, seconds: with it the history's length is bounded.
const ENTRY_S: f64 = 0.05;

/// Bytes and losses of one connection since it was made.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LinkTotals {
    /// Bytes from the device.
    pub bytes: u64,
    /// Losses on the way.
    pub losses: LinkLosses,
}

#[derive(Debug, Clone, Copy)]
struct Entry {
    at_s: f64,
    bytes: u64,
    samples: u64,
}

/// Rates and losses over any number of connections.
#[derive(Debug, Clone, Default)]
pub struct LinkHealth {
    ended: LinkTotals,
    current: LinkTotals,
    samples: u64,
    history: VecDeque<Entry>,
}

impl LinkHealth {
    /// Notes a new connection, whose counts begin at zero.
    pub fn connected(&mut self) {
        self.ended = self.total();
        self.current = LinkTotals::default();
        self.history.clear();
    }

    /// Samples have arrived.
    pub fn samples(&mut self, count: usize) {
        self.samples = self.samples.saturating_add(count as u64);
    }

    /// Totals of the present connection.
    pub fn update(&mut self, current: LinkTotals, now_s: f64) {
        self.current = current;
        if self.history.back().is_some_and(|last| now_s - last.at_s < ENTRY_S) {
            return;
        }
        let bytes = self.total().bytes;
        self.history.push_back(Entry { at_s: now_s, bytes, samples: self.samples });
        while self.history.get(1).is_some_and(|second| now_s - second.at_s > RATE_S) {
            self.history.pop_front();
        }
    }

    /// All connections together.
    pub fn total(&self) -> LinkTotals {
        let (a, b) = (self.ended, self.current);
        LinkTotals {
            bytes: a.bytes.saturating_add(b.bytes),
            losses: LinkLosses {
                frames_missing: a.losses.frames_missing.saturating_add(b.losses.frames_missing),
                frames_corrupt: a.losses.frames_corrupt.saturating_add(b.losses.frames_corrupt),
                frames_unreadable: a.losses.frames_unreadable.saturating_add(b.losses.frames_unreadable),
                samples_missing: a.losses.samples_missing.saturating_add(b.losses.samples_missing),
            },
        }
    }

    /// Samples received.
    pub fn samples_received(&self) -> u64 {
        self.samples
    }

    /// Bytes and samples per second of wall time, over the last second.
    pub fn per_second(&self) -> [f64; 2] {
        match (self.history.front(), self.history.back()) {
            (Some(first), Some(last)) if last.at_s > first.at_s => {
                let span_s = last.at_s - first.at_s;
                fn rate(first: u64, last: u64, span_s: f64) -> f64 {
                    last.saturating_sub(first) as f64 / span_s
                }
                [rate(first.bytes, last.bytes, span_s), rate(first.samples, last.samples, span_s)]
            }
            _ => [0.0; 2],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn totals(bytes: u64, samples_missing: u64) -> LinkTotals {
        LinkTotals { bytes, losses: LinkLosses { samples_missing, ..LinkLosses::default() } }
    }

    #[test]
    fn rates_are_those_of_the_last_second() {
        let mut health = LinkHealth::default();
        assert_eq!(health.per_second(), [0.0, 0.0]);
        let mut bytes = 0;
        for tenth in 0..100 {
            // Slow at first, fast at the end.
            bytes += if tenth < 50 { 10 } else { 630 };
            health.samples(100);
            health.update(totals(bytes, 0), f64::from(tenth) * 0.1);
        }
        let [bytes_per_s, samples_per_s] = health.per_second();
        assert!((bytes_per_s - 6_300.0).abs() < 1.0, "{bytes_per_s}");
        assert!((samples_per_s - 1_000.0).abs() < 1.0, "{samples_per_s}");
        assert_eq!(health.samples_received(), 10_000);
    }

    #[test]
    fn losses_of_earlier_connections_are_not_forgotten() {
        let mut health = LinkHealth::default();
        health.update(totals(100, 3), 0.0);
        health.connected();
        assert_eq!(health.total(), totals(100, 3));
        assert_eq!(health.per_second(), [0.0, 0.0]);
        health.update(totals(20, 4), 5.0);
        assert_eq!(health.total(), totals(120, 7));
    }

    #[test]
    fn the_history_is_bounded() {
        let mut health = LinkHealth::default();
        for i in 0..10_000 {
            health.update(totals(i, 0), i as f64 * 1e-3);
        }
        assert!(health.history.len() < 30, "{}", health.history.len());
    }
}
