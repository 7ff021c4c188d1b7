//! `guide characterize`: the rig's own mechanics from runs in air.

mod air;

use super::output::Output;
use air::{AirArgs, RunInAir};
use anyhow::Context;
use device::record::Recorded;
use formats::model_file::ModelFile;
use formats::session::{Labels, Session};
use inference::diagnose::{
    Characterisation, CharacterizeOptions, KnownParameter, Moved, Standing, characterize, moved_since,
};
use serde::Serialize;
use std::fmt::{self, Display};
use std::path::PathBuf;

/// Find the rig's own mechanics from runs in air, without tissue, for the sessions that follow
///
/// The needle is in both guides and in nothing else (`depth_mm = 0`); guide 2 makes small and large holds on both sides of zero, in both
/// axes, with sweeps of the shape where there are any. They determine compliances, play, friction and the errors of the force sensor. With
/// --port the device makes these runs first, each after a tare at zero.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide characterize --port /dev/ttyACM0 --rig rig.toml --session air --out characterized.toml\n  \
                  guide characterize --session air --force-gain-sd 0.01 --out characterized.toml\n  \
                  guide characterize --session air-june --since characterized.toml --out characterized-june.toml"
)]
pub struct Args {
    /// Session folder with runs in air (holds session.toml), or for those of --port; other runs of it are not used
    #[arg(long, value_name = "DIR")]
    session: PathBuf,
    /// Write what the runs determine to this file, for `characterized` in the [rig] of sessions and set-ups
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Report which parameters have changed since this file was written
    #[arg(long, value_name = "FILE")]
    since: Option<PathBuf>,
    /// Relative standard deviation of the force sensor's gain: 0.01 after a calibration with weights
    #[arg(long, value_name = "SHARE", value_parser = share)]
    force_gain_sd: Option<f64>,
    /// Relative standard deviation of the needle's stated bending stiffness
    #[arg(long, value_name = "SHARE", value_parser = share)]
    stiffness_sd: Option<f64>,
    #[command(flatten)]
    air: AirArgs,
}

/// A relative standard deviation.
fn share(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "expected a number, 0.0001 to 0.5".to_owned())?;
    if (1e-4..=0.5).contains(&value) { Ok(value) } else { Err("expected 0.0001 to 0.5".to_owned()) }
}

/// The document.
#[derive(Serialize)]
struct Document {
    schema: &'static str,
    session: String,
    /// The runs that were recorded for it; nothing without `--port`.
    recorded: Option<Vec<RunInAir>>,
    /// Parameters that have changed since the file of `--since`; nothing without it.
    moved_since: Option<Vec<Moved>>,
    #[serde(flatten)]
    found: Characterisation,
    /// The file that was written.
    rig_file: Option<String>,
}

/// Runs the sub-command.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    // A file that cannot be read is found before anything moves.
    let earlier_rig = args.since.as_deref().map(ModelFile::read).transpose()?;
    let recorded = air::record(&args.air, &args.session, out)?;
    let session = Session::read(&args.session)?;
    let options = CharacterizeOptions { force_gain_sd: args.force_gain_sd, stiffness_sd: args.stiffness_sd };
    let characterization = characterize(&session, &options)
        .with_context(|| format!("cannot characterise {}", args.session.display()))?;
    let name = match Labels::read(&args.session)? {
        Labels { name: Some(name), date: Some(date), .. } => format!("{name}, {date}"),
        Labels { name: Some(name), .. } => name,
        _ => args.session.display().to_string(),
    };
    if let Some(path) = &args.out {
        characterization.model(Some(name)).write(path)?;
    }
    let document = Document {
        schema: "guide.characterize/1",
        session: args.session.display().to_string(),
        recorded,
        moved_since: earlier_rig
            .map(|earlier_rig| moved_since(&KnownParameter::of_model(&earlier_rig), &characterization)),
        found: characterization,
        rig_file: args.out.as_ref().map(|path| path.display().to_string()),
    };
    out.result(&document, Text(&document))
}

/// A characterisation for the eye.
struct Text<'a>(&'a Document);

impl Display for Text<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parameters = &self.0.found;
        for RunInAir { run, recorded } in self.0.recorded.iter().flatten() {
            let Recorded { samples, duration_s, sweeps, samples_missing, .. } = recorded;
            write!(f, "recorded     {run}: {samples} samples in {duration_s:.3} s, {sweeps} sweeps")?;
            match samples_missing {
                0 => writeln!(f)?,
                missing => writeln!(f, ", {missing} samples lost")?,
            }
        }
        match self.0.moved_since.as_deref() {
            None => {}
            Some([]) => writeln!(f, "since then   no parameter has changed")?,
            Some(moved) => {
                for (number, one) in moved.iter().enumerate() {
                    writeln!(f, "{:<13}{one}", if number == 0 { "changed" } else { "" })?;
                }
            }
        }
        writeln!(f, "runs         {} in air: {}", parameters.runs.len(), parameters.runs.join(", "))?;
        for one in &parameters.parameters {
            let [low, high] = one.ci95;
            let parameter_name = format!("{} {}", one.effect, one.parameter);
            match one.standing {
                Standing::Identified => {
                    writeln!(f, "{parameter_name:<46} {:>9.4} ({low:.4} to {high:.4})", one.value)?;
                }
                Standing::Stated => {
                    writeln!(
                        f,
                        "{parameter_name:<46} {:>9.4} ({low:.4} to {high:.4}), as stated",
                        one.value
                    )?;
                }
                Standing::NotIdentifiable => {
                    writeln!(f, "{parameter_name:<46} not identifiable from these runs")?;
                    if let Some(remedy) = one.settled_by {
                        writeln!(f, "             needs {remedy}")?;
                    }
                }
            }
        }
        if let Some(scatter_n) = parameters.tare_scatter_n {
            writeln!(f, "zero         scatters by {scatter_n:.4} N from run to run")?;
        }
        writeln!(f, "fit          chi-square per reading {:.2}", parameters.chi_square_per_reading)?;
        for warning in &parameters.warnings {
            writeln!(f, "note         {warning}")?;
        }
        match &self.0.rig_file {
            Some(path) => writeln!(f, "written      {path}"),
            None => Ok(()),
        }
    }
}
