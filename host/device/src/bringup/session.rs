//! Runs the steps over the link, in order, each only where nothing that it depends on is known to be wrong.

use super::findings::Finding;
use super::moves::Moves;
use super::report::{Device, Report, StepReport, StepResult};
use super::{BringupError, Operator, Prompt, Step, moves, pulses, rest, stop, wires};
use crate::link::{Client, LinkError, Point, Telemetry, named};
use protocol::{CalibrationRecord, CalibrationSource, Fault, Hello, Request, State, Status};
use std::thread::sleep;
use std::time::{Duration, Instant};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// How long the host waits for device time to pass, by its own clock: far more than any link needs.
const TIMEOUT: Duration = Duration::from_secs(120);
/// How often a clear is tried.
const CLEAR_TRIES: u32 = 10;
/// How long a device that restarts may take until it answers again.
const RESTART_TIME: Duration = Duration::from_secs(20);

/// A bring-up under way.
pub(super) struct Session<'a> {
    pub client: Client,
    pub operator: &'a mut dyn Operator,
    /// The moves of the loop's step, for the force's.
    pub moves: Option<Moves>,
    port: String,
}

/// Carries out a bring-up of the device at a port: these steps, or those of them that can run. `failed` are steps that an earlier bring-up
/// found something wrong in, and that are not repeated; `calibration` is what the last step stores, which without it is none of the steps.
///
/// # Errors
/// Where the device cannot be reached, speaks another protocol, the link is lost, or the user interrupts; what is wrong with the rig is no
/// error.
pub fn run(
    port: &str,
    steps: &[Step],
    failed: &[Step],
    calibration: Option<&CalibrationRecord>,
    operator: &mut dyn Operator,
) -> Result<Report, BringupError> {
    let client = Client::connect(port)?;
    let mut report = Report {
        schema: "guide.bringup/1",
        date: OffsetDateTime::now_utc().format(&Rfc3339).unwrap_or_default(),
        device: device(client.hello()),
        passed: false,
        interrupted_in: None,
        steps: Vec::new(),
    };
    let mut session = Session { client, operator, moves: None, port: port.to_owned() };
    let is_due = |step: &Step| steps.contains(step) && (*step != Step::Store || calibration.is_some());
    let mut is_lossy = false;
    for step in Step::ALL.into_iter().filter(is_due) {
        if is_lossy {
            let because = "the line loses frames: correct it first".to_owned();
            report.steps.push(StepReport::without(step, StepResult::Blocked, because));
            continue;
        }
        let blocking = step.needs().iter().find(|needed| {
            let (name, repeated) = (needed.name(), steps.contains(needed));
            (!repeated && failed.contains(needed))
                || report.steps.iter().any(|before| before.step == name && before.blocks())
        });
        let done = match blocking {
            Some(needed) => {
                let because = format!("`{}` has to pass first", needed.name());
                StepReport::without(step, StepResult::Blocked, because)
            }
            None => {
                report.interrupted_in = Some(step.name());
                session.operator.begins(step, &report)?;
                if let (Step::Store, Some(record)) = (step, calibration) {
                    session = session.stored(record)?;
                    report.device = device(session.client.hello());
                }
                let mut done = session.step(step);
                if matches!(done, Err(LinkError::Restarted { .. })) {
                    session = session.reconnected()?;
                    let mut restarted = StepReport::new(step);
                    restarted.find(wires::reset_finding(session.client.hello(), "in this step"));
                    done = Ok(restarted);
                }
                // The device is there and answers, but not enough of it arrives: nothing more can be measured.
                let lost =
                    done.as_ref().err().filter(|error| matches!(error, LinkError::AnswerMissing { .. }));
                let lost = lost.map(ToString::to_string);
                if let Some(measured) = lost {
                    is_lossy = true;
                    let _ = session.client.request(Request::Stop);
                    let mut lossy = StepReport::new(step);
                    lossy.find(Finding::new("link.lossy", None, measured));
                    done = Ok(lossy);
                }
                if done.is_err() || session.operator.is_interrupted() {
                    // Where the link is gone the stop cannot arrive; the device ends the motion by itself and holds.
                    let _ = session.client.request(Request::Stop);
                }
                if session.operator.is_interrupted() {
                    return Err(BringupError::Interrupted { step: step.name() });
                }
                done?
            }
        };
        report.steps.push(done);
    }
    let _ = session.client.request(Request::Stop);
    let failed = |report: &StepReport| matches!(report.result, StepResult::Failed | StepResult::Blocked);
    report.passed = !report.steps.iter().any(failed);
    report.interrupted_in = None;
    Ok(report)
}

