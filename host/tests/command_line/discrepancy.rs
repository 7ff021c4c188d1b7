//! Any forward model behind `guide discrepancy`: here a process that answers lines of JSON, written for the shell of any system with Python.

use super::{failure, folder, json, path, text};
use serde_json::Value;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A mass on a rail that is said to have viscous friction alone.
const RAIL: &str = r#"
import json, sys

runs = {}
for line in sys.stdin:
    request = json.loads(line)
    if request["type"] == "start":
        speed = {"name": "speed", "unit": "m/s"}
        answer = {
            "parameters": [
                {"name": "mass", "unit": "kg", "mean": 2.0, "sd": 2.0},
                {"name": "viscous", "unit": "N s/m", "mean": 1.0, "sd": 1.0},
            ],
            "sites": [{"name": "friction", "unit": "N", "adds_to": "force", "regressors": [speed]}],
            "channels": [{"name": "force", "unit": "N"}],
        }
    elif request["type"] == "run":
        runs[request["run"]] = request["columns"]
        continue
    else:
        columns, p = runs[request["run"]], request["parameters"]
        pairs = zip(columns["acceleration"], columns["speed"])
        answer = {"channels": {"force": [p["mass"] * a + p["viscous"] * v for a, v in pairs]}}
    print(json.dumps(answer), flush=True)
"#;

/// The record of a rail of 2.2 kg and 0.8 N s/m with a hidden dry friction.
fn record(folder: &Path, name: &str, turn_hz: f64, dry_n: f64) -> PathBuf {
    let mut rows = "time_s,acceleration,speed,force\n".to_owned();
    for i in 0..400_u32 {
        let time_s = 0.01 * f64::from(i);
        let phase = turn_hz * time_s;
        let speed = phase.sin() + 0.3 * (2.3 * phase).sin();
        let acceleration = turn_hz * (phase.cos() + 0.69 * (2.3 * phase).cos());
        // Reproducible noise: a chaotic map.
        let noise = 0.05 * (f64::from(i * i * 7919 % 1009) / 504.5 - 1.0);
        let force = 2.2 * acceleration + 0.8 * speed + dry_n * speed.signum() + noise;
        writeln!(rows, "{time_s},{acceleration},{speed},{force}").expect("text");
    }
    let file = folder.join(name);
    fs::write(&file, rows).expect("written");
    file
}

/// Arguments for two records with this dry friction; nothing, with a printed line, without Python.
fn arguments(folder: &Path, dry_n: f64) -> Option<Vec<String>> {
    if Command::new("python3").arg("--version").output().is_err() {
        println!("skipped: there is no python3");
        return None;
    }
    let model = folder.join("rail.py");
    fs::write(&model, RAIL).expect("written");
    let [slow, fast] =
        [("slow.csv", 3.0), ("fast.csv", 4.0)].map(|(name, hz)| record(folder, name, hz, dry_n));
    let command = format!("python3 '{}'", path(&model));
    let words = ["discrepancy", "--model-command", &command, path(&slow), "--judge", path(&fast), "--json"];
    Some(words.map(str::to_owned).to_vec())
}

fn borrowed(words: &[String]) -> Vec<&str> {
    words.iter().map(String::as_str).collect()
}

#[test]
fn a_hidden_friction_is_named_with_its_size_and_none_where_there_is_none() {
    let folder = folder();
    let Some(words) = arguments(folder.path(), 0.5) else { return };
    let report = json(&borrowed(&words));
    assert_eq!(report["schema"], "discrepancy.diagnosis/1");
    let terms = report["terms"].as_array().expect("laws");
    assert_eq!(terms.len(), 1, "{report}");
    let law = &terms[0];
    assert_eq!(
        (&law["site"], &law["form"], &law["is_named"]),
        (&"friction".into(), &"sign".into(), &true.into())
    );
    assert!(interval_end(0, law) < 0.5 && 0.5 < interval_end(1, law), "{law}");
    let held_out = &report["channels"][0]["held_out"];
    assert!(misfit("after", held_out) < 0.5 * misfit("before", held_out), "{held_out}");

    let words = arguments(folder.path(), 0.0).expect("Python as before");
    let report = json(&borrowed(&words));
    assert_eq!((&report["verdict"], &report["terms"]), (&"adequate".into(), &Value::Array(Vec::new())));
}

fn misfit(key: &str, held_out: &Value) -> f64 {
    held_out[key].as_f64().expect("a misfit")
}

fn interval_end(index: usize, law: &Value) -> f64 {
    law["values"][0]["ci95"][index].as_f64().expect("an end")
}

#[test]
fn faults_of_a_call_are_told() {
    let folder = folder();
    let Some(mut words) = arguments(folder.path(), 0.5) else { return };
    words.extend(["--try", "friction/speed/jump"].map(str::to_owned));
    let message = failure(&borrowed(&words));
    assert!(message.contains("--try") && message.contains("\"jump\" is none of the forms"), "{message}");

    let file = folder.path().join("slow.csv");
    let rows = text(&fs::read(&file).expect("readable"));
    fs::write(&file, rows.replacen("force", "load", 1)).expect("written");
    let words = arguments_of_existing(folder.path());
    let message = failure(&borrowed(&words));
    assert!(message.contains("no column \"force\"") && message.contains("slow.csv"), "{message}");
}

/// The same call with the files as they are.
fn arguments_of_existing(folder: &Path) -> Vec<String> {
    let [model, slow] = ["rail.py", "slow.csv"].map(|name| folder.join(name));
    let command = format!("python3 '{}'", path(&model));
    ["discrepancy", "--model-command", &command, path(&slow), "--json"].map(str::to_owned).to_vec()
}
