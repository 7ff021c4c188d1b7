//! The program `guide` on the firmware: the whole procedure, its repeatability, and a pulled plug.

use formats::session::Session;
use serde_json::Value;
use simulation::rig::config::RigConfig;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};
use system::bench::Bench;
use system::demo::{Outcome, judgement, procedure};
use system::images::build_guide;
use system::qemu::HANGS;
use system::readme::{self, shell::Shell};

const XTASK: &str = env!("CARGO_BIN_EXE_system");

/// Results of the procedure, its recording, and its output on the pages.
fn run_procedure(seed: u64) -> (Outcome, String, String) {
    let folder = tempfile::tempdir().unwrap();
    let output_path = readme::rig::out(folder.path());
    let mut printed = String::new();
    let outcome =
        procedure(Path::new(XTASK), seed, &output_path, &mut |text| printed.push_str(text)).unwrap();
    printed.push_str(&judgement(&outcome, seed, &output_path).unwrap());
    if seed == readme::rig::SEED {
        let shell = Shell::new(build_guide().unwrap(), folder.path());
        readme::check_console("recording", &shell).unwrap();
    }
    let force = std::fs::read_to_string(output_path.join("phantom/d30-1.force.csv")).unwrap();
    (outcome, force, readme::rig::as_shown(&printed, folder.path(), Path::new(XTASK)))
}

