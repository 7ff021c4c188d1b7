//! `guide acquire` and `guide record`: measuring into a session.

mod report;

use super::followed;
use super::igtl::{PublishArgs, TrackerArgs};
use super::output::Output;
use super::rig_args::{FaultNotes, ForceLimitArgs, PortArgs, StartArgs, interrupted};
use crate::follow::{Follower, push, sentence_now};
use crate::foreign::{Form, printable};
use crate::igtl::Live;
use anyhow::{Context, bail, ensure};
use device::link::{Batch, Client, Program, RunOptions, Telemetry};
use device::record::{AcquisitionObserver, Recorded, Recorder, Ultrasound, acquire, provenance};
use device::recording::{RawFile, RawRecorder, RecordingInfo};
use device::sweep::Sweep;
use formats::model_file::ModelFile;
use formats::session::{DEPTH_RANGE_MM, Provenance, SessionWriter, Setup};
use indicatif::{ProgressBar, ProgressStyle};
use protocol::{Request, Step};
use report::print;
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// Destination of a recording.
#[derive(clap::Args)]
pub(super) struct SessionArgs {
    /// Session folder; a new run is added to one that exists
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Insertion depth of the needle, millimetres; 0 in air
    #[arg(long, value_name = "MM", value_parser = run_depth_mm)]
    depth_mm: f64,
    /// Needle, guides and noise: a TOML file with `[needle]`, `[rig]`, `[noise]` as in a session (needed for a new session)
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
    /// Name of the run (default: made of the depth and a number)
    #[arg(long, value_name = "ID")]
    id: Option<String>,
    /// Raw recording of everything the device sends (default: <run>.mcap in the session folder)
    #[arg(long, value_name = "FILE", conflicts_with = "no_raw")]
    raw: Option<PathBuf>,
    /// Do not write a raw recording
    #[arg(long)]
    no_raw: bool,
    /// Compare the force with this model (model.toml of `guide diagnose --out`) while it is measured, and say since when it no longer follows
    #[arg(long, value_name = "FILE")]
    follow: Option<PathBuf>,
}

impl SessionArgs {
    /// For a run in air with this name, with its raw recording.
    pub(super) fn in_air(out: PathBuf, rig: Option<PathBuf>, id: String) -> Self {
        Self { out, depth_mm: 0.0, rig, id: Some(id), raw: None, no_raw: false, follow: None }
    }

    /// Comparison of the readings with a model, if one is given.
    fn follower(&self, setup: &Setup) -> anyhow::Result<Option<Follower>> {
        let Some(path) = &self.follow else { return Ok(None) };
        ensure!(self.depth_mm > 0.0, "--follow: in air no model has a force, expected a depth in tissue");
        followed::follower(path, &setup.rig, self.depth_mm).map(Some)
    }
}

/// Reads a depth in tissue, millimetres.
pub fn depth_mm(text: &str) -> Result<f64, String> {
    number_between(text, DEPTH_RANGE_MM)
}

/// Reads the depth of a run, millimetres: 0 in air.
pub fn run_depth_mm(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(0.0) => Ok(0.0),
        _ => depth_mm(text).map_err(|expected| format!("{expected}, or 0 in air")),
    }
}

/// Reads a duration in seconds.
pub fn duration_s(text: &str) -> Result<f64, String> {
    number_between(text, [0.001, 1e6])
}

fn number_between(text: &str, [least, most]: [f64; 2]) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number| (least..=most).contains(number));
    number.ok_or_else(|| format!("expected a number from {least} to {most}"))
}

/// Run a motion program on the rig and record it
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide acquire --port /dev/ttyACM0 --out phantom-a --rig rig.toml --depth-mm 30 \\\n      \
                        --program staircase --sweep-command 'probe-export --csv'"
)]
pub struct AcquireArgs {
    #[command(flatten)]
    port: PortArgs,
    #[command(flatten)]
    session: SessionArgs,
    #[command(flatten)]
    start: StartArgs,
    #[command(flatten)]
    limit: ForceLimitArgs,
    /// Motion program: a TOML file, or `displace`, `staircase` or `quick-staircase`
    #[arg(long, value_name = "FILE")]
    program: String,
    /// Command that prints one ultrasound sweep as CSV (z_mm, deflection_y_mm[, deflection_x_mm, time_s]); run in every hold
    /// that requests a sweep
    #[arg(long, value_name = "COMMAND", conflicts_with = "igtl")]
    sweep_command: Option<String>,
    /// Command that saves the ultrasound frames of one sweep and prints the path of the file or folder as its last line; run in every
    /// hold that requests a sweep. `guide import ultrasound --run` measures the shape from them
    #[arg(long, value_name = "COMMAND", conflicts_with_all = ["igtl", "sweep_command"])]
    frames_command: Option<String>,
    /// Measure although the force was not tared since the device started: its zero is that of the calibration
    #[arg(long)]
    no_tare: bool,
    #[command(flatten)]
    tracker: TrackerArgs,
    #[command(flatten)]
    publish: PublishArgs,
}

