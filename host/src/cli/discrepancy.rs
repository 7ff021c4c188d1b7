//! `guide discrepancy`: which law a forward model of any kind lacks, for a model that is a process.

use super::output::Output;
use ::discrepancy::process::ProcessModel;
use ::discrepancy::{Data, Effect, Options, Run, diagnose};
use anyhow::{Context, ensure};
use std::path::PathBuf;
use std::sync::mpsc::channel;
use std::time::Duration;

/// Find which law a forward model of any rig lacks, and by how much adding it reduces the misfit
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide discrepancy --model-command \"python3 tank.py\" slow.csv --judge fast.csv\n  \
                  guide discrepancy --model-command ./tank a.csv b.csv --judge c.csv --try \"balance/level/*\" --json"
)]
pub struct Args {
    /// The model: a program with its arguments, which answers lines of JSON (`discrepancy.model/1`)
    #[arg(long, value_name = "COMMAND")]
    model_command: String,
    /// Runs to fit: CSV files with a column time_s, the model's channels, and columns that are known
    #[arg(required = true, value_name = "CSV")]
    runs: Vec<PathBuf>,
    /// Runs that are held out and judge what is found
    #[arg(long, num_args = 1.., value_name = "CSV")]
    judge: Vec<PathBuf>,
    /// Laws that are tried, as SITE/REGRESSOR/FORM or SITE/constant, * for any part (default: all that the model's sites allow)
    #[arg(long = "try", num_args = 1.., value_name = "LAW")]
    laws: Vec<String>,
    /// What a model that is right may leave of each regressor, percent of the standard deviation of a channel
    #[arg(long, value_name = "PERCENT", default_value_t = 1.0)]
    everyday_percent: f64,
    /// Longest time of one answer of the model, seconds
    #[arg(long, value_name = "S", default_value_t = 60.0)]
    timeout_s: f64,
}

/// Runs `guide discrepancy`.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    let words = shlex::split(&args.model_command).unwrap_or_default();
    let (program, arguments) = words.split_first().with_context(|| {
        format!("--model-command: {:?}, expected a program with its arguments", args.model_command)
    })?;
    let timeout = Duration::try_from_secs_f64(args.timeout_s).unwrap_or_default();
    ensure!(!timeout.is_zero(), "--timeout-s: {}, expected a number of seconds above 0", args.timeout_s);
    let effects: Result<Vec<Effect>, _> = args.laws.iter().map(|text| Effect::parse(text)).collect();
    let options = Options { everyday: 1e-2 * args.everyday_percent, effects: effects.context("--try")? };
    let model = ProcessModel::start(program, arguments, timeout).context("--model-command")?;
    let files = args.runs.iter().map(|path| (path, false)).chain(args.judge.iter().map(|path| (path, true)));
    let read = |(path, judges): (&PathBuf, bool)| Run::read(path, &model.declaration().channels, judges);
    let data = Data::new(files.map(read).collect::<Result<_, _>>()?)?;
    let progress = out.progress();
    let (steps, inbox) = channel();
    // The work may report from any thread, the terminal is written by this one.
    let report = std::thread::scope(|scope| {
        let work = scope.spawn(|| {
            let steps = steps;
            diagnose(&model, &data, &options, &|step| drop(steps.send(step.to_owned())))
        });
        inbox.iter().for_each(|step| progress.set_message(step));
        work.join()
    });
    progress.finish_and_clear();
    let report = report.unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
    out.result(&report, &report)
}
