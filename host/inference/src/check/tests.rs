//! One simulated session that is right, and every way in which it can be wrong.

use super::*;
use formats::session::{ForceRow, SessionWriter, Setup, ShapeRow, template};
use simulation::simulate::{Sensors, SimulationPlan};
use std::fs;
use tempfile::{TempDir, tempdir};

/// Lateral runs and insertions of the example that `guide init` makes.
fn example() -> TempDir {
    let folder = tempdir().expect("a folder");
    let plan = folder.path().join("plan.toml");
    fs::write(&plan, template::EXAMPLE_PLAN).expect("written");
    let setup = Setup::read(&plan).expect("a rig");
    let simulated = SimulationPlan::read(&plan, None)
        .expect("a plan")
        .carry_out(&setup.rig, Sensors::new(&setup.noise), 1)
        .expect("simulated");
    simulated.write(&mut SessionWriter::open(folder.path(), &setup).expect("a session")).expect("written");
    folder
}

/// The findings, without the folder's name.
fn findings(folder: &TempDir) -> Vec<String> {
    let prefix = format!("{}/", folder.path().display());
    check(folder.path()).findings.iter().map(|finding| finding.to_string().replace(&prefix, "")).collect()
}

fn ability(check: &Check, command: &str) -> Capability {
    check.abilities.iter().find(|ability| ability.command == command).expect("a command").clone()
}

/// The example's findings after a file of it has been changed; the file is put back.
fn changed(folder: &TempDir, file: &str, change: impl FnOnce(String) -> String) -> Vec<String> {
    let path = folder.path().join(file);
    let original = fs::read_to_string(&path).expect("a file");
    fs::write(&path, change(original.clone())).expect("written");
    let reported = findings(folder);
    fs::write(&path, original).expect("written");
    reported
}

/// A table with one column times a factor, plus something.
fn column(text: &str, name: &str, change: impl Fn(f64) -> f64) -> String {
    let mut lines = text.lines();
    let header = lines.next().expect("a header");
    let index = header.split(',').position(|column| column == name).expect("the column");
    let mut csv = format!("{header}\n");
    for line in lines {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        cells[index] = format!("{:.12}", change(cells[index].parse().expect("a number")));
        csv += &(cells.join(",") + "\n");
    }
    csv
}

#[test]
fn the_example_is_right_and_of_use() {
    let folder = example();
    let report = check(folder.path());
    assert!(report.usable && !report.empty, "{report:?}");
    assert_eq!(report.findings, []);
    for (command, runs) in [("identify", 4), ("predict", 4), ("diagnose", 8)] {
        let ability = ability(&report, command);
        assert!(ability.usable && ability.skipped.is_empty(), "{ability:?}");
        assert_eq!(ability.runs.len(), runs, "{command}");
    }
    let track = ability(&report, "track");
    assert!(!track.usable && track.skipped[0].reason.contains("no [[steering]]"), "{track:?}");
    assert!(ability(&report, "predict").remarks[0].contains("--until 5 to 99 mm"));
    assert!(ability(&report, "diagnose").remarks[0].contains("d20-2, d40-2"));
    assert!(ability(&report, "report").remarks[0].contains("identify, predict, diagnose"));
}

#[test]
fn a_template_is_valid_and_empty_and_nothing_is_not() {
    let folder = tempdir().expect("a folder");
    let empty_report = check(folder.path());
    assert!(!empty_report.usable && empty_report.errors() == 1 && empty_report.abilities.is_empty());
    fs::write(folder.path().join("session.toml"), template::SESSION).expect("written");
    let report = check(folder.path());
    assert!(report.usable && report.empty && report.findings.is_empty(), "{report:?}");
    assert!(report.abilities.iter().all(|ability| !ability.usable));
}

#[test]
fn every_error_is_reported_with_its_place() {
    let folder = example();
    fs::write(folder.path().join("i2.csv"), "depth_mm,tip_y_mm\n1,x\n").expect("written");
    fs::remove_file(folder.path().join("i3.csv")).expect("removed");
    let report = check(folder.path());
    assert!(!report.usable && report.errors() == 2);
    let first = &report.findings[0];
    assert_eq!((first.line, first.column), (Some(2), Some(3)));
    assert_eq!(first.what, "tip_y_mm: \"x\" is not a number");
    assert_eq!(first.expected.as_deref(), Some("a number from -200 to 200"));
    assert!(findings(&folder)[1].contains(": insertion.path: cannot read i3.csv: "));
    assert_eq!(ability(&report, "predict").runs, ["i1", "i4"]);
}

