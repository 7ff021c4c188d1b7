//! `cargo xtask demo` and `cargo xtask rig`: the whole system at work on a machine without a board.
//!
//! The demonstration types the commands a user would type and shows what they print. Its motions start at fixed times of the
//! device's clock, and the rig advances with that clock, so the same seed gives the same numbers on any machine. The rig has
//! these times, and waits for a command that a busy machine has not come to yet.

mod air;
pub mod hidden;
pub mod investigated;
mod outcome;
pub mod seeds;
pub mod steered;

pub use outcome::{Frames, Outcome};

use crate::bench::Bench;
use crate::cosim::{Appointment, Fault};
use crate::images;
use crate::needle;
use crate::qemu::HANGS;
use anyhow::{Context, Result, ensure};
use device::link::Program;
use formats::session::{InsertionRun, Noise, Session, SessionWriter, Setup};
use mechanics::Rig;
use simulation::rig::SCAN_MARGIN_MM;
use simulation::rig::config::RigConfig;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::{Duration, Instant};

/// When home, tare and the measurement start, seconds of the device's clock. A command that comes too late is refused, not carried
/// out at another time; the rig's clock waits for each of them, however slow or busy the machine is.
const HOME_AT_S: u32 = 4;
const TARE_AT_S: u32 = 10;
const ACQUIRE_AT_S: u32 = 15;
/// Insertions of the needle after the modulus is known.
const INSERTIONS: usize = 4;
/// Rig seconds per second at most; slower computers run QEMU at half of it.
const SPEED: f64 = 8.0;
/// A command that takes longer shows a sign of life as often: half of what a reader waits before a program seems to hang.
const QUIET: Duration = Duration::from_secs(15);

/// Options of `cargo xtask demo`.
#[derive(clap::Args)]
pub struct Args {
    /// Seed of tissue, actuators and noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Folder of rig file and session
    #[arg(long, value_name = "DIR", default_value = "target/demo")]
    out: PathBuf,
}

/// Options of `cargo xtask rig`.
#[derive(clap::Args)]
pub struct RigArgs {
    /// Seed of tissue, actuators and noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Rig file with an optional table `[simulation]` (default: the demonstration's rig)
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Rig seconds per second; a large number for as fast as this machine can
    #[arg(long, default_value_t = 1.0, value_name = "FACTOR")]
    speed: f64,
    /// Something that is wired or mounted wrong, as `leads-reversed:x` or `hum50:0.05`; may be given several times
    #[arg(long, value_name = "FAULT")]
    fault: Vec<Fault>,
}

/// Runs the demonstration and judges it. Whether the hidden effect is found, and how far the steered needle misses, are results that are
/// printed, not errors.
///
/// # Errors
/// Where a command fails, samples were lost, or the modulus is off by more than a tenth.
pub fn run(args: &Args) -> Result<()> {
    println!("the rig is brought up, by the steps that need no hand:\n");
    brought_up(args.seed, &args.out, &mut |text| print!("{text}"))?;
    let outcome = procedure(&this_program()?, args.seed, &args.out, &mut |text| print!("{text}"))?;
    print!("{}", judgement(&outcome, args.seed, &args.out)?);
    println!();
    println!(
        "another rig, characterised in air; then it hides an effect, guide investigate chooses what to measure, and the firmware makes the runs:\n"
    );
    let known = hidden::RigKnown::InAir;
    let investigated =
        investigated::investigated(&this_program()?, args.seed, &args.out, known, &mut |text| {
            print!("{text}")
        })?;
    println!("{}", investigated.summary(args.seed));
    println!("figures and the augmented model are in {}", args.out.display());
    println!("\na needle is steered to a target; the firmware moves guide 2, another program pushes:\n");
    let steered = steered::steered(&this_program()?, args.seed, &args.out, &mut |text| print!("{text}"))?;
    println!("{}", steered.summary(args.seed));
    let (lost, error) = (outcome.lost_samples(), outcome.error()?);
    ensure!(lost == 0.0, "{lost} samples were lost on the way");
    ensure!(error.abs() < 0.1, "the identified modulus is off by {:.0} %", 100.0 * error);
    Ok(())
}

