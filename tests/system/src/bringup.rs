//! `cargo xtask study bringup`: `guide bringup` on rigs with every fault that it can find, and on sound ones, through the firmware.
//!
//! Faults come from [`Kind`], each with its sizes; axis, actuators, noise and offsets are drawn from the seed. The person at the rig is
//! simulated: it presses the emergency stop on request.

use crate::bench::Bench;
use crate::cosim::{Cosim, Fault, Kind};
use crate::wire::{Direction, NoisyWire};
use anyhow::{Context, Result, ensure};
use device::bringup::{self, BringupError, Finding, Operator, Prompt, Report, Step};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use simulation::rig::config::RigConfig;
use std::cell::Cell;
use std::collections::BTreeMap;
use std::io;
use std::path::Path;
use std::time::Duration;

/// Rig seconds per second.
const SPEED: f64 = 8.0;

/// Options of `cargo xtask study bringup`.
#[derive(clap::Args, Debug, Clone)]
pub struct Options {
    /// Rigs without a fault
    #[arg(long, default_value_t = 50)]
    seeds: u64,
    /// First seed, of faults and of rigs without one
    #[arg(long, default_value_t = 1)]
    from: u64,
    /// Only the faults whose name contains this
    #[arg(long, value_name = "TEXT")]
    only: Option<String>,
    /// Print what each bring-up found
    #[arg(long)]
    verbose: bool,
}

/// How one fault was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Score {
    /// By its name, alone.
    Named,
    /// By its name, with one other explanation.
    InTwo,
    /// Something was found, and not this.
    OtherNamed,
    /// Nothing was found.
    Missed,
}

/// One bring-up, and what the rig did.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// What it reported.
    pub report: Report,
    /// Time of the rig, seconds.
    pub time_s: f64,
    /// How far a motor moved before the loop's step, in one axis from the start, millimetres.
    pub moved_mm: f64,
}

/// The person at the simulated rig.
struct Player<'a> {
    rig: &'a Cosim,
    clock_ratio: f64,
    from_m: [f64; 2],
    moved_mm: Cell<f64>,
    /// Until the loop may move.
    is_watched: bool,
}

impl Player<'_> {
    fn watch(&self) {
        let at_m = self.rig.rig(|rig| rig.position_m());
        for (at_m, from_m) in at_m.into_iter().zip(self.from_m) {
            self.moved_mm.set(self.moved_mm.get().max(1e3 * (at_m - from_m).abs()));
        }
    }
}

impl Operator for Player<'_> {
    fn confirm(&mut self, prompt: Prompt) -> bool {
        match prompt {
            Prompt::PressStop => self.rig.press_stop(true),
            Prompt::ReleaseStop => self.rig.press_stop(false),
            Prompt::Allow(Step::Loop) => self.is_watched = false,
            Prompt::Allow(_) => {}
        }
        true
    }

    fn begins(&mut self, _: Step, _: &Report) -> io::Result<()> {
        Ok(())
    }

    fn is_interrupted(&self) -> bool {
        if self.is_watched {
            self.watch();
        }
        false
    }

    fn clock(&mut self) -> Option<Duration> {
        let device_s = self.rig.answered_ms() as f64 * 1e-3;
        Some(Duration::from_secs_f64(device_s / self.clock_ratio))
    }
}

/// Brings up a rig of this seed with these faults.
///
/// # Errors
/// Where the bench cannot be had, or the link fails.
pub fn trial(faults: &[Fault], seed: u64) -> Result<Trial> {
    let bench = Bench::wired(RigConfig::default(), seed, SPEED, faults.to_vec())?;
    let size = |kind: Kind| faults.iter().find(|fault| fault.kind == kind).map(|fault| fault.size);
    let noisy = match size(Kind::LossyLink) {
        Some(rate) => {
            let wire = NoisyWire::connect(Path::new(&bench.port()), seed)?;
            for direction in [Direction::ToHost, Direction::ToDevice] {
                wire.bit_error_rate(direction, rate);
            }
            Some(wire)
        }
        None => None,
    };
    let port = noisy.as_ref().map_or_else(|| bench.port(), NoisyWire::port);
    let mut player = Player {
        rig: bench.rig(),
        clock_ratio: size(Kind::Clock).unwrap_or(1.0),
        from_m: bench.rig().rig(|rig| rig.position_m()),
        moved_mm: Cell::new(0.0),
        is_watched: true,
    };
    let report =
        bringup::run(&port, &Step::ALL, &[], None, &mut player).context("the bring-up has failed")?;
    let moved_mm = player.moved_mm.get();
    let time_s = bench.rig().steps() as f64 * 1e-3;
    drop(noisy);
    bench.stop()?;
    Ok(Trial { report, time_s, moved_mm })
}

