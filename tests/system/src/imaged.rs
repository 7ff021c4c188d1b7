//! `cargo xtask study images`: K from ultrasound frames beside K from the true shape of the same run, by the program's own commands.
//!
//! Needle, force and displacement are those of the generator that shares no code with the forward model (`worlds`); frames are those of
//! the simulated scanner, with a lag, frames without contact or echo, and echoes elsewhere. Guide 2 rests some micrometres from zero.

mod judged;
mod table;

use crate::images;
use anyhow::{Context, Result, ensure};
use formats::session::{ForceRow, FrameSweep, LateralRun, Session, SessionWriter, Setup, ShapeRow};
use judged::judged;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use simulation::rig::scanner::{Scan, ScannerConfig};
use std::path::{Path, PathBuf};
use std::process::Command;
use table::table;
use worlds::random::uniform;
use worlds::{Design, LateralPlan, NoisePlan, Truth};

const RUN: &str = "d-1";
/// Needle of the generator, and the first and last frame from surface and tip.
const NEEDLE_MM: f64 = 1.27;
const MARGIN_MM: f64 = 0.5;
const STEP_MM: f64 = 0.25;
/// The start of a sweep is stated wrong by this, to see what that does to K.
const START_OFF_MM: f64 = 0.1;
/// Stated standard deviation of the true shape.
const TRUE_SD_M: f64 = 1e-6;

/// Options of `cargo xtask study images`.
#[derive(clap::Args, Debug, Clone)]
pub struct Options {
    /// Runs, each with a sweep along the straight and one along the displaced needle
    #[arg(long, default_value_t = 40)]
    sessions: u64,
    /// Seed of the sessions
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print every run
    #[arg(long)]
    verbose: bool,
    /// Keep frames and sessions of every run in this folder
    #[arg(long, value_name = "DIR")]
    keep: Option<PathBuf>,
}

/// K and its interval, kilopascals.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Modulus {
    k_kpa: f64,
    interval_kpa: [f64; 2],
}

impl Modulus {
    fn holds(&self, k_kpa: f64) -> bool {
        (self.interval_kpa[0]..=self.interval_kpa[1]).contains(&k_kpa)
    }

    /// Distance from this value in standard deviations of `ln K`.
    fn off_sd(&self, k_kpa: f64) -> f64 {
        let [low, high] = self.interval_kpa;
        (self.k_kpa / k_kpa).ln() * 2.0 * formats::NORMAL_975 / (high / low).ln()
    }

    fn width_kpa(&self) -> f64 {
        self.interval_kpa[1] - self.interval_kpa[0]
    }
}

/// One run.
#[derive(Debug, Clone)]
struct Imaged {
    true_kpa: f64,
    of_images: Modulus,
    /// From the true shape, and from a shape as numbers with the generator's errors.
    of_truth: Modulus,
    of_numbers: Modulus,
    /// The same images with the start of the sweep stated wrong.
    of_shifted: Modulus,
    used: usize,
    rejected: usize,
    wrong: usize,
    /// Squared errors of used frames across and along the beam, square millimetres and in standard deviations; a constant is taken off.
    squares: [f64; 2],
    normalised: [f64; 2],
    /// The same of the curve through them, square millimetres.
    of_curve: [f64; 2],
    lag_error_s: f64,
}

/// Runs the study and prints its table.
///
/// # Errors
/// Where the program cannot be built, or a command fails.
pub fn run(options: &Options) -> Result<()> {
    ensure!(
        (1..=10_000).contains(&options.sessions),
        "--sessions is {}, expected 1 to 10000",
        options.sessions
    );
    let guide = images::build_guide()?;
    let mut results = Vec::new();
    for number in 0..options.sessions {
        let passing = tempfile::tempdir()?;
        let folder = match &options.keep {
            Some(kept) => kept.join(number.to_string()),
            None => passing.path().to_owned(),
        };
        std::fs::create_dir_all(&folder).with_context(|| format!("{}: cannot make", folder.display()))?;
        let result = imaged(&guide, &folder, options.seed, number)?;
        if options.verbose {
            println!("{}", line(number, &result));
        }
        results.push(result);
    }
    println!("{}", table(&results));
    Ok(())
}

fn line(number: u64, one: &Imaged) -> String {
    format!(
        "{number}: true {:.2}; images {}; true shape {}; numbers {}; {} used, {} rejected, {} wrong; lag off by {:.4} s",
        one.true_kpa,
        interval_text(&one.of_images),
        interval_text(&one.of_truth),
        interval_text(&one.of_numbers),
        one.used,
        one.rejected,
        one.wrong,
        one.lag_error_s,
    )
}

fn interval_text(modulus: &Modulus) -> String {
    let [low, high] = modulus.interval_kpa;
    format!("{:.2} ({low:.2} to {high:.2})", modulus.k_kpa)
}

