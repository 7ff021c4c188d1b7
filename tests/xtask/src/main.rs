//! `cargo xtask`: installs what is missing, builds what is needed with cargo's own progress on the screen, and runs it.
//!
//! It depends on nothing of the product and on two small packages, so that it is built in seconds and prints what it
//! does before the long builds. Programs that it runs: `system` (the whole system in QEMU), `studies` (Monte Carlo
//! tables), cargo itself. Options belong to what is run: `cargo xtask demo --help` prints those of the demonstration.

mod build;
mod check;
mod cluster;
mod flash;
mod licences;
mod progress;
mod release;
mod setup;
mod tiers;
mod web;
mod wheel;
mod wording;

use anyhow::{Result, bail};
use std::ffi::OsString;
use std::process::ExitCode;

/// Prerequisite of a task before it is run by the program `system`.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Needs {
    /// The program alone.
    Nothing,
    /// The microcontroller's Rust target.
    Target,
    /// The target and QEMU.
    Qemu,
    /// It is carried out here.
    Here,
}

/// Tasks, with what they need and do.
const TASKS: [(&str, Needs, &str); 24] = [
    ("demo", Needs::Here, "Run the whole procedure on the firmware in QEMU with a simulated rig"),
    (
        "test",
        Needs::Here,
        "Run what decides whether a change is right: lints, host, protocol, firmware end to end (--all: what takes longer too; --second: only that)",
    ),
    (
        "lint",
        Needs::Here,
        "Check format, lints, documentation and licences, for the host and for the microcontroller",
    ),
    (
        "setup",
        Needs::Here,
        "Install what is missing: the microcontroller's Rust target, QEMU (--no-install: only name it)",
    ),
    (
        "wording",
        Needs::Here,
        "Count vague names, comments that begin with a clause and named closures, per crate (--list CRATE: where)",
    ),
    ("wheel", Needs::Here, "Build the Python wheel and test it in a fresh virtual environment"),
    (
        "release",
        Needs::Here,
        "Make the bundle that a user downloads, for Linux, Windows and macOS (--test: run what is in it)",
    ),
    (
        "cluster",
        Needs::Here,
        "Run the workflow for many sessions on Slurm (installs it), with this machine as the only node",
    ),
    (
        "bench",
        Needs::Nothing,
        "Measure run times, beside those of alternative libraries, and how they grow with size",
    ),
    (
        "size",
        Needs::Target,
        "Build the image of each board and compare its flash and RAM use with the committed figures",
    ),
    ("flash", Needs::Here, "Build the firmware of a board and flash it with probe-rs (--board, --log)"),
    (
        "hil",
        Needs::Target,
        "Run the protocol's tests on a board, flash its firmware, and run the automatic steps of `guide bringup`",
    ),
    ("readme", Needs::Qemu, "Regenerate the outputs and pictures of the documentation, or compare them"),
    ("study", Needs::Here, "Compute a table of the documentation, or one that is part of the program"),
    (
        "tracking",
        Needs::Qemu,
        "Run the online estimator on the target: agreement with the host, instructions per update",
    ),
    (
        "sequences",
        Needs::Qemu,
        "Carry out random sequences of commands, faults of sensors and restarts: none may circumvent a limit",
    ),
    (
        "left-running",
        Needs::Qemu,
        "Leave guide serve and guide monitor running, with clients, other programs and a port that comes and goes",
    ),
    (
        "fuzz",
        Needs::Nothing,
        "Fuzz every parser with generated inputs, and report the input on which one fails",
    ),
    ("timing", Needs::Qemu, "Run the control core on the target: instructions per control period"),
    ("rig", Needs::Qemu, "Start the firmware in QEMU with a simulated rig and leave it running for `guide`"),
    (
        "web",
        Needs::Here,
        "Make guide.html, the program as one page (--test: compare it in a browser with the program)",
    ),
    ("sweep", Needs::Nothing, "Print one ultrasound sweep of a simulated rig as CSV"),
    (
        "frames",
        Needs::Nothing,
        "Save the ultrasound frames of one sweep of a simulated rig, and print the file's path",
    ),
    (
        "needle",
        Needs::Nothing,
        "Push a simulated needle as a plant of `guide steer --port PORT --tip`, whose guide 2 is that of a rig",
    ),
];

