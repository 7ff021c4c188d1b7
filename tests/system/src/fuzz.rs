//! `cargo xtask fuzz`: the fuzz targets of `tests/fuzz`, each for a while, and what was found.
//!
//! The targets are built by `cargo fuzz` with the address sanitizer, which a nightly compiler has. The targets are in
//! [`crate::fuzzed`]; their kept inputs are in `tests/fuzz/corpus`, to which no input is added here: new inputs stay in
//! the build folder.

use crate::fuzzed::{TARGETS, Target};
use crate::images::{root, target_dir};
use anyhow::{Context, Result, bail};
use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

const BY_HAND: &str = "rustup toolchain install nightly --profile minimal";
/// Longest time for one input, seconds: what takes longer hangs.
const TIMEOUT_S: u32 = 10;
/// Most memory of a target, megabytes.
const MAX_MEMORY_MB: u32 = 1_024;

/// Options of `cargo xtask fuzz`.
#[derive(Debug, Clone, clap::Args)]
pub struct Args {
    /// Duration of each target
    #[arg(long, default_value_t = 60, value_name = "SECONDS")]
    pub seconds: u32,
    /// Seed of the inputs
    #[arg(long, default_value_t = 1)]
    pub seed: u32,
    /// Targets to run (default: all)
    #[arg(value_name = "TARGET", value_parser = names())]
    pub targets: Vec<String>,
}

fn names() -> impl Into<clap::builder::ValueParser> {
    clap::builder::PossibleValuesParser::new(TARGETS.map(|target| target.name))
}

/// Result of a target.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
struct Outcome {
    executions: u64,
    per_second: u64,
    coverage: u64,
    /// The input that was found.
    found: Option<String>,
}

/// Runs the targets.
///
/// # Errors
/// Where something is missing, does not build, or an input was found.
pub fn run(args: &Args) -> Result<()> {
    let host = nightly_host()?;
    let cargo_fuzz = ensure_cargo_fuzz()?;
    let folder = std::path::absolute(target_dir().join("fuzz"))?;
    let chosen: Vec<&Target> = TARGETS
        .iter()
        .filter(|target| args.targets.is_empty() || args.targets.iter().any(|name| name == target.name))
        .collect();
    for target in &chosen {
        build(&cargo_fuzz, &folder, target)?;
    }
    println!("{}", Row(["target", "executions", "executions/s", "coverage", "crashes"].map(str::to_owned)));
    let mut failures = Vec::new();
    for target in chosen {
        let program = folder.join(&host).join("release").join(target.name);
        let outcome = fuzz(&program, &folder, target, args)?;
        let Outcome { executions, per_second, coverage, .. } = outcome;
        let crashes = u64::from(outcome.found.is_some());
        let numbers = [executions, per_second, coverage, crashes].map(|number| number.to_string());
        let [executions, per_second, coverage, crashes] = numbers;
        println!("{}", Row([target.name.to_owned(), executions, per_second, coverage, crashes]));
        failures
            .extend(outcome.found.map(|input| format!("{input}\n  again: {} {input}", program.display())));
    }
    if failures.is_empty() {
        return Ok(());
    }
    bail!(
        "{} found:\n{}",
        if failures.len() == 1 { "an input was" } else { "inputs were" },
        failures.join("\n")
    )
}

/// One row of the table.
struct Row([String; 5]);

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [target, executions, per_second, coverage, crashes] = &self.0;
        write!(f, "{target:<10} {executions:>12} {per_second:>13} {coverage:>9} {crashes:>8}")
    }
}

/// The machine that the nightly compiler builds for.
fn nightly_host() -> Result<String> {
    let version =
        Command::new("rustup").args(["run", "nightly", "rustc", "-vV"]).stdin(Stdio::null()).output();
    let version = version.ok().filter(|output| output.status.success());
    let version = version.with_context(|| {
        format!("fuzzing needs a nightly compiler for its sanitizer; install it: {BY_HAND}")
    })?;
    let text = String::from_utf8_lossy(&version.stdout);
    let host = text.lines().find_map(|line| line.strip_prefix("host: "));
    Ok(host.context("rustc does not report its target")?.to_owned())
}

/// The program of `cargo fuzz`: the one that is installed, or one of our own.
fn ensure_cargo_fuzz() -> Result<PathBuf> {
    let installed = PathBuf::from("cargo-fuzz");
    if works(&installed) {
        return Ok(installed);
    }
    let tools = std::path::absolute(target_dir().join("tools"))?;
    let program = tools.join("bin").join("cargo-fuzz");
    if !works(&program) {
        eprintln!("xtask: installing cargo-fuzz into {} (it builds the fuzz targets)", tools.display());
        let mut install = crate::images::cargo();
        install.args(["install", "--quiet", "--locked", "cargo-fuzz", "--root"]).arg(&tools);
        let status = install.stdin(Stdio::null()).status().context("cannot run cargo")?;
        if !status.success() {
            bail!("cannot install cargo-fuzz; by hand: cargo install cargo-fuzz");
        }
    }
    Ok(program)
}

