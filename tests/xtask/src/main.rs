//! `cargo xtask`: installs what is missing, builds what is needed with cargo's own progress on the screen, and runs it.
//!
//! It depends on nothing of the product, so that it is built in seconds and says what it does before the long builds. What it runs:
//! `system` (the whole system in QEMU), `studies` (Monte Carlo tables), cargo itself.

mod build;
mod check;
mod setup;

use anyhow::Result;
use clap::{Parser, Subcommand};
use std::ffi::OsString;
use std::process::ExitCode;

/// Set up, build, test and demonstrate the needle guide
#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask")]
struct Cli {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Run the whole procedure on the firmware in QEMU with a simulated rig
    Demo(Passed),
    /// Run every check and test: format, lints, documentation, host, protocol, firmware end to end
    Test,
    /// Check format, lints, documentation and licences, for the host and for the microcontroller
    Lint,
    /// Install what is missing: the microcontroller's Rust target, QEMU
    Setup(setup::Args),
    /// Measure the programs beside what one would take instead, and how their cost grows; write the page of it
    Bench(Passed),
    /// Build the image for the board and compare its flash and RAM use with the committed figures
    Size(Passed),
    /// Make the outputs and pictures of the documentation anew, or compare them
    Readme(Passed),
    /// Make a table of the documentation, or one that comes with the tool
    Study(Passed),
    /// Run the online estimator on the target, in QEMU: agreement with the host, instructions per update
    Tracking(Passed),
    /// Run the firmware on a bad cable: flipped bits, cuts, programs; nothing wrong may arrive, nothing be lost uncounted
    Stress(Passed),
    /// Run the firmware for an hour of its time with random commands, faults, restarts, cuts and flipped bits; what must hold is
    /// checked throughout
    Soak(Passed),
    /// Carry out random sequences of commands, faults and restarts, in this process and through the firmware in QEMU: none may get
    /// round a limit
    Campaign(Passed),
    /// Feed every reader of bytes with generated inputs; reports which one makes it fail
    Fuzz(Passed),
    /// Run the control core on the target, in QEMU: instructions per control period
    Timing(Passed),
    /// Start the firmware in QEMU with a simulated rig and leave it running for `guide`
    Rig(Passed),
    /// Print one ultrasound sweep of a simulated rig as CSV
    Sweep(Passed),
}

/// Arguments for the program that does it; `--help` prints its options.
#[derive(clap::Args)]
#[command(disable_help_flag = true)]
struct Passed {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "OPTIONS")]
    arguments: Vec<OsString>,
}

fn main() -> ExitCode {
    match run(Cli::parse().task) {
        Ok(code) => code,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(task: Task) -> Result<ExitCode> {
    let system = |name: &str, passed: &Passed| build::system(name, &passed.arguments);
    match task {
        Task::Demo(passed) => {
            if !passed.arguments.iter().any(|argument| argument == "--help" || argument == "-h") {
                build::announce_demo();
                setup::ensure_all()?;
            }
            system("demo", &passed)
        }
        Task::Test => {
            check::announce();
            setup::ensure_all()?;
            check::all()?;
            // With the features of the tests, so that nothing is built twice.
            build::cargo(&["test", "--workspace", "--no-run"])?;
            build::run_system("test", &[])
        }
        Task::Lint => {
            setup::ensure_target()?;
            check::all().map(|()| ExitCode::SUCCESS)
        }
        Task::Setup(args) => setup::setup(args).map(|()| ExitCode::SUCCESS),
        Task::Bench(passed) => system("bench", &passed),
        Task::Size(passed) => {
            setup::ensure_target()?;
            system("size", &passed)
        }
        Task::Readme(passed) => {
            setup::ensure_all()?;
            system("readme", &passed)
        }
        Task::Study(passed) => build::study(&passed.arguments),
        Task::Tracking(passed) => in_qemu("tracking", &passed),
        Task::Stress(passed) => in_qemu("stress", &passed),
        Task::Soak(passed) => in_qemu("soak", &passed),
        Task::Campaign(passed) => in_qemu("campaign", &passed),
        Task::Fuzz(passed) => system("fuzz", &passed),
        Task::Timing(passed) => in_qemu("timing", &passed),
        Task::Rig(passed) => in_qemu("rig", &passed),
        Task::Sweep(passed) => system("sweep", &passed),
    }
}

/// What needs the firmware's target and QEMU.
fn in_qemu(name: &str, passed: &Passed) -> Result<ExitCode> {
    setup::ensure_all()?;
    build::system(name, &passed.arguments)
}