/// Record what the device streams, without moving anything
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide record --port /dev/ttyACM0 --out phantom-a --depth-mm 30 --duration-s 10"
)]
pub struct RecordArgs {
    #[command(flatten)]
    port: PortArgs,
    #[command(flatten)]
    session: SessionArgs,
    /// Duration, seconds (default: until interrupted)
    #[arg(long, value_name = "SECONDS", value_parser = duration_s)]
    duration_s: Option<f64>,
    #[command(flatten)]
    tracker: TrackerArgs,
    #[command(flatten)]
    publish: PublishArgs,
}

/// Runs `guide acquire`.
pub fn run_acquire(args: &AcquireArgs, out: &mut Output) -> anyhow::Result<()> {
    let program = Program::load(&args.program)?;
    let opened = open_session(&args.session)?;
    let mut follower = args.session.follower(&opened.setup)?;
    let ultrasound = match (args.tracker.connect()?, &args.sweep_command) {
        (Some(tracker), _) => Ultrasound::Tracker(Box::new(tracker)),
        (None, Some(command)) => Ultrasound::Command(command),
        (None, None) => args.frames_command.as_deref().map_or(Ultrasound::Absent, Ultrasound::Frames),
    };
    let mut client = Client::connect(&args.port.port)?;
    args.start.acknowledge(&mut client)?;
    let tares_itself = program.steps.iter().any(|planned| matches!(planned.step, Step::Tare { .. }));
    let tared = tares_itself || client.safety()?.tared;
    if !args.no_tare && !tared {
        bail!(
            "the force was not tared since the device started, so that its zero is that of the calibration and every result carries \
             the sensor's offset: run `guide tare` with the needle unloaded first, or give --no-tare"
        );
    }
    let live = args.publish.begin(&opened.setup.rig, &args.session.out, args.session.depth_mm, out)?;
    args.limit.set(&mut client)?;
    let options = args.start.options(true)?;
    let conditions =
        Measured { command: "acquire", session: &args.session, tared, live, follower: follower.as_mut() };
    let id = opened.id.clone();
    let (recorded, raw) =
        record_program(&mut client, opened, &program, ultrasound, options, conditions, out)?;
    print("guide.acquire/1", &args.session, &id, recorded, raw.as_ref(), follower, out)
}

/// Conditions of a recorded program.
pub(super) struct Measured<'a> {
    /// The sub-command.
    pub command: &'a str,
    pub session: &'a SessionArgs,
    /// The force has a measured zero.
    pub tared: bool,
    /// Who follows it meanwhile.
    pub live: Option<Live>,
    /// Comparison with a model.
    pub follower: Option<&'a mut Follower>,
}

/// Runs a program on the device and records it into a session.
pub(super) fn record_program(
    client: &mut Client,
    opened: Opened,
    program: &Program,
    ultrasound: Ultrasound<'_>,
    options: RunOptions<'_>,
    about: Measured<'_>,
    out: &Output,
) -> anyhow::Result<(Recorded, Option<RawFile>)> {
    let Opened { mut session, id, setup } = opened;
    let Measured { command, session: args, tared, live, follower } = about;
    let raw = start_raw(args, command, &id, &setup, tared, client)?;
    let made_with = provenance(client.hello(), Some(tared));
    let bar = ProgressBar::new(program.steps.len() as u64).with_style(
        ProgressStyle::with_template("{msg} {wide_bar} step {pos}/{len} {elapsed}")
            .context("the progress bar's template")?,
    );
    bar.set_message(printable(&program.name, Form::Text).into_owned());
    bar.enable_steady_tick(Duration::from_millis(200));
    let outcome = measure(&mut session, &id, args.depth_mm, made_with, |recorder| {
        let mut watch = Watch { bar: &bar, live, follower, out };
        Ok(acquire(client, program, options, ultrasound, recorder, &mut watch)?)
    });
    bar.finish_and_clear();
    let raw = raw.map(RawRecorder::finish).transpose();
    Ok((outcome?, raw?))
}