/// `guide acquire` with the staircase, just started, and the folder of its session.
fn acquiring(bench: &Bench) -> (PathBuf, Child) {
    let guide = build_guide().unwrap();
    let session = bench.folder().join("session");
    let rig_file = bench.folder().join("rig.toml");
    std::fs::write(
        &rig_file,
        "[needle]\nyoungs_modulus_gpa = 200.0\nouter_diameter_mm = 1.27\ninner_diameter_mm = 1.0\n\
         [rig]\nguide2_mm = 60.0\nentry_mm = 70.0\n",
    )
    .unwrap();
    let child = Command::new(guide)
        .args(["acquire", "--port", &bench.port(), "--program", "staircase", "--depth-mm", "30", "--no-tare"])
        .arg("--rig")
        .arg(&rig_file)
        .arg("--out")
        .arg(&session)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    (session, child)
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn the_procedure_finds_the_hidden_modulus_and_repeats_exactly() {
    let (outcome, force, printed) = run_procedure(readme::rig::SEED);
    readme::check_part("demo", &printed).unwrap();
    let true_kpa = outcome.truth.modulus_pa * 1e-3;
    let [low_kpa, high_kpa] = outcome.interval_kpa().unwrap();
    assert!((low_kpa..=high_kpa).contains(&true_kpa), "{true_kpa} kPa is not in {low_kpa} to {high_kpa} kPa");
    let likelihood_kpa = outcome.number("likelihood", "k_kpa").unwrap();
    assert!((likelihood_kpa / true_kpa - 1.0).abs() < 0.1, "{likelihood_kpa} kPa instead of {true_kpa} kPa");
    assert!(outcome.number("energy", "k_kpa").unwrap() > 0.0);
    assert_eq!(outcome.lost_samples(), 0.0);
    let run = &outcome.session.lateral[0];
    let times_s = &run.force.time_s;
    let gaps = times_s.windows(2).filter(|pair| (pair[1] - pair[0] - 1e-3).abs() > 1e-6).count();
    assert_eq!((run.force.lost_before.is_some(), gaps), (true, 0), "a sample every millisecond");
    let mut sweeps_s = run.shape.time_s.clone().unwrap();
    sweeps_s.dedup();
    assert_eq!(sweeps_s.len(), 1, "the sweep at the push; the one at rest is the straight needle");
    let frames = outcome.frames().unwrap();
    assert!(frames.used >= 180 && frames.rejected >= 1, "{frames:?}");

    let (predicted_mm, quadratic_mm) =
        (outcome.path_error_mm(None), outcome.path_error_mm(Some("quadratic")));
    assert!(predicted_mm < quadratic_mm, "{predicted_mm} mm beside {quadratic_mm} mm by a quadratic");
    assert!(
        outcome.share_inside() > 0.75,
        "{} of the measured tips inside their bands",
        outcome.share_inside()
    );

    let (again, force_again, _) = run_procedure(readme::rig::SEED);
    assert!(force == force_again, "the same seed gave another recording");
    assert_eq!(outcome.identified["pooled"], again.identified["pooled"]);
    assert_eq!(outcome.identified["runs"], again.identified["runs"]);
    assert_eq!(outcome.predicted, again.predicted);
}

/// Without a schedule, as by hand: what the pages type, then move there, and the status shows it.
#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_move_by_hand_arrives() {
    let guide = build_guide().unwrap();
    let bench = Bench::start(readme::rig::quiet(), 21, 4.0, HANGS).unwrap();
    let shell = Shell::new(guide.clone(), bench.folder()).with_port(bench.port());
    readme::check_console("live", &shell).unwrap();
    let output = Command::new(&guide)
        .args(["move", "--port", &bench.port(), "--x-mm", "-0.5", "--y-mm", "0.7", "--json"])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    for (field, target_mm) in [("position_x_mm", -0.5), ("position_y_mm", 0.7)] {
        let error_mm = report[field].as_f64().unwrap() - target_mm;
        assert!(error_mm.abs() < 0.06, "{field} is {error_mm} mm off");
    }
    bench.stop().unwrap();
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_plug_pulled_in_mid_run_is_reported_in_one_line_and_loses_nothing_recorded() {
    let mut bench = Bench::start(RigConfig::default(), 22, 4.0, HANGS).unwrap();
    let (session, child) = acquiring(&bench);
    let force_file = session.join("d30-1.force.csv");
    let began = Instant::now();
    while rows(&force_file) < 2_000 {
        assert!(began.elapsed() < HANGS, "nothing is recorded");
        thread::sleep(Duration::from_millis(20));
    }
    let rows_before = rows(&force_file);
    bench.pull_the_plug();
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(stderr.lines().count(), 1, "{stderr}");
    assert!(stderr.starts_with("error: ") && stderr.contains("disappeared"), "{stderr}");

    let read = Session::read(&session).unwrap();
    let times_s = &read.lateral[0].force.time_s;
    assert!(times_s.len() + 1 >= rows_before, "{} of {rows_before} rows are left", times_s.len());
    let gaps = times_s.windows(2).filter(|pair| (pair[1] - pair[0] - 1e-3).abs() > 1e-6).count();
    assert_eq!(gaps, 0, "every sample up to the end is there");
}

fn rows(force_file: &PathBuf) -> usize {
    std::fs::read_to_string(force_file).map_or(0, |text| text.lines().count())
}

/// A computer that sleeps is a host that is silent: the device stops by itself, and what was recorded until then stays.
#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_host_that_is_suspended_in_mid_run_loses_nothing_recorded_and_names_the_fault() {
    let bench = Bench::start(RigConfig::default(), 25, 4.0, HANGS).unwrap();
    let (session, child) = acquiring(&bench);
    let signal = |name: &str| {
        let kill = format!("kill -{name} {}", child.id());
        assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
    };
    let force_file = session.join("d30-1.force.csv");
    let began = Instant::now();
    while rows(&force_file) < 2_000 {
        assert!(began.elapsed() < HANGS, "nothing is recorded");
        thread::sleep(Duration::from_millis(20));
    }
    let rows_before = rows(&force_file);
    signal("STOP");
    // Twice the device's 2 s, by its own clock.
    let start_step = bench.rig().steps();
    while bench.rig().steps() < start_step + 5_000 {
        assert!(began.elapsed() < HANGS, "the rig stands");
        thread::sleep(Duration::from_millis(20));
    }
    assert!(!bench.rig().bridges_driven(), "the device has stopped by itself");
    signal("CONT");
    let output = child.wait_with_output().unwrap();
    let stderr_text = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{stderr_text}");
    assert_eq!(stderr_text.lines().filter(|line| line.starts_with("error: ")).count(), 1, "{stderr_text}");
    assert!(stderr_text.contains("host") || stderr_text.contains("silent"), "{stderr_text}");
    let read = Session::read(&session).unwrap();
    let force = &read.lateral[0].force;
    assert!(force.time_s.len() + 1 >= rows_before, "{} of {rows_before} rows are left", force.time_s.len());
    assert!(force.time_s.windows(2).all(|pair| pair[1] > pair[0]), "the device's clock goes on");
    bench.stop().unwrap();
}

