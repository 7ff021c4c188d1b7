//! `guide characterize` on a device: runs in air that are interrupted, unplugged and killed on the way, and what is found of the rig in the end.

use super::library::eventually;
use simulation::rig::config::{HiddenEffect, RigConfig};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use system::bench::Bench;
use system::images::build_guide;
use system::qemu::HANGS;
use system::wire::NoisyWire;

const XTASK: &str = env!("CARGO_BIN_EXE_system");
const RIG: &str = "[needle]\nyoungs_modulus_gpa = 200.0\nouter_diameter_mm = 1.27\ninner_diameter_mm = 1.0\n\
                   [rig]\nguide2_mm = 60.0\nentry_mm = 70.0\n";
/// Clearance and clamp of the rig, in the units of their parameters.
const CLEARANCE_MM: f64 = 0.12;
const CLAMP: f64 = 0.4;

fn in_air() -> RigConfig {
    let mut config = RigConfig::default();
    config.simulation.depth_mm = 0.0;
    let effect = |id: &str, value| HiddenEffect { id: id.to_owned(), values: vec![value] };
    config.simulation.effects =
        vec![effect("rig.backlash", CLEARANCE_MM), effect("rig.clamp_compliance", CLAMP)];
    config
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn runs_in_air_that_end_early_are_not_used_and_the_next_start_goes_on_with_them() {
    let bench = Bench::start(in_air(), 31, 50.0, HANGS).unwrap();
    let wire = NoisyWire::connect(Path::new(&bench.port()), 31).unwrap();
    let folder = bench.folder();
    let (rig_file, air, file) =
        (folder.join("rig.toml"), folder.join("air"), folder.join("characterized.toml"));
    std::fs::write(&rig_file, RIG).unwrap();
    let sweep = format!("'{XTASK}' sweep --socket '{}'", bench.rig().ultrasound().display());
    let guide = build_guide().unwrap();
    let start = || {
        let mut command = Command::new(&guide);
        command.args(["characterize", "--json", "--port", &wire.port(), "--repeats", "1"]);
        command.args(["--force-gain-sd", "0.01", "--sweep-command", &sweep]);
        command.arg("--rig").arg(&rig_file).arg("--session").arg(&air).arg("--out").arg(&file);
        command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    };
    let driven = || bench.rig().bridges_driven();
    // Ends it once guide 2 moves in a run; its exit code and what it printed from the run on.
    let end = |mut child: Child, run: &str, act: &dyn Fn(&mut Child)| {
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
        let begins = lines.find(|text| text.contains(&format!("{run}: ")) && text.contains("steps"));
        assert!(begins.is_some(), "{run} begins");
        eventually("it moves", driven);
        act(&mut child);
        let texts: Vec<String> = lines.collect();
        let code = child.wait().unwrap().code();
        let since = bench.rig().steps();
        eventually("it is at rest", || bench.rig().steps() > since + 3_000 && !driven());
        assert!(!file.exists(), "nothing half-characterised is written");
        (code, texts.join("\n"))
    };
    let (code, text) = end(start(), "air-x-1", &|child| {
        let interrupt = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
        assert!(interrupt.success());
    });
    assert_eq!(code, Some(1), "{text}");
    assert!(text.contains("air-x-1: 1 of 2 runs in air are complete, nothing of this one is used"), "{text}");

    let (code, text) = end(start(), "air-x-1", &|_| wire.cut());
    assert!(code == Some(1) && text.contains("1 of 2 runs in air are complete"), "{code:?} {text}");
    wire.mend();
    let (code, _) = end(start(), "air-x-1", &|child| child.kill().unwrap());
    assert_eq!(code, None, "killed");

    let whole = start().wait_with_output().unwrap();
    let [stdout, stderr] = [whole.stdout, whole.stderr].map(|text| String::from_utf8(text).unwrap());
    assert!(whole.status.success(), "{stderr}");
    assert!(stderr.contains("1 of 2 runs in air are complete; next: air-x-1"), "{stderr}");
    let document: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    let warnings = document["warnings"].to_string();
    assert!(warnings.contains("air-x-1 ended early"), "{warnings}");
    assert_eq!(document["runs"].as_array().map(Vec::len), Some(2), "{:#}", document["runs"]);
    for (effect, truth, within) in [
        ("rig.backlash", CLEARANCE_MM, 0.02),
        ("rig.clamp_compliance", CLAMP, 0.2),
        ("rig.friction", 0.0, 0.005),
    ] {
        let parameters = document["parameters"].as_array().unwrap();
        let found = parameters.iter().find(|one| one["effect"] == effect).unwrap();
        let off = found["value"].as_f64().unwrap() - truth;
        assert!(off.abs() < within, "{effect}: {found}");
    }
    let kept = std::fs::read_to_string(&file).unwrap();
    assert!(kept.contains("rig.backlash") && kept.contains("learned_from = \"air, 20"), "{kept}");

    // All runs are there: nothing moves, and the result is the same.
    let since = bench.rig().rig(|rig| rig.position_m());
    let again = start().wait_with_output().unwrap();
    let stderr = String::from_utf8(again.stderr).unwrap();
    assert!(again.status.success() && stderr.contains("nothing is moved"), "{stderr}");
    assert_eq!(String::from_utf8(again.stdout).unwrap(), stdout);
    assert_eq!(bench.rig().rig(|rig| rig.position_m()), since);
    bench.stop().unwrap();
}
