//! Commands that write, where the disk is full at any byte, where a name is taken, and where they are killed: one line, exit code 1,
//! nothing half-written, and the same command works once the cause is gone.
//!
//! The disk that is full is a limit on the size of a file (`prlimit`): what goes beyond it fails as on a full disk.
#![cfg(target_os = "linux")]

#[path = "interrupted/device.rs"]
mod device;
#[path = "interrupted/every.rs"]
mod every;
#[path = "interrupted/steer.rs"]
mod steer;

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::thread;
use std::time::Instant;
use tempfile::TempDir;

/// Every command that writes files without a device, with a word on what a failure leaves of it.
const WRITERS: [(&str, Left); 26] = [
    ("init made", Left::Nothing),
    ("init made --example", Left::Nothing),
    ("simulate --config plan.toml --out made", Left::Nothing),
    ("simulate --config more.toml --out .", Left::Nothing),
    ("import trajcontrol trajcontrol.csv --rig rig.toml --out made", Left::Nothing),
    ("import trajcontrol recordings/later.csv --rig rig.toml --out .", Left::Nothing),
    ("import slicer needle.mrk.json --force d20.force.csv --rig rig.toml --out made", Left::Nothing),
    ("import fbg poses.txt --rig rig.toml --out made", Left::Nothing),
    ("plan --rig rig.toml --k-kpa 5 30 --depth-mm 20 --displacement-mm 1 --plot plan.svg", Left::Whole),
    ("relation --rig rig.toml --depth-mm 30 --plot block.svg", Left::Whole),
    ("identify . --plots made", Left::Whole),
    ("predict . --plots made --until 15", Left::Whole),
    ("track . --plots made", Left::Whole),
    ("diagnose . --out made.toml --plots made", Left::Whole),
    ("report . --date 2026-11-23 --out report.html", Left::Whole),
    ("summarize . --out made.jsonl", Left::Nothing),
    ("population summaries.jsonl --plots made --out prior.toml", Left::Whole),
    ("calibrate force weights.csv --from calibration.toml --out made.toml", Left::Nothing),
    ("calibrate position gauge.csv --axis y --from calibration.toml --out made.toml", Left::Nothing),
    ("characterize --session air --out made.toml", Left::Nothing),
    ("calibrate-image nwire.igs.mha --phantom fcal.xml --out made.toml", Left::Nothing),
    ("plan-path . --target-mm=2,1,80 --plots made", Left::Whole),
    ("man --out made", Left::Whole),
    ("recover run.mcap --out made.mcap", Left::Nothing),
    ("export run.mcap --to npy --out made.npy", Left::Nothing),
    ("export run.mcap --to csv --out made", Left::Nothing),
];

/// Commands that write files and need a device, a server or a plant for it: see `device` and `steer`; the result of the
/// bring-up is tried through QEMU. The file of `capture` has its header last: without that it is no sequence.
const WITH_A_DEVICE: [&str; 6] = ["acquire", "bringup", "calibration", "capture", "record", "steer"];

/// Options that name what is written.
const WRITING_OPTIONS: [&str; 4] = ["--out ", "--plots ", "--plot ", "--raw "];

/// Files that a command leaves when it could not write all of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Left {
    /// No file.
    Nothing,
    /// Some of its files, each of them whole.
    Whole,
}

/// A folder with one sound file of every kind.
fn folder() -> TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    let base = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/hostile/base");
    for entry in fs::read_dir(base).expect("a folder of files") {
        let entry = entry.expect("an entry");
        fs::copy(entry.path(), folder.path().join(entry.file_name())).expect("copied");
    }
    let plan = fs::read_to_string(folder.path().join("plan.toml")).expect("a plan");
    // The same runs under names that the session does not have.
    let more = plan.replace("id = \"", "id = \"more-");
    fs::write(folder.path().join("more.toml"), more).expect("written");
    // The same insertion under a name that is free in the session's folder.
    let recordings = folder.path().join("recordings");
    fs::create_dir(&recordings).expect("a folder");
    fs::copy(folder.path().join("trajcontrol.csv"), recordings.join("later.csv")).expect("copied");
    fs::write(folder.path().join("run.mcap"), recording()).expect("written");
    fs::write(folder.path().join("summaries.jsonl"), summaries()).expect("written");
    for (name, content) in CALIBRATION {
        fs::write(folder.path().join(name), content).expect("written");
    }
    let images = Path::new(env!("CARGO_MANIFEST_DIR")).join("imaging/tests/data");
    for name in ["nwire.igs.mha", "fcal.xml"] {
        fs::copy(images.join(format!("plus-{name}")), folder.path().join(name)).expect("copied");
    }
    fs::write(folder.path().join("air.toml"), AIR).expect("written");
    let simulated = Command::new(env!("CARGO_BIN_EXE_guide"))
        .current_dir(folder.path())
        .args(["simulate", "--config", "air.toml", "--out", "air"])
        .output()
        .expect("simulated");
    assert!(simulated.status.success(), "{}", String::from_utf8_lossy(&simulated.stderr));
    fs::remove_file(folder.path().join("air.toml")).expect("removed");
    folder
}

