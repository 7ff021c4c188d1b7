//! `cargo xtask test`: the first tier, which decides in minutes whether a change is right, and with `--all` the second one, which takes
//! longer and repeats nothing of the first.
//!
//! | | first tier | second tier |
//! |---|---|---|
//! | checks | format, clippy of the host; the image builds without warnings | documentation, clippy of the Python module and of the images, compiling for Windows, manual, licences |
//! | host | every test but those of the second column | studies in small, examples in documentation, Python |
//! | firmware | protocol in QEMU; every hazard, the procedure and the link end to end | the second board, instructions of control core and online estimator, peers, steering, bring-up, sequences, sizes of the images |
//!
//! A test of the second tier is marked `#[ignore]` with the reason; of the tests in `tests/system/tests/end_to_end`, which need QEMU and are all
//! marked, the first tier runs those below the module `in_minutes`. CONTRIBUTING states why each of the others is not there.

use crate::progress::{Output, watched};
use crate::{build, check, setup, wheel};
use anyhow::{Result, anyhow, bail, ensure};
use std::ffi::OsString;
use std::fs;
use std::ops::AddAssign;
use std::process::{Command, ExitCode};
use std::thread;
use std::time::Instant;

/// Help of the task.
pub const HELP: &str = "Run the checks and tests that decide whether a change is right; ends with `N passed, N failed`\n\n\
    Usage: cargo xtask test [--all | --second]\n\n\
    Options:\n  \
      --all     Then also what takes longer: documentation, both boards, studies in small, bring-up, steering, peers, Python\n  \
      --second  Only what takes longer\n";
/// The Python module as cargo builds it.
const MODULE: &str = "libneedle_guide_core.so";
/// The module of the end-to-end tests that the first tier runs.
const IN_MINUTES: &str = "in_minutes::";
/// Programs of tests without the examples in documentation. Always for the whole workspace: for a part of it cargo would build what it
/// depends on again, with fewer features.
const TESTS: [&str; 5] = ["--workspace", "--lib", "--bins", "--tests", "--no-fail-fast"];

/// Outcomes of tests.
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

/// Runs the task.
///
/// # Errors
/// Where a check complains, something cannot be installed or built, or a test failed.
pub fn run(arguments: &[OsString]) -> Result<ExitCode> {
    let [first, second] = match arguments {
        [] => [true, false],
        [option] if option == "--all" => [true, true],
        [option] if option == "--second" => [false, true],
        _ => bail!("test: unknown option, expected --all, --second or none"),
    };
    eprintln!(
        "xtask: format and lints, then the tests; the first time this builds everything (CONTRIBUTING states how long each part takes)"
    );
    let mut counts = Counts::default();
    let minutes = |began: Instant| began.elapsed().as_secs_f64() / 60.0;
    if first {
        let began = Instant::now();
        counts = first_tier()?;
        println!("first tier: {} in {:.1} min", summary(counts), minutes(began));
    }
    if second && counts.failed == 0 {
        let began = Instant::now();
        let second_result = second_tier()?;
        println!("second tier: {} in {:.1} min", summary(second_result), minutes(began));
        counts += second_result;
    }
    println!("\n{}", summary(counts));
    Ok(if counts.failed == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn summary(counts: Counts) -> String {
    format!("{} passed, {} failed", counts.passed, counts.failed)
}

fn first_tier() -> Result<Counts> {
    check::texts()?;
    setup::ensure_target()?;
    // An installation waits for the network, the first build for the processor.
    let installed = thread::spawn(setup::ensure_qemu);
    check::lints()?;
    installed.join().map_err(|_| anyhow!("the installation of QEMU has crashed"))??;
    build::with_image(|| build::cargo(&[&["test", "--no-run"], &TESTS[..]].concat()))?;
    let mut counts = cargo_test(&TESTS, &[])?;
    counts += cargo_test(&["--workspace", "--test", "end_to_end"], &["--ignored", IN_MINUTES])?;
    counts += on_target(&[])?;
    Ok(counts)
}

fn second_tier() -> Result<Counts> {
    check::rest()?;
    // The Python module where it can be tested.
    let python = wheel::python().is_ok();
    if python {
        build::cargo(&["build", "--package", "needle-guide", "--features", "extension"])?;
        keep_module()?;
    } else {
        println!("\n     The Python module is not tested: there is no Python 3.10 or later");
    }
    let mut counts = cargo_test(&TESTS, &["--ignored", "--skip", IN_MINUTES])?;
    counts += cargo_test(&["--workspace", "--doc", "--no-fail-fast"], &[])?;
    counts += on_target(if python { &["--rest", "--python"] } else { &["--rest"] })?;
    Ok(counts)
}

/// Copies the Python module to where its tests have it from: what tests build next replaces it with one that Python cannot load.
fn keep_module() -> Result<()> {
    let folder = build::target_dir().join("debug");
    let extension_dir = folder.join("extension");
    fs::create_dir_all(&extension_dir)?;
    fs::copy(folder.join("deps").join(MODULE), extension_dir.join(MODULE))?;
    Ok(())
}

/// Runs tests of cargo, and counts.
fn cargo_test(of_cargo: &[&str], of_tests: &[&str]) -> Result<Counts> {
    let mut command = Command::new(build::program());
    command.current_dir(build::root()).arg("test").args(of_cargo).arg("--").args(of_tests);
    counted(&mut command)
}

/// Programs on the target, which the program `system` runs.
fn on_target(options: &[&str]) -> Result<Counts> {
    let mut command = Command::new(build::target_dir().join("debug").join("system"));
    counted(command.arg("on-target").args(options))
}

/// Runs a program and adds up the counts in its lines. A failure without a failed test means that it could not run
/// them.
fn counted(command: &mut Command) -> Result<Counts> {
    let mut counts = Counts::default();
    command.env(build::PROGRAM, build::guide());
    let status = watched(command, Output::Standard, |line| {
        if let Some(of_line) = counts_in(line) {
            counts += of_line;
        }
    })?;
    ensure!(status.success() || counts.failed > 0, "{command:?} failed before it ran the tests");
    Ok(counts)
}

/// Counts in a line like `test result: ok. 12 passed; 0 failed; ...` of cargo's tests, or `12 passed, 0 failed` of a program on the target.
fn counts_in(line: &str) -> Option<Counts> {
    let (counts, separator) = match line.strip_prefix("test result: ") {
        Some(result) => (result.split_once(". ")?.1, "; "),
        None => (line, ", "),
    };
    let number = |what: &str| {
        counts
            .split(separator)
            .find_map(|part| part.strip_suffix(what))
            .and_then(|part| part.trim().parse().ok())
    };
    Some(Counts { passed: number(" passed")?, failed: number(" failed")? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_read_from_the_lines_of_both_runners() {
        let line = "test result: FAILED. 12 passed; 3 failed; 0 ignored; 0 measured; 0 filtered out; finished in 0.1s";
        assert_eq!(counts_in(line), Some(Counts { passed: 12, failed: 3 }));
        assert_eq!(counts_in("42 passed, 1 failed"), Some(Counts { passed: 42, failed: 1 }));
        for other in ["test a::b ... ok", "", "done", "3 passed"] {
            assert_eq!(counts_in(other), None, "{other}");
        }
    }
}