/// The device's stream and a tracker's lines become estimates while both still run.
#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn tracking_live_joins_device_and_tracker() {
    let bench = Bench::start(RigConfig::default(), 23, 4.0, HANGS).unwrap();
    let guide = build_guide().unwrap();
    let file = |name: &str, text: &str| {
        let path = bench.folder().join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    file(
        "session.toml",
        "[session]\nformat = 1\n[needle]\nyoungs_modulus_gpa = 200.0\nouter_diameter_mm = 1.27\ninner_diameter_mm = 1.0\n\
         length_mm = 130.0\n[rig]\nguide2_mm = 60.0\nentry_mm = 70.0\n",
    );
    let program = file("push.toml", "name = \"push\"\n[[step]]\nmove_y_mm = 2.0\nspeed_mm_s = 0.5\n");
    // One reading per batch of the device: more than it will send.
    let lines: String =
        (0..2_000).map(|i| format!("{},{}\n", 0.1 * f64::from(i), -0.01 * f64::from(i))).collect();
    let tip = file("tip.csv", &format!("depth_mm,tip_y_mm\n{lines}"));
    let output = Command::new(guide)
        .args(["track", "--live", "--json", "--port", &bench.port()])
        .arg("--program")
        .arg(&program)
        .arg("--tip")
        .arg(&tip)
        .arg(bench.folder())
        .output()
        .unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}");
    let lines: Vec<Value> = String::from_utf8(output.stdout)
        .unwrap()
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert!(lines.len() > 5, "{} estimates; {stderr}", lines.len());
    let depths: Vec<f64> = lines.iter().map(|line| line["depth_mm"].as_f64().unwrap()).collect();
    assert!(depths.is_sorted(), "{depths:?}");
    assert!(stderr.contains("at the end"), "{stderr}");
    bench.stop().unwrap();
}

/// Runs `guide` on the bench, which must succeed; returns its JSON.
fn guide(bench: &Bench, arguments: &[&str]) -> Value {
    let mut command = Command::new(build_guide().unwrap());
    command.args(arguments).args(["--port", &bench.port(), "--json"]);
    let output = command.output().unwrap();
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// A retreat most of which is still to come when the user interrupts: the guide stops there, and another one goes on until the load is gone.
#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_retreat_that_is_interrupted_stops_on_its_way() {
    let bench = Bench::start(readme::rig::quiet(), 27, 0.3, HANGS).unwrap();
    guide(&bench, &["home", "--nominal"]);
    guide(&bench, &["move", "--y-mm", "2"]);
    guide(&bench, &["limits", "--force-n", "0.3"]);
    let mut command = Command::new(build_guide().unwrap());
    command.args(["retreat", "--port", &bench.port(), "--json"]);
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let began = Instant::now();
    while !bench.rig().bridges_driven() {
        assert!(began.elapsed() < HANGS, "it does not move");
        thread::sleep(Duration::from_millis(5));
    }
    rustix::process::kill_process(rustix::process::Pid::from_child(&child), rustix::process::Signal::INT)
        .unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let stopped: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(stopped["outcome"], "stopped: see `guide status`");
    let y_mm = stopped["position_y_mm"].as_f64().unwrap();
    assert!((1.1..2.1).contains(&y_mm), "{y_mm} mm");
    let further = guide(&bench, &["retreat"]);
    assert!(further["position_y_mm"].as_f64().unwrap() < y_mm - 0.5, "{further} from {y_mm} mm");
    bench.stop().unwrap();
}

