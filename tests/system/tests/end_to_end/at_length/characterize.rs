//! `guide characterize` with the runs in air that the device makes for it.

use formats::session::Session;
use serde_json::Value;
use simulation::rig::config::{HiddenEffect, RigConfig};
use std::process::{Command, Output, Stdio};
use system::bench::Bench;
use system::images::build_guide;
use system::qemu::HANGS;

const XTASK: &str = env!("CARGO_BIN_EXE_system");
/// Clearance at guide 2, millimetres.
const CLEARANCE_MM: f64 = 0.12;

fn characterize(bench: &Bench, arguments: &[&str]) -> Output {
    let rig = bench.folder().join("rig.toml");
    std::fs::write(
        &rig,
        "[needle]\nyoungs_modulus_gpa = 200.0\nouter_diameter_mm = 1.27\ninner_diameter_mm = 1.0\n\
         [rig]\nguide2_mm = 60.0\nentry_mm = 70.0\n\
         [noise]\nforce_n = 0.005\ndisplacement_mm = 0.02\nshape_mm = 0.03\n",
    )
    .unwrap();
    Command::new(build_guide().unwrap())
        .current_dir(bench.folder())
        .args(["characterize", "--json", "--session", "air", "--port", &bench.port(), "--rig", "rig.toml"])
        .args(arguments)
        .stdin(Stdio::null())
        .output()
        .unwrap()
}

fn parameter<'a>(document: &'a Value, effect: &str) -> &'a Value {
    let mut parameters = document["parameters"].as_array().unwrap().iter();
    parameters.find(|one| one["effect"] == effect).unwrap_or_else(|| panic!("no {effect} in {document:#}"))
}

#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn the_runs_that_the_device_makes_show_what_is_loose_in_the_rig() {
    let mut config = RigConfig::default();
    config.simulation.depth_mm = 0.0;
    config.simulation.effects =
        vec![HiddenEffect { id: "rig.backlash".to_owned(), values: vec![CLEARANCE_MM] }];
    let bench = Bench::start(config, 31, 8.0, HANGS).unwrap();
    let sweep = format!("'{XTASK}' sweep --socket '{}'", bench.rig().ultrasound().display());
    let output = characterize(&bench, &["--runs", "1", "--sweep-command", &sweep, "--out", "found.toml"]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}");
    assert!(stderr.contains("guide 2 goes to 4.0 mm on both sides of zero"), "{stderr}");
    let document: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(document["runs"], serde_json::json!(["air-y-1", "air-x-1"]), "{document:#}");
    for run in document["recorded"].as_array().unwrap() {
        assert_eq!((&run["samples_missing"], &run["sweeps"]), (&0.into(), &5.into()), "{run:#}");
    }
    let backlash = parameter(&document, "rig.backlash");
    // The study of rigs in air measures the coverage of its interval; one rig must be found to a twentieth.
    let [low, high] = [0, 1].map(|end| backlash["ci95"][end].as_f64().unwrap());
    let error_mm = (0.5 * (low + high) - CLEARANCE_MM).abs();
    assert!(error_mm < 0.05 * CLEARANCE_MM && high - low < 0.06, "{backlash:#}");
    assert_eq!(backlash["standing"], "identified");

    // Each run has its own zero, from a tare at rest, and both are in the session in any case.
    let session = Session::read(&bench.folder().join("air")).unwrap();
    assert!(session.lateral.iter().all(|run| run.is_in_air() && run.force.time_s.len() > 30_000));
    let zero_n = session.lateral[0].force.force_y_n.iter().take(1_000).sum::<f64>() / 1e3;
    assert!(zero_n.abs() < 0.02, "the run begins at {zero_n} N");
    assert!(std::fs::read_to_string(bench.folder().join("found.toml")).unwrap().contains("rig.backlash"));

    // A characterization is valid for one rig at one time.
    let again = characterize(&bench, &[]);
    let stderr = String::from_utf8_lossy(&again.stderr);
    assert!(!again.status.success() && stderr.contains("has runs in air already (air-y-1)"), "{stderr}");
    bench.stop().unwrap();
}
