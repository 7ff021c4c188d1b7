//! `guide bringup` on rigs that are wired wrong, and on a sound one. A fault of each kind is enough here: `cargo xtask study bringup` has
//! all of them, and many sound rigs.

use crate::in_minutes::library::eventually;
use device::link::Client;
use protocol::{CalibrationRecord, Text};
use simulation::rig::config::RigConfig;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use system::bench::Bench;
use system::bringup::{Score, score, trial};
use system::cosim::Fault;
use system::images::build_guide;
use system::qemu::HANGS;
use system::readme::{self, shell::Shell};
use system::wire::NoisyWire;

fn named(faults: &[&str]) {
    for (seed, text) in (100..).zip(faults) {
        let fault: Fault = text.parse().unwrap();
        let trial = trial(&[fault], seed).unwrap();
        println!("{text}\n{}", trial.report);
        assert_eq!(score(fault.kind, trial.report.findings()), Score::Named, "{text}");
        assert!(!trial.report.passed && trial.moved_mm <= 0.3, "{text}: {} mm", trial.moved_mm);
    }
}

#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn motors_and_potentiometers_that_are_wired_wrong_are_named() {
    named(&["leads-reversed:y", "motors-swapped", "potentiometer-reversed:x"]);
}

#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn faults_of_the_force_channels_are_named() {
    named(&["hum50:0.02", "force-turned:25"]);
}

#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn faults_of_stop_supply_and_link_are_named() {
    named(&["stop-not-wired", "brown-out:8", "clock:1.05"]);
}

#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn a_sound_rig_passes() {
    let trial = trial(&[], 200).unwrap();
    // The time that it takes is reported by the study: device time goes on while a busy computer lets the host wait.
    assert!(trial.report.passed, "{}", trial.report);
}

#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn the_page_shows_a_rig_without_a_fault() {
    let bench = Bench::start(RigConfig::default(), 22, 4.0, HANGS).unwrap();
    let shell = Shell::new(build_guide().unwrap(), bench.folder()).with_port(bench.port());
    readme::check_console("new", &shell).unwrap();
    bench.stop().unwrap();
}

#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn the_command_writes_its_result_and_fails_where_something_is_found() {
    let run = |fault: &str| {
        let bench = Bench::wired(RigConfig::default(), 7, 8.0, vec![fault.parse().unwrap()]).unwrap();
        let output_path = bench.folder().join("bringup.toml");
        let guide = build_guide().unwrap();
        let output = Command::new(guide)
            .args(["bringup", "--json", "--yes", "--no-clock", "--port", &bench.port(), "--out"])
            .arg(&output_path)
            .output()
            .unwrap();
        let document: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let kept_text = std::fs::read_to_string(output_path).unwrap();
        bench.stop().unwrap();
        (output.status.code(), document, kept_text)
    };
    let (code, document, kept_text) = run("leads-reversed:x");
    assert_eq!(code, Some(1));
    let motors = &document["steps"][5];
    assert_eq!((&motors["step"], &motors["result"]), (&"motors".into(), &"failed".into()), "{document:#}");
    assert_eq!(motors["findings"][0]["id"], "motor.leads_reversed");
    assert_eq!(document["steps"][6]["result"], "blocked");
    assert_eq!(document["steps"][2]["result"], "skipped");
    assert!(
        kept_text.contains("id = \"motor.leads_reversed\"") && kept_text.contains("passed = false"),
        "{kept_text}"
    );
}

