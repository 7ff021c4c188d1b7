//! The signals that end programs end every command, whatever it waits for: a file whose writer never comes, a device that never answers,
//! a reader of its output that has stalled.

use super::{folder, guide, help_of, names_of_commands, words};
use rustix::fs::OFlags;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use std::fs::{self, OpenOptions};
use std::io::{ErrorKind, Write};
use std::net::TcpListener;
use std::os::fd::OwnedFd;
use std::os::unix::fs::{OpenOptionsExt, PermissionsExt};
use std::path::Path;
use std::process::{Child, Command};
use std::sync::Mutex;
use std::thread;
use std::time::{Duration, Instant};

/// A way of each command to last: `pipe` is a file without a writer, `stuck` a session with one, PORT a device that never answers, HOST a
/// server that never answers; a command that prints waits for its reader.
const LASTING: [&str; 44] = [
    "init made",
    "check stuck",
    "import trajcontrol pipe --rig rig.toml --out made",
    "simulate --config pipe --out made",
    "web . --page page.html",
    "web . --page page.html --port PORT",
    "identify stuck",
    "predict stuck",
    "track stuck",
    "track . --live --port PORT --tip pipe",
    "diagnose stuck",
    "investigate stuck",
    "discrepancy --model-command=./mute pipe",
    "plan --rig pipe --k-kpa 5 30",
    "plan-path stuck --target-mm=2,1,80",
    "relation --rig pipe --depth-mm 30",
    "effects",
    "report stuck",
    "summarize stuck --out made.jsonl",
    "population pipe",
    "ports",
    "bringup --yes --port PORT",
    "calibration --port PORT",
    "calibrate force pipe --from calibration.toml --out made.toml",
    "calibrate-image pipe --phantom pipe",
    "characterize --port PORT --rig rig.toml --session made",
    "status --port PORT",
    "home --port PORT",
    "tare --port PORT",
    "move --y-mm 1 --port PORT",
    "stop --port PORT",
    "limits --port PORT",
    "retreat --port PORT",
    "clear --port PORT",
    "record --out made --rig rig.toml --depth-mm 20 --port PORT",
    "acquire --out made --rig rig.toml --depth-mm 20 --program program.toml --port PORT",
    "capture --igtl HOST --out made --frames 3",
    "steer made --port PORT --tip cat --target-mm=1,0,50",
    "info pipe",
    "recover pipe --out made.mcap",
    "export pipe --to npy --out made.npy",
    "serve . --igtl=127.0.0.1:0",
    "completions bash",
    "man",
];
/// The live screen needs a terminal: `tests/terminal.rs`. Of `help` there is nothing to interrupt.
const ELSEWHERE: [&str; 2] = ["monitor", "help"];

const PAGE: &str = concat!(
    "<head><meta name=\"generator\" content=\"guide ",
    env!("CARGO_PKG_VERSION"),
    "\"><meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; script-src 'sha256-x='\"><p></head>"
);

/// Time in which a command ends, and what a busy computer may add.
const WITHIN: Duration = Duration::from_millis(1_000 + 4_000);
/// A command that sleeps for so long waits for something.
const ASLEEP: Duration = Duration::from_millis(200);

#[test]
fn every_command_is_in_the_table() {
    for name in names_of_commands(&help_of(&[])) {
        let is_listed = LASTING.iter().any(|command| command.split(' ').next() == Some(&name));
        assert!(is_listed || ELSEWHERE.contains(&name.as_str()), "{name} is not tried");
    }
}

/// What a command waits for, kept open.
struct Waits {
    folder: tempfile::TempDir,
    _device: OwnedFd,
    port: String,
    server: TcpListener,
}

