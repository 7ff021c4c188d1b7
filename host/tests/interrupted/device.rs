//! Commands that write what a device sends, and commands that move it: a disk that is full at any byte, and signals.

use super::{failure, files, folder, guide, words};
use fake_device::{Act, FakeDevice, Script};
use formats::session::Session;
use protocol::Request;
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::{Child, Command, Output};
use std::thread;
use std::time::{Duration, Instant};

/// Longest that a command may take to see a signal.
const LIMIT: Duration = Duration::from_secs(20);

/// A device that sends so many samples and completes.
fn device(batches: usize) -> FakeDevice {
    let mut program: Vec<Act> = (0..batches).flat_map(|_| [Act::Batch(32), Act::Wait(15)]).collect();
    program.push(Act::Complete);
    FakeDevice::start(Script { program, ..Script::default() })
}

fn run(folder: &Path, device: &FakeDevice, limit_bytes: Option<u64>, command: &str) -> Output {
    let command = format!("{command} --port {}", device.port);
    guide(folder, limit_bytes, &words(&command)).output().expect("guide starts")
}

const ACQUIRE: &str = "acquire --out made --rig rig.toml --depth-mm 20 --program push.toml --no-tare";

fn bench() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(
        folder.path().join("rig.toml"),
        "[needle]\nyoungs_modulus_gpa = 200.0\nouter_diameter_mm = 1.27\ninner_diameter_mm = 1.0\n\
         [rig]\nguide2_mm = 60.0\nentry_mm = 70.0\n",
    )
    .expect("written");
    let program = "name = \"push\"\n[[step]]\nmove_y_mm = 1.2\nspeed_mm_s = 1.0\n";
    fs::write(folder.path().join("push.toml"), program).expect("written");
    folder
}

/// A recording of what a device sends.
pub fn recording() -> Vec<u8> {
    let folder = bench();
    let output = run(folder.path(), &device(60), None, ACQUIRE);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    fs::read(folder.path().join("made/d20-1.mcap")).expect("a recording")
}

/// Whatever is full when: the guide is stopped, what is recorded is read again, and there is one line.
#[test]
fn a_disk_that_fills_up_while_a_run_is_recorded_stops_the_guide_and_keeps_whole_rows() {
    let undisturbed = bench();
    assert!(run(undisturbed.path(), &device(60), None, ACQUIRE).status.success());
    let made = files(&undisturbed.path().join("made"));
    let size = |name: &str| made.get(Path::new(name)).map_or(0, |content| content.len() as u64);
    let mcap = size("d20-1.mcap");
    let rows = size("d20-1.force.csv");
    assert!(mcap > 10_000 && rows > 10_000, "{mcap} and {rows} bytes");
    let limits: BTreeSet<u64> =
        [0, 1, size("session.toml") - 1, rows / 3, rows - 1, mcap * 3 / 4].into_iter().collect();
    for bytes in limits {
        let what = format!("acquire with {bytes} bytes a file");
        let folder = bench();
        let fake = device(60);
        let line = failure(&run(folder.path(), &fake, Some(bytes), ACQUIRE), &what);
        assert!(line.contains("File too large"), "{what}: {line}");
        let executed = fake.executed();
        let runs = executed.iter().any(|request| matches!(request, Request::Run { .. }));
        // A disk that is full from the beginning lets nothing run; one that fills up during the run ends it; the last bytes come after it.
        assert_eq!(runs, bytes > 1, "{what}: {line}; {executed:?}");
        if runs && bytes <= rows / 3 {
            assert!(executed.contains(&Request::Stop), "{what}: {line}; {executed:?}");
        }
        let session = folder.path().join("made");
        if session.join("session.toml").exists() {
            let read = Session::read(&session);
            let read = read.unwrap_or_else(|error| panic!("{what}: {error}"));
            let times_s = read.lateral.first().map_or(&[][..], |run| run.force.time_s.as_slice());
            assert!(times_s.windows(2).all(|pair| pair[1] > pair[0]), "{what}: whole rows in order");
            let text = fs::read_to_string(session.join("d20-1.force.csv")).unwrap_or_default();
            assert!(text.is_empty() || text.ends_with('\n'), "{what}: the last row is whole");
        } else {
            assert!(!session.exists(), "{what}: a folder without a session");
        }
        // Once there is room, the same command works.
        let again = run(folder.path(), &device(60), None, ACQUIRE);
        assert!(again.status.success(), "{what}, then again: {}", String::from_utf8_lossy(&again.stderr));
    }
}

#[test]
fn a_disk_that_fills_up_under_a_calibration_leaves_the_old_file() {
    let folder = folder();
    let path = folder.path().join("unit.toml");
    fs::write(&path, "old").expect("written");
    let line =
        failure(&run(folder.path(), &device(0), Some(100), "calibration --out unit.toml"), "calibration");
    assert!(line.contains("unit.toml: cannot write: File too large"), "{line}");
    assert_eq!(fs::read(&path).expect("there"), b"old");
    assert!(run(folder.path(), &device(0), None, "calibration --out unit.toml").status.success());
    assert!(fs::read_to_string(&path).expect("there").contains("[potentiometer.x]"));
}

fn signal(child: &Child, name: &str) {
    let sent = Command::new("sh").args(["-c", &format!("kill -{name} {}", child.id())]).status();
    assert!(sent.expect("a shell").success());
}

/// Starts a command and sends a signal when the program runs; its output and what the device was sent.
fn signalled(folder: &Path, command: &str, name: &str) -> (Output, Vec<Request>) {
    let program = vec![Act::Batch(32), Act::Wait(1_500)];
    let fake = FakeDevice::start(Script { program, ..Script::default() });
    let command = format!("{command} --port {}", fake.port);
    let mut child = guide(folder, None, &words(&command)).spawn().expect("guide starts");
    let began = Instant::now();
    while !fake.executed().iter().any(|request| matches!(request, Request::Run { .. })) {
        assert!(began.elapsed() < LIMIT, "{command}: nothing runs");
        thread::sleep(Duration::from_millis(5));
    }
    thread::sleep(Duration::from_millis(100));
    signal(&child, name);
    let began = Instant::now();
    while child.try_wait().expect("a state").is_none() {
        assert!(began.elapsed() < LIMIT, "{command}: SIG{name} has no effect");
        thread::sleep(Duration::from_millis(5));
    }
    let output = child.wait_with_output().expect("its output");
    (output, fake.executed())
}

#[test]
#[ignore = "takes half a minute: cargo xtask test --all runs it"]
fn a_signal_in_mid_motion_stops_the_guide_and_is_reported_in_one_line() {
    for command in [
        "home",
        "move --y-mm 1",
        "tare --duration-s 2",
        "acquire --out made --rig rig.toml --depth-mm 20 --program push.toml --no-tare",
    ] {
        let names: &[&str] = if command.starts_with("move") { &["INT", "TERM", "HUP"] } else { &["INT"] };
        for name in names {
            let folder = bench();
            let (output, executed) = signalled(folder.path(), command, name);
            let what = format!("{command}, SIG{name}");
            assert_eq!(failure(&output, &what), "error: interrupted: the guide was stopped");
            assert_eq!(String::from_utf8_lossy(&output.stderr).lines().count(), 1, "{what}");
            assert!(executed.contains(&Request::Stop), "{what}: {executed:?}");
            if command.starts_with("acquire") {
                let read = Session::read(&folder.path().join("made")).expect("a session");
                assert_eq!(read.lateral.first().map(|run| run.force.time_s.len()), Some(32), "{what}");
            }
        }
    }
}
