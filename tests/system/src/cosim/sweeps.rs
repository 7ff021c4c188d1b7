//! The rig's ultrasound probe on sockets: one sweep per connection, as text that `guide acquire` takes, or as a scan from which frames are rendered.
//!
//! A sweep costs no device time: from the connection on, device time waits ([`super::gate`]) until the program that takes the
//! sweep has ended and been waited for by the one that started it, which then has all of its output.

use super::{POLL_INTERVAL, State, lock};
use crate::qemu::HANGS;
use anyhow::{Context, Result};
use rustix::process::{Pid, test_kill_process};
use simulation::rig::SimulatedRig;
use simulation::rig::scanner::Scan;
use std::fs;
use std::io::{ErrorKind, Read, Write};
use std::net::Shutdown;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

/// Time for which device time waits for a program that takes a sweep, by the computer's clock: one that hangs, or that
/// is never reaped, must not keep it for ever.
const TIMEOUT: Duration = Duration::from_secs(20);

/// Function that reads the present rig.
type Taken = fn(&mut SimulatedRig) -> String;

pub(super) fn serve(
    path: &Path,
    state: Arc<Mutex<State>>,
    stop: Arc<AtomicBool>,
    taken: Taken,
) -> Result<()> {
    let listener = UnixListener::bind(path)
        .with_context(|| format!("cannot serve ultrasound sweeps at {}", path.display()))?;
    thread::Builder::new().name("ultrasound".into()).spawn(move || {
        for stream in listener.incoming() {
            if stop.load(Ordering::Acquire) {
                return;
            }
            if let Ok(stream) = stream {
                lock(&state).gate.sweep_begins();
                give(stream, &state, &stop, taken);
                lock(&state).gate.sweep_ends();
            }
        }
    })?;
    Ok(())
}

/// Gives one sweep, and waits for the end of the program that takes it.
fn give(mut stream: UnixStream, state: &Mutex<State>, stop: &AtomicBool, taken: Taken) {
    let text = taken(&mut lock(state).rig);
    // A client that has gone away takes no sweep; the next one will.
    let sent = stream.write_all(text.as_bytes()).and_then(|()| stream.shutdown(Shutdown::Write));
    if sent.is_err() || stream.set_read_timeout(Some(POLL_INTERVAL)).is_err() {
        return;
    }
    let began = Instant::now();
    let mut received = Vec::new();
    while goes_on(&began, stop) && is_open(&mut stream, &mut received) {}
    let taker =
        str::from_utf8(&received).ok().and_then(|text| text.trim().parse().ok()).and_then(Pid::from_raw);
    while goes_on(&began, stop) && taker.is_some_and(|taker| test_kill_process(taker).is_ok()) {
        thread::sleep(POLL_INTERVAL);
    }
}

fn goes_on(began: &Instant, stop: &AtomicBool) -> bool {
    began.elapsed() < TIMEOUT && !stop.load(Ordering::Acquire)
}

/// Whether the far end has it open, checked for a moment; what it has sent is kept.
fn is_open(stream: &mut UnixStream, received: &mut Vec<u8>) -> bool {
    let mut bytes = [0; 64];
    match stream.read(&mut bytes) {
        Ok(length) => {
            received.extend(bytes.iter().take(length));
            // Far more than a number has.
            length > 0 && received.len() < bytes.len()
        }
        Err(error) => {
            matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted)
        }
    }
}

/// A scan as JSON; empty where it cannot be written as that.
pub(super) fn scan_json(rig: &mut SimulatedRig) -> String {
    serde_json::to_string(&rig.scan()).unwrap_or_default()
}

pub(super) fn sweep_csv(rig: &mut SimulatedRig) -> String {
    let mut text = String::from("z_mm,deflection_x_mm,deflection_y_mm\n");
    for sample in rig.sweep() {
        let [x, y] = sample.deflection_m.map(|metres| metres * 1e3);
        text += &format!("{:.3},{x:.4},{y:.4}\n", sample.z_m * 1e3);
    }
    text
}

