//! `cargo xtask left-running`: what a laboratory leaves running: `guide serve` with its clients, then the screen of `guide monitor`, on
//! a port that is unplugged, comes back under another name and is wanted by a second program.
//!
//! | what must hold | how |
//! |---|---|
//! | memory does not grow | of the program, by [`memory::GROWTH_LIMIT_BYTES`] at most in 10 minutes of the device's time |
//! | clocks do not drift | stamps against the rig's own time |
//! | updates come back after every unplugging, each stamp later than the one before | a viewer of this process |
//! | clients that speak half messages, nonsense or nothing disturb nobody | [`peers`] |
//! | a second program on the port reports that it is in use, and disturbs no other | `guide status` |
//! | the end is clean | exit code 0 |

mod memory;
mod peers;
mod worker;

use crate::bench::Bench;
use crate::images::build_guide;
use crate::numbers::minutes;
use crate::pty::{Pty, wait};
use crate::qemu::HANGS;
use crate::wire::NoisyWire;
use anyhow::{Context, Result, ensure};
use memory::{GROWTH_LIMIT_BYTES, Memory};
use peers::{Stranger, Viewer};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rustix::event::{PollFlags, Timespec};
use rustix::process::{Pid, Signal, kill_process};
use rustix::termios::{Winsize, tcsetwinsize};
use simulation::rig::config::RigConfig;
use std::fmt::{self, Display};
use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

/// Rig seconds per second: as many as the machine can do.
const SPEED: f64 = f64::INFINITY;
/// Wall-clock time for a second of the device's after which something hangs.
const SLOWEST: f64 = 20.0;
/// Time after which a program must not grow any more, milliseconds of the rig's, where the run is long enough.
const WARM_MS: u64 = 120_000;
/// Time between two looks at everything.
const POLL: Duration = Duration::from_millis(20);
/// The rig's time between two unpluggings, milliseconds.
const PLUGGED_MS: std::ops::Range<u64> = 15_000..90_000;
/// Time without the cable.
const UNPLUGGED: std::ops::Range<u64> = 100..2_500;
/// The rig's time between two attempts of a second program, milliseconds.
const SECOND_PROGRAM_MS: u64 = 10_000;
/// Share of its time by which stamps may go faster or slower than the rig: what they may follow the computer's clock by, and more.
const DRIFT: f64 = 300e-6;
/// Largest delay of an update on a busy computer, seconds.
const LATE_S: f64 = 2.0;
/// Keys of the screen that are pressed: motions, stop, clear, window, help.
const KEYS: [&[u8]; 10] = [b"\x1b[A", b"\x1b[B", b"\x1b[C", b"\x1b[D", b"s", b"c", b"+", b"-", b"?", b"h"];
/// The rig's time between two keys, milliseconds.
const KEY_MS: u64 = 700;
const TIMEOUT: Timespec = Timespec { tv_sec: 0, tv_nsec: 20_000_000 };

/// Options of `cargo xtask left-running`.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct Args {
    /// Duration, minutes of the device's time
    #[arg(long, default_value_t = 60.0, value_name = "MINUTES", value_parser = minutes, allow_negative_numbers = true)]
    pub minutes: f64,
    /// Seed of the rig and of all that is done to it
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// Result of the run.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Served {
    /// Time of the rig, seconds.
    pub rig_s: f64,
    /// Time of this computer, seconds.
    pub wall_s: f64,
    /// Updates that a viewer has received.
    pub updates: u64,
    /// Stamps less the rig's time over the whole, seconds: what an update is late by may differ.
    pub drift_s: f64,
    /// Connections of clients that speak no sense.
    pub strangers: u64,
    /// Second programs that reported that the port is in use.
    pub refused: u32,
    /// Number of times the port came back under another name.
    pub replugged: u32,
    /// Keys pressed on the screen.
    pub keys: u32,
    /// Bytes that the screen has drawn.
    pub drawn_bytes: u64,
    /// Size of `serve` and `monitor` after warming up and at their end, bytes; `None` after a short run, or where the system does not report it.
    pub memory_bytes: [Option<[u64; 2]>; 2],
}

