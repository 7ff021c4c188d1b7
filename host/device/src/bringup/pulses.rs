//! Single short pulses of each motor, and the response of both potentiometers and both force channels.
//!
//! The needle presses back against the guide, so that the force shows the true motion. It separates cases that the
//! potentiometers alone cannot separate: reversed leads (guide and potentiometer moved in the wrong direction) from a reversed
//! potentiometer (only the reading did), and swapped motors from swapped potentiometers. Without a needle both findings remain.

use super::findings::{Finding, of_fault};
use super::report::StepReport;
use super::session::{POLL_INTERVAL, Session};
use crate::link::silence::Silence;
use crate::link::{LinkError, Telemetry};
use protocol::{
    EventKind, PULSE_DUTY_LIMIT_PERMILLE, PULSE_LIMIT_MS, PulseOutcome, PulseReport, Refusal, Request,
};
use std::time::{Duration, Instant};

/// Mean motion that is one, micrometres: ten times the noise of a mean of 20 readings, a third of what the weakest unit makes.
const MOVED_UM: f64 = 40.0;
/// Change of force that answers a motion, newtons: four times the noise of the mean over two pulses.
const ANSWERED_N: f64 = 5e-3;
/// Time for which an event is awaited, by the host's clock.
const EVENT_TIMEOUT: Duration = Duration::from_secs(20);

/// Results of the pulses of one motor, up and down.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Tried {
    /// Motion of x and y, micrometres, in the pulse upwards and downwards.
    moved_um: [[f64; 2]; 2],
    /// Change of force along x and y, newtons.
    force_n: [[f64; 2]; 2],
    /// A force ended one of them.
    pressed: bool,
}

impl Tried {
    /// This axis' motion where the drive is counted as upwards, mean of both directions; a direction without motion does not count.
    fn along_um(&self, axis: usize) -> f64 {
        mean_of(self.moved_um[0][axis], -self.moved_um[1][axis], MOVED_UM)
    }

    fn answer_n(&self, axis: usize) -> f64 {
        0.5 * (self.force_n[0][axis] - self.force_n[1][axis])
    }
}

/// Mean of two values of which one may be missing, being too small.
fn mean_of(up: f64, down: f64, least: f64) -> f64 {
    match (up.abs() >= least, down.abs() >= least) {
        (true, false) => up,
        (false, true) => down,
        _ => 0.5 * (up + down),
    }
}

pub(super) fn run(session: &mut Session, report: &mut StepReport) -> Result<(), LinkError> {
    let mut motors = Vec::new();
    for axis in 0..2 {
        match both_ways(session, axis)? {
            Ok(outcome) => motors.push(outcome),
            Err(finding) => {
                report.find(finding);
                return Ok(());
            }
        }
    }
    if let [x, y] = motors.as_slice() {
        for (name, motors) in [("x", x), ("y", y)] {
            for (way, moved_um) in ["up", "down"].iter().zip(motors.moved_um) {
                report.measure(format!("pulse_{name}_{way}_moves_x_mm"), 1e-3 * moved_um[0]);
                report.measure(format!("pulse_{name}_{way}_moves_y_mm"), 1e-3 * moved_um[1]);
            }
        }
        judge([*x, *y], report);
    }
    Ok(())
}

/// A pulse up and one down; a finding where the device refuses. One that a bring-up before this has interrupted between both leaves the
/// first direction used up: then the other is tried first.
fn both_ways(session: &mut Session, axis: usize) -> Result<Result<Tried, Finding>, LinkError> {
    let mut motor = Tried { moved_um: [[0.0; 2]; 2], force_n: [[0.0; 2]; 2], pressed: false };
    let mut pending = vec![(0, 1), (1, -1)];
    let mut refused = 0;
    while let Some((direction, sign)) = pending.first().copied() {
        pending.remove(0);
        let Some(pulse) = one(session, axis, sign)? else {
            refused += 1;
            let fault = session.client.status()?.fault;
            if fault.is_none() && refused == 1 {
                pending.push((direction, sign));
                continue;
            }
            return Ok(Err(fault.map_or_else(|| {
                let measured =
                    "a pulse would leave the travel, or earlier pulses have used up what is allowed in this direction".to_owned();
                Finding::new("potentiometer.off_middle", Some(axis), measured)
            }, of_fault)));
        };
        motor.moved_um[direction] = session.client.displacement_m(pulse.moved_counts).map(|m| 1e6 * m);
        motor.force_n[direction] = session.client.force_n(pulse.force_counts);
        motor.pressed |= pulse.outcome == PulseOutcome::Force;
    }
    Ok(Ok(motor))
}

