//! `guide summarize`: one record per session, for statistics over many.

use super::output::{Output, write_file};
use anyhow::{Context, ensure};
use inference::summarize;
use population::Summary;
use serde::Serialize;
use std::collections::HashSet;
use std::fmt::{self, Display, Write as _};
use std::path::PathBuf;

/// Write one record per session for `guide population`: K, every effect's likelihood, labels
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide summarize sessions/* --out all.jsonl\n  guide summarize phantom-a --out phantom-a.jsonl --json"
)]
pub struct Args {
    /// Session folders (each holds session.toml); one that fails becomes a record with its error, what is no session is skipped
    #[arg(required = true)]
    dirs: Vec<PathBuf>,
    /// Write the records to this file, one JSON document per line (`needle.summary/1`)
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Seed of the bootstraps of every session's diagnosis
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Name and version of the result.
const SCHEMA: &str = "guide.summarize/1";

/// Written file.
#[derive(Serialize)]
struct Written {
    schema: &'static str,
    file: String,
    sessions: usize,
    failed: usize,
    bytes: usize,
    records: Vec<Record>,
    /// Files, and folders without session.toml.
    skipped: Vec<String>,
}

/// One session in short.
#[derive(Serialize)]
struct Record {
    session: String,
    verdict: Option<String>,
    k_kpa: Option<f64>,
    k_ci95_kpa: Option<[f64; 2]>,
    effects: usize,
    error: Option<String>,
}

/// Runs the sub-command.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    let mut seen_paths = HashSet::new();
    for dir in &args.dirs {
        ensure!(seen_paths.insert(dir), "{}: named twice, expected each session once", dir.display());
    }
    // An entry for a missing session stays: it fails as a session, so that a wrong name is seen.
    let (skipped, sessions): (Vec<&PathBuf>, Vec<&PathBuf>) =
        args.dirs.iter().partition(|path| path.exists() && !path.join("session.toml").is_file());
    ensure!(
        !sessions.is_empty(),
        "{}: no session, expected at least one folder that holds session.toml",
        skipped.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", ")
    );
    let progress = out.progress();
    let mut text = String::new();
    let mut records = Vec::new();
    for (number, dir) in sessions.iter().enumerate() {
        progress.set_message(format!("{} of {}: {}", number + 1, sessions.len(), dir.display()));
        let summary = summarize(dir, args.seed);
        let line = serde_json::to_string(&summary).context("cannot write a record")?;
        let _ = writeln!(text, "{line}");
        records.push(record(summary));
    }
    progress.finish_and_clear();
    write_file(&args.out, &text)?;
    let written = Written {
        schema: SCHEMA,
        file: args.out.display().to_string(),
        sessions: records.len(),
        failed: records.iter().filter(|record| record.error.is_some()).count(),
        bytes: text.len(),
        records,
        skipped: skipped.iter().map(|path| path.display().to_string()).collect(),
    };
    out.result(&written, Text(&written))
}

fn record(summary: Summary) -> Record {
    let result = summary.result.as_ref();
    let identifiable: HashSet<&String> =
        result.iter().flat_map(|result| result.amplitudes.iter().map(|one| &one.effect)).collect();
    Record {
        verdict: result.map(|result| result.verdict.clone()),
        k_kpa: result.map(|result| result.k_kpa),
        k_ci95_kpa: result.map(|result| result.k_ci95_kpa),
        effects: identifiable.len(),
        error: summary.error.clone(),
        session: summary.session,
    }
}

struct Text<'a>(&'a Written);

impl Display for Text<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for record in &self.0.records {
            match (&record.error, &record.verdict, record.k_kpa.zip(record.k_ci95_kpa)) {
                (None, Some(verdict), Some((k_kpa, [low, high]))) => writeln!(
                    f,
                    "{}: K {k_kpa:.2} kPa ({low:.2} to {high:.2}), {verdict}, {} effects identifiable",
                    record.session, record.effects
                )?,
                (error, ..) => {
                    writeln!(f, "{}: failed: {}", record.session, error.as_deref().unwrap_or("no result"))?;
                }
            }
        }
        for path in &self.0.skipped {
            writeln!(f, "skipped      {path}: no session, it holds no session.toml")?;
        }
        let Written { file, sessions, failed, bytes, .. } = self.0;
        writeln!(f, "written      {file}: {sessions} records, {failed} of them failed, {bytes} bytes")
    }
}
