//! `guide info`, `guide recover` and `guide export`: what to do with a raw recording.

use super::output::Output;
use device::recording::export::{Exported, RunOptions, to_npy, to_session};
use device::recording::{Contents, DamageSummary, RawFile, recover};
use formats::session::Setup;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use std::fmt::{self, Display};
use std::path::{Path, PathBuf};

/// Show what is in a raw recording: device, duration, samples, losses, faults
#[derive(clap::Args)]
#[command(after_help = "Example:\n  guide info phantom-a/d30-1.mcap")]
pub struct InfoArgs {
    /// Raw recording; it may be unfinished
    #[arg(value_name = "FILE")]
    file: PathBuf,
}

/// Write a clean recording out of one that is damaged or was never finished
#[derive(clap::Args)]
#[command(after_help = "Example:\n  guide recover phantom-a/d30-1.mcap --out d30-1-clean.mcap")]
pub struct RecoverArgs {
    /// Raw recording
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// The new recording (default: beside it, named .recovered.mcap)
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// Export a raw recording: to a session, an array for NumPy, or a clean recording
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide export d30-1.mcap --to csv --out phantom-a\n  guide export d30-1.mcap --to npy --out d30-1.npy"
)]
pub struct ExportArgs {
    /// Raw recording; it may be unfinished or damaged
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// csv: the rows of a lateral run in a session folder; npy: every sample in a structured array; mcap: as `guide recover`
    #[arg(long, value_name = "KIND")]
    to: Kind,
    /// Session folder or file
    #[arg(long, value_name = "PATH")]
    out: PathBuf,
    /// csv: insertion depth of the needle, millimetres (default: as recorded)
    #[arg(long, value_name = "MM", value_parser = super::record::run_depth_mm)]
    depth_mm: Option<f64>,
    /// csv: needle, guides and noise (default: as recorded)
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
    /// csv: name of the run (default: as recorded)
    #[arg(long, value_name = "ID")]
    id: Option<String>,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Kind {
    Csv,
    Npy,
    Mcap,
}

#[derive(Serialize)]
struct Report {
    schema: &'static str,
    /// Written file.
    #[serde(skip_serializing_if = "Option::is_none")]
    out: Option<PathBuf>,
    #[serde(skip_serializing_if = "Option::is_none")]
    bytes_written: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    rows: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    exported_run: Option<String>,
    #[serde(flatten)]
    contents: Contents,
}

impl Report {
    fn new(schema: &'static str, contents: Contents) -> Self {
        Self { schema, out: None, bytes_written: None, rows: None, exported_run: None, contents }
    }
}

impl Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let contents = &self.contents;
        fn known(text: &Option<String>) -> String {
            text.clone().unwrap_or_else(|| "unknown".to_owned())
        }
        writeln!(f, "recording  {}: {} bytes", contents.file.display(), contents.bytes)?;
        writeln!(
            f,
            "run        {} by `guide {}`, {}",
            known(&contents.run),
            known(&contents.command),
            contents.depth_mm.map_or("depth unknown".to_owned(), |depth_mm| format!("{depth_mm} mm deep"))
        )?;
        match &contents.device {
            Some(device) => writeln!(
                f,
                "device     {}, firmware {}, calibration {} ({})",
                device.board, device.firmware, device.calibration_id, device.calibration_crc
            )?,
            None => writeln!(f, "device     unknown: its hello is lost")?,
        }
        writeln!(
            f,
            "samples    {} in {:.3} s{}",
            contents.samples,
            contents.duration_s,
            contents
                .last_s
                .map_or(String::new(), |last_s| format!(", the last at {last_s:.3} s of the device's clock"))
        )?;
        match (contents.samples_missing, contents.frames_missing) {
            (0, 0) => writeln!(f, "lost       nothing")?,
            (samples, frames) => writeln!(f, "lost       {samples} samples, {frames} frames")?,
        }
        if contents.frames_late > 0 {
            writeln!(
                f,
                "order      {} frames come behind later ones and are not used: `mcap sort` puts messages in order",
                contents.frames_late
            )?;
        }
        for fault in &contents.faults {
            writeln!(f, "fault      {} at {:.3} s: {}", fault.number, fault.time_s, fault.cause)?;
        }
        writeln!(f, "file       {}", Condition(&contents.damage))?;
        match (&self.out, self.rows, &self.exported_run) {
            (Some(out), Some(rows), Some(run)) => {
                writeln!(f, "written    {run} in {}: {rows} rows", out.display())
            }
            (Some(out), Some(rows), None) => writeln!(f, "written    {}: {rows} rows", out.display()),
            (Some(out), None, _) => {
                writeln!(f, "written    {}: {} bytes", out.display(), self.bytes_written.unwrap_or_default())
            }
            (None, ..) => Ok(()),
        }
    }
}

