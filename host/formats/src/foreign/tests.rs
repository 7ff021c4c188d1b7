//! Grids, names, clocks and offsets; whole imports are tests of the command line.

use super::grid::Grid;
use super::*;
use proptest::prelude::*;
use std::path::Path;

fn table(text: &str) -> RawTable {
    RawTable::new(Grid::parse(Path::new("t.csv"), text.as_bytes()).expect("a grid")).expect("a table")
}

fn map(choices: &[&str]) -> Mapping {
    Mapping { choices: choices.iter().map(|text| Choice::parse(text).expect("a choice")).collect() }
}

fn values(column: &RawColumn) -> Vec<f64> {
    column.values.iter().map(|value| column.origin as f64 + value).collect()
}

fn names(table: &RawTable) -> Vec<(&str, Option<&str>)> {
    table
        .columns
        .iter()
        .map(|column| (column.name.as_str(), column.unit.as_ref().map(|unit| unit.name.as_str())))
        .collect()
}

#[test]
fn separators_decimal_commas_and_names_are_found() {
    let two = [("t", Some("s")), ("F", Some("N"))];
    for text in [
        "t (s),F (N)\n0,1.5\n1,2.5\n2,3.5\n",
        "t (s);F (N)\n0;1,5\n1;2,5\n2;3,5\n",
        "t (s)\tF (N)\n0\t1,5\n1\t2,5\n2\t3,5\n",
        "t/s F/N\n0 1.5\n1 2.5\n2 3.5\n",
        "t/s  F/N\n0,0   1,5\n1,0   2,5\n2,0   3,5\n",
        "\"t (s)\",\"F (N)\"\n\"0\",\"1,5\"\n\"1\",\"2,5\"\n\"2\",\"3,5\"\n",
        "% made by a program\n% t_s | F_N\n0|1.5\n1|2.5\n2|3.5\n",
        "t;F\n(s);(N)\n0;1.5\n1;2.5\n2;3.5\n",
        "\u{feff}Test 5; of 2024\n\nt [s];F [N];\n0;1,5;\n1;2,5;\n2;3,5;\n",
    ] {
        let parsed_table = table(text);
        assert_eq!(names(&parsed_table), two, "{text}");
        assert_eq!(values(&parsed_table.columns[1]), [1.5, 2.5, 3.5], "{text}");
    }
    let bare = table("0 1.5\n1 2.5\n2 3.5\n");
    assert_eq!(names(&bare), [("column 1", None), ("column 2", None)]);
    assert!(bare.form.ends_with("without names"), "{}", bare.form);
}

#[test]
fn rows_without_numbers_and_a_cut_last_row_are_left_out_and_noted() {
    let parsed_table = table("t,f,word\n0,1,a\n1,,b\nnan,3,c\nStopped by user,,\n4,5,d\n5,6");
    assert_eq!(parsed_table.lines, [2, 3, 4, 6]);
    assert!(parsed_table.columns[1].values[1].is_nan() && parsed_table.columns[0].values[2].is_nan());
    assert_eq!(parsed_table.words.iter().map(|column| &column.header).collect::<Vec<_>>(), ["word"]);
    assert!(
        parsed_table.notes[0].contains("line 7: the last row is cut off")
            && parsed_table.notes[1].contains("from line 5 on"),
        "{:?}",
        parsed_table.notes
    );
    for bytes in [&b""[..], b"\n\n", b"only words\nand more\n", b"\0\0\0\0", b"1\n2\n3\n"] {
        let outcome = Grid::parse(Path::new("t.csv"), bytes).and_then(RawTable::new);
        assert!(outcome.is_err(), "{bytes:?}");
    }
}

/// Force and displacement of a push at 100 Hz; `f` makes a line of time, displacement and force in mm and N.
fn push(header: &str, line: impl Fn(f64, f64, f64) -> String) -> RawTable {
    let rows = (0..300).map(|i| {
        let t = 0.01 * f64::from(i);
        let x = (t - 1.0).clamp(0.0, 1.0);
        line(t, x, 0.3 * x + 2e-3 * (7.7 * f64::from(i)).sin()) + "\n"
    });
    table(&(header.to_owned() + "\n" + &rows.collect::<String>()))
}

