//! Sweeps that no result uses: every command that uses the session reports them, in one line with what to do.

use super::{folder, guide, json, path, text};
use std::fmt::Write as _;
use std::fs;

#[test]
fn every_command_reports_a_sweep_that_was_taken_while_the_guide_moved() {
    let folder = folder();
    let dir = folder.path().join("example");
    json(&["init", "--example", path(&dir), "--json"]);
    let file = dir.join("d20-1.shape.csv");
    let mut rows = fs::read_to_string(&file).expect("there");
    for point in 0..19 {
        // At 28.5 s guide 2 is on its way from -1.2 mm to 0.
        writeln!(rows, "{},{}.0,0.1,0.0", 28.45 + 0.005 * f64::from(point), 71 + point).expect("written");
    }
    fs::write(&file, rows).expect("written");
    let remedy = "hold for longer than a sweep takes";
    let report = folder.path().join("report.html");
    let commands: [&[&str]; 4] = [
        &["check", path(&dir)],
        &["identify", path(&dir)],
        &["identify", path(&dir), "--layers"],
        &["diagnose", path(&dir)],
    ];
    for command in commands {
        let output = guide(command);
        let shown = text(&output.stdout) + &text(&output.stderr);
        assert!(
            shown.lines().any(|line| line.contains("19 points") && line.contains(remedy)),
            "{command:?}: {shown}"
        );
    }
    let written_report = guide(&["report", path(&dir), "--out", path(&report)]);
    assert!(written_report.status.success(), "{}", text(&written_report.stderr));
    let page = fs::read_to_string(&report).expect("written");
    assert!(page.contains(remedy));
    let unused = &json(&["identify", path(&dir), "--json"])["unused"];
    assert_eq!((&unused[0]["run"], &unused[0]["count"]), (&"d20-1".into(), &19.into()), "{unused}");
}

#[test]
fn a_check_fails_where_identify_can_use_no_run() {
    let folder = folder();
    let dir = folder.path().join("example");
    json(&["init", "--example", path(&dir), "--json"]);
    assert!(guide(&["check", path(&dir)]).status.success());
    // Column, of rows by their number, of files with this ending.
    type Change = fn(usize) -> Option<f64>;
    let changes: [(&str, &str, &[usize], Change); 3] = [
        ("a guide that never moves", ".force.csv", &[1, 3], |_| Some(0.0)),
        ("a guide that never rests", ".force.csv", &[1, 3], |row| Some(0.01 * (row % 2_000) as f64)),
        ("a shape of one point", ".shape.csv", &[], |row| (row == 1).then_some(0.0)),
    ];
    for (what, ending, columns, change) in changes {
        let changed_dir = folder.path().join(what);
        fs::create_dir(&changed_dir).expect("a folder");
        for entry in fs::read_dir(&dir).expect("there") {
            let file = entry.expect("an entry").path();
            let to = changed_dir.join(file.file_name().expect("a name"));
            if !path(&file).ends_with(ending) {
                fs::copy(&file, to).expect("a copy");
                continue;
            }
            let rows = fs::read_to_string(&file).expect("there");
            let changed: String = rows
                .lines()
                .enumerate()
                .filter(|(row, _)| *row == 0 || change(*row).is_some())
                .map(|(row, line)| {
                    let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
                    let value = change(row).filter(|_| row > 0);
                    for column in columns {
                        if let Some((cell, value)) = cells.get_mut(*column).zip(value) {
                            *cell = format!("{value:.4}");
                        }
                    }
                    cells.join(",") + "\n"
                })
                .collect();
            fs::write(to, changed).expect("written");
        }
        let checked = guide(&["check", path(&changed_dir)]);
        let shown = text(&checked.stdout) + &text(&checked.stderr);
        assert_eq!(checked.status.code(), Some(1), "{what}: {shown}");
        assert!(!guide(&["identify", path(&changed_dir)]).status.success(), "{what}");
    }
}

#[test]
fn a_failure_with_json_is_one_document_too() {
    let folder = folder();
    let dir = path(folder.path());
    fs::write(folder.path().join("session.toml"), "[session]\nformat = \"one\"\n").expect("written");
    let failed = document(&["identify", dir, "--json"], 1);
    assert_eq!((&failed["schema"], &failed["kind"]), (&"guide.failure/1".into(), &"file".into()), "{failed}");
    assert!(failed["path"].as_str().expect("a path").ends_with("session.toml"), "{failed}");
    assert_eq!(failed["line"], 2, "{failed}");
    // Wrong use, in which the option itself may not have been parsed.
    let failed = document(&["identify", dir, "--poisson", "0.6", "--json"], 2);
    assert_eq!(failed["kind"], "usage", "{failed}");
    assert!(failed["error"].as_str().expect("a reason").contains("0.6"), "{failed}");
    // A command that prints its findings and then fails has printed its document.
    assert_eq!(document(&["check", dir, "--json"], 1)["schema"], "guide.check/2");
    // Without the option, and for help, nothing changes.
    assert!(guide(&["identify", dir]).stdout.is_empty());
    assert!(text(&guide(&["identify", "--json", "--help"]).stdout).starts_with("Identify"));
}

fn document(arguments: &[&str], code: i32) -> serde_json::Value {
    let output = guide(arguments);
    assert_eq!(output.status.code(), Some(code), "{arguments:?} {}", text(&output.stderr));
    assert!(text(&output.stderr).contains("error: "), "{arguments:?}: the line for a person remains");
    serde_json::from_slice::<serde_json::Value>(&output.stdout).expect("one JSON document")
}
