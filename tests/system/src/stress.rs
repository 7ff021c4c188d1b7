//! `cargo xtask stress`: the firmware on a line with errors for minutes of its time. Bits flip, the line is cut and restored, programs run.
//!
//! Every sample that arrives is compared with what the rig's sensors gave in its millisecond; every one that does not must be
//! counted as lost; control must never be late.

use crate::bench::Bench;
use crate::numbers::{minutes, share};
use crate::qemu::HANGS;
use crate::trial::{Books, Cuts};
use crate::wire::{Direction, NoisyWire};
use anyhow::{Result, bail, ensure};
use device::link::{Client, LinkError, LinkLosses, Telemetry};
use protocol::{Counters, Load, Request, State, Step, program_crc};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use simulation::rig::config::RigConfig;
use std::fmt::{self, Display};
use std::time::Duration;

/// Rig seconds per second: as many as the machine can do.
const SPEED: f64 = f64::INFINITY;
/// Wall-clock time for a second of the device's after which something hangs.
const SLOWEST: f64 = 20.0;

/// Options of `cargo xtask stress`.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct Args {
    /// How long, minutes of the device's time
    #[arg(long, default_value_t = 10.0, value_name = "MINUTES", value_parser = minutes, allow_negative_numbers = true)]
    pub minutes: f64,
    /// Share of the bits that flip, both ways
    #[arg(long, default_value_t = 1e-5, value_name = "SHARE", value_parser = share, allow_negative_numbers = true)]
    pub bit_error_rate: f64,
    /// Seed of the rig, the errors, the cuts and the programs
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// What has become of the samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Survived {
    /// Device time from the first sample to the last, seconds.
    pub duration_s: f64,
    /// Samples that arrived, each as it was sensed.
    pub samples: u64,
    /// What the host counts as lost.
    pub losses: LinkLosses,
    /// What the device counts.
    pub counters: Counters,
    /// How busy it was.
    pub load: Load,
    /// Bits that flipped, to the device and to the host.
    pub flipped_bits: [u64; 2],
    /// How often the cable was cut.
    pub cuts: u32,
    /// Programs that ran.
    pub programs: u32,
}

impl Display for Survived {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            duration_s,
            samples,
            losses,
            counters,
            load,
            flipped_bits: [to_device, to_host],
            cuts,
            programs,
        } = self;
        writeln!(
            f,
            "{duration_s:.1} s of device time: {samples} samples arrived, each equal to the reading of its sensor; {} missing, each counted",
            losses.samples_missing
        )?;
        writeln!(
            f,
            "  {cuts} cuts, {to_host} bits flipped towards the host ({} frames damaged, {} missing), {to_device} towards the device ({} frames damaged)",
            losses.frames_corrupt,
            losses.frames_missing,
            counters.frames_corrupt + counters.frames_overlong
        )?;
        write!(
            f,
            "  {programs} programs; {} messages dropped; {} late control periods, latest start {} us, longest period {} us",
            counters.messages_dropped,
            counters.control_overruns,
            load.latest_start_us,
            load.longest_period_us
        )
    }
}

/// Runs it.
///
/// # Errors
/// Where a sample is not what was sensed, one is lost and not counted, control was late, or the bench fails.
pub fn run(args: Args) -> Result<Survived> {
    let limit = HANGS + Duration::from_secs_f64(args.minutes * 60.0 * SLOWEST);
    let bench = Bench::start(RigConfig::default(), args.seed, SPEED, limit)?;
    bench.rig().keep_history();
    let wire = NoisyWire::connect(&bench.folder().join("serial"), args.seed)?;
    let client = Client::connect(&wire.port())?;
    for direction in [Direction::ToDevice, Direction::ToHost] {
        wire.bit_error_rate(direction, args.bit_error_rate);
    }
    let mut random = ChaCha8Rng::seed_from_u64(args.seed);
    let cuts = Cuts::new(bench.rig().steps(), &mut random);
    let books = Books::new(bench.rig().started());
    let mut trial = Trial { bench: &bench, wire: &wire, client, random, cuts, books, programs: 0 };
    let survived = trial.run((args.minutes * 60e3) as u64)?;
    drop(trial);
    drop(wire);
    bench.stop()?;
    Ok(survived)
}