/// The automatic steps of the bring-up, a line each.
///
/// # Errors
/// Where the firmware cannot be started, or something is found.
fn brought_up(seed: u64, out: &Path, show: &mut dyn FnMut(&str)) -> Result<()> {
    let guide = images::build_guide()?;
    images::build(images::Image::Qemu)?;
    fs::create_dir_all(out).with_context(|| format!("cannot make {}", out.display()))?;
    let record = out.join("bringup.toml");
    // The file is that of an earlier demonstration, with another rig.
    if record.exists() {
        fs::remove_file(&record).with_context(|| format!("cannot remove {}", record.display()))?;
    }
    let bench = Bench::start(RigConfig::default(), seed, SPEED, HANGS)?;
    let port = bench.port();
    let mut guide = Typist { program: guide, show };
    guide.shown(&["bringup", "--port", &port, "--yes", "--no-clock", "--out", path(&record)?])?;
    bench.stop()?;
    Ok(())
}

/// Comparison of the results with the truth, in words.
///
/// # Errors
/// Where the result lacks a number.
pub fn judgement(outcome: &Outcome, seed: u64, out: &Path) -> Result<String> {
    let true_kpa = outcome.truth.modulus_pa * 1e-3;
    let likelihood_kpa = outcome.number("likelihood", "k_kpa")?;
    let [low_kpa, high_kpa] = outcome.interval_kpa()?;
    let frames = outcome.frames()?;
    let verdict = if (low_kpa..=high_kpa).contains(&true_kpa) { "contains" } else { "misses" };
    Ok(format!(
        "ground truth, hidden from the estimator (seed {seed}):
  true K           {true_kpa:.2} kPa
  identified K     {likelihood_kpa:.2} kPa, error {:+.1} %
  95 % interval    {low_kpa:.2} to {high_kpa:.2} kPa: {verdict} the true K
  frames           {} used, {} rejected
  start of QEMU to K: {:.1} s
  tip beyond 50 mm: error {:.2} mm on average ({:.2} mm by a quadratic), {:.0} % inside the 95 % bands
the session is in {}
",
        100.0 * outcome.error()?,
        frames.used,
        frames.rejected,
        outcome.elapsed.as_secs_f64(),
        outcome.path_error_mm(None),
        outcome.path_error_mm(Some("quadratic")),
        100.0 * outcome.share_inside(),
        out.join(SESSION).display(),
    ))
}

const SESSION: &str = "phantom";
const RUN: &str = "d30-1";
/// The motion program of the measurement.
const PROGRAM: &str = "displace";

