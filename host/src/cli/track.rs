//! `guide track`: stiffness and damping of the tissue online, over recorded steering runs or live.

use super::live::{self, LiveArgs};
use super::output::{Output, figures_file};
use crate::figures;
use anyhow::{Context, bail, ensure};
use formats::session::Session;
use inference::track::results::{Errors, LayersResult, TrackResult, Tracking};
use inference::track::{Options, track};
use std::fmt::{self, Display};
use std::path::PathBuf;

/// Track stiffness and damping of the tissue online, over steering runs
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide track phantom-a\n  guide track phantom-a --compare --plots figures\n  \
                  tracker --csv | guide track phantom-a --live --port /dev/ttyACM0 --tip -"
)]
pub struct Args {
    /// Session folder (holds session.toml); with --live needle, rig and noise are taken from it
    dir: PathBuf,
    /// Length of the needle from the fixture to the tip, millimetres, instead of [needle] length_mm
    #[arg(long, value_name = "MM")]
    length_mm: Option<f64>,
    /// Mass of the fixture that moves with the needle's base, kilograms, instead of [rig] fixture_mass_kg
    #[arg(long, value_name = "KG")]
    fixture_kg: Option<f64>,
    /// Depth at which stiffness and damping may jump, as from one layer to the next, millimetres (default: an unknown, reported with its
    /// interval; 40 mm with --live)
    #[arg(long, value_name = "MM")]
    segment_mm: Option<f64>,
    /// Initial values: stiffness, N/m^2, and damping, N s/m^2; they may be wrong by a factor of a hundred
    #[arg(long, num_args = 2, value_names = ["STIFFNESS", "DAMPING"])]
    start: Option<Vec<f64>>,
    /// Compare with the published estimator and Kalman filters on the same data
    #[arg(long)]
    compare: bool,
    /// Draw each run (tip, error, stiffness, damping) as an SVG file into this folder
    #[arg(long, value_name = "FOLDER")]
    plots: Option<PathBuf>,
    #[command(flatten)]
    live: LiveArgs,
}

/// Runs the sub-command.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    let options = options(args)?;
    let session = Session::read(&args.dir)?;
    if args.live.live {
        return live::run(&args.live, &session, &options, out);
    }
    let result = track(&session, &options).with_context(|| format!("cannot track {}", args.dir.display()))?;
    if let Some(folder) = out.figures_folder(args.plots.as_deref()) {
        for run in result.runs.iter().filter(|run| !run.depth_mm.is_empty()) {
            figures_file(folder, &format!("{}.track", run.id), &figures::steering(run)?, out)?;
        }
    }
    out.result(&result, Text(&result))
}

fn options(args: &Args) -> anyhow::Result<Options> {
    check_within("--length-mm", args.length_mm, [10.0, 2000.0])?;
    check_within("--fixture-kg", args.fixture_kg, [0.0, 100.0])?;
    check_within("--segment-mm", args.segment_mm, [4.0, 500.0])?;
    let start = match args.start.as_deref() {
        Some(&[stiffness, damping]) => {
            check_within("--start: stiffness", Some(stiffness), [1e-3, 1e12])?;
            check_within("--start: damping", Some(damping), [1e-6, 1e12])?;
            Some([stiffness, damping])
        }
        Some(_) => bail!("--start: expected stiffness and damping"),
        None => None,
    };
    Ok(Options {
        length_m: args.length_mm.map(|mm| 1e-3 * mm),
        fixture_mass_kg: args.fixture_kg,
        start,
        segment_m: args.segment_mm.map(|mm| 1e-3 * mm),
        compare: args.compare,
    })
}

fn check_within(name: &str, value: Option<f64>, [least, most]: [f64; 2]) -> anyhow::Result<()> {
    let good = value.is_none_or(|value| (least..=most).contains(&value));
    ensure!(good, "{name}: {}, expected {least} to {most}", value.unwrap_or_default());
    Ok(())
}

struct Text<'a>(&'a Tracking);

impl Display for Text<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let runs = &self.0.runs;
        let ids = runs.iter().map(|run| run.id.chars().count());
        let methods =
            runs.iter().flat_map(|run| &run.compare).map(|other| "- ".len() + other.method.chars().count());
        let width = ids.chain(methods).fold(9, usize::max);
        writeln!(
            f,
            "mean over the inserted part at the end of the run (95 % interval); tip simulated with the estimates at each time"
        )?;
        writeln!(
            f,
            "  {:<width$}  depth    stiffness, kN/m^2      damping, kN s/m^2      tip error (RMS, largest)   from",
            "run"
        )?;
        for run in runs {
            write_run(f, run, width)?;
        }
        for warning in &self.0.warnings {
            writeln!(f, "note         {warning}")?;
        }
        for run in runs {
            for warning in &run.warnings {
                writeln!(f, "note         {}: {warning}", run.id)?;
            }
        }
        Ok(())
    }
}

fn write_run(f: &mut fmt::Formatter<'_>, run: &TrackResult, width: usize) -> fmt::Result {
    if let Some(last) = &run.last {
        writeln!(
            f,
            "  {:<width$}  {:<7}  {:<21}  {:<21}  {}",
            run.id,
            format!("{:.0} mm", last.depth_mm),
            last.stiffness_n_per_m2.words(1e-3, 1),
            last.damping_n_s_per_m2.words(1e-3, 2),
            tip(&run.errors)
        )?;
    }
    if let Some(LayersResult {
        boundary_mm: Some(mm),
        boundary_ci95_mm: Some([low, high]),
        stiffness_ratio,
        ..
    }) = &run.layers
    {
        let ratio =
            stiffness_ratio.map_or(String::new(), |ratio| format!(", {ratio:.2} times as stiff below"));
        writeln!(f, "  {:<width$}  layers: boundary at {mm:.1} mm ({low:.1} to {high:.1}){ratio}", "")?;
    }
    for other in &run.compare {
        writeln!(
            f,
            "  {:<width$}           {:<21}  {:<21}  {}",
            format!("- {}", other.method),
            value_text(other.stiffness_n_per_m2, 1),
            value_text(other.damping_n_s_per_m2, 2),
            tip(&other.errors)
        )?;
    }
    Ok(())
}

fn value_text(value: Option<f64>, digits: usize) -> String {
    value.map_or("-".to_owned(), |value| format!("{:.digits$}", 1e-3 * value))
}

fn tip(errors: &Errors) -> String {
    match (errors.rms_mm, errors.max_mm, errors.converged_at_mm) {
        (Some(rms), Some(max), Some(from)) => {
            format!("{:<25}  {from:.0} mm", format!("{rms:.2} mm, {max:.2} mm"))
        }
        _ => "does not converge to 0.5 mm".to_owned(),
    }
}