#[test]
fn adding_a_constant_to_all_times_changes_nothing() {
    fn of(origin: i64) -> crate::session::ForceSeries {
        let table = push("Time (s),Stage (mm),Load (N)", |t, x, f| {
            format!("{}.{:02},{x},{f}", origin + t as i64, (100.0 * t).round() as i64 % 100)
        });
        take(&[table], &Mapping::default(), &Options::default()).expect("a run").force.expect("a force")
    }
    assert_eq!(of(0), of(1_764_000_000));
    assert_eq!(of(0), of(12_345));
}

#[test]
fn a_clock_of_the_day_passes_midnight_and_one_that_is_set_back_is_an_error() {
    fn clock(shift_s: f64) -> impl Fn(f64, f64, f64) -> String {
        move |t: f64, x: f64, f: f64| {
            let clock_s = (86_399.0 + t + if t > 2.0 { shift_s } else { 0.0 }) % 86_400.0;
            let (h, m, s) = ((clock_s / 3600.0) as u32, (clock_s / 60.0) as u32 % 60, clock_s % 60.0);
            format!("{h:02}:{m:02}:{s:06.3},{x},{f}")
        }
    }
    let lateral_run =
        take(&[push("Time,Stage (mm),Load (N)", clock(0.0))], &Mapping::default(), &Options::default())
            .expect("a run");
    let times_s = lateral_run.force.expect("a force").time_s;
    assert!(
        (times_s[299] - 2.99).abs() < 1e-9 && lateral_run.notes.iter().any(|note| note.contains("midnight")),
        "{:?}",
        lateral_run.notes
    );
    let error =
        take(&[push("Time,Stage (mm),Load (N)", clock(-0.7))], &Mapping::default(), &Options::default());
    assert!(error.expect_err("set back").to_string().contains("never step back"));
}

#[test]
fn rows_of_one_time_are_one_reading_and_missing_ones_are_interpolated() {
    // Each reading twice: one of them is enough.
    let twice = push("Time (s),Stage (mm),Load (N)", |t, x, f| format!("{t},{x},{f}\n{t},{x},{f}"));
    let lateral_run = take(&[twice], &Mapping::default(), &Options::default()).expect("a run");
    assert_eq!(lateral_run.force.expect("a force").time_s.len(), 300);
    assert!(
        lateral_run
            .notes
            .iter()
            .any(|note| note.contains("300 rows have the time of the row before: the mean")),
        "{:?}",
        lateral_run.notes
    );
    // Sensors in turn: every row has one of them.
    let turns = push("Time (s),Stage (mm),Load (N)", |t, x, f| {
        if ((100.0 * t).round() as u32).is_multiple_of(2) { format!("{t},{x},") } else { format!("{t},,{f}") }
    });
    let force =
        take(&[turns], &Mapping::default(), &Options::default()).expect("a run").force.expect("a force");
    assert_eq!(force.time_s.len(), 149);
    let (t, y_m) = (force.time_s[60] + 0.01, force.displacement_y_m[60]);
    assert!((1e3 * y_m - (t - 1.0).clamp(0.0, 1.0)).abs() < 1e-9, "{t} {y_m}");
}

