//! Layouts of recordings and programs of others (columns, units, separators), with numbers made here: the series are those they were made of.

use super::*;
use std::fmt::Write as _;
use std::path::Path;

const GRAVITY: f64 = 9.806_65;
const POUND_N: f64 = 4.448_221_615_260_5;

/// Time in seconds, displacement in millimetres, force in newtons of row `i`.
pub(super) fn truth(i: usize) -> [f64; 3] {
    let t = 0.02 * i as f64;
    let x = 1.2 * (t - 3.0).clamp(0.0, 1.0);
    [t, x, 0.3 * x + 5e-3 * (2.3 * i as f64).sin()]
}

pub(super) fn lines(before: &str, row: impl Fn(usize, f64, f64, f64) -> String) -> Vec<u8> {
    let rows = (0..400).map(|i| {
        let [t, x, f] = truth(i);
        row(i, t, x, f) + "\r\n"
    });
    (before.to_owned() + &rows.collect::<String>()).into_bytes()
}

/// Session content of a file by its maps.
pub(super) fn taken(bytes: &[u8], maps: &[&str], rate_hz: Option<f64>) -> Result<Taken, TableError> {
    let table = Grid::parse(Path::new("t.csv"), bytes).and_then(RawTable::new)?;
    let choices = maps.iter().map(|map| Choice::parse(map)).collect::<Result<Vec<_>, _>>()?;
    take(&[table], &Mapping { choices }, &Options { rate_hz, ..Options::default() })
}

fn comma(value: f64) -> String {
    format!("{value:.8}").replace('.', ",")
}

pub(super) fn same(name: &str, bytes: &[u8], maps: &[&str], rate_hz: Option<f64>) {
    let lateral_run = taken(bytes, maps, rate_hz).unwrap_or_else(|error| panic!("{name}: {error}"));
    let force = lateral_run.force.expect("a force");
    assert_eq!(force.time_s.len(), 400, "{name}: {:?}", lateral_run.notes);
    for i in 0..400 {
        let [t, x, f] = truth(i);
        let values = [force.time_s[i], 1e3 * force.displacement_y_m[i], force.force_y_n[i]];
        let is_equal = values.iter().zip([t, x, f]).all(|(a, b)| (a - b).abs() < 2e-5);
        assert!(is_equal, "{name}, row {i}: {values:?} and {:?}", [t, x, f]);
    }
}