/// One pulse; `None` where it was refused or a fault ended it.
fn one(session: &mut Session, axis: usize, sign: i16) -> Result<Option<PulseReport>, LinkError> {
    let request = Request::Pulse {
        axis: axis as u8,
        duty_permille: sign * PULSE_DUTY_LIMIT_PERMILLE as i16,
        duration_ms: PULSE_LIMIT_MS,
    };
    while session.client.waiting().is_some() {}
    match session.client.request(request) {
        Ok(()) => {}
        Err(LinkError::Refused { refusal: Refusal::OutOfTravel | Refusal::Faulted { .. }, .. }) => {
            return Ok(None);
        }
        Err(error) => return Err(error),
    }
    let (deadline, mut silence) = (Instant::now() + EVENT_TIMEOUT, Silence::default());
    while Instant::now() < deadline && !session.operator.is_interrupted() {
        // The device may have restarted and be silent: the question finds out.
        session.client.request_status()?;
        if let Some(Telemetry::Event(event)) = silence.next(&mut session.client, POLL_INTERVAL)?
            && let EventKind::PulseEnded(report) = event.kind
        {
            session.at_rest()?;
            return Ok((report.outcome != PulseOutcome::Stopped).then_some(report));
        }
    }
    // The event was lost on the way: its content is not known.
    session.at_rest()?;
    Err(session.silent())
}

fn judge(tried: [Tried; 2], report: &mut StepReport) {
    if swapped(&tried, report) {
        return;
    }
    // A needle that answers the other axis is mounted: a guide that moves meets it.
    let is_mounted = [1, 0].map(|other: usize| tried[other].answer_n(other).abs() > ANSWERED_N);
    for (axis, tried) in tried.iter().enumerate() {
        let [first_um, second_um] = tried.moved_um.map(|moved_um| moved_um[axis]);
        let moves = [first_um.abs() >= MOVED_UM, second_um.abs() >= MOVED_UM];
        let axis_um = tried.along_um(axis);
        let answer_n = tried.answer_n(axis);
        let measured = format!(
            "up {:+.3} mm, down {:+.3} mm, force {:+.1} mN for upwards",
            1e-3 * first_um,
            1e-3 * second_um,
            1e3 * answer_n
        );
        fn finding(id: &'static str, axis: usize, measured: &str) -> Finding {
            Finding::new(id, Some(axis), measured.to_owned())
        }
        match moves {
            [false, false] if tried.pressed => report.find(finding("motor.presses", axis, &measured)),
            [false, false] if answer_n.abs() > ANSWERED_N => {
                report.find(finding("potentiometer.stuck", axis, &measured))
            }
            [false, false] if is_mounted[axis] => {
                report.find(finding("motor.does_not_move", axis, &measured))
            }
            [false, false] => {
                report.find(finding("motor.does_not_move", axis, &measured).or("potentiometer.stuck"))
            }
            [false, true] if axis_um > 0.0 => report.find(finding("motor.dead_up", axis, &measured)),
            [true, false] if axis_um > 0.0 => report.find(finding("motor.dead_down", axis, &measured)),
            // The bridge's other half, where the leads are reversed as well.
            [false, true] | [true, false] => {
                report.find(
                    finding("motor.leads_reversed", axis, &measured)
                        .or("motor.dead_up")
                        .or("motor.dead_down"),
                );
            }
            [true, true] if axis_um > 0.0 => {}
            [true, true] if answer_n > ANSWERED_N => {
                report.find(finding("potentiometer.reversed", axis, &measured))
            }
            [true, true] if answer_n < -ANSWERED_N => {
                report.find(finding("motor.leads_reversed", axis, &measured))
            }
            [true, true] => {
                report.find(finding("motor.leads_reversed", axis, &measured).or("potentiometer.reversed"))
            }
        }
    }
}