impl Waits {
    fn new() -> Self {
        let folder = folder();
        let stuck = folder.path().join("stuck");
        fs::create_dir(&stuck).expect("a folder");
        for name in ["session.toml", "d20.shape.csv", "i1.csv", "ref1.csv", "s1.csv"] {
            fs::copy(folder.path().join(name), stuck.join(name)).expect("copied");
        }
        for name in ["pipe", "output", "stuck/d20.force.csv"] {
            let made = Command::new("mkfifo").arg(folder.path().join(name)).status();
            assert!(made.expect("mkfifo").success());
        }
        // A model that reads what it is sent and answers nothing, and a page of this version.
        let mute = folder.path().join("mute");
        fs::write(&mute, "#!/bin/sh\nexec cat > /dev/null\n").expect("written");
        fs::set_permissions(&mute, fs::Permissions::from_mode(0o755)).expect("executable");
        fs::write(folder.path().join("page.html"), PAGE).expect("written");
        let device = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC);
        let device = device.expect("a pseudo terminal");
        grantpt(&device).expect("granted");
        unlockpt(&device).expect("unlocked");
        let port = ptsname(&device, Vec::new()).expect("its name").into_string().expect("text");
        let server = TcpListener::bind("127.0.0.1:0").expect("a port");
        Self { folder, _device: device, port, server }
    }

    /// A file that takes nothing any more.
    fn full_output(&self) -> fs::File {
        let path = self.folder.path().join("output");
        let open = |flags: OFlags| {
            OpenOptions::new().read(true).write(true).custom_flags(flags.bits() as i32).open(&path)
        };
        let mut filled = open(OFlags::NONBLOCK).expect("a pipe");
        for size in [4_096, 1] {
            let chunk = vec![b'x'; size];
            loop {
                match filled.write(&chunk) {
                    Ok(_) => {}
                    Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                    Err(error) => panic!("{error}"),
                }
            }
        }
        open(OFlags::empty()).expect("the same pipe")
    }

    /// Starts a command and waits until it waits.
    fn start(&self, command: &str) -> Result<Child, String> {
        let host = self.server.local_addr().expect("an address").to_string();
        let command = command.replace("PORT", &self.port).replace("HOST", &host);
        let mut child = guide(self.folder.path(), None, &words(&command));
        let mut child = child.stdout(self.full_output()).spawn().expect("guide starts");
        let mut awake = Instant::now();
        while awake.elapsed() < ASLEEP {
            thread::sleep(Duration::from_millis(10));
            if let Some(status) = child.try_wait().expect("a state") {
                let output = child.wait_with_output().expect("its output");
                return Err(format!("ends by itself: {status}, {}", String::from_utf8_lossy(&output.stderr)));
            }
            if !is_asleep(child.id()) {
                awake = Instant::now();
            }
        }
        Ok(child)
    }
}

/// The main thread of a process waits.
fn is_asleep(id: u32) -> bool {
    let stat = fs::read_to_string(Path::new("/proc").join(id.to_string()).join("stat")).unwrap_or_default();
    stat.rsplit(") ").next().is_some_and(|rest| rest.starts_with('S'))
}

/// Time that a command takes to end on a signal; or what is wrong with that.
fn ends(command: &str, signal: &str) -> Result<Duration, String> {
    let waits = Waits::new();
    let mut child = waits.start(command)?;
    let sent = Command::new("sh").args(["-c", &format!("kill -{signal} {}", child.id())]).status();
    assert!(sent.expect("a shell").success());
    let began = Instant::now();
    while child.try_wait().expect("a state").is_none() {
        if began.elapsed() > WITHIN {
            child.kill().expect("killed");
            child.wait().expect("ended");
            return Err(format!("does not end within {WITHIN:?}"));
        }
        thread::sleep(Duration::from_millis(5));
    }
    Ok(began.elapsed())
}

#[test]
#[ignore = "takes a minute: cargo xtask test --all runs it"]
fn the_signals_that_end_programs_end_every_command_whatever_it_waits_for() {
    let cases = LASTING.iter().flat_map(|command| ["INT", "TERM", "HUP"].map(|signal| (*command, signal)));
    let (cases, failed) = (Mutex::new(cases), Mutex::new(Vec::new()));
    thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                loop {
                    let Some((command, signal)) = cases.lock().expect("sound").next() else { break };
                    match ends(command, signal) {
                        Ok(took) => println!("{took:?} {command}, {signal}"),
                        Err(found) => {
                            failed.lock().expect("sound").push(format!("{command}, {signal}: {found}"))
                        }
                    }
                }
            });
        }
    });
    let failed = failed.into_inner().expect("sound");
    assert!(failed.is_empty(), "{}", failed.join("\n"));
}
