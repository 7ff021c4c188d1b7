//! Running an image in QEMU, with a time limit and its log.

use crate::images::Board;
use anyhow::{Context, Result, bail};
#[cfg(feature = "firmware-log")]
use defmt_decoder::{DecodeError, Table};
use std::collections::VecDeque;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// The QEMU program.
const QEMU: &str = "qemu-system-arm";
/// File in which a process sets the priority of its session, on kernels that can.
const AUTOGROUP: &str = "/proc/self/autogroup";
/// Nanoseconds of virtual time per instruction, as a power of two: 4 ns, three times as fast as the real part. An emulated
/// register access takes 200 instructions; at this rate a control period has the share of a millisecond it has on the board.
const ICOUNT_SHIFT: u32 = 2;
/// After this, by the computer's clock, something hangs. No limit of speed: many times what the slowest computer takes.
pub const HANGS: Duration = Duration::from_secs(1_800);
/// Name of the pipe in QEMU's working folder that gets a copy of what leaves the serial port, where it is there.
pub(crate) const OUTPUT_PIPE: &str = "serial.out";
/// Interval at which the end of QEMU is polled.
const POLL: Duration = Duration::from_millis(20);

/// Lines of the firmware's log that are kept, so that a run of hours takes no more memory than one of minutes.
#[cfg(feature = "firmware-log")]
const LOG_LINES: usize = 2_000;

/// Other end of the firmware's serial port. Its path is `serial` in the working folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Line {
    /// A socket.
    Socket,
    /// A pseudo terminal, for programs that expect a serial port. Kernels' workers carry its bytes, and there are kernels that let those wait
    /// for seconds while all processors are busy.
    Terminal,
}

/// A running QEMU. Dropping it ends it.
#[derive(Debug)]
pub struct Qemu {
    child: Arc<Mutex<Child>>,
    log: Arc<Mutex<VecDeque<String>>>,
    decoder: Option<JoinHandle<()>>,
    serial: PathBuf,
    deadline: Arc<Mutex<Option<Instant>>>,
    _turn: Turn,
}

/// QEMUs of this process that run now.
static RUNNING: Mutex<usize> = Mutex::new(0);
/// One of them ended.
static ENDED: Condvar = Condvar::new();

/// The right to run a QEMU, which takes about a processor: as many run at a time as there are processors. Code that starts something
/// that waits for QEMU takes the turn first, and then starts it.
#[derive(Debug)]
pub struct Turn(());

/// Waits for its turn.
pub fn turn() -> Turn {
    let processors = thread::available_parallelism().map_or(1, usize::from);
    let running = RUNNING.lock().unwrap_or_else(PoisonError::into_inner);
    let mut running =
        ENDED.wait_while(running, |running| *running >= processors).unwrap_or_else(PoisonError::into_inner);
    *running += 1;
    Turn(())
}

impl Drop for Turn {
    fn drop(&mut self) {
        *RUNNING.lock().unwrap_or_else(PoisonError::into_inner) -= 1;
        ENDED.notify_one();
    }
}

impl Qemu {
    /// Starts an image of the first board with its working folder; otherwise as [`Self::start_for`].
    ///
    /// # Errors
    /// As [`Self::start_for`].
    pub fn start(turn: Turn, elf: &Path, folder: &Path, limit: Duration) -> Result<Self> {
        Self::start_for(Board::BL475eIot01a, Line::Socket, turn, elf, folder, limit)
    }

