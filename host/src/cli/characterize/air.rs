//! Runs in air, made on the device: those that the session does not have yet.

use super::super::igtl::TrackerArgs;
use super::super::output::Output;
use super::super::record::{Planned, SessionArgs, open_session, recorded};
use super::super::rig_args::{ForceLimitArgs, StartArgs, interrupted};
use anyhow::Context;
use device::link::{Client, RunOptions};
use device::record::Ultrasound;
use device::record::air::{AirRun, interval_s};
use formats::session::Session;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// How runs in air are made.
#[derive(clap::Args)]
#[command(next_help_heading = "Runs in air, made on the device")]
pub struct AirArgs {
    /// Serial port of the device, as `guide ports` lists it: makes the runs in air that the session does not have yet. The needle is in both
    /// guides and in nothing else; guide 2 moves by up to 4 mm and 1 N on either side
    #[arg(long, value_name = "PORT")]
    port: Option<String>,
    /// Needle, guides and noise: a TOML file with `[needle]`, `[rig]`, `[noise]` as in a session (needed for a new session)
    #[arg(long, value_name = "FILE", requires = "port")]
    rig: Option<PathBuf>,
    /// How often each axis is run
    #[arg(long, value_name = "N", requires = "port", default_value_t = 2, value_parser = repeats)]
    repeats: usize,
    /// Command that prints one sweep of the shape as CSV (z_mm, deflection_y_mm[, deflection_x_mm, time_s]); run at zero and at the largest
    /// displacements
    #[arg(long, value_name = "COMMAND", requires = "port", conflicts_with = "igtl")]
    sweep_command: Option<String>,
    #[command(flatten)]
    start: StartArgs,
    #[command(flatten)]
    limit: ForceLimitArgs,
    #[command(flatten)]
    tracker: TrackerArgs,
}

fn repeats(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|count| (1..=20).contains(count)).ok_or_else(|| "expected 1 to 20".to_owned())
}

impl AirArgs {
    /// Makes the runs that the session in a folder does not have, each one whole or not at all: one that ends early is made again by the
    /// next call, under another name.
    ///
    /// # Errors
    /// Of the session, the link and the device; the runs before are kept.
    pub fn make(&self, dir: &Path, out: &Output) -> anyhow::Result<()> {
        let Some(port) = &self.port else { return Ok(()) };
        let session = || dir.join("session.toml").exists().then(|| Session::read(dir)).transpose();
        let before = session()?;
        let all = AirRun::all(self.repeats);
        let is_made = |run: &AirRun| before.as_ref().is_some_and(|session| run.is_in(session));
        let missing: Vec<AirRun> = all.iter().copied().filter(|run| !is_made(run)).collect();
        let made = all.len() - missing.len();
        let Some(first) = missing.first() else {
            out.note(format_args!(
                "{}: all {made} runs in air are there, nothing is moved; another --session for new ones",
                dir.display()
            ));
            return Ok(());
        };
        if before.is_some() {
            out.note(format_args!(
                "{}: {made} of {} runs in air are complete; next: {first}",
                dir.display(),
                all.len()
            ));
        }
        let mut client = Client::connect(port)?;
        self.start.acknowledge(&mut client)?;
        let interrupted = interrupted()?;
        for (number, run) in missing.iter().enumerate() {
            let place = self.place(number, interrupted);
            self.run(&mut client, dir, *run, session()?.as_ref(), place, out).with_context(|| {
                format!(
                    "{run}: {} of {} runs in air are complete, nothing of this one is used; the same command goes on with it",
                    made + number,
                    all.len()
                )
            })?;
        }
        Ok(())
    }

    fn place(&self, number: usize, interrupted: &'static AtomicBool) -> Place {
        Place { number, interrupted, first_s: self.start.at_s }
    }

    fn run(
        &self,
        client: &mut Client,
        dir: &Path,
        run: AirRun,
        session: Option<&Session>,
        place: Place,
        out: &Output,
    ) -> anyhow::Result<()> {
        let args = SessionArgs::in_air(dir, self.rig.as_deref(), run.free_id(session));
        let opened = open_session(&args)?;
        let travel_mm = 1e-3 * f64::from(client.hello().scales.travel_um);
        let program = run.program(&opened.setup, travel_mm).with_context(|| {
            "the needle is too stiff between its guides: it takes more than 1 N to move guide 2 by 0.8 mm; expected a longer or thinner one"
        })?;
        let interval_s = interval_s(&program);
        out.note(format_args!("{run}: {} steps, about {interval_s:.0} s", program.steps.len()));
        let start_us =
            place.first_s.map(|first_s| (1e6 * (first_s + place.number as f64 * interval_s)).round() as u64);
        let options = RunOptions { start_us, stream: true, interrupted: place.interrupted };
        // It tares itself, with the needle straight.
        let planned = Planned { program: &program, options, limit: self.limit, tared: true };
        let ultrasound = match (self.tracker.connect()?, &self.sweep_command) {
            (Some(tracker), _) => Ultrasound::Tracker(Box::new(tracker)),
            (None, Some(command)) => Ultrasound::Command(command),
            (None, None) => Ultrasound::Absent,
        };
        recorded(client, &args, opened, &planned, ultrasound, None, out)?;
        Ok(())
    }
}

/// Which run of this call it is, when the first starts by the device's clock, and where an interrupt is found.
#[derive(Clone, Copy)]
struct Place {
    number: usize,
    first_s: Option<f64>,
    interrupted: &'static AtomicBool,
}
