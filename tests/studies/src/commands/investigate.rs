//! `cargo xtask study investigate`: runs until what is hidden has its name, chosen by what they tell against a standard programme.
//!
//! An ordinary laboratory, its imperfections with it, measures tissue that hides one effect of the blind study. `guide investigate` chooses its runs
//! one by one; the standard programme goes through three depths and both axes and begins again. Both end with the first verdict that has one
//! name, or after as many runs as are allowed. The sessions' generator shares nothing with the forward model.

use anyhow::{Context, Result, ensure};
use formats::session::Session;
use inference::diagnose::{Diagnosis, Options, Verdict, diagnose};
use inference::investigate::{Bounds, Decision, End, Goal, Menu, PlannedRun, decide};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use simulation::simulate::Axis;
use worlds::{
    Background, Design, LateralPlan, Truth, ids, on_all_cores, session_on, strengths, touched_modulus,
};

const MM: f64 = 1e-3;
/// Runs of an investigation.
const MAX_RUNS: usize = 12;
/// Largest force of a run, N.
const FORCE_LIMIT_N: f64 = 4.0;
/// Depths of both, mm, and the order of the standard programme.
const DEPTHS_MM: [f64; 3] = [20.0, 30.0, 40.0];
const STANDARD: [(f64, Axis); 6] =
    [(30.0, Axis::Y), (30.0, Axis::X), (20.0, Axis::Y), (20.0, Axis::X), (40.0, Axis::Y), (40.0, Axis::X)];

/// A laboratory with something hidden in it.
struct Laboratory {
    truth: Truth,
    background: Background,
    noise_seed: u64,
}

/// Result of a programme.
struct Ended {
    runs: usize,
    minutes: f64,
    end: End,
    /// Classes that are named.
    named: Vec<Vec<String>>,
    k_is_held: bool,
    /// Half-width of the interval of K over its middle.
    width: f64,
}

impl Laboratory {
    fn drawn(seed: u64) -> Result<Self> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let lateral: Vec<&'static str> = ids().filter(|id| !id.starts_with("tip.")).collect();
        let id = lateral[random.random_range(0..lateral.len())];
        let values = strengths(id).context("an effect has strengths")?;
        let [_, middle, strong] = values;
        let values = if random.random::<bool>() { middle } else { strong };
        let k_kpa = 8.0 * 4.0f64.powf(random.random::<f64>());
        let truth = Truth { k_kpa, tip_load_n: 0.0, effects: vec![(id, values)], foreign: None };
        let background = Background::drawn(&truth, &Design::four_runs(), random.random());
        Ok(Self { truth, background, noise_seed: random.random() })
    }

    fn hidden(&self) -> &'static str {
        self.truth.effects.first().map_or("", |(id, _)| id)
    }

    fn measured(&self, runs: &[PlannedRun]) -> (Session, Design) {
        let lateral = runs.iter().map(|PlannedRun { plan, .. }| LateralPlan {
            id: plan.id.clone(),
            depth_mm: plan.depth_m / MM,
            axis: usize::from(plan.axis == Axis::X),
            levels_mm: plan.levels_m.iter().map(|level_m| level_m / MM).collect(),
            hold_s: plan.hold_s,
            ramp_mm_per_s: plan.ramp_m_per_s / MM,
        });
        let design = Design { lateral: lateral.collect(), insertion: Vec::new(), ..Design::four_runs() };
        (session_on(&self.truth, &self.background, &design, self.noise_seed), design)
    }

    fn ended(&self, runs: &[PlannedRun], found: &Diagnosis, end: End) -> Ended {
        let (_, design) = self.measured(&runs[..1]);
        let k_kpa = self.truth.k_kpa * touched_modulus(&self.truth, &self.background, &design);
        let [low, high] = found.k_ci95_kpa;
        let means = found.mean_modulus.map(|mean| mean.modulus_kpa.ci95).unwrap_or([low, high]);
        Ended {
            runs: runs.len(),
            minutes: runs.iter().map(|run| run.minutes).sum(),
            end,
            named: found.effects.iter().map(|effect| effect.class.clone()).collect(),
            k_is_held: [[low, high], means].iter().any(|[low, high]| (*low..=*high).contains(&k_kpa)),
            width: (high - low) / (high + low),
        }
    }

    fn investigated(&self) -> Result<Ended> {
        let mut runs: Vec<PlannedRun> = Vec::new();
        loop {
            let session = (!runs.is_empty()).then(|| self.measured(&runs).0);
            let menu = Menu::new(session.as_ref(), &DEPTHS_MM, None);
            let Some(session) = session else {
                runs.push(menu.first().context("a first run")?);
                continue;
            };
            let planned = menu.runs(Some(&session));
            let plans = planned.iter().map(|run| run.plan.clone()).collect();
            let mut diagnosis = diagnose(&session, &Options { plans, ..Options::default() }, |_| {})?;
            let prospects = diagnosis.prospects.take().context("prospects")?;
            let runs_left = (MAX_RUNS - runs.len()) as u32;
            let bounds = Bounds { runs_left, force_limit_n: FORCE_LIMIT_N };
            match decide(Goal::Name, &diagnosis, &prospects, planned, bounds) {
                Decision::Stop(end) => return Ok(self.ended(&runs, &diagnosis, end)),
                Decision::Measure(choice) => runs.push(choice.run),
            }
        }
    }

    fn standard(&self) -> Result<Ended> {
        let mut runs: Vec<PlannedRun> = Vec::new();
        loop {
            let session = (!runs.is_empty()).then(|| self.measured(&runs).0);
            if let Some(session) = &session {
                let diagnosis = diagnose(session, &Options::default(), |_| {})?;
                if diagnosis.verdict == Verdict::Named {
                    return Ok(self.ended(&runs, &diagnosis, End::Named));
                }
                if runs.len() == MAX_RUNS {
                    return Ok(self.ended(&runs, &diagnosis, End::MaxRuns));
                }
            }
            let (depth_mm, axis) = STANDARD[runs.len() % STANDARD.len()];
            let menu = Menu::new(session.as_ref(), &DEPTHS_MM, None).runs(session.as_ref());
            runs.push(
                menu.into_iter()
                    .find(|run| is_next(run, axis, depth_mm))
                    .context("a run of the programme")?,
            );
        }
    }
}

