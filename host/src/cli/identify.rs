//! `guide identify`: the tissue's modulus from the lateral runs of a session.

use super::output::Output;
use std::path::PathBuf;

/// Identify the tissue's modulus from the lateral runs of a session
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide identify phantom-a\n  guide identify phantom-a --json > identified.json"
)]
pub struct Args {
    /// Session folder (holds session.toml)
    dir: PathBuf,
}

/// Runs the sub-command.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    out.note(format_args!("reading {}", args.dir.display()));
    out.result(&args.dir, "")
}