#[test]
fn ten_layouts_give_the_series_they_were_made_of() {
    same(
        "tensile tester",
        &lines("Time (s),Extension (mm),Load (N)\n", |_, t, x, f| format!("{t},{x:.6},{f:.6}")),
        &[],
        None,
    );
    same(
        "microcontroller with raw counts",
        &lines("time (ms),forceRaw,force (mN), encoderRaw,position (um)\n", |i, t, x, f| {
            format!("{:.0},{},{:.3},{},{:.3}", 1e3 * t, 400 + i, 1e3 * f, 9000 + i, 1e3 * x)
        }),
        &["force (mN)=force_y_n", "position (um)=displacement_y_mm"],
        None,
    );
    same(
        "hydraulic tester",
        &lines(
            "MTS793|MPT|ENU|1|2\r\nData Header:\tTimed\r\n\r\nTime\t25 N MTS Force\t250 MTS Displacement\r\nSec\tkN\tmm\r\n",
            |_, t, x, f| format!("{}\t{}\t{}", comma(t), comma(-1e-3 * f), comma(-x)),
        ),
        &["25 N MTS Force=force_y_n:-kN", "250 MTS Displacement=displacement_y_mm:-mm"],
        None,
    );
    same(
        "rock mechanics",
        &lines("Time (sec),Ch:Load (lbs),Ch:Position (mm),Ch:Stress (PSI)\n", |_, t, x, f| {
            format!("{t},{:.8},{x:.6},{}", f / POUND_N, 0.5)
        }),
        &[],
        None,
    );
    let mut windows =
        b"\"Pr\xfcfzeit\";\"Standardweg\";\"Standardkraft\"\r\n\"s\";\"\xb5m\";\"N\"\r\n".to_vec();
    windows.extend(lines("", |_, t, x, f| format!("{};{};{}", comma(t), comma(1e3 * x), comma(f))));
    let maps = ["Standardkraft=force_y_n", "Standardweg=displacement_y_mm", "Prüfzeit=time_s"];
    same("materials tester of Windows", &windows, &maps, None);
    same(
        "robot",
        &lines("t_unix,pos_x,pos_y,pos_z,force_x,force_y\n", |_, t, x, f| {
            format!("{:.6},{:.8},0.2,0.3,{:.6},{:.6}", 1_764_000_000.0 + t, 0.112 + 1e-3 * x, 0.01, f)
        }),
        &["force_y=force_y_n:N", "pos_x=displacement_y_mm:m", "t_unix=time_s"],
        None,
    );
    let preamble: String = (1..=22).map(|i| format!("setting {i} = {i}.5\n")).collect();
    same(
        "friction",
        &lines(&preamble, |i, t, x, f| format!(" {t:.4}   {f:.6}  {}  {x:.6}", 0.1 * i as f64)),
        &["#2=force_y_n:N", "#4=displacement_y_mm:mm", "#1=time_s:s"],
        None,
    );
    let mut logger = "Sample;Date and Time;Load [gf];Stage [inch]\n".to_owned();
    for i in 0..400 {
        let [t, x, f] = truth(i);
        let (second, milli) = (58 + (t + 1e-9) as u32, (1e3 * t).round() as u32 % 1000);
        let (hour, minute, second) = if second < 60 { (23, 59, second) } else { (0, 0, second - 60) };
        let day = if hour == 23 { 30 } else { 31 };
        let _ = writeln!(
            logger,
            "{i};{day}.12.2025 {hour:02}:{minute:02}:{second:02}.{milli:03};{:.5};{:.8}",
            1e3 * f / GRAVITY,
            x / 25.4
        );
    }
    let logger: Vec<u8> =
        [0xFF, 0xFE].into_iter().chain(logger.encode_utf16().flat_map(u16::to_le_bytes)).collect();
    same("data logger", &logger, &[], None);
    same(
        "numpy",
        &lines("# t force disp\n", |_, t, x, f| format!("{t:.18e} {f:.18e} {:.18e}", 1e-3 * x)),
        &["force=force_y_n:N", "disp=displacement_y_mm:m", "t=time_s:s"],
        None,
    );
    let header = "LabVIEW Measurement\nWriter_Version|2\n***End_of_Header***\nX_Value|Fy|LVDT|Comment\n";
    same(
        "instrument program",
        &lines(header, |i, _, x, f| format!("{i}|{:.6}|{x:.6}|", 1e3 * f)),
        &["Fy=force_y_n:mN", "LVDT=displacement_y_mm:mm"],
        Some(50.0),
    );
}

#[test]
fn what_is_not_known_is_asked_for_by_name() {
    fn plain(before: &str) -> Vec<u8> {
        lines(before, |_, t, x, f| format!("{t},{x:.6},{f:.6}"))
    }
    for (before, maps, words) in [
        ("Time (s),Extension,Load (N)\n", &[][..], "'Extension=displacement_y_mm': no unit is stated"),
        ("Time (s),Extension (mm),Load (V)\n", &[], "'Load (V)=force_y_n': no unit is stated"),
        (
            "Time (s),Extension (N),Load (N)\n",
            &["Extension (N)=displacement_y_mm"],
            "its unit, N, is one of force",
        ),
        (
            "Time (s),Extension (mm),Load (V)\n",
            &[],
            "(V), expected --map 'Load (V)=force_y_n:UNIT' with N, mN, g, kg, lbf, or what one in the column stands for, such as 0.5 N",
        ),
        ("Time (s),Extension (mm),Load x100 [N]\n", &[], "its name has a factor, x100"),
        (
            "Time (s),Extension (mm),Load (N)\n(s),(mm),(mN)\n",
            &[],
            "its name states N, and the line of units mN",
        ),
        ("a,b,c\n", &[], "--map 'COLUMN=QUANTITY:UNIT' for each"),
        ("Time (s),Extension (m),Load (N)\n", &[], "is the unit right?"),
        ("Time (s),Extension (mm),Load (N)\n", &["Force=force_y_n:N"], "expected one of \"Time (s)\""),
        ("x,Extension (mm),Load (N)\n", &[], "no column of times among"),
    ] {
        let error = taken(&plain(before), maps, None).expect_err(words).to_string();
        assert!(error.contains(words), "{words} is not in {error}");
    }
    let rows = lines("Time (s),Extension (mm),Load (N)\n", |i, t, x, f| {
        if i == 9 { format!("{t},{x},over") } else { format!("{t},{x},{f}") }
    });
    let error = taken(&rows, &[], None).expect_err("a word").to_string();
    assert!(error.contains("t.csv:11: Load (N): \"over\" is not a number"), "{error}");
}

