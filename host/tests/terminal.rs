//! A live screen ends with its terminal, and on the signals that end programs.
#![cfg(all(unix, feature = "screen"))]

use fake_device::{FakeDevice, Script};
use protocol::Request;
use rustix::process::{Pid, Signal, kill_process};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use std::fs::{File, OpenOptions};
use std::os::fd::OwnedFd;
use std::process::{Child, Command, ExitStatus};
use std::thread;
use std::time::{Duration, Instant};

/// Time in which it has to end, and what a busy computer may add.
const WITHIN: Duration = Duration::from_millis(1_000 + 4_000);

/// `guide monitor` on a terminal of its own, which controls no session: nothing but its end tells that it has gone.
fn monitor(device: &FakeDevice) -> (OwnedFd, Child) {
    let terminal =
        openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).expect("a terminal");
    grantpt(&terminal).expect("granted");
    unlockpt(&terminal).expect("unlocked");
    let name = ptsname(&terminal, Vec::new()).expect("its name").into_string().expect("text");
    let side = || -> File { OpenOptions::new().read(true).write(true).open(&name).expect("its other side") };
    let child = Command::new(env!("CARGO_BIN_EXE_guide"))
        .args(["monitor", "--port", &device.port])
        .stdin(side())
        .stdout(side())
        .stderr(side())
        .spawn()
        .expect("starts");
    let began = Instant::now();
    while !device.executed().contains(&Request::Stream { enable: true }) {
        assert!(began.elapsed() < Duration::from_secs(60), "it does not connect");
        thread::sleep(Duration::from_millis(10));
    }
    // Its keys are read from when the alternate screen is there.
    let (mut shown, mut buffer) = (Vec::new(), [0; 4096]);
    while !shown.windows(ALTERNATE_SCREEN.len()).any(|bytes| bytes == ALTERNATE_SCREEN) {
        let count = rustix::io::read(&terminal, &mut buffer).expect("output");
        shown.extend_from_slice(&buffer[..count]);
    }
    (terminal, child)
}

fn ended(child: &mut Child) -> Option<ExitStatus> {
    let began = Instant::now();
    while began.elapsed() < WITHIN {
        if let Some(status) = child.try_wait().expect("a child") {
            return Some(status);
        }
        thread::sleep(Duration::from_millis(10));
    }
    let _ = child.kill();
    None
}

/// Sequence by which a program asks a terminal for its alternate screen.
const ALTERNATE_SCREEN: &[u8] = b"\x1b[?1049h";

#[test]
fn a_monitor_whose_terminal_is_closed_stops_the_guide_and_ends() {
    let device = FakeDevice::start(Script::default());
    let (terminal, mut child) = monitor(&device);
    drop(terminal);
    assert!(ended(&mut child).is_some(), "it outlives its terminal");
    assert!(device.executed().contains(&Request::Stop), "{:?}", device.executed());
}

#[test]
fn a_monitor_ends_on_the_signals_that_end_programs() {
    for signal in [Signal::HUP, Signal::TERM, Signal::INT] {
        let device = FakeDevice::start(Script::default());
        let (terminal, mut child) = monitor(&device);
        kill_process(Pid::from_child(&child), signal).expect("sent");
        assert!(ended(&mut child).is_some_and(|status| status.success()), "{signal:?}");
        assert!(device.executed().contains(&Request::Stream { enable: false }), "telemetry goes on");
        drop(terminal);
    }
}