fn device(hello: &Hello) -> Device {
    Device {
        board: hello.board.as_str().to_owned(),
        firmware: hello.firmware_version.as_str().to_owned(),
        commit: hello.commit.as_str().to_owned(),
        calibration: hello.calibration.id.as_str().to_owned(),
        calibration_crc: format!("{:08x}", hello.calibration.crc),
    }
}

impl Session<'_> {
    fn step(&mut self, step: Step) -> Result<StepReport, LinkError> {
        let mut report = StepReport::new(step);
        if matches!(step, Step::Motors | Step::Loop) {
            if let Some(fault) = self.clear()? {
                report.find(of_fault(fault));
                return Ok(report);
            }
            if !self.operator.confirm(Prompt::Allow(step)) {
                return Ok(StepReport::without(
                    step,
                    StepResult::Skipped,
                    "motion was not allowed".to_owned(),
                ));
            }
            self.acknowledge()?;
        }
        match step {
            Step::Link => wires::link(self, &mut report)?,
            Step::Supply => wires::supply(self, &mut report)?,
            Step::EmergencyStop => return stop::run(self, report),
            Step::Converter => rest::converter(self, &mut report)?,
            Step::Potentiometers => rest::potentiometers(self, &mut report)?,
            Step::Motors => pulses::run(self, &mut report)?,
            Step::Loop => moves::run(self, &mut report)?,
            // It has been stored before: the device is another one since.
            Step::Store => {}
            Step::Force => match self.moves.take() {
                Some(done) => moves::force(&done, &mut report),
                None => {
                    let because = "it evaluates the moves of `loop`, which did not run".to_owned();
                    return Ok(StepReport::without(step, StepResult::Skipped, because));
                }
            },
        }
        Ok(report)
    }

    /// Has the device keep a calibration and restart with it, and reads it back; the session with the device as it is then.
    fn stored(self, record: &CalibrationRecord) -> Result<Self, LinkError> {
        let Self { client, operator, moves, port } = self;
        let mut client = client.store_calibration(record)?;
        let theirs = client.calibration()?;
        if theirs != *record {
            let (sent, theirs) = (named(&record.id, record.crc()), named(&theirs.id, theirs.crc()));
            return Err(LinkError::CalibrationNotKept { port, sent, theirs });
        }
        Ok(Self { client, operator, moves, port })
    }

    /// Has the device move by the constants of the rig as designed where it has no others: a new rig has none.
    fn acknowledge(&mut self) -> Result<(), LinkError> {
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
        let from = self.client.status()?;
        let until_us = from.t_us + (time_s * 1e6) as u64;
        let deadline = Instant::now() + TIMEOUT;
        loop {
            let status = self.client.status()?;
            if status.t_us >= until_us {
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
        let deadline = Instant::now() + TIMEOUT;
        let span_s = |points: &[Point]| match points {
            [first, .., last] => last.time_s - first.time_s,
            _ => 0.0,
        };
        while span_s(&points) < time_s {
            match self.client.next(Duration::from_millis(200))? {
                Some(Telemetry::Samples(batch)) => points.extend(batch.points),
                Some(_) => {}
                None if Instant::now() > deadline => return Err(self.silent()),
                None => {}
            }
            if self.operator.is_interrupted() {
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

    /// The device does not do what is awaited; where the user interrupts, [`run`] reports that instead.
    pub fn silent(&self) -> LinkError {
        LinkError::Silent { port: self.port.clone() }
    }

    /// After a restart of the device: connects again, once the port is free of the connection before.
    fn reconnected(self) -> Result<Self, LinkError> {
        let Self { client, operator, moves, port } = self;
        drop(client);
        let deadline = Instant::now() + RESTART_TIME;
        loop {
            match Client::connect_within(&port, 1) {
                Ok(client) => return Ok(Self { client, operator, moves, port }),
                Err(error) if Instant::now() > deadline => return Err(error),
                Err(_) => sleep(Duration::from_millis(100)),
            }
        }
    }
}

/// The finding of a fault that is latched at rest.
pub(super) fn of_fault(fault: Fault) -> Finding {
    let id = match fault {
        Fault::EmergencyStop => "stop.stays",
        Fault::ForceSensor => "force.silent",
        Fault::ForceStuck => "force.repeats",
        Fault::ForceRange => "force.saturated",
        Fault::ForceLimit => "force.limit",
        Fault::Potentiometer => "potentiometer.jumps",
        Fault::Travel => "potentiometer.off_middle",
        Fault::Restarted => "supply.restarted",
        _ => "loop.fault",
    };
    Finding::new(id, None, crate::link::error::explain_fault(fault))
}
