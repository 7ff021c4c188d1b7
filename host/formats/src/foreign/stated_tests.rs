//! Files that contradict themselves, their options or each other: an error at the place, or a remark.

use super::grid::Grid;
use super::layout_tests::{lines, taken, truth};
use super::*;
use std::fmt::Write as _;
use std::path::Path;

const HEAD: &str = "Time [s],Displacement [mm],Force [N]\r\n";

fn comma(text: &str) -> String {
    text.replace(',', ";").replace('.', ",")
}

/// A table whose rows are written by one function before row `at` and by another from there on.
fn changed(
    at: usize,
    first: impl Fn(String, usize) -> String,
    second: impl Fn(String, usize) -> String,
) -> Vec<u8> {
    lines("", |i, t, x, f| {
        let row = format!("{t:.2},{x:.5},{f:.5}");
        if i < at { first(row, i) } else { second(row, i) }
    })
}

fn with_head(head: &str, rows: Vec<u8>) -> Vec<u8> {
    [head.as_bytes(), rows.as_slice()].concat()
}

fn notes(bytes: &[u8], maps: &[&str], rate_hz: Option<f64>) -> Vec<String> {
    taken(bytes, maps, rate_hz).unwrap_or_else(|error| panic!("{error}")).notes
}

#[test]
fn a_form_that_changes_is_an_error_at_its_line() {
    fn unchanged(row: String, _: usize) -> String {
        row
    }
    let (tabs, semicolons) =
        (|row: String, _: usize| row.replace(',', "\t"), |row: String, _: usize| comma(&row));
    let head = HEAD.replace(',', ";");
    for (name, bytes, line, words) in [
        (
            "points, then commas",
            with_head(&head, changed(250, |row, _| row.replace(',', ";"), semicolons)),
            252,
            "decimal",
        ),
        (
            "commas first",
            with_head(&head, changed(150, semicolons, |row, _| row.replace(',', ";"))),
            152,
            "decimal",
        ),
        ("late", with_head(&head, changed(390, |row, _| row.replace(',', ";"), semicolons)), 392, "decimal"),
        ("commas, then tabulators", with_head(HEAD, changed(150, unchanged, tabs)), 152, "tabulators"),
        ("tabulators at the end", with_head(HEAD, changed(399, unchanged, tabs)), 401, "tabulators"),
        ("no names", changed(150, tabs, unchanged), 151, "commas"),
        (
            "a number in front",
            with_head(HEAD, changed(300, unchanged, |row, i| format!("{i},{row}"))),
            302,
            "4 cells",
        ),
        (
            "a number in front early",
            with_head(HEAD, changed(100, unchanged, |row, i| format!("{i},{row}"))),
            102,
            "4 from here on",
        ),
        (
            "a column less at the end",
            with_head(&HEAD.replace("\r", ",T [C]\r"), changed(380, |row, _| row + ",21.5", unchanged)),
            382,
            "3 cells",
        ),
        (
            "blanks, a column more",
            with_head(
                &HEAD.replace(" [", "[").replace(',', " "),
                changed(150, |row, _| row.replace(',', " "), |row, _| row.replace(',', " ") + " 21.5"),
            ),
            152,
            "4 from here on",
        ),
    ] {
        let maps = ["--map"; 0];
        let error = taken(&bytes, &maps, None).map(|run| run.forms).expect_err(name).to_string();
        assert!(error.contains(&format!("t.csv:{line}:")) && error.contains(words), "{name}: {error}");
    }
}