#[test]
fn counts_and_volts_are_taken_by_what_one_of_them_stands_for() {
    let bytes = lines("Time (s),Encoder (counts),Load x100 [N],Cell (mV)\n", |_, t, x, f| {
        format!("{t},{:.4},{:.6},{:.6}", 1e3 * x, 100.0 * f, 2.0 * f)
    });
    let encoder = "Encoder (counts)=displacement_y_mm:1/1000 mm";
    same("factor", &bytes, &[encoder, "Load x100 [N]=force_y_n:0.01 N"], None);
    same("calibration", &bytes, &[encoder, "Cell (mV)=force_y_n:0.5N"], None);
    let run = taken(&bytes, &[encoder, "Load x100 [N]=force_y_n:N"], None);
    let error_or_note = run.map_or_else(|error| error.to_string(), |run| run.notes.join("\n"));
    assert!(error_or_note.contains("its name has a factor, x100"), "{error_or_note}");
}

#[test]
fn a_number_that_ends_with_its_point_is_cut_off() {
    let mut bytes = lines("Time (s),Extension (mm),Load (N)\n", |_, t, x, f| format!("{t},{x:.6},{f}"));
    bytes.extend(b"8.0,1.2,1.");
    let run = taken(&bytes, &[], None).expect("a run");
    assert!(run.notes.iter().any(|note| note.contains("the last row is cut off")), "{:?}", run.notes);
    assert_eq!(run.force.map(|force| force.time_s.len()), Some(400));
}

#[test]
fn cells_that_are_no_numbers_say_what_is_expected_in_their_place() {
    type Cell = fn(f64) -> String;
    let cells: [(Cell, &str); 6] = [
        (
            |f| format!("({:.4})", f + 1.0),
            "\"(1.0000)\" is not a number but one in parentheses, expected -1.0000 if it is one below zero, else 1.0000",
        ),
        (
            |f| format!("{:.4}-", f + 1.0),
            "\"1.0000-\" is not a number but one with a minus behind it, expected -1.0000",
        ),
        (
            |f| format!("{:.4} mN", f + 1.0),
            "\"1.0000 mN\" is not a number but one with a unit, expected 1.0000 with mN in the name of the column",
        ),
        (
            |_| "OL".to_owned(),
            "\"OL\" is not a number, expected numbers, and where there is no reading (overload, out of range) an empty cell or nan",
        ),
        (
            |_| "<invalid>".to_owned(),
            "\"<invalid>\" is not a number, expected numbers, and where there is no reading",
        ),
        (|_| "0.01-0.02".to_owned(), "\"0.01-0.02\" is not a number, expected numbers"),
    ];
    for (cell, words) in cells {
        // In one row, in those of the rest, and in all.
        for from in [11, 100, 1_000] {
            let rows = lines("Time (s),Extension (mm),Load (N)\n", |i, t, x, f| {
                if i == 9 || (10..from).contains(&i) {
                    format!("{t},{x},{}", cell(if i == 9 { 0.0 } else { f }))
                } else {
                    format!("{t},{x},{f}")
                }
            });
            for maps in [&[][..], &["Load (N)=force_y_n"]] {
                let error = taken(&rows, maps, None).expect_err(words).to_string();
                assert!(error.contains(words) && error.contains(": Load (N): "), "{words} is not in {error}");
            }
        }
    }
    for text in ["{\"t\": 0.1, \"f\": 2.0}\n", "t:0.1,f:2.0\n"] {
        let error = taken(text.repeat(9).as_bytes(), &[], None).expect_err("no table").to_string();
        assert!(
            error.contains("no rows of two numbers or more: \"")
                && error.contains("in the middle of the file"),
            "{error}"
        );
    }
}

