//! `guide report`: one HTML file with everything that the analyses say of a session, for the lab notebook.

use super::characterized::CharacterizedArgs;
use super::output::{Output, write_file};
use super::report_bundle;
use crate::report::bundle::Wishes;
use crate::report::{Analyses, Day, Options, Origin, Outcome, Report};
use anyhow::{bail, ensure};
use device::words::join;
use formats::model_file::ModelFile;
use formats::session::Session;
use inference::diagnose::Verdict;
use serde::Serialize;
use std::fmt::{self, Display};
use std::path::{Path, PathBuf};

/// Write a session's report: one HTML file with the results, figures and provenance, for screen and paper
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide report phantom-a\n  guide report phantom-a --until 70 --model model.toml --out phantom-a.html\n  \
                  guide report phantom-a --date 2025-03-01\n  guide report phantom-a --bundle phantom-a.zip\n  \
                  guide report --verify phantom-a.zip"
)]
pub struct Args {
    /// Session folder (holds session.toml)
    #[arg(required_unless_present = "verify")]
    dir: Option<PathBuf>,
    /// File to write (default: report.html in the session folder)
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Take the effects of a model file (model.toml) into the model, and its modulus where the session has no lateral runs
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    #[command(flatten)]
    rig: CharacterizedArgs,
    /// Depth up to which readings of each insertion are used, millimetres
    #[arg(long, default_value_t = 50.0, value_name = "MM")]
    until: f64,
    /// Date of the report: YYYY-MM-DD, or today (default: time of the newest file that it is made from)
    #[arg(long, value_name = "DATE")]
    date: Option<Day>,
    /// Write the report with session, models, results, draws and checksums into one zip file, from which --verify makes it again elsewhere
    #[arg(long, value_name = "FILE", conflicts_with = "out")]
    bundle: Option<PathBuf>,
    /// Verify such a file: whether all in it is as it was made, and whether the same results come out here, byte for byte
    #[arg(long, value_name = "FILE", conflicts_with_all = ["dir", "out", "model", "characterized", "until", "date", "bundle"])]
    verify: Option<PathBuf>,
}

/// Runs the sub-command.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    match (&args.verify, &args.dir, &args.bundle) {
        (Some(path), ..) => report_bundle::verify(path, out),
        (None, Some(dir), Some(path)) => bundle(args, dir, path, out),
        (None, Some(dir), None) => page(args, dir, out),
        (None, None, _) => bail!("DIR: missing, expected a session folder or --verify"),
    }
}

/// Date of the report, and the model files that it is made from.
fn origin(args: &Args, dir: &Path, session: &Session) -> anyhow::Result<Origin> {
    ensure!((5.0..=500.0).contains(&args.until), "--until: {}, expected 5 to 500 mm", args.until);
    let rig_file = args.rig.read(dir)?.map(|(path, _)| path);
    let models: Vec<PathBuf> = args.model.iter().chain(&rig_file).cloned().collect();
    Ok(Origin::of(session, &models, command(args, dir), args.date.unwrap_or_default())?)
}

/// Makes a bundle.
fn bundle(args: &Args, dir: &Path, path: &Path, out: &mut Output) -> anyhow::Result<()> {
    let session = Session::read(dir)?;
    let date = origin(args, dir, &session)?.date;
    let wishes =
        Wishes { until_mm: args.until, model: args.model.as_deref(), characterized: args.rig.file(), date };
    report_bundle::make(&session, &wishes, path, out)
}

/// Checks that the name of the page promises no other format.
fn ensure_page_name(path: &Path) -> anyhow::Result<()> {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
    ensure!(
        ending.is_none_or(|ending| ["html", "htm"].contains(&ending.as_str())),
        "--out: {}, expected a name that ends in .html: the report is a page, which a browser prints to PDF",
        path.display()
    );
    Ok(())
}

/// Writes the page.
fn page(args: &Args, dir: &Path, out: &mut Output) -> anyhow::Result<()> {
    args.out.as_deref().map_or(Ok(()), ensure_page_name)?;
    let session = Session::read(dir)?;
    let origin = origin(args, dir, &session)?;
    let model = args.model.as_deref().map(ModelFile::read).transpose()?;
    let rig = args.rig.read(dir)?.map(|(_, rig)| rig);

    let progress = out.progress();
    let options = Options { until_m: 1e-3 * args.until, model, rig, draws: None };
    let analyses = Analyses::of(&session, &options, |step| progress.set_message(step.to_owned()));
    progress.finish_and_clear();
    for failure in analyses.failures() {
        out.note(format_args!("warning: {failure}"));
    }
    let report = Report::new(&session, &analyses, &origin);
    let html = report.html();
    let path = args.out.clone().unwrap_or_else(|| dir.join("report.html"));
    write_file(&path, &html)?;
    let written_report = Done::new(&session, &report, &analyses, &path, html.len());
    out.result(&written_report, &written_report)
}

/// The command with what the report depends on: where it is written to, it does not.
fn command(args: &Args, dir: &Path) -> String {
    let mut words = vec!["guide".to_owned(), "report".to_owned(), dir.display().to_string()];
    if let Some(model) = &args.model {
        words.extend(["--model".to_owned(), model.display().to_string()]);
    }
    if let Some(rig) = args.rig.file() {
        words.extend(["--characterized".to_owned(), rig.display().to_string()]);
    }
    words.extend(["--until".to_owned(), args.until.to_string()]);
    join(words.iter().map(String::as_str))
}

/// Written file.
#[derive(Serialize)]
struct Done<'a> {
    schema: &'static str,
    session: Option<&'a str>,
    /// The file.
    file: String,
    bytes: usize,
    date: &'a str,
    k_kpa: Option<f64>,
    k_ci95_kpa: Option<[f64; 2]>,
    verdict: Option<Verdict>,
    sections: Vec<SectionState<'a>>,
    warnings: &'a [String],
}

/// State of a section.
#[derive(Serialize)]
struct SectionState<'a> {
    id: &'static str,
    /// `done`, `skipped` or `failed`.
    state: &'static str,
    /// Why it is not done.
    why: Option<&'a str>,
}

impl<'a> Done<'a> {
    fn new(session: &'a Session, report: &'a Report, analyses: &Analyses, path: &Path, bytes: usize) -> Self {
        let pooled = analyses.identification.found().map(|found| &found.pooled);
        let sections = report.sections.iter().map(|section| {
            let (state, why) = match &section.content {
                Outcome::Found(_) => ("done", None),
                Outcome::NotThere(what) => ("skipped", Some(*what)),
                Outcome::Failed(why) => ("failed", Some(why.as_str())),
            };
            SectionState { id: section.id, state, why }
        });
        Self {
            schema: "guide.report/2",
            session: session.name.as_deref(),
            file: path.display().to_string(),
            bytes,
            date: &report.date,
            k_kpa: pooled.map(|pooled| pooled.k_kpa),
            k_ci95_kpa: pooled.map(|pooled| pooled.ci95_kpa),
            verdict: analyses.diagnosis.found().map(|found| found.verdict),
            sections: sections.collect(),
            warnings: &report.warnings,
        }
    }
}

impl Display for Done<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for section in &self.sections {
            match section.why {
                Some(why) => writeln!(f, "{:<15}{}: {why}", section.id, section.state)?,
                None => writeln!(f, "{:<15}{}", section.id, section.state)?,
            }
        }
        writeln!(f, "{:<15}{}, {} kB", "written", self.file, self.bytes.div_ceil(1000))
    }
}
