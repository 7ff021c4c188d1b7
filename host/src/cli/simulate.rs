//! `guide simulate`: a session from the forward model.

use super::output::Output;
use anyhow::{Context, ensure};
use formats::model_file::ModelFile;
use formats::session::{InsertionRun, LateralRun, SessionWriter, Setup, SteeringRun, Walls};
use inference::walls::BlockResult;
use mechanics::effects::Effect;
use mechanics::unknowns::sensors;
use serde::Serialize;
use simulation::rig::steering::{self, Tissue};
use simulation::simulate::{Sensors, SimulationPlan, SteeringPlan};
use std::collections::BTreeMap;
use std::fmt::{self, Display};
use std::path::{Path, PathBuf};

/// Make a session from the forward model: lateral runs, insertions, steering runs
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide simulate --config plan.toml --out simulated --seed 1\n  guide simulate --config plan.toml --model model.toml \
                  --out simulated\n\nThe file has [needle], [rig] and [noise] of a session. For lateral runs and insertions also\n\n  [tissue]\n  \
                  k_kpa = 12.0         # or foundation = \"body\", youngs_kpa, poisson; body_mm, sides: a block\n  [tip]\n  load_n = 0.2         # optional\n  [[effect]]           # optional; ids and parameters: guide effects\n  \
                  id = \"tissue.layers\"\n  parameters = { k_ratio = { value = 2.0 }, boundary_mm = { value = 15 } }\n\n  [[lateral]]\n  id = \"y20-1\"\n  \
                  depth_mm = 20        # also axis, levels_mm, hold_s, ramp_mm_per_s, rate_hz, sweep_levels, spacing_mm\n\n  [[insertion]]\n  \
                  id = \"i1\"\n  depth_mm = 100       # also speed_mm_per_s, turn_at_mm, step_mm\n\nand for steering runs, with length_mm in [needle] \
                  and fixture_mass_kg in [rig],\n\n  [tissue]\n  layers = [\n    { bottom_mm = 40, stiffness_n_per_m2 = 15000, \
                  damping_n_s_per_m2 = 1000 },\n    { bottom_mm = 80, stiffness_n_per_m2 = 40000, damping_n_s_per_m2 = 2000 },\n  ]\n  \
                  inclusions = [{ depth_mm = 20, width_mm = 3, factor = 1.8 }]\n\n  [[steering]]\n  id = \"s8\"\n  speed_mm_s = 8\n  \
                  straight_mm = 30      # with support; also depth_mm, lateral_mm, wobble_mm, wobble_hz, period_ms, disturbances"
)]
pub struct Args {
    /// TOML file: needle, rig, noise, tissue, runs
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// Take modulus, tip load and effects from a model file where it has them, instead of from the plan
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Session folder to make; runs are added to one that exists
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Seed of the noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Simulated session.
#[derive(Serialize)]
pub struct Made {
    schema: &'static str,
    session: String,
    seed: u64,
    /// Steering runs.
    runs: Vec<One>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    lateral: Vec<Recorded>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    insertion: Vec<Recorded>,
    #[serde(skip_serializing_if = "Option::is_none")]
    truth: Option<Truth>,
}

#[derive(Serialize)]
struct One {
    id: String,
    samples: usize,
    depth_mm: f64,
    /// True value: means over the inserted part.
    mean_stiffness_n_per_m2: f64,
    mean_damping_n_s_per_m2: f64,
}

/// A lateral run or an insertion.
#[derive(Serialize)]
struct Recorded {
    id: String,
    depth_mm: f64,
    samples: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    shape_points: Option<usize>,
}

/// True values of lateral runs and insertions.
#[derive(Serialize)]
struct Truth {
    k_kpa: Option<f64>,
    /// Young's modulus of a body; `None` for springs.
    youngs_kpa: Option<f64>,
    poisson: Option<f64>,
    /// The block that the body is; nothing of a half space.
    block: Option<BlockResult>,
    tip_load_n: f64,
    effects: Vec<TrueEffect>,
}

#[derive(Serialize)]
struct TrueEffect {
    id: &'static str,
    parameters: BTreeMap<&'static str, f64>,
}

/// Runs the sub-command.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    let model = args.model.as_deref().map(ModelFile::read).transpose()?;
    let simulated = make(&args.config, model.as_ref(), &args.out, args.seed)?;
    if !simulated.runs.is_empty() && simulated.truth.as_ref().is_some_and(|truth| !truth.effects.is_empty()) {
        out.note("the effects are those of the lateral runs and insertions: steering runs are without");
    }
    out.result(&simulated, &simulated)
}