#[test]
fn names_above_a_column_of_comments_are_those_of_labview() {
    let header_text = "LabVIEW Measurement\t\nSeparator\tTab\n***End_of_Header***\t\nChannels\t2\t\nSamples\t400\t400\n\
                       ***End_of_Header***\t\t\nX_Value\tDisplacement\tForce\tComment\n";
    let bytes = lines(header_text, |_, t, x, f| format!("{t:.6}\t{x:.6}\t{f:.6}"));
    same(
        "lvm",
        &bytes,
        &["X_Value=time_s:s", "Displacement=displacement_y_mm:mm", "Force=force_y_n:N"],
        None,
    );
    // Another surplus word is none that can be left out: it may be a unit behind its name.
    let bytes = lines("Time X Force N\n", |_, t, x, f| format!("{t:.6} {x:.6} {f:.6}"));
    assert!(taken(&bytes, &["Force=force_y_n:N"], None).is_err());
}

#[test]
fn seconds_and_nanoseconds_of_one_stamp_are_one_time() {
    fn stamp(t: f64) -> String {
        let ns = (1e9 * t).round() as i64 + 1_764_000_000_900_000_000;
        format!("{},{}", ns.div_euclid(1_000_000_000), ns.rem_euclid(1_000_000_000))
    }
    fn row(_: usize, t: f64, x: f64, f: f64) -> String {
        format!("{},{:.9},{f:.6}", stamp(t), 1e-3 * x)
    }
    let maps = ["w.force.y=force_y_n:N", "j.position=displacement_y_mm:m"];
    for names in ["header.stamp.sec,header.stamp.nanosec", "secs,nsecs"] {
        let bytes = lines(&format!("{names},j.position,w.force.y\n"), row);
        same(names, &bytes, &maps, None);
    }
    let bytes = lines("a,b,j.position,w.force.y\n", row);
    same("by maps", &bytes, &["a=time_s:s", "b=time_s:ns", maps[0], maps[1]], None);
    // Two whole times are no time and its fraction, whatever their units.
    let bytes = lines("a,b,x_mm,f_n\n", |_, t, x, f| format!("{t},{},{x},{f}", 1e3 * t));
    let maps = ["a=time_s:s", "b=time_s:ms", "x_mm=displacement_y_mm", "f_n=force_y_n"];
    let error = taken(&bytes, &maps, None).unwrap_err().to_string();
    assert!(error.contains("beside a time in units of 1 s"), "{error}");
}

#[test]
fn a_session_s_own_names_are_what_they_say() {
    let force = Grid::parse(
        Path::new("f.csv"),
        &lines("Time,displacement_y_mm,force_y_n,displacement_x_mm,force_x_n\n", |_, t, x, f| {
            format!("{t},{x},{f},0.01,0.02")
        }),
    );
    let shape =
        "time_s,z_mm,deflection_y_mm,deflection_x_mm\n5.0,71.0,0.9,0.1\n5.5,72.0,0.8,0.1\n6.0,73.0,0.7,0.1\n";
    let shape = Grid::parse(Path::new("s.csv"), shape.as_bytes());
    let tables = [force, shape].map(|grid| grid.and_then(RawTable::new).expect("a table"));
    let options =
        Options { merge_on: Some("time".into()), z_from: Some(ZOrigin::Guide1), ..Options::default() };
    let lateral_run = take(&tables, &Mapping::default(), &options).expect("a run");
    assert_eq!(lateral_run.force.expect("a force").displacement_x_m.expect("both axes").len(), 400);
    let shape = lateral_run.shape.expect("a shape");
    fn millimetres(values: &[f64]) -> Vec<f64> {
        values.iter().map(|m| (1e6 * m).round() / 1e3).collect::<Vec<_>>()
    }
    assert_eq!(millimetres(&shape.z_m), [71.0, 72.0, 73.0]);
    assert_eq!(millimetres(&shape.y_m), [0.9, 0.8, 0.7]);
}

/// Cells of one column from those of a table with time, displacement and force.
fn moved_at(taken: &Taken, row: usize) -> f64 {
    taken.force.as_ref().expect("a force").displacement_y_m[row]
}

