//! Malformed inputs and what `guide` prints of each, word for word; and unusual ones that it takes as they are, so that it does not grow
//! stricter.
//!
//! `hostile/base` is a small sound session with a file of every other kind beside it. A case is a folder in
//! `hostile/cases` whose files are laid over a copy of the base, in which the command then runs; a case without a
//! folder is the base itself. The table `hostile/table.toml` has the expected results. To add a case: its folder, and
//! its entry in the table.

use serde::Deserialize;
use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Fewest malformed inputs.
const MIN_CASES: usize = 60;
/// No malformed input may keep the program busy for longer.
const LIMIT: Duration = Duration::from_secs(10);
/// Commands that run at once.
const WORKERS: usize = 4;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    case: Vec<Case>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Case {
    /// Name of the case and of its folder.
    name: String,
    /// Arguments of `guide`, between spaces.
    command: String,
    /// Exit code.
    #[serde(default = "Case::failed")]
    exit: i32,
    /// All lines of standard error.
    #[serde(default)]
    stderr: Vec<String>,
    /// Lines that standard output has among others.
    #[serde(default)]
    stdout: Vec<String>,
    /// The input is sound: the result is that of this other case.
    same_as: Option<String>,
    /// The input is sound, though it is unusual.
    #[serde(default)]
    sound: bool,
}

impl Case {
    fn failed() -> i32 {
        1
    }
}

/// Outcome of a command.
#[derive(Debug, PartialEq)]
struct Outcome {
    /// None where it had to be ended.
    exit: Option<i32>,
    stdout: String,
    stderr: String,
}

fn hostile() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/hostile")
}

fn lay(from: &Path, over: &Path) {
    fs::create_dir_all(over).expect("a folder");
    for entry in fs::read_dir(from).expect("a folder of files") {
        let entry = entry.expect("an entry");
        let destination = over.join(entry.file_name());
        if entry.path().is_dir() {
            lay(&entry.path(), &destination);
        } else {
            fs::copy(entry.path(), destination).expect("copied");
        }
    }
}

/// Runs `guide` in a copy of the base under the case's files.
fn guide(case: &Case, command: &str) -> Outcome {
    let folder = tempfile::tempdir().expect("a folder");
    let session = folder.path().join("session");
    lay(&hostile().join("base"), &session);
    let case_dir = hostile().join("cases").join(&case.name);
    if case_dir.exists() {
        lay(&case_dir, &session);
    }
    let mut child = Command::new(env!("CARGO_BIN_EXE_guide"))
        .args(command.split_whitespace())
        .current_dir(&session)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("guide starts");
    let (mut stdout, mut stderr) = (child.stdout.take().expect("piped"), child.stderr.take().expect("piped"));
    thread::scope(|scope| {
        let printed = scope.spawn(|| read(&mut stdout));
        let remarks = scope.spawn(|| read(&mut stderr));
        let deadline = Instant::now() + LIMIT;
        let status = loop {
            match child.try_wait().expect("a status") {
                Some(status) => break Some(status),
                None if Instant::now() > deadline => {
                    child.kill().expect("ended");
                    child.wait().expect("a status");
                    break None;
                }
                None => thread::sleep(Duration::from_millis(2)),
            }
        };
        let [stdout, stderr] = [printed, remarks].map(|text| text.join().expect("read"));
        Outcome { exit: status.and_then(|status| status.code()), stdout, stderr }
    })
}

fn read(stream: &mut dyn Read) -> String {
    let mut text = Vec::new();
    stream.read_to_end(&mut text).expect("read");
    String::from_utf8_lossy(&text).into_owned()
}

/// Difference between the outcome and the table; empty if there is none.
fn deviations(case: &Case, others: &[Case]) -> String {
    let mut deviations = String::new();
    let Outcome { exit, stdout, stderr } = guide(case, &case.command);
    match exit {
        None => differ("time", "an end within 10 s", "none, or a signal", &mut deviations),
        Some(exit) if exit != case.exit => {
            differ("exit code", &case.exit.to_string(), &exit.to_string(), &mut deviations)
        }
        Some(_) => {}
    }
    if stderr.lines().ne(case.stderr.iter().map(String::as_str)) {
        differ("standard error", &case.stderr.join("\n             "), stderr.trim_end(), &mut deviations);
    }
    for line in &case.stdout {
        if !stdout.lines().any(|there| there == line) {
            differ("standard output", line, stdout.trim_end(), &mut deviations);
        }
    }
    // A check of the session reports the fault that stops a command with a place in the session.
    if let [message] = case.stderr.as_slice()
        && let Some(finding) = message.strip_prefix("error: ./")
    {
        let finding = format!("error        ./{finding}");
        let check = guide(case, "check .");
        if check.exit != Some(1) || !check.stdout.lines().any(|line| line == finding) {
            differ("guide check", &finding, check.stdout.trim_end(), &mut deviations);
        }
    }
    if let Some(same_case) = &case.same_as {
        let referenced = others.iter().find(|other| other.name == *same_case).expect("a case of that name");
        let expected = guide(referenced, &referenced.command);
        if stdout != expected.stdout {
            differ("result", expected.stdout.trim_end(), stdout.trim_end(), &mut deviations);
        }
    }
    deviations
}

fn differ(what: &str, expected: &str, got: &str, deviations: &mut String) {
    let _ = writeln!(deviations, "  {what}\n    expected {expected}\n    got      {got}");
}

fn table() -> Vec<Case> {
    let text = fs::read_to_string(hostile().join("table.toml")).expect("the table");
    toml::from_str::<Table>(&text).expect("a table of cases").case
}

#[test]
fn rejects_malformed_inputs_and_accepts_valid_ones() {
    let cases = table();
    let malformed = cases.iter().filter(|case| !case.sound).count();
    assert!(malformed >= MIN_CASES, "{malformed} malformed inputs, expected {MIN_CASES}");
    let (next, failures) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    thread::scope(|scope| {
        for _ in 0..WORKERS {
            scope.spawn(|| {
                while let Some(case) = cases.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let differences = deviations(case, &cases);
                    if !differences.is_empty() {
                        failures
                            .lock()
                            .expect("a list")
                            .push(format!("{}: {}\n{differences}", case.name, case.command));
                    }
                }
            });
        }
    });
    let mut failures = failures.into_inner().expect("a list");
    failures.sort();
    assert!(
        failures.is_empty(),
        "{} of {} cases deviate\n\n{}",
        failures.len(),
        cases.len(),
        failures.join("\n")
    );
}

#[test]
fn the_table_and_the_folders_name_the_same_cases() {
    let cases = table();
    let names: BTreeSet<&str> = cases.iter().map(|case| case.name.as_str()).collect();
    assert_eq!(names.len(), cases.len(), "a name appears twice");
    for entry in fs::read_dir(hostile().join("cases")).expect("the cases") {
        let name = entry.expect("an entry").file_name();
        let name = name.to_str().expect("UTF-8");
        assert!(names.contains(name), "{name}: a folder that the table does not name");
    }
}
