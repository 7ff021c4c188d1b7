//! The device under bring-up and the person beside it: what every step does with them.

use super::Operator;
use crate::link::silence::Silence;
use crate::link::{Client, LinkError, Point, Telemetry, named};
use protocol::{CalibrationRecord, CalibrationSource, Fault, Request, State, Status};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Time for which the host waits for device time to pass, by its own clock: far more than any link
/// needs.
const TIMEOUT: Duration = Duration::from_secs(120);
/// Time for which one poll for telemetry waits: short, so that an interrupt is handled soon.
pub(super) const POLL_INTERVAL: Duration = Duration::from_millis(50);
/// Largest number of attempts to clear.
const CLEAR_TRIES: u32 = 10;
/// Time within which a device that restarts has to answer again.
const RESTART_TIME: Duration = Duration::from_secs(20);

/// A bring-up under way.
pub(super) struct Session<'a> {
    pub client: Client,
    pub operator: &'a mut dyn Operator,
    port: String,
}

impl<'a> Session<'a> {
    /// With the device at a port.
    pub fn connect(port: &str, operator: &'a mut dyn Operator) -> Result<Self, LinkError> {
        Ok(Self { client: Client::connect(port)?, operator, port: port.to_owned() })
    }

    /// Has the device keep a calibration and restart with it, and reads it back; the session with the device as it is then.
    pub fn stored(self, record: &CalibrationRecord) -> Result<Self, LinkError> {
        let Self { client, operator, port } = self;
        let mut client = client.store_calibration(record)?;
        let theirs = client.calibration()?;
        if theirs != *record {
            let (sent, theirs) = (named(&record.id, record.crc()), named(&theirs.id, theirs.crc()));
            return Err(LinkError::CalibrationNotKept { port, sent, theirs });
        }
        Ok(Self { client, operator, port })
    }

    /// Has the device move by the constants of the rig as designed where it has no others: a new rig has none.
    pub fn acknowledge(&mut self) -> Result<(), LinkError> {
        if self.client.safety()?.calibration == CalibrationSource::Nominal {
            self.client.request(Request::AcknowledgeCalibration)?;
        }
        Ok(())
    }

    /// Leaves a fault state; the fault whose cause is still there.
    pub fn clear(&mut self) -> Result<Option<Fault>, LinkError> {
        let Some(fault) = self.client.status()?.fault else { return Ok(None) };
        if fault == Fault::CalibrationLost {
            self.client.request(Request::AcknowledgeCalibration)?;
        }
        // A cause that comes and goes, as the jumps of a bad wiper, is not the one that is latched.
        for tries_left in (0..CLEAR_TRIES).rev() {
            match self.client.request(Request::ClearFault) {
                Ok(()) => break,
                Err(LinkError::Refused { .. }) if tries_left == 0 => return Ok(Some(fault)),
                Err(LinkError::Refused { .. }) => drop(self.wait(0.02)?),
                Err(error) => return Err(error),
            }
        }
        // A cause that takes some periods to be found again.
        self.wait(0.1)?;
        Ok(self.client.status()?.fault)
    }

    /// Lets device time pass, seconds; the status after that.
    pub fn wait(&mut self, time_s: f64) -> Result<Status, LinkError> {
        let first_status = self.client.status()?;
        let deadline_us = first_status.t_us + (time_s * 1e6) as u64;
        let deadline = Instant::now() + TIMEOUT;
        loop {
            let status = self.client.status()?;
            if status.t_us >= deadline_us {
                return Ok(status);
            }
            if Instant::now() > deadline || self.operator.is_interrupted() {
                return Err(self.silent());
            }
            sleep(Duration::from_millis(5));
        }
    }

    /// Records samples for so many seconds of the device.
    pub fn record(&mut self, time_s: f64) -> Result<Vec<Point>, LinkError> {
        while self.client.waiting().is_some() {}
        self.client.request(Request::Stream { enable: true })?;
        let mut points: Vec<Point> = Vec::new();
        let mut silence = Silence::default();
        let deadline = Instant::now() + TIMEOUT;
        fn span_s(points: &[Point]) -> f64 {
            match points {
                [first, .., last] => last.time_s - first.time_s,
                _ => 0.0,
            }
        }
        while span_s(&points) < time_s {
            if let Some(Telemetry::Samples(batch)) = silence.next(&mut self.client, POLL_INTERVAL)? {
                points.extend(batch.points);
            }
            if Instant::now() > deadline || self.operator.is_interrupted() {
                return Err(self.silent());
            }
        }
        self.client.request(Request::Stream { enable: false })?;
        Ok(points)
    }

    /// Waits for the device to be idle or in a fault.
    pub fn at_rest(&mut self) -> Result<Status, LinkError> {
        loop {
            let status = self.wait(0.02)?;
            if matches!(status.state, State::Idle | State::Faulted) {
                return Ok(status);
            }
        }
    }

    /// The device does not do what is awaited; where the user interrupts, [`run`](super::run) reports that instead.
    pub fn silent(&self) -> LinkError {
        LinkError::Silent { port: self.port.clone() }
    }

    /// After a restart of the device: connects again, once the port is free of the connection before.
    pub fn reconnected(self) -> Result<Self, LinkError> {
        let Self { client, operator, port } = self;
        drop(client);
        let deadline = Instant::now() + RESTART_TIME;
        loop {
            match Client::connect_within(&port, 1) {
                Ok(client) => return Ok(Self { client, operator, port }),
                Err(error) if Instant::now() > deadline => return Err(error),
                Err(_) => sleep(Duration::from_millis(100)),
            }
        }
    }
}