/// Homes, tares, displaces, holds, records and identifies with the program `guide`; `show` gets what a user would read. `xtask` is
/// the program that takes sweeps from the rig.
///
/// # Errors
/// Where a command fails.
pub fn procedure(xtask: &Path, seed: u64, out: &Path, show: &mut dyn FnMut(&str)) -> Result<Outcome> {
    let guide = images::build_guide()?;
    let config = RigConfig::default();
    let session = out.join(SESSION);
    if session.exists() {
        fs::remove_dir_all(&session).with_context(|| format!("cannot clear {}", session.display()))?;
    }
    fs::create_dir_all(out).with_context(|| format!("cannot make {}", out.display()))?;
    let rig_file = out.join("rig.toml");
    fs::write(&rig_file, rig_toml(&config.rig))?;
    let depth_mm = config.simulation.depth_mm.to_string();
    let user_rig = config.rig.clone();
    images::build(images::Image::Qemu)?;

    let began = Instant::now();
    let bench = Bench::start(config, seed, SPEED, HANGS)?;
    bench.rig().expect([
        Appointment::at_s(HOME_AT_S),
        Appointment::at_s(TARE_AT_S),
        Appointment::at_s(ACQUIRE_AT_S).with_sweeps(sweeps(PROGRAM)?),
    ]);
    let port = bench.port();
    let frames = frames_command(xtask, &bench, &session)?;
    let (session, rig_file) = (path(&session)?, path(&rig_file)?);
    let mut guide = Typist { program: guide, show };
    let [home_at, tare_at, acquire_at] = [HOME_AT_S, TARE_AT_S, ACQUIRE_AT_S].map(|at_s| at_s.to_string());
    guide.shown(&["home", "--port", &port, "--at-s", &home_at])?;
    guide.shown(&["tare", "--port", &port, "--at-s", &tare_at])?;
    let acquire =
        ["acquire", "--port", &port, "--at-s", &acquire_at, "--program", PROGRAM, "--rig", rig_file];
    let recording = ["--depth-mm", &depth_mm, "--out", session, "--id", RUN, "--frames-command", &frames];
    guide.shown(&[&acquire[..], &recording].concat())?;
    (guide.show)("(the frames are simulated: a needle in speckle, some without contact or echo)\n\n");
    let start_mm = (1e3 * user_rig.entry_m + SCAN_MARGIN_MM).to_string();
    let frame_options = ["--z-field", "ProbePosition", "--sweep-start-mm", &start_mm];
    guide.shown(&[&["import", "ultrasound", "--run", RUN, "--out", session][..], &frame_options].concat())?;
    let truth = bench.rig().rig(|rig| rig.truth());
    let insertions = bench.rig().rig(|rig| rig.insertions(&user_rig, seed, INSERTIONS))?;
    bench.stop()?;
    guide.shown(&["identify", session])?;
    let elapsed = began.elapsed();
    (guide.show)(
        "(the needle is inserted by hand, and its tip tracked, four times: i1 to i4 of the session)\n\n",
    );
    record(Path::new(session), &user_rig, &insertions)?;
    guide.shown(&["predict", session, "--until", "50", "--compare"])?;
    let predicted = serde_json::from_str(&guide.output(&["predict", session, "--until", "50", "--json"])?)
        .context("guide predict --json printed no JSON")?;
    let identified = serde_json::from_str(&guide.output(&["identify", session, "--json"])?)
        .context("guide identify --json printed no JSON")?;
    let frames_file = Path::new(session).join(format!("{RUN}.frames.json"));
    let imported = fs::read_to_string(&frames_file)
        .with_context(|| format!("{}: cannot read", frames_file.display()))
        .and_then(|text| serde_json::from_str(&text).context("the import's record is no JSON"))?;
    let session = Session::read(Path::new(session))?;
    Ok(Outcome { identified, predicted, session, imported, truth, elapsed })
}

/// Adds the insertions to the session.
fn record(session: &Path, rig: &Rig, insertions: &[InsertionRun]) -> Result<()> {
    let setup = Setup {
        name: String::new(),
        rig: rig.clone(),
        fixture_mass_kg: None,
        noise: Noise::default(),
        tissue: Default::default(),
    };
    let mut writer = SessionWriter::open(session, &setup)?;
    Ok(insertions.iter().try_for_each(|run| writer.insertion(run))?)
}

/// The rig's file, as its user would write it.
fn rig_toml(rig: &Rig) -> String {
    let needle = &rig.needle;
    format!(
        "[needle]\nyoungs_modulus_gpa = {:.1}\nouter_diameter_mm = {:.3}\ninner_diameter_mm = {:.3}\n\n\
         [rig]\nguide2_mm = {:.2}\nentry_mm = {:.2}\n",
        needle.youngs_modulus_pa * 1e-9,
        needle.outer_diameter_m * 1e3,
        needle.inner_diameter_m * 1e3,
        rig.guide2_m * 1e3,
        rig.entry_m * 1e3,
    )
}

/// The command by which `guide acquire` takes a sweep.
fn sweep_command(xtask: &Path, bench: &Bench) -> String {
    format!("'{}' sweep --socket '{}'", xtask.display(), bench.rig().ultrasound().display())
}

/// The command by which `guide acquire` takes the frames of a sweep, which are saved in the session's folder.
fn frames_command(xtask: &Path, bench: &Bench, session: &Path) -> Result<String> {
    let (socket, folder) = (bench.rig().scanner(), session.join("frames"));
    Ok(format!("'{}' frames --socket '{}' --out '{}'", xtask.display(), socket.display(), path(&folder)?))
}

/// The steps of a motion program in which a sweep is taken.
fn sweeps(program: &str) -> Result<Vec<u8>> {
    let steps = (0..).zip(Program::load(program)?.steps);
    Ok(steps.filter(|(_, planned)| planned.sweep).map(|(index, _)| index).collect())
}

