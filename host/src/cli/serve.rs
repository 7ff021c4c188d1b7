//! `guide serve`: results of a session and what its device measures, for OpenIGTLink clients.

use super::followed;
use super::igtl::{RateArgs, USUAL, set_tissue_model};
use super::output::Output;
use super::rig_args::interrupted;
use crate::follow::{Follower, push, sentence_now};
use crate::igtl::{Live, Scene, live};
use anyhow::{Context, bail};
use device::igtl::Message;
use device::link::{Client, Telemetry};
use device::monitor::{Event, Worker};
use formats::model_file::ModelFile;
use formats::session::{DEPTH_RANGE_MM, Session};
use inference::identify::{self, Identification, YoungsMethod, identify};
use inference::predict::{self, predict};
use mechanics::continuum::Contact;
use serde::Serialize;
use std::collections::BTreeSet;
use std::fmt::{self, Display};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::mpsc::{self, Sender};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime};

/// Interval at which the program checks whether it is to end.
const POLL_INTERVAL: Duration = Duration::from_millis(50);
/// Interval at which the session's files are checked. They are read when they have not changed between two
/// checks.
const FILE_POLL_INTERVAL: Duration = Duration::from_secs(1);

/// Publish results and live values over OpenIGTLink (3D Slicer, PLUS and others): guide, force, needle, tip, modulus, predicted path
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide serve phantom-a --igtl\n  guide serve phantom-a --igtl --port /dev/ttyACM0 --depth-mm 30 --follow model.toml\n  guide serve \
                        phantom-a --igtl=0.0.0.0:18944"
)]
pub struct Args {
    /// Session folder: its results are published, and again whenever it changes
    #[arg(default_value = ".")]
    dir: PathBuf,
    /// Serve OpenIGTLink: to this machine alone unless an address is given
    #[arg(long, required = true, value_name = "HOST:PORT", num_args = 0..=1, require_equals = true, default_missing_value = USUAL)]
    igtl: String,
    /// Serial port of the device: guide and force are published too, tip and shape where the modulus is known
    #[arg(long, value_name = "PORT")]
    port: Option<String>,
    /// Insertion depth of the needle, millimetres (default: that of the last lateral run)
    #[arg(long, value_name = "MM", requires = "port", value_parser = super::record::depth_mm)]
    depth_mm: Option<f64>,
    /// Foundation modulus, kilopascals, instead of the session's
    #[arg(long, value_name = "K", value_parser = modulus_kpa)]
    k_kpa: Option<f64>,
    /// Take the effects of a model file (model.toml) into the model
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Compare the force with this model (model.toml of `guide diagnose --out`) and say since when it no longer follows
    #[arg(long, value_name = "FILE", requires = "port")]
    follow: Option<PathBuf>,
    /// Depth up to which readings of each insertion are used for the prediction of its rest, millimetres
    #[arg(long, value_name = "MM", default_value_t = 50.0, value_parser = super::record::depth_mm)]
    until: f64,
    #[command(flatten)]
    rate: RateArgs,
    /// Duration, seconds (default: until interrupted)
    #[arg(long, value_name = "SECONDS", value_parser = super::record::duration_s)]
    duration_s: Option<f64>,
}

fn modulus_kpa(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|value| *value > 0.0 && *value <= 1e4);
    value.ok_or_else(|| "expected more than 0 and at most 10000 kPa".to_owned())
}

#[derive(Serialize)]
struct Report<'a> {
    schema: &'static str,
    session: &'a Path,
    address: String,
    port: Option<&'a str>,
}

impl Display for Report<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "serving    {} over OpenIGTLink at {}", self.session.display(), self.address)?;
        match self.port {
            Some(port) => writeln!(f, "device     {port}"),
            None => Ok(()),
        }
    }
}

