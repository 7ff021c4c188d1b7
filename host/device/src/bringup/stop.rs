//! The emergency stop, pressed and released by hand.

use super::findings::Finding;
use super::report::{StepReport, StepResult};
use super::session::Session;
use super::{Prompt, Step};
use crate::link::LinkError;
use protocol::Fault;

/// Delay between the operator's action and the reading of the line, seconds of the device.
const SETTLE_S: f64 = 0.2;

/// The line is at stop; `None` where another fault is latched, behind which the line is not reported.
fn stops(session: &mut Session) -> Result<Option<bool>, LinkError> {
    session.wait(SETTLE_S)?;
    Ok(match session.clear()? {
        None => Some(false),
        Some(Fault::EmergencyStop) => Some(true),
        Some(_) => None,
    })
}

pub(super) fn run(session: &mut Session, mut report: StepReport) -> Result<StepReport, LinkError> {
    let Some(released) = stops(session)? else {
        let because = "another fault is latched, which hides the line: clear that first".to_owned();
        return Ok(StepReport::without(Step::EmergencyStop, StepResult::Skipped, because));
    };
    let is_pressed = session.operator.confirm(Prompt::PressStop);
    if !is_pressed && !released {
        let because = "the emergency stop was not pressed: it is untested".to_owned();
        return Ok(StepReport::without(Step::EmergencyStop, StepResult::Skipped, because));
    }
    let pressed = if is_pressed { stops(session)? } else { None };
    let again =
        if is_pressed && session.operator.confirm(Prompt::ReleaseStop) { stops(session)? } else { None };
    fn level(stops: bool) -> &'static str {
        if stops { "stop" } else { "run" }
    }
    let measured = format!(
        "line released: {}, pressed: {}",
        level(again.unwrap_or(released)),
        pressed.map_or("not tried", level)
    );
    match (released, pressed, again) {
        (false, Some(true), None | Some(false)) => {}
        (false, Some(true), Some(true)) => report.find(Finding::new("stop.stays", None, measured)),
        (false, _, _) => report.find(Finding::new("stop.not_wired", None, measured)),
        (true, Some(false), _) => report.find(Finding::new("stop.normally_open", None, measured)),
        (true, Some(true), Some(false)) => {}
        (true, Some(true), _) => report.find(Finding::new("stop.open", None, measured)),
        (true, None, _) => report.find(Finding::new("stop.open", None, measured).or("stop.normally_open")),
    }
    Ok(report)
}