struct Trial<'a> {
    bench: &'a Bench,
    wire: &'a NoisyWire,
    client: Client,
    random: ChaCha8Rng,
    cuts: Cuts,
    books: Books,
    programs: u32,
}

impl Trial<'_> {
    fn run(&mut self, duration_ms: u64) -> Result<Survived> {
        // The longest silence that the device allows: cuts are part of this, and shorter.
        self.request(Request::Limits { force_mn: 5_000, silence_ms: 60_000 })?;
        self.request(Request::Stream { enable: true })?;
        let began_ms = self.bench.rig().steps();
        let mut program_ms = began_ms + 1_000;
        while self.bench.rig().steps() < began_ms + duration_ms {
            self.receive(Duration::from_millis(20))?;
            let now_ms = self.bench.rig().steps();
            self.cuts.step(now_ms, self.wire, &mut self.random);
            if !self.cuts.is_cut() && now_ms >= program_ms {
                self.program()?;
                program_ms = now_ms + self.random.random_range(4_000..12_000);
            }
        }
        self.finish()
    }

    /// Sends a request until it is answered or given up.
    fn request(&mut self, request: Request) -> Result<()> {
        match self.client.request(request) {
            Ok(()) | Err(LinkError::Unanswered { .. }) => Ok(()),
            Err(error) => bail!(error),
        }
    }

    /// A small motion, or a fault cleared, as the state allows.
    fn program(&mut self) -> Result<()> {
        let y_um = self.random.random_range(-400..400);
        let steps = [Step::Move { x_um: 0, y_um, speed_um_s: 2_000 }, Step::Hold { duration_ms: 500 }];
        for (index, step) in (0..).zip(steps) {
            match self.client.request(Request::LoadStep { index, step }) {
                Ok(()) => {}
                // The one before still runs, or the answer is lost: another time.
                Err(LinkError::Refused { .. } | LinkError::Unanswered { .. }) => return Ok(()),
                Err(error) => bail!(error),
            }
        }
        match self.client.request(Request::Run { steps: 2, crc: program_crc(&steps), start_us: 0 }) {
            Ok(()) => self.programs += 1,
            Err(LinkError::Refused { .. } | LinkError::Unanswered { .. }) => {}
            Err(error) => bail!(error),
        }
        Ok(())
    }

    fn receive(&mut self, timeout: Duration) -> Result<()> {
        let mut next = self.client.next(timeout)?;
        while let Some(telemetry) = next {
            if let Telemetry::Samples(batch) = telemetry {
                self.books.compare(&batch, self.bench.rig())?;
            }
            next = self.client.waiting();
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<Survived> {
        self.wire.mend();
        for direction in [Direction::ToDevice, Direction::ToHost] {
            self.wire.bit_error_rate(direction, 0.0);
        }
        // One whole batch on a good cable counts what was lost before it.
        let until = self.bench.rig().steps() + 500;
        while self.bench.rig().steps() < until {
            self.receive(Duration::from_millis(20))?;
        }
        let status = self.client.status()?;
        self.client.request(Request::Stream { enable: false })?;
        while let Some(telemetry) = self.client.waiting() {
            if let Telemetry::Samples(batch) = telemetry {
                self.books.compare(&batch, self.bench.rig())?;
            }
        }
        let (samples, missing, span_ms) = (self.books.samples(), self.books.missing(), self.books.span_ms());
        let Counters { control_overruns, .. } = status.counters;
        ensure!(samples + missing == span_ms, "{samples} samples and {missing} lost in {span_ms} ms");
        ensure!(control_overruns == 0, "{control_overruns} late control periods");
        ensure!(status.state != State::Faulted, "fault {:?}", status.fault);
        let flipped = |direction| self.wire.counters(direction).flipped_bits;
        Ok(Survived {
            duration_s: span_ms as f64 * 1e-3,
            samples,
            losses: LinkLosses { samples_missing: missing, ..self.client.losses() },
            counters: status.counters,
            load: status.load,
            flipped_bits: [flipped(Direction::ToDevice), flipped(Direction::ToHost)],
            cuts: self.cuts.count(),
            programs: self.programs,
        })
    }
}
