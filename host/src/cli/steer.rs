//! `guide steer`: brings a needle to a target, step by step, through a plant of someone else or the device.

mod drawing;
#[cfg(feature = "screen")]
mod live;
#[cfg(not(feature = "screen"))]
#[path = "steer/without_screen.rs"]
mod live;
mod outcome;
mod publish;
mod text;

use super::igtl::USUAL;
use super::output::Output;
use super::rig_args::{ForceLimitArgs, StartArgs, interrupted};
use crate::follow::{Parted, SteeredFollower, sentence_of_plant};
use anyhow::{Context, anyhow, bail, ensure};
use device::igtl::{Publisher, server};
use device::link::Client;
use device::steer::RigPlant;
use device::words::split;
use drawing::Readings;
use formats::NORMAL_975;
use formats::model_file::ModelFile;
use live::Live;
use outcome::{CueDocument, Fault, report};
use publish::Published;
use std::fs::{self, File, OpenOptions};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use steering::{
    Cue, Event, KnownEffect, Options, Plant, ProcessPlant, Record, Recorded, ReplayPlant, Run, SteerError,
    steer,
};
pub use text::write_before;

/// Steer a needle to a target: push, estimate tissue and tip, plan and make guide moves at stops, supervise, record
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide steer run1 --plant 'python3 plant.py' --target-mm=3,-2,100\n  guide steer run1 --port \
                  /dev/ttyACM0 --tip 'python3 stage.py' --target-mm=3,-2,100\n  guide steer run1 --plant 'python3 tracker.py' \
                  --advise --target-mm=3,-2,100\n  guide steer --replay run1/steer.jsonl --json"
)]
pub struct Args {
    /// Folder for the record of the run (steer.jsonl, or the next free name); made where it is missing
    #[arg(required_unless_present = "replay")]
    dir: Option<PathBuf>,
    /// Program that represents rig, needle and tissue, with its arguments: one JSON object a line on its standard input and output
    /// (needle/1)
    #[arg(long, value_name = "COMMAND", conflicts_with = "replay", required_unless_present_any = ["replay", "port"])]
    plant: Option<String>,
    /// Port of the device that moves guide 2, as `guide ports` lists it, a socket, or tcp:HOST:PORT
    #[arg(long, value_name = "PORT", conflicts_with_all = ["replay", "plant"], requires = "tip")]
    port: Option<String>,
    /// Program that pushes the needle and reads its tip, where guide 2 is moved by the device: needle/1 without the guide
    #[arg(long, value_name = "COMMAND", requires = "port")]
    tip: Option<String>,
    /// Use the nominal calibration, that of the rig as designed, where the device has none stored (until its next
    /// start)
    #[arg(long, requires = "port")]
    nominal: bool,
    #[command(flatten)]
    force_limit: ForceLimitArgs,
    /// Target: across the needle's axis, and its depth beyond the surface, millimetres
    #[arg(long, value_name = "X,Y,DEPTH", value_parser = target, allow_hyphen_values = true, required_unless_present = "replay", conflicts_with = "replay")]
    target_mm: Option<[f64; 3]>,
    /// Carry out a recorded run again without its plant, and compare every command and decision
    #[arg(long, value_name = "FILE")]
    replay: Option<PathBuf>,
    /// Push this far between two stops at which guide 2 may be moved, millimetres
    #[arg(long, value_name = "MM", default_value_t = 5.0, conflicts_with = "replay")]
    rest_every_mm: f64,
    /// Speed of pushing, millimetres a second, within what the plant allows
    #[arg(long, value_name = "MM/S", default_value_t = 4.0, conflicts_with = "replay")]
    push_speed_mm_s: f64,
    /// Turn the needle at most this often instead of moving guide 2: 0, 1 or 2; 2 with --advise
    #[arg(long, value_name = "N", conflicts_with_all = ["replay", "port"])]
    rotations: Option<usize>,
    /// For a needle that is held by hand: print what to do next, each time as it is decided; guide 2 is not moved
    #[arg(long, conflicts_with_all = ["replay", "port", "unsteered"])]
    advise: bool,
    /// Push and estimate without moving guide 2
    #[arg(long, conflicts_with = "replay")]
    unsteered: bool,
    /// Characterized rig (characterized.toml of `guide characterize --out`): its compliances and the needle's stiffness
    /// are in the model, the play of guide 2 with its interval
    #[arg(long, value_name = "FILE", conflicts_with = "replay")]
    characterized: Option<PathBuf>,
    /// Publish target, planned path with its band and next action over OpenIGTLink meanwhile; to this machine alone unless an address
    /// is given
    #[arg(long, value_name = "HOST:PORT", num_args = 0..=1, require_equals = true, default_missing_value = USUAL, conflicts_with = "replay")]
    publish: Option<String>,
    /// Show target, path so far, planned path with its band, what can be reached and the next action, live; where the output is no terminal
    /// the last of these screens is printed as text, 80 by 24; with --replay too
    #[arg(long)]
    screen: bool,
    /// Folder for figures: path and plan, and the plane of the target, as SVG; with --replay too
    #[arg(long, value_name = "DIR")]
    plots: Option<PathBuf>,
}