struct Condition<'a>(&'a DamageSummary);

impl Display for Condition<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let DamageSummary { places, count, bytes, frames_saved, unfinished } = self.0;
        if let Some(first) = places.first() {
            write!(f, "{bytes} bytes damaged in {count} places, the first at byte {}", first.offset)?;
            write!(f, "; {frames_saved} frames saved from them")?;
            if *unfinished { write!(f, "; never finished") } else { Ok(()) }
        } else if *unfinished {
            write!(f, "intact, but never finished (`guide recover` does that)")
        } else {
            write!(f, "intact")
        }
    }
}

/// Runs `guide info`.
pub fn run_info(args: &InfoArgs, out: &mut Output) -> anyhow::Result<()> {
    let contents = with_progress(&args.file, |progress| Ok(Contents::read(&args.file, progress)?))?;
    let report = Report::new("guide.info/1", contents);
    out.result(&report, &report)
}

/// Runs `guide recover`.
pub fn run_recover(args: &RecoverArgs, out: &mut Output) -> anyhow::Result<()> {
    let output_path = args.out.clone().unwrap_or_else(|| args.file.with_extension("recovered.mcap"));
    let report = recovered("guide.recover/1", &args.file, &output_path)?;
    out.result(&report, &report)
}

/// Runs `guide export`.
pub fn run_export(args: &ExportArgs, out: &mut Output) -> anyhow::Result<()> {
    const SCHEMA: &str = "guide.export/1";
    let exported = match args.to {
        Kind::Mcap => {
            let report = recovered(SCHEMA, &args.file, &args.out)?;
            return out.result(&report, &report);
        }
        Kind::Csv => {
            let setup = args.rig.as_deref().map(Setup::read).transpose()?;
            let options = RunOptions { id: args.id.clone(), depth_mm: args.depth_mm, setup };
            with_progress(&args.file, |progress| Ok(to_session(&args.file, &args.out, &options, progress)?))?
        }
        Kind::Npy => with_progress(&args.file, |progress| Ok(to_npy(&args.file, &args.out, progress)?))?,
    };
    let Exported { contents, run, rows } = exported;
    let damage = &contents.damage;
    if damage.count > 0 || damage.unfinished {
        out.note(format_args!("{}: {}", args.file.display(), Condition(damage)));
    }
    let report = Report {
        out: Some(args.out.clone()),
        rows: Some(rows),
        exported_run: run,
        ..Report::new(SCHEMA, contents)
    };
    out.result(&report, &report)
}

fn recovered(schema: &'static str, from: &Path, to: &Path) -> anyhow::Result<Report> {
    let (contents, RawFile { path, bytes }) =
        with_progress(from, |progress| Ok(recover(from, to, progress)?))?;
    Ok(Report { out: Some(path), bytes_written: Some(bytes), ..Report::new(schema, contents) })
}

/// Shows how far a file has been read.
fn with_progress<T>(
    file: &Path,
    read: impl FnOnce(&mut dyn FnMut(u64)) -> anyhow::Result<T>,
) -> anyhow::Result<T> {
    let length = std::fs::metadata(file).map_or(0, |metadata| metadata.len());
    let style = ProgressStyle::with_template("reading {wide_bar} {bytes}/{total_bytes} {elapsed}")?;
    let bar = ProgressBar::new(length).with_style(style);
    let outcome = read(&mut |position| bar.set_position(position));
    bar.finish_and_clear();
    outcome
}