#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn a_step_that_is_interrupted_or_cut_off_is_named_by_the_next_start_and_keeps_others_from_running() {
    let bench = Bench::wired(RigConfig::default(), 9, 8.0, vec![]).unwrap();
    let wire = NoisyWire::connect(Path::new(&bench.port()), 9).unwrap();
    let output_path = bench.folder().join("bringup.toml");
    let guide = build_guide().unwrap();
    let start = |steps: &[&str]| {
        let mut command = Command::new(&guide);
        command.args(["bringup", "--yes", "--no-clock", "--port", &wire.port(), "--out"]).arg(&output_path);
        for step in steps {
            command.args(["--step", step]);
        }
        command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
    };
    // Ends it once a line of it begins so.
    let end = |mut child: Child, line: &str, act: &dyn Fn(u32)| {
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
        lines.find(|text| text.starts_with(line)).expect("the step begins");
        let driven = || bench.rig().bridges_driven();
        eventually("it moves", driven);
        act(child.id());
        let texts: Vec<String> = lines.collect();
        let code = child.wait().unwrap().code();
        let start_step = bench.rig().steps();
        eventually("it is at rest", || bench.rig().steps() > start_step + 3_000 && !driven());
        (code, texts.join("\n"))
    };
    let interrupt =
        |id: u32| assert!(Command::new("kill").args(["-INT", &id.to_string()]).status().unwrap().success());
    let (code, text) = end(start(&["motors", "loop"]), "loop:", &interrupt);
    assert!(code == Some(1) && text.contains("interrupted in `loop`"), "{code:?} {text}");
    assert!(std::fs::read_to_string(&output_path).unwrap().contains("interrupted_in = \"loop\""));

    let blocked = start(&["force"]).wait_with_output().unwrap();
    let text = String::from_utf8(blocked.stderr).unwrap();
    assert_eq!(blocked.status.code(), Some(1), "{text}");
    assert!(text.contains("interrupted in `loop`"), "{text}");

    let (code, text) = end(start(&["loop"]), "loop:", &|_| wire.cut());
    assert_eq!(code, Some(1), "{text}");
    assert!(std::fs::read_to_string(&output_path).unwrap().contains("interrupted_in = \"loop\""));
    bench.stop().unwrap();
}

#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn the_last_step_stores_a_calibration_and_reads_it_back_and_one_that_is_cut_off_is_named_by_the_next_start() {
    let bench = Bench::wired(RigConfig::default(), 10, 8.0, vec![]).unwrap();
    let wire = NoisyWire::connect(Path::new(&bench.port()), 10).unwrap();
    let (output_path, file) = (bench.folder().join("bringup.toml"), bench.folder().join("unit-7.toml"));
    let guide = build_guide().unwrap();
    let device = || Client::connect(&wire.port()).unwrap().calibration().unwrap();
    let nominal = device();
    let unit = CalibrationRecord { id: Text::new("unit-7"), ..nominal.clone() };
    formats::calibration_file::write(&file, &unit).unwrap();
    let bringup = |steps: &[&str]| {
        let mut command = Command::new(&guide);
        command.args(["bringup", "--yes", "--no-clock", "--port", &wire.port(), "--calibration"]).arg(&file);
        command.arg("--out").arg(&output_path).args(steps.iter().flat_map(|step| ["--step", step]));
        command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    };
    // The plug is pulled as the step begins: the device has one calibration or the other, whole.
    let mut cut = bringup(&["store"]);
    let mut lines = BufReader::new(cut.stderr.take().unwrap()).lines().map(Result::unwrap);
    lines.find(|text| text.starts_with("store:")).expect("the step begins");
    wire.cut();
    assert_eq!((cut.wait().unwrap().code(), lines.next().is_some()), (Some(1), true));
    assert!(std::fs::read_to_string(&output_path).unwrap().contains("interrupted_in = \"store\""));
    wire.mend();
    let stored = device();
    assert!(stored == nominal || stored == unit, "{stored:?}");

    let again = bringup(&["link", "store"]).wait_with_output().unwrap();
    let [stdout, stderr] = [again.stdout, again.stderr].map(|text| String::from_utf8(text).unwrap());
    assert!(again.status.success() && stderr.contains("interrupted in `store`"), "{stderr}");
    assert!(stdout.contains("store           passed") && stdout.contains("calibration unit-7"), "{stdout}");
    assert_eq!(device(), unit);
    bench.stop().unwrap();
}