/// Makes the session.
pub fn make(config: &Path, model: Option<&ModelFile>, folder: &Path, seed: u64) -> anyhow::Result<Made> {
    let mut setup = Setup::read(config)?;
    let plan = SimulationPlan::read(config, model)?;
    let steering = SteeringPlan::read(config, &setup)?;
    let name = config.display();
    ensure!(
        !steering.runs.is_empty() || !plan.is_empty(),
        "{name}:1:1: lateral, insertion, steering: missing, expected at least one [[lateral]], [[insertion]] or [[steering]]"
    );
    if setup.name.is_empty()
        && let Some(folder_name) = folder.file_name()
    {
        setup.name = folder_name.to_string_lossy().into_owned();
    }
    // The simulated tissue has walls only if they are stated.
    setup.tissue.walls.get_or_insert(Walls::Far);
    let steered = steered(config, &setup, &steering, seed)?;
    let simulated = plan
        .carry_out(&setup.rig, Sensors::new(&setup.noise), seed)
        .with_context(|| format!("{name}: cannot simulate"))?;
    let effects = plan.model.effects();
    let mut session = SessionWriter::open(folder, &setup)?;
    let written =
        simulated.write(&mut session).and_then(|()| steered.iter().try_for_each(|run| session.steering(run)));
    if let Err(error) = written {
        // All of it or nothing, so that the same command works once there is room.
        session.undo();
        return Err(error.into());
    }
    let support = plan.model.support.unwrap_or_default();
    let truth = (!plan.is_empty()).then(|| Truth {
        k_kpa: plan.model.modulus_pa.map(|modulus_pa| modulus_pa / 1e3),
        youngs_kpa: plan.model.youngs_pa.filter(|_| support.is_body()).map(|youngs_pa| youngs_pa / 1e3),
        poisson: support.poisson(),
        block: support.block().map(BlockResult::from),
        tip_load_n: plan.model.tip_load_n.unwrap_or(0.0),
        effects: effects.iter().map(TrueEffect::new).collect(),
    });
    Ok(Made {
        schema: "guide.simulate/1",
        session: folder.display().to_string(),
        seed,
        runs: steered.iter().map(|run| One::new(run, &steering.tissue)).collect(),
        lateral: simulated.lateral.iter().map(Recorded::lateral).collect(),
        insertion: simulated.insertion.iter().map(Recorded::insertion).collect(),
        truth,
    })
}

/// The steering runs, as the sensors see them.
fn steered(config: &Path, setup: &Setup, plan: &SteeringPlan, seed: u64) -> anyhow::Result<Vec<SteeringRun>> {
    if plan.runs.is_empty() {
        return Ok(Vec::new());
    }
    let name = config.display();
    let sensors = steering::Sensors {
        base_m: setup.noise.displacement_m.unwrap_or(sensors::DISPLACEMENT_NOISE.mean()),
        force_n: setup.noise.force_n.unwrap_or(sensors::FORCE_NOISE.mean()),
        tip_m: setup.noise.tip_m.unwrap_or(sensors::TIP_NOISE.mean()),
    };
    let rig = plan.rig(&setup.rig).with_context(|| format!("{name}: cannot simulate"))?;
    (0..)
        .zip(&plan.runs)
        .map(|(number, run)| {
            let truth = rig.carry_out(run).with_context(|| format!("{name}: steering {:?}", run.id))?;
            Ok(truth.measure(sensors, seed, number))
        })
        .collect()
}

impl One {
    fn new(run: &SteeringRun, tissue: &Tissue) -> Self {
        let depth_m = run.depth_m.last().copied().unwrap_or(0.0);
        let [mean_stiffness_n_per_m2, mean_damping_n_s_per_m2] = tissue.mean(depth_m);
        let (id, samples) = (run.id.clone(), run.time_s.len());
        Self { id, samples, depth_mm: 1e3 * depth_m, mean_stiffness_n_per_m2, mean_damping_n_s_per_m2 }
    }
}

impl Recorded {
    fn lateral(run: &LateralRun) -> Self {
        Self {
            id: run.id.clone(),
            depth_mm: 1e3 * run.depth_m,
            samples: run.force.time_s.len(),
            shape_points: Some(run.shape.z_m.len()),
        }
    }

    fn insertion(run: &InsertionRun) -> Self {
        Self {
            id: run.id.clone(),
            depth_mm: 1e3 * run.depth_m.last().copied().unwrap_or(0.0),
            samples: run.depth_m.len(),
            shape_points: None,
        }
    }
}

impl TrueEffect {
    fn new((effect, values): &(&'static dyn Effect, Vec<f64>)) -> Self {
        let parameters = effect.parameters().iter().map(|info| info.name).zip(values.iter().copied());
        Self { id: effect.id(), parameters: parameters.collect() }
    }
}

impl Display for Made {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for Recorded { id, depth_mm, samples, shape_points } in &self.lateral {
            let points = shape_points.unwrap_or_default();
            writeln!(
                f,
                "lateral      {id}: {samples} samples and {points} shape points at {depth_mm:.0} mm"
            )?;
        }
        for Recorded { id, depth_mm, samples, .. } in &self.insertion {
            writeln!(f, "insertion    {id}: {samples} samples to {depth_mm:.0} mm")?;
        }
        for One { id, samples, depth_mm, mean_stiffness_n_per_m2, mean_damping_n_s_per_m2 } in &self.runs {
            writeln!(
                f,
                "run          {id}: {samples} samples to {depth_mm:.0} mm; true means {:.1} kN/m^2, {:.2} kN s/m^2",
                1e-3 * mean_stiffness_n_per_m2,
                1e-3 * mean_damping_n_s_per_m2
            )?;
        }
        if let Some(Truth { k_kpa, youngs_kpa, poisson, block, tip_load_n, effects }) = &self.truth {
            let modulus = match (youngs_kpa, poisson) {
                (Some(youngs_kpa), Some(poisson)) => format!("E {youngs_kpa} kPa, Poisson's ratio {poisson}"),
                _ => format!("K {} kPa", k_kpa.map_or("-".to_owned(), |k_kpa| k_kpa.to_string())),
            };
            writeln!(f, "truth        {modulus}, tip load {tip_load_n} N")?;
            if let Some(block) = block {
                writeln!(f, "truth        {block}")?;
            }
            for TrueEffect { id, parameters } in effects {
                let values: Vec<String> =
                    parameters.iter().map(|(name, value)| format!("{name} {value}")).collect();
                writeln!(f, "truth        {id}: {}", values.join(", "))?;
            }
        }
        writeln!(f, "session      {} (seed {})", self.session, self.seed)
    }
}