fn is_next(run: &PlannedRun, axis: Axis, depth_mm: f64) -> bool {
    run.plan.axis == axis && (run.plan.depth_m / MM - depth_mm).abs() < 0.5
}

/// Runs the study.
///
/// # Errors
/// Where a session cannot be diagnosed.
pub fn run(sessions: usize, seed: u64, verbose: bool) -> Result<()> {
    ensure!(sessions > 0, "--sessions 0: expected 1 or more");
    let results = on_all_cores(sessions, |number| {
        let laboratory = Laboratory::drawn(seed.wrapping_mul(1_000_003).wrapping_add(number as u64))?;
        Ok((laboratory.hidden(), [laboratory.investigated()?, laboratory.standard()?]))
    })
    .into_iter()
    .collect::<Result<Vec<_>>>()?;
    if verbose {
        for (number, (hidden, ends)) in results.iter().enumerate() {
            eprintln!("#{number} {hidden}: {}; standard {}", line(&ends[0]), line(&ends[1]));
        }
    }
    println!(
        "| programme | right name | in the class | another name | nothing named | runs, median | minutes, median | K held | half-width of K, median |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for (place, name) in ["chosen by what it tells", "standard"].into_iter().enumerate() {
        let ends: Vec<(&str, &Ended)> =
            results.iter().map(|(hidden, ends)| (*hidden, &ends[place])).collect();
        println!(
            "| {name} | {} of {sessions} | {} | {} | {} | {:.0} | {:.0} | {} | {:.1} % |",
            ends.iter().filter(|(id, end)| is_right(id, end)).count(),
            ends.iter().filter(|(id, end)| names_effect(id, end) && !is_right(id, end)).count(),
            ends.iter().filter(|(id, end)| !end.named.is_empty() && !names_effect(id, end)).count(),
            ends.iter().filter(|(_, end)| end.named.is_empty()).count(),
            median_of(&|end| end.runs as f64, &ends),
            median_of(&|end| end.minutes, &ends),
            ends.iter().filter(|(_, end)| end.k_is_held).count(),
            median_of(&|end| 1e2 * end.width, &ends)
        );
    }
    Ok(())
}

fn median_of(of: &dyn Fn(&Ended) -> f64, ends: &[(&str, &Ended)]) -> f64 {
    let mut values: Vec<f64> = ends.iter().map(|(_, end)| of(end)).collect();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn names_effect(id: &str, end: &Ended) -> bool {
    end.named.iter().any(|class| class.iter().any(|one| one == id))
}

fn is_right(id: &str, end: &Ended) -> bool {
    end.named == [[id.to_owned()]]
}

fn line(one: &Ended) -> String {
    format!("{:?} after {} runs, {:.0} min: {:?}", one.end, one.runs, one.minutes, one.named)
}