/// Each drive moves the other axis' potentiometer.
fn swapped([x, y]: &[Tried; 2], report: &mut StepReport) -> bool {
    fn other(tried: &Tried, axis: usize) -> bool {
        tried.along_um(1 - axis).abs() > MOVED_UM && tried.along_um(axis).abs() < MOVED_UM
    }
    if !(other(x, 0) && other(y, 1)) {
        return false;
    }
    let measured = format!(
        "driving x moves y by {:+.3} mm, driving y moves x by {:+.3} mm",
        1e-3 * x.along_um(1),
        1e-3 * y.along_um(0)
    );
    // The force of the driven axis answers where only the readings are swapped.
    let same_axis_n = x.answer_n(0).abs() + y.answer_n(1).abs();
    let cross_axis_n = x.answer_n(1).abs() + y.answer_n(0).abs();
    fn finding(id: &'static str, measured: &str) -> Finding {
        Finding::new(id, None, measured.to_owned())
    }
    report.find(if same_axis_n > 2.0 * cross_axis_n && same_axis_n > ANSWERED_N {
        finding("potentiometer.swapped", &measured)
    } else if cross_axis_n > 2.0 * same_axis_n && cross_axis_n > ANSWERED_N {
        finding("motor.swapped", &measured)
    } else {
        finding("motor.swapped", &measured).or("potentiometer.swapped")
    });
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bringup::Step;

    /// Interpretation of the pulses of a motor: potentiometer and force matrices of what really moves, micrometres and
    /// newtons for upwards.
    fn tried(moved_um: [f64; 2], force_n: [f64; 2]) -> Tried {
        fn down(up: [f64; 2]) -> [f64; 2] {
            up.map(|value| -value)
        }
        Tried { moved_um: [moved_um, down(moved_um)], force_n: [force_n, down(force_n)], pressed: false }
    }

    const X: Tried = Tried {
        moved_um: [[160.0, 2.0], [-150.0, -1.0]],
        force_n: [[0.06, 0.001], [-0.05, 0.0]],
        pressed: false,
    };

    fn found(y: Tried) -> Vec<(&'static str, usize)> {
        let mut report = StepReport::new(Step::Motors);
        judge([X, y], &mut report);
        report.findings.iter().map(|finding| (finding.id, finding.or_else.len())).collect()
    }

    #[test]
    fn signs_of_motion_and_force_name_what_is_reversed() {
        assert!(found(tried([0.0, 150.0], [0.0, 0.06])).is_empty());
        assert_eq!(found(tried([0.0, -150.0], [0.0, -0.06])), [("motor.leads_reversed", 0)]);
        assert_eq!(found(tried([0.0, -150.0], [0.0, 0.06])), [("potentiometer.reversed", 0)]);
        assert_eq!(found(tried([0.0, -150.0], [0.0, 0.001])), [("motor.leads_reversed", 1)]);
        assert_eq!(found(tried([0.0, 3.0], [0.0, 0.06])), [("potentiometer.stuck", 0)]);
        assert_eq!(found(tried([0.0, 3.0], [0.0, 0.0])), [("motor.does_not_move", 0)]);
        fn bare(moved_um: [f64; 2]) -> Tried {
            tried(moved_um, [0.0; 2])
        }
        let mut report = StepReport::new(Step::Motors);
        judge([bare([150.0, 0.0]), bare([0.0, 3.0])], &mut report);
        assert_eq!(report.findings[0].or_else, ["potentiometer.stuck"], "no needle is mounted");
    }

    #[test]
    fn a_dead_half_bridge_is_named_by_its_direction() {
        let mut dead = tried([0.0, 150.0], [0.0, 0.06]);
        dead.moved_um[0] = [0.0; 2];
        assert_eq!(found(dead), [("motor.dead_up", 0)]);
        let mut dead = tried([0.0, 150.0], [0.0, 0.06]);
        dead.moved_um[1] = [0.0; 2];
        assert_eq!(found(dead), [("motor.dead_down", 0)]);
    }

    #[test]
    fn the_force_separates_swapped_motors_from_swapped_potentiometers() {
        fn judged(x: Tried, y: Tried) -> Vec<(&'static str, usize)> {
            let mut report = StepReport::new(Step::Motors);
            judge([x, y], &mut report);
            report.findings.iter().map(|finding| (finding.id, finding.or_else.len())).collect::<Vec<_>>()
        }
        fn motors(force_n: f64) -> Vec<(&'static str, usize)> {
            judged(tried([0.0, 150.0], [0.0, force_n]), tried([150.0, 0.0], [force_n, 0.0]))
        }
        assert_eq!(motors(0.06), [("motor.swapped", 0)]);
        assert_eq!(motors(0.0), [("motor.swapped", 1)]);
        let readings = judged(tried([0.0, 150.0], [0.06, 0.0]), tried([150.0, 0.0], [0.0, 0.06]));
        assert_eq!(readings, [("potentiometer.swapped", 0)]);
    }
}