#[test]
fn single_lines_and_rows_that_lack_a_number_are_left_out_and_noted() {
    // The first row lacks a column, and another one a field in the middle.
    let first = with_head(
        "t[s] T[C] d[mm] F[N]\n",
        lines(
            "",
            |i, t, x, f| if i == 0 { format!("{t} {x} {f}") } else { format!("{t} 21.5 {x:.5} {f:.5}") },
        ),
    );
    let maps = ["d[mm]=displacement_y_mm"];
    assert!(
        notes(&first, &maps, None)
            .iter()
            .any(|note| note.contains("line 2: a line of numbers right above the rows")),
        "{:?}",
        notes(&first, &maps, None)
    );
    let short = with_head(
        "t[s],d[mm],F[N],T[C]\n",
        lines("", |i, t, x, f| {
            if (200..203).contains(&i) {
                format!("{t},{f:.5},21.5")
            } else {
                format!("{t},{x:.5},{f:.5},21.5")
            }
        }),
    );
    let run = taken(&short, &maps, None).expect("a run");
    assert!(
        run.notes.iter().any(|note| note.contains("3 rows, from line 202 on, have fewer numbers")),
        "{:?}",
        run.notes
    );
    let force = run.force.expect("a force");
    assert!(
        force.displacement_y_m.windows(2).all(|pair| (pair[1] - pair[0]).abs() < 1e-4),
        "a force became a displacement"
    );
    // A number of rows above the names, and factors below them, are no rows in another form.
    let count = with_head(
        &format!("400\t3\r\n{}", HEAD.replace(',', "\t")),
        changed(0, |row, _| row, |row, _| row.replace(',', "\t")),
    );
    assert_eq!(taken(&count, &[], None).expect("a run").force.map(|force| force.time_s.len()), Some(400));
    // Signs between thousands are none either.
    let thousands = with_head(
        "Time [ms];Displacement [um];Force [mN]\n",
        lines("", |_, t, x, f| {
            let um = 1e3 * x;
            let text = if um >= 1000.0 { format!("1.{:03.0}", um - 1000.0) } else { format!("{um:.0}") };
            format!("{:.0};{text};{:.0}", 1e3 * t, 1e3 * f)
        }),
    );
    assert!(taken(&thousands, &[], None).is_ok());
}

#[test]
fn rows_that_a_counter_misses_take_their_time() {
    fn is_lost(i: usize) -> bool {
        (200..240).contains(&i) || (300..305).contains(&i)
    }
    let rows = |counter: &dyn Fn(usize) -> String, head: &str| -> Vec<u8> {
        let mut text = format!("{head},Position [mm],Force [N]\n");
        for i in (0..400).filter(|i| !is_lost(*i)) {
            let [_, x, f] = truth(i);
            let _ = writeln!(text, "{},{x:.5},{f:.5}", counter(i));
        }
        text.into_bytes()
    };
    for (name, head, bytes) in [
        ("by one", "Sample", rows(&|i| (17 + i).to_string(), "Sample")),
        ("by ten", "Tick", rows(&|i| (10 * i).to_string(), "Tick")),
        ("of 8 bit", "Seq", rows(&|i| ((100 + i) % 256).to_string(), "Seq")),
    ] {
        let run = taken(&bytes, &[], Some(50.0)).unwrap_or_else(|error| panic!("{name}: {error}"));
        let noted = run.notes.iter().any(|note| {
            note.contains(&format!("line 202: \"{head}\" counts the rows and leaves out 45 in 2 places"))
        });
        assert!(noted, "{name}: {:?}", run.notes);
        let times_s = run.force.expect("a force").time_s;
        assert!(
            (times_s[354] - 0.02 * 399.0).abs() < 1e-9 && (times_s[200] - 4.8).abs() < 1e-9,
            "{name}: {times_s:?}"
        );
    }
    // A row that is marked as a fault was recorded, too.
    let marked = with_head(
        "Position [mm],Force [N],Status\n",
        lines("", |i, _, x, f| format!("{x:.5},{f:.5},{}", if is_lost(i) { "ERROR" } else { "OK" })),
    );
    let times_s = taken(&marked, &[], Some(50.0)).expect("a run").force.expect("a force").time_s;
    assert!((times_s[354] - 0.02 * 399.0).abs() < 1e-9, "{times_s:?}");
    // A displacement of whole numbers is no counter, and one without gaps is not mentioned.
    let whole = with_head(
        "Sample,Counts,Position [mm],Force [N]\n",
        lines("", |i, _, x, f| format!("{i},{:.0},{x:.5},{f:.5}", 1e3 * x)),
    );
    assert!(!notes(&whole, &[], Some(50.0)).iter().any(|note| note.contains("counts the rows")));
}

