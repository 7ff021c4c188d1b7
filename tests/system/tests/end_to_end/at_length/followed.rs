//! Faults that begin while the firmware measures: the comparison with the model says so within seconds.

use serde_json::Value;
use simulation::rig::NeedleLoad;
use simulation::rig::config::RigConfig;
use std::fs;
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};
use system::bench::Bench;
use system::cosim::Injection;
use system::images::build_guide;
use system::qemu::HANGS;

/// Rig seconds per second.
const SPEED: f64 = 8.0;
const SEED: u64 = 31;
/// Device time before the fault: more than the three seconds of rest in which noise and zero are learned.
const SOUND_MS: u64 = 6_000;
/// Time within which it is to be found, and what the force's time stamps may be off.
const FOUND_S: f64 = 2.0;
const STAMP_S: f64 = 0.2;

fn succeeds(arguments: &[&str]) -> Value {
    let output = Command::new(build_guide().unwrap()).args(arguments).arg("--json").output().unwrap();
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Waits for the device's time.
fn await_step(bench: &Bench, step: u64) {
    let began = Instant::now();
    while bench.rig().steps() < step {
        assert!(began.elapsed() < HANGS, "the rig stands");
        thread::sleep(Duration::from_millis(2));
    }
}

/// Records for twelve seconds with the needle displaced; the fault begins after six.
fn recorded(run: &str, fault: impl FnOnce(&Bench)) -> (Value, String, f64) {
    let bench = Bench::start(RigConfig::default(), SEED, SPEED, HANGS).unwrap();
    let port = bench.port();
    succeeds(&["home", "--port", &port]);
    succeeds(&["tare", "--port", &port]);
    succeeds(&["move", "--port", &port, "--y-mm", "1"]);
    let [rig, model, session] = ["rig.toml", "model.toml", run].map(|name| bench.folder().join(name));
    let needle = "[needle]\nyoungs_modulus_gpa = 200.0\nouter_diameter_mm = 1.27\ninner_diameter_mm = 1.0\n";
    fs::write(&rig, format!("{needle}[rig]\nguide2_mm = 60.0\nentry_mm = 70.0\n")).unwrap();
    let k_kpa = 1e-3 * bench.rig().rig(|rig| rig.truth().modulus_pa);
    let interval = format!("k_ci95_kpa = [{:.3}, {:.3}]", 0.98 * k_kpa, 1.02 * k_kpa);
    fs::write(&model, format!("[model]\nformat = 1\n[tissue]\nk_kpa = {k_kpa:.3}\n{interval}\n")).unwrap();
    let first = bench.rig().steps();
    let child = Command::new(build_guide().unwrap())
        .args(["record", "--json", "--port", &port, "--depth-mm", "30", "--duration-s", "12", "--no-raw"])
        .arg("--out")
        .arg(&session)
        .arg("--rig")
        .arg(&rig)
        .arg("--follow")
        .arg(&model)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    await_step(&bench, first + SOUND_MS);
    fault(&bench);
    let began_s = 1e-3 * bench.rig().steps() as f64;
    let output = child.wait_with_output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{stderr}");
    bench.stop().unwrap();
    (serde_json::from_slice(&output.stdout).unwrap(), stderr, began_s)
}

#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn a_force_that_jumps_and_a_needle_that_slips_are_found_within_two_seconds_and_nothing_without_a_fault() {
    let (document, stderr, _) = recorded("sound", |_| {});
    assert_eq!(document["followed"], serde_json::json!({"compared": true, "parted": []}), "{stderr}");
    let jump = |bench: &Bench| {
        bench.rig().inject(Injection { force_spike_n: Some([0.0, 0.4]), ..Injection::default() });
    };
    let slip = |bench: &Bench| {
        bench.rig().rig(|rig| {
            let stiffness_n_per_m = 0.4 * rig.truth().stiffness_n_per_m;
            rig.set_load(Some(NeedleLoad { at_m: [0.0; 2], force_n: [0.0; 2], stiffness_n_per_m }));
        });
    };
    for (name, fault) in [("jump", &jump as &dyn Fn(&Bench)), ("slip", &slip)] {
        let (document, stderr, began_s) = recorded(name, fault);
        let parted = document["followed"]["parted"].as_array().unwrap();
        let [parted] = parted.as_slice() else { panic!("{name}: {document:#}") };
        assert_eq!((&parted["axis"], &parted["channel"]), (&"y".into(), &"force".into()), "{name}");
        let delay_s = parted["found_s"].as_f64().unwrap() - began_s;
        assert!((-STAMP_S..FOUND_S + STAMP_S).contains(&delay_s), "{name}: {delay_s} s, {document:#}");
        assert!(stderr.contains("warning: the force along y no longer follows the model since "), "{stderr}");
        eprintln!(
            "{name}: found {delay_s:.2} s after it began, {:.0} sigma",
            parted["sigma"].as_f64().unwrap()
        );
    }
}
