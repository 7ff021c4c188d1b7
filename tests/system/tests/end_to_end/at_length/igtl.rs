//! OpenIGTLink beside other people's implementations: what they receive is what the session holds, what they send becomes shapes.

use formats::session::Session;
use imaging::read::Sequence;
use serde_json::Value;
use simulation::rig::config::RigConfig;
use std::fs::{self, File};
use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use system::bench::Bench;
use system::images::build_guide;
use system::peers::{self, Running};
use system::qemu::HANGS;

const RIG: &str = "[needle]\nyoungs_modulus_gpa = 200.0\nouter_diameter_mm = 1.27\ninner_diameter_mm = 1.0\n\
                   [rig]\nguide2_mm = 60.0\nentry_mm = 70.0\n";

/// Programs of the C++ library that are compiled, all at once.
const EXAMPLES: [&str; 3] = ["Receiver/ReceiveClient", "Tracker/TrackerServer", "Imager/ImagerServer"];

/// A free port.
fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// The peer, or the reason why it is skipped: printed past the test harness, which shows nothing of tests that pass.
fn had<T>(peer: Result<T, String>) -> Option<T> {
    peer.map_err(|why| writeln!(std::io::stderr(), "skipped: {why}")).ok()
}

/// Starts a program whose standard output goes to a file.
fn start(command: &mut Command, out: &Path) -> Running {
    let log_file = File::create(out).unwrap();
    Running(command.stdin(Stdio::null()).stdout(log_file).stderr(Stdio::null()).spawn().unwrap())
}

