//! `cargo xtask study clean`: sessions in which nothing is hidden, over the noise and the sampling that laboratories have.
//!
//! Displacements that scatter by 0 to 0.1 mm, forces by 0.005 to 0.1 N, 20 to 1000 rows a second, all as the session
//! states them. Half of the sessions are those of `guide simulate`, half those of a generator that shares nothing with
//! the forward model. No effect may be named, neither by a session nor by a population of sessions with like noise of the displacement.

use anyhow::Result;
use formats::model_file::ModelFile;
use formats::session::{Labels, Noise, Session, Tissue};
use inference::summarize_session;
use mechanics::{Needle, Rig};
use population::{Options, Summary, analyse};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use simulation::simulate::{Axis, LateralPlan, Sensors, SimulationPlan, SweepLevels};
use std::sync::atomic::{AtomicUsize, Ordering};
use worlds::random::uniform;
use worlds::{Background, Design, NoisePlan, Truth, on_all_cores, session_on};

const MM: f64 = 1e-3;
/// Ranges of the standard deviations and of the rate; force and rate are drawn by their logarithms.
const DISPLACEMENT_MM: [f64; 2] = [0.0, 0.1];
const FORCE_N: [f64; 2] = [0.005, 0.1];
const RATE_HZ: [f64; 2] = [20.0, 1000.0];
/// Sessions of a population, a row of the table.
const POPULATION: usize = 60;
/// An effect that noise of the displacement resembles.
const DELAY: &str = "sensor.delay";

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
    k_kpa: f64,
    record: Summary,
}

impl Outcome {
    fn verdict(&self) -> &str {
        self.record.result.as_ref().map_or("failed", |result| result.verdict.as_str())
    }

    fn holds_k(&self) -> bool {
        self.record.result.as_ref().is_some_and(|result| {
            let [low, high] = result.k_ci95_kpa;
            (low..=high).contains(&self.k_kpa)
        })
    }

    /// Score and information of a delay.
    fn delay(&self) -> [f64; 2] {
        let amplitudes = self.record.result.as_ref().map_or(&[][..], |result| &result.amplitudes);
        let delay = amplitudes.iter().find(|one| one.effect == DELAY);
        delay.map_or([0.0; 2], |one| [one.score, one.information])
    }

    /// Standard deviations by which every parameter of an effect is off its neutral value.
    fn sizes(&self, effect: &str) -> String {
        let amplitudes = self.record.result.as_ref().map_or(&[][..], |result| &result.amplitudes);
        let of_effect = amplitudes.iter().filter(|one| one.effect == effect);
        let sizes = of_effect.map(|one| {
            let place =
                one.at.as_ref().map_or_else(String::new, |(name, value)| format!(" at {name} {value}"));
            format!("{}{place} {:+.2}", one.parameter, one.score / one.information.sqrt())
        });
        sizes.collect::<Vec<_>>().join(", ")
    }

    fn line(&self) -> String {
        let named = self.record.result.iter().flat_map(|result| &result.named);
        let named: Vec<String> = named
            .map(|one| {
                format!("{} (log evidence {:+.1}) [{}]", one.id, one.log_evidence, one.class.join("|"))
            })
            .collect();
        format!("{}: K {:.2}, {} {}", self.record.session, self.k_kpa, self.verdict(), named.join(", "))
    }
}

fn outcome(generator: Generator, number: usize, seed: u64) -> Result<Outcome> {
    let mut random = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(1_000_003).wrapping_add(number as u64));
    let k_kpa = uniform(8.0, 20.0, &mut random);
    let displacement_mm = uniform(DISPLACEMENT_MM[0], DISPLACEMENT_MM[1], &mut random);
    let [force_n, rate_hz] =
        [FORCE_N, RATE_HZ].map(|[low, high]| uniform(low.ln(), high.ln(), &mut random).exp());
    let noise = NoisePlan { displacement_mm, force_n, rate_hz: rate_hz.round(), ..NoisePlan::default() };
    let session = generator.session(k_kpa, &noise, random.random())?;
    let name = format!(
        "{} #{number}, displacement {displacement_mm:.4} mm, force {force_n:.4} N, {:.0} Hz",
        generator.name(),
        noise.rate_hz
    );
    let record = summarize_session(name, &session, &Labels::default(), number as u64);
    Ok(Outcome { displacement_mm, k_kpa, record })
}

/// Runs the study: a table, a line for each session that is not found adequate, and the sizes in every session of what a population names.
///
/// # Errors
/// An error if a session cannot be made, or a population cannot be analysed.
pub fn run(sessions: usize, seed: u64, only: &str) -> Result<()> {
    println!(
        "| sessions of | displacement noise, mm | sessions | named | unexplained | K held | `{DELAY}` of all, ms | named by the population |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for (place, generator) in Generator::ALL.into_iter().enumerate() {
        if !generator.name().contains(only) {
            continue;
        }
        let finished = AtomicUsize::new(0);
        let outcomes = on_all_cores(sessions, |number| {
            let outcome = outcome(generator, number, seed.wrapping_add(7919 * place as u64));
            let finished_count = 1 + finished.fetch_add(1, Ordering::Relaxed);
            match &outcome {
                Ok(one) if one.verdict() != "adequate" => eprintln!("{}", one.line()),
                _ if finished_count.is_multiple_of(20) => eprintln!("{finished_count} of {sessions}"),
                _ => {}
            }
            outcome
        });
        let mut outcomes = outcomes.into_iter().collect::<Result<Vec<Outcome>>>()?;
        outcomes.sort_by(|a, b| a.displacement_mm.total_cmp(&b.displacement_mm));
        for like in outcomes.chunks(POPULATION) {
            println!("| {} | {} |", generator.name(), row(like)?);
        }
    }
    Ok(())
}

/// Sessions of one population.
fn row(like: &[Outcome]) -> Result<String> {
    let [score, information] =
        like.iter().map(Outcome::delay).fold([0.0; 2], |sum, one| [sum[0] + one[0], sum[1] + one[1]]);
    let records: Vec<Summary> = like.iter().map(|one| one.record.clone()).collect();
    let population = analyse(records, &Options::default())?;
    for one in &population.shared_effects {
        like.iter().for_each(|session| {
            eprintln!("{} {}: {}", one.effect, session.record.session, session.sizes(&one.effect))
        });
    }
    let shared =
        population.shared_effects.iter().map(|one| format!("{} p {:.1e}", one.effect, one.p_adjusted));
    let spread = population.spread.iter().map(|one| format!("{} {:?}", one.effect, one.kind));
    let by_population: Vec<String> = shared.chain(spread).collect();
    let named = like.iter().filter(|one| ["named", "ambiguous"].contains(&one.verdict())).count();
    let unexplained = like.iter().filter(|one| ["unexplained", "failed"].contains(&one.verdict())).count();
    Ok([
        format!("{:.3} to {:.3}", noise_mm(like.first()), noise_mm(like.last())),
        like.len().to_string(),
        named.to_string(),
        unexplained.to_string(),
        like.iter().filter(|one| one.holds_k()).count().to_string(),
        format!("{:.2} +- {:.2}", 1e3 * score / information, 1e3 / information.sqrt()),
        if by_population.is_empty() { "nothing".to_owned() } else { by_population.join(", ") },
    ]
    .join(" | "))
}

fn noise_mm(one: Option<&Outcome>) -> f64 {
    one.map_or(0.0, |one| one.displacement_mm)
}
