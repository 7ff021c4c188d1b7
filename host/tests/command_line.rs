//! The program `guide` on sessions on disk, as a user or a script calls it.

use formats::session::{ForceRow, Noise, Session, SessionWriter, Setup, ShapeRow};
use mechanics::{Beam, Foundation, Model, Needle, Rig};
use serde_json::Value;
use simulation::rig::SimulatedRig;
use simulation::rig::config::RigConfig;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};
use tempfile::TempDir;

#[path = "command_line/begin.rs"]
mod begin;
#[path = "command_line/bundle.rs"]
mod bundle;
#[path = "command_line/check.rs"]
mod check;
#[path = "command_line/clocks.rs"]
mod clocks;
#[path = "command_line/discrepancy.rs"]
mod discrepancy;
#[path = "command_line/draws.rs"]
mod draws;
#[path = "command_line/many.rs"]
mod many;
#[path = "command_line/models.rs"]
mod models;
#[path = "command_line/monitor.rs"]
mod monitor;
#[path = "command_line/plan_path.rs"]
mod plan_path;
#[path = "command_line/rejected.rs"]
mod rejected;
#[path = "command_line/report.rs"]
mod report;
#[path = "command_line/shapes.rs"]
mod shapes;
#[path = "command_line/shell.rs"]
mod shell;
#[path = "command_line/tables.rs"]
mod tables;
#[path = "command_line/ultrasound.rs"]
mod ultrasound;

const K_PA: f64 = 12e3;

fn rig() -> Rig {
    Rig::two_guides(Needle::gauge_18(), 0.06, 0.07)
}

