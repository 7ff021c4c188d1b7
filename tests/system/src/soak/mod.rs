//! `cargo xtask soak`: the firmware for an hour of its time with everything at random: commands, faults and their remedies,
//! restarts, ports closed and opened, cuts, flipped bits. What must hold is checked throughout.
//!
//! | part | does |
//! |---|---|
//! | [`answers`] | which answer a command gets in which state |
//! | [`commands`] | random commands and programs |
//! | [`device`] | questions and answers, each checked against the rig |
//! | [`episodes`], [`faults`] | a cause, what the device makes of it, the remedy |
//! | [`line`] | the cable over time |
//! | [`watch`] | counters, memory, travel |
//! | [`tally`] | what was done |
//! | [`programs`], [`peers`], [`worker`] | `--programs`: `guide serve` and `guide monitor` with other programs, clients and cables |
//!
//! The seed decides what is done and in which order; when it happens is up to this computer too.

mod answers;
mod commands;
mod device;
mod episodes;
mod faults;
mod line;
mod peers;
pub mod programs;
mod tally;
mod watch;
mod worker;

use crate::bench::Bench;
use crate::cosim::Injection;
use crate::numbers::minutes;
use crate::qemu::HANGS;
use crate::terminals::Terminals;
use crate::wire::NoisyWire;
use anyhow::{Result, ensure};
use device::Device;
use line::Line;
use protocol::Request;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use simulation::rig::config::RigConfig;
use std::fmt::{self, Display};
use std::time::{Duration, Instant};
pub use tally::Tally;
use watch::{GROWTH_LIMIT_BYTES, STACK_LEAST_BYTES};

/// Rig seconds per second: as many as the machine can do.
const SPEED: f64 = f64::INFINITY;
/// Wall-clock time for a second of the device's after which something hangs.
const SLOWEST: f64 = 20.0;
/// Time after which this process must not grow any more, milliseconds of the rig's, where the soak is long enough.
const WARM_MS: u64 = 120_000;
/// Silence of the host that is allowed while it is not silent on purpose: a bad line costs a client some seconds.
const PATIENT_MS: u32 = 60_000;
/// How often it reports its progress, milliseconds of the rig's.
const REPORT_INTERVAL_MS: u64 = 300_000;
/// Lines of the firmware's log that are printed with a failure.
const LOG_LINES: usize = 12;

/// Options of `cargo xtask soak`.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct Args {
    /// How long, minutes of the device's time
    #[arg(long, default_value_t = 60.0, value_name = "MINUTES", value_parser = minutes, allow_negative_numbers = true)]
    pub minutes: f64,
    /// Seed of the rig and of all that is done to it
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// `guide serve` and then `guide monitor` instead, with clients, a second program and a port that comes and goes
    #[arg(long)]
    pub programs: bool,
}

/// What came of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Survived {
    /// Time of the rig, seconds.
    pub rig_s: f64,
    /// Time of this computer, seconds.
    pub wall_s: f64,
    /// What was done.
    pub tally: Tally,
    /// Samples that arrived, each as it was sensed.
    pub samples: u64,
    /// Samples that were lost, each counted by the host.
    pub missing: u64,
    /// Samples of times in which no host was receiving.
    pub unreceived: u64,
    /// How often the cable was cut.
    pub cuts: u32,
    /// Bits that flipped, to the device and to the host.
    pub flipped_bits: [u64; 2],
    /// Late periods, all of them with a cause.
    pub overruns: u32,
    /// Answers and events for which the device had no room.
    pub messages_dropped: u32,
    /// Least free stack of the device, bytes.
    pub stack_free_bytes: Option<u32>,
    /// Most entries of its outbox.
    pub outbox_most: u8,
    /// Furthest from the middle, metres, and hardest, newtons.
    pub reach: crate::cosim::Reach,
    /// Longest that this computer's pseudo terminals kept a byte, seconds.
    pub terminals_s: f64,
    /// Size of this process after warming up and at the end, bytes; `None` where the system does not report it.
    pub memory_bytes: Option<[u64; 2]>,
}

impl Display for Survived {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{:.0} s of the rig in {:.0} s", self.rig_s, self.wall_s)?;
        write!(f, "{}", self.tally)?;
        let [to_device, to_host] = self.flipped_bits;
        writeln!(
            f,
            "  {} restarts, {} ports closed and opened, {} cuts, {to_host} bits flipped towards the host, {to_device} towards the device",
            self.tally.restarts, self.tally.reopened, self.cuts
        )?;
        writeln!(
            f,
            "  {} samples arrived, each equal to the reading of its sensor and in its millisecond; {} missing, each counted; {} while no host was receiving",
            self.samples, self.missing, self.unreceived
        )?;
        writeln!(
            f,
            "  at most {:.2} mm from the centre and {:.2} N; {} late control periods, all of them while the converter was slow",
            self.reach.position_m * 1e3,
            self.reach.force_n,
            self.overruns
        )?;
        let stack = self.stack_free_bytes.map_or("?".to_owned(), |bytes| bytes.to_string());
        writeln!(
            f,
            "  device: {stack} bytes of stack never used (limit {STACK_LEAST_BYTES}), outbox at most {} of 24 entries, {} messages dropped",
            self.outbox_most, self.messages_dropped
        )?;
        match self.memory_bytes.map(|bytes| bytes.map(|bytes| bytes / 1024)) {
            Some([first, last]) => writeln!(
                f,
                "  host: {first} KiB after warming up, {last} KiB at the end (limit: {} KiB more per 10 minutes)",
                GROWTH_LIMIT_BYTES / 1024
            ),
            None => {
                writeln!(f, "  host: this system does not report the size of a process (no /proc/self/statm)")
            }
        }?;
        write!(f, "  this computer's pseudo terminals kept a byte for {:.2} s at most", self.terminals_s)
    }
}