/// Runs `guide record`.
pub fn run_record(args: &RecordArgs, out: &mut Output) -> anyhow::Result<()> {
    let Opened { mut session, id, setup } = open_session(&args.session)?;
    let mut follower = args.session.follower(&setup)?;
    let mut tracker = args.tracker.connect()?;
    let mut client = Client::connect(&args.port.port)?;
    let interrupted = interrupted()?;
    let live = args.publish.begin(&setup.rig, &args.session.out, args.session.depth_mm, out)?;
    let tared = client.safety()?.tared;
    let raw = start_raw(&args.session, "record", &id, &setup, tared, &mut client)?;
    let made_with = provenance(client.hello(), Some(tared));
    let mut faults = FaultNotes::default();
    let hidden = ProgressBar::hidden();
    let mut watch = Watch { bar: &hidden, live, follower: follower.as_mut(), out };
    let outcome = measure(&mut session, &id, args.session.depth_mm, made_with, |recorder| {
        client.request(Request::Stream { enable: true })?;
        while !interrupted.load(Ordering::Acquire)
            && args.duration_s.is_none_or(|limit_s| recorder.recorded().duration_s < limit_s)
        {
            match client.next(device::link::SILENCE_LIMIT)? {
                Some(Telemetry::Samples(batch)) => {
                    watch.samples(&batch);
                    recorder.batch(&batch)?;
                    if let Some(tracker) = &mut tracker {
                        tracker.samples(&batch);
                        recorder.track(tracker, &mut watch)?;
                    }
                }
                Some(other) => faults.see(&other, "the recording continues", watch.out),
                None => bail!(device::link::LinkError::Silent { port: args.port.port.clone() }),
            }
        }
        // Telemetry after the last row is in neither.
        client.detach_tap();
        client.request(Request::Stream { enable: false })?;
        Ok(Recorded { link: client.losses(), ..recorder.recorded() })
    });
    tracker.iter().flat_map(|tracker| tracker.unused()).for_each(|remark| watch.note(&remark));
    let raw = raw.map(RawRecorder::finish).transpose();
    print("guide.record/1", &args.session, &id, outcome?, raw?.as_ref(), follower, out)
}

/// Follows the recording of a run: shows the progress, publishes where that is wanted.
struct Watch<'a> {
    bar: &'a ProgressBar,
    live: Option<Live>,
    follower: Option<&'a mut Follower>,
    out: &'a Output,
}

impl AcquisitionObserver for Watch<'_> {
    fn step(&mut self, step: usize) {
        self.bar.set_position(step as u64);
    }

    fn samples(&mut self, batch: &Batch) {
        if let Some(live) = &mut self.live {
            live.samples(batch);
        }
        let departures =
            self.follower.as_mut().map(|follower| push(follower, &batch.points)).unwrap_or_default();
        for parted in departures {
            let sentence = sentence_now(&parted);
            self.note(&format!("warning: {sentence}"));
            self.live.iter_mut().for_each(|live| live.scene().parted(sentence.clone()));
        }
    }

    fn sweep(&mut self, sweep: &Sweep, time_s: f64) {
        if let Some(live) = &mut self.live {
            live.sweep(sweep, time_s);
        }
    }

    fn note(&mut self, text: &str) {
        self.bar.suspend(|| self.out.note(text));
    }
}

/// A session that takes a run.
pub(super) struct Opened {
    session: SessionWriter,
    id: String,
    pub setup: Setup,
}

/// Begins the raw recording, unless it is not wanted. If its usual name is taken by remains of a run that never
/// started, it gets another.
fn start_raw(
    args: &SessionArgs,
    command: &str,
    id: &str,
    setup: &Setup,
    tared: bool,
    client: &mut Client,
) -> anyhow::Result<Option<RawRecorder>> {
    if args.no_raw {
        return Ok(None);
    }
    let path = args.raw.clone().unwrap_or_else(|| {
        let again = (2..).map(|number: u32| format!("{id}.{number}.mcap"));
        let mut names = std::iter::once(format!("{id}.mcap")).chain(again).map(|name| args.out.join(name));
        names.find(|path| !path.exists()).unwrap_or_default()
    });
    let info = RecordingInfo::new(command, id, args.depth_mm, setup.to_toml(&path)?).with_tared(tared);
    Ok(Some(RawRecorder::start(&path, info, client)?))
}

/// Opens or creates the session and chooses the run's name.
pub(super) fn open_session(args: &SessionArgs) -> anyhow::Result<Opened> {
    let existing = args.out.join("session.toml");
    let mut setup = match &args.rig {
        Some(rig) => Setup::read(rig)?,
        None if existing.exists() => Setup::read(&existing)?,
        None => bail!(
            "{}: no such session yet, so needle and rig are not known: give them with --rig FILE",
            args.out.display()
        ),
    };
    if setup.name.is_empty()
        && let Some(folder) = args.out.file_name()
    {
        setup.name = folder.to_string_lossy().into_owned();
    }
    let rig = args.rig.as_deref().map(ModelFile::of_setup_rig).transpose()?.flatten();
    let mut session = SessionWriter::open(&args.out, &setup)?;
    if let Some((_, rig)) = rig {
        session.characterized(&rig)?;
    }
    let id = args.id.clone().unwrap_or_else(|| {
        let used_ids = session.lateral_ids();
        (1..)
            .map(|number| format!("d{}-{number}", args.depth_mm))
            .find(|name| !used_ids.contains(name))
            .unwrap_or_default()
    });
    Ok(Opened { session, id, setup })
}

/// Records one run and enters it in the session in any case: what was recorded before a failure is kept.
fn measure(
    session: &mut SessionWriter,
    id: &str,
    depth_mm: f64,
    made_with: Provenance,
    record: impl FnOnce(&mut Recorder) -> anyhow::Result<Recorded>,
) -> anyhow::Result<Recorded> {
    let mut writer = session.lateral(id, depth_mm * 1e-3)?;
    writer.made_with(made_with);
    let outcome = record(&mut Recorder::new(&mut writer));
    writer.finish()?;
    outcome
}
