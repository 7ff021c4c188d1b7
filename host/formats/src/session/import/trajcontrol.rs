//! `trajcontrol`: the CSV files of a needle under a laterally actuated guide with an electromagnetic tip sensor, as its ROS nodes
//! write them.
//!
//! Tip position in millimetres with the insertion along `-y`, up along `z`; guide position in metres; a sensor without
//! data writes zeros. The quaternion `Tip qw, qx, qy, qz` turns the sensor's axes into those of the positions. The needle's tangent at
//! the tip, `t`, is the sensor's z axis, along which its coil is wound and lies in the needle; the slopes of the needle are then
//! `t_x / -t_y` and `t_z / -t_y`. A coil that does not lie exactly along the needle adds a constant to both.

use super::super::InsertionRun;
use super::frame::id_of;
use super::screen::{Reading, Skipped, count, screen};
use crate::document::table::{Column, Table};
use crate::document::{Place, Problem, SessionError, read_foreign_text};
use std::path::Path;

const MM: f64 = 1e-3;
const TIP_MM: [f64; 2] = [-2000.0, 2000.0];
const ROBOT_M: [f64; 2] = [-2.0, 2.0];
/// Parts of a unit quaternion, with room for rounding.
const PART: [f64; 2] = [-1.1, 1.1];
/// The square of a quaternion's norm may be off by so much.
const NORM: f64 = 0.05;
/// A needle that goes in along `-y` points there within 30 degrees.
const STEEPEST: f64 = 0.58;

const COLUMNS: [Column; 11] = [
    Column::required("Timestamp sec", 1.0, [0.0, 1e11]),
    Column::required("Timestamp nanosec", 1e-9, [0.0, 1e9]),
    Column::required("Tip x", MM, TIP_MM).blank(),
    Column::required("Tip y", MM, TIP_MM).blank(),
    Column::required("Tip z", MM, TIP_MM).blank(),
    Column::optional("Tip qw", 1.0, PART).blank(),
    Column::optional("Tip qx", 1.0, PART).blank(),
    Column::optional("Tip qy", 1.0, PART).blank(),
    Column::optional("Tip qz", 1.0, PART).blank(),
    Column::optional("Robot x", 1.0, ROBOT_M).blank(),
    Column::optional("Robot z", 1.0, ROBOT_M).blank(),
];

/// A recording of another rig, and what of it is no reading of a needle that goes in.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// The readings that are kept.
    pub run: InsertionRun,
    /// Rows that are not, by reason.
    pub skipped: Vec<Skipped>,
    /// Remarks on the import, a sentence each.
    pub remarks: Vec<String>,
}