#[test]
fn rates_and_units_of_the_user_are_taken_and_their_contradiction_is_noted() {
    fn rows(head: &str) -> Vec<u8> {
        with_head(head, lines("", |_, _, x, f| format!("{x:.5},{f:.5}")))
    }
    let names = "Displacement [mm],Force [mN]\n";
    for (before, rate_hz, noted) in [
        ("Sample rate: 50 Hz\n", 25.0, true),
        ("Scan rate [Hz]: 50\n", 25.0, true),
        ("Sampling interval,20,ms\n", 25.0, true),
        ("# fs = 0.05 kHz\n", 25.0, true),
        ("Sample rate: 50 Hz\n", 50.0, false),
        ("Filter cutoff frequency: 10 Hz\n", 50.0, false),
        ("Operator 7, rig 3\n", 50.0, false),
    ] {
        let notes = notes(&rows(&format!("{before}{names}")), &[], Some(rate_hz));
        let is_noted = notes
            .iter()
            .any(|note| note.contains("line 1: the file states 50 rows a second, and --rate-hz 25 is taken"));
        assert_eq!(is_noted, noted, "{before}: {notes:?}");
    }
    let error = taken(&rows(&format!("Sample rate: 50 Hz\n{names}")), &[], None)
        .map(|run| run.forms)
        .expect_err("no times");
    assert!(error.to_string().contains("--rate-hz 50 for rows at one rate, as line 1 states"), "{error}");
    // Times that the file has are taken before a rate.
    let timed = with_head(HEAD, changed(0, |row, _| row, |row, _| row));
    assert!(
        notes(&timed, &[], Some(20.0)).iter().any(|note| note.contains("usually 50.0000 rows a second")
            && note.contains("--rate-hz 20 is not used"))
    );
    assert!(!notes(&timed, &[], Some(50.0)).iter().any(|note| note.contains("--rate-hz")));
    for (map, noted) in [
        ("Force [mN]=force_y_n:N", true),
        ("Force [mN]=force_y_n:-mN", false),
        ("Displacement [mm]=displacement_y_mm:um", true),
    ] {
        let notes = notes(&rows(names), &[map], Some(50.0));
        assert_eq!(notes.iter().any(|note| note.contains("as --map states")), noted, "{map}: {notes:?}");
    }
    let of_milliseconds =
        with_head("Time [ms],Displacement [mm],Force [N]\n", changed(0, |row, _| row, |row, _| row));
    assert!(
        notes(&of_milliseconds, &["Time [ms]=time_s:s"], None)
            .iter()
            .any(|note| note.contains("states ms, and is taken in s"))
    );
}

#[test]
fn a_tare_between_the_rows_is_an_error_where_the_force_steps() {
    // The force is 0.36 N at row 250; the remark is before it.
    fn tared(text: &str, offset_n: f64) -> Vec<u8> {
        with_head(
            HEAD,
            lines("", |i, t, x, f| {
                let remark = if i == 250 { format!("{text}\r\n") } else { String::new() };
                format!("{remark}{t:.2},{x:.5},{:.5}", if i < 250 { f } else { f - offset_n })
            }),
        )
    }
    for text in ["# TARE", "% re-zeroed by operator", "Zero set,,"] {
        let error = taken(&tared(text, 0.36), &[], None).map(|run| run.forms).expect_err(text).to_string();
        assert!(
            error.contains("t.csv:252: Force [N]") && error.contains("another zero from here on"),
            "{text}: {error}"
        );
        // At a force of 0 it changes nothing.
        let notes = notes(&tared(text, 0.0), &[], None);
        assert!(
            notes.iter().any(|note| note.contains("line 252:") && note.contains("not more than elsewhere")),
            "{text}: {notes:?}"
        );
    }
    let event = with_head(
        "Time [s],Displacement [mm],Force [N],Event\n",
        lines("", |i, t, x, f| {
            format!(
                "{t:.2},{x:.5},{:.5},{}",
                if i < 250 { f } else { f - 0.36 },
                if i == 250 { "tare" } else { "" }
            )
        }),
    );
    assert!(taken(&event, &[], None).is_err_and(|error| error.to_string().contains("t.csv:252: Force [N]")));
    // Other remarks are shown.
    let remarks = notes(&tared("# range switched: displacement in um from here", 0.0), &[], None);
    assert!(
        remarks.iter().any(|note| note.contains("\"# range switched: displacement in um from here\"")),
        "{remarks:?}"
    );
}