/// How a fault was found among these.
pub fn score<'a>(kind: Kind, findings: impl Iterator<Item = &'a Finding>) -> Score {
    let mut best = Score::Missed;
    for finding in findings {
        let this = match (finding.id == kind.id(), finding.or_else.as_slice()) {
            (true, []) => Score::Named,
            (true, [_]) => Score::InTwo,
            (false, [other]) if *other == kind.id() => Score::InTwo,
            _ => Score::OtherNamed,
        };
        best = best.min(this);
    }
    best
}

/// Every fault in each of its sizes, its axis drawn.
pub fn faults(seed: u64) -> Vec<Fault> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut all = Vec::new();
    for kind in Kind::ALL {
        let sizes = if kind.sizes().is_empty() { &[0.0] } else { kind.sizes() };
        for size in sizes {
            let axis = if kind.has_axis() { usize::from(random.random::<bool>()) } else { 0 };
            all.push(Fault { kind, axis, size: *size });
        }
    }
    all
}

/// Runs the study; prints a line per fault and the table.
///
/// # Errors
/// Where a bring-up fails.
pub fn run(options: &Options) -> Result<()> {
    ensure!(options.seeds <= 1_000, "--seeds is {}, expected at most 1000", options.seeds);
    let mut counts: BTreeMap<Score, u32> = BTreeMap::new();
    let mut furthest_mm = 0.0_f64;
    let wanted =
        |fault: &Fault| options.only.as_ref().is_none_or(|only| fault.to_string().contains(only.as_str()));
    for (number, fault) in faults(options.from).into_iter().filter(wanted).enumerate() {
        let Some(trial) = attempt(&[fault], options.from + number as u64)? else { continue };
        let score = score(fault.kind, trial.report.findings());
        furthest_mm = furthest_mm.max(trial.moved_mm);
        println!("{:32} {score:?}: {}", fault.to_string(), summary(&trial));
        if options.verbose {
            println!("{}", trial.report);
        }
        *counts.entry(score).or_default() += 1;
    }
    let (mut passed, mut sound) = (0, 0);
    let mut longest_s = 0.0_f64;
    for seed in options.from..options.from + options.seeds {
        let Some(trial) = attempt(&[], seed)? else { continue };
        sound += 1;
        longest_s = longest_s.max(trial.time_s);
        passed += u64::from(trial.report.passed);
        if !trial.report.passed || options.verbose {
            println!("rig without a fault {seed}: {}\n{}", summary(&trial), trial.report);
        }
    }
    let of = |score| counts.get(&score).copied().unwrap_or(0);
    println!("\n| bring-up | |\n|---|---|");
    println!("| faults: named | {} of {} |", of(Score::Named), counts.values().sum::<u32>());
    println!("| in a class of two | {} |", of(Score::InTwo));
    println!("| something else named | {} |", of(Score::OtherNamed));
    println!("| missed | {} |", of(Score::Missed));
    println!("| furthest from the start before the loop is closed | {furthest_mm:.2} mm |");
    if sound > 0 {
        println!("| rigs without a fault that pass | {passed} of {sound} |");
        println!("| longest on a rig without a fault, time of the rig | {longest_s:.0} s |");
    }
    Ok(())
}

/// A trial; where the link fails, as on a computer that starves QEMU, once more, and then nothing, which is printed.
fn attempt(faults: &[Fault], seed: u64) -> Result<Option<Trial>> {
    for _ in 0..2 {
        match trial(faults, seed) {
            Ok(trial) => return Ok(Some(trial)),
            Err(error) if error.downcast_ref::<BringupError>().is_some() => {
                println!("not counted, seed {seed}: {error:#}")
            }
            Err(error) => return Err(error),
        }
    }
    Ok(None)
}

fn summary(trial: &Trial) -> String {
    let names: Vec<String> = trial
        .report
        .findings()
        .map(|finding| {
            let axis = finding.axis.map_or(String::new(), |axis| format!(" {axis}"));
            let others: String = finding.or_else.iter().map(|other| format!(" or {other}")).collect();
            format!("{}{axis}{others}", finding.id)
        })
        .collect();
    if names.is_empty() { "nothing found".to_owned() } else { names.join(", ") }
}