/// Reads one recording. The insertion is named after its file; positions are relative to the guide's first one, guide positions
/// too. Rows that are no readings of a needle that goes in are skipped with a reason
/// ([`SkipReason`](super::SkipReason)), and so is a last line that was cut off; what is kept can be written into a session. Rest and an
/// early end are kept as they are: who uses the insertion decides.
///
/// # Errors
/// [`SessionError`] with file, line, column and field; also where no row is left, with the reasons.
pub fn trajcontrol(path: &Path) -> Result<Recording, SessionError> {
    let text = read_foreign_text(path)?;
    let mut table = Table::parse(path, whole_lines(&text), &COLUMNS, 1)?;
    let mut column = |name: &str| table.take(name).unwrap_or_default();
    let (seconds, nanoseconds) = (column("Timestamp sec"), column("Timestamp nanosec"));
    let tip = [column("Tip x"), column("Tip y"), column("Tip z")];
    let quaternion = ["Tip qw", "Tip qx", "Tip qy", "Tip qz"].map(&mut column);
    let robot = [column("Robot x"), column("Robot z")];
    fn value_at(values: &[f64], i: usize) -> f64 {
        values.get(i).copied().unwrap_or_default()
    }

    // The guide's first position is where the straight needle points; before it has one, it has not moved.
    let has_guide = |i: usize| {
        let values = robot.each_ref().map(|values| value_at(values, i));
        values.iter().all(|m| m.is_finite()) && values.iter().any(|m| *m != 0.0)
    };
    let first = (0..seconds.len()).find(|i| has_guide(*i));
    let [zero_x_m, zero_z_m] = [0, 1].map(|side| first.map_or(0.0, |i| value_at(&robot[side], i)));
    let mut guide_m = [zero_x_m, zero_z_m];
    let mut readings = Vec::with_capacity(seconds.len());
    for i in 0..seconds.len() {
        if has_guide(i) {
            guide_m = [value_at(&robot[0], i), value_at(&robot[1], i)];
        }
        let [x_m, y_m, z_m] = [0, 1, 2].map(|side| value_at(&tip[side], i));
        readings.push(Reading {
            tip_m: [-y_m, z_m, x_m],
            orientation: [0, 1, 2, 3].map(|part| value_at(&quaternion[part], i)),
            guide_m: [guide_m[1] - zero_z_m, guide_m[0] - zero_x_m],
        });
    }
    // Whole seconds since 1970 lose nothing next to nanoseconds when the start is taken off first.
    let time_s = |i: usize| {
        value_at(&seconds, i) - value_at(&seconds, 0)
            + (value_at(&nanoseconds, i) - value_at(&nanoseconds, 0))
    };
    if let Some(row) = (1..seconds.len()).find(|i| time_s(*i) < time_s(i - 1)) {
        let (now_s, earlier_s) = (time_s(row), time_s(row - 1));
        return Err(SessionError::Field {
            place: row_place(path, &text, row),
            field: "Timestamp sec".to_owned(),
            problem: Problem::Syntax(format!("{:.3} s before the row before", earlier_s - now_s)),
            expected: "times that never step back: was the clock set, or are two recordings joined?"
                .to_owned(),
        });
    }
    let all_readings = run(path, &readings, [zero_z_m, zero_x_m], (0..readings.len()).map(time_s).collect());
    let reasons = screen(&readings, |row| all_readings.check_row(row, path).is_ok());
    let skipped = count(&reasons);
    let mut recording =
        Recording { run: all_readings.only(|row| reasons[row].is_none()), skipped, remarks: Vec::new() };
    if recording.run.depth_m.is_empty() {
        let skipped: Vec<String> = recording.skipped.iter().map(Skipped::to_string).collect();
        return Err(SessionError::Field {
            place: Place { path: path.to_owned(), line: 1, column: 1 },
            field: "Tip x, Tip y, Tip z".to_owned(),
            problem: Problem::Syntax(format!("no row is a reading: {}", skipped.join("; "))),
            expected: "at least one row in which the tip sensor is not silent (0, 0, 0)".to_owned(),
        });
    }
    if first.is_none() {
        (recording.run.guide2_y_m, recording.run.guide2_x_m) = (None, None);
    }
    recording.direction(quaternion.iter().any(|part| !part.is_empty()));
    Ok(recording)
}

/// All readings as columns; `zero_m` is where the guide began, vertical and horizontal.
fn run(path: &Path, readings: &[Reading], zero_m: [f64; 2], mut time_s: Vec<f64>) -> InsertionRun {
    let column = |value: &dyn Fn(&Reading) -> f64| readings.iter().map(value).collect::<Vec<f64>>();
    let start_s = readings.iter().position(Reading::is_measured);
    let start_s = start_s.and_then(|first| time_s.get(first).copied()).unwrap_or_default();
    time_s.iter_mut().for_each(|time_s| *time_s -= start_s);
    InsertionRun {
        id: id_of(path),
        path: path.to_owned(),
        depth_m: column(&|r| r.tip_m[0]),
        tip_y_m: column(&|r| r.tip_m[1] - zero_m[0]),
        tip_x_m: Some(column(&|r| r.tip_m[2] - zero_m[1])),
        time_s: Some(time_s),
        guide2_y_m: Some(column(&|r| r.guide_m[0])),
        guide2_x_m: Some(column(&|r| r.guide_m[1])),
        tip_direction_y_rad: Some(column(&|r| slopes(r.orientation)[0])),
        tip_direction_x_rad: Some(column(&|r| slopes(r.orientation)[1])),
        ..InsertionRun::default()
    }
}