#[test]
fn rows_that_are_faster_than_their_clock_are_spread_evenly() {
    // A tenth of a second at 100 Hz; whole seconds of the day at 100 Hz, begun within one; a tick of 15.625 ms.
    fn tenths(t: f64) -> String {
        format!("{:.1}", (10.0 * t + 1e-9).floor() / 10.0)
    }
    fn seconds(t: f64) -> String {
        format!("10:00:{:02}", (t + 0.73 + 1e-9).floor())
    }
    fn ticks(t: f64) -> String {
        format!("{:.3}", (64.0 * t + 1e-9).floor() / 64.0)
    }
    let clocks: [&dyn Fn(f64) -> String; 3] = [&tenths, &seconds, &ticks];
    for (clock, within_s) in clocks.into_iter().zip([1e-6, 1e-6, 5e-3]) {
        let coarse = push("Time (s),Stage (mm),Load (N)", |t, x, f| format!("{},{x},{f}", clock(t)));
        let lateral_run = take(&[coarse], &Mapping::default(), &Options::default()).expect("a run");
        let times_s = lateral_run.force.expect("a force").time_s;
        assert_eq!(times_s.len(), 300, "{:?}", lateral_run.notes);
        for (row, time_s) in times_s.iter().enumerate() {
            assert!((time_s - 0.01 * row as f64).abs() < within_s, "{row}: {time_s}");
        }
        assert!(
            lateral_run.notes.iter().any(|note| note.contains("spread evenly")),
            "{:?}",
            lateral_run.notes
        );
    }
    // Pauses in which nothing was recorded: before and after each there is one rate, whose phase is known to a period.
    fn pauses(t: f64) -> f64 {
        t + if t > 1.6 { 7.0 } else { 0.0 }
    }
    let paused = push("Time (s),Stage (mm),Load (N)", |t, x, f| {
        format!("{:.1},{x},{f}", (10.0 * pauses(t) + 1e-9).floor() / 10.0)
    });
    let times_s = take(&[paused], &Mapping::default(), &Options::default())
        .expect("a run")
        .force
        .expect("a force")
        .time_s;
    assert_eq!(times_s.len(), 300);
    for (row, time_s) in times_s.iter().enumerate() {
        assert!((time_s - pauses(0.01 * row as f64)).abs() < 0.011, "{row}: {time_s}");
    }
    // Rows that come at no rate: those of one stamp are one reading.
    let bursts = push("Time (s),Stage (mm),Load (N)", |t, x, f| {
        let row = (100.0 * t).round() as usize;
        format!("{:.1},{x},{f}", 0.1 * (row * row / 900) as f64)
    });
    let lateral_run = take(&[bursts], &Mapping::default(), &Options::default()).expect("a run");
    assert!(
        lateral_run.notes.iter().any(|note| note.contains("the mean of such rows")),
        "{:?}",
        lateral_run.notes
    );
}

#[test]
fn formats_that_are_no_tables_say_how_they_become_one() {
    for (name, words) in [
        ("run.parquet", "read_parquet"),
        ("run.h5", "h5py"),
        ("run.NPY", "numpy.load"),
        ("run.tdms", "nptdms"),
        ("run_0.db3", "--dst-storage mcap"),
        ("run.bag", "ROS 1"),
        ("run.csv.gz", "unpack"),
    ] {
        let error = RawTable::read(Path::new(name)).expect_err(name).to_string();
        assert!(error.starts_with(name) && error.contains(words), "{error}");
    }
}

#[test]
fn offsets_of_two_clocks_are_within_their_intervals() {
    let options = Options::default();
    let mapping = map(&["Load (N)=force_y_n", "Stage (mm)=displacement_y_mm", "Time (s)=time_s"]);
    for offset_s in [0.0, 0.004, 3.217, -12.3456, 250.0] {
        let force = push("Time (s),Load (N)", |t, _, f| format!("{t:.4},{f:.6}"));
        let moved = push("Time (s),Stage (mm)", |t, x, _| format!("{:.4},{x:.6}", t + offset_s));
        let lateral_run = take(&[force, moved], &mapping, &options).expect("a run");
        let offset = lateral_run.offset.expect("an offset");
        assert!(
            (offset.offset_s + offset_s).abs() < 2.5 * offset.sd_s && offset.sd_s < 0.01,
            "{offset_s}: {offset:?}"
        );
    }
    // Ramps that repeat fit at several offsets, and noise at none.
    fn wave(header: &str, of: fn(f64) -> f64) -> RawTable {
        push(header, move |t, _, _| format!("{t:.4},{:.6}", of(t)))
    }
    let two_tables = [
        wave("Time (s),Load (N)", |t| (12.0 * t).sin() + 0.05 * (1e5 * t * t).sin()),
        wave("Time (s),Stage (mm)", |t| (12.0 * t).sin() + 0.05 * (3e4 * t * t).cos()),
    ];
    let error = take(&two_tables, &mapping, &options).expect_err("repeats").to_string();
    assert!(error.contains("fit alike") && error.contains("--merge-on"), "{error}");
    let noise = [
        wave("Time (s),Load (N)", |t| (1e5 * t * t).sin()),
        wave("Time (s),Stage (mm)", |t| (3e4 * t * t).cos()),
    ];
    assert!(
        take(&noise, &mapping, &options)
            .expect_err("noise")
            .to_string()
            .contains("expected ramps in both files")
    );
}

