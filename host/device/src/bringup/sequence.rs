//! Runs the steps over the link, in order, each only if no step on which it depends has a blocking finding.

use super::findings::{Finding, of_fault};
use super::moves::Moves;
use super::report::{Device, Report, StepReport, StepResult};
use super::session::Session;
use super::{BringupError, Operator, Prompt, Step, moves, pulses, rest, stop, wires};
use crate::link::LinkError;
use protocol::{CalibrationRecord, Hello, Request};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// Carries out these steps of a bring-up with the device at a port, as far as they can run. `failed` are the failed steps of an
/// earlier bring-up that are not repeated. `calibration` is stored by the last step, which is left out without one.
///
/// # Errors
/// Where the device cannot be reached, speaks another protocol, the link is lost, or the user interrupts. A fault of the rig is
/// a finding and no error.
pub fn run(
    port: &str,
    steps: &[Step],
    failed: &[Step],
    calibration: Option<&CalibrationRecord>,
    operator: &mut dyn Operator,
) -> Result<Report, BringupError> {
    let mut session = Session::connect(port, operator)?;
    let mut report = Report {
        schema: "guide.bringup/1",
        date: OffsetDateTime::now_utc().format(&Rfc3339).unwrap_or_default(),
        device: device(session.client.hello()),
        passed: false,
        interrupted_in: None,
        steps: Vec::new(),
    };
    // Moves of the loop's step, for the force's step.
    let mut moves = None;
    let mut is_lossy = false;
    for step in Step::ALL
        .into_iter()
        .filter(|step| steps.contains(step) && (*step != Step::Store || calibration.is_some()))
    {
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
        let step_report = match blocking {
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
                let mut step_report = carry_out(step, &mut session, &mut moves);
                if matches!(step_report, Err(LinkError::Restarted { .. })) {
                    session = session.reconnected()?;
                    let mut restarted = StepReport::new(step);
                    restarted.find(wires::reset_finding(session.client.hello(), "in this step"));
                    step_report = Ok(restarted);
                }
                // The device is there and answers, but not enough of it arrives: nothing more can be measured.
                let lost = step_report
                    .as_ref()
                    .err()
                    .filter(|error| matches!(error, LinkError::AnswerMissing { .. }));
                let lost = lost.map(ToString::to_string);
                if let Some(measured) = lost {
                    is_lossy = true;
                    let _ = session.client.request(Request::Stop);
                    let mut lossy = StepReport::new(step);
                    lossy.find(Finding::new("link.lossy", None, measured));
                    step_report = Ok(lossy);
                }
                if step_report.is_err() || session.operator.is_interrupted() {
                    // Without a link the stop cannot arrive; the device ends the motion by itself and holds.
                    let _ = session.client.request(Request::Stop);
                }
                if session.operator.is_interrupted() {
                    return Err(BringupError::Interrupted { step: step.name() });
                }
                step_report?
            }
        };
        report.steps.push(step_report);
    }
    let _ = session.client.request(Request::Stop);
    report.passed =
        !report.steps.iter().any(|report| matches!(report.result, StepResult::Failed | StepResult::Blocked));
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

/// One step; `moved` are the moves of the loop's step, for the force's.
fn carry_out(step: Step, session: &mut Session, moved: &mut Option<Moves>) -> Result<StepReport, LinkError> {
    let mut report = StepReport::new(step);
    if matches!(step, Step::Motors | Step::Loop) {
        if let Some(fault) = session.clear()? {
            report.find(of_fault(fault));
            return Ok(report);
        }
        if !session.operator.confirm(Prompt::Allow(step)) {
            return Ok(StepReport::without(step, StepResult::Skipped, "motion was not allowed".to_owned()));
        }
        session.acknowledge()?;
    }
    match step {
        Step::Link => wires::link(session, &mut report)?,
        Step::Supply => wires::supply(session, &mut report)?,
        Step::EmergencyStop => return stop::run(session, report),
        Step::Converter => rest::converter(session, &mut report)?,
        Step::Potentiometers => rest::potentiometers(session, &mut report)?,
        Step::Motors => pulses::run(session, &mut report)?,
        Step::Loop => *moved = moves::run(session, &mut report)?,
        // It has been stored before: the device is another one since.
        Step::Store => {}
        Step::Force => match moved.take() {
            Some(done) => moves::force(&done, &mut report),
            None => {
                let because = "it evaluates the moves of `loop`, which did not run".to_owned();
                return Ok(StepReport::without(step, StepResult::Skipped, because));
            }
        },
    }
    Ok(report)
}

#[cfg(test)]
mod tests {
    use super::*;
    use fake_device::{FakeDevice, Script};
    use std::io;
    use std::time::Duration;

    /// Nobody: allows everything and never interrupts.
    struct Nobody;

    impl Operator for Nobody {
        fn confirm(&mut self, _: Prompt) -> bool {
            true
        }

        fn begins(&mut self, _: Step, _: &Report) -> io::Result<()> {
            Ok(())
        }

        fn is_interrupted(&self) -> bool {
            false
        }

        fn clock(&mut self) -> Option<Duration> {
            None
        }
    }

    /// This one answers, and streams nothing outside programs.
    #[test]
    fn a_device_that_sends_nothing_is_not_awaited_for_minutes() {
        let device = FakeDevice::start(Script::default());
        let outcome = run(&device.port, &[Step::Link], &[], None, &mut Nobody);
        assert!(matches!(outcome, Err(BringupError::Link(LinkError::Silent { .. }))), "{outcome:?}");
    }
}
