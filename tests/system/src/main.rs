//! The program behind `cargo xtask`, which builds it first: demonstration, tests and long runs of the whole system.

use anyhow::{Context, Result};
use clap::{Parser, Subcommand};
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
#[cfg(feature = "checks")]
use system::{
    beside, bringup, fuzz, hil, imaged, left_running, on_target, readme, sequences, size, timing, tracking,
};
use system::{cosim, demo, needle};

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
    Demo(demo::Args),
    /// Run what `cargo xtask test` has beside cargo's tests: programs on the target, in QEMU
    #[cfg(feature = "checks")]
    OnTarget(on_target::Args),
    /// Measure run times, beside those of alternative libraries, and how they scale; write the page of them
    #[cfg(feature = "checks")]
    Bench(beside::Args),
    /// Build the image of each board and compare its flash and RAM use with the committed figures
    #[cfg(feature = "checks")]
    Size(size::Args),
    /// Run the protocol's tests on a board, flash its firmware, and run the automatic steps of `guide bringup`
    #[cfg(feature = "checks")]
    Hil(hil::Args),
    /// Regenerate the outputs and pictures of README.md and the manual, or compare them
    #[cfg(feature = "checks")]
    Readme(readme::Args),
    /// Run the end of the demonstration for many seeds
    #[cfg(feature = "checks")]
    StudyDemo(demo::seeds::Seeds),
    /// K from simulated ultrasound frames beside K from the true shape, by the commands of `guide`
    #[cfg(feature = "checks")]
    StudyImages(imaged::Options),
    /// Run `guide bringup` on rigs with every fault of wiring, mounting and sensors, and on sound ones
    #[cfg(feature = "checks")]
    StudyBringup(bringup::Options),
    /// Run the online estimator on the target, in QEMU: agreement with the host, instructions per update
    #[cfg(feature = "checks")]
    Tracking,
    /// Carry out random sequences of commands, faults of sensors and restarts, in this process and through the firmware in QEMU: none
    /// may circumvent a limit
    #[cfg(feature = "checks")]
    Sequences(sequences::Args),
    /// Leave `guide serve` and then `guide monitor` running, with clients, a second program and a port that comes and goes
    #[cfg(feature = "checks")]
    LeftRunning(left_running::Args),
    /// Fuzz every parser with generated inputs, and report the input on which one fails
    #[cfg(feature = "checks")]
    Fuzz(fuzz::Args),
    /// Run the control core on the target, in QEMU: instructions per control period
    #[cfg(feature = "checks")]
    Timing,
    /// Start the firmware in QEMU with a simulated rig and leave it running for `guide`
    Rig(demo::RigArgs),
    /// Print one ultrasound sweep of a simulated rig as CSV
    Sweep {
        /// Socket on which the rig serves its sweeps
        #[arg(long, value_name = "SOCKET")]
        socket: PathBuf,
    },
    /// Save the ultrasound frames of one sweep of a simulated rig, and print the file's path
    Frames {
        /// Socket on which the rig serves its scans
        #[arg(long, value_name = "SOCKET")]
        socket: PathBuf,
        /// Folder in which they are saved
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
    },
    /// Push a simulated needle as a plant of `guide steer --port PORT --tip`, whose guide 2 is that of a rig
    Needle(needle::Args),
}

fn main() -> ExitCode {
    match run(Cli::parse().task) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(task: Task) -> Result<()> {
    match task {
        Task::Demo(args) => demo::run(&args),
        #[cfg(feature = "checks")]
        Task::OnTarget(args) => on_target::run(args),
        #[cfg(feature = "checks")]
        Task::Bench(args) => beside::run(&args),
        #[cfg(feature = "checks")]
        Task::Size(args) => size::run(&args),
        #[cfg(feature = "checks")]
        Task::Hil(args) => hil::run(&args),
        #[cfg(feature = "checks")]
        Task::Readme(args) => readme::run(&args),
        #[cfg(feature = "checks")]
        Task::StudyDemo(args) => demo::seeds::run(&args),
        #[cfg(feature = "checks")]
        Task::StudyImages(args) => imaged::run(&args),
        #[cfg(feature = "checks")]
        Task::StudyBringup(args) => bringup::run(&args),
        #[cfg(feature = "checks")]
        Task::Tracking => {
            println!("{}", tracking::run()?);
            Ok(())
        }
        #[cfg(feature = "checks")]
        Task::Sequences(args) => {
            println!("{}", sequences::run(args)?);
            Ok(())
        }
        #[cfg(feature = "checks")]
        Task::LeftRunning(args) => {
            println!("{}", left_running::run(args)?);
            Ok(())
        }
        #[cfg(feature = "checks")]
        Task::Fuzz(args) => fuzz::run(&args),
        #[cfg(feature = "checks")]
        Task::Timing => {
            println!("{}", timing::run()?);
            Ok(())
        }
        Task::Rig(args) => demo::rig(&args),
        Task::Needle(args) => needle::run(&args),
        Task::Frames { socket, out } => {
            let (path, _frame_count) = cosim::take_frames(&socket, &out)?;
            println!("{}", path.display());
            std::io::stdout().flush().context("cannot print the path")
        }
        Task::Sweep { socket } => {
            let sweep = cosim::take_sweep(&socket, true)?;
            print!("{}", sweep.text);
            std::io::stdout().flush().context("cannot print the sweep")
        }
    }
}