/// Runs the sub-command.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    let interrupted = interrupted()?;
    let model = args.model.as_deref().map(ModelFile::read).transpose()?;
    let session = Session::read(&args.dir)?;
    let follower = args.follower(&session)?;
    let scene = Scene::new(session.rig.guide2_m, session.rig.entry_m);
    let client = args.port.as_deref().map(Client::connect).transpose()?;
    let live = Arc::new(Mutex::new(args.rate.serve(&args.igtl, scene)?));
    let address = lock(&live).publisher().address().to_string();
    let (remarks, received) = mpsc::channel();
    let worker = client.map(|client| follow(client, follower, &live, remarks)).transpose()?;
    let report = Report { schema: "guide.serve/1", session: &args.dir, address, port: args.port.as_deref() };
    out.line(&report, &report)?;

    let mut results = Results { args, model, live: &live, noted: BTreeSet::new() };
    let began = Instant::now();
    let mut files = FilesWatch::default();
    let mut next_poll = began;
    while !interrupted.load(Ordering::Acquire) && !is_over(began, args.duration_s) {
        if Instant::now() >= next_poll {
            next_poll = Instant::now() + FILE_POLL_INTERVAL;
            if files.has_settled(&args.dir) {
                results.publish(out);
            }
        }
        let changes = args.rate.client_remarks(&lock(&live));
        changes.into_iter().for_each(|remark| out.note(remark));
        received.try_iter().for_each(|remark: String| out.note(remark));
        if worker.as_ref().is_some_and(|worker| !worker.is_running()) {
            bail!("the link's thread has ended");
        }
        std::thread::sleep(POLL_INTERVAL);
    }
    Ok(())
}

fn is_over(began: Instant, duration_s: Option<f64>) -> bool {
    duration_s.is_some_and(|limit_s| began.elapsed().as_secs_f64() > limit_s)
}

impl Args {
    /// Depth of the needle, as stated or that of the last lateral run.
    fn depth_mm(&self, session: &Session) -> Option<f64> {
        self.depth_mm.or_else(|| session.lateral.last().map(|run| 1e3 * run.depth_m))
    }

    /// Comparison of the force with a model, if one is given.
    fn follower(&self, session: &Session) -> anyhow::Result<Option<Follower>> {
        let Some(path) = &self.follow else { return Ok(None) };
        let depth_mm = self.depth_mm(session).filter(|depth_mm| *depth_mm > 0.0);
        let depth_mm =
            depth_mm.context("--follow: in air no model has a force, expected a depth in tissue")?;
        followed::follower(path, &session.rig, depth_mm).map(Some)
    }
}

/// Publishes what the device streams, and since when its force no longer follows the model; a lost connection is made again.
fn follow(
    client: Client,
    mut follower: Option<Follower>,
    live: &Arc<Mutex<Live>>,
    remarks: Sender<String>,
) -> anyhow::Result<Worker> {
    let live = Arc::clone(live);
    Worker::start(client, move |event| {
        let remark = match event {
            Event::Telemetry(Telemetry::Samples(batch)) => {
                let departures =
                    follower.as_mut().map(|follower| push(follower, &batch.points)).unwrap_or_default();
                for sentence in departures.iter().map(sentence_now) {
                    let _ = remarks.send(format!("warning: {sentence}"));
                    lock(&live).scene().parted(sentence);
                }
                return lock(&live).samples(&batch);
            }
            Event::Lost(reason) => format!("the connection to the device is lost: {reason}"),
            Event::Parted(text) => text,
            Event::Connected { .. } | Event::Telemetry(_) | Event::LinkTotals(_) | Event::Command(_) => {
                return;
            }
        };
        // If there is no receiver left the program ends.
        let _ = remarks.send(remark);
    })
    .context("cannot start the link's thread")
}

/// The publisher, also where a thread has panicked while it held the lock: its state remains usable.
fn lock(live: &Mutex<Live>) -> MutexGuard<'_, Live> {
    live.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Results of the session as they are published.
struct Results<'a> {
    args: &'a Args,
    model: Option<ModelFile>,
    live: &'a Mutex<Live>,
    noted: BTreeSet<String>,
}