/// Waits until a port has a server.
fn await_port(port: u16) {
    let began = Instant::now();
    while std::net::TcpStream::connect(("127.0.0.1", port)).is_err() {
        assert!(began.elapsed() < HANGS, "no server at {port}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Output of a viewer for one device.
fn received(lines: &Path, device: &str) -> Vec<Value> {
    let text = fs::read_to_string(lines).unwrap();
    let messages = text.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
    messages.filter(|message| message["device"] == device).collect()
}

fn json(command: &mut Command) -> Value {
    let output = command.arg("--json").output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn finished(child: Child) -> (bool, String) {
    let output = child.wait_with_output().unwrap();
    (output.status.success(), String::from_utf8_lossy(&output.stderr).into_owned())
}

/// One run in QEMU with a foreign tracker as the ultrasound and foreign viewers connected.
#[test]
#[ignore = "needs QEMU and programs of others: cargo xtask test --all runs it"]
fn foreign_viewers_receive_what_the_session_holds_and_a_foreign_tracker_gives_its_shapes() {
    let Some(python) = had(peers::python()) else { return };
    let receiver = had(peers::examples(&EXAMPLES));
    let bench = Bench::start(RigConfig::default(), 23, 1.0, HANGS).unwrap();
    let guide = build_guide().unwrap();
    let path = |name: &str| bench.folder().join(name);
    let (session, shapes, rig) = (path("session"), path("shapes"), path("rig.toml"));
    fs::write(&rig, RIG).unwrap();
    fs::create_dir(&shapes).unwrap();
    let (tracker_port, own_port) = (free_port(), free_port());
    let mut tracker = Command::new(&python);
    tracker.arg(peers::scripts().join("tracker.py")).arg(tracker_port.to_string()).arg(&shapes);
    tracker.arg(env!("CARGO_BIN_EXE_system")).args(["sweep", "--socket"]).arg(bench.rig().ultrasound());
    let _tracker = start(&mut tracker, &path("tracker.txt"));
    await_port(tracker_port);

    let acquiring = Command::new(&guide)
        .args(["acquire", "--port", &bench.port(), "--program", "displace", "--depth-mm", "30", "--no-tare"])
        .args(["--igtl", &format!("127.0.0.1:{tracker_port}"), &format!("--publish=127.0.0.1:{own_port}")])
        .arg("--rig")
        .arg(&rig)
        .arg("--out")
        .arg(&session)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    await_port(own_port);
    let port = own_port.to_string();
    let viewer = [peers::scripts().join("viewer.py").into_os_string(), port.clone().into()];
    let viewer = start(Command::new(&python).args(viewer), &path("viewer.txt"));
    let receiver = receiver.map(|folder| {
        let errors = File::create(path("receiver.txt")).unwrap();
        let mut command = Command::new(folder.join("ReceiveClient"));
        command.args(["127.0.0.1", &port]).stdout(errors.try_clone().unwrap()).stderr(errors);
        (Running(command.stdin(Stdio::null()).spawn().unwrap()), folder)
    });
    let (exit_status, stderr) = finished(acquiring);
    assert!(exit_status, "{stderr}");
    drop(viewer);

    // Values that the viewers received.
    let recorded = Session::read(&session).unwrap();
    let run = &recorded.lateral[0];
    let documents = received(&path("viewer.txt"), "Guide");
    let mut compared = 0;
    for document in &documents {
        let document: Value = serde_json::from_str(document["content"].as_str().unwrap()).unwrap();
        let time_s = document["time_s"].as_f64().unwrap();
        let Ok(row) = run.force.time_s.binary_search_by(|row_s| row_s.total_cmp(&time_s)) else { continue };
        compared += 1;
        for (field, series, unit) in [
            ("force_y_n", &run.force.force_y_n, 1.0),
            ("position_y_mm", &run.force.displacement_y_m, 1e3),
            ("position_x_mm", run.force.displacement_x_m.as_ref().unwrap(), 1e3),
        ] {
            let value_error = document[field].as_f64().unwrap() - unit * series[row];
            // The session's files have nine decimals.
            assert!(value_error.abs() < 1e-9, "{field} is off by {value_error} at {time_s} s");
        }
    }
    assert!(compared > 50, "{compared} of {} updates are of the run", documents.len());
    let poses = received(&path("viewer.txt"), "GuideToReference");
    let mut posed = 0;
    for pose in &poses {
        let Some(document) =
            documents.iter().find(|document| (stamp_s(document) - stamp_s(pose)).abs() < 1e-6)
        else {
            continue;
        };
        let document: Value = serde_json::from_str(document["content"].as_str().unwrap()).unwrap();
        let matrix = &pose["content"];
        for (row, expected_mm) in
            [document["position_x_mm"].as_f64().unwrap(), document["position_y_mm"].as_f64().unwrap(), 60.0]
                .into_iter()
                .enumerate()
        {
            let error_mm = matrix[row][3].as_f64().unwrap() - expected_mm;
            assert!(error_mm.abs() < 1e-5, "row {row} of {matrix} is off by {error_mm} mm");
        }
        posed += 1;
    }
    assert!(posed > 50, "{posed} of {} poses have their document", poses.len());
    if receiver.is_some() {
        let text = fs::read_to_string(path("receiver.txt")).unwrap();
        for kind in ["TRANSFORM", "STRING", "POINT"] {
            let count = text.matches(&format!("Receiving {kind} data type")).count();
            assert!(count > 10, "{count} messages of {kind}");
        }
        assert!(text.contains("guide.igtl/1") && text.contains("60"), "{text}");
    }

    // Values that the tracker sent.
    let measured = run.shape.time_s.as_ref().unwrap();
    let mut times_s = measured.clone();
    times_s.dedup();
    assert!(times_s.len() > 20, "{} sweeps", times_s.len());
    let sent: Vec<Vec<[f64; 3]>> =
        (0..).map_while(|number| sweep(&shapes.join(format!("{number}.csv")))).collect();
    let mut next = 0;
    let mut exact = String::from("time_s,z_mm,deflection_y_mm,deflection_x_mm\n");
    for time_s in times_s {
        let rows: Vec<usize> = (0..measured.len()).filter(|row| measured[*row] == time_s).collect();
        let matching = sent[next..]
            .iter()
            .position(|sweep| {
                sweep.len() == rows.len()
                    && sweep.iter().zip(&rows).all(|([z_mm, y_mm, x_mm], row)| {
                        let x_m = run.shape.x_m.as_ref().unwrap()[*row];
                        let point_m = [run.shape.z_m[*row], run.shape.y_m[*row], x_m];
                        // Single precision on the wire.
                        point_m.iter().zip([z_mm, y_mm, x_mm]).all(|(m, mm)| (1e3 * m - mm).abs() < 1e-5)
                    })
            })
            .expect("each sweep is one that was sent, in order");
        for [z_mm, y_mm, x_mm] in &sent[next + matching] {
            exact += &format!("{time_s},{z_mm},{y_mm},{x_mm}\n");
        }
        next += matching + 1;
    }

    // The same modulus as from the shapes in the tracker's own files.
    let identified = json(Command::new(&guide).arg("identify").arg(&session));
    fs::write(session.join("d30-1.shape.csv"), exact).unwrap();
    let from_files = json(Command::new(&guide).arg("identify").arg(&session));
    let ratio = k_kpa(&identified) / k_kpa(&from_files);
    assert!((ratio - 1.0).abs() < 1e-6, "{ratio}");
    let true_kpa = bench.rig().rig(|rig| rig.truth().modulus_pa) * 1e-3;
    assert!((k_kpa(&identified) / true_kpa - 1.0).abs() < 0.1, "{identified}");

    // A tip from the C++ library.
    if let Some((_, folder)) = &receiver {
        let port = free_port();
        let _server = start(
            Command::new(folder.join("TrackerServer")).args([&port.to_string(), "20"]),
            &path("server.txt"),
        );
        // The example serves its first client for ever: no other client may try whether it is up.
        let began = Instant::now();
        let output = loop {
            let output = Command::new(&guide)
                .args([
                    "record",
                    "--port",
                    &bench.port(),
                    "--depth-mm",
                    "40",
                    "--id",
                    "tip",
                    "--duration-s",
                    "4",
                ])
                .args(["--igtl", &format!("localhost:{port}"), "--igtl-tip", "Tracker", "--out"])
                .arg(&session)
                .output()
                .unwrap();
            let stderr = String::from_utf8_lossy(&output.stderr);
            if !stderr.contains("cannot connect to OpenIGTLink") || began.elapsed() > HANGS {
                break output;
            }
        };
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let recorded = Session::read(&session).unwrap();
        let shape = &recorded.lateral.iter().find(|run| run.id == "tip").unwrap().shape;
        assert!(shape.z_m.len() > 5, "{shape:?}");
        // The example goes round: x = z = 50 mm cos, y = 50 mm sin.
        for (row, z_m) in shape.z_m.iter().enumerate() {
            let (y_m, x_m) = (shape.y_m[row], shape.x_m.as_ref().unwrap()[row]);
            assert!((x_m - z_m).abs() < 1e-8 && (y_m.hypot(x_m) - 0.05).abs() < 1e-7, "{shape:?}");
        }
    }
    bench.stop().unwrap();
}

fn k_kpa(identified: &Value) -> f64 {
    identified["pooled"]["k_kpa"].as_f64().unwrap()
}

fn stamp_s(message: &Value) -> f64 {
    message["stamp_s"].as_f64().unwrap()
}

/// Rows of a sweep that a tracker has kept, millimetres: along the needle, y, x.
fn sweep(path: &Path) -> Option<Vec<[f64; 3]>> {
    let text = fs::read_to_string(path).ok()?;
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next()?.split(',').collect();
    let column = |name: &str| names.iter().position(|known| *known == name);
    let columns = [column("z_mm")?, column("deflection_y_mm")?, column("deflection_x_mm")?];
    Some(
        lines
            .map(|line| {
                let cells: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
                columns.map(|column| cells[column])
            })
            .collect(),
    )
}

/// A sequence that was captured, as `guide capture --json` states it.
fn captured(port: u16, out: &Path, more: &[&str]) -> Value {
    let (guide, began) = (build_guide().unwrap(), Instant::now());
    loop {
        let mut capture = Command::new(&guide);
        capture
            .args(["capture", "--igtl", &format!("127.0.0.1:{port}"), "--json", "--out"])
            .arg(out)
            .args(more);
        let output = capture.output().unwrap();
        if output.status.success() {
            return serde_json::from_slice(&output.stdout).unwrap();
        }
        // The server is not there yet. It takes who connects first for its client, so that this is no other connection.
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(stderr.contains("cannot connect") && began.elapsed() < HANGS, "{stderr}");
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// Frames of 625 x 750 pixels, 30 a second, of which some are never sent.
#[test]
#[ignore = "needs programs of others: cargo xtask test --all runs it"]
fn frames_of_a_foreign_scanner_become_a_sequence_and_lost_ones_are_counted() {
    let Some(python) = had(peers::python()) else { return };
    let folder = tempfile::tempdir().unwrap();
    let port = free_port();
    let mut scanner = Command::new(&python);
    scanner.arg(peers::scripts().join("scanner.py")).arg(port.to_string()).args(["90", "7", "8", "40"]);
    let _scanner = start(&mut scanner, &folder.path().join("scanner.txt"));
    let frames = folder.path().join("frames");
    let capture = captured(port, &frames, &["--frames", "87"]);
    assert_eq!((&capture["image"], &capture["frames"]), (&"Probe".into(), &87.into()), "{capture}");
    assert_eq!(capture["lost"].as_u64().unwrap(), 3, "{capture}");
    assert!((capture["rate_hz"].as_f64().unwrap() - 30.0).abs() < 0.1, "{capture}");
    let sequence = Sequence::open(Path::new(capture["path"].as_str().unwrap())).unwrap();
    let header = sequence.header();
    let spacing_mm = header.spacing_mm.unwrap();
    assert!((spacing_mm[0] - 0.1).abs() < 1e-6 && (spacing_mm[1] - 0.2).abs() < 1e-6, "{spacing_mm:?}");
    let pose = header.frames[86].transforms["ImageToReference"];
    for (at, expected) in [(0, 1.0), (5, -1.0), (10, -1.0), (3, -4.0), (7, 3.0), (11, 70.0)] {
        assert!((pose[at] - expected).abs() < 1e-4, "{pose:?}");
    }
}

/// The C++ library's own server of images.
#[test]
#[ignore = "needs programs of others: cargo xtask test --all runs it"]
fn frames_of_the_library_s_own_server_become_a_sequence() {
    let Some(examples) = had(peers::examples(&EXAMPLES)) else { return };
    let folder = tempfile::tempdir().unwrap();
    let port = free_port();
    let images = examples.join("usr/share/doc/openigtlink-examples/examples/Imager/img");
    let mut server = Command::new(examples.join("ImagerServer"));
    server.arg(port.to_string()).arg("30").arg(&images);
    let _server = start(&mut server, &folder.path().join("server.txt"));
    let capture = captured(port, &folder.path().join("frames"), &["--frames", "60"]);
    assert_eq!(capture["frames"].as_u64().unwrap(), 60, "{capture}");
    let mut sequence = Sequence::open(Path::new(capture["path"].as_str().unwrap())).unwrap();
    assert_eq!([sequence.header().width, sequence.header().height], [256, 256]);
    let mut read = 0;
    while let Some(frame) = sequence.next_frame().unwrap() {
        assert!(frame.pixels.iter().any(|pixel| *pixel > 0));
        read += 1;
    }
    assert_eq!(read, 60);
}

/// Results of a session, as a viewer that comes later receives them.
#[test]
#[ignore = "needs programs of others: cargo xtask test --all runs it"]
fn a_foreign_viewer_receives_the_results_that_the_commands_print() {
    let Some(python) = had(peers::python()) else { return };
    let guide = build_guide().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let session = folder.path().join("playground");
    assert!(
        Command::new(&guide).args(["init", "--example"]).arg(&session).output().unwrap().status.success()
    );
    let mut serving = Running(
        Command::new(&guide)
            .arg("serve")
            .arg(&session)
            .args(["--igtl=127.0.0.1:0", "--json"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap(),
    );
    let mut line = String::new();
    BufReader::new(serving.0.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let report: Value = serde_json::from_str(&line).unwrap();
    let (host, port) = report["address"].as_str().unwrap().split_once(':').unwrap();
    assert_eq!(host, "127.0.0.1", "to this machine alone");
    let lines = folder.path().join("viewer.txt");
    let _viewer = start(Command::new(&python).arg(peers::scripts().join("viewer.py")).arg(port), &lines);
    let began = Instant::now();
    let text = |device: &str| loop {
        if let Some(last) = received(&lines, device).pop() {
            return last["content"].clone();
        }
        assert!(began.elapsed() < HANGS, "no {device}");
        std::thread::sleep(Duration::from_millis(50));
    };
    let document = |device: &str| -> Value { serde_json::from_str(text(device).as_str().unwrap()).unwrap() };

    let identified = json(Command::new(&guide).arg("identify").arg(&session));
    let published = document("Identification");
    for field in ["k_kpa", "sd_kpa", "ci95_kpa"] {
        assert_eq!(published[field], identified["pooled"][field], "{field}");
    }
    assert_eq!(published["youngs_modulus_kpa"], identified["youngs_modulus_kpa"]["value"]);

    let predicted = json(Command::new(&guide).arg("predict").arg(&session));
    let last = predicted["insertions"].as_array().unwrap().last().unwrap();
    let published = document("Prediction");
    assert_eq!((&published["insertion"], &published["tip_force_n"]), (&last["id"], &last["tip_force_n"]));
    let path = text("PredictedPath");
    let depths_mm = last["depth_mm"].as_array().unwrap();
    assert_eq!(path.as_array().unwrap().len(), depths_mm.len());
    let entry_mm = Session::read(&session).unwrap().rig.entry_m * 1e3;
    for (index, depth_mm) in depths_mm.iter().enumerate() {
        let y_mm = last["tip_y_mm"][index].as_f64().unwrap();
        let expected = [(1, y_mm), (2, entry_mm + depth_mm.as_f64().unwrap())];
        for (axis, mm) in expected {
            assert!((path[index][axis].as_f64().unwrap() - mm).abs() < 1e-4, "point {index} axis {axis}");
        }
    }

    // Another number of runs: sent again without a request.
    let text = fs::read_to_string(session.join("session.toml")).unwrap();
    let fewer = text.replacen("[[lateral]]", "[[unused]]", 1);
    fs::write(session.join("session.toml"), fewer).unwrap();
    let runs = published_runs(&lines, identified["pooled"]["runs"].as_u64().unwrap());
    assert_eq!(runs, identified["pooled"]["runs"].as_u64().unwrap() - 1);
}

/// Number of runs of the latest identification, once it is another than before.
fn published_runs(lines: &Path, before: u64) -> u64 {
    let began = Instant::now();
    loop {
        let document = received(lines, "Identification").pop().unwrap();
        let document: Value = serde_json::from_str(document["content"].as_str().unwrap()).unwrap();
        match document["runs"].as_u64() {
            Some(runs) if runs != before => return runs,
            _ => assert!(began.elapsed() < HANGS, "still {before} runs"),
        }
        std::thread::sleep(Duration::from_millis(50));
    }
}