/// Reads a target.
pub fn target(text: &str) -> Result<[f64; 3], String> {
    let values: Result<Vec<f64>, _> = text.split(',').map(|value| value.trim().parse()).collect();
    let values = values.map_err(|_| "expected three numbers: X,Y,DEPTH")?;
    let values = <[f64; 3]>::try_from(values).map_err(|_| "expected three numbers: X,Y,DEPTH")?;
    if values.iter().all(|value| value.is_finite()) {
        Ok(values)
    } else {
        Err("expected finite numbers".into())
    }
}

/// Runs the sub-command.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    if let Some(file) = &args.replay {
        return replay(file, args, out);
    }
    let (Some(dir), Some(target_mm)) = (&args.dir, args.target_mm) else {
        bail!("expected DIR, --target-mm and --plant, or --port and --tip, or --replay");
    };
    super::plan_path::check_range("--rest-every-mm", args.rest_every_mm, [1.0, 20.0])?;
    super::plan_path::check_range("--push-speed-mm-s", args.push_speed_mm_s, [0.1, 100.0])?;
    let rotations = args.rotations.unwrap_or(if args.advise { 2 } else { 0 });
    let least = usize::from(args.advise);
    ensure!((least..=2).contains(&rotations), "--rotations: {rotations}, expected {least} to 2");
    let rig = args.characterized.as_deref().map(ModelFile::read).transpose()?.unwrap_or_default();
    let live = Live::new(args.screen, target_mm, out)?;
    let driver = Driver::new(args)?;
    let options = Options {
        rest_every_mm: args.rest_every_mm,
        push_speed_mm_s: args.push_speed_mm_s,
        steered: !args.unsteered,
        rotations,
        rig: known(&rig),
        ..Options::new(target_mm)
    };
    let publisher = match &args.publish {
        Some(address) => {
            let publisher = Publisher::bind(server::address(address)?, server::MAX_CLIENTS)?;
            out.note(format_args!("OpenIGTLink at {}", publisher.address()));
            Some(publisher)
        }
        None => None,
    };
    let mut followed = Followed {
        readings: Readings::default(),
        agreement: SteeredFollower::default(),
        published: Published::new(publisher, target_mm),
        live,
    };
    let (file, path) = create(dir)?;
    let record = Record::new(file);
    record.note("options", &options);
    // The options are those that a replay reads, to the last bit.
    let options = serde_json::from_str(&serde_json::to_string(&options)?)?;
    let mut closed = None;
    let is_shown = followed.live.is_shown();
    followed.live.begin()?;
    let mut on_news = |news: News| match news {
        News::Cue(cue) if args.advise && !is_shown && closed.is_none() => {
            let words = format!("{cue}\n");
            closed = out.line(&CueDocument { schema: "guide.steer_cue/1", cue }, words).err();
        }
        News::Parted(parted) if !is_shown => {
            out.note(format_args!("warning: {}", sentence_of_plant(&parted)));
        }
        News::Cue(_) | News::Parted(_) => {}
    };
    let outcome = driver.carry_out(&options, &record, &mut followed, &mut on_news);
    followed.live.end(&outcome, out)?;
    if let Some(error) = closed {
        return Err(error);
    }
    if let Some(problem) = record.failed() {
        out.note(format_args!("warning: {}: the record is not complete: {problem}", path.display()));
    }
    if let Ok(run) = &outcome {
        drawing::draw(run, &followed.readings, args.plots.as_deref(), out)?;
    }
    report(outcome, &options, Some(&path), false, &followed.agreement.agreement(), out)
}