    /// Starts an image with its working folder, where the plant pipes are and the serial port appears. It is killed when
    /// the time limit is over, even if it hangs.
    ///
    /// # Errors
    /// Where QEMU cannot be started or its serial port does not appear.
    pub fn start_for(
        board: Board,
        line: Line,
        turn: Turn,
        elf: &Path,
        folder: &Path,
        limit: Duration,
    ) -> Result<Self> {
        let serial = folder.join("serial");
        let mut port = match line {
            // The name in the working folder: a socket's path may have 107 bytes.
            Line::Socket => "socket,id=usb,path=serial,server=on,wait=off".to_owned(),
            Line::Terminal => format!("pty,id=usb,path={}", serial.display()),
        };
        if folder.join(OUTPUT_PIPE).exists() {
            // The device's output is read.
            port += &format!(",logfile={OUTPUT_PIPE}");
        }
        let mut child = session(line)
            .current_dir(folder)
            .args(["-machine", "b-l475e-iot01a", "-display", "none", "-monitor", "none", "-nodefaults"])
            .arg("-chardev")
            .arg(port)
            .args(["-serial", "null"].repeat(board.serial_ports_before()))
            .args(["-serial", "chardev:usb"])
            .args(["-semihosting-config", "enable=on,target=native"])
            .args(["-icount", &format!("shift={ICOUNT_SHIFT},sleep=off")])
            .arg("-kernel")
            .arg(elf)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .with_context(|| format!("cannot start {QEMU}"))?;
        let log = Arc::new(Mutex::new(VecDeque::new()));
        let stdout = child.stdout.take().context("QEMU has no output")?;
        let mut stderr = child.stderr.take().context("QEMU has no error output")?;
        let image = std::fs::read(elf).with_context(|| format!("cannot read {}", elf.display()))?;
        let decoder = thread::Builder::new().name("firmware log".into()).spawn({
            let log = Arc::clone(&log);
            move || decode(&image, stdout, &log)
        })?;
        thread::Builder::new().name("qemu messages".into()).spawn({
            let log = Arc::clone(&log);
            move || {
                let mut text = String::new();
                let _ = stderr.read_to_string(&mut text);
                let mut log = log.lock().unwrap_or_else(PoisonError::into_inner);
                log.extend(text.lines().map(|line| format!("qemu: {line}")));
            }
        })?;
        let child = Arc::new(Mutex::new(child));
        let deadline = Arc::new(Mutex::new(Instant::now().checked_add(limit)));
        kill_at(&child, Arc::clone(&deadline))?;
        let qemu = Self { child, log, decoder: Some(decoder), serial, deadline, _turn: turn };
        qemu.await_serial()?;
        Ok(qemu)
    }

    /// The serial port, as the host opens it.
    pub fn serial(&self) -> &Path {
        &self.serial
    }

    /// The end of the firmware's log so far, and QEMU's own messages.
    pub fn log(&self) -> Vec<String> {
        self.log.lock().unwrap_or_else(PoisonError::into_inner).iter().cloned().collect()
    }

    /// Sets another time limit, from now on.
    pub fn limit(&self, limit: Duration) {
        *self.deadline.lock().unwrap_or_else(PoisonError::into_inner) = Instant::now().checked_add(limit);
    }

    /// Waits for the firmware to end by itself; returns its exit code.
    ///
    /// # Errors
    /// Where it has not ended in time.
    pub fn wait(mut self, limit: Duration) -> Result<(i32, Vec<String>)> {
        let deadline = Instant::now() + limit;
        loop {
            if let Some(status) = self.exited()? {
                if let Some(decoder) = self.decoder.take() {
                    let _ = decoder.join();
                }
                return Ok((status.code().unwrap_or(-1), self.log()));
            }
            if Instant::now() > deadline {
                bail!("the firmware has not ended in {limit:?}; its log: {:#?}", self.log());
            }
            thread::sleep(POLL);
        }
    }

    /// Exit status; `None` while it runs.
    ///
    /// # Errors
    /// Where the system does not report it.
    pub fn exited(&self) -> Result<Option<ExitStatus>> {
        self.child.lock().unwrap_or_else(PoisonError::into_inner).try_wait().context("cannot check QEMU")
    }