impl Display for Served {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{:.0} s of the rig in {:.0} s", self.rig_s, self.wall_s)?;
        writeln!(
            f,
            "  guide serve: {} updates, none lost for good; stamps {:+.3} s against the rig's time; {} other clients; {} second programs rejected",
            self.updates, self.drift_s, self.strangers, self.refused
        )?;
        writeln!(f, "  guide monitor: {} keys, {} KiB drawn", self.keys, self.drawn_bytes / 1024)?;
        writeln!(f, "  the port came back under another name {} times", self.replugged)?;
        let sizes =
            ["serve", "monitor"].into_iter().zip(self.memory_bytes).map(|(name, bytes)| match bytes {
                Some([first, last]) => {
                    format!("{name} {} KiB after warming up, {} KiB at the end", first / 1024, last / 1024)
                }
                None => format!(
                    "{name}: not measured (a run of {} min or less, or a system without /proc)",
                    4 * WARM_MS / 60_000
                ),
            });
        let sizes = sizes.collect::<Vec<_>>().join("; ");
        write!(f, "  memory: {sizes} (limit: {} KiB more per 10 minutes)", GROWTH_LIMIT_BYTES / 1024)
    }
}

/// Runs it: half of the time `serve`, half of it `monitor`.
///
/// # Errors
/// Where anything does not hold.
pub fn run(args: Args) -> Result<Served> {
    let limit = HANGS + Duration::from_secs_f64(args.minutes * 60.0 * SLOWEST);
    let bench = Bench::at_terminal(RigConfig::default(), args.seed, SPEED, limit)?;
    bench.rig().host_may_be_silent(true);
    let began = Instant::now();
    let guide = build_guide()?;
    let session = bench.folder().join("session");
    let example =
        Command::new(&guide).args(["init", "--example"]).arg(&session).stdout(Stdio::null()).status()?;
    ensure!(example.success(), "guide init --example fails");
    let half_ms = (args.minutes * 30e3) as u64;
    let mut rig = Desk {
        bench: &bench,
        guide,
        cable: Cable::new(&bench, args.seed)?,
        random: ChaCha8Rng::seed_from_u64(args.seed),
        // A short run is over before the session's results are published, which takes memory once.
        warm_ms: if half_ms > 2 * WARM_MS { WARM_MS } else { u64::MAX / 2 },
        served: Served::default(),
    };
    rig.serve(&session, half_ms).with_context(|| format!("seed {}, guide serve", args.seed))?;
    rig.monitor(half_ms).with_context(|| format!("seed {}, guide monitor", args.seed))?;
    let Desk { cable, mut served, .. } = rig;
    drop(cable);
    (served.rig_s, served.wall_s) = (bench.rig().steps() as f64 * 1e-3, began.elapsed().as_secs_f64());
    bench.stop()?;
    Ok(served)
}

/// A serial port that comes and goes, under a name that stays as `/dev/serial/by-id` does.
struct Cable {
    device: PathBuf,
    link: PathBuf,
    seed: u64,
    wire: Option<NoisyWire>,
}

impl Cable {
    fn new(bench: &Bench, seed: u64) -> Result<Self> {
        let (device, link) = (bench.folder().join("serial"), bench.folder().join("by-id"));
        let mut cable = Self { device, link, seed, wire: None };
        cable.plug()?;
        Ok(cable)
    }

    fn unplug(&mut self) {
        self.wire = None;
    }

    fn plug(&mut self) -> Result<()> {
        let wire = NoisyWire::connect(&self.device, self.seed)?;
        let _ = std::fs::remove_file(&self.link);
        std::os::unix::fs::symlink(wire.port(), &self.link)?;
        self.wire = Some(wire);
        Ok(())
    }
}

struct Desk<'a> {
    bench: &'a Bench,
    guide: PathBuf,
    cable: Cable,
    random: ChaCha8Rng,
    warm_ms: u64,
    served: Served,
}