fn main() -> ExitCode {
    let mut arguments = std::env::args_os().skip(1);
    let Some(task) = arguments.next().map(|task| task.to_string_lossy().into_owned()) else {
        eprint!("{}", help());
        return ExitCode::from(2);
    };
    if ["--help", "-h", "help"].contains(&task.as_str()) {
        print!("{}", help());
        return ExitCode::SUCCESS;
    }
    let Some((name, needs, _)) = TASKS.iter().find(|(name, ..)| *name == task) else {
        eprintln!("error: there is no task `{task}`\n\n{}", help());
        return ExitCode::from(2);
    };
    let arguments: Vec<OsString> = arguments.collect();
    match run(name, *needs, &arguments) {
        Ok(code) => code,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn help() -> String {
    let width = TASKS.iter().map(|(name, ..)| name.len()).max().unwrap_or_default() + 2;
    let tasks: String = TASKS.iter().map(|(name, _, what)| format!("  {name:<width$}{what}\n")).collect();
    format!(
        "Set up, build, test and demonstrate the needle guide\n\nUsage: cargo xtask <TASK> [OPTIONS]\n\nCommands:\n{tasks}\n\
         `cargo xtask TASK --help` prints the options of a task; the first time it is built for that.\n"
    )
}

fn run(name: &str, needs: Needs, arguments: &[OsString]) -> Result<ExitCode> {
    let wants_help = arguments.iter().any(|argument| argument == "--help" || argument == "-h");
    match needs {
        _ if wants_help
            && ![
                "test", "lint", "setup", "study", "web", "wheel", "cluster", "release", "wording", "flash",
            ]
            .contains(&name) => {}
        Needs::Target => setup::ensure_target()?,
        Needs::Qemu => setup::ensure_all()?,
        Needs::Nothing => {}
        Needs::Here => return here(name, arguments),
    }
    build::system(name, arguments)
}

/// Tasks that are carried out here.
fn here(name: &str, arguments: &[OsString]) -> Result<ExitCode> {
    match name {
        "demo" => {
            build::announce_demo();
            setup::ensure_all()?;
            build::demo(arguments)
        }
        "study" => build::study(arguments),
        "wheel" | "cluster" | "release" | "wording" | "flash"
            if arguments.iter().any(|argument| argument == "--help" || argument == "-h") =>
        {
            let help = match name {
                "wheel" => wheel::HELP,
                "cluster" => cluster::HELP,
                "wording" => wording::HELP,
                "flash" => flash::HELP,
                _ => release::HELP,
            };
            print!("{help}");
            Ok(ExitCode::SUCCESS)
        }
        "release" => release::release(arguments),
        "flash" => flash::flash(arguments),
        "cluster" => cluster::cluster(arguments).map(|()| ExitCode::SUCCESS),
        "wheel" => wheel::wheel(arguments).map(|()| ExitCode::SUCCESS),
        "wording" => wording::wording(arguments).map(|()| ExitCode::SUCCESS),
        "web" => web::web(arguments),
        "setup" => {
            let only_name = arguments == ["--no-install"];
            if !only_name && !arguments.is_empty() {
                bail!("setup: unknown option, expected --no-install or none");
            }
            setup::setup(only_name).map(|()| ExitCode::SUCCESS)
        }
        "test" if arguments.iter().any(|argument| argument == "--help" || argument == "-h") => {
            print!("{}", tiers::HELP);
            Ok(ExitCode::SUCCESS)
        }
        "test" => tiers::run(arguments),
        _ if !arguments.is_empty() => bail!("{name} has no options"),
        _ => {
            setup::ensure_target()?;
            check::all().map(|()| ExitCode::SUCCESS)
        }
    }
}