/// Intervals of a rig in a file, as normal distributions.
pub fn known(rig: &ModelFile) -> Vec<KnownEffect> {
    rig.effects
        .iter()
        .map(|learned| KnownEffect {
            id: learned.effect.id().to_owned(),
            values: learned.values.clone(),
            sds: learned
                .ci95
                .iter()
                .map(|ci95| ci95.map_or(0.0, |[low, high]| (high - low) / (2.0 * NORMAL_975)))
                .collect(),
        })
        .collect()
}

/// What is said while a run goes on.
enum News {
    /// What is to be done next.
    Cue(Cue),
    /// Readings no longer follow the model.
    Parted(Parted),
}

/// Records and published values of a run.
struct Followed {
    readings: Readings,
    agreement: SteeredFollower,
    published: Published,
    live: Live,
}

/// Plant that is steered.
struct Driver {
    /// Program of the plant, or of the needle's side.
    words: Vec<String>,
    /// The device that moves guide 2, where the plant does not.
    client: Option<Client>,
    interrupted: &'static AtomicBool,
}

impl Driver {
    /// Connects to the device, where there is one. Driver before any motion.
    fn new(args: &Args) -> anyhow::Result<Self> {
        let (option, command) = match (&args.plant, &args.tip) {
            (Some(plant), _) => ("--plant", plant),
            (None, Some(tip)) => ("--tip", tip),
            (None, None) => bail!("expected --plant, or --port and --tip"),
        };
        let words = split(command).filter(|words| !words.is_empty());
        let words = words.ok_or_else(|| anyhow!("{option}: `{command}` is no command"))?;
        let interrupted = interrupted()?;
        let client = match &args.port {
            Some(port) => {
                let mut client = Client::connect(port)?;
                StartArgs { at_s: None, nominal: args.nominal }.acknowledge(&mut client)?;
                ensure!(
                    client.safety()?.tared,
                    "the force was not tared since the device started, so that the force limit counts from the calibration's zero: run \
                     `guide tare` with the needle unloaded first"
                );
                args.force_limit.set(&mut client)?;
                Some(client)
            }
            None => None,
        };
        Ok(Self { words, client, interrupted })
    }

    /// Steers; what passes between controller and plant is recorded.
    fn carry_out(
        self,
        options: &Options,
        record: &Record,
        followed: &mut Followed,
        on_news: &mut dyn FnMut(News),
    ) -> Result<Run, SteerError> {
        let Self { words, client, interrupted } = self;
        let (program, arguments) = words.split_first().map_or(("", &[][..]), |(first, rest)| (first, rest));
        match client {
            None => {
                let mut plant = ProcessPlant::start(program, arguments, record.clone(), interrupted)?;
                carry_out(&mut plant, options, record, followed, on_news)
            }
            Some(client) => {
                // The lines of the whole are recorded, not those of its needle's side.
                let needle = ProcessPlant::start(program, arguments, Record::default(), interrupted)
                    .map_err(|error| record.failure(error))?;
                let plant = RigPlant::new(client, needle, interrupted);
                carry_out(&mut Recorded { plant, record: record.clone() }, options, record, followed, on_news)
            }
        }
    }
}

