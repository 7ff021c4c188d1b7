//! The command line: one file per sub-command, and the conventions they share.
//!
//! * Results go to standard output (with `--json` exactly one JSON document, of a failure too), remarks and progress to standard error.
//! * Exit code 0: done; 1: failed, with one line `error: ...` on standard error; 2: wrong use.
//! * When the reader closes the pipe (`guide ... | head`) the program ends without a message.
//!
//! To add a sub-command: its file with `Args` (whose help ends with an example) and `run`, one variant of [`Command`],
//! one line in [`run`] and its name in a group (`groups.rs`).

mod bringup;
mod calibrate;
mod calibrate_image;
mod calibration;
mod call;
mod capture;
mod characterize;
mod characterized;
mod check;
mod colour;
pub mod device;
mod diagnose;
mod diagnose_check;
mod discrepancy;
mod draws_args;
mod effects;
mod followed;
mod foundation_args;
mod frame_pictures;
mod groups;
mod identify;
mod igtl;
mod import;
mod import_camera;
mod import_shapes;
mod import_table;
mod import_ultrasound;
mod init;
mod investigate;
mod limits;
mod live;
#[cfg(feature = "screen")]
mod monitor;
mod operate;
mod output;
mod own_effects;
mod plan;
mod plan_path;
mod population;
mod ports;
mod predict;
mod record;
mod recordings;
mod relation;
mod report;
mod report_bundle;
mod rig_args;
mod serve;
mod shell;
mod simulate;
mod status;
mod steer;
mod summarize;
mod tare;
#[cfg(feature = "screen")]
mod terminal_end;
mod track;
#[cfg(feature = "web")]
mod web;

pub use call::{CallError, Called, FailedAt, Kind, call, readable};

use clap::{ColorChoice, CommandFactory, FromArgMatches, Parser, Subcommand};
use output::{Output, StdoutClosed};
use std::ffi::OsString;
use std::process::ExitCode;

/// Actuated needle guide: operate the rig, identify the tissue, predict the needle.
#[derive(Parser)]
#[command(name = "guide", version, subcommand_required = true, arg_required_else_help = true)]
#[command(after_help = "Example:\n  guide identify phantom-a --json")]
struct Cli {
    #[command(subcommand)]
    command: Command,

    /// Print one JSON document instead of text
    #[arg(long, global = true)]
    json: bool,

    /// Effects of this file too, as formulas: known to every command from then on, and to model files that it writes
    #[arg(long, global = true, value_name = "FILE")]
    effects: Vec<std::path::PathBuf>,

    /// Colours in help, warnings, errors and on the live screen; auto: on terminals, unless NO_COLOR is set
    #[arg(long, global = true, value_name = "WHEN", default_value = "auto")]
    color: ColorChoice,
}

/// Commands of `guide`.
#[derive(Subcommand)]
enum Command {
    Ports(ports::Args),
    Bringup(bringup::Args),
    Status(operate::StatusArgs),
    #[cfg(feature = "screen")]
    Monitor(monitor::Args),
    Home(operate::HomeArgs),
    Tare(tare::Args),
    Move(operate::MoveArgs),
    Stop(operate::StopArgs),
    Clear(operate::ClearArgs),
    Retreat(operate::RetreatArgs),
    Limits(limits::Args),
    Calibration(calibration::Args),
    Calibrate(calibrate::Args),
    CalibrateImage(calibrate_image::Args),
    Characterize(characterize::Args),
    Record(record::RecordArgs),
    Acquire(record::AcquireArgs),
    Capture(capture::Args),
    Info(recordings::InfoArgs),
    Recover(recordings::RecoverArgs),
    Export(recordings::ExportArgs),
    Plan(plan::Args),
    Identify(identify::Args),
    Predict(predict::Args),
    Diagnose(diagnose::Args),
    Investigate(investigate::Args),
    Discrepancy(discrepancy::Args),
    Summarize(summarize::Args),
    Population(population::Args),
    Report(report::Args),
    Serve(serve::Args),
    #[cfg(feature = "web")]
    Web(web::Args),
    Track(track::Args),
    PlanPath(plan_path::Args),
    Steer(steer::Args),
    Effects(effects::Args),
    Init(init::Args),
    Check(check::Args),
    Simulate(simulate::Args),
    Import(Box<import::Args>),
    Relation(relation::Args),
    Completions(shell::CompletionsArgs),
    Man(shell::ManArgs),
}

/// Runs the sub-command named on the command line (its first argument is the program's name) and turns its outcome into an exit code.
pub fn main(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    ExitCode::from(exit_code(arguments))
}

