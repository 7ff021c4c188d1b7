//! State of the device, from the events on its link. It has neither terminal nor clock: times are passed in.

use super::health::{LinkHealth, LinkTotals};
use super::traces::Traces;
use crate::link::{Point, Telemetry};
use protocol::{EventKind, Fault, Hello, ResetReason, State as Phase, Status};
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::collections::VecDeque;

/// Device time over which force and position are averaged, seconds.
pub const MEAN_S: f64 = 0.1;
/// Samples that are averaged at most, at any behaviour of the device's clock.
const MEAN_SAMPLES: usize = 1_000;
/// Values that are older than this are shown as old, seconds.
const OLD_S: f64 = 1.0;
/// Least width of the gap that a restart leaves in the plots, seconds.
const RESTART_GAP_S: f64 = 0.1;

/// Event on the link.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// The device has answered the hello.
    Connected {
        /// Number of the device's start.
        boot_id: u32,
        /// Who it is.
        hello: Box<Hello>,
    },
    /// The device sent something.
    Telemetry(Telemetry),
    /// Totals of the present connection.
    LinkTotals(LinkTotals),
    /// The connection is lost, with the reason.
    Lost(String),
    /// Outcome of a command.
    Command(Outcome),
    /// The force no longer follows a model, in words.
    Parted(String),
}

/// Result of a command.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Outcome {
    /// In words.
    pub text: String,
    /// It was carried out, or is being carried out.
    pub good: bool,
}

/// A device's report of its last restart.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Restart {
    /// Why it started.
    pub reason: ResetReason,
    /// The panic that ended the run before.
    pub panic: Option<String>,
}

/// A lost connection.
#[derive(Debug, Clone, PartialEq)]
pub struct ConnectionLoss {
    /// Why.
    pub reason: String,
    /// Since when.
    pub since_s: f64,
}

/// A lateral stiffness with its interval, newtons per metre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stiffness {
    /// The estimate.
    pub value_n_per_m: f64,
    /// Its 95 % interval.
    pub ci95_n_per_m: [f64; 2],
}

/// State of the device.
#[derive(Debug, Clone, Default)]
pub struct State {
    /// Port of the device.
    pub port: String,
    /// Hello that the device sent when it was connected.
    pub hello: Option<Box<Hello>>,
    /// Number of its start.
    pub boot_id: Option<u32>,
    /// The connection that is lost, while it is.
    pub down: Option<ConnectionLoss>,
    /// Its latest status.
    pub status: Option<Box<Status>>,
    /// Its state and the running step.
    pub phase: Option<(Phase, Option<u8>)>,
    /// Its latched fault.
    pub fault: Option<Fault>,
    /// A restart that the user has not dismissed.
    pub restart: Option<Restart>,
    /// Outcome of the last command, or what has been noticed since.
    pub outcome: Option<Outcome>,
    /// Descriptions of the axes whose force no longer follows a model.
    pub parted: Vec<String>,
    /// Force and displacement over time.
    pub traces: Traces,
    /// Losses, rates and load of the link.
    pub health: LinkHealth,
    recent: VecDeque<Point>,
    /// Latest device time that was received.
    clock_s: Option<f64>,
    /// When something was received last.
    received_s: Option<f64>,
    /// Device time of the first sample of this connection.
    streamed_from_s: Option<f64>,
    /// Offset from device time to the time of the plots, which goes on when the device starts again from zero.
    offset_s: f64,
    news: u64,
}

impl State {
    /// State before any event of the device at this port.
    pub fn new(port: &str) -> Self {
        Self { port: port.to_owned(), ..Self::default() }
    }

    /// Takes an event. Times are seconds of a steady clock of the host.
    pub fn take(&mut self, event: Event, now_s: f64) {
        match event {
            Event::Connected { boot_id, hello } => self.connected(boot_id, hello, now_s),
            Event::Telemetry(telemetry) => self.telemetry(telemetry, now_s),
            Event::LinkTotals(totals) => self.health.update(totals, now_s),
            Event::Lost(reason) => {
                let silent_since_s = self.down.as_ref().map_or(now_s, |down| down.since_s);
                self.down = Some(ConnectionLoss { reason, since_s: silent_since_s });
                self.news += 1;
            }
            Event::Command(outcome) => self.outcome = Some(outcome),
            Event::Parted(text) => {
                self.outcome = Some(Outcome { text: text.clone(), good: false });
                self.parted.push(text);
                self.news += 1;
            }
        }
    }

    /// The user has read the device's report of its restart.
    pub fn dismiss(&mut self) {
        self.restart = None;
    }

    fn connected(&mut self, boot_id: u32, hello: Box<Hello>, now_s: f64) {
        let now_device_s = hello.now_us as f64 * 1e-6;
        let restarted = self.boot_id.is_some_and(|known| known != boot_id);
        if restarted && let (Some(clock_s), Some(received_s)) = (self.clock_s, self.received_s) {
            let silence_s = (now_s - received_s).max(RESTART_GAP_S);
            self.offset_s += clock_s + silence_s - now_device_s;
        }
        if restarted || (self.boot_id.is_none() && hello.last_panic.is_some()) {
            let panic = hello.last_panic.as_ref().map(|text| text.as_str().to_owned());
            self.restart = Some(Restart { reason: hello.reset_reason, panic });
        }
        self.health.connected();
        self.recent.clear();
        self.streamed_from_s = None;
        (self.clock_s, self.received_s) = (Some(now_device_s), Some(now_s));
        (self.boot_id, self.hello, self.down) = (Some(boot_id), Some(hello), None);
        self.news += 1;
    }

