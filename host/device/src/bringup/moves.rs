//! The position loop in small moves, and the force channels against them.
//!
//! A needle of round section presses back equally in every direction: the matrix of force against motion has to be one
//! number times the unit matrix. The measured difference names the fault of the force channels.

use super::findings::Finding;
use super::report::StepReport;
use super::session::Session;
use crate::link::error::explain_fault;
use crate::link::program::PlannedStep;
use crate::link::{Batch, LinkError, Point, Program, RunOptions, Telemetry, run as run_program};
use protocol::Step as DeviceStep;
use std::sync::atomic::AtomicBool;

/// Amplitude of the moves, micrometres, and their speed, micrometres per second.
const MOVE_UM: i32 = 800;
const SPEED_UM_S: u32 = 2_000;
/// Hold after each move, milliseconds.
const HOLD_MS: u32 = 400;
/// Largest error at rest that the loop has by its design, metres (it re-engages at 45 um), and overshoot.
const SETTLED_M: f64 = 60e-6;
const OVERSHOOT_M: f64 = 150e-6;
/// Stiffness below which no needle is mounted, newtons per metre.
const LEAST_N_PER_M: f64 = 20.0;
/// Share of the stiffness that counts as another fault than the tolerance of cell and mounting.
const TOLERANCE: f64 = 0.06;
/// Share by which the gains of a cell's channels may differ.
const GAIN_TOLERANCE: f64 = 0.15;

/// Force of x and y (rows) per motion along x and y (columns), newtons per metre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Moves {
    matrix_n_per_m: [[f64; 2]; 2],
}

/// Readings of one hold.
#[derive(Debug, Clone, Copy, Default)]
struct Held {
    time_s: f64,
    position_m: [f64; 2],
    force_n: [f64; 2],
    count: f64,
}

impl Held {
    fn add(&mut self, point: &Point) {
        let Point { time_s, displacement_m: position_m, force_n, .. } = *point;
        self.count += 1.0;
        self.time_s += (time_s - self.time_s) / self.count;
        for axis in 0..2 {
            self.position_m[axis] += (position_m[axis] - self.position_m[axis]) / self.count;
            self.force_n[axis] += (force_n[axis] - self.force_n[axis]) / self.count;
        }
    }
}

/// The moves of both axes; nothing where they could not be made.
pub(super) fn run(session: &mut Session, report: &mut StepReport) -> Result<Option<Moves>, LinkError> {
    let mut matrix_n_per_m = [[0.0; 2]; 2];
    for axis in 0..2 {
        let Some(hold_readings) = axis_moves(session, axis, report)? else { return Ok(None) };
        for (force, row) in matrix_n_per_m.iter_mut().enumerate() {
            row[axis] = stiffness(&hold_readings, axis, force);
        }
    }
    Ok(Some(Moves { matrix_n_per_m }))
}

