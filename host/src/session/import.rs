//! Recordings of others as parts of a session.
//!
//! `trajcontrol`: the CSV files of a needle under a laterally actuated guide with an electromagnetic tip sensor, as its ROS nodes
//! write them. Tip position in millimetres with the insertion along `-y`; guide position in metres; a sensor that has nothing to
//! say writes zeros.
//!
//! [`slicer`] and [`poses`]: a needle's shape as points in space, from 3D Slicer and from shape-sensing fibres; [`Frame`] makes them
//! positions along the needle and deflections.

mod frame;
mod poses;
mod slicer;

pub use frame::{Axis, Frame, FrameError, NeedlePoints, Straight, name_of};
pub use poses::{LengthUnit, poses};
pub use slicer::slicer;

use super::InsertionRun;
use super::error::{Place, Problem, SessionError, read_text};
use super::table::{Column, Table};
use std::path::Path;

const MM: f64 = 1e-3;
const TIP_MM: [f64; 2] = [-2000.0, 2000.0];
const ROBOT_M: [f64; 2] = [-2.0, 2.0];

const COLUMNS: [Column; 7] = [
    Column::required("Timestamp sec", 1.0, [0.0, 1e11]),
    Column::required("Timestamp nanosec", 1e-9, [0.0, 1e9]),
    Column::required("Tip x", MM, TIP_MM),
    Column::required("Tip y", MM, TIP_MM),
    Column::required("Tip z", MM, TIP_MM),
    Column::optional("Robot x", 1.0, ROBOT_M),
    Column::optional("Robot z", 1.0, ROBOT_M),
];

/// Reads one recording. The insertion is named after its file; positions are relative to the guide's first one, guide positions
/// too; rows in which the tip sensor was silent are left out, and so is a last line that was cut off. Rest, retraction and early
/// ends are kept as they are: who uses the insertion decides.
///
/// # Errors
/// [`SessionError`] with file, line, column and field.
pub fn trajcontrol(path: &Path) -> Result<InsertionRun, SessionError> {
    let text = read_text(path)?;
    let mut table = Table::parse(path, whole_lines(&text), &COLUMNS, 1)?;
    let mut column = |name: &str| table.take(name).unwrap_or_default();
    let (seconds, nanoseconds) = (column("Timestamp sec"), column("Timestamp nanosec"));
    let tip = [column("Tip x"), column("Tip y"), column("Tip z")];
    let robot = [column("Robot x"), column("Robot z")];
    let at = |values: &[f64], i: usize| values.get(i).copied().unwrap_or_default();

    let mut run = InsertionRun {
        id: path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default(),
        path: path.to_owned(),
        depth_m: Vec::new(),
        tip_y_m: Vec::new(),
        tip_x_m: None,
        time_s: None,
        rotation_rad: None,
        guide2_y_m: None,
        guide2_x_m: None,
        base_force_y_n: None,
    };
    let (mut tip_x_m, mut time_s, mut guide2_x_m, mut guide2_y_m) = (vec![], vec![], vec![], vec![]);
    // The guide's first position is where the straight needle points; before it has one, it has not moved.
    let heard = |i: usize| robot.iter().any(|values| at(values, i) != 0.0);
    let first = (0..seconds.len()).find(|i| heard(*i));
    let [zero_x_m, zero_z_m] = [0, 1].map(|side| first.map_or(0.0, |i| at(&robot[side], i)));
    let mut last = [zero_x_m, zero_z_m];
    let mut start_s = None;
    for i in 0..seconds.len() {
        if heard(i) {
            last = [at(&robot[0], i), at(&robot[1], i)];
        }
        if tip.iter().all(|values| at(values, i) == 0.0) {
            continue;
        }
        // Whole seconds since 1970 lose nothing next to nanoseconds when the start is taken off first.
        let start = *start_s.get_or_insert([at(&seconds, i), at(&nanoseconds, i)]);
        time_s.push(at(&seconds, i) - start[0] + at(&nanoseconds, i) - start[1]);
        run.depth_m.push(-at(&tip[1], i));
        tip_x_m.push(at(&tip[0], i) - zero_x_m);
        run.tip_y_m.push(at(&tip[2], i) - zero_z_m);
        guide2_x_m.push(last[0] - zero_x_m);
        guide2_y_m.push(last[1] - zero_z_m);
    }
    if run.depth_m.is_empty() {
        return Err(SessionError::Field {
            place: Place { path: path.to_owned(), line: 1, column: 1 },
            field: "Tip x, Tip y, Tip z".to_owned(),
            problem: Problem::NoRows,
            expected: "at least one row in which the tip sensor is not silent (0, 0, 0)".to_owned(),
        });
    }
    run.tip_x_m = Some(tip_x_m);
    run.time_s = Some(time_s);
    if first.is_some() {
        run.guide2_x_m = Some(guide2_x_m);
        run.guide2_y_m = Some(guide2_y_m);
    }
    Ok(run)
}