    fn telemetry(&mut self, telemetry: Telemetry, now_s: f64) {
        self.received_s = Some(now_s);
        match telemetry {
            Telemetry::Samples(batch) => {
                self.health.samples(batch.points.len());
                self.phase = Some((batch.state, batch.step));
                for point in batch.points {
                    self.point(point);
                }
            }
            Telemetry::Event(event) => {
                self.tick(event.t_us as f64 * 1e-6);
                if let EventKind::Faulted { fault } = event.kind {
                    self.fault = Some(fault);
                }
            }
            Telemetry::Status(status) => {
                self.tick(status.t_us as f64 * 1e-6);
                self.phase = Some((status.state, (status.step != u8::MAX).then_some(status.step)));
                self.fault = status.fault;
                self.status = Some(status);
                self.news += 1;
            }
        }
    }

    fn point(&mut self, point: Point) {
        let ([force_x, force_y], [x, y]) = (point.force_n, point.displacement_m);
        self.tick(point.time_s);
        self.streamed_from_s.get_or_insert(point.time_s);
        self.traces.push(point.time_s + self.offset_s, [force_x, force_y, x, y]);
        self.recent.push_back(point);
        while self.recent.len() > MEAN_SAMPLES
            || self.recent.front().is_some_and(|first: &Point| point.time_s - first.time_s >= MEAN_S)
        {
            self.recent.pop_front();
        }
    }

    fn tick(&mut self, device_s: f64) {
        self.clock_s = Some(self.clock_s.map_or(device_s, |clock_s| clock_s.max(device_s)));
    }

    /// Whether the values are outdated.
    pub fn is_old(&self, now_s: f64) -> bool {
        self.down.is_some() || self.silent_s(now_s).is_none_or(|silent_s| silent_s > OLD_S)
    }

    /// Time since something was received.
    pub fn silent_s(&self, now_s: f64) -> Option<f64> {
        self.received_s.map(|received_s| (now_s - received_s).max(0.0))
    }

    /// Clock of the device.
    pub fn clock_s(&self) -> Option<f64> {
        self.clock_s
    }

    /// Time at the right edge of the plots; without a connection it goes on with the host's clock.
    pub fn edge_s(&self, now_s: f64) -> f64 {
        let silent_s = if self.down.is_some() { self.silent_s(now_s).unwrap_or(0.0) } else { 0.0 };
        self.clock_s.unwrap_or(0.0) + self.offset_s + silent_s
    }

    /// Displacement in m and force in N: means over the last [`MEAN_S`], or those of the status where nothing is streamed.
    pub fn mean(&self) -> Option<([f64; 2], [f64; 2])> {
        let count = self.recent.len() as f64;
        if count > 0.0 {
            let mean = |value: fn(&Point) -> [f64; 2]| {
                let [x, y] =
                    self.recent.iter().map(value).fold([0.0; 2], |[x, y], [dx, dy]| [x + dx, y + dy]);
                [x / count, y / count]
            };
            return Some((mean(|point| point.displacement_m), mean(|point| point.force_n)));
        }
        let (hello, status) = (self.hello.as_ref()?, self.status.as_ref()?);
        fn si(counts: [i32; 2], nano: u32) -> [f64; 2] {
            counts.map(|count| f64::from(count) * f64::from(nano) * 1e-9)
        }
        let displacement_m = si(status.position_counts, hello.scales.position_nm_per_count);
        Some((displacement_m, si(status.force_counts, hello.scales.force_nn_per_count)))
    }

    /// Stiffness along x and y as the device has estimated it; none before guide 2 has moved far enough to determine it.
    pub fn stiffness(&self) -> [Option<Stiffness>; 2] {
        let fit = self.status.as_ref().map_or([None; 2], |status| status.stiffness);
        fit.map(|fit| {
            let fit = fit?;
            let freedom = f64::from(fit.readings.checked_sub(2).filter(|freedom| *freedom > 0)?);
            let quantile = StudentsT::new(0.0, 1.0, freedom).ok()?.inverse_cdf(0.975);
            let (value_n_per_m, half) =
                (f64::from(fit.slope_mn_per_m) * 1e-3, quantile * f64::from(fit.sd_mn_per_m) * 1e-3);
            Some(Stiffness { value_n_per_m, ci95_n_per_m: [value_n_per_m - half, value_n_per_m + half] })
        })
    }

    /// Device time that has been streamed since the connection was made, seconds.
    pub fn streamed_s(&self) -> f64 {
        self.streamed_from_s.zip(self.clock_s).map_or(0.0, |(from_s, clock_s)| clock_s - from_s)
    }

    /// Grows with every status and with every change of the connection.
    pub fn news(&self) -> u64 {
        self.news
    }

    /// The lost connection, if the connection is lost.
    pub fn down(&self) -> Option<&ConnectionLoss> {
        self.down.as_ref()
    }

    /// Outcome of the last command.
    pub fn outcome(&self) -> Option<&Outcome> {
        self.outcome.as_ref()
    }
}

#[cfg(test)]
#[path = "state_tests.rs"]
mod tests;
