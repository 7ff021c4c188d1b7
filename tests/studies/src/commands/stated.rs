//! `cargo xtask study stated`: sessions in which one number that is stated of the rig is wrong.
//!
//! An ordinary laboratory, its imperfections with it, measures a plain tissue and states guide 2, the surface or a
//! diameter of the needle beside the truth. The study counts whether the interval of K holds the modulus of the touched
//! tissue, and whether a diagnosis that calls the model adequate states such an interval. The sessions' generator
//! shares nothing with the forward model.

use anyhow::Result;
use formats::session::Session;
use inference::diagnose::{Diagnosis, Verdict, diagnose};
use inference::identify::{self, identify};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use worlds::{Background, Design, Truth, on_all_cores, session_on, touched_modulus};

const MM: f64 = 1e-3;

/// Statement that differs from the truth, and by how many millimetres.
#[derive(Debug, Clone, Copy)]
enum Stated {
    Guide2(f64),
    Surface(f64),
    Diameter(f64),
}

impl Stated {
    const ALL: [Self; 8] = [
        Self::Guide2(0.0),
        Self::Guide2(1.0),
        Self::Guide2(2.0),
        Self::Guide2(5.0),
        Self::Surface(1.0),
        Self::Surface(2.0),
        Self::Surface(5.0),
        Self::Diameter(0.03),
    ];

    fn name(self) -> String {
        match self {
            Self::Guide2(0.0) => "nothing".to_owned(),
            Self::Guide2(mm) => format!("guide 2 by {mm} mm"),
            Self::Surface(mm) => format!("surface by {mm} mm"),
            Self::Diameter(mm) => format!("outer diameter by {mm} mm"),
        }
    }

    /// Effects that are what is wrong.
    fn effect(self) -> &'static [&'static str] {
        match self {
            Self::Guide2(_) => &["rig.guide2_position"],
            Self::Surface(_) => &["rig.surface_position", "sensor.depth_shift", "tissue.entry_gap"],
            Self::Diameter(_) => &["needle.stiffness"],
        }
    }

    fn state(self, session: &mut Session, sign: f64) {
        let rig = &mut session.rig;
        match self {
            Self::Guide2(mm) => rig.guide2_m += sign * mm * MM,
            Self::Surface(mm) => rig.entry_m += sign * mm * MM,
            Self::Diameter(mm) => rig.needle.outer_diameter_m += sign * mm * MM,
        }
        rig.entry_m = rig.entry_m.max(rig.guide2_m);
    }
}

/// Result of one session.
struct Outcome {
    held: [bool; 2],
    width: [f64; 2],
    in_class: bool,
    adequate_and_missed: bool,
    line: String,
}

fn outcome(stated: Stated, number: usize, seed: u64) -> Result<Outcome> {
    let mut random = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(1_000_003).wrapping_add(number as u64));
    let k_kpa = 8.0 * (4.0f64).powf(random.random::<f64>());
    let truth = Truth { k_kpa, tip_load_n: 0.0, effects: Vec::new(), foreign: None };
    let design = Design::four_runs();
    let background = Background::drawn(&truth, &design, random.random());
    let sign = if random.random::<bool>() { 1.0 } else { -1.0 };
    let mut session = session_on(&truth, &background, &design, random.random());
    stated.state(&mut session, sign);
    let k_kpa = k_kpa * touched_modulus(&truth, &background, &design);
    let identification = identify(&session, &identify::Options::default())?;
    let Diagnosis { k_ci95_kpa, verdict, effects, .. } =
        diagnose(&session, &inference::diagnose::Options::default(), |_| {})?;
    let by_identify = identification.pooled.ci95_kpa;
    let coverage = [is_inside(by_identify, k_kpa), is_inside(k_ci95_kpa, k_kpa)];
    let in_class =
        effects.iter().flat_map(|effect| &effect.class).any(|id| stated.effect().contains(&id.as_str()));
    let named: Vec<String> = effects.iter().map(|effect| effect.class.join("|")).collect();
    let widest_assumption = identification.pooled.rests_on.map_or("nothing", |rests| rests.assumption);
    Ok(Outcome {
        held: coverage,
        width: [by_identify, k_ci95_kpa].map(|[low, high]| (high - low) / (high + low)),
        in_class,
        adequate_and_missed: verdict == Verdict::Adequate && !coverage[1],
        line: format!(
            "{} #{number}: K {k_kpa:.2}, identify {:.2} ({:.2} to {:.2}) on {widest_assumption}, diagnose {:.2} to {:.2}, {verdict:?} {}",
            stated.name(),
            identification.pooled.k_kpa,
            by_identify[0],
            by_identify[1],
            k_ci95_kpa[0],
            k_ci95_kpa[1],
            named.join(", ")
        ),
    })
}

fn is_inside([low, high]: [f64; 2], k_kpa: f64) -> bool {
    (low..=high).contains(&k_kpa)
}

/// Runs the study: a table, or one line for each session whose name holds `only`.
///
/// # Errors
/// Where a session cannot be identified or diagnosed.
pub fn run(sessions: usize, seed: u64, only: &str) -> Result<()> {
    println!(
        "| stated beside the truth | K held by identify | by diagnose | half-widths, % | named or in class | adequate, K not held |"
    );
    println!("|---|---|---|---|---|---|");
    for (place, stated) in
        Stated::ALL.into_iter().enumerate().filter(|(_, stated)| stated.name().contains(only))
    {
        let outcomes = on_all_cores(sessions, |number: usize| {
            outcome(stated, number, seed.wrapping_add(7919 * place as u64))
        })
        .into_iter()
        .collect::<Result<Vec<Outcome>>>()?;
        println!(
            "| {} | {} of {sessions} | {} | {:.1}, {:.1} | {} | {} |",
            stated.name(),
            outcomes.iter().filter(|one| one.held[0]).count(),
            outcomes.iter().filter(|one| one.held[1]).count(),
            median_width_percent(0, &outcomes),
            median_width_percent(1, &outcomes),
            outcomes.iter().filter(|one| one.in_class).count(),
            outcomes.iter().filter(|one| one.adequate_and_missed).count()
        );
        if !only.is_empty() {
            outcomes.iter().for_each(|one| eprintln!("{}", one.line));
        }
    }
    Ok(())
}

fn median_width_percent(at: usize, outcomes: &[Outcome]) -> f64 {
    let mut widths: Vec<f64> = outcomes.iter().map(|one| one.width[at]).collect();
    widths.sort_by(f64::total_cmp);
    1e2 * widths.get(widths.len() / 2).copied().unwrap_or(f64::NAN)
}