#[test]
fn signs_between_thousands_are_no_decimal_commas() {
    fn parted(value: f64, decimals: usize, sign: char, point: char) -> String {
        let text = format!("{:.decimals$}", value.abs());
        let (whole, fraction) = text.split_once('.').unwrap_or((&text, ""));
        let mut digits = String::new();
        for (at, digit) in whole.chars().enumerate() {
            if at > 0 && (whole.len() - at).is_multiple_of(3) {
                digits.push(sign);
            }
            digits.push(digit);
        }
        if decimals > 0 {
            digits = format!("{digits}{point}{fraction}");
        }
        if value < 0.0 { format!("-{digits}") } else { digits }
    }
    // Whole micrometres are rounded by half of one; the others by less.
    for (decimals, sign, point) in
        [(1, ',', '.'), (1, '.', ','), (2, '\'', '.'), (1, '\u{a0}', ','), (0, ',', '.')]
    {
        let bytes = lines("Time (ms);Position (um);Load (mN)\n", |_, t, x, f| {
            let cells = [(1e3 * t, 0), (1e3 * x, decimals), (1e3 * f, 3)];
            cells.map(|(value, decimals)| parted(value, decimals, sign, point)).join(";")
        });
        let lateral_run = taken(&bytes, &[], None).unwrap_or_else(|error| panic!("{sign} {point}: {error}"));
        for row in [0, 170, 399] {
            let (right, read) = (1e-3 * truth(row)[1], moved_at(&lateral_run, row));
            assert!((read - right).abs() < 0.51e-6, "{sign} {point} {row}: {read} for {right}");
        }
        assert!(lateral_run.notes.iter().any(|note| note.contains("thousands")), "{:?}", lateral_run.notes);
    }
}

#[test]
fn clocks_in_days_zones_and_two_columns_give_the_times_they_were_made_of() {
    fn rest(x: f64, f: f64) -> String {
        format!("{x:.6},{f:.6}")
    }
    let header = "Time,Extension (mm),Load (N)\n";
    same(
        "days of a spreadsheet",
        &lines(header, |_, t, x, f| format!("{:.12},{}", 45_418.5 + t / 86_400.0, rest(x, f))),
        &[],
        None,
    );
    fn clock(t: f64, hours: i64) -> String {
        let ms = (1e3 * t).round() as i64 + 59_995_000;
        format!(
            "{:02}:{:02}:{:02}.{:03}",
            hours + ms / 3_600_000 - 14,
            ms / 60_000 % 60,
            ms / 1000 % 60,
            ms % 1000
        )
    }
    same(
        "clocks that are put forward",
        &lines(header, |i, t, x, f| {
            let (hours, zone) = if i < 150 { (0, "+01:00") } else { (1, "+02:00") };
            format!("2024-03-31T{}{zone},{}", clock(t, hours), rest(x, f))
        }),
        &[],
        None,
    );
    same(
        "milliseconds beside whole seconds",
        &lines("Time,ms,Extension (mm),Load (N)\n", |_, t, x, f| {
            let text = clock(t, 2);
            let (whole, ms) = text.split_once('.').expect("a fraction");
            format!("{whole},{},{}", ms.parse::<u32>().expect("a number"), rest(x, f))
        }),
        &[],
        None,
    );
    same(
        "minutes and seconds",
        &lines(header, |_, t, x, f| format!("05:{:05.2},{}", 12.0 + t, rest(x, f))),
        &[],
        None,
    );
    // Five thousand rows in a second, and fifty thousand or two in the time of a day's clock.
    let bytes =
        lines("Time,Extension (mm),Load (N)\n", |_, t, x, f| format!("{:.9},{}", 1e-2 * t, rest(x, f)));
    assert!(!taken(&bytes, &[], None).is_err_and(|error| error.to_string().contains("or d for")));
    let bytes =
        lines("Time,Extension (mm),Load (N)\n", |_, t, x, f| format!("{:.9},{}", 1e-3 * t, rest(x, f)));
    let error = taken(&bytes, &[], None).expect_err("no unit").to_string();
    assert!(error.contains("or d for the days of a spreadsheet"), "{error}");
}

#[test]
fn set_points_errors_and_velocities_are_not_taken_for_what_is_measured() {
    let header = "Time (s),Position setpoint (mm),Position (mm),Position error (mm),Load (N),Load limit (N),Load cell temperature\n";
    let rows = lines(header, |_, t, x, f| format!("{t},{:.6},{x:.6},{:.6},{f:.6},50,23.5", 2.0 * x, -x));
    same("a controller's table", &rows, &[], None);
}
