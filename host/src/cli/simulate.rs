//! `guide simulate`: a session from the forward model.

use super::output::Output;
use anyhow::{Context, ensure};
use host::rig::steering::{Plan, Sensors, SteeringRig, Tissue};
use host::session::{SessionWriter, Setup};
use serde::{Deserialize, Serialize};
use std::fmt::{self, Display};
use std::fs;
use std::path::PathBuf;

/// Make a session of steering runs from the forward model
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide simulate --config steering.toml --out made-up --seed 1\n\nThe file has [needle] (with length_mm), [rig] (with \
                  fixture_mass_kg) and [noise] of a session, and\n\n  [tissue]\n  layers = [\n    { bottom_mm = 40, stiffness_n_per_m2 = 15000, \
                  damping_n_s_per_m2 = 1000 },\n    { bottom_mm = 80, stiffness_n_per_m2 = 40000, damping_n_s_per_m2 = 2000 },\n  ]\n  \
                  inclusions = [{ depth_mm = 20, width_mm = 3, factor = 1.8 }]\n\n  [[steering]]\n  id = \"s8\"\n  speed_mm_s = 8\n  \
                  straight_mm = 30      # with support; also depth_mm, lateral_mm, wobble_mm, wobble_hz, period_ms, disturbances"
)]
pub struct Args {
    /// TOML file: needle, rig, noise, tissue, runs
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// Session folder to make; runs are added to one that exists
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// What the noise is drawn from
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// What the file has beyond a session's tables.
#[derive(Deserialize)]
struct File {
    tissue: Tissue,
    #[serde(default)]
    steering: Vec<Plan>,
}

/// Noise where the file states none: a stage's motors, a force sensor, an electromagnetic tracker.
const BASE_SD_M: f64 = 0.02e-3;
const FORCE_SD_N: f64 = 0.05;
const TIP_SD_M: f64 = 0.1e-3;

#[derive(Serialize)]
struct Made {
    schema: &'static str,
    session: String,
    seed: u64,
    runs: Vec<One>,
}

#[derive(Serialize)]
struct One {
    id: String,
    samples: usize,
    depth_mm: f64,
    /// What is to be found: means over the inserted part.
    mean_stiffness_n_per_m2: f64,
    mean_damping_n_s_per_m2: f64,
}

/// Runs the sub-command.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    let mut setup = Setup::read(&args.config)?;
    let text = fs::read_to_string(&args.config)
        .with_context(|| format!("{}: cannot read", args.config.display()))?;
    let File { tissue, steering } =
        toml::from_str(&text).with_context(|| args.config.display().to_string())?;
    let name = args.config.display();
    tissue.check().with_context(|| format!("{name}: [tissue]"))?;
    ensure!(!steering.is_empty(), "{name}: steering: missing, expected at least one [[steering]]");
    let length_m = setup.rig.needle.length_m.with_context(|| {
        format!("{name}: [needle] length_mm: missing, expected the length from the fixture to the tip")
    })?;
    let fixture_mass_kg = setup
        .fixture_mass_kg
        .with_context(|| format!("{name}: [rig] fixture_mass_kg: missing, expected 0 to 100 kg"))?;
    let sensors = Sensors {
        base_m: setup.noise.displacement_m.unwrap_or(BASE_SD_M),
        force_n: setup.noise.force_n.unwrap_or(FORCE_SD_N),
        tip_m: setup.noise.tip_m.unwrap_or(TIP_SD_M),
    };
    if setup.name.is_empty()
        && let Some(folder) = args.out.file_name()
    {
        setup.name = folder.to_string_lossy().into_owned();
    }
    let rig = SteeringRig::new(setup.rig.clone(), length_m, fixture_mass_kg, &tissue)?;
    let mut session = SessionWriter::open(&args.out, &setup)?;
    let mut runs = Vec::new();
    for (number, plan) in (0..).zip(&steering) {
        let truth = rig.carry_out(plan).with_context(|| format!("{name}: steering {:?}", plan.id))?;
        let run = truth.measure(sensors, args.seed, number);
        session.steering(&run)?;
        let depth_m = run.depth_m.last().copied().unwrap_or(0.0);
        let [mean_stiffness_n_per_m2, mean_damping_n_s_per_m2] = tissue.mean(depth_m);
        runs.push(One {
            id: run.id,
            samples: run.time_s.len(),
            depth_mm: 1e3 * depth_m,
            mean_stiffness_n_per_m2,
            mean_damping_n_s_per_m2,
        });
    }
    let made =
        Made { schema: "guide.simulate/1", session: args.out.display().to_string(), seed: args.seed, runs };
    out.result(&made, &made)
}

impl Display for Made {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for One { id, samples, depth_mm, mean_stiffness_n_per_m2, mean_damping_n_s_per_m2 } in &self.runs {
            writeln!(
                f,
                "run          {id}: {samples} samples to {depth_mm:.0} mm; true means {:.1} kN/m^2, {:.2} kN s/m^2",
                1e-3 * mean_stiffness_n_per_m2,
                1e-3 * mean_damping_n_s_per_m2
            )?;
        }
        writeln!(f, "session      {} (seed {})", self.session, self.seed)
    }
}