/// A calibration is stored by the driver of the flash, outlives restarts, is worked with, and is named by what is recorded.
#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_stored_calibration_outlives_a_restart_and_is_worked_with() {
    let bench = Bench::start(readme::rig::quiet(), 24, 4.0, HANGS).unwrap();
    let calibration_before = guide(&bench, &["calibration"]);
    assert_eq!(calibration_before["id"], "nominal");
    // Shifted by 2 mm along y, twice the force along x.
    let file = bench.folder().join("unit-7.toml");
    std::fs::write(
        &file,
        "id = \"unit-7\"\ntravel_mm = 8.0\nforce_range_n = 5.0\n\
         force_n_per_code = [[2.235174e-6, 0.0], [0.0, 1.117587e-6]]\n\
         [potentiometer.x]\ntrack_codes = [40, 4055]\ncodes = [0, 4096]\nrising_mm = [-25.0, 25.0]\n\
         [potentiometer.y]\ntrack_codes = [40, 4055]\ncodes = [0, 4096]\nrising_mm = [-23.0, 27.0]\n",
    )
    .unwrap();
    let status_before = guide(&bench, &["status"]);
    let stored = guide(&bench, &["calibration", "--store", file.to_str().unwrap()]);
    assert_eq!(stored["id"], "unit-7");
    let status_after = guide(&bench, &["status"]);
    assert_eq!(
        (&status_after["calibration_id"], &status_after["calibration_crc"]),
        (&stored["id"], &stored["crc"])
    );
    assert_eq!((&status_after["state"], &status_after["fault"]), (&Value::from("idle"), &Value::Null));
    let shift_mm = number(&status_after, "position_y_mm") - number(&status_before, "position_y_mm");
    assert!((shift_mm - 2.0).abs() < 0.15, "shifted by {shift_mm} mm");
    let ratio = number(&status_after, "force_x_n") / number(&status_before, "force_x_n");
    assert!((ratio - 2.0).abs() < 0.2, "{ratio} of the force");
    bench.rig().inject(system::cosim::Injection { brown_out: true, ..Default::default() });
    let began = Instant::now();
    while bench.rig().resets() < 2 {
        assert!(began.elapsed() < HANGS, "no restart");
        thread::sleep(Duration::from_millis(10));
    }
    guide(&bench, &["clear"]);
    assert_eq!(guide(&bench, &["calibration"])["crc"], stored["crc"]);
    // To where the needle is not loaded: a tare under load is rejected.
    guide(&bench, &["move", "--x-mm", "0", "--y-mm", "2"]);
    let tare = guide(&bench, &["tare"]);
    assert_eq!((&tare["readings"], &tare["verdict"]), (&Value::from(1_000), &Value::from("good")), "{tare}");

    let rig_file = bench.folder().join("rig.toml");
    std::fs::write(
        &rig_file,
        "[needle]\nyoungs_modulus_gpa = 200.0\nouter_diameter_mm = 1.27\ninner_diameter_mm = 1.0\n\
         [rig]\nguide2_mm = 60.0\nentry_mm = 70.0\n",
    )
    .unwrap();
    let session = bench.folder().join("session");
    let (session_text, rig) = (session.to_str().unwrap(), rig_file.to_str().unwrap());
    guide(
        &bench,
        &["record", "--out", session_text, "--rig", rig, "--depth-mm", "30", "--duration-s", "0.5"],
    );
    let text = std::fs::read_to_string(session.join("session.toml")).unwrap();
    let crc = stored["crc"].as_str().unwrap();
    assert!(text.contains("calibration_id = \"unit-7\"") && text.contains(crc), "{text}");
    bench.stop().unwrap();
}

fn number(report: &Value, field: &str) -> f64 {
    report[field].as_f64().unwrap()
}