/// One run by the commands.
fn imaged(guide: &Path, folder: &Path, seed: u64, number: u64) -> Result<Imaged> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(number);
    let truth =
        Truth { k_kpa: uniform(8.0, 24.0, &mut random), tip_load_n: 0.2, effects: Vec::new(), foreign: None };
    let mut rest_mm = || uniform(-0.015, 0.015, &mut random);
    let levels_mm = vec![rest_mm(), 1.2 + rest_mm(), rest_mm()];
    let depth_mm = uniform(20.0, 40.0, &mut random).round();
    let scanner = ScannerConfig { lag_s: uniform(-0.2, 0.2, &mut random), ..ScannerConfig::default() };
    let drawn: u64 = random.random();
    let plan =
        LateralPlan { id: RUN.to_owned(), depth_mm, axis: 0, levels_mm, hold_s: 3.0, ramp_mm_per_s: 1.0 };
    let noisy =
        Design { lateral: vec![plan], insertion: Vec::new(), noise: NoisePlan::default(), images: None };
    let quiet = Design { noise: noisy.noise.none(), ..noisy.clone() };
    let (noisy, quiet) = (worlds::session(&truth, &noisy, drawn), worlds::session(&truth, &quiet, drawn));
    let (recorded, exact) = (run_of(&noisy)?, run_of(&quiet)?);
    let needle = sweeps_of(exact);
    let [first, second, ..] = needle.as_slice() else { anyhow::bail!("fewer than two sweeps") };

    let entry_mm = 1e3 * noisy.rig.entry_m;
    let session = folder.join("images");
    let mut frames = Vec::new();
    // The generator images a rest before or after the displacement: which of the two is the straight needle is found by the import.
    for (name, (time_s, points)) in [("first", first), ("second", second)] {
        let scan = Scan {
            scanner: scanner.clone(),
            seed: random.random(),
            needle_mm: NEEDLE_MM,
            axis_mm: axis_mm(points, [entry_mm + MARGIN_MM, entry_mm + depth_mm - MARGIN_MM]),
        };
        let path = folder.join(format!("{name}.igs.mha"));
        scan.write(&path).with_context(|| format!("{}: cannot write", path.display()))?;
        frames.push((FrameSweep { time_s: *time_s, frames: path }, scan));
    }
    let of_frames: Vec<FrameSweep> = frames.iter().map(|(sweep, _)| sweep.clone()).collect();
    write(&session, &noisy, recorded, &Shape::Frames(&of_frames))?;
    let (of_truth, of_numbers) = (folder.join("truth"), folder.join("numbers"));
    write(&of_truth, &noisy, recorded, &Shape::Exact(exact))?;
    write(&of_numbers, &noisy, recorded, &Shape::Recorded)?;

    let import = |start_mm: f64| {
        let (start_mm, session) = (format!("{start_mm}"), session.display().to_string());
        let options = ["--z-field", "ProbePosition", "--sweep-start-mm", &start_mm, "--json"];
        json(guide, &[&["import", "ultrasound", "--run", RUN, "--out", &session][..], &options].concat())
    };
    import(entry_mm + MARGIN_MM + START_OFF_MM)?;
    let of_shifted = identified(guide, &session)?;
    let imported = import(entry_mm + MARGIN_MM)?;
    let judged = judged(&imported, &frames)?;
    let sweep = &imported["sweeps"][0];
    let states = [sweep, &imported["straight"]].map(|sweep| &sweep["states"]);
    Ok(Imaged {
        true_kpa: truth.k_kpa,
        of_images: identified(guide, &session)?,
        of_truth: identified(guide, &of_truth)?,
        of_numbers: identified(guide, &of_numbers)?,
        of_shifted,
        used: count_of_states(true, states),
        rejected: count_of_states(false, states),
        wrong: judged.wrong,
        squares: judged.squares,
        normalised: judged.normalised,
        of_curve: judged.of_curve,
        lag_error_s: sweep["lag_s"].as_f64().context("no lag")? - scanner.lag_s,
    })
}

fn count_of_states(is_used: bool, states: [&Value; 2]) -> usize {
    let counts = states.iter().filter_map(|states| states.as_object()).flatten();
    counts
        .filter(|(state, _)| (*state == "used") == is_used)
        .filter_map(|(_, count)| count.as_u64())
        .sum::<u64>() as usize
}

/// The run of a session that has one.
fn run_of(session: &Session) -> Result<&LateralRun> {
    session.lateral.first().context("the generator made no run")
}

