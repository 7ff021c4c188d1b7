//! `cargo xtask study clean`: sessions in which nothing is hidden, over the noise and the sampling that laboratories have.
//!
//! Displacements that scatter by 0 to 0.1 mm, forces by 0.005 to 0.1 N, 20 to 1000 rows a second, all as the session
//! states them. Half of the sessions are those of `guide simulate`, half those of a generator that shares nothing with
//! the forward model. No effect may be named.

use anyhow::Result;
use formats::model_file::ModelFile;
use formats::session::{Noise, Session, Tissue};
use inference::diagnose::{Options, Verdict, diagnose};
use mechanics::{Needle, Rig};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use simulation::simulate::{Axis, LateralPlan, Sensors, SimulationPlan, SweepLevels};
use std::sync::atomic::{AtomicUsize, Ordering};
use worlds::{Background, Design, NoisePlan, Truth, on_all_cores, session_on};

const MM: f64 = 1e-3;
/// Ranges of the standard deviations and of the rate; force and rate are drawn by their logarithms.
const DISPLACEMENT_MM: [f64; 2] = [0.0, 0.1];
const FORCE_N: [f64; 2] = [0.005, 0.1];
const RATE_HZ: [f64; 2] = [20.0, 1000.0];
/// Rows of the table: displacement noise up to these.
const BANDS_MM: [f64; 3] = [0.02, 0.05, 0.1];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Generator {
    Simulate,
    Worlds,
}

impl Generator {
    const ALL: [Self; 2] = [Self::Simulate, Self::Worlds];

    fn name(self) -> &'static str {
        match self {
            Self::Simulate => "guide simulate",
            Self::Worlds => "the independent generator",
        }
    }

    fn session(self, k_kpa: f64, noise: &NoisePlan, seed: u64) -> Result<Session> {
        match self {
            Self::Simulate => simulated(k_kpa, noise, seed),
            Self::Worlds => {
                let truth = Truth { k_kpa, tip_load_n: 0.0, effects: Vec::new(), foreign: None };
                let design = Design { noise: noise.clone(), ..Design::four_runs() };
                Ok(session_on(&truth, &Background::default(), &design, seed))
            }
        }
    }
}

/// A session of `guide simulate`, with the runs of [`Design::four_runs`].
fn simulated(k_kpa: f64, noise: &NoisePlan, seed: u64) -> Result<Session> {
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
    let runs =
        [("y20", 20.0, Axis::Y), ("y30", 30.0, Axis::Y), ("y40", 40.0, Axis::Y), ("x30", 30.0, Axis::X)];
    let lateral = runs.into_iter().chain([("y30b", 30.0, Axis::Y)]).map(|(id, depth_mm, axis)| LateralPlan {
        id: id.to_owned(),
        depth_m: MM * depth_mm,
        axis,
        levels_m: [0.0, 0.4, 0.8, 1.2, 0.8, 0.0, -0.6, -1.2, 0.0].map(|mm| MM * mm).to_vec(),
        hold_s: 3.0,
        ramp_m_per_s: MM,
        rate_hz: noise.rate_hz,
        sweep_levels: SweepLevels::Extremes,
        spacing_m: 0.5 * MM,
    });
    let model = ModelFile { modulus_pa: Some(1e3 * k_kpa), ..ModelFile::default() };
    let plan = SimulationPlan { model, lateral: lateral.collect(), insertion: Vec::new() };
    let stated = Noise {
        force_n: Some(noise.force_n),
        displacement_m: Some(MM * noise.displacement_mm),
        shape_m: Some(MM * noise.shape_mm),
        ..Noise::default()
    };
    let simulated = plan.carry_out(&rig, Sensors::new(&stated), seed)?;
    Ok(Session {
        dir: "simulated".into(),
        name: Some("simulated".to_owned()),
        fixture_mass_kg: None,
        noise: stated,
        tissue: Tissue { walls: Some(formats::session::Walls::Far), ..Tissue::default() },
        lateral: simulated.lateral,
        insertion: Vec::new(),
        indentation: Vec::new(),
        steering: Vec::new(),
        rig,
    })
}

