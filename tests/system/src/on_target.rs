//! Tests that `cargo xtask test` runs beside cargo's tests: programs on the target, in QEMU, and with the second tier
//! the Python module and the sizes of the images. Ends with `N passed, N failed`.

use crate::images::{self, Board, Image};
use crate::qemu::{HANGS, Line, Qemu, turn};
use crate::{module, size, timing, tracking};
use anyhow::{Context, Result, bail};
use std::ops::AddAssign;

/// Options of the programs on the target.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct Args {
    /// Those of the second tier: the second board, control core and online estimator, the sizes of the images
    #[arg(long)]
    rest: bool,
    /// The Python module too (Python 3.10 or later with venv; NumPy, pandas and pytest from PyPI)
    #[arg(long)]
    python: bool,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Counts {
    passed: u64,
    failed: u64,
}

impl AddAssign for Counts {
    fn add_assign(&mut self, other: Self) {
        self.passed += other.passed;
        self.failed += other.failed;
    }
}

impl Counts {
    /// One more test with this outcome.
    fn of(name: &str, outcome: Result<()>) -> Self {
        match outcome {
            Ok(()) => {
                println!("test {name} ... ok");
                Self { passed: 1, failed: 0 }
            }
            Err(error) => {
                println!("test {name} ... FAILED: {error:#}");
                Self { passed: 0, failed: 1 }
            }
        }
    }
}

/// Runs the programs of a tier.
///
/// # Errors
/// Where a test failed.
pub fn run(args: Args) -> Result<()> {
    let mut counts = Counts::default();
    if args.rest {
        counts += conformance(Board::NucleoL476rg);
        println!("\n     Running the control core on the target, in QEMU");
        let timed = timing::run().map(|timing| println!("{timing}"));
        counts += Counts::of("the control core on the target", timed);
        println!("\n     Running the online estimator on the target, in QEMU");
        let tracked = tracking::run().map(|tracked| println!("{tracked}"));
        counts += Counts::of("the online estimator on the target", tracked);
        println!("\n     Building the boards' images");
        counts += Counts::of("the images have not grown", size::run(&size::Args::default()));
    } else {
        counts += conformance(Board::BL475eIot01a);
    }
    if args.python {
        println!("\n     Running the tests of the Python module");
        match module::run(&images::target_dir().join("debug")) {
            Ok(found) => counts += Counts { passed: found.passed, failed: found.failed },
            Err(error) => counts += Counts::of("the Python module", Err(error)),
        }
    }
    println!("\n{} passed, {} failed", counts.passed, counts.failed);
    if counts.failed > 0 {
        bail!("{} tests failed", counts.failed);
    }
    Ok(())
}

/// Runs the protocol's tests on the target and counts.
fn conformance(board: Board) -> Counts {
    println!("\n     Running the protocol's tests on the target, in QEMU ({})", board.name());
    conformance_log(board).unwrap_or_else(|error| Counts::of("the protocol on the target", Err(error)))
}

fn conformance_log(board: Board) -> Result<Counts> {
    let elf = images::build_for(board, Image::Conformance)?;
    let folder = tempfile::tempdir()?;
    let qemu = Qemu::start_for(board, Line::Socket, turn(), &elf, folder.path(), HANGS)?;
    let (_, log) = qemu.wait(HANGS)?;
    for line in &log {
        println!("{}", line.split_once(' ').map_or(line.as_str(), |(_level, text)| text));
    }
    let last = log.last().and_then(|line| line.split_once(' ')).map(|(_level, text)| text);
    last.and_then(conformance_line).context("the protocol's tests did not come to their end")
}

/// Counts in the line `12 passed, 0 failed`.
fn conformance_line(line: &str) -> Option<Counts> {
    let (passed, failed) = line.split_once(" passed, ")?;
    Some(Counts { passed: passed.parse().ok()?, failed: failed.strip_suffix(" failed")?.parse().ok()? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_read_from_the_last_line_of_the_target() {
        assert_eq!(conformance_line("42 passed, 1 failed"), Some(Counts { passed: 42, failed: 1 }));
        assert_eq!(conformance_line("done"), None);
    }
}