/// Runs it.
///
/// # Errors
/// Where anything does not hold; the error names the seed and the device's time.
pub fn run(args: Args) -> Result<Survived> {
    let limit = HANGS + Duration::from_secs_f64(args.minutes * 60.0 * SLOWEST);
    let bench = Bench::at_terminal(RigConfig::default(), args.seed, SPEED, limit)?;
    let began = Instant::now();
    bench.rig().keep_history();
    let wire = NoisyWire::connect(&bench.folder().join("serial"), args.seed)?;
    let mut random = ChaCha8Rng::seed_from_u64(args.seed);
    let duration_ms = (args.minutes * 60e3) as u64;
    let line = Line::new(&wire, bench.rig().steps(), &mut random);
    // A short run is one test of many in the same process, whose memory is not its own.
    let warm_ms = if duration_ms > 2 * WARM_MS { WARM_MS } else { u64::MAX };
    let mut device = Device::new(&bench, line, random, warm_ms)?;
    let outcome = soak(&mut device, duration_ms);
    if let Err(error) = outcome {
        let (rig_s, device_s) = (device.now_ms() as f64 * 1e-3, device.device_ms() as f64 * 1e-3);
        let log = bench.log();
        let last =
            log.iter().skip(log.len().saturating_sub(LOG_LINES)).cloned().collect::<Vec<_>>().join("\n  ");
        let stall =
            bench.terminals().and_then(Terminals::stall).map_or(String::new(), |stall| format!("\n{stall}"));
        return Err(error.context(format!(
            "seed {}, device time {device_s:.3} s (rig {rig_s:.3} s); the firmware's last words:\n  {last}{stall}\n",
            args.seed
        )));
    }
    let Device { books, line, watch, memory, tally, .. } = device;
    let survived = Survived {
        rig_s: bench.rig().steps() as f64 * 1e-3,
        wall_s: began.elapsed().as_secs_f64(),
        tally,
        samples: books.samples(),
        missing: books.missing(),
        unreceived: books.unreceived(),
        cuts: line.cuts(),
        flipped_bits: line.flipped_bits(),
        overruns: watch.overruns(),
        messages_dropped: watch.messages_dropped(),
        stack_free_bytes: watch.stack_free_bytes,
        outbox_most: watch.outbox_most,
        reach: watch.reach,
        terminals_s: bench.terminals().map_or(0.0, |terminals| terminals.longest().as_secs_f64()),
        memory_bytes: memory.first_bytes.zip(memory.last_bytes).map(|(first, last)| [first, last]),
    };
    drop(wire);
    bench.stop()?;
    Ok(survived)
}

fn soak(device: &mut Device<'_>, duration_ms: u64) -> Result<()> {
    device.set_limits(4_300, PATIENT_MS)?;
    device.resume_stream()?;
    // The guide starts where it happens to be.
    device.home()?;
    let began_ms = device.now_ms();
    let causes = faults::causes();
    let mut reported = 0;
    while device.now_ms() < began_ms + duration_ms {
        let minutes = (device.now_ms() - began_ms) / REPORT_INTERVAL_MS * (REPORT_INTERVAL_MS / 60_000);
        if minutes > reported {
            reported = minutes;
            eprintln!("{minutes} of {:.0} minutes", duration_ms as f64 / 60e3);
        }
        match device.random.random_range(0..100) {
            0..70 => device.command()?,
            70..74 => device.host_is_silent()?,
            _ => {
                let cause = causes[device.random.random_range(0..causes.len())];
                device.fault(&cause)?;
            }
        }
        let pause_ms = device.random.random_range(0..800);
        device.pass(pause_ms)?;
    }
    // One whole batch on a good cable counts what was lost before it.
    device.insist(Request::Stop)?;
    let now_ms = device.now_ms();
    device.line.make_good(now_ms);
    device.pass(500)?;
    let status = device.status()?;
    ensure!(status.fault.is_none(), "fault {:?} at the end", status.fault);
    device.insist(Request::Stream { enable: false })?;
    device.close()?;
    let (samples, missing, span_ms) =
        (device.books.samples(), device.books.missing(), device.books.span_ms());
    ensure!(samples + missing == span_ms, "{samples} samples and {missing} lost in {span_ms} ms");
    device.rig().inject(Injection::default());
    Ok(())
}

#[cfg(test)]
mod testing {
    use protocol::{Counters, Load, State, Status};

    /// A device with nothing to report.
    pub(super) fn idle() -> Status {
        Status {
            t_us: 0,
            state: State::Idle,
            step: u8::MAX,
            fault: None,
            position_counts: [0; 2],
            force_counts: [0; 2],
            streaming: false,
            counters: Counters::default(),
            load: Load::default(),
            motor_budget_permille: [0; 2],
            force_limit_mn: 4_000,
            silence_limit_ms: 2_000,
            stiffness: [None; 2],
        }
    }
}