/// Slopes of the needle, vertical and horizontal, of a sensor turned like this; NaN where this is no turn, or the needle does not point
/// into the tissue.
fn slopes([w, x, y, z]: [f64; 4]) -> [f64; 2] {
    let square = w * w + x * x + y * y + z * z;
    // The sensor's z axis, turned: the third column of the rotation matrix, times the square of the norm.
    let tangent = [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), w * w - x * x - y * y + z * z];
    let [slope_y, slope_x] = [tangent[2] / -tangent[1], tangent[0] / -tangent[1]];
    let is_forward = tangent[1] < 0.0 && slope_y.hypot(slope_x) < STEEPEST;
    if (square - 1.0).abs() < NORM && is_forward { [slope_y, slope_x] } else { [f64::NAN; 2] }
}

impl Recording {
    /// Keeps the tip's direction where most readings have one.
    fn direction(&mut self, there: bool) {
        let rows = self.run.depth_m.len();
        let direction_count =
            self.run.tip_direction_y_rad.iter().flatten().filter(|slope| slope.is_finite()).count();
        if 2 * direction_count >= rows {
            return;
        }
        if there {
            self.remarks.push(format!(
                "tip direction skipped: the sensor's z axis is within 30 degrees of the insertion in {direction_count} of {rows} rows only"
            ));
        }
        (self.run.tip_direction_y_rad, self.run.tip_direction_x_rad) = (None, None);
    }
}

/// Position at which a row below the header begins.
fn row_place(path: &Path, text: &str, row: usize) -> Place {
    let line = text
        .lines()
        .enumerate()
        .filter(|(_, line)| !line.starts_with('#') && !line.trim().is_empty())
        .nth(row + 1)
        .map_or(0, |(line, _)| line);
    Place { path: path.to_owned(), line: line + 1, column: 1 }
}

/// The text without a last line that has fewer cells than the header: a recording that was cut off.
fn whole_lines(text: &str) -> &str {
    fn cells(line: &str) -> usize {
        line.matches(',').count()
    }
    match text.trim_end_matches('\n').rfind('\n') {
        Some(newline) if !text.ends_with('\n') => {
            let (complete_lines, last) = text.split_at(newline + 1);
            let header = complete_lines.lines().next().unwrap_or_default();
            if cells(last) < cells(header) { complete_lines } else { text }
        }
        _ => text,
    }
}

#[cfg(test)]
mod tests {
    use super::super::SkipReason;
    use super::*;
    use std::f64::consts::FRAC_PI_2;
    use std::fmt::Write as _;
    use std::fs;

    const HEADER: &str = "Timestamp sec,Timestamp nanosec, Target sec,Tip x,Tip y,Tip z,Tip qw,Tip qx,Tip qy,Tip qz,Robot x,Robot z";

    /// Rows of time, tip and robot; simulated, in the layout of the recordings.
    fn read(rows: &str) -> Result<Recording, SessionError> {
        let dir = tempfile::tempdir().expect("a folder");
        let path = dir.path().join("run_1.csv");
        fs::write(&path, format!("{HEADER}\n{rows}")).expect("writes");
        trajcontrol(&path)
    }