#[test]
fn a_tare_between_the_rows_of_a_session_is_an_error_too() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.force.csv");
    let read = |remark: &str, offset_n: f64| {
        let rows = lines("", |i, t, x, f| {
            let text = if i == 250 { format!("{remark}\r\n") } else { String::new() };
            format!("{text}{t:.2},{x:.5},{:.5}", if i < 250 { f } else { f - offset_n })
        });
        let head = "# tared before the run\ntime_s,displacement_y_mm,force_y_n\n";
        std::fs::write(&path, with_head(head, rows)).expect("written");
        crate::session::ForceSeries::read(&path)
    };
    let error = read("# TARE", 0.36).map(|force| force.time_s).expect_err("a new zero").to_string();
    assert!(error.contains("a.force.csv:253:") && error.contains("another zero from here on"), "{error}");
    assert!(read("# TARE", 0.0).is_ok() && read("# checked", 0.36).is_ok());
}

/// Force and displacement in two files, of which the second has another clock.
fn two_files(
    head: &str,
    force_s: impl Fn(f64) -> f64,
    moved_s: impl Fn(f64) -> f64,
    options: &Options,
) -> Result<Taken, TableError> {
    let levels = [0.0, 1.0, 2.5, 1.0, 3.0, 2.0, 0.5, 2.5, 0.0];
    let (mut force, mut moved) = (format!("{head},Force [N]\n"), format!("{head},Position [mm]\n"));
    for i in 0..75 * levels.len() {
        let (step, ramp_position) = (i / 75, (i % 75) as f64 / 15.0);
        let start = levels[step.saturating_sub(1)];
        let y_mm = start + (levels[step] - start) * ramp_position.min(1.0);
        let (t, f) = (0.02 * i as f64, 0.6 * y_mm + 5e-3 * (2.3 * i as f64).sin());
        let _ = writeln!(force, "{:.4},{f:.5}", force_s(t));
        let _ = writeln!(moved, "{:.4},{y_mm:.5}", moved_s(t));
    }
    let table =
        |name: &str, text: &str| Grid::parse(Path::new(name), text.as_bytes()).and_then(RawTable::new);
    take(&[table("f.csv", &force)?, table("p.csv", &moved)?], &Mapping::default(), options)
}

#[test]
fn clocks_that_drift_are_stretched_and_those_that_are_no_one_clock_are_noted() {
    let run = two_files("t [s]", |t| t, |t| 12.0 + 1.005 * t, &Options::default()).expect("a run");
    assert!(
        run.notes.iter().any(|note| note.contains("the clocks drift") && note.contains("fast")),
        "{:?}",
        run.notes
    );
    let force = run.force.expect("a force");
    let worst = force.time_s.iter().zip(&force.displacement_y_m).zip(&force.force_y_n);
    let worst = worst.map(|((_, y_m), f)| (600.0 * y_m - f).abs()).fold(0.0, f64::max);
    assert!(worst < 0.1, "{worst} N at the steepest ramp");
    assert!(
        two_files("t [s]", |t| t, |t| 12.0 + t, &Options::default()).is_ok_and(|run| run.drift.is_none())
    );
    let merge = Options { merge_on: Some("t [s]".to_owned()), ..Options::default() };
    let offset = Options { offset_s: Some(-12.0), ..Options::default() };
    // Options, offset of the second clock, and the remedy.
    for (head, options, of_first, of_second, remedy) in [
        ("t [s]", &merge, 5.0, 0.0, "--offset-s 5.0"),
        ("t [s]", &offset, 0.0, 10.0, "--offset-s -10.0"),
        ("t [s]", &merge, 5.0, 5.0, ""),
        ("t [s]", &offset, 0.0, 12.0, ""),
        // Clocks since 1970, of which one is set wrongly.
        ("time [s]", &Options::default(), 1.764e9, 1.764e9 + 1.5, "--offset-s -1.5"),
        ("time [s]", &Options::default(), 1.764e9, 1.764e9, ""),
    ] {
        let run = two_files(head, |t| of_first + t, |t| of_second + t, options)
            .unwrap_or_else(|error| panic!("{error}"));
        let noted = run.notes.iter().find(|note| note.contains("the ramps contradict each other"));
        match noted {
            Some(note) => {
                assert!(!remedy.is_empty() && note.contains(remedy), "{of_first} {of_second}: {note}")
            }
            None => assert!(remedy.is_empty(), "{of_first} {of_second}: {:?}", run.notes),
        }
    }
}