/// Path of this program, from the working folder where it lies in it.
pub(crate) fn this_program() -> Result<PathBuf> {
    let path = std::env::current_exe().context("cannot find this program")?;
    let folder = std::env::current_dir().context("cannot find the working folder")?;
    Ok(path.strip_prefix(folder).map(Path::to_owned).unwrap_or(path))
}

fn path(path: &Path) -> Result<&str> {
    path.to_str().with_context(|| format!("{} is not UTF-8", path.display()))
}

/// Types commands and shows what they print.
struct Typist<'a> {
    program: PathBuf,
    show: &'a mut dyn FnMut(&str),
}

impl Typist<'_> {
    fn shown(&mut self, arguments: &[&str]) -> Result<()> {
        self.printed(arguments).map(|_| ())
    }

    /// Shows what a command prints, and returns it.
    fn printed(&mut self, arguments: &[&str]) -> Result<String> {
        self.echo(arguments);
        let printed = self.output(arguments)?;
        (self.show)(&printed);
        (self.show)("\n");
        Ok(printed)
    }

    fn echo(&mut self, arguments: &[&str]) {
        let quoted = arguments.iter().map(|argument| match *argument {
            // Long commands go on in the next line; which they are must not depend on how long paths are.
            "--rig" | "--sweep-command" | "--frames-command" | "--z-field" | "--tip" => {
                format!("\\\n    {argument}")
            }
            text if text.contains(' ') => format!("\"{text}\""),
            text => text.to_owned(),
        });
        (self.show)(&format!("$ guide {}\n", quoted.collect::<Vec<_>>().join(" ")));
    }

    fn output(&self, arguments: &[&str]) -> Result<String> {
        let (running, ended) = mpsc::channel::<()>();
        let output = thread::scope(|scope| {
            scope.spawn(move || {
                let began = Instant::now();
                while ended.recv_timeout(QUIET) == Err(RecvTimeoutError::Timeout) {
                    let command = arguments.first().unwrap_or(&"");
                    eprintln!("(guide {command} has been at work for {} s)", began.elapsed().as_secs());
                }
            });
            let output = Command::new(&self.program).args(arguments).stdin(Stdio::null()).output();
            drop(running);
            output
        })?;
        let stderr = String::from_utf8_lossy(&output.stderr);
        ensure!(output.status.success(), "guide {}: {}", arguments.join(" "), stderr.trim());
        Ok(String::from_utf8_lossy(&output.stdout).into_owned())
    }
}

/// Starts firmware and rig and leaves them to the user until interrupted.
///
/// # Errors
/// Where they cannot be started or the firmware ends.
pub fn rig(args: &RigArgs) -> Result<()> {
    ensure!(args.speed > 0.0, "--speed is {}, expected a positive number", args.speed);
    let config = args.config.as_deref().map_or_else(|| Ok(RigConfig::default()), RigConfig::read)?;
    let bench = match args.fault.as_slice() {
        [] => Bench::start(config, args.seed, args.speed, Duration::MAX)?,
        faults => {
            let bench = Bench::wired(config, args.seed, args.speed, faults.to_vec())?;
            bench.limit(Duration::MAX);
            bench
        }
    };
    println!("port            {}", bench.port());
    println!("sweep command   {}", sweep_command(&this_program()?, &bench));
    println!("needle          {}", needle::command(&this_program()?, &bench.rig().needle(), args.seed));
    println!("the firmware's log follows; Ctrl-C ends it");
    let ended = Arc::new(AtomicBool::new(false));
    ctrlc::set_handler({
        let ended = Arc::clone(&ended);
        move || ended.store(true, Ordering::Release)
    })?;
    let mut shown = 0;
    while bench.runs()? && !ended.load(Ordering::Acquire) {
        let log = bench.log();
        for line in log.iter().skip(shown) {
            println!("{line}");
        }
        shown = log.len();
        thread::sleep(Duration::from_millis(100));
    }
    ensure!(ended.load(Ordering::Acquire), "the firmware ended");
    Ok(())
}