    #[test]
    fn silent_rows_and_cut_lines_are_skipped() {
        let recording = read(
            "1700000000,900000000,0,0,0,0,0,0,0,0,0,0\n\
             1700000001,400000000,0,-25.5,2.0,22.5,0.7,0,0,0,-0.025,0.022\n\
             1700000001,900000000,0,-25.0,-10.0,22.0,0.7,0,0,0,-0.024,0.0215\n\
             1700000002,400000000,0,-24.0,-10",
        )
        .expect("reads");
        let run = &recording.run;
        assert_eq!(run.id, "run_1");
        fn close(a: &[f64], b: &[f64]) -> bool {
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12)
        }
        assert!(close(&run.depth_m, &[-2e-3, 10e-3]), "{:?}", run.depth_m);
        assert!(close(run.tip_x_m.as_deref().expect("x"), &[-0.5e-3, 0.0]));
        assert!(close(&run.tip_y_m, &[0.5e-3, 0.0]));
        assert!(close(run.guide2_x_m.as_deref().expect("guide"), &[0.0, 1e-3]));
        assert!(close(run.guide2_y_m.as_deref().expect("guide"), &[0.0, -0.5e-3]));
        let time_s = run.time_s.as_ref().expect("time");
        assert!((time_s[1] - 0.5).abs() < 1e-6 && time_s[0] == 0.0);
        assert_eq!(recording.skipped, [Skipped { reason: SkipReason::Silent, rows: 1, first_row: 1 }]);
        // A quaternion whose length is not 1 has no direction.
        assert_eq!(run.tip_direction_x_rad, None);
        assert!(recording.remarks[0].contains("0 of 2 rows"), "{:?}", recording.remarks);
    }

    #[test]
    fn rows_in_which_the_sensor_gave_no_number_are_skipped_and_counted() {
        fn row(second: u32, tip: &str, robot: &str) -> String {
            format!("{},0,0,{tip},0.7,0,0,0,{robot}\n", 1_700_000_000 + second)
        }
        let rows = [
            row(0, "-25.0,-1.0,22.0", "-0.025,0.02"),
            row(1, "nan,nan,nan", "-0.025,0.02"),
            row(2, "-25.1,-2.0,22.0", "nan,nan"),
            row(3, "-25.2,,22.0", "-0.025,0.02"),
            row(4, "-25.2,-3.0,NaN", "-0.025,0.02"),
            row(5, "-25.2,-3.0,22.0", "-0.025,0.021"),
        ];
        let recording = read(&rows.concat()).expect("reads");
        assert_eq!(recording.skipped, [Skipped { reason: SkipReason::Missing, rows: 3, first_row: 2 }]);
        assert_eq!(recording.run.time_s, Some(vec![0.0, 2.0, 5.0]));
        // The previous row has the position of the guide.
        let guide_m = recording.run.guide2_y_m.expect("a guide");
        assert!(guide_m[1] == 0.0 && (guide_m[2] - 1e-3).abs() < 1e-12, "{guide_m:?}");
        // A quaternion without numbers is no direction, and no reason to refuse its row.
        let without_rotation =
            row(6, "-25.3,-4.0,22.0", "-0.025,0.021").replace("0.7,0,0,0", "nan,nan,nan,nan");
        assert_eq!(read(&(rows.concat() + &without_rotation)).expect("reads").run.depth_m.len(), 4);
    }

    #[test]
    fn a_clock_that_steps_back_is_an_error_at_its_row() {
        fn row(second: u32, depth: u32) -> String {
            format!("{second},0,0,-25,-{depth},2{depth},0,0,0,0,0.01,0.01\n")
        }
        let rows: String =
            [(1000, 1), (1001, 2), (1001, 3), (981, 4), (982, 5)].map(|(s, d)| row(s, d)).concat();
        let error = read(&rows).expect_err("steps back").to_string();
        assert!(error.contains("run_1.csv:5:1: Timestamp sec: 20.000 s before the row before"), "{error}");
    }

    #[test]
    fn faults_name_place_and_what_was_expected() {
        fn message(rows: &str) -> String {
            read(rows).map(|_| ()).map_err(|error| error.to_string()).expect_err("fails")
        }
        assert!(
            message("1,0,0,1,oops,3,0,0,0,0,0,0\n")
                .contains("run_1.csv:2:9: Tip y: \"oops\" is not a number")
        );
        let silent = message("1,0,0,0,0,0,0,0,0,0,0.1,0.1\n");
        assert!(
            silent.contains("no row is a reading: 1 row from row 1 on, silent: the tip sensor gave 0, 0, 0"),
            "{silent}"
        );
        assert!(message("").contains("no rows, expected at least one row"));
    }

    /// The needle points along `-y`, then tilts by known angles upwards and to the side: what was turned is measured.
    #[test]
    fn directions_are_those_of_the_sensors_z_axis() {
        // From the sensor's z to -y: a quarter turn about x; then small turns about the axes of the positions.
        fn product(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
            [
                a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
                a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
                a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
                a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
            ]
        }
        fn turn(axis: usize, rad: f64) -> [f64; 4] {
            let mut q = [(0.5 * rad).cos(), 0.0, 0.0, 0.0];
            q[axis] = (0.5 * rad).sin();
            q
        }
        let forward = turn(1, FRAC_PI_2);
        // About -x by 0.1: -y towards z. About z by 0.05: -y towards x.
        for (q, y, x) in [
            (forward, 0.0, 0.0),
            (product(turn(1, -0.1), forward), 0.1f64.tan(), 0.0),
            (product(turn(3, 0.05), forward), 0.0, 0.05f64.tan()),
            // A turn about the needle's own axis changes nothing.
            (product(product(turn(1, -0.1), forward), turn(3, 1.0)), 0.1f64.tan(), 0.0),
            (product(turn(3, 0.05), product(forward, turn(3, -2.0))).map(|part| -part), 0.0, 0.05f64.tan()),
        ] {
            let [found_y, found_x] = slopes(q);
            assert!((found_y - y).abs() < 1e-12 && (found_x - x).abs() < 1e-12, "{found_y} {found_x}");
        }
        assert!(slopes(turn(1, -FRAC_PI_2))[0].is_nan(), "a needle that points out of the tissue");
        assert!(slopes([0.0; 4])[0].is_nan());

        let [w, x, y, z] = product(turn(1, -0.1), forward);
        let rows = format!("1,0,0,1,-5,2,{w},{x},{y},{z},0.01,0.01\n2,0,0,1,-6,2.01,0.5,0,0,0,0.01,0.01\n");
        let recording = read(&rows).expect("reads");
        let directions = recording.run.tip_direction_y_rad.expect("directions");
        assert!((directions[0] - 0.1f64.tan()).abs() < 1e-12 && directions[1].is_nan(), "{directions:?}");
    }

    /// Rest and an early end do not keep an insertion from being one; a withdrawal at the end is skipped.
    #[test]
    fn rest_is_kept_and_a_withdrawal_is_skipped() {
        let mut rows = String::new();
        let mut number = 0;
        let mut row = |depth: f64| {
            number += 1;
            let noise = 1e-4 * f64::from(number);
            let _ = writeln!(
                rows,
                "{},0,0,{},{},20,0,0,0,0,-0.02,0.02",
                1_700_000_000 + number,
                noise + 0.01 * depth,
                -depth
            );
        };
        for stop in 0..=12 {
            (0..4).for_each(|_| row(5.0 * f64::from(stop)));
        }
        (1..37).for_each(|i| row(60.0 - 3.0 * f64::from(i)));
        let recording = read(&rows).expect("reads");
        assert_eq!(recording.skipped, [Skipped { reason: SkipReason::Withdrawn, rows: 35, first_row: 54 }]);
        assert!(recording.remarks.is_empty() || recording.run.tip_direction_y_rad.is_none());
        let depth_m = &recording.run.depth_m;
        assert_eq!(depth_m.len(), 53, "four rows of each of 13 stops, and one row just behind the last");
        assert!((depth_m.iter().copied().fold(0.0, f64::max) - 0.06).abs() < 1e-12);
    }
}
