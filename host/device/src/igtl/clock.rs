//! When a message was, on the device's clock. Three clocks meet here: the sender's, this machine's and the device's.
//!
//! Neither link reports how long it takes, only when things arrive. Some messages arrive with almost no delay; the
//! offset between two clocks is therefore the least difference between arrival and stamp in the last seconds, so that
//! drift is followed and jitter is not.

use crate::link::Batch;
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Time over which the least delay is searched.
const WINDOW: Duration = Duration::from_secs(10);
/// Most differences that are kept.
const MAX_KEPT: usize = 1_024;
/// A message that arrives this late comes from a clock that was set.
const SET_S: f64 = 1.0;
/// Largest rate at which stamps run faster or slower than the device's clock to follow this machine's: twice what two
/// crystals differ by.
const FOLLOWING: f64 = 200e-6;
/// Largest lead of the device's clock over the newest sample: the most that a batch is late.
const AHEAD_S: f64 = 0.05;

/// The least of the differences in a window of time.
#[derive(Debug, Default)]
struct Least {
    /// Time and value, both increasing: an entry above a newer one cannot be the minimum any more and is dropped.
    kept: VecDeque<(Instant, f64)>,
}

impl Least {
    fn add(&mut self, at: Instant, difference_s: f64) -> f64 {
        while self.kept.back().is_some_and(|(_, kept_s)| *kept_s >= difference_s) {
            self.kept.pop_back();
        }
        self.kept.push_back((at, difference_s));
        while self.kept.len() > MAX_KEPT
            || self
                .kept
                .front()
                .is_some_and(|(then, _): &(Instant, f64)| at.saturating_duration_since(*then) > WINDOW)
        {
            self.kept.pop_front();
        }
        self.least().unwrap_or(difference_s)
    }

    fn least(&self) -> Option<f64> {
        self.kept.front().map(|(_, difference_s)| *difference_s)
    }
}

/// The sender's clock and the device's, relative to this machine's.
#[derive(Debug)]
pub struct Clocks {
    began: Instant,
    sender: Least,
    device: Least,
    /// Newest device time and when it arrived.
    newest: Option<(f64, f64)>,
}

impl Clocks {
    /// Clocks whose offset is still unknown. `began` is the zero of this machine's clock here.
    pub fn new(began: Instant) -> Self {
        Self { began, sender: Least::default(), device: Least::default(), newest: None }
    }

    /// The sender's clock was set: what is known of it counts no more.
    pub fn sender_was_set(&mut self) {
        self.sender = Least::default();
    }

    fn host_s(&self, at: Instant) -> f64 {
        at.saturating_duration_since(self.began).as_secs_f64()
    }

    /// Samples have arrived.
    pub fn samples(&mut self, batch: &Batch, at: Instant) {
        let Some(last) = batch.points.last() else { return };
        let host_s = self.host_s(at);
        self.device.add(at, host_s - last.time_s);
        self.newest = Some((last.time_s, host_s));
    }

    /// Device time of a message that arrived then; none before the first sample. `stamp` is zero where the sender does not state when
    /// it was.
    pub fn device_s(&mut self, stamp: Duration, at: Instant) -> Option<f64> {
        let arrived_s = self.host_s(at);
        let sent_s = if stamp.is_zero() { arrived_s } else { self.sent_s(stamp, at, arrived_s) };
        let (newest_s, newest_at_s) = self.newest?;
        // A device that goes slower than its clock reads, as one in a simulator can, is not run ahead of.
        let most_s = newest_s + (sent_s - newest_at_s) + AHEAD_S;
        self.device.least().map(|offset_s| (sent_s - offset_s).min(most_s))
    }

    /// When a message would have arrived if it had been as quick as the quickest.
    fn sent_s(&mut self, stamp: Duration, at: Instant, arrived_s: f64) -> f64 {
        let difference_s = arrived_s - stamp.as_secs_f64();
        if self.sender.least().is_some_and(|least_s| difference_s - least_s > SET_S) {
            self.sender = Least::default();
        }
        stamp.as_secs_f64() + self.sender.add(at, difference_s)
    }
}

/// Times since 1970 of a device's times. They go with the device's clock, which no jitter of the link moves, and follow this machine's
/// by [`FOLLOWING`]: a crystal that is off by 50 ppm is 4 s off after a day.
#[derive(Debug, Default)]
pub struct ClockMapping {
    least: Least,
    /// Time since 1970 at the device's zero, and the device's newest time, seconds.
    zero: Option<(f64, f64)>,
}

impl ClockMapping {
    /// A device time that has just arrived: `at` by this machine's steady clock, `now` since 1970.
    pub fn arrived(&mut self, time_s: f64, at: Instant, now: Duration) {
        if self.zero.is_some_and(|(_, newest_s)| time_s < newest_s) {
            // The device has started again.
            *self = Self::default();
        }
        let least_s = self.least.add(at, now.as_secs_f64() - time_s);
        let (zero_s, newest_s) = self.zero.unwrap_or((least_s, time_s));
        let most_s = FOLLOWING * (time_s - newest_s);
        self.zero = Some((zero_s + (least_s - zero_s).clamp(-most_s, most_s), time_s));
    }