struct Outcome {
    displacement_mm: f64,
    verdict: Verdict,
    holds_k: bool,
    line: String,
}

fn outcome(generator: Generator, number: usize, seed: u64) -> Result<Outcome> {
    let mut random = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(1_000_003).wrapping_add(number as u64));
    let mut uniform = |[low, high]: [f64; 2]| low + (high - low) * random.random::<f64>();
    let k_kpa = uniform([8.0, 20.0]);
    let displacement_mm = uniform(DISPLACEMENT_MM);
    let [force_n, rate_hz] = [FORCE_N, RATE_HZ].map(|range| uniform(range.map(f64::ln)).exp());
    let noise = NoisePlan { displacement_mm, force_n, rate_hz: rate_hz.round(), ..NoisePlan::default() };
    let session = generator.session(k_kpa, &noise, random.random())?;
    let diagnosis = diagnose(&session, &Options::default(), |_| {})?;
    let [low, high] = diagnosis.k_ci95_kpa;
    let named: Vec<String> = diagnosis
        .effects
        .iter()
        .map(|effect| {
            format!(
                "{} (log evidence {:+.1}) [{}]",
                effect.id,
                effect.log_evidence_gain,
                effect.class.join("|")
            )
        })
        .collect();
    Ok(Outcome {
        displacement_mm,
        verdict: diagnosis.verdict,
        holds_k: (low..=high).contains(&k_kpa),
        line: format!(
            "{} #{number}: displacement {displacement_mm:.4} mm, force {force_n:.4} N, {:.0} Hz, K {k_kpa:.2} ({low:.2} to {high:.2}), {:?} {}",
            generator.name(),
            noise.rate_hz,
            diagnosis.verdict,
            named.join(", ")
        ),
    })
}

/// Runs the study: a table, and a line for each session that is not found adequate.
///
/// # Errors
/// Where a session cannot be made or diagnosed.
pub fn run(sessions: usize, seed: u64, only: &str) -> Result<()> {
    println!("| sessions of | displacement noise, mm | sessions | named | unexplained | K held |");
    println!("|---|---|---|---|---|---|");
    for (place, generator) in Generator::ALL.into_iter().enumerate() {
        if !generator.name().contains(only) {
            continue;
        }
        let finished = AtomicUsize::new(0);
        let outcomes = on_all_cores(sessions, |number| {
            let outcome = outcome(generator, number, seed.wrapping_add(7919 * place as u64));
            let finished_count = 1 + finished.fetch_add(1, Ordering::Relaxed);
            match &outcome {
                Ok(one) if one.verdict != Verdict::Adequate => eprintln!("{}", one.line),
                _ if finished_count.is_multiple_of(20) => eprintln!("{finished_count} of {sessions}"),
                _ => {}
            }
            outcome
        });
        let outcomes = outcomes.into_iter().collect::<Result<Vec<Outcome>>>()?;
        let mut least_mm = 0.0;
        for most_mm in BANDS_MM {
            let outcomes_within: Vec<&Outcome> =
                outcomes.iter().filter(|one| (least_mm..most_mm).contains(&one.displacement_mm)).collect();
            let count = |is: &dyn Fn(&Outcome) -> bool| outcomes_within.iter().filter(|one| is(one)).count();
            println!(
                "| {} | {least_mm} to {most_mm} | {} | {} | {} | {} |",
                generator.name(),
                outcomes_within.len(),
                count(&|one| matches!(one.verdict, Verdict::Named | Verdict::Ambiguous)),
                count(&|one| one.verdict == Verdict::Unexplained),
                count(&|one| one.holds_k)
            );
            least_mm = most_mm;
        }
    }
    Ok(())
}