#[test]
fn a_map_is_written_and_read_again() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("map.toml");
    let mapping = map(&["Force \"a\" [g]=force_y_n:-g", "#3=time_s:ms", "Stage X=displacement_y_mm"]);
    std::fs::write(&path, mapping.to_toml()).expect("written");
    assert_eq!(Mapping::read(&path).expect("reads"), mapping);
    for (text, words) in [
        ("[table]\nformat = 9\n", "map.toml:2:10"),
        ("[table]\nformat = 1\n[[column]]\nname = \"a\"\nis = \"force\"\n", "map.toml:5:6: column.is"),
        ("[table]\nformat = 1\n[[column]]\nname = \"a\"\nis = \"time_s\"\nfactor = 2\n", "column.factor"),
    ] {
        std::fs::write(&path, text).expect("written");
        let error = Mapping::read(&path).expect_err(words).to_string();
        assert!(error.contains(words), "{error}");
    }
}

#[test]
fn a_position_and_a_force_against_it_are_noticed() {
    let stage = push("Time (s),Stage (mm),Load (N)", |t, x, f| format!("{t},{},{}", 112.5 + x, -f));
    fn notes(zero: Zero, stage: &RawTable) -> Result<(String, Vec<f64>), TableError> {
        let options = Options { zero, ..Options::default() };
        let result = take(std::slice::from_ref(stage), &Mapping::default(), &options);
        result.map(|result| (result.notes.join("; "), result.force.expect("a force").displacement_y_m))
    }
    let (zero_note, moved_m) = notes(Zero::Auto, &stage).expect("a run");
    assert!(
        zero_note.contains("never near 0") && zero_note.contains("falls where the displacement rises"),
        "{zero_note}"
    );
    assert!(moved_m[0].abs() < 1e-12 && (moved_m[299] - 1e-3).abs() < 1e-12);
    assert!(notes(Zero::Written, &stage).expect_err("112 mm").to_string().contains("is the unit right?"));
}

proptest! {
    /// Whatever the bytes are, there is a table or an error.
    #[test]
    fn any_bytes_are_borne(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
        let _ = Grid::parse(Path::new("t.csv"), &bytes).and_then(RawTable::new);
    }

    /// Numbers come back from every separator and decimal sign.
    #[test]
    fn numbers_come_back(
        rows in prop::collection::vec((-1e6f64..1e6, -1e3f64..1e3, 0.0f64..9.0), 5..40),
        form in 0usize..6,
    ) {
        let (separator, comma) = [(",", false), (";", false), (";", true), ("\t", true), ("|", false), (" ", true)][form];
        let number = |value: f64| { let text = format!("{value:.6}"); if comma { text.replace('.', ",") } else { text } };
        let lines: String = rows.iter().map(|(a, b, c)| [number(*a), number(*b), number(*c)].join(separator) + "\n").collect();
        let parsed_table = table(&lines);
        prop_assert_eq!(parsed_table.columns.len(), 3);
        for (row, (a, b, c)) in rows.iter().enumerate() {
            for (column, value) in [a, b, c].into_iter().enumerate() {
                let read = parsed_table.columns[column].origin as f64 + parsed_table.columns[column].values[row];
                prop_assert!((read - value).abs() < 1e-6, "{} {}", read, value);
            }
        }
    }
}