    /// The time since 1970; zero before anything has arrived.
    pub fn stamp(&self, time_s: f64) -> Duration {
        let device_time_s = self.zero.map_or(0.0, |(zero_s, _)| zero_s + time_s);
        Duration::try_from_secs_f64(device_time_s).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::Point;
    use protocol::State;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn batch(time_s: f64) -> Batch {
        let point = Point { time_s, displacement_m: [0.0; 2], force_n: [0.0; 2], repeats_force: false };
        Batch { state: State::Idle, step: None, lost_before: 0, points: vec![point] }
    }

    /// A minute of samples and messages; the greatest error of the time found, after `warm_s`. `device` and `sender` are the
    /// clocks, `jitter_s` the most that a message waits beyond the least.
    fn greatest_error_s(
        device: impl Fn(f64) -> f64,
        sender: impl Fn(f64) -> f64,
        jitter_s: f64,
        warm_s: f64,
    ) -> f64 {
        let began = Instant::now();
        let mut clocks = Clocks::new(began);
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut worst_s = 0.0f64;
        for step in 0..6_000 {
            let now_s = f64::from(step) * 0.01;
            let arrival = began + Duration::from_secs_f64(now_s);
            clocks.samples(&batch(device(now_s)), arrival);
            if step % 7 == 0 {
                let waited_s = jitter_s * random.random::<f64>().powi(2);
                let stamp = Duration::from_secs_f64(sender(now_s - waited_s));
                let device_time_s = clocks.device_s(stamp, arrival).unwrap();
                if now_s > warm_s {
                    worst_s = worst_s.max((device_time_s - device(now_s - waited_s)).abs());
                }
            }
        }
        worst_s
    }

    #[test]
    fn jitter_and_drift_of_all_clocks_are_followed() {
        // The sender is decades ahead and 50 ppm fast, the device 100 ppm slow: half a millisecond and a millisecond in the window.
        let worst_s = greatest_error_s(
            |now_s: f64| 3.0 + now_s * (1.0 - 100e-6),
            |now_s: f64| 1.7e9 + now_s * (1.0 + 50e-6),
            0.2,
            5.0,
        );
        assert!(worst_s < 4e-3, "{worst_s} s");
    }

    #[test]
    fn the_offset_of_a_sender_whose_clock_is_set_is_estimated_again_at_once() {
        for jump_s in [-3_600.0, 3_600.0] {
            let worst_s = greatest_error_s(
                |now_s| now_s,
                |now_s: f64| 1.7e9 + now_s + if now_s > 30.0 { jump_s } else { 0.0 },
                0.0,
                1.0,
            );
            assert!(worst_s < 1e-3, "{worst_s} s after {jump_s} s");
        }
    }

    #[test]
    fn a_simulated_device_may_be_quick_or_slow() {
        for speed in [0.2, 1.0, 5.0] {
            let worst_s = greatest_error_s(|now_s| speed * now_s, |now_s| 1.7e9 + now_s, 0.0, 1.0);
            assert!(worst_s < 0.051, "{worst_s} s at {speed} times");
        }
    }

    /// Stamps of a device over a day, ten a minute: greatest distance from the true time after the first hour, and greatest difference of a
    /// stamp's step from the device's, as a share.
    fn stamps_of_a_day(rate: f64, jitter_s: f64) -> (f64, f64) {
        let began = Instant::now();
        let mut stamps = ClockMapping::default();
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let (mut worst_s, mut uneven, mut previous) = (0.0f64, 0.0f64, None);
        for step in 0..14_400 {
            let true_s = f64::from(step) * 6.0;
            let device_s = 3.0 + rate * true_s;
            // Some of the samples of a window are hardly late.
            let late_s = jitter_s * random.random::<f64>().powi(2);
            let arrival = Duration::from_secs_f64(true_s + late_s);
            stamps.arrived(device_s, began + arrival, Duration::from_secs_f64(1.7e9 + true_s + late_s));
            let stamp_s = stamps.stamp(device_s).as_secs_f64() - 1.7e9;
            if true_s > 3_600.0 {
                worst_s = worst_s.max((stamp_s - true_s).abs());
            }
            if let Some((stamp_before_s, device_before_s)) = previous {
                let steps_s: [f64; 2] = [stamp_s - stamp_before_s, device_s - device_before_s];
                uneven = uneven.max((steps_s[0] / steps_s[1] - 1.0).abs());
            }
            previous = Some((stamp_s, device_s));
        }
        (worst_s, uneven)
    }

    #[test]
    fn stamps_stay_with_this_machines_clock_for_a_day_and_are_even() {
        for rate in [1.0 - 100e-6, 1.0 + 100e-6] {
            let (worst_s, uneven) = stamps_of_a_day(rate, 0.02);
            assert!(worst_s < 0.02, "{worst_s} s off at {rate}");
            assert!(uneven < 1.01 * FOLLOWING, "{uneven} at {rate}");
        }
        // A simulated device at another speed goes on by its own clock.
        let (_, uneven) = stamps_of_a_day(4.0, 0.0);
        assert!(uneven < 1.01 * FOLLOWING, "{uneven}");
    }

    #[test]
    fn a_device_that_starts_again_is_put_to_the_clock_again() {
        let (began, mut stamps) = (Instant::now(), ClockMapping::default());
        assert_eq!(stamps.stamp(5.0), Duration::ZERO);
        stamps.arrived(100.0, began, Duration::from_secs(1_000));
        stamps.arrived(1.0, began + Duration::from_secs(9), Duration::from_secs(1_009));
        assert_eq!(stamps.stamp(1.5), Duration::from_secs_f64(1_009.5));
    }

    #[test]
    fn without_stamps_the_arrival_counts_and_without_samples_nothing_is_known() {
        let began = Instant::now();
        let mut clocks = Clocks::new(began);
        assert_eq!(clocks.device_s(Duration::from_secs(5), began), None);
        clocks.samples(&batch(7.0), began + Duration::from_millis(100));
        let device_time_s = clocks.device_s(Duration::ZERO, began + Duration::from_millis(120)).unwrap();
        assert!((device_time_s - 7.02).abs() < 1e-9, "{device_time_s}");
    }
}