/// Sweeps of a run: time, and z, x and y of their points, millimetres.
fn sweeps_of(run: &LateralRun) -> Vec<(f64, Vec<[f64; 3]>)> {
    let shape = &run.shape;
    let mut sweeps: Vec<(f64, Vec<[f64; 3]>)> = Vec::new();
    let times_s = shape.time_s.iter().flatten();
    let x_m = shape.x_m.iter().flatten();
    for (((time_s, z_m), y_m), x_m) in times_s.zip(&shape.z_m).zip(&shape.y_m).zip(x_m) {
        let point = [1e3 * z_m, 1e3 * x_m, 1e3 * y_m];
        match sweeps.last_mut() {
            Some((last_s, points)) if last_s == time_s => points.push(point),
            _ => sweeps.push((*time_s, vec![point])),
        }
    }
    sweeps
}

/// The needle's axis in fine steps.
fn axis_mm(points: &[[f64; 3]], [from_mm, to_mm]: [f64; 2]) -> Vec<[f64; 3]> {
    let steps = ((to_mm - from_mm) / STEP_MM + 1e-9) as usize;
    (0..=steps)
        .map(|step| {
            let z_mm = from_mm + STEP_MM * step as f64;
            let [x_mm, y_mm] = between(points, z_mm);
            [z_mm, x_mm, y_mm]
        })
        .collect()
}

/// x and y at a position: on the line through the two nearest points, beyond the ends too.
fn between(points: &[[f64; 3]], z_mm: f64) -> [f64; 2] {
    let last = points.len().saturating_sub(2);
    let segment = points.partition_point(|point| point[0] <= z_mm).saturating_sub(1).min(last);
    let (Some([a_mm, a_x, a_y]), Some([b_mm, b_x, b_y])) = (points.get(segment), points.get(segment + 1))
    else {
        return [f64::NAN; 2];
    };
    let fraction = (z_mm - a_mm) / (b_mm - a_mm);
    [a_x + fraction * (b_x - a_x), a_y + fraction * (b_y - a_y)]
}

/// Source of a session's shape.
enum Shape<'a> {
    Frames(&'a [FrameSweep]),
    Exact(&'a LateralRun),
    Recorded,
}

/// Writes a session with the recorded force.
fn write(folder: &Path, session: &Session, run: &LateralRun, shape: &Shape<'_>) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot make", folder.display()))?;
    let mut noise = session.noise;
    if matches!(shape, Shape::Exact(_)) {
        noise.shape_m = Some(TRUE_SD_M);
    }
    let setup = Setup {
        name: String::new(),
        rig: session.rig.clone(),
        fixture_mass_kg: None,
        noise,
        tissue: Default::default(),
    };
    let mut writer = SessionWriter::open(folder, &setup)?;
    let mut rows = writer.lateral(RUN, run.depth_m)?;
    let force = &run.force;
    for ((time_s, displacement_y_m), force_y_n) in
        force.time_s.iter().zip(&force.displacement_y_m).zip(&force.force_y_n)
    {
        rows.force(&ForceRow {
            time_s: *time_s,
            displacement_y_m: *displacement_y_m,
            force_y_n: *force_y_n,
            ..ForceRow::default()
        })?;
    }
    let points = match shape {
        Shape::Frames(frames) => {
            for sweep in *frames {
                rows.frames(sweep.clone())?;
            }
            Vec::new()
        }
        Shape::Exact(exact) => sweeps_of(exact),
        Shape::Recorded => sweeps_of(run),
    };
    // Frames are taken of the straight needle and of the first displacement only.
    for (time_s, points) in points.into_iter().take(2) {
        for [z_mm, x_mm, y_mm] in points {
            let [z_m, deflection_x_m, deflection_y_m] = [z_mm, x_mm, y_mm].map(|mm| 1e-3 * mm);
            rows.shape(&ShapeRow { time_s, z_m, deflection_y_m, deflection_x_m, image: None })?;
        }
    }
    Ok(rows.finish()?)
}

/// Modulus that `guide identify` finds by the likelihood.
fn identified(guide: &Path, session: &Path) -> Result<Modulus> {
    let identification = json(guide, &["identify", &session.display().to_string(), "--json"])?;
    Ok(Modulus {
        k_kpa: number_of("k_kpa", &identification)?,
        interval_kpa: [number_of("ci95_kpa/0", &identification)?, number_of("ci95_kpa/1", &identification)?],
    })
}

fn number_of(field: &str, identification: &Value) -> Result<f64> {
    let value = identification.pointer(&format!("/runs/0/methods/likelihood/{field}"));
    value.and_then(Value::as_f64).with_context(|| format!("identify gave no {field}"))
}

fn json(guide: &Path, arguments: &[&str]) -> Result<Value> {
    let output = Command::new(guide).args(arguments).output().context("cannot run guide")?;
    ensure!(output.status.success(), "guide {arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).context("guide printed no JSON")
}