/// Up, down and back along an axis: the holds above, below and back. Empty if a fault ended it; the fault is a
/// finding.
fn axis_moves(
    session: &mut Session,
    axis: usize,
    report: &mut StepReport,
) -> Result<Option<[Held; 3]>, LinkError> {
    let home_m =
        session.client.status().map(|status| session.client.displacement_m(status.position_counts))?;
    let home_um = home_m.map(|m| (1e6 * m).round() as i32);
    fn target(by_um: i32, home_um: &[i32; 2], axis: usize) -> [i32; 2] {
        let mut target_um = *home_um;
        target_um[axis] += by_um;
        target_um
    }
    let targets_um = [target(MOVE_UM, &home_um, axis), target(-MOVE_UM, &home_um, axis), home_um];
    let name = ["x", "y"][axis];
    let steps = targets_um.into_iter().flat_map(|[x_um, y_um]| {
        [DeviceStep::Move { x_um, y_um, speed_um_s: SPEED_UM_S }, DeviceStep::Hold { duration_ms: HOLD_MS }]
    });
    let steps = steps.map(|step| PlannedStep { step, sweep: false }).collect();
    let program = Program { name: format!("moves along {name}"), steps };
    let mut hold_readings = [Held::default(); 3];
    let mut furthest_m = [0.0_f64; 3];
    let mut observe = |step: u8, point: &Point| {
        let (turn, is_hold) = (usize::from(step) / 2, step % 2 == 1);
        let direction = [1.0, -1.0, home_um[axis].signum().into()][turn.min(2)];
        let overshoot_m =
            direction * (point.displacement_m[axis] - 1e-6 * f64::from(targets_um[turn.min(2)][axis]));
        if turn < 2 {
            furthest_m[turn] = furthest_m[turn].max(overshoot_m);
        }
        if is_hold && turn < 3 {
            hold_readings[turn].add(point);
        }
    };
    while session.client.waiting().is_some() {}
    let Session { client, operator, .. } = session;
    // The operator has the interrupt, and is requested for it with everything that arrives.
    let options = RunOptions { start_us: None, stream: true, interrupted: &AtomicBool::new(false) };
    let outcome = run_program(client, &program, options, |_, telemetry| {
        if let Telemetry::Samples(Batch { step: Some(step), points, .. }) = telemetry {
            points.iter().for_each(|point| observe(*step, point));
        }
        if operator.is_interrupted() { Err(LinkError::Interrupted) } else { Ok(()) }
    });
    match outcome {
        Ok(()) => {}
        Err(LinkError::ProgramEnded { fault }) => {
            let measured = fault.map_or_else(|| "the program ended early".to_owned(), explain_fault);
            report.find(Finding::new("loop.fault", Some(axis), measured));
            return Ok(None);
        }
        Err(error) => return Err(error),
    }
    let [first, second, third] = hold_readings;
    let error_m = [(first, targets_um[0]), (second, targets_um[1])]
        .map(|(hold_readings, target_um)| hold_readings.position_m[axis] - 1e-6 * f64::from(target_um[axis]));
    let worst_m = error_m.into_iter().map(f64::abs).fold(0.0, f64::max);
    let overshoot_m = furthest_m[0].max(furthest_m[1]);
    report.measure(format!("error_at_rest_{name}_mm"), 1e3 * worst_m);
    report.measure(format!("overshoot_{name}_mm"), 1e3 * overshoot_m);
    if worst_m > SETTLED_M || overshoot_m > OVERSHOOT_M {
        let measured =
            format!("{:.3} mm off at rest, {:.3} mm beyond the target", 1e3 * worst_m, 1e3 * overshoot_m);
        report.find(Finding::new("loop.inaccurate", Some(axis), measured));
    }
    if hold_readings.iter().any(|hold_readings| hold_readings.count < 50.0)
        || (first.position_m[axis] - second.position_m[axis]).abs() < 0.5e-3
    {
        let measured = format!(
            "{:.0}, {:.0} and {:.0} samples of the holds arrived",
            first.count, second.count, third.count
        );
        report.find(Finding::new("link.lossy", None, measured));
        return Ok(None);
    }
    Ok(Some(hold_readings))
}

/// Change of a force per motion along an axis, newtons per metre: of the plane in position and time through three holds, so that a drift of
/// the force does not count.
fn stiffness([up, down, back]: &[Held; 3], axis: usize, force: usize) -> f64 {
    let from_up = |held: &Held| {
        let (moved_m, force_n) =
            (held.position_m[axis] - up.position_m[axis], held.force_n[force] - up.force_n[force]);
        (moved_m, held.time_s - up.time_s, force_n)
    };
    let ((second_m, second_s, second_n), (third_m, third_s, third_n)) = (from_up(down), from_up(back));
    (second_n * third_s - third_n * second_s) / (second_m * third_s - third_m * second_s)
}

pub(super) fn force(moves: &Moves, report: &mut StepReport) {
    let m = moves.matrix_n_per_m;
    for (row, force) in m.iter().zip(["x", "y"]) {
        for (value, motion) in row.iter().zip(["x", "y"]) {
            report.measure(format!("force_{force}_per_{motion}_n_per_mm"), 1e-3 * value);
        }
    }
    let [[xx, xy], [yx, yy]] = m;
    let text = format!(
        "force x {:+.3} and y {:+.3} N/mm along x, x {:+.3} and y {:+.3} N/mm along y",
        1e-3 * xx,
        1e-3 * yx,
        1e-3 * xy,
        1e-3 * yy
    );
    for (id, axis) in classify(m) {
        report.find(Finding::new(id, axis, text.clone()));
    }
}