/// A calibration and readings for another one.
const CALIBRATION: [(&str, &str); 3] = [
    (
        "calibration.toml",
        "id = \"unit-7\"\ntravel_mm = 10.0\nforce_range_n = 5.0\nforce_n_per_code = [[9.31e-7, 0.0], [0.0, 9.31e-7]]\n\
         [potentiometer.x]\ntrack_codes = [40, 4055]\ncodes = [0, 4096]\nrising_mm = [-25.0, 25.0]\n\
         [potentiometer.y]\ntrack_codes = [40, 4055]\ncodes = [0, 4096]\nrising_mm = [-25.0, 25.0]\n",
    ),
    (
        "weights.csv",
        "load_x_n,load_y_n,force_x_n,force_y_n\n0,0,0.011,-0.004\n0.981,0,1.017,0.049\n1.962,0,2.032,0.101\n0,0.981,-0.021,0.949\n0,1.962,-0.046,1.897\n",
    ),
    (
        "gauge.csv",
        "gauge_mm,position_mm\n-4,-3.95\n-2,-1.98\n0,0.01\n2,2.02\n4,4.03\n2,2.12\n0,0.1\n-2,-1.88\n-4,-3.86\n",
    ),
];

/// A run in air.
const AIR: &str = "[needle]\nyoungs_modulus_gpa = 200.0\nouter_diameter_mm = 1.27\ninner_diameter_mm = 1.0\n\
                   [rig]\nguide2_mm = 60.0\nentry_mm = 70.0\n[noise]\nforce_n = 0.005\n[tissue]\nk_kpa = 10.0\n\
                   [[lateral]]\nid = \"air\"\ndepth_mm = 0\nlevels_mm = [0, 0.3, 2, 0.3, 0, -0.3, -2, 0]\nhold_s = 1\n";

/// Records of four subjects, made once: the same session with other moduli.
fn summaries() -> &'static str {
    static SUMMARIES: std::sync::OnceLock<String> = std::sync::OnceLock::new();
    SUMMARIES.get_or_init(|| {
        let base = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/hostile/base");
        let output_dir = tempfile::tempdir().expect("a folder");
        let file = output_dir.path().join("one.jsonl");
        let output = Command::new(env!("CARGO_BIN_EXE_guide"))
            .args([OsStr::new("summarize"), base.as_os_str(), OsStr::new("--out"), file.as_os_str()])
            .output()
            .expect("guide starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let one: serde_json::Value =
            serde_json::from_str(&fs::read_to_string(file).expect("a file")).expect("a record");
        [("a", 0.0), ("b", 0.12), ("c", -0.15), ("d", 0.05)]
            .into_iter()
            .map(|(subject, ln_change)| {
                let mut record = one.clone();
                record["session"] = subject.into();
                record["subject"] = subject.into();
                let ln_k = record["result"]["ln_k_kpa"].as_f64().expect("a modulus");
                record["result"]["ln_k_kpa"] = (ln_k + ln_change).into();
                format!("{record}\n")
            })
            .collect()
    })
}

/// A recording, made once.
fn recording() -> &'static [u8] {
    static RECORDING: std::sync::OnceLock<Vec<u8>> = std::sync::OnceLock::new();
    RECORDING.get_or_init(device::recording)
}

fn guide(folder: &Path, limit_bytes: Option<u64>, command: &[&OsStr]) -> Command {
    let program = OsStr::new(env!("CARGO_BIN_EXE_guide"));
    let mut shell = match limit_bytes {
        Some(bytes) => {
            let mut shell = Command::new("sh");
            // A signal would end the program where a full disk gives an error.
            shell
                .args(["-c", "trap '' XFSZ; exec prlimit --fsize=\"$0\" \"$@\"", &bytes.to_string()])
                .arg(program);
            shell
        }
        None => Command::new(program),
    };
    shell
        .args(command)
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    shell
}

fn words(command: &str) -> Vec<&OsStr> {
    command.split_whitespace().map(OsStr::new).collect()
}

/// The one line of a command that fails, and nothing on standard output.
fn failure(output: &Output, what: &str) -> String {
    let stderr_text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{what}: {stderr_text}");
    let errors: Vec<&str> = stderr_text.lines().filter(|line| line.starts_with("error: ")).collect();
    assert_eq!(errors.len(), 1, "{what}: {stderr_text}");
    assert_eq!(stderr_text.lines().last(), errors.first().copied(), "{what}: {stderr_text}");
    errors.concat()
}