#[test]
fn a_second_column_of_times_in_a_table_is_mentioned_and_compared_with_the_ramps() {
    let levels = [0.0, 1.0, 2.5, 1.0, 3.0, 2.0, 0.5];
    let y_mm = |i: usize| {
        let (step, ramp_position) = (i / 75, (i % 75) as f64 / 15.0);
        let start = levels[step.saturating_sub(1)];
        start + (levels[step.min(6)] - start) * ramp_position.min(1.0)
    };
    for (late_rows, is_contradicted) in [(0, false), (40, true)] {
        let mut text = "Stage time [s],Position [mm],Force time [s],Force [N]\n".to_owned();
        for i in 0..75 * levels.len() - 40 {
            let t = 0.02 * i as f64;
            let f = 0.6 * y_mm(i + late_rows) + 5e-3 * (2.3 * i as f64).sin();
            let _ = writeln!(text, "{t:.2},{:.5},{:.2},{f:.5}", y_mm(i), t + 0.02 * late_rows as f64);
        }
        let notes = notes(text.as_bytes(), &["Stage time [s]=time_s"], None);
        assert!(
            notes
                .iter()
                .any(|note| note.contains("\"Force time [s]\" is another column of times, and not used")),
            "{notes:?}"
        );
        let contradicted = notes
            .iter()
            .any(|note| note.contains("the ramps contradict each other") && note.contains("-0.8"));
        assert_eq!(contradicted, is_contradicted, "{notes:?}");
    }
}

#[test]
fn tips_of_an_insertion_that_are_positions_are_counted_from_the_entry() {
    fn table(first_mm: f64, y_mm: f64) -> Vec<u8> {
        let mut text = "Time [s],Depth [mm],Tip y [mm],Tip x [mm]\n".to_owned();
        for i in 0..61 {
            let z = first_mm + f64::from(i);
            let _ = writeln!(
                text,
                "{:.1},{z:.2},{:.4},{:.4}",
                0.5 * f64::from(i),
                y_mm + 1.2e-3 * z * z,
                -7.5 + 0.4e-3 * z * z
            );
        }
        text.into_bytes()
    }
    let maps = ["Depth [mm]=depth_mm", "Tip y [mm]=tip_y_mm", "Tip x [mm]=tip_x_mm"];
    let run = taken(&table(0.0, 12.4), &maps, None).expect("a run");
    let insertion = run.insertion.expect("an insertion");
    let tip_x_m = insertion.tip_x_m.expect("tip x");
    assert!((insertion.tip_y_m[60] - 4.32e-3).abs() < 1e-9 && (tip_x_m[60] - 1.44e-3).abs() < 1e-9);
    assert_eq!(
        run.notes.iter().filter(|note| note.contains("taken as a position")).count(),
        2,
        "{:?}",
        run.notes
    );
    let later = taken(&table(20.0, 12.4), &maps, None).expect("a run");
    assert!(
        later.notes.iter().any(|note| note.contains("tip_y_mm") && note.contains("is it a position?")),
        "{:?}",
        later.notes
    );
    assert!(later.insertion.is_some_and(|insertion| (insertion.tip_y_m[0] - 12.88e-3).abs() < 1e-9));
}

#[test]
fn a_drift_of_clocks_that_are_taken_as_one_is_noted() {
    let drifting = two_files("time [s]", |t| 1.764e9 + t, |t| 1.764e9 + 1.005 * t, &Options::default());
    let notes = drifting.expect("a run").notes;
    assert!(notes.iter().any(|note| note.contains("the ramps show a drift between them")), "{notes:?}");
    let by_ramps = Options { by_ramps: true, ..Options::default() };
    let stretched =
        two_files("time [s]", |t| 1.764e9 + t, |t| 1.764e9 + 1.005 * t, &by_ramps).expect("a run");
    assert!(
        stretched.drift.is_some_and(|drift| (drift.rate + 5e-3).abs() < 4.0 * drift.sd),
        "{:?}",
        stretched.drift
    );
    let merge = Options { merge_on: Some("t [s]".to_owned()), ..Options::default() };
    let notes_of_one = two_files("t [s]", |t| t, |t| t, &merge).expect("a run").notes;
    assert!(!notes_of_one.iter().any(|note| note.contains("drift")), "{notes_of_one:?}");
    // A column that one file does not have is none that they share.
    let unknown = Options { merge_on: Some("clock".to_owned()), ..Options::default() };
    assert!(
        two_files("t [s]", |t| t, |t| t, &unknown)
            .is_err_and(|error| error.to_string().contains("--merge-on 'clock'"))
    );
}
