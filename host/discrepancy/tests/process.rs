//! A model in plain Python behind lines of JSON, and what it may do wrong.

use discrepancy::process::ProcessModel;
use discrepancy::*;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

/// A tank that drains by the square root of its level. `FAULT` is what it does wrong.
const MODEL: &str = r#"
import bisect, json, math, sys, time

FAULT = sys.argv[1]

def law(term, x):
    xs, ys = term["x"], term["y"]
    if term["regressor"] is None:
        return ys[0]
    i = min(max(bisect.bisect_right(xs, x), 1), len(xs) - 1)
    return ys[i - 1] + (ys[i] - ys[i - 1]) * (x - xs[i - 1]) / (xs[i] - xs[i - 1])

def predict(run, p, terms):
    level, levels = 4.0, []
    for u in run["columns"]["pump"]:
        levels.append(level)
        rate = p["pump"] * u - p["outflow"] * math.sqrt(max(level, 0.0)) + sum(law(t, level) for t in terms)
        level = max(level + rate, 0.0)
    return levels

runs = {}
for line in sys.stdin:
    request = json.loads(line)
    if request["type"] == "start":
        answer = {
            "parameters": [
                {"name": "outflow", "unit": "cm^0.5/s", "mean": 0.3, "sd": 0.15, "range": [0, 5]},
                {"name": "pump", "unit": "cm/(V s)", "mean": 0.5, "sd": 0.25, "range": [0, 5]},
            ],
            "sites": [{"name": "balance", "unit": "cm/s", "regressors": [{"name": "level", "unit": "cm", "range": [0, 14]}]}],
            "channels": [{"name": "level", "unit": "cm"}],
        }
    elif request["type"] == "run":
        runs[request["run"]] = request
        continue
    else:
        levels = predict(runs[request["run"]], request["parameters"], request["terms"])
        if FAULT == "nan":
            levels[7] = None
        if FAULT == "size":
            levels = levels[:-1]
        if FAULT == "slow":
            time.sleep(60)
        if FAULT == "leaves":
            sys.exit(3)
        answer = {"channels": {"level": levels}}
        if FAULT == "fails":
            answer = {"error": "the integrator diverged"}
        if FAULT == "babbles":
            print("fine so far")
            continue
    print(json.dumps(answer), flush=True)
"#;

/// The run of a tank with an overflow above 9 cm, in steps of a second as the model has them.
fn run(name: &str, turn: f64, judges: bool) -> Run {
    let mut level: f64 = 4.0;
    let (mut levels, mut pumps) = (Vec::new(), Vec::new());
    for i in 0..300u32 {
        let phase = f64::from(i) / turn;
        let pump = 1.8 + 0.9 * phase.sin() + 0.5 * (2.3 * phase).sin();
        // Reproducible noise: a chaotic map.
        let noise = 0.02 * (f64::from(i * i * 7919 % 1009) / 504.5 - 1.0);
        levels.push(level + noise);
        pumps.push(pump);
        level += 0.55 * pump - 0.34 * level.sqrt() - 0.3 * (level - 9.0).max(0.0);
    }
    Run {
        name: name.to_owned(),
        time_s: (0..300).map(f64::from).collect(),
        channels: vec![Channel {
            name: "level".to_owned(),
            unit: "cm".to_owned(),
            values: levels,
            sds: None,
        }],
        columns: vec![Column { name: "pump".to_owned(), unit: "V".to_owned(), values: pumps }],
        judges,
    }
}

/// The result with a model that does something wrong; nothing, with a printed line, without Python.
fn diagnosed(fault: &str, folder: &Path) -> Option<Result<Report, Error>> {
    if Command::new("python3").arg("--version").output().is_err() {
        println!("skipped: there is no python3");
        return None;
    }
    let path = folder.join("model.py");
    std::fs::write(&path, MODEL).expect("written");
    let arguments = [path.display().to_string(), fault.to_owned()];
    // A start takes as long as the machine needs; a slow model sleeps for much longer than the time-out of its predictions.
    let model = ProcessModel::start("python3", &arguments, Duration::from_secs(120)).expect("a model");
    let model = if fault == "slow" { model.with_timeout(Duration::from_secs(1)) } else { model };
    let data = Data::new(vec![run("slow", 29.0, false), run("fast", 23.0, true)]).expect("data");
    Some(diagnose(&model, &data, &Options::default(), &|_| ()))
}

#[test]
fn a_process_in_python_is_diagnosed() {
    let folder = tempfile::tempdir().expect("a folder");
    let Some(result) = diagnosed("none", folder.path()) else { return };
    let report = result.expect("a result");
    assert_eq!(report.terms.len(), 1, "{report}");
    assert_eq!(report.terms[0].law.id(), "balance/level/above_level", "{report}");
    let level = &report.terms[0].values[1];
    assert!((level.value - 9.0).abs() < 0.3, "{report}");
}

#[test]
fn every_fault_of_a_process_has_its_message() {
    let cases = [
        ("nan", "the model predicts NaN in run slow, channel level, reading 8 (at 7 s)"),
        ("size", "the model predicts 299 values of level in run slow; expected 300, one per instant"),
        ("slow", "no answer within 1 s"),
        ("leaves", "the model process has ended with exit status: 3"),
        ("fails", "the integrator diverged"),
        ("babbles", "the model answered \"fine so far\""),
    ];
    for (fault, expected) in cases {
        let folder = tempfile::tempdir().expect("a folder");
        let Some(result) = diagnosed(fault, folder.path()) else { return };
        let message = result.expect_err(fault).to_string();
        assert!(message.contains(expected), "{fault}: {message}");
    }
}

#[test]
fn a_program_that_does_not_exist_is_named() {
    let started = ProcessModel::start("no-such-model", &[], Duration::from_secs(1));
    assert!(started.err().is_some_and(|error| error.to_string().contains("cannot start \"no-such-model\"")));
}
