//! `guide population`: what many sessions have in common, and what is unusual.

use super::output::{Output, figures_file, write_file};
use crate::figures;
use anyhow::Context;
use population::{Options, analyse, prior_toml, read_summaries};
use std::path::PathBuf;

/// Analyse many sessions: K between subjects, effects that rigs, needles, tissues or days share, drift, unusual sessions
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide summarize sessions/* --out all.jsonl\n  guide population all.jsonl --by tissue\n  \
                  guide population all.jsonl --by tissue --covariate age_years --plots figures --out prior.toml"
)]
pub struct Args {
    /// Files of records that `guide summarize` has written
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Form groups, each with its own mean and spread, by these labels (rig, needle, tissue, subject, site, day, month) or covariates
    #[arg(long, value_name = "LABEL", value_delimiter = ',')]
    by: Vec<String>,
    /// Levels within a group whose sessions have something in common, outermost first (default: site and subject, as the sessions state
    /// them)
    #[arg(long, value_name = "LABEL", value_delimiter = ',')]
    nested: Vec<String>,
    /// Take all sessions for independent, also several of one subject: intervals are then too narrow
    #[arg(long, conflicts_with = "nested")]
    independent: bool,
    /// Covariates that ln K depends on linearly
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    covariate: Vec<String>,
    /// Add draws of mean and spreads to the JSON document
    #[arg(long)]
    draws: bool,
    /// Write the prior for the next session to this file
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Draw forest plot, spread by group, funnel, time chart of every rig and shrinkage as SVG files into this folder
    #[arg(long, value_name = "FOLDER")]
    plots: Option<PathBuf>,
}

/// Runs the sub-command.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    let progress = out.progress();
    progress.set_message("records are read".to_owned());
    let summaries = read_summaries(&args.files);
    let options = Options {
        by: args.by.clone(),
        nested: args.nested.clone(),
        independent: args.independent,
        covariates: args.covariate.clone(),
        draws: args.draws,
    };
    progress.set_message("effects and groups are compared".to_owned());
    let analysed = summaries.and_then(|summaries| analyse(summaries, &options));
    progress.finish_and_clear();
    let population = analysed.context("cannot analyse the population")?;
    if let Some(path) = &args.out {
        write_file(path, &prior_toml(&population))?;
        out.note(format_args!("writing {}", path.display()));
    }
    if let Some(folder) = out.figures_folder(args.plots.as_deref()) {
        for (name, svg) in figures::population(&population)? {
            figures_file(folder, &name, &svg, out)?;
        }
    }
    out.result(&population, &population)
}
