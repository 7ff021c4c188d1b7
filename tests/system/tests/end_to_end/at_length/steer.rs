//! `guide steer` on the firmware: the needle arrives, and each thing that can go wrong ends in a hold with a named cause, a complete
//! record, and a replay that ends by the same.

use serde_json::Value;
use simulation::rig::config::RigConfig;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::thread;
use std::time::{Duration, Instant};
use system::bench::Bench;
use system::cosim::Injection;
use system::images::build_guide;
use system::needle;
use system::qemu::HANGS;

const XTASK: &str = env!("CARGO_BIN_EXE_system");
/// Rig seconds per second: as fast as it goes.
const SPEED: f64 = 50.0;
/// Seed of needle and rig.
const SEED: u64 = 26;

fn guide(arguments: &[&str]) -> Output {
    Command::new(build_guide().unwrap()).args(arguments).stdin(Stdio::null()).output().unwrap()
}

fn succeeds(arguments: &[&str]) -> Value {
    let output = guide(&[arguments, &["--json"]].concat());
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// A bench with guide 2 at home and its force tared.
fn bench(seed: u64) -> Bench {
    let bench = Bench::start(RigConfig::default(), seed, SPEED, HANGS).unwrap();
    succeeds(&["home", "--port", &bench.port()]);
    succeeds(&["tare", "--port", &bench.port()]);
    bench
}

/// `guide steer` of a needle, just started.
fn steering(bench: &Bench, seed: u64, more: &str) -> Child {
    let [x_mm, y_mm, depth_mm] = needle::drawn(seed).unwrap().target_mm;
    let tip = format!("{}{more}", needle::command(Path::new(XTASK), &bench.rig().needle(), seed));
    Command::new(build_guide().unwrap())
        .arg("steer")
        .arg(bench.folder().join("steered"))
        .args(["--port", &bench.port(), "--tip", &tip, &format!("--target-mm={x_mm},{y_mm},{depth_mm}")])
        .arg("--json")
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// The document of a run, whether it succeeded, and its errors.
fn ended(child: Child) -> (Value, bool, String) {
    let output = child.wait_with_output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    let document = serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("no document: {stderr}"));
    (document, output.status.success(), stderr)
}

fn lines(record: &Path, kind: &str) -> Vec<Value> {
    let text = fs::read_to_string(record).unwrap_or_default();
    let whole = text.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
    whole.filter_map(|line| line.get(kind).cloned()).collect()
}

/// The record of the run that is under way: that with the highest number.
fn newest(bench: &Bench) -> PathBuf {
    let folder = bench.folder().join("steered");
    file_name((1..).take_while(|number| file_name(*number, &folder).exists()).last().unwrap_or(1), &folder)
}

fn file_name(number: usize, folder: &Path) -> PathBuf {
    match number {
        1 => folder.join("steer.jsonl"),
        _ => folder.join(format!("steer-{number}.jsonl")),
    }
}

/// Waits until a run has decided so often.
fn await_decisions(bench: &Bench, before: &Path, count: usize) {
    let began = Instant::now();
    while newest(bench) == before || lines(&newest(bench), "decision").len() < count {
        assert!(began.elapsed() < HANGS, "no {count} decisions");
        thread::sleep(Duration::from_millis(10));
    }
}

/// Checks the state that every fault has to leave: its name, a complete record, a needle and a guide that are held, and
/// a replay that ends by the same.
fn assert_held(bench: &Bench, (document, succeeded, stderr): (Value, bool, String), name: &str) {
    assert!(!succeeded && document["fault"]["name"] == name, "{name}: {document} {stderr}");
    assert!(stderr.contains(&format!("error: {name}: ")), "{stderr}");
    let record = PathBuf::from(document["record"].as_str().unwrap());
    let fault = lines(&record, "fault").pop().expect("the record ends with the fault");
    assert_eq!(fault, document["fault"], "{name}");
    assert!(!lines(&record, "decision").is_empty(), "{name}: nothing was decided before");
    // Every command but a last one that failed is answered, and the needle stays where it was commanded last.
    let (commands, answers) = (lines(&record, "command"), lines(&record, "plant"));
    assert!(answers.len() - 1 == commands.len() || answers.len() == commands.len(), "{name}");
    // The guide: no bridge is driven any more. If the plug was pulled the guide is not driven.
    let released = bench.rig().released_since().is_some();
    assert!(released || name == "device_gone", "{name}: a bridge is driven");
    let again = guide(&["steer", "--replay", record.to_str().unwrap(), "--json"]);
    let replayed: Value = serde_json::from_slice(&again.stdout).unwrap();
    assert_eq!(replayed["fault"], document["fault"], "{}", String::from_utf8_lossy(&again.stderr));
}

#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn the_needle_arrives_through_the_firmware_within_limits_and_the_record_replays() {
    let unsteered_mm = needle::drawn(SEED).unwrap().unsteered_mm;
    let bench = bench(SEED);
    let (document, succeeded, stderr) = ended(steering(&bench, SEED, ""));
    assert!(succeeded, "{stderr}");
    let run = &document["run"];
    assert_eq!((&run["outcome"]["kind"], &run["depth_mm"]), (&"arrived".into(), &100.0.into()));
    let miss_mm = run["miss_mm"].as_f64().unwrap();
    assert!(miss_mm < 0.5 * unsteered_mm, "{miss_mm} mm, unsteered {unsteered_mm} mm");
    for (limit, count) in run["end"]["limits_broken"].as_object().unwrap() {
        assert_eq!(count, 0, "{limit}");
    }
    // The firmware measured the force of the needle, and not of the rig's own.
    let peak_n = run["peak_force_n"].as_f64().unwrap();
    let true_n = run["end"]["peak_force_n"].as_f64().unwrap();
    assert!((peak_n - true_n).abs() < 0.3 && true_n > 0.3, "{peak_n} N measured, {true_n} N true");
    let replayed = succeeds(&["steer", "--replay", document["record"].as_str().unwrap()]);
    assert_eq!(replayed["run"], document["run"]);
    bench.stop().unwrap();
}