/// As [`main()`], for programs that end themselves: 0 done, 1 failed, 2 wrong use.
pub fn exit_code(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    let is_json = wants_json(&arguments);
    if let Err(error) = own_effects::define(&arguments) {
        return failed(&error, Output::new(is_json, false), false);
    }
    let command = command().color(colour::requested(arguments.iter().skip(1).cloned()));
    let parsed = command.try_get_matches_from(arguments).and_then(|matches| Cli::from_arg_matches(&matches));
    let cli = match parsed {
        Ok(cli) => cli,
        Err(error) => {
            // Help and version come this way too; a closed stream is no reason for a message.
            let _ = error.print();
            if error.use_stderr() {
                let _ = Output::new(is_json, false).failure(&call::wrong_use(&error));
            }
            return u8::try_from(error.exit_code()).unwrap_or(2);
        }
    };
    let coloured = colour::settle(cli.color);
    let mut out = Output::new(cli.json, coloured);
    match run(&cli.command, &mut out).and_then(|()| out.finish()) {
        Ok(()) => 0,
        Err(error) if error.is::<StdoutClosed>() => 0,
        Err(error) => failed(&error, out, coloured),
    }
}

/// Whether a command line has `--json` among its own words. The words are searched because a command line that cannot be parsed has its
/// document too.
fn wants_json(arguments: &[OsString]) -> bool {
    arguments.iter().skip(1).take_while(|word| *word != "--").any(|word| word == "--json")
}

/// Reports a failure, and returns its exit code. A closed standard output is no reason for another message.
fn failed(error: &anyhow::Error, mut out: Output, coloured: bool) -> u8 {
    output::report(error, coloured);
    let _ = out.failure(&call::failure(error, Called::default()));
    1
}

/// The command line. Every option takes a negative number: where it may not have one the answer states what it may have, not "unexpected argument '-1'".
fn command() -> clap::Command {
    fn negative_too(command: clap::Command) -> clap::Command {
        command
            .mut_args(|arg| if takes_value(&arg) { arg.allow_negative_numbers(true) } else { arg })
            .mut_subcommands(negative_too)
    }
    groups::grouped(negative_too(Cli::command()))
}

fn takes_value(arg: &clap::Arg) -> bool {
    arg.get_action().takes_values() && !arg.is_positional()
}

fn run(command: &Command, out: &mut Output) -> anyhow::Result<()> {
    match command {
        Command::Ports(args) => ports::run(args, out),
        Command::Bringup(args) => bringup::run(args, out),
        Command::Status(args) => operate::status(args, out),
        #[cfg(feature = "screen")]
        Command::Monitor(args) => monitor::run(args, out),
        Command::Home(args) => operate::home(args, out),
        Command::Tare(args) => tare::run(args, out),
        Command::Move(args) => operate::move_guide(args, out),
        Command::Stop(args) => operate::stop(args, out),
        Command::Clear(args) => operate::clear(args, out),
        Command::Retreat(args) => operate::retreat(args, out),
        Command::Limits(args) => limits::run(args, out),
        Command::Calibration(args) => calibration::run(args, out),
        Command::Calibrate(args) => calibrate::run(args, out),
        Command::CalibrateImage(args) => calibrate_image::run(args, out),
        Command::Characterize(args) => characterize::run(args, out),
        Command::Record(args) => record::run_record(args, out),
        Command::Acquire(args) => record::run_acquire(args, out),
        Command::Capture(args) => capture::run(args, out),
        Command::Info(args) => recordings::run_info(args, out),
        Command::Recover(args) => recordings::run_recover(args, out),
        Command::Export(args) => recordings::run_export(args, out),
        Command::Plan(args) => plan::run(args, out),
        Command::Discrepancy(args) => discrepancy::run(args, out),
        Command::Relation(args) => relation::run(args, out),
        Command::Identify(args) => identify::run(args, out),
        Command::Predict(args) => predict::run(args, out),
        Command::Diagnose(args) => diagnose::run(args, out),
        Command::Investigate(args) => investigate::run(args, out),
        Command::Summarize(args) => summarize::run(args, out),
        Command::Population(args) => population::run(args, out),
        Command::Report(args) => report::run(args, out),
        Command::Serve(args) => serve::run(args, out),
        #[cfg(feature = "web")]
        Command::Web(args) => web::run(args, out),
        Command::Track(args) => track::run(args, out),
        Command::PlanPath(args) => plan_path::run(args, out),
        Command::Steer(args) => steer::run(args, out),
        Command::Effects(args) => effects::run(args, out),
        Command::Check(args) => check::run(args, out),
        Command::Init(args) => init::run(args, out),
        Command::Simulate(args) => simulate::run(args, out),
        Command::Import(args) => import::run(args, out),
        Command::Completions(args) => shell::completions(args, out),
        Command::Man(args) => shell::man(args, out),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Options that take numbers, of all commands.
    #[test]
    fn no_option_takes_a_negative_number_for_an_option() {
        fn each(command: &clap::Command, names: &[&str], options: &mut usize) {
            for part in command.get_subcommands() {
                each(part, &[names, &[part.get_name()]].concat(), options);
            }
            for arg in command
                .get_arguments()
                .filter(|arg| arg.get_action().takes_values() && !arg.is_require_equals_set())
            {
                let Some(long) = arg.get_long() else { continue };
                let option = format!("--{long}");
                let line = names.iter().copied().chain([option.as_str(), "-1"]);
                if let Err(error) = super::command().try_get_matches_from(line) {
                    assert!(!error.to_string().contains("unexpected argument"), "{names:?}: {error}");
                }
                *options += 1;
            }
        }
        let mut options = 0;
        each(&command(), &["guide"], &mut options);
        assert!(options > 100, "{options}");
    }
}
