//! Channels that give a number while they measure nothing.

use super::layout_tests::{lines, taken, truth};
use super::{Taken, zeros_among_forces};

/// Cell of the force in a row, from the row and the true force.
type Cell = fn(usize, f64) -> String;

const HEADER: &str = "Time (s),Extension (mm),Load (N)\n";

/// A run whose force is that of `force` in every row, which has the truth and its row.
fn with_force(force: impl Fn(usize, f64) -> String) -> Taken {
    let bytes = lines(HEADER, |i, t, x, f| format!("{t},{x:.6},{}", force(i, f)));
    taken(&bytes, &[], None).expect("a run")
}

/// Checks that these rows are left out, with a remark, and all others are as they were.
fn left_out(name: &str, run: &Taken, is_zero: impl Fn(usize) -> bool, words: &str) {
    let force = run.force.as_ref().expect("a force");
    let rows: Vec<usize> = (0..400).filter(|row| !is_zero(*row)).collect();
    let recovered_rows: Vec<usize> =
        force.time_s.iter().map(|t| ((t + truth(rows[0])[0]) / 0.02).round() as usize).collect();
    assert_eq!(recovered_rows, rows, "{name}: {:?}", run.notes);
    for (row, force_n) in rows.iter().zip(&force.force_y_n) {
        assert!((force_n - truth(*row)[2]).abs() < 2e-2, "{name}, row {row}: {force_n}");
    }
    assert!(run.notes.iter().any(|note| note.contains(words)), "{name}: {:?}", run.notes);
}

#[test]
fn zeros_among_readings_of_a_channel_with_noise_are_left_out() {
    type Pattern = fn(usize) -> bool;
    let patterns: [(&str, Pattern, &str); 6] = [
        ("a block in the hold", |i| (260..300).contains(&i), "t.csv: line 262: \"Load (N)\" falls from"),
        ("a reading", |i| i == 300, "line 302: "),
        ("short ones", |i| i > 205 && i % 37 < 2, "line 224: "),
        ("every second one, from the start on", |i| i % 2 == 1 && i > 1, "zeros between readings"),
        ("every fourth one is true", |i| i % 4 != 0 && i > 3, "zeros between readings"),
        ("to the end", |i| i > 340, "line 343: "),
    ];
    for (name, is_zero, words) in patterns {
        let run = with_force(|i, f| if is_zero(i) { "0.00000".to_owned() } else { format!("{f:.5}") });
        left_out(name, &run, is_zero, words);
    }
    // Hundredths of a newton: at rest zero is the reading of every row.
    let run = with_force(|i, f| if (260..270).contains(&i) { "0".to_owned() } else { format!("{f:.2}") });
    left_out("hundredths", &run, |i| (260..270).contains(&i), "line 262: ");
}

#[test]
fn a_position_that_drops_to_zero_is_left_out() {
    let bytes = lines(HEADER, |i, t, x, f| {
        let position = if (260..264).contains(&i) || i == 20 { 0.0 } else { 51.3 + x };
        format!("{t},{position:.4},{f:.5}")
    });
    let run = taken(&bytes, &[], None).expect("a run");
    let force = run.force.expect("a force");
    assert!(force.displacement_y_m.iter().all(|y_m| (-1e-6..1.3e-3).contains(y_m)), "{:?}", run.notes);
    assert!(
        force.time_s.len() >= 396
            && run.notes.iter().any(|note| note.contains("\"Extension (mm)\" falls from 51.3"))
    );
}

#[test]
fn zeros_that_are_readings_stay() {
    // Before contact, in a band around zero, in a channel of few levels, and on the way from one side to the other.
    let channels: [(&str, Cell); 6] = [
        ("steps of a tenth", |i, _| {
            format!("{:.1}", ((i as f64 - 200.0).abs() / 10.0 - 3.0).max(0.0).floor() / 10.0)
        }),
        ("before contact", |i, f| if i <= 150 { "0".to_owned() } else { format!("{f:.5}") }),
        ("contact with a step", |i, f| if i <= 150 { "0".to_owned() } else { format!("{:.5}", f + 0.8) }),
        ("a band", |i, _| {
            let f = 0.36 * (1.0 - ((i as f64 - 200.0).abs() / 20.0 - 4.0).abs() / 2.0)
                + 2e-3 * (2.3 * i as f64).sin();
            if f < 0.05 { "0".to_owned() } else { format!("{f:.5}") }
        }),
        ("whole tenths", |i, _| format!("{:.1}", [0.0, 0.4, 0.0, 0.3][i / 100])),
        ("from one side to the other", |i, f| {
            let side = [0.4, -0.4][i / 200];
            if i == 200 { "0".to_owned() } else { format!("{:.5}", side + 0.01 * f) }
        }),
    ];
    for (name, force) in channels {
        let run = with_force(force);
        assert_eq!(run.force.expect("a force").time_s.len(), 400, "{name}: {:?}", run.notes);
        assert!(!run.notes.iter().any(|note| note.contains("exactly")), "{name}: {:?}", run.notes);
    }
}

#[test]
fn a_force_that_is_one_value_over_and_over_is_remarked() {
    let stuck: [(&str, Cell, &str); 4] = [
        ("the end of the range", |_, f| format!("{:.5}", f.min(0.3)), "exactly 0.3 in"),
        (
            "held",
            |i, f| format!("{:.5}", if (240..260).contains(&i) { 0.34 } else { f }),
            "exactly 0.34 in 20",
        ),
        ("dead", |_, _| "0.0".to_owned(), "exactly 0 in 400"),
        (
            "every second one",
            |i, f| format!("{:.5}", truth(i / 2 * 2)[2].min(0.3) + 0.0 * f),
            "exactly 0.3 in",
        ),
    ];
    for (name, force, words) in stuck {
        let run = with_force(force);
        assert!(run.notes.iter().any(|note| note.contains(words)), "{name}: {:?}", run.notes);
    }
    // A logger that is faster than the channel, and whole numbers.
    let channels: [(&str, Cell); 2] = [
        ("ten times each", |i, _| format!("{:.5}", truth(i / 10 * 10)[2])),
        ("hundredths", |_, f| format!("{f:.2}")),
    ];
    for (name, force) in channels {
        let run = with_force(force);
        assert!(!run.notes.iter().any(|note| note.contains("exactly")), "{name}: {:?}", run.notes);
    }
}

#[test]
fn a_force_series_of_a_session_is_searched_for_them_too() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("push.csv");
    for (is_zero, line) in [(false, None), (true, Some(262))] {
        let bytes = lines("time_s,displacement_y_mm,force_y_n\n", |i, t, x, f| {
            let force = if is_zero && (260..270).contains(&i) { 0.0 } else { f };
            format!("{t},{x:.6},{force:.5}")
        });
        std::fs::write(&path, bytes).expect("written");
        let fault = zeros_among_forces(&path);
        assert_eq!(fault.as_ref().map(|(line, ..)| *line), line, "{fault:?}");
        assert!(fault.is_none_or(|(_, field, words)| field == "force_y_n" && words.contains("to exactly 0")));
    }
    assert_eq!(zeros_among_forces(&folder.path().join("none.csv")), None);
}