/// A force that is off by something the controller does not know of is reported on the way, in the record and in the document; the run goes on.
#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn a_force_that_jumps_on_the_way_is_reported_and_the_run_goes_on() {
    let bench = bench(SEED);
    let (document, succeeded, stderr) = ended(steering(&bench, SEED, ""));
    assert!(succeeded && document["followed"]["force_compared"] == true, "{stderr}");
    assert_eq!(document["followed"]["parted"], serde_json::json!([]), "{stderr}");
    let sound = newest(&bench);
    succeeds(&["home", "--port", &bench.port()]);
    let child = steering(&bench, SEED, "");
    await_decisions(&bench, &sound, 6);
    bench.rig().inject(Injection { force_spike_n: Some([0.0, 1.0]), ..Injection::default() });
    let (document, _, stderr) = ended(child);
    let parted = &document["followed"]["parted"][0];
    assert_eq!((&parted["channel"], &parted["axis"]), (&"force".into(), &"y".into()), "{document:#}");
    let words = "warning: the force along y no longer follows the model since ";
    assert!(stderr.contains(words), "{stderr}");
    assert_eq!(lines(&newest(&bench), "parted").first(), Some(parted));
}

#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn whatever_fails_ends_in_a_hold_with_its_name() {
    let mut bench = bench(SEED);
    for (failure, name) in [
        ("silent", "tip_silent"),
        ("frozen", "tip_frozen"),
        ("jumping", "tip_outside_band"),
        ("late", "tip_late"),
        ("let-go", "needle_off_depth"),
    ] {
        let failing = steering(&bench, SEED, &format!(" --fails {failure} --beyond-mm 22"));
        assert_held(&bench, ended(failing), name);
        succeeds(&["home", "--port", &bench.port()]);
    }
    // If guide 2 is not at home no run begins.
    succeeds(&["move", "--port", &bench.port(), "--y-mm", "1"]);
    let (document, succeeded, stderr) = ended(steering(&bench, SEED, ""));
    assert!(!succeeded && document["fault"]["name"] == "guide_not_home", "{document}");
    assert!(stderr.contains("run `guide home` first"), "{stderr}");
    let mut previous = newest(&bench);
    succeeds(&["home", "--port", &bench.port()]);
    // The emergency stop is pressed on the way.
    let child = steering(&bench, SEED, "");
    await_decisions(&bench, &previous, 3);
    bench.rig().press_stop(true);
    assert_held(&bench, ended(child), "emergency_stop");
    previous = newest(&bench);
    bench.rig().press_stop(false);
    succeeds(&["clear", "--port", &bench.port()]);
    succeeds(&["home", "--port", &bench.port()]);
    // An interlock: the force leaps beyond its limit while the needle is steered.
    let child = steering(&bench, SEED, "");
    await_decisions(&bench, &previous, 3);
    bench.rig().inject(Injection { force_spike_n: Some([4.5, 0.0]), ..Injection::default() });
    assert_held(&bench, ended(child), "device_fault");
    previous = newest(&bench);
    bench.rig().inject(Injection::default());
    succeeds(&["clear", "--port", &bench.port()]);
    succeeds(&["home", "--port", &bench.port()]);
    // The user interrupts.
    let child = steering(&bench, SEED, "");
    await_decisions(&bench, &previous, 3);
    rustix::process::kill_process(rustix::process::Pid::from_child(&child), rustix::process::Signal::INT)
        .unwrap();
    assert_held(&bench, ended(child), "interrupted");
    previous = newest(&bench);
    succeeds(&["home", "--port", &bench.port()]);
    // The plug is pulled.
    let child = steering(&bench, SEED, "");
    await_decisions(&bench, &previous, 3);
    bench.pull_the_plug();
    assert_held(&bench, ended(child), "device_gone");
}
