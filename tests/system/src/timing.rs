//! `cargo xtask timing`: what a control period costs on the target, in instructions, and what share of the processor that is.

use crate::images::{self, Image};
use crate::qemu::{HANGS, Qemu, turn};
use anyhow::{Context, Result, ensure};
use std::fmt::{self, Display};

/// Five minutes of control take a few seconds.
/// Clocks in a control period: a millisecond at 80 MHz.
const CLOCKS: f64 = 80_000.0;
/// Clocks per instruction: what code from flash with its accelerator takes on this core, with some to spare.
const CLOCKS_PER_INSTRUCTION: f64 = 1.5;
/// Share of the processor that the longest period may take.
const SHARE: f64 = 0.25;

/// Output of the target.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Timing {
    /// Control periods measured.
    pub periods: u64,
    /// Instructions of a period on average.
    pub mean_instructions: u64,
    /// Instructions of the longest period.
    pub most_instructions: u64,
    /// Periods in which the bridges were driven.
    pub driven: u64,
    /// Answers and events.
    pub notes: u64,
    /// Periods in the fault state.
    pub faulted: u64,
}

impl Timing {
    /// Share of the processor that the longest period takes.
    pub fn share(&self) -> f64 {
        self.most_instructions as f64 * CLOCKS_PER_INSTRUCTION / CLOCKS
    }
}

impl Display for Timing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { periods, mean_instructions, most_instructions, driven, notes, faulted } = self;
        writeln!(
            f,
            "{periods} control periods of 1 ms: {mean_instructions} instructions on average, {most_instructions} at most"
        )?;
        write!(
            f,
            "  at {CLOCKS_PER_INSTRUCTION} clocks each the longest takes {:.1} % of an 80 MHz core (limit {:.0} %); {driven} periods driven, {faulted} in fault, {notes} answers and events",
            100.0 * self.share(),
            100.0 * SHARE
        )
    }
}

/// Measures.
///
/// # Errors
/// Where it cannot be run, or the longest period takes more than its share.
pub fn run() -> Result<Timing> {
    let elf = images::build(Image::Timing)?;
    let folder = tempfile::tempdir()?;
    let qemu = Qemu::start(turn(), &elf, folder.path(), HANGS)?;
    let (code, log) = qemu.wait(HANGS)?;
    ensure!(code == 0, "the timing image ended with {code}: {log:#?}");
    let line = log.iter().find_map(|line| line.split_once("period ")).context("the image prints nothing")?.1;
    let timing = read(line).with_context(|| format!("not a timing: {line}"))?;
    ensure!(
        timing.driven * 10 > timing.periods && timing.faulted > 0 && timing.notes > timing.periods / 10,
        "the image did not do what it is there to measure: {timing}"
    );
    ensure!(timing.share() < SHARE, "the longest period takes too long: {timing}");
    Ok(timing)
}

fn read(line: &str) -> Option<Timing> {
    let mut numbers = line.split(|c: char| !c.is_ascii_digit()).filter_map(|word| word.parse().ok());
    let mut next = || numbers.next();
    Some(Timing {
        periods: next()?,
        mean_instructions: next()?,
        most_instructions: next()?,
        driven: next()?,
        notes: next()?,
        faulted: next()?,
    })
}