impl Desk<'_> {
    fn now_ms(&self) -> u64 {
        self.bench.rig().steps()
    }

    fn serve(&mut self, session: &Path, duration_ms: u64) -> Result<()> {
        let mut command = Command::new(&self.guide);
        command.arg("serve").arg(session).arg("--igtl=127.0.0.1:0").arg("--port").arg(&self.cable.link);
        command.args(["--k-kpa", "17"]).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut program = Program::start(command, self.now_ms() + self.warm_ms)?;
        let address = program.address()?;
        let viewer = Viewer::connect(address)?;
        let stranger = Stranger::start(address, self.random.random());
        self.await_updates(&viewer, 2, &mut program)?;
        let (first, first_ms) = (viewer.last(), self.now_ms());
        let (mut unplug_ms, mut second_ms) =
            (first_ms + self.random.random_range(PLUGGED_MS), first_ms + SECOND_PROGRAM_MS);
        while self.now_ms() < first_ms + duration_ms {
            program.check(self.now_ms())?;
            if self.now_ms() >= second_ms {
                self.second_program()?;
                second_ms = self.now_ms() + SECOND_PROGRAM_MS;
            }
            if self.now_ms() >= unplug_ms {
                self.replug()?;
                let updates_before = viewer.last().updates;
                self.await_updates(&viewer, updates_before + 2, &mut program)?;
                unplug_ms = self.now_ms() + self.random.random_range(PLUGGED_MS);
            }
            thread::sleep(POLL);
        }
        // At least once, however short the run is.
        self.second_program()?;
        self.replug()?;
        let updates_before = viewer.last().updates;
        self.await_updates(&viewer, updates_before + 2, &mut program)?;
        let (last, last_ms) = (viewer.last(), self.now_ms());
        let rig_s = (last_ms - first_ms) as f64 * 1e-3;
        let drift_s = last.stamp.as_secs_f64() - first.stamp.as_secs_f64() - rig_s;
        ensure!(
            drift_s.abs() < LATE_S + DRIFT * rig_s,
            "stamps have gone {drift_s:+.3} s from the rig's time in {rig_s:.0} s"
        );
        self.served.updates = viewer.end()?;
        self.served.drift_s = drift_s;
        self.served.strangers = stranger.end();
        self.served.memory_bytes[0] = program.interrupt()?;
        Ok(())
    }

    fn monitor(&mut self, duration_ms: u64) -> Result<()> {
        let screen = Pty::open()?;
        let size = Winsize { ws_row: 40, ws_col: 120, ws_xpixel: 0, ws_ypixel: 0 };
        tcsetwinsize(&screen.slave, size)?;
        let end = || screen.slave.try_clone().map(Stdio::from);
        let mut command = Command::new(&self.guide);
        command.args(["monitor", "--port"]).arg(&self.cable.link).env("TERM", "xterm");
        command.stdin(end()?).stdout(end()?).stderr(Stdio::null());
        let began_ms = self.now_ms();
        let mut program = Program::start(command, began_ms + self.warm_ms)?;
        let (mut unplug_ms, mut key_ms) =
            (began_ms + self.random.random_range(PLUGGED_MS), began_ms + KEY_MS);
        let (mut drawn, mut hushed) = (0, Instant::now());
        while self.now_ms() < began_ms + duration_ms {
            program.check(self.now_ms())?;
            let bytes = drain(&screen);
            drawn += bytes;
            if bytes > 0 {
                hushed = Instant::now();
            }
            ensure!(hushed.elapsed() < HANGS, "the screen does not change any more");
            if self.now_ms() >= key_ms {
                let key = KEYS[self.random.random_range(0..KEYS.len())];
                rustix::io::write(&screen.master, key)?;
                self.served.keys += 1;
                key_ms = self.now_ms() + KEY_MS;
            }
            if self.now_ms() >= unplug_ms {
                self.replug()?;
                unplug_ms = self.now_ms() + self.random.random_range(PLUGGED_MS);
            }
        }
        ensure!(drawn > 0, "nothing was drawn");
        self.served.drawn_bytes = drawn;
        let memory = program.memory();
        let began = Instant::now();
        // The key may come while the screen's help is shown, which takes one; what is drawn has to be read until the end.
        while program.child.try_wait()?.is_none() {
            rustix::io::write(&screen.master, b"q")?;
            drain(&screen);
            ensure!(began.elapsed() < HANGS, "the key q does not end it");
        }
        program.ended()?;
        self.served.memory_bytes[1] = memory;
        Ok(())
    }

    fn replug(&mut self) -> Result<()> {
        self.cable.unplug();
        thread::sleep(Duration::from_millis(self.random.random_range(UNPLUGGED)));
        self.cable.plug()?;
        self.served.replugged += 1;
        Ok(())
    }

    /// A second program on the port: reports in one line that another one has it. Just after the cable has come back it may be the first.
    fn second_program(&mut self) -> Result<()> {
        let began = Instant::now();
        loop {
            let output =
                Command::new(&self.guide).args(["status", "--port"]).arg(&self.cable.link).output()?;
            if !output.status.success() {
                let text = String::from_utf8_lossy(&output.stderr);
                ensure!(text.contains("in use by another program"), "a second program on the port: {text}");
                self.served.refused += 1;
                return Ok(());
            }
            ensure!(began.elapsed() < HANGS, "guide serve does not take its port again");
            thread::sleep(Duration::from_secs(1));
        }
    }

    fn await_updates(&self, viewer: &Viewer, count: u64, program: &mut Program) -> Result<()> {
        let began = Instant::now();
        while viewer.last().updates < count {
            program.check(self.now_ms())?;
            ensure!(began.elapsed() < HANGS, "updates do not come back");
            thread::sleep(POLL);
        }
        Ok(())
    }
}