/// The first free name in a folder: runs are never overwritten, also where several are made at once.
fn create(dir: &Path) -> anyhow::Result<(File, PathBuf)> {
    fs::create_dir_all(dir).with_context(|| format!("{}: cannot create", dir.display()))?;
    for number in 1..100_000 {
        let name = if number == 1 { "steer.jsonl".to_owned() } else { format!("steer-{number}.jsonl") };
        let path = dir.join(name);
        match OpenOptions::new().write(true).create_new(true).open(&path) {
            Ok(file) => return Ok((file, path)),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error).with_context(|| format!("{}: cannot create", path.display())),
        }
    }
    bail!("{}: holds 100000 records, expected fewer", dir.display())
}

fn carry_out(
    plant: &mut dyn Plant,
    options: &Options,
    record: &Record,
    followed: &mut Followed,
    on_news: &mut dyn FnMut(News),
) -> Result<Run, SteerError> {
    let target_depth_mm = options.target_mm[2];
    let Followed { readings, agreement, published, live } = followed;
    let result = steer(plant, options, &mut |event| {
        live.take(event);
        match event {
            Event::Statement(stated) => {
                let cue = Cue {
                    depth_mm: 0.0,
                    turn_by_deg: None,
                    bevel_deg: stated.bevel_deg,
                    push_to_mm: options.rest_every_mm.min(target_depth_mm),
                    limits: None,
                };
                published.cue(&cue);
                on_news(News::Cue(cue));
            }
            Event::Decision(decision) => {
                record.note("decision", decision);
                published.decision(decision);
                let cue = decision.cue(target_depth_mm);
                published.cue(&cue);
                on_news(News::Cue(cue));
            }
            Event::Answer(answer) => readings.take(answer),
            Event::Compared(comparison) => {
                for parted in agreement.take(comparison) {
                    record.note("parted", &parted);
                    published.parted(&parted);
                    live.parted(&parted);
                    on_news(News::Parted(parted));
                }
            }
            _ => {}
        }
    });
    match &result {
        Ok(run) => record.note("outcome", &run.outcome),
        Err(error) => record.note("fault", &Fault::from(error)),
    }
    result
}

/// Carries a recorded run out again.
fn replay(file: &Path, args: &Args, out: &mut Output) -> anyhow::Result<()> {
    let text = fs::read_to_string(file).with_context(|| format!("{}: cannot read", file.display()))?;
    let mut plant = ReplayPlant::new(&text).with_context(|| format!("{}: no record", file.display()))?;
    let options = plant.options().clone();
    let recorded = plant.decisions().to_vec();
    let mut live = Live::new(args.screen, options.target_mm, out)?;
    live.begin()?;
    let (mut decisions, mut readings) = (Vec::new(), Readings::default());
    let mut agreement = SteeredFollower::default();
    let outcome = steer(&mut plant, &options, &mut |event| {
        live.take(event);
        match event {
            Event::Decision(decision) => decisions.push(serde_json::to_string(decision).unwrap_or_default()),
            Event::Answer(answer) => readings.take(answer),
            Event::Compared(comparison) => {
                agreement.take(comparison).iter().for_each(|parted| live.parted(parted));
            }
            _ => {}
        }
    });
    live.end(&outcome, out)?;
    if let Err(SteerError::Plant(error @ steering::PlantError::Differs { .. })) = &outcome {
        bail!("{}: {error}", file.display());
    }
    for (number, decision) in recorded.iter().enumerate() {
        ensure!(
            decisions.get(number) == Some(decision),
            "{}: decision {} comes out differently, expected that of the record",
            file.display(),
            number + 1
        );
    }
    if let Ok(run) = &outcome {
        drawing::draw(run, &readings, args.plots.as_deref(), out)?;
    }
    report(outcome, &options, Some(file), true, &agreement.agreement(), out)
}
