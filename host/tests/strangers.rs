//! Files of programs that nobody here has used with `guide`, chosen without knowledge of the readers: each is read right, or rejected
//! with the reason. No case may end in a silent wrong number.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;

#[path = "strangers/bags.rs"]
mod bags;
#[path = "strangers/contradictions.rs"]
mod contradictions;
#[path = "strangers/dicom.rs"]
mod dicom;
#[path = "strangers/frames.rs"]
mod frames;
#[path = "strangers/markups.rs"]
mod markups;
#[path = "strangers/messages.rs"]
mod messages;
#[path = "strangers/recordings.rs"]
mod recordings;
#[path = "strangers/tables.rs"]
mod tables;
#[path = "strangers/variants.rs"]
mod variants;
#[path = "strangers/workbooks.rs"]
mod workbooks;

/// Answer of the program to one import.
struct Answer {
    folder: TempDir,
    succeeded: bool,
    /// Everything that it printed.
    printed: String,
}

/// Imports with these arguments; files lie in the folder, in which the command runs.
fn import(folder: TempDir, arguments: &[&str]) -> Answer {
    let output = Command::new(env!("CARGO_BIN_EXE_guide"))
        .current_dir(folder.path())
        .arg("import")
        .args(arguments)
        .args(["--out", "out"])
        .output()
        .expect("guide starts");
    let printed = [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    Answer { folder, succeeded: output.status.success(), printed: printed.concat() }
}

fn folder() -> TempDir {
    tempfile::tempdir().expect("a folder")
}

/// A folder with one file in it.
fn with_file(name: &str, content: impl AsRef<[u8]>) -> TempDir {
    let folder = folder();
    fs::write(folder.path().join(name), content).expect("written");
    folder
}

/// The columns of the only file of the session that ends like this.
fn columns(answer: &Answer, ending: &str, names: [&str; 3]) -> Vec<[f64; 3]> {
    let output_path = answer.folder.path().join("out");
    let files = fs::read_dir(&output_path).expect("a session").map(|entry| entry.expect("an entry").path());
    let matching: Vec<PathBuf> = files.filter(|file| file.to_string_lossy().ends_with(ending)).collect();
    let [file] = matching.as_slice() else { panic!("{matching:?} are not one file:\n{}", answer.printed) };
    read_columns(file, names)
}

/// Columns of a CSV file; one that it lacks is full of zeros.
fn read_columns(file: &Path, names: [&str; 3]) -> Vec<[f64; 3]> {
    let mut reader = csv::Reader::from_path(file).expect("opens");
    let header = reader.headers().expect("a header").clone();
    let column_indices = names.map(|name| header.iter().position(|cell| cell == name));
    let rows = reader.records().map(|row| row.expect("a row"));
    rows.map(|row| {
        column_indices.map(|column| column.map_or(0.0, |index| row[index].parse().expect("a number")))
    })
    .collect()
}

/// Rejected, and the reason has one of these words; nothing is written.
fn assert_rejected(answer: &Answer, words: &[&str]) {
    assert!(!answer.succeeded, "accepted:\n{}", answer.printed);
    let printed = answer.printed.to_lowercase();
    assert!(
        words.iter().any(|word| printed.contains(&word.to_lowercase())),
        "no reason:\n{}",
        answer.printed
    );
    assert!(
        !answer.folder.path().join("out/session.toml").exists(),
        "a session is left:\n{}",
        answer.printed
    );
}

/// Rejected with one of these words, or right as the other check says.
fn assert_right_or_rejected(answer: &Answer, words: &[&str], right: impl Fn(&Answer)) {
    if answer.succeeded { right(answer) } else { assert_rejected(answer, words) }
}

/// The force series that every table below states in its own way: rest, 1 mm, back, -1 mm and back, with ramps; 10 rows a second.
/// Seconds, millimetres, newtons; the force has a ripple by which rows can be told apart.
fn staircase() -> Vec<[f64; 3]> {
    let levels = [0.0, 1.0, 0.0, -1.0, 0.0];
    let mut rows = Vec::new();
    for (number, level) in levels.iter().enumerate() {
        let start_mm = if number == 0 { 0.0 } else { levels[number - 1] };
        for step in 0..25 {
            let displacement =
                if step < 5 { start_mm + (level - start_mm) * f64::from(step) / 5.0 } else { *level };
            let row = rows.len() as f64;
            let force = 2.4 * displacement + 0.01 * (0.7 * row).sin();
            rows.push([row / 10.0, displacement, (force * 1e4).round() / 1e4]);
        }
    }
    rows
}

/// Rows of the imported force series are those of the staircase: every one at its time, and at least this many.
fn assert_staircase(answer: &Answer, least: usize) {
    let expected = staircase();
    let rows = columns(answer, ".force.csv", ["time_s", "displacement_y_mm", "force_y_n"]);
    assert!(rows.len() >= least, "{} rows:\n{}", rows.len(), answer.printed);
    assert!(rows.len() <= expected.len(), "{} rows:\n{}", rows.len(), answer.printed);
    let start_s = rows[0][0];
    for [time_s, displacement_mm, force_n] in rows {
        let index = ((time_s - start_s) * 10.0).round() as usize;
        let row = expected.get(index).unwrap_or_else(|| panic!("time {time_s} s:\n{}", answer.printed));
        let is_close = (time_s - start_s - row[0]).abs() < 2e-3
            && (displacement_mm - row[1]).abs() < 2e-3
            && (force_n - row[2]).abs() < 2e-3;
        assert!(is_close, "{time_s} {displacement_mm} {force_n} for {row:?}:\n{}", answer.printed);
    }
}

/// A table of the staircase: a header, and a row as this function writes it.
fn rows_as(header: &str, row: impl Fn(&[f64; 3]) -> String) -> String {
    let mut table = header.to_owned();
    for values in staircase() {
        table.push_str(&row(&values));
        table.push('\n');
    }
    table
}

/// The lines of a test in a source, from its name to the end.
fn body<'t>(source: &'t str, name: &str) -> Option<&'t str> {
    let start = source.find(&format!("fn {name}()"))?;
    let (before, rest) = source.split_at(start);
    let indent: String = before.chars().rev().take_while(|letter| *letter == ' ').collect();
    let is_test = before.lines().rev().take(4).any(|line| line.trim() == "#[test]");
    let end = rest.find(&format!("\n{indent}}}\n"))?;
    is_test.then(|| &rest[..end])
}

