//! `cargo xtask study bringup`: `guide bringup` on rigs with every fault that it can find, and on sound ones, through the firmware.
//!
//! Faults come from [`Kind`], each with its sizes; axis, actuators, noise and offsets are drawn from the seed. The person at the rig is
//! simulated: it presses the emergency stop on request.

use crate::bench::Bench;
use crate::cosim::{Cosim, Fault, Kind, Reach};
use crate::wire::{Direction, NoisyWire};
use anyhow::{Context, Result, ensure};
use device::bringup::{self, BringupError, CATALOGUE, Finding, Operator, Prompt, Report, Step, StepResult};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use simulation::rig::config::RigConfig;
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
    /// Rigs with two faults of different kinds at once; none with --only
    #[arg(long, default_value_t = 24)]
    pairs: u64,
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

/// Score of one fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Score {
    /// By its name, alone.
    Named,
    /// By its name, with one other explanation.
    InTwo,
    /// Something was found, and not this.
    OtherNamed,
    /// The fault was missed.
    Missed,
}

/// One bring-up, and what the rig did.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// Report of the bring-up.
    pub report: Report,
    /// Time of the rig, seconds.
    pub time_s: f64,
    /// Largest motion of a motor before the loop's step, in one axis from the start, millimetres; over every control
    /// period.
    pub moved_mm: f64,
    /// Largest change of the force on the needle before the loop's step, along one axis, newtons.
    pub force_n: f64,
}

impl Trial {
    /// Whether the position loop moved the guide.
    fn loop_ran(&self) -> bool {
        self.report.steps.iter().any(|step| step.step == Step::Loop.name() && has_run(step.result))
    }
}

fn has_run(result: StepResult) -> bool {
    matches!(result, StepResult::Passed | StepResult::Failed)
}

/// The person at the simulated rig.
struct Player<'a> {
    rig: &'a Cosim,
    clock_ratio: f64,
    /// Last time that the clock returned.
    returned_ms: u64,
    /// Until the loop may move.
    reach: Option<Reach>,
}

impl Operator for Player<'_> {
    fn confirm(&mut self, prompt: Prompt) -> bool {
        match prompt {
            Prompt::PressStop => self.rig.press_stop(true),
            Prompt::ReleaseStop => self.rig.press_stop(false),
            Prompt::Allow(Step::Loop) => self.reach = self.reach.or_else(|| self.rig.take_watched()),
            Prompt::Allow(_) => {}
        }
        true
    }

    fn begins(&mut self, _: Step, _: &Report) -> io::Result<()> {
        Ok(())
    }

    fn is_interrupted(&self) -> bool {
        false
    }

    /// The time of the last answer, which is close, if it came after what was returned before; the time now, as long as the rig has not read that
    /// the device has answered: the host may have the answer before.
    fn clock(&mut self) -> Option<Duration> {
        let answered_ms = self.rig.started() + self.rig.answered_ms();
        self.returned_ms = if answered_ms > self.returned_ms { answered_ms } else { self.rig.steps() };
        Some(Duration::from_secs_f64(self.returned_ms as f64 * 1e-3 / self.clock_ratio))
    }
}

/// Brings up a rig of this seed with these faults.
///
/// # Errors
/// Where the bench cannot be had, or the link fails.
pub fn trial(faults: &[Fault], seed: u64) -> Result<Trial> {
    let bench = Bench::wired(RigConfig::default(), seed, SPEED, faults.to_vec())?;
    let noisy = match fault_size(Kind::LossyLink, faults) {
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
        clock_ratio: fault_size(Kind::Clock, faults).unwrap_or(1.0),
        returned_ms: 0,
        reach: None,
    };
    bench.rig().watch();
    let report =
        bringup::run(&port, &Step::ALL, &[], None, &mut player).context("the bring-up has failed")?;
    let reach = player.reach.or_else(|| bench.rig().take_watched()).unwrap_or_default();
    let time_s = bench.rig().steps() as f64 * 1e-3;
    drop(noisy);
    bench.stop()?;
    Ok(Trial { report, time_s, moved_mm: 1e3 * reach.position_m, force_n: reach.force_n })
}

fn fault_size(kind: Kind, faults: &[Fault]) -> Option<f64> {
    faults.iter().find(|fault| fault.kind == kind).map(|fault| fault.size)
}

/// Score of a fault by these findings.
pub fn score<'a>(kind: Kind, findings: impl Iterator<Item = &'a Finding>) -> Score {
    let mut best = Score::Missed;
    for finding in findings {
        let outcome = match (finding.id == kind.id(), finding.or_else.as_slice()) {
            (true, []) => Score::Named,
            (true, [_]) => Score::InTwo,
            (false, [other]) if *other == kind.id() => Score::InTwo,
            _ => Score::OtherNamed,
        };
        best = best.min(outcome);
    }
    best
}

/// Every fault in each of its sizes, its axis drawn.
pub fn faults(seed: u64) -> Vec<Fault> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut all_faults = Vec::new();
    for kind in Kind::ALL {
        let sizes = if kind.sizes().is_empty() { &[0.0] } else { kind.sizes() };
        for size in sizes {
            let axis = if kind.has_axis() { usize::from(random.random::<bool>()) } else { 0 };
            all_faults.push(Fault { kind, axis, size: *size });
        }
    }
    all_faults
}