#[test]
fn units_that_are_mixed_up_are_suspected() {
    let folder = example();
    for (file, name, factor, expected) in [
        ("d20-1.force.csv", "force_y_n", 1e2, "d20-1.force.csv: force_y_n: "),
        ("d20-1.force.csv", "force_y_n", 1e-6, "expected a measurable force"),
        ("d20-1.force.csv", "displacement_y_mm", 1e-3, "d20-1.force.csv: displacement_y_mm: 0.00"),
        ("d20-1.force.csv", "displacement_y_mm", 20.0, "expected a few millimetres: are these micrometres?"),
        ("d20-1.force.csv", "time_s", 1e3, "expected seconds: are these milliseconds?"),
        ("d20-1.shape.csv", "z_mm", 1e-3, "d20-1.shape.csv: z_mm: 0.09 at most, expected millimetres"),
        ("d20-1.shape.csv", "deflection_y_mm", 1e-3, "d20-1.shape.csv: deflection_y_mm: 0.00"),
        ("d20-1.shape.csv", "deflection_y_mm", 50.0, "millimetres from the straight needle"),
        ("i1.csv", "depth_mm", 1e-3, "i1.csv: depth_mm: 0.1 at most, expected millimetres"),
        ("i1.csv", "tip_y_mm", 1e-3, "i1.csv: tip_y_mm: 0.00"),
    ] {
        let reported = changed(&folder, file, |text| {
            let text = column(&text, name, |value| factor * value);
            // Who mixes up units does so in both planes.
            let x_name = name.replace("_y_", "_x_");
            if x_name == name { text } else { column(&text, &x_name, |value| factor * value) }
        });
        assert!(reported.iter().any(|line| line.contains(expected)), "{name} x {factor}: {reported:#?}");
    }
    for (file, name, plus, expected) in [
        ("d20-1.shape.csv", "z_mm", -70.0, "expected positions from guide 1: are these from the surface?"),
        ("d20-1.shape.csv", "z_mm", 10.0, "is beyond the tip at 90.0"),
        ("i1.csv", "tip_y_mm", 150.0, "expected distances from the straight needle's line"),
    ] {
        let reported =
            changed(&folder, file, |text: String| column(&text, name, |value| (plus + value).max(0.0)));
        assert!(reported.iter().any(|line| line.contains(expected)), "{name} + {plus}: {reported:#?}");
    }
}

#[test]
fn what_the_session_file_states_is_checked() {
    let folder = example();
    for (from, to, expected) in [
        ("youngs_modulus_gpa = 200.0", "youngs_modulus_gpa = 2.0", "needle.youngs_modulus_gpa: 2, expected"),
        ("outer_diameter_mm = 1.27", "outer_diameter_mm = 5.27", "needle.outer_diameter_mm: 5.27"),
        ("force_n = 0.02\n", "", "noise: force_n not stated"),
        ("shape_mm = 0.025", "shape_mm = 0.000025", "noise.shape_mm: 0.000025"),
        ("shape_mm = 0.025", "shape = 0.025", "noise.shape: not part of the format, ignored"),
        ("[noise]", "[noises]", "session.toml:16:2: noises: not part of the format"),
        ("d20-2.force.csv", "d20-1.force.csv", "d20-1.force.csv: used by d20-1 and d20-2"),
        ("depth_mm = 20.0", "depth_mm = 2.0", "lateral.depth_mm: 2 in run d20-1"),
    ] {
        let reported = changed(&folder, "session.toml", |text| {
            assert!(text.contains(from), "{text}");
            text.replacen(from, to, 1)
        });
        assert!(reported.iter().any(|line| line.contains(expected)), "{expected}: {reported:#?}");
    }
    let mixed = changed(&folder, "session.toml", |text| {
        let crc = |crc: &str| format!("calibration_crc = \"{crc}\"\nid = ");
        let text = text.replacen("id = \"d20-1\"", &(crc("00000001") + "\"d20-1\""), 1);
        text.replacen("id = \"d20-2\"", &(crc("00000002") + "\"d20-2\""), 1)
    });
    assert!(mixed[0].contains("runs differ: d20-1 with 00000001; d20-2 with 00000002"), "{mixed:#?}");
}

#[test]
fn gaps_are_reported() {
    let folder = example();
    let cut = |text: String, out: std::ops::Range<usize>| -> String {
        let kept_lines = text.lines().enumerate().filter(|(line, _)| !out.contains(line));
        kept_lines.map(|(_, line)| format!("{line}\n")).collect()
    };
    let lost_rows = changed(&folder, "d20-1.force.csv", |text| cut(text, 100..130));
    assert!(
        lost_rows[0].starts_with("d20-1.force.csv: time_s: no rows from 4.90 to 6.45 s"),
        "{lost_rows:#?}"
    );
    let lost_samples =
        changed(&folder, "d20-1.force.csv", |text| column(&text, "lost_before", |value| value + 1.0));
    assert!(lost_samples[0].contains("samples are missing"), "{lost_samples:#?}");
    let missing_rows = changed(&folder, "i1.csv", |text| cut(text, 61..121));
    assert!(missing_rows[0].starts_with("i1.csv: depth_mm: no rows from"), "{missing_rows:#?}");
    let reported = changed(&folder, "i1.csv", |text| text + &"1,20,0,10000\n".repeat(100));
    assert!(reported[0].contains("rows are before the surface, drawn back, or misread"), "{reported:#?}");
}

#[test]
fn a_run_that_is_no_use_is_named() {
    let folder = tempdir().expect("a folder");
    let plan = folder.path().join("plan.toml");
    fs::write(&plan, template::EXAMPLE_PLAN).expect("written");
    let mut session =
        SessionWriter::open(folder.path(), &Setup::read(&plan).expect("a rig")).expect("a session");
    let mut run = session.lateral("short", 0.03).expect("a run");
    for row in 0..5 {
        run.force(&ForceRow { time_s: 0.1 * f64::from(row), ..ForceRow::default() }).expect("a row");
    }
    run.shape(&ShapeRow { z_m: 0.08, ..ShapeRow::default() }).expect("a point");
    run.finish().expect("written");
    let report = check(folder.path());
    assert!(!report.usable && report.errors() == 0, "{report:#?}");
    let identify = ability(&report, "identify");
    assert_eq!(identify.skipped[0].id.as_deref(), Some("short"));
    assert!(identify.skipped[0].reason.contains("no hold found"), "{identify:?}");
    assert!(!ability(&report, "report").usable);
}