/// Takes a scan from a rig that serves them, renders its frames and saves them in a folder under a new name: what `xtask frames` does. The rig
/// waits for the end of this process.
///
/// # Errors
/// Where there is no server, or the file cannot be written.
pub fn take_frames(socket: &Path, folder: &Path) -> Result<(PathBuf, TakenSweep)> {
    let sweep = take_sweep(socket, true)?;
    let scan: Scan = serde_json::from_str(&sweep.text).context("what the rig serves is no scan")?;
    fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let mut names = (1..).map(|number: u32| folder.join(format!("sweep-{number}.igs.mha")));
    let path = names.find(|path| !path.exists()).unwrap_or_default();
    scan.write(&path).with_context(|| format!("cannot write {}", path.display()))?;
    Ok((path, sweep))
}

/// A sweep that is being taken. The rig waits until this is dropped: the program that prints the text keeps it until that is done.
#[derive(Debug)]
pub struct TakenSweep {
    /// The sweep as CSV.
    pub text: String,
    _stream: UnixStream,
}

/// Takes one sweep from a rig that serves them: what `xtask sweep` prints. The rig waits for the end of this process too, if a
/// program is to have its output.
///
/// # Errors
/// Where there is no server.
pub fn take_sweep(socket: &Path, for_a_program: bool) -> Result<TakenSweep> {
    let mut stream = UnixStream::connect(socket)
        .with_context(|| format!("no simulated ultrasound at {}", socket.display()))?;
    stream.set_read_timeout(Some(HANGS))?;
    if for_a_program {
        write!(stream, "{}", std::process::id())?;
    }
    let mut text = String::new();
    stream.read_to_string(&mut text).context("the simulated ultrasound broke off")?;
    Ok(TakenSweep { text, _stream: stream })
}

#[cfg(test)]
mod tests {
    use super::super::gate::Waiting;
    use super::super::wiring::Wiring;
    use super::super::{Electronics, Gate, Reach};
    use super::*;
    use simulation::rig::config::RigConfig;
    use std::process::{Command, Stdio};

    /// A rig that serves sweeps.
    fn served(folder: &Path) -> (std::path::PathBuf, Arc<Mutex<State>>, Arc<AtomicBool>) {
        let state = State {
            rig: SimulatedRig::new(RigConfig::default(), 1).unwrap(),
            electronics: Electronics::new(1.0, Wiring::new(Vec::new(), 0, 1.0, 0.0)),
            steps: 0,
            resets: 0,
            started: 0,
            reach: Reach::default(),
            watched: None,
            history: None,
            gate: Gate::new(),
            allowance: None,
            sent_bytes: 0,
        };
        let (state, stop) = (Arc::new(Mutex::new(state)), Arc::new(AtomicBool::new(false)));
        let socket = folder.join("ultrasound");
        serve(&socket, Arc::clone(&state), Arc::clone(&stop), sweep_csv).unwrap();
        (socket, state, stop)
    }

    fn waits(state: &Mutex<State>) -> bool {
        lock(state).gate.waiting(0, Instant::now()) == Some(Waiting::Sweep)
    }

    fn eventually(mut holds: impl FnMut() -> bool) {
        let began = Instant::now();
        while !holds() {
            assert!(began.elapsed() < HANGS, "never");
            thread::sleep(POLL_INTERVAL);
        }
    }

    #[test]
    fn device_time_waits_while_a_sweep_is_taken_and_no_longer() {
        let folder = tempfile::tempdir().unwrap();
        let (socket, state, stop) = served(folder.path());
        assert!(!waits(&state));
        let sweep = take_sweep(&socket, false).unwrap();
        assert!(sweep.text.lines().count() > 10, "{}", sweep.text);
        assert!(waits(&state), "until it is dropped");
        drop(sweep);
        eventually(|| !waits(&state));
        stop.store(true, Ordering::Release);
    }

    #[test]
    fn device_time_waits_until_the_program_that_took_a_sweep_is_reaped() {
        let folder = tempfile::tempdir().unwrap();
        let (socket, state, stop) = served(folder.path());
        // It ends when its input does, and is a process until it has been waited for.
        let mut program = Command::new("cat").stdin(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap();
        let mut stream = UnixStream::connect(&socket).unwrap();
        write!(stream, "{}", program.id()).unwrap();
        stream.read_to_string(&mut String::new()).unwrap();
        drop(stream);
        eventually(|| waits(&state));
        drop(program.stdin.take());
        for _ in 0..20 {
            thread::sleep(POLL_INTERVAL);
            assert!(waits(&state), "it has not been waited for");
        }
        program.wait().unwrap();
        eventually(|| !waits(&state));
        stop.store(true, Ordering::Release);
    }
}