/// The text without a last line that has fewer cells than the header: a recording that was cut off.
fn whole_lines(text: &str) -> &str {
    let cells = |line: &str| line.matches(',').count();
    match text.trim_end_matches('\n').rfind('\n') {
        Some(newline) if !text.ends_with('\n') => {
            let (before, last) = text.split_at(newline + 1);
            let header = before.lines().next().unwrap_or_default();
            if cells(last) < cells(header) { before } else { text }
        }
        _ => text,
    }
}

#[cfg(test)]
mod shape_tests;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inference::insertion::TipPath;
    use std::fmt::Write as _;
    use std::fs;

    const HEADER: &str =
        "Timestamp sec,Timestamp nanosec, Target sec,Tip x,Tip y,Tip z,Tip qw,Robot x,Robot z, Robot sec";

    /// Rows of time, tip and robot; made up, in the layout of the recordings.
    fn read(rows: &str) -> Result<InsertionRun, SessionError> {
        let dir = tempfile::tempdir().expect("a folder");
        let path = dir.path().join("run_1.csv");
        fs::write(&path, format!("{HEADER}\n{rows}")).expect("writes");
        trajcontrol(&path)
    }

    #[test]
    fn silent_rows_and_cut_lines_are_left_out() {
        let run = read(
            "1700000000,900000000,0,0,0,0,0,0,0,0\n\
             1700000001,400000000,0,-25.5,2.0,22.5,0.7,-0.025,0.022,1\n\
             1700000001,900000000,0,-25.0,-10.0,22.0,0.7,-0.024,0.0215,1\n\
             1700000002,400000000,0,-24.0,-10",
        )
        .expect("reads");
        assert_eq!(run.id, "run_1");
        let close =
            |a: &[f64], b: &[f64]| a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12);
        assert!(close(&run.depth_m, &[-2e-3, 10e-3]), "{:?}", run.depth_m);
        assert!(close(run.tip_x_m.as_deref().expect("x"), &[-0.5e-3, 0.0]));
        assert!(close(&run.tip_y_m, &[0.5e-3, 0.0]));
        assert!(close(run.guide2_x_m.as_deref().expect("guide"), &[0.0, 1e-3]));
        assert!(close(run.guide2_y_m.as_deref().expect("guide"), &[0.0, -0.5e-3]));
        let time_s = run.time_s.expect("time");
        assert!((time_s[1] - 0.5).abs() < 1e-6 && time_s[0] == 0.0);
    }

    #[test]
    fn faults_name_place_and_what_was_expected() {
        let message =
            |rows: &str| read(rows).map(|_| ()).map_err(|error| error.to_string()).expect_err("fails");
        assert!(
            message("1,0,0,1,oops,3,0,0,0,0\n").contains("run_1.csv:2:9: Tip y: \"oops\" is not a number")
        );
        assert!(
            message("1,0,0,0,0,0,0,0.1,0.1,0\n")
                .contains("expected at least one row in which the tip sensor")
        );
        assert!(message("").contains("no rows, expected at least one row"));
    }

    /// Rest rows, retraction at the end and an early end do not keep an insertion from being one.
    #[test]
    fn rest_and_retraction_are_no_fault() {
        let mut rows = String::new();
        let mut row = |depth: f64| {
            let _ =
                writeln!(rows, "{},0,0,{},{},20,0.7,-0.02,0.02,0", rows_time(depth), 0.01 * depth, -depth);
        };
        for stop in 0..=12 {
            (0..4).for_each(|_| row(5.0 * f64::from(stop)));
        }
        (0..20).for_each(|i| row(60.0 - 3.0 * f64::from(i)));
        let path = TipPath::new(&read(&rows).expect("reads")).expect("an insertion");
        assert!((path.deepest_m - 0.06).abs() < 1e-12);
        assert_eq!(path.bins.len(), 14, "13 stops, and one row just behind the last");
        assert!(path.rows_left_out >= 18);
    }

    fn rows_time(depth: f64) -> i64 {
        1_700_000_000 + depth as i64
    }
}
