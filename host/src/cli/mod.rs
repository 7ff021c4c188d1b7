//! The command line: one file per sub-command, and the conventions they share.
//!
//! * Results go to standard output (with `--json` exactly one JSON document), remarks and progress to standard error.
//! * Exit code 0: done; 1: failed, with one line `error: ...` on standard error; 2: wrong use.
//! * A reader that goes away (`guide ... | head`) ends the program without a word.
//!
//! To add a sub-command: its file with `Args` (whose help ends with an example) and `run`, one variant of [`Command`]
//! and one line in [`main`].

mod bringup;
mod calibrate;
mod calibration;
mod characterize;
mod check;
mod colour;
mod diagnose;
mod effects;
mod identify;
mod igtl;
mod import;
mod import_shapes;
mod import_ultrasound;
mod init;
mod limits;
mod live;
mod monitor;
mod operate;
mod output;
mod plan;
mod population;
mod ports;
mod predict;
mod record;
mod recordings;
mod relation;
mod report;
mod rig_args;
mod serve;
mod shell;
mod simulate;
mod status;
mod steer;
mod summarize;
mod tare;
mod track;

use clap::{ColorChoice, CommandFactory, FromArgMatches, Parser, Subcommand};
use output::{Output, StdoutClosed};
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

    /// Colours in help, warnings, errors and on the live screen; auto: on terminals, unless NO_COLOR is set
    #[arg(long, global = true, value_name = "WHEN", default_value = "auto")]
    color: ColorChoice,
}

/// What `guide` can do.
#[derive(Subcommand)]
enum Command {
    Ports(ports::Args),
    Bringup(bringup::Args),
    Status(operate::StatusArgs),
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
    Characterize(characterize::Args),
    Record(record::RecordArgs),
    Acquire(record::AcquireArgs),
    Info(recordings::InfoArgs),
    Recover(recordings::RecoverArgs),
    Export(recordings::ExportArgs),
    Plan(plan::Args),
    Identify(identify::Args),
    Predict(predict::Args),
    Diagnose(diagnose::Args),
    Summarize(summarize::Args),
    Population(population::Args),
    Report(report::Args),
    Serve(serve::Args),
    Track(track::Args),
    Steer(steer::Args),
    Effects(effects::Args),
    Init(init::Args),
    Check(check::Args),
    Simulate(simulate::Args),
    Import(import::Args),
    Relation(relation::Args),
    Completions(shell::CompletionsArgs),
    Man(shell::ManArgs),
}

/// Runs the sub-command named on the command line and turns its outcome into an exit code.
pub fn main() -> ExitCode {
    let command = Cli::command().color(colour::requested(std::env::args_os().skip(1)));
    let cli = Cli::from_arg_matches(&command.get_matches()).unwrap_or_else(|error| error.exit());
    let coloured = colour::settle(cli.color);
    let mut out = Output::new(cli.json, coloured);
    let outcome = match &cli.command {
        Command::Ports(args) => ports::run(args, &mut out),
        Command::Bringup(args) => bringup::run(args, &mut out),
        Command::Status(args) => operate::status(args, &mut out),
        Command::Monitor(args) => monitor::run(args, &mut out),
        Command::Home(args) => operate::home(args, &mut out),
        Command::Tare(args) => tare::run(args, &mut out),
        Command::Move(args) => operate::move_guide(args, &mut out),
        Command::Stop(args) => operate::stop(args, &mut out),
        Command::Clear(args) => operate::clear(args, &mut out),
        Command::Retreat(args) => operate::retreat(args, &mut out),
        Command::Limits(args) => limits::run(args, &mut out),
        Command::Calibration(args) => calibration::run(args, &mut out),
        Command::Calibrate(args) => calibrate::run(args, &mut out),
        Command::Characterize(args) => characterize::run(args, &mut out),
        Command::Record(args) => record::run_record(args, &mut out),
        Command::Acquire(args) => record::run_acquire(args, &mut out),
        Command::Info(args) => recordings::run_info(args, &mut out),
        Command::Recover(args) => recordings::run_recover(args, &mut out),
        Command::Export(args) => recordings::run_export(args, &mut out),
        Command::Plan(args) => plan::run(args, &mut out),
        Command::Relation(args) => relation::run(args, &mut out),
        Command::Identify(args) => identify::run(args, &mut out),
        Command::Predict(args) => predict::run(args, &mut out),
        Command::Diagnose(args) => diagnose::run(args, &mut out),
        Command::Summarize(args) => summarize::run(args, &mut out),
        Command::Population(args) => population::run(args, &mut out),
        Command::Report(args) => report::run(args, &mut out),
        Command::Serve(args) => serve::run(args, &mut out),
        Command::Track(args) => track::run(args, &mut out),
        Command::Steer(args) => steer::run(args, &mut out),
        Command::Effects(args) => effects::run(args, &mut out),
        Command::Check(args) => check::run(args, &mut out),
        Command::Init(args) => init::run(args, &mut out),
        Command::Simulate(args) => simulate::run(args, &mut out),
        Command::Import(args) => import::run(args, &mut out),
        Command::Completions(args) => shell::completions(args, &mut out),
        Command::Man(args) => shell::man(args, &mut out),
    };
    match outcome.and_then(|()| out.finish()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if error.is::<StdoutClosed>() => ExitCode::SUCCESS,
        Err(error) => {
            output::report(&error, coloured);
            ExitCode::FAILURE
        }
    }
}