fn guide(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_guide")).args(arguments).output().expect("guide starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Standard output of a command that succeeds, as JSON.
fn json(arguments: &[&str]) -> Value {
    let output = guide(arguments);
    assert!(output.status.success(), "{}", text(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("one JSON document")
}

/// The one line of a command that fails; with `--json` standard output has the failure as a document.
fn failure(arguments: &[&str]) -> String {
    let output = guide(arguments);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    if arguments.contains(&"--json") {
        let document: Value = serde_json::from_slice(&output.stdout).expect("one JSON document");
        assert_eq!(document["schema"], "guide.failure/1", "{document}");
    } else {
        assert!(output.stdout.is_empty());
    }
    text(&output.stderr).lines().last().unwrap_or_default().to_owned()
}

fn path(folder: &Path) -> &str {
    folder.to_str().expect("UTF-8")
}

fn writer(folder: &Path) -> SessionWriter {
    let noise = Noise { tip_m: Some(0.06e-3), ..Noise::default() };
    SessionWriter::open(
        folder,
        &Setup {
            name: "simulated".to_owned(),
            rig: rig(),
            fixture_mass_kg: None,
            noise,
            tissue: Default::default(),
        },
    )
    .expect("a session")
}

/// Rest, push of 1.2 mm, hold; a shape with rounding for noise.
fn add_lateral_run(session: &mut SessionWriter) {
    let beam = Beam::solve(&rig(), &Foundation::uniform(K_PA).expect("a modulus"), 0.03).expect("solves");
    let mut run = session.lateral("d30-1", 0.03).expect("a run");
    for row in 0..400 {
        let time_s = 0.02 * f64::from(row);
        let y_m = 1.2e-3 * ((time_s - 3.0) / 1.0).clamp(0.0, 1.0);
        let wobble = (2.3 * f64::from(row)).sin();
        let force_y_n = beam.force_n(y_m) + 5e-3 * wobble;
        run.force(&ForceRow {
            time_s,
            displacement_y_m: y_m + 2e-6 * wobble,
            force_y_n,
            ..ForceRow::default()
        })
        .expect("a row");
    }
    for mm in 0..30 {
        let z_m = 0.07 + 1e-3 * f64::from(mm);
        let rounded_m = (1e5 * beam.deflection_m(1.2e-3, z_m)).round() / 1e5;
        run.shape(&ShapeRow { time_s: 6.0, z_m, deflection_y_m: rounded_m, ..ShapeRow::default() })
            .expect("a point");
    }
    run.finish().expect("written");
}

fn add_insertions(session: &mut SessionWriter) {
    let rig = SimulatedRig::new(RigConfig::default(), 3).expect("a rig");
    for run in rig.insertions(&self::rig(), 3, 3).expect("insertions") {
        session.insertion(&run).expect("written");
    }
}

fn folder() -> TempDir {
    tempfile::tempdir().expect("a folder")
}

#[test]
fn what_was_written_is_identified() {
    let folder = folder();
    add_lateral_run(&mut writer(folder.path()));
    let identification = json(&["identify", path(folder.path()), "--json"]);
    assert_eq!(identification["schema"], "guide.identify/1");
    let k_kpa = identification["pooled"]["k_kpa"].as_f64().expect("a modulus");
    assert!((k_kpa / 12.0 - 1.0).abs() < 0.02, "{k_kpa}");
    assert!(identification["youngs_modulus_kpa"]["relation"] == "continuum");
    let vesic = json(&["identify", path(folder.path()), "--json", "--relation", "vesic", "--poisson", "0.4"]);
    assert_eq!(vesic["youngs_modulus_kpa"]["poisson"], 0.4);

    for wrong in [&["--relation", "hooke"][..], &["--poisson", "0.6"], &["--bootstrap", "1"]] {
        let output = guide(&[&["identify", path(folder.path())], wrong].concat());
        assert_eq!(output.status.code(), Some(2), "{wrong:?}");
    }
    assert!(failure(&["identify", "no/such/folder"]).contains("no/such/folder/session.toml: cannot read"));
    assert!(failure(&["predict", path(folder.path())]).contains("session.toml: insertion: missing"));
}

#[test]
fn insertions_are_predicted() {
    let folder = folder();
    add_insertions(&mut writer(folder.path()));
    let dir = path(folder.path());
    let prediction = json(&["predict", dir, "--until", "60", "--json"]);
    assert_eq!(prediction["schema"], "guide.predict/2");
    let insertions = prediction["insertions"].as_array().expect("a list");
    assert_eq!(insertions.len(), 3);
    for one in insertions {
        assert_eq!(one["identified_until_mm"], 60.0);
        for list in [
            "depth_mm",
            "tip_y_mm",
            "lo95_y_mm",
            "hi95_y_mm",
            "measured_y_mm",
            "tip_x_mm",
            "lo95_x_mm",
            "measured_x_mm",
        ] {
            assert_eq!(one[list].as_array().map(Vec::len), Some(101), "{list}");
        }
        assert!(one["mae_mm"].as_f64().expect("measured") < 0.5);
        assert_eq!(one["depth_mm"][100], 100.0);
        assert_eq!(one["learned"]["from"].as_array().map(Vec::len), Some(2));
    }
    // Text, figures, more depth, no learning.
    let plots = folder.path().join("plots");
    let shown = guide(&["predict", dir, "--to", "120", "--alone", "--compare", "--plots", path(&plots)]);
    assert!(shown.status.success(), "{}", text(&shown.stderr));
    let shown = text(&shown.stdout);
    for part in ["tip load", "i1", "rig and tissue", "mechanics", "quadratic", "published"] {
        assert!(shown.contains(part), "{part} is not in {shown}");
    }
    assert!(fs::read_to_string(plots.join("i1.path.svg")).expect("a figure").starts_with("<svg"));

    assert!(failure(&["predict", dir, "--until", "nan"]).contains("--until: NaN, expected 5 to 500 mm"));
    // Beyond the readings, which end within the hundred-and-first millimetre, nothing is measured: refused, unless the prediction goes further.
    let refusal = failure(&["predict", dir, "--until", "500"]);
    assert!(refusal.contains("--until: 500, expected at most 101 mm"), "{refusal}");
    let further = guide(&["predict", dir, "--until", "500", "--to", "120", "--alone"]);
    assert!(text(&further.stdout).starts_with("tip measured to 100 to 101 mm, predicted"), "{further:?}");
    assert!(failure(&["predict", dir, "--k-kpa", "0", "1"]).contains("--k-kpa"));
    assert_eq!(guide(&["predict", dir, "--until", "deep"]).status.code(), Some(2));
    let graded = json(&["predict", dir, "--until", "60", "--effect", "tissue.gradient=0.02", "--json"]);
    assert_ne!(graded["insertions"][0]["tip_y_mm"], prediction["insertions"][0]["tip_y_mm"]);
    for wrong in
        ["tissue.gradient", "tissue.gradient=a", "tissue.layers=2", "tissue.fog=1", "tissue.gradient=99"]
    {
        assert_eq!(guide(&["predict", dir, "--effect", wrong]).status.code(), Some(2), "{wrong}");
    }
    fs::write(folder.path().join("i2.csv"), "depth_mm,tip_y_mm\n0,0\n1,oops\n").expect("writes");
    assert!(failure(&["predict", dir]).contains("i2.csv:3:3: tip_y_mm: \"oops\" is not a number"));
}

/// The written insertion is read again to the last digit kept.
#[test]
fn insertions_survive_the_disk() {
    let folder = folder();
    add_insertions(&mut writer(folder.path()));
    let session = Session::read(folder.path()).expect("reads");
    let rig = SimulatedRig::new(RigConfig::default(), 3).expect("a rig");
    let insertions = rig.insertions(&self::rig(), 3, 3).expect("insertions");
    for (read, insertions) in session.insertion.iter().zip(&insertions) {
        assert_eq!(read.id, insertions.id);
        assert!(
            are_close(&read.depth_m, &insertions.depth_m) && are_close(&read.tip_y_m, &insertions.tip_y_m)
        );
        assert!(are_close(read.tip_x_m.as_deref().expect("x"), insertions.tip_x_m.as_deref().expect("x")));
    }
    let again = writer(folder.path()).insertion(&insertions[0]).expect_err("taken").to_string();
    assert!(again.contains("\"i1\" is taken"), "{again}");
    assert!(Model::uniform(rig_of(&session), K_PA).is_ok());
}

fn are_close(a: &[f64], b: &[f64]) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-11) && a.len() == b.len()
}

fn rig_of(session: &Session) -> Rig {
    session.rig.clone()
}

#[test]
fn recordings_of_others_are_imported() {
    let folder = folder();
    let recordings = folder.path().join("recordings");
    fs::create_dir(&recordings).expect("a folder");
    let mut rows =
        "Timestamp sec,Timestamp nanosec,Tip x,Tip y,Tip z,Robot x,Robot z\n0,0,0,0,0,0,0\n".to_owned();
    for stop in 0..=100 {
        let d = f64::from(stop);
        rows += &format!(
            "{},500000000,{},{},{},-0.025,0.02\n",
            100 + stop,
            -25.0 + 5e-4 * d * d,
            -d,
            20.0 - 0.01 * d
        );
    }
    fs::write(recordings.join("run_1.csv"), &rows).expect("writes");
    fs::write(recordings.join("run_2.csv"), &rows).expect("writes");
    fs::write(recordings.join("empty.csv"), "Timestamp sec,Timestamp nanosec,Tip x,Tip y,Tip z\n")
        .expect("writes");
    let output_path = folder.path().join("session");
    let import_json =
        json(&["import", "trajcontrol", path(&recordings), "--out", path(&output_path), "--json"]);
    assert_eq!(import_json["insertions"].as_array().map(Vec::len), Some(2));
    assert!(
        import_json["skipped"][0]["reason"]
            .as_str()
            .expect("a reason")
            .contains("empty.csv:1:1: rows: no rows")
    );
    let prediction = json(&["predict", path(&output_path), "--json"]);
    assert!(prediction["insertions"][0]["mae_mm"].as_f64().expect("measured") < 0.3);
    assert_eq!(import_json["insertions"][0]["skipped"][0]["reason"], "silent");
    assert!(
        failure(&["import", "trajcontrol", "nowhere.csv", "--out", path(&output_path)])
            .contains("nowhere.csv: cannot read")
    );
    // A file that cannot be read, a folder without recordings and a name that is taken cost themselves only.
    let empty_path = folder.path().join("nothing");
    fs::create_dir(&empty_path).expect("a folder");
    fs::write(folder.path().join("run_3.csv"), rows + "210,0,0.1,50.5,0.1,-0.025,0.02\n").expect("writes");
    let third = folder.path().join("run_3.csv");
    let again = recordings.join("run_1.csv");
    let mixed = ["nowhere.csv", path(&empty_path), path(&again), path(&third)];
    let more =
        json(&[&["import", "trajcontrol"], &mixed[..], &["--out", path(&output_path), "--json"]].concat());
    assert_eq!(more["insertions"][0]["id"], "run_3");
    assert_eq!(more["insertions"][0]["skipped"][1]["reason"], "jump");
    assert_eq!(more["skipped"].as_array().map(Vec::len), Some(3));
    json(&["check", path(&output_path), "--json"]);
    assert_eq!(
        json(&["predict", path(&output_path), "--json"])["insertions"].as_array().map(Vec::len),
        Some(3)
    );
    // A second time their names are taken.
    let again = failure(&["import", "trajcontrol", path(&recordings), "--out", path(&output_path)]);
    assert!(again.contains("\"run_1\" is taken"), "{again}");
}

const STEERING: &str = r#"
[needle]
youngs_modulus_gpa = 200.0
outer_diameter_mm = 1.27
inner_diameter_mm = 1.0
length_mm = 130.0

[rig]
guide2_mm = 60.0
entry_mm = 70.0
fixture_mass_kg = 0.3

[tissue]
layers = [{ bottom_mm = 80, stiffness_n_per_m2 = 20000, damping_n_s_per_m2 = 1000 }]

[[steering]]
id = "s8"
speed_mm_s = 8

[[steering]]
id = "straight"
speed_mm_s = 8
lateral_mm = 0
"#;

#[test]
fn steering_runs_are_simulated_and_tracked() {
    let folder = folder();
    let config = folder.path().join("steering.toml");
    fs::write(&config, STEERING).expect("written");
    let (dir, config) = (folder.path().join("made"), path(&config).to_owned());
    let simulated = json(&["simulate", "--config", &config, "--out", path(&dir), "--seed", "3", "--json"]);
    assert_eq!(simulated["schema"], "guide.simulate/1");
    assert_eq!(simulated["runs"][0]["mean_stiffness_n_per_m2"], 20000.0);
    let figures = folder.path().join("figures");
    let tracked = json(&["track", path(&dir), "--json", "--compare", "--plots", path(&figures)]);
    assert_eq!(tracked["schema"], "guide.track/2");
    let run = &tracked["runs"][0];
    assert_eq!(run["id"], "s8");
    let last = &run["last"]["stiffness_n_per_m2"];
    let ends = [&last["ci95"][0], &last["ci95"][1]].map(|end| end.as_f64().expect("a number"));
    assert!(ends[0] < 2e4 && 2e4 < ends[1] && ends[1] < 2.5 * ends[0], "{last}");
    assert!(run["rms_mm"].as_f64().expect("converged") < 0.2, "{}", run["rms_mm"]);
    assert!(run["converged_at_mm"].as_f64().expect("converged") < 20.0);
    let rows = run["depth_mm"].as_array().expect("a list").len();
    assert!(rows > 50);
    for list in [
        "stiffness_n_per_m2",
        "damping_n_s_per_m2",
        "damping_hi95_n_s_per_m2",
        "tip_y_mm",
        "measured_tip_y_mm",
    ] {
        assert_eq!(run[list].as_array().expect("a list").len(), rows, "{list}");
    }
    assert_eq!(run["compare"].as_array().expect("a list").len(), 3);
    // Without lateral motion there is nothing to see, and no number.
    let straight = &tracked["runs"][1];
    assert!(straight["last"]["stiffness_n_per_m2"]["value"].is_null(), "{}", straight["last"]);
    assert!(straight["damping_n_s_per_m2"].as_array().expect("a list").iter().all(Value::is_null));
    let printed = text(&guide(&["track", path(&dir)]).stdout);
    assert!(printed.contains("straight: stiffness is not identifiable from this motion"), "{printed}");
    assert!(figures.join("s8.track.svg").exists());
    // The same seed makes the same session; another one, or a run that is there, does not.
    let again = folder.path().join("again");
    json(&["simulate", "--config", &config, "--out", path(&again), "--seed", "3", "--json"]);
    assert_eq!(csv(&dir), csv(&again));
    assert!(failure(&["simulate", "--config", &config, "--out", path(&dir)]).contains("s8"));
}

fn csv(dir: &Path) -> String {
    fs::read_to_string(dir.join("s8.csv")).expect("written")
}

#[test]
fn steering_faults_name_their_place() {
    let folder = folder();
    let config = folder.path().join("steering.toml");
    let output_path = folder.path().join("out");
    let fails = |text: &str, expected: &str| {
        fs::write(&config, text).expect("written");
        let printed = failure(&["simulate", "--config", path(&config), "--out", path(&output_path)]);
        assert!(printed.contains(expected), "{printed}");
    };
    fails(&STEERING.replace("length_mm = 130.0", ""), "steering.toml:2:1: needle.length_mm: missing");
    fails(&STEERING.replace("fixture_mass_kg = 0.3", ""), "rig.fixture_mass_kg: missing");
    fails(&STEERING.replace("speed_mm_s = 8", "speed_mm_s = 0"), "speed_mm_s: 0 is out of range");
    fails(&STEERING.replace("bottom_mm = 80", "bottom_mm = -1"), "bottom_mm: -1 is out of range");
    fails(&STEERING.replace("speed_mm_s", "speed_mph"), "speed_mph");
    fails(STEERING.split("[[steering]]").next().expect("text"), "steering: missing");
    fails(&STEERING.replace("layers =", "layer ="), "tissue.layer: \"layer\" is not known");
    fails(
        &STEERING.replace(
            "layers = [{ bottom_mm = 80, stiffness_n_per_m2 = 20000, damping_n_s_per_m2 = 1000 }]",
            "",
        ),
        "tissue.layers: missing, expected at least one layer",
    );

    let session = writer(folder.path());
    drop(session);
    let dir = path(folder.path());
    assert!(failure(&["track", dir]).contains("steering: missing"));
    let csv = "time_s,depth_mm,base_y_mm,base_force_y_n,tip_y_mm\n0,0,0,0,0\n0.1,1,0.1,0.01,0.1\n";
    fs::write(folder.path().join("s1.csv"), csv).expect("written");
    let toml = folder.path().join("session.toml");
    let entry = "\n[[steering]]\nid = \"s1\"\ndata = \"s1.csv\"\n";
    fs::write(&toml, fs::read_to_string(&toml).expect("written") + entry).expect("written");
    assert!(failure(&["track", dir]).contains("[needle] length_mm: missing"));
    let tracked = json(&["track", dir, "--length-mm", "130", "--json"]);
    // Two samples identify nothing, and no number is made of them.
    assert!(tracked["runs"][0]["last"]["stiffness_n_per_m2"]["value"].is_null(), "{}", tracked["runs"][0]);
    let printed = tracked["runs"][0]["warnings"].to_string();
    assert!(printed.contains("identifiable"), "{printed}");
    fs::write(folder.path().join("s1.csv"), csv.replace("\n0.1,", "\nx,")).expect("written");
    assert!(
        failure(&["track", dir, "--length-mm", "130"]).contains("s1.csv:3:1: time_s"),
        "file, line, column and field"
    );
    for wrong in [&["--segment-mm", "0"][..], &["--start", "-1", "5"], &["--length-mm", "1"]] {
        let output = guide(&[&["track", dir], wrong].concat());
        assert!(!output.status.success(), "{wrong:?}");
    }
}

#[test]
fn a_calibration_file_is_checked_before_any_device_is_opened() {
    let folder = folder();
    let file = folder.path().join("unit-7.toml");
    let text = "id = \"unit-7\"\ntravel_mm = 10\nforce_range_n = 5\nforce_n_per_code = [[9.31e-7, 0], [0, 9.31e-7]]\n\
                [potentiometer.x]\ntrack_codes = [40, 4055]\ncodes = [0, 4096]\nrising_mm = [-25, 25]\n\
                [potentiometer.y]\ntrack_codes = [40, 4055]\ncodes = [0, 4096]\nrising_mm = [-25, 25]\n";
    assert!(store(text, &file).contains("no such port"));
    let printed = store(&text.replacen("[-25, 25]", "[-25, 25, 26]", 1), &file);
    assert!(printed.contains("unit-7.toml:8:13: potentiometer.x.rising_mm: a list of 3"), "{printed}");
    assert!(failure(&["limits", "--port", "/dev/no-such-port", "--force-n", "2"]).contains("no such port"));
}

fn store(text: &str, file: &std::path::PathBuf) -> String {
    fs::write(file, text).expect("writes");
    failure(&["calibration", "--port", "/dev/no-such-port", "--store", path(file)])
}

#[test]
fn runs_with_different_calibrations_are_named() {
    let folder = folder();
    add_lateral_run(&mut writer(folder.path()));
    let dir = path(folder.path());
    let toml = folder.path().join("session.toml");
    let plain = fs::read_to_string(&toml).expect("reads");
    let with_calibration = plain.clone() + "calibration_crc = \"0000002a\"\n";
    let second_run = "\n[[lateral]]\nid = \"again\"\ndepth_mm = 30.0\nforce = \"d30-1.force.csv\"\n\
                 shape = \"d30-1.shape.csv\"\ncalibration_crc = \"1a2b3c4d\"\n";
    for (text, warned) in
        [(plain, false), (with_calibration.clone(), false), (with_calibration + second_run, true)]
    {
        fs::write(&toml, text).expect("writes");
        let output = guide(&["identify", dir]);
        assert!(output.status.success(), "{}", text_of(&output));
        let printed = text_of(&output);
        assert_eq!(printed.contains("different calibrations"), warned, "{printed}");
        assert!(!warned || printed.contains("d30-1 with 0000002a; again with 1a2b3c4d"), "{printed}");
    }
}

/// Text that a command printed beside its result.
fn text_of(output: &Output) -> String {
    text(&output.stderr)
}