/// Every file below a folder, by its name, with its content.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut file_contents = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(inner) = folders.pop() {
        for entry in fs::read_dir(&inner).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(folder).expect("below it").to_owned();
                file_contents.insert(name, fs::read(&path).expect("readable"));
            }
        }
    }
    file_contents
}

/// New and changed files.
fn changed(
    before: &BTreeMap<PathBuf, Vec<u8>>,
    now: BTreeMap<PathBuf, Vec<u8>>,
) -> BTreeMap<PathBuf, Vec<u8>> {
    now.into_iter().filter(|(name, content)| before.get(name) != Some(content)).collect()
}

/// Checks the files that remain after a failure.
fn assert_left(
    left: Left,
    found: &BTreeMap<PathBuf, Vec<u8>>,
    whole: &BTreeMap<PathBuf, Vec<u8>>,
    what: &str,
) {
    let names: Vec<_> = found.keys().collect();
    match left {
        Left::Nothing => assert!(found.is_empty(), "{what} left {names:?}"),
        Left::Whole => {
            let changed_files = found.iter().filter(|(name, content)| whole.get(*name) != Some(content));
            let changed_names: Vec<_> = changed_files.map(|(name, _)| name).collect();
            assert!(changed_names.is_empty(), "{what} left parts of {changed_names:?}");
        }
    }
}

/// Commands that compute for seconds: they are tried at fewer places.
fn is_slow(command: &str) -> bool {
    ["identify", "diagnose", "report", "summarize", "init made --example"]
        .iter()
        .any(|slow| command.starts_with(slow))
}

/// Runs something for each writer, on both processors.
fn for_each_writer(check: impl Fn(&str, Left) + Sync) {
    let (even, odd): (Vec<_>, Vec<_>) =
        WRITERS.into_iter().enumerate().partition(|(number, _)| number % 2 == 0);
    thread::scope(|scope| {
        for share in [even, odd] {
            let check = &check;
            scope.spawn(move || share.into_iter().for_each(|(_, (command, left))| check(command, left)));
        }
    });
}

/// The files of an undisturbed run.
fn undisturbed(command: &str) -> BTreeMap<PathBuf, Vec<u8>> {
    let folder = folder();
    let original = files(folder.path());
    let output = guide(folder.path(), None, &words(command)).output().expect("guide starts");
    assert!(output.status.success(), "{command}: {}", String::from_utf8_lossy(&output.stderr));
    let whole = changed(&original, files(folder.path()));
    assert!(!whole.is_empty(), "{command} writes");
    whole
}

fn help_of(command: &[&str]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_guide")).args(command).arg("--help").output();
    String::from_utf8(output.expect("guide starts").stdout).expect("UTF-8")
}

/// The names in the list of commands.
fn names_of_commands(help: &str) -> Vec<String> {
    let list = help.split("Commands:").nth(1).and_then(|rest| rest.split("Options:").next());
    let lines = list.expect("a list of commands").lines().filter_map(|line| line.strip_prefix("  "));
    lines
        .filter(|line| !line.starts_with(' '))
        .filter_map(|line| line.split(' ').next())
        .map(str::to_owned)
        .collect()
}

#[test]
fn every_command_that_writes_is_in_the_table() {
    let tested_commands: BTreeSet<&str> =
        WRITERS.iter().filter_map(|(command, _)| command.split(' ').next()).collect();
    let mut writers = 0;
    for command in names_of_commands(&help_of(&[])) {
        let command = command.as_str();
        if command == "help" {
            continue;
        }
        let help = help_of(&[command]);
        if WRITING_OPTIONS.iter().any(|option| help.contains(option)) {
            writers += 1;
            assert!(
                tested_commands.contains(command) || WITH_A_DEVICE.contains(&command),
                "{command} writes and is not tried"
            );
        }
    }
    assert!(writers > 12, "{writers} commands with an option that names what is written");
}