#[test]
fn every_kind_has_the_test_that_failed_and_two_variants() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the workspace");
    let kinds = include_str!("strangers/kinds.in");
    let lines = kinds.lines().filter(|line| !line.starts_with('#'));
    let mut counts: Vec<(&str, [usize; 2])> = Vec::new();
    let mut seen = Vec::new();
    for line in lines.filter(|line| !line.is_empty()) {
        let place = ["failed ", "variant "].iter().position(|word| line.starts_with(word));
        let Some(place) = place else {
            counts.push((line, [0; 2]));
            continue;
        };
        let (kind, of_kind) = counts.last_mut().expect("a kind");
        of_kind[place] += 1;
        let (test, case) = line.split_once(" | ").expect(line);
        let mut words = test.split_whitespace().skip(1);
        let (file, name) = (words.next().expect(line), words.next().expect(line));
        let source = fs::read_to_string(root.join(file)).unwrap_or_else(|error| panic!("{line}: {error}"));
        let body = body(&source, name).unwrap_or_else(|| panic!("{line}: no such test"));
        assert!(body.contains(case), "{line}: the test has no such case");
        assert!(!seen.contains(&(*kind, test, case)), "{line}: twice");
        seen.push((*kind, test, case));
    }
    for (kind, [failed, variants]) in &counts {
        assert!(*failed >= 1 && *variants >= 2, "{kind}: {failed} that failed, {variants} variants");
    }
    assert!(counts.len() >= 27, "{} kinds", counts.len());
}