fn works(program: &Path) -> bool {
    let version = Command::new(program).args(["fuzz", "--version"]).stdin(Stdio::null()).output();
    version.is_ok_and(|output| output.status.success())
}

fn build(cargo_fuzz: &Path, folder: &Path, target: &Target) -> Result<()> {
    let status = Command::new("rustup")
        .args(["run", "nightly"])
        .arg(cargo_fuzz)
        .args(["fuzz", "build", target.name, "--fuzz-dir", "tests/fuzz", "--target-dir"])
        .arg(folder)
        .current_dir(root())
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .status()
        .context("cannot run cargo-fuzz")?;
    if !status.success() {
        bail!("the fuzz target {} does not build", target.name);
    }
    Ok(())
}

/// Runs one target for its time.
fn fuzz(program: &Path, folder: &Path, target: &Target, args: &Args) -> Result<Outcome> {
    let corpus = root().join("tests/fuzz/corpus").join(target.name);
    let dictionary = root().join("tests/fuzz/dictionaries").join(format!("{}.dict", target.name));
    let new = folder.join("corpus").join(target.name);
    let artifacts = folder.join("artifacts").join(target.name);
    for folder in [&new, &artifacts] {
        fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    }
    let mut command = Command::new(program);
    // The first folder takes what is new.
    command.args([&new, &corpus]);
    command.args([
        format!("-max_total_time={}", args.seconds),
        format!("-seed={}", args.seed),
        format!("-max_len={}", target.most_bytes),
        format!("-timeout={TIMEOUT_S}"),
        format!("-rss_limit_mb={MAX_MEMORY_MB}"),
        format!("-artifact_prefix={}/", artifacts.display()),
        "-print_final_stats=1".to_owned(),
    ]);
    if dictionary.exists() {
        command.arg(format!("-dict={}", dictionary.display()));
    }
    let output = command
        .env("ASAN_OPTIONS", "detect_odr_violation=0")
        .stdin(Stdio::null())
        .output()
        .with_context(|| format!("cannot run {}", program.display()))?;
    let stderr = String::from_utf8_lossy(&output.stderr);
    let log = folder.join(format!("{}.log", target.name));
    fs::write(&log, stderr.as_bytes()).with_context(|| format!("cannot write {}", log.display()))?;
    let mut outcome = outcome(&stderr);
    if !output.status.success() && outcome.found.is_none() {
        outcome.found = Some(format!("{}: it ended by itself, see {}", target.name, log.display()));
    }
    Ok(outcome)
}

/// Reads the output of a target.
fn outcome(stderr: &str) -> Outcome {
    let crash_input = stderr.lines().find_map(|line| line.split_once("Test unit written to "));
    Outcome {
        executions: last_number("stat::number_of_executed_units:", stderr),
        per_second: last_number("stat::average_exec_per_sec:", stderr),
        coverage: last_number(" cov: ", stderr),
        found: crash_input.map(|(_, file)| file.trim().to_owned()),
    }
}

fn last_number(name: &str, stderr: &str) -> u64 {
    let lines = stderr.lines().filter_map(|line| line.split_once(name));
    let mut numbers = lines.filter_map(|(_, after)| number(after.split_whitespace().next()?));
    numbers.next_back().unwrap_or(0)
}

fn number(text: &str) -> Option<u64> {
    text.trim().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_output_of_a_target_is_read() {
        let quiet = "#2\tINITED cov: 12 ft: 13 corp: 1/1b exec/s: 0 rss: 40Mb\n\
                     #900\tDONE   cov: 345 ft: 400 corp: 9/99b lim: 64 exec/s: 450 rss: 60Mb\n\
                     Done 900 runs in 2 second(s)\n\
                     stat::number_of_executed_units: 900\nstat::average_exec_per_sec:     450\n";
        let expected = Outcome { executions: 900, per_second: 450, coverage: 345, found: None };
        assert_eq!(outcome(quiet), expected);
        let crashed = "#7\tNEW    cov: 8 ft: 9\nartifact_prefix='a/'; Test unit written to a/crash-1\n\
                       stat::number_of_executed_units: 7\nstat::average_exec_per_sec:     0\n";
        let expected =
            Outcome { executions: 7, per_second: 0, coverage: 8, found: Some("a/crash-1".to_owned()) };
        assert_eq!(outcome(crashed), expected);
    }
}
