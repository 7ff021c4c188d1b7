//! `cargo xtask test`: every test there is, and how many passed.
//!
//! 1. All that `cargo test` has, with the end-to-end tests, which boot the firmware in QEMU.
//! 2. The tests of the Python module, where a Python is installed.
//! 3. The protocol's tests on the target, in QEMU, with the image of each board.
//! 4. The online estimator on the target, in QEMU.
//! 5. The control core on the target, in QEMU: instructions per period.
//! 6. The boards' images: build without warnings, and have not grown.
//!
//! The last line is `N passed, N failed`.

use crate::images::{self, Board, Image};
use crate::qemu::{HANGS, Line, Qemu, turn};
use crate::{module, size, timing, tracking};
use anyhow::{Context, Result, bail};
use std::io::{BufRead, BufReader};
use std::ops::AddAssign;
use std::process::Stdio;

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

/// Options of the suite.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct Args {
    /// Build and test the Python module too (Python 3.10 or later with venv; NumPy, pandas and pytest from PyPI)
    #[arg(long)]
    pub python: bool,
}

/// Runs everything.
///
/// # Errors
/// Where a test failed or something could not be built.
pub fn run(args: Args) -> Result<()> {
    // Meanwhile, on cores that wait for the last crate of the tests. What goes wrong is reported where the image is used.
    let images = std::thread::spawn(|| Image::ALL.map(images::build));
    let mut counts = host(args)?;
    drop(images.join());
    if args.python {
        println!("\n     Running the tests of the Python module");
        match module::run(&images::target_dir().join("debug")) {
            Ok(found) => counts += Counts { passed: found.passed, failed: found.failed },
            Err(error) => counts += Counts::of("the Python module", Err(error)),
        }
    } else {
        println!("\n     The Python module is not tested: there is no Python 3.10 or later");
    }
    for board in Board::ALL {
        println!("\n     Running the protocol's tests on the target, in QEMU ({})", board.name());
        match conformance(board) {
            Ok(found) => counts += found,
            Err(error) => counts += Counts::of("the protocol on the target", Err(error)),
        }
    }
    println!("\n     Running the online estimator on the target, in QEMU");
    let tracked = tracking::run().map(|tracked| println!("{tracked}"));
    counts += Counts::of("the online estimator on the target", tracked);
    println!("\n     Running the control core on the target, in QEMU");
    let timed = timing::run().map(|timing| println!("{timing}"));
    counts += Counts::of("the control core on the target", timed);
    println!("\n     Building the boards' images");
    counts += Counts::of("the images have not grown", size::run(&size::Args::default()));
    println!("\n{} passed, {} failed", counts.passed, counts.failed);
    if counts.failed > 0 {
        bail!("{} tests failed", counts.failed);
    }
    Ok(())
}

/// Runs `cargo test` and counts.
fn host(args: Args) -> Result<Counts> {
    let features: &[&str] = if args.python { &["--features", module::FEATURE] } else { &[] };
    let mut child = images::cargo()
        .args(["test", "--workspace", "--no-fail-fast"])
        .args(features)
        .args(["--", "--include-ignored"])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()
        .context("cannot run cargo")?;
    let mut counts = Counts::default();
    for line in BufReader::new(child.stdout.take().context("cargo has no output")?).lines() {
        let line = line?;
        println!("{line}");
        if let Some(of_line) = result_line(&line) {
            counts += of_line;
        }
    }
    let status = child.wait()?;
    if !status.success() && counts.failed == 0 {
        bail!("cargo test failed before it ran the tests");
    }
    Ok(counts)
}

/// Counts in a line like `test result: ok. 12 passed; 0 failed; ...`.
fn result_line(line: &str) -> Option<Counts> {
    let (_, counts) = line.strip_prefix("test result: ")?.split_once(". ")?;
    let number = |what: &str| {
        let part = counts.split("; ").find_map(|part| part.strip_suffix(what))?;
        part.trim().parse().ok()
    };
    Some(Counts { passed: number("passed")?, failed: number("failed")? })
}

/// Runs the protocol's tests on the target and counts.
fn conformance(board: Board) -> Result<Counts> {
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
    fn counts_are_read_from_the_lines_of_both_runners() {
        let line = "test result: FAILED. 12 passed; 3 failed; 0 ignored; 0 measured; 0 filtered out; finished in 0.1s";
        assert_eq!(result_line(line), Some(Counts { passed: 12, failed: 3 }));
        assert_eq!(result_line("test a::b ... ok"), None);
        assert_eq!(conformance_line("42 passed, 1 failed"), Some(Counts { passed: 42, failed: 1 }));
        assert_eq!(conformance_line("done"), None);
    }
}
