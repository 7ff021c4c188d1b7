//! The runs in air of `guide characterize --port`: recorded on the device, into the session that is characterised.

use crate::cli::output::Output;
use crate::cli::record::{Measured, SessionArgs, open_session, record_program};
use crate::cli::rig_args::{StartArgs, device_time, device_us};
use anyhow::{anyhow, bail};
use device::air::{Axis, REACH_MM, Timetable, reach_mm, run_program, tare_program};
use device::link::{Client, LinkError, RunOptions, run};
use device::record::{Recorded, Ultrasound};
use formats::session::{LateralRun, Session, Setup};
use inference::diagnose::CharacterizeError;
use mechanics::{Model, ModelError};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Runs of each axis unless another number is requested: their zeros show how far a tare scatters.
const RUNS: u8 = 2;

/// Run in air before the rig is characterised.
#[derive(clap::Args)]
#[command(next_help_heading = "Recording the runs on a device")]
pub struct AirArgs {
    /// Record the runs first, into the session, with the device on this serial port, as `guide ports` lists it
    #[arg(long, value_name = "PORT")]
    port: Option<String>,
    /// Needle, guides and noise: a TOML file with `[needle]`, `[rig]`, `[noise]` as in a session (needed for a new session)
    #[arg(long, value_name = "FILE", requires = "port")]
    rig: Option<PathBuf>,
    /// Largest displacement on both sides of zero, millimetres (default: where the needle presses with 1 N, at most 4)
    #[arg(long, value_name = "MM", requires = "port", value_parser = reach)]
    reach_mm: Option<f64>,
    /// Runs of each axis
    #[arg(long, value_name = "N", requires = "port", default_value_t = RUNS, value_parser = clap::value_parser!(u8).range(1..=5))]
    runs: u8,
    /// Command that prints the needle's shape as CSV (z_mm, deflection_y_mm[, deflection_x_mm, time_s]); run in the holds at zero and
    /// at the extremes
    #[arg(long, value_name = "COMMAND", requires = "port")]
    sweep_command: Option<String>,
    /// Start the first tare when the device's clock reads this, in seconds since its start, and what follows at fixed times after it
    /// (default: at once); guide 2 is near zero then
    #[arg(long, value_name = "SECONDS", requires = "port", value_parser = device_time)]
    at_s: Option<f64>,
    /// Use the nominal calibration, that of the rig as designed, where the device has none stored (until its next
    /// start)
    #[arg(long, requires = "port")]
    nominal: bool,
}

fn reach(text: &str) -> Result<f64, String> {
    let [least, most] = REACH_MM;
    let value = text.parse().ok().filter(|value| (least..=most).contains(value));
    value.ok_or_else(|| format!("expected a number from {least} to {most}"))
}

/// A run that was recorded.
#[derive(Serialize)]
pub struct RunInAir {
    /// Its name in the session.
    pub run: String,
    #[serde(flatten)]
    pub recorded: Recorded,
}

/// Records the runs where a port is named; nothing without one.
pub fn record(args: &AirArgs, session: &Path, out: &Output) -> anyhow::Result<Option<Vec<RunInAir>>> {
    let Some(port) = &args.port else { return Ok(None) };
    refuse_other_runs(session)?;
    let ids = (1..=args.runs).flat_map(|number| [Axis::Y, Axis::X].map(|axis| (axis, number)));
    let mut client = Client::connect(port)?;
    let start = StartArgs { at_s: None, nominal: args.nominal };
    start.acknowledge(&mut client)?;
    let options = start.options(true)?;
    let at = |start_s: Option<f64>| RunOptions { start_us: start_s.map(device_us), ..options };
    let mut timetable = Timetable::new(args.at_s);
    let tare = tare_program().map_err(|problem| anyhow!("{problem}"))?;
    // The setup file is of a new session; later runs find it there.
    let mut rig = args.rig.clone();
    let mut completed_runs = Vec::new();
    for (axis, number) in ids {
        let id = format!("air-{}-{number}", axis.name());
        let destination = SessionArgs::in_air(session.to_owned(), rig.take(), id.clone());
        let opened = open_session(&destination)?;
        if !opened.setup.rig.needle.stiffness_known {
            // Before anything moves.
            bail!(CharacterizeError::NeedleUnknown {
                path: args.rig.clone().unwrap_or_else(|| session.join("session.toml"))
            });
        }
        let reach_mm = match args.reach_mm {
            Some(reach_mm) => reach_mm,
            None => reach_of(&opened.setup)?,
        };
        if completed_runs.is_empty() {
            out.note(format_args!(
                "guide 2 goes to {reach_mm:.1} mm on both sides of zero, in both axes; the needle is in both guides and in nothing else"
            ));
        }
        let program = run_program(axis, reach_mm).map_err(|problem| anyhow!("{problem}"))?;
        run(&mut client, &tare, at(timetable.start_s(&tare)), |_, _| Ok::<(), LinkError>(()))?;
        let ultrasound = args.sweep_command.as_deref().map_or(Ultrasound::Absent, Ultrasound::Command);
        let conditions = Measured {
            command: "characterize",
            session: &destination,
            tared: true,
            live: None,
            follower: None,
        };
        let options = at(timetable.start_s(&program));
        let (recorded, _) =
            record_program(&mut client, opened, &program, ultrasound, options, conditions, out)?;
        completed_runs.push(RunInAir { run: id, recorded });
    }
    Ok(Some(completed_runs))
}

/// Runs in air of another time would be characterised with the new ones, as if the rig were the same.
fn refuse_other_runs(session: &Path) -> anyhow::Result<()> {
    if !session.join("session.toml").exists() {
        return Ok(());
    }
    let read = Session::read(session)?;
    if let Some(run) = read.lateral.iter().find(|run| LateralRun::is_in_air(run)) {
        bail!(
            "{}: has runs in air already ({}): name a folder without any, or leave out --port to characterise these",
            session.display(),
            run.id
        );
    }
    Ok(())
}

/// Largest displacement of a run with this needle, millimetres.
fn reach_of(setup: &Setup) -> Result<f64, ModelError> {
    // Without tissue its modulus does not matter.
    let beam = Model::uniform(setup.rig.clone(), 1e3)?.beam(0.0)?;
    Ok(reach_mm(beam.lateral_stiffness_n_per_m()))
}