/// Bytes that a program has written to its terminal.
fn drain(screen: &Pty) -> u64 {
    let mut buffer = [0; 4096];
    let mut count = 0;
    while wait(screen.master.as_fd(), PollFlags::IN, &TIMEOUT) {
        match rustix::io::read(&screen.master, &mut buffer) {
            Ok(bytes) if bytes > 0 => count += bytes as u64,
            _ => break,
        }
        if count > 1 << 20 {
            break;
        }
    }
    count
}

/// A program at work. Dropping it ends it.
struct Program {
    child: Child,
    memory: Memory,
    ended: bool,
}

impl Program {
    fn start(mut command: Command, warm_ms: u64) -> Result<Self> {
        let child = command.spawn().context("cannot start guide")?;
        let memory = Memory::of(child.id(), warm_ms);
        Ok(Self { child, memory, ended: false })
    }

    /// Address at which it serves, from its first line; its further output is read and dropped.
    fn address(&mut self) -> Result<SocketAddr> {
        let mut lines = BufReader::new(self.child.stdout.take().context("no output")?).lines();
        let line = lines.next().context("guide serve ended at once")??;
        thread::Builder::new().name("serve's output".into()).spawn(move || lines.for_each(drop))?;
        let address = line.rsplit(' ').next().unwrap_or_default();
        address.parse().with_context(|| format!("no address in {line:?}"))
    }

    fn check(&mut self, now_ms: u64) -> Result<()> {
        let status = self.child.try_wait()?;
        ensure!(status.is_none(), "it ended by itself: {status:?}");
        self.memory.sample(now_ms)
    }

    fn memory(&self) -> Option<[u64; 2]> {
        self.memory.first_bytes.zip(self.memory.last_bytes).map(|(first, last)| [first, last])
    }

    fn interrupt(mut self) -> Result<Option<[u64; 2]>> {
        let memory = self.memory();
        if let Some(process) = i32::try_from(self.child.id()).ok().and_then(Pid::from_raw) {
            kill_process(process, Signal::INT)?;
        }
        self.ended()?;
        Ok(memory)
    }

    fn ended(&mut self) -> Result<()> {
        let status = self.child.wait()?;
        self.ended = true;
        ensure!(status.success(), "it ended with {status}");
        Ok(())
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        if !self.ended {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}