#[test]
#[ignore = "takes half a minute: cargo xtask test --all runs it"]
fn a_disk_that_is_full_at_any_byte_is_reported_in_one_line_and_leaves_no_part_of_a_file() {
    for_each_writer(|command, left| {
        let whole = undisturbed(command);
        let sizes: BTreeSet<u64> = whole.values().map(|content| content.len() as u64).collect();
        let largest = sizes.last().copied().unwrap_or_default();
        // At the first byte, in the middle, and at the last of each file; of many files, the largest.
        let ends = sizes.iter().rev().take(2).map(|bytes| bytes.saturating_sub(1));
        let limits: BTreeSet<u64> = [0, largest / 2].into_iter().chain(ends).collect();
        for bytes in limits.into_iter().take(if is_slow(command) { 2 } else { 4 }) {
            let context = format!("{command} with {bytes} bytes a file");
            let folder = folder();
            let original = files(folder.path());
            let output = guide(folder.path(), Some(bytes), &words(command)).output().expect("guide starts");
            let line = failure(&output, &context);
            assert!(line.contains("File too large"), "{context}: {line}");
            assert_left(left, &changed(&original, files(folder.path())), &whole, &context);
            if bytes != largest / 2 {
                continue;
            }
            // Once there is room, it works.
            let again = guide(folder.path(), None, &words(command)).output().expect("guide starts");
            assert!(
                again.status.success(),
                "{context}, then again: {}",
                String::from_utf8_lossy(&again.stderr)
            );
            assert!(
                changed(&original, files(folder.path())) == whole,
                "{context}, then again, gives something else"
            );
        }
    });
}

#[test]
#[ignore = "takes half a minute: cargo xtask test --all runs it"]
fn a_name_that_cannot_be_written_is_reported_in_one_line_and_leaves_no_part_of_a_file() {
    for_each_writer(|command, left| {
        let whole = undisturbed(command);
        let inputs = files(folder().path());
        // Only the first and the last of many similar files, as manual pages, are checked.
        let new: Vec<&PathBuf> = whole.keys().filter(|name| !inputs.contains_key(*name)).collect();
        let chosen: BTreeSet<&PathBuf> =
            new.iter().take(3).chain(new.iter().rev().take(2)).copied().collect();
        for name in chosen.into_iter().take(if is_slow(command) { 1 } else { 5 }) {
            let context = format!("{command} with a folder in place of {}", name.display());
            let folder = folder();
            fs::create_dir_all(folder.path().join(name)).expect("a folder");
            let original = files(folder.path());
            let output = guide(folder.path(), None, &words(command)).output().expect("guide starts");
            let line = failure(&output, &context);
            assert!(
                line.contains(&*name.to_string_lossy()) || name.ends_with("session.toml"),
                "{context}: {line}"
            );
            assert_left(left, &changed(&original, files(folder.path())), &whole, &context);
        }
    });
}

/// A command that is killed has no time to clean up: hidden files may be left, and rows of a session's run. A kill within a write cuts the
/// last one, which a reader skips with a warning.
#[test]
#[ignore = "takes half a minute: cargo xtask test --all runs it"]
fn a_command_that_is_killed_at_any_moment_leaves_whole_files_and_readable_sessions() {
    const MOMENTS: u32 = 6;
    for_each_writer(|command, left| {
        // A few of the files that are whole one by one stand for all.
        if left == Left::Whole && !command.starts_with("man") {
            return;
        }
        let began = Instant::now();
        let whole = undisturbed(command);
        let takes = began.elapsed();
        for moment in 1..=MOMENTS {
            let context = format!("{command} killed at {moment} of {MOMENTS}");
            let folder = folder();
            let original = files(folder.path());
            let mut child = guide(folder.path(), None, &words(command)).spawn().expect("guide starts");
            thread::sleep(takes * moment / MOMENTS);
            child.kill().expect("killed");
            child.wait().expect("ended");
            for (name, content) in changed(&original, files(folder.path())) {
                let hidden =
                    name.file_name().is_some_and(|name| name.to_string_lossy().starts_with(".guide-"));
                if hidden || whole.get(&name) == Some(&content) {
                    continue;
                }
                // The lock is the kernel's and ends with the process; its file stays.
                if name.ends_with(".session.lock") {
                    continue;
                }
                // A session grows run by run; every state of it can be read.
                if name.ends_with("session.toml") {
                    let session = folder.path().join(name.parent().unwrap_or(Path::new("")));
                    let read = formats::session::Session::read(&session);
                    assert!(
                        read.is_ok(),
                        "{context}: {}",
                        read.err().map_or(String::new(), |error| error.to_string())
                    );
                    continue;
                }
                let rows = whole.get(&name).is_some_and(|all| all.starts_with(&content));
                assert!(rows && name.extension() == Some(OsStr::new("csv")), "{context}: {}", name.display());
            }
        }
    });
}

#[test]
fn a_result_that_standard_output_does_not_take_is_a_failure() {
    let folder = folder();
    for command in [
        "check . --json",
        "predict . --until 15 --json",
        "effects",
        "man",
        "completions bash",
        "info run.mcap",
    ] {
        let full =
            fs::OpenOptions::new().write(true).open("/dev/full").expect("the device that is always full");
        let output = guide(folder.path(), None, &words(command)).stdout(full).output().expect("guide starts");
        let line = failure(&output, command);
        assert!(line.contains("No space left"), "{command}: {line}");
    }
}