/// Two faults of different findings, drawn: what is alone in [`faults`], in one of its sizes each.
pub fn pair(seed: u64) -> [Fault; 2] {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let all_faults = faults(seed);
    let first = drawn_fault(&all_faults, &mut random);
    loop {
        let second = drawn_fault(&all_faults, &mut random);
        if second.kind.id() != first.kind.id() {
            return [first, second];
        }
    }
}

fn drawn_fault(all_faults: &[Fault], random: &mut ChaCha8Rng) -> Fault {
    all_faults[random.random_range(0..all_faults.len())]
}

/// Whether the finding of a fault keeps the guide from being moved by the loop.
fn blocks(fault: &Fault) -> bool {
    CATALOGUE.iter().any(|known| known.id == fault.kind.id() && known.blocks)
}

/// Results of the rigs with two faults.
#[derive(Debug, Default)]
struct Pairs {
    count: u32,
    /// Number of rigs with at least one of the two named, alone or in a class of two.
    named: u32,
    /// The loop moved the guide although one of the two is of a kind that forbids it.
    moved_on: u32,
    furthest_mm: f64,
    largest_n: f64,
}

impl Pairs {
    fn of(options: &Options) -> Result<Self> {
        let mut results = Self::default();
        let count = if options.only.is_none() { options.pairs } else { 0 };
        for seed in options.from..options.from + count {
            let faults = pair(seed);
            let Some(trial) = attempt(&faults, seed)? else { continue };
            let (named, moved_on) = (
                faults.iter().any(|fault| score(fault.kind, trial.report.findings()) <= Score::InTwo),
                trial.loop_ran() && faults.iter().any(blocks),
            );
            let result_name = match (named, moved_on) {
                (true, false) => "Named",
                (false, false) => "NotNamed",
                (_, true) => "MovedOn",
            };
            println!(
                "{:32} {result_name}: {}",
                faults.map(|fault| fault.to_string()).join(" and "),
                summary(&trial)
            );
            if options.verbose {
                println!("{}", trial.report);
            }
            results.count += 1;
            results.named += u32::from(named);
            results.moved_on += u32::from(moved_on);
            results.furthest_mm = results.furthest_mm.max(trial.moved_mm);
            results.largest_n = results.largest_n.max(trial.force_n);
        }
        Ok(results)
    }
}

/// Runs the study; prints a line per fault and the table.
///
/// # Errors
/// Where a bring-up fails.
pub fn run(options: &Options) -> Result<()> {
    for (name, count) in [("seeds", options.seeds), ("pairs", options.pairs)] {
        ensure!(count <= 1_000, "--{name} is {count}, expected at most 1000");
    }
    let mut counts: BTreeMap<Score, u32> = BTreeMap::new();
    let (mut furthest_mm, mut largest_n) = (0.0_f64, 0.0_f64);
    for (number, fault) in faults(options.from)
        .into_iter()
        .filter(|fault| options.only.as_ref().is_none_or(|only| fault.to_string().contains(only.as_str())))
        .enumerate()
    {
        let Some(trial) = attempt(&[fault], options.from + number as u64)? else { continue };
        let score = score(fault.kind, trial.report.findings());
        furthest_mm = furthest_mm.max(trial.moved_mm);
        largest_n = largest_n.max(trial.force_n);
        println!("{:32} {score:?}: {}", fault.to_string(), summary(&trial));
        if options.verbose {
            println!("{}", trial.report);
        }
        *counts.entry(score).or_default() += 1;
    }
    let pairs = Pairs::of(options)?;
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
    println!("\n| bring-up | |\n|---|---|");
    println!("| faults: named | {} of {} |", count_of(Score::Named, &counts), counts.values().sum::<u32>());
    println!("| in a class of two | {} |", count_of(Score::InTwo, &counts));
    println!("| something else named | {} |", count_of(Score::OtherNamed, &counts));
    println!("| missed | {} |", count_of(Score::Missed, &counts));
    println!(
        "| furthest from the start before the loop is closed, change of the force | {furthest_mm:.2} mm, {largest_n:.2} N |"
    );
    if pairs.count > 0 {
        println!("| two faults at once: at least one named | {} of {} |", pairs.named, pairs.count);
        println!("| the loop was closed on a fault that forbids it | {} |", pairs.moved_on);
        println!(
            "| furthest before that, change of the force | {:.2} mm, {:.2} N |",
            pairs.furthest_mm, pairs.largest_n
        );
    }
    if sound > 0 {
        println!("| rigs without a fault that pass | {passed} of {sound} |");
        println!("| longest on a rig without a fault, time of the rig | {longest_s:.0} s |");
    }
    Ok(())
}

fn count_of(score: Score, counts: &BTreeMap<Score, u32>) -> u32 {
    counts.get(&score).copied().unwrap_or(0)
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
            let alternatives: String = finding.or_else.iter().map(|other| format!(" or {other}")).collect();
            format!("{}{axis}{alternatives}", finding.id)
        })
        .collect();
    if names.is_empty() { "nothing found".to_owned() } else { names.join(", ") }
}