/// Faults of the force channels that a matrix of force against motion implies.
fn classify(m: [[f64; 2]; 2]) -> Vec<(&'static str, Option<usize>)> {
    let [x, y] = m.map(|row| row[0].hypot(row[1]));
    let stiffness = x.max(y);
    if stiffness < LEAST_N_PER_M {
        return vec![("force.no_response", None)];
    }
    if let Some(axis) = [x, y].iter().position(|row| *row < 0.1 * stiffness) {
        return vec![("force.dead", Some(axis))];
    }
    let [[xx, xy], [yx, yy]] = m;
    if xy.abs() > 3.0 * xx.abs() && yx.abs() > 3.0 * yy.abs() {
        return vec![("force.swapped", None)];
    }
    let mut faults = Vec::new();
    // Signs first: what is left is judged as if they were right.
    let signs = [xx, yy].map(|own| if own < 0.0 { -1.0 } else { 1.0 });
    for (axis, sign) in signs.iter().enumerate() {
        if *sign < 0.0 {
            faults.push(("force.sign", Some(axis)));
        }
    }
    let (diagonal, xy, yx) = ([xx * signs[0], yy * signs[1]], xy * signs[0], yx * signs[1]);
    let scale = 0.5 * (diagonal[0] + diagonal[1]);
    let (rotation, common) = (0.5 * (yx - xy), 0.5 * (yx + xy));
    if rotation.abs() > TOLERANCE * scale && common.abs() < 0.4 * rotation.abs() {
        faults.push(("force.turned", None));
    } else if xy.abs().max(yx.abs()) > TOLERANCE * scale {
        faults.push(("force.crosstalk", Some(usize::from(yx.abs() > xy.abs()))));
    }
    let ratio = diagonal[0] / diagonal[1];
    if !(1.0 - GAIN_TOLERANCE..=1.0 / (1.0 - GAIN_TOLERANCE)).contains(&ratio) {
        faults.push(("force.gain", None));
    }
    faults
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The matrix of a needle of 400 N/m behind a cell that does this to forces along x and y.
    fn behind(cell: [[f64; 2]; 2]) -> Vec<(&'static str, Option<usize>)> {
        classify(cell.map(|row| row.map(|value| 400.0 * value)))
    }

    #[test]
    fn a_drift_is_no_stiffness() {
        let hold_readings = [(0.0, 8e-4), (1.2, -8e-4), (2.3, 1e-5)].map(|(time_s, at_m)| {
            let force_n = [0.1 * time_s, 400.0 * at_m + 0.1 * time_s - 0.3];
            Held { time_s, position_m: [0.0, at_m], force_n, count: 400.0 }
        });
        assert!(
            stiffness(&hold_readings, 1, 0).abs() < 1e-9
                && (stiffness(&hold_readings, 1, 1) - 400.0).abs() < 1e-9
        );
    }

    #[test]
    fn the_matrix_names_what_the_cell_does() {
        assert!(behind([[1.02, 0.02], [-0.03, 0.97]]).is_empty());
        assert_eq!(behind([[0.0, 1.0], [1.0, 0.0]]), [("force.swapped", None)]);
        assert_eq!(behind([[1.0, 0.0], [0.0, -1.0]]), [("force.sign", Some(1))]);
        assert_eq!(behind([[1.0, 0.12], [0.0, 1.0]]), [("force.crosstalk", Some(0))]);
        assert_eq!(behind([[1.0, 0.0], [-0.3, 1.0]]), [("force.crosstalk", Some(1))]);
        assert_eq!(behind([[1.0, 0.0], [0.0, 0.75]]), [("force.gain", None)]);
        assert_eq!(behind([[0.0, 0.01], [0.0, 1.0]]), [("force.dead", Some(0))]);
        assert_eq!(behind([[0.01, 0.0], [0.0, 0.01]]), [("force.no_response", None)]);
        for degrees in [6.0_f64, -20.0, 40.0] {
            let (sin, cos) = degrees.to_radians().sin_cos();
            assert_eq!(behind([[cos, -sin], [sin, cos]]), [("force.turned", None)], "{degrees}");
        }
    }
}
