//! Commands that write what a device sends, and commands that move it: a disk that is full at any byte, and signals.

use super::{failure, files, folder, guide, words};
use fake_device::{Act, FakeDevice, Script};
use formats::session::Session;
use protocol::Request;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use std::collections::BTreeSet;
use std::fs;
use std::os::fd::OwnedFd;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
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
    let made_files = files(&undisturbed.path().join("made"));
    let size = |name: &str| made_files.get(Path::new(name)).map_or(0, |content| content.len() as u64);
    let mcap = size("d20-1.mcap");
    let rows = size("d20-1.force.csv");
    assert!(mcap > 10_000 && rows > 10_000, "{mcap} and {rows} bytes");
    let limits: BTreeSet<u64> =
        [0, 1, size("session.toml") - 1, rows / 3, rows - 1, mcap * 3 / 4].into_iter().collect();
    for bytes in limits {
        let context = format!("acquire with {bytes} bytes a file");
        let folder = bench();
        let fake = device(60);
        let line = failure(&run(folder.path(), &fake, Some(bytes), ACQUIRE), &context);
        assert!(line.contains("File too large"), "{context}: {line}");
        let executed = fake.executed();
        let runs = executed.iter().any(|request| matches!(request, Request::Run { .. }));
        // A disk that is full from the beginning lets nothing run; one that fills up during the run ends it; the last bytes come after it.
        assert_eq!(runs, bytes > 1, "{context}: {line}; {executed:?}");
        if runs && bytes <= rows / 3 {
            assert!(executed.contains(&Request::Stop), "{context}: {line}; {executed:?}");
        }
        let session = folder.path().join("made");
        if session.join("session.toml").exists() {
            let read = Session::read(&session);
            let read = read.unwrap_or_else(|error| panic!("{context}: {error}"));
            let times_s = read.lateral.first().map_or(&[][..], |run| run.force.time_s.as_slice());
            assert!(times_s.windows(2).all(|pair| pair[1] > pair[0]), "{context}: whole rows in order");
            let text = fs::read_to_string(session.join("d20-1.force.csv")).unwrap_or_default();
            assert!(text.is_empty() || text.ends_with('\n'), "{context}: the last row is whole");
        } else {
            assert!(!session.exists(), "{context}: a folder without a session");
        }
        // Once there is room, the same command works.
        let again = run(folder.path(), &device(60), None, ACQUIRE);
        assert!(again.status.success(), "{context}, then again: {}", String::from_utf8_lossy(&again.stderr));
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

/// Event that ends a command.
#[derive(Debug, Clone, Copy)]
enum End {
    Signal(&'static str),
    /// The terminal from which it was started is closed.
    Terminal,
}

const ENDS: [End; 4] = [End::Signal("INT"), End::Signal("TERM"), End::Signal("HUP"), End::Terminal];

/// A command that is started at a terminal of its own.
fn at_terminal(folder: &Path, command: &str) -> (OwnedFd, Child) {
    let terminal =
        openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).expect("a terminal");
    grantpt(&terminal).expect("granted");
    unlockpt(&terminal).expect("unlocked");
    let name = ptsname(&terminal, Vec::new()).expect("its name").into_string().expect("text");
    let side = fs::OpenOptions::new().read(true).write(true).open(name).expect("its other side");
    let mut child = Command::new("setsid");
    child.args(["--ctty", "--wait", env!("CARGO_BIN_EXE_guide")]).args(words(command)).current_dir(folder);
    child.stdin(side).stdout(Stdio::piped()).stderr(Stdio::piped());
    (terminal, child.spawn().expect("guide starts"))
}

/// Starts a command, and ends it when the device has had a request; its output, what the device was sent, and how long it took.
fn ended(
    folder: &Path,
    command: &str,
    end: End,
    begun: impl Fn(&Request) -> bool,
) -> (Output, Vec<Request>, Duration) {
    let program = vec![Act::Batch(32), Act::Wait(10_000)];
    let fake = FakeDevice::start(Script { program, is_patient: true, ..Script::default() });
    let command = format!("{command} --port {}", fake.port);
    let (mut terminal, mut child) = match end {
        End::Signal(_) => (None, guide(folder, None, &words(&command)).spawn().expect("guide starts")),
        End::Terminal => {
            let (terminal, child) = at_terminal(folder, &command);
            (Some(terminal), child)
        }
    };
    let began = Instant::now();
    while !fake.executed().iter().any(&begun) {
        assert!(began.elapsed() < LIMIT, "{command}: nothing runs");
        thread::sleep(Duration::from_millis(5));
    }
    thread::sleep(Duration::from_millis(100));
    let began = Instant::now();
    match end {
        End::Signal(name) => signal(&child, name),
        End::Terminal => drop(terminal.take()),
    }
    while child.try_wait().expect("a state").is_none() {
        assert!(began.elapsed() < LIMIT, "{command}: {end:?} has no effect");
        thread::sleep(Duration::from_millis(5));
    }
    let took = began.elapsed();
    let output = child.wait_with_output().expect("its output");
    (output, fake.executed(), took)
}

/// Time in which a command ends, and what a busy computer may add.
const WITHIN: Duration = Duration::from_millis(1_000 + 4_000);

#[test]
#[ignore = "takes half a minute: cargo xtask test --all runs it"]
fn what_ends_a_program_in_mid_motion_stops_the_guide_and_is_reported_in_one_line() {
    let mut longest = Duration::ZERO;
    for command in [
        "home",
        "move --y-mm 1",
        "tare --duration-s 2",
        "acquire --out made --rig rig.toml --depth-mm 20 --program push.toml --no-tare",
        "characterize --rig rig.toml --session air --out made.toml",
    ] {
        for end in ENDS {
            let folder = bench();
            let (output, executed, took) = ended(folder.path(), command, end, |request: &Request| {
                matches!(request, Request::Run { .. })
            });
            let context = format!("{command}, {end:?}");
            if matches!(end, End::Signal(_)) {
                assert_eq!(failure(&output, &context), "error: interrupted: the guide was stopped");
                // The bring-up in air states before what it is going to do.
                let lines = if command.starts_with("characterize") { 2 } else { 1 };
                assert_eq!(String::from_utf8_lossy(&output.stderr).lines().count(), lines, "{context}");
            }
            assert!(took < WITHIN, "{context}: {took:?}");
            longest = longest.max(took);
            assert!(executed.contains(&Request::Stop), "{context}: {executed:?}");
            if command.starts_with("acquire") {
                let read = Session::read(&folder.path().join("made")).expect("a session");
                assert_eq!(read.lateral.first().map(|run| run.force.time_s.len()), Some(32), "{context}");
            }
        }
    }
    println!("{longest:?} at most");
}

/// The device does not move, and neither keepalive nor hold continues.
#[test]
#[ignore = "takes some seconds: cargo xtask test --all runs it"]
fn what_ends_a_program_that_follows_the_device_ends_it_at_once() {
    for command in ["record --out made --rig rig.toml --depth-mm 20", "serve . --igtl=127.0.0.1:0"] {
        for end in ENDS {
            let folder = if command.starts_with("serve") { folder() } else { bench() };
            let (_, executed, took) = ended(folder.path(), command, end, |request: &Request| {
                matches!(request, Request::Stream { enable: true })
            });
            assert!(took < WITHIN, "{command}, {end:?}: {took:?}");
            let runs = executed.iter().any(|request| matches!(request, Request::Run { .. }));
            assert!(!runs, "{command}, {end:?}: {executed:?}");
        }
    }
}