    fn await_serial(&self) -> Result<()> {
        let deadline = Instant::now() + HANGS;
        while !self.serial.exists() {
            if let Some(status) = self.exited()? {
                bail!("QEMU ended at once ({status}): {:?}", self.log());
            }
            if Instant::now() > deadline {
                bail!("QEMU made no serial port in {HANGS:?}: {:?}", self.log());
            }
            thread::sleep(POLL);
        }
        Ok(())
    }
}

impl Drop for Qemu {
    fn drop(&mut self) {
        let mut child = self.child.lock().unwrap_or_else(PoisonError::into_inner);
        let _ = child.kill();
        let _ = child.wait();
    }
}

/// QEMU as a session of its own where sessions share the processors: so it has its part of them beside a shell that keeps all of them
/// busy, and the device answers in time. At a terminal it leaves them to others. An emulator takes a whole one, and there are kernels
/// (Linux 6.18) that then give none to their own workers, which carry the bytes of pseudo terminals: nothing arrives for seconds.
fn session(line: Line) -> Command {
    if !Path::new(AUTOGROUP).exists() {
        return Command::new(QEMU);
    }
    let mut command = Command::new("setsid");
    match line {
        Line::Socket => command.arg(QEMU),
        Line::Terminal => {
            let standing_back = format!("{{ echo 10 > {AUTOGROUP}; }} 2> /dev/null; exec \"$0\" \"$@\"");
            command.args(["sh", "-c", &standing_back, QEMU])
        }
    };
    command
}

/// Kills QEMU when its time is over; where there is no such time it never is.
fn kill_at(child: &Arc<Mutex<Child>>, deadline: Arc<Mutex<Option<Instant>>>) -> Result<()> {
    let child = Arc::downgrade(child);
    thread::Builder::new().name("qemu time limit".into()).spawn(move || {
        while !is_over(&deadline) {
            thread::sleep(POLL);
            if child.strong_count() == 0 {
                return;
            }
        }
        if let Some(child) = child.upgrade() {
            let _ = child.lock().unwrap_or_else(PoisonError::into_inner).kill();
        }
    })?;
    Ok(())
}

fn is_over(deadline: &Mutex<Option<Instant>>) -> bool {
    let deadline = *deadline.lock().unwrap_or_else(PoisonError::into_inner);
    deadline.is_some_and(|deadline| Instant::now() >= deadline)
}

/// Takes the log off, so that the firmware does not wait for a reader, and leaves one line of it.
#[cfg(not(feature = "firmware-log"))]
fn decode(_: &[u8], mut stdout: ChildStdout, log: &Mutex<VecDeque<String>>) {
    let mut buffer = [0; 1024];
    while let Ok(1..) = stdout.read(&mut buffer) {}
    let line = "(this build does not decode the firmware's log: `cargo xtask rig` does)".to_owned();
    log.lock().unwrap_or_else(PoisonError::into_inner).push_back(line);
}

#[cfg(feature = "firmware-log")]
fn decode(image: &[u8], mut stdout: ChildStdout, log: &Mutex<VecDeque<String>>) {
    let table = match Table::parse(image) {
        Ok(Some(table)) => table,
        _ => return push("(the image has no log table)".to_owned(), log),
    };
    let mut decoder = table.new_stream_decoder();
    let mut buffer = [0; 1024];
    while let Ok(length @ 1..) = stdout.read(&mut buffer) {
        decoder.received(buffer.get(..length).unwrap_or_default());
        loop {
            match decoder.decode() {
                Ok(frame) => push(frame.display(false).to_string(), log),
                Err(DecodeError::UnexpectedEof) => break,
                Err(DecodeError::Malformed) if table.encoding().can_recover() => {}
                Err(DecodeError::Malformed) => {
                    return push("(the log is garbled from here on)".to_owned(), log);
                }
            }
        }
    }
}

#[cfg(feature = "firmware-log")]
fn push(line: String, log: &Mutex<VecDeque<String>>) {
    let mut log = log.lock().unwrap_or_else(PoisonError::into_inner);
    if log.len() == LOG_LINES {
        log.pop_front();
    }
    log.push_back(line);
}