impl Results<'_> {
    /// Reads the session and publishes what it gives; what it does not give is reported, once.
    fn publish(&mut self, out: &Output) {
        let session = match Session::read(&self.args.dir) {
            Ok(session) => session,
            Err(error) => return self.note(format!("not published: {error}"), out),
        };
        let stamp = live::now();
        let mut messages: Vec<Message> = Vec::new();
        let model = self.model.clone().unwrap_or_default();
        let mut found: Option<Identification> = None;
        if !session.lateral.is_empty() {
            let relation = YoungsMethod::Continuum(Contact::Bonded);
            let options = identify::Options { relation, ..identify::Options::default() }.with_model(&model);
            match identify(&session, &options) {
                Ok(identification) => {
                    messages.push(Scene::identification(&identification, stamp));
                    found = Some(identification);
                }
                Err(error) => self.note(format!("the modulus is not published: {error}"), out),
            }
        }
        let of_model = model.modulus_and_sd_pa();
        if !session.insertion.is_empty() {
            let stated = predict::Options { until_m: 1e-3 * self.args.until, ..predict::Options::default() };
            let options = stated.with_model(&model, session.lateral.is_empty());
            match predict(&session, &options) {
                Ok(prediction) => messages.extend(lock(self.live).scene().prediction(&prediction, stamp)),
                Err(error) => self.note(format!("the path is not published: {error}"), out),
            }
        }
        if self.args.port.is_some() {
            let identified_kpa = found.map(|found| found.pooled.k_kpa);
            let k_kpa =
                self.args.k_kpa.or(identified_kpa).or(of_model.map(|[modulus_pa, _]| 1e-3 * modulus_pa));
            self.publish_tissue(&session, k_kpa, out);
        }
        lock(self.live).publisher().keep(&messages);
    }

    /// Has tip and shape published.
    fn publish_tissue(&mut self, session: &Session, k_kpa: Option<f64>, out: &Output) {
        let Some(depth_mm) = self.args.depth_mm(session) else {
            let [least, most] = DEPTH_RANGE_MM;
            return self.note(
                format!("tip and shape of the needle are not published: give its depth with --depth-mm ({least} to {most})"),
                out,
            );
        };
        let Some(k_kpa) = k_kpa else {
            return self.note(
                "tip and shape of the needle are not published: neither the session nor --k-kpa gives the modulus".to_owned(),
                out,
            );
        };
        let has_model = set_tissue_model(
            lock(self.live).scene(),
            &session.rig,
            1e3 * k_kpa,
            self.model.as_ref(),
            depth_mm,
        );
        if let Err(error) = has_model {
            self.note(format!("tip and shape of the needle are not published: {error:#}"), out);
        }
    }

    fn note(&mut self, text: String, out: &Output) {
        if self.noted.insert(text.clone()) {
            out.note(text);
        }
    }
}

/// The session's files, to see when they change.
#[derive(Default)]
struct FilesWatch {
    previous: Option<Vec<(PathBuf, u64, SystemTime)>>,
    read: Option<Vec<(PathBuf, u64, SystemTime)>>,
}

impl FilesWatch {
    /// Whether the files differ from when this was last true, and have not changed since the previous check. The first check counts.
    fn has_settled(&mut self, dir: &Path) -> bool {
        let now = Self::state(dir);
        let settled = self.previous.as_ref().is_none_or(|previous| *previous == now)
            && self.read.as_ref() != Some(&now);
        self.previous = Some(now.clone());
        if settled {
            self.read = Some(now);
        }
        settled
    }

    fn state(dir: &Path) -> Vec<(PathBuf, u64, SystemTime)> {
        let entries = std::fs::read_dir(dir).into_iter().flatten().flatten();
        let mut state: Vec<_> = entries
            .filter_map(|entry| {
                let metadata = entry.metadata().ok()?;
                let is_one = entry.path().extension().is_some_and(|kind| kind == "csv" || kind == "toml");
                (is_one && metadata.is_file()).then_some((
                    entry.path(),
                    metadata.len(),
                    metadata.modified().ok()?,
                ))
            })
            .collect();
        state.sort();
        state
    }
}
