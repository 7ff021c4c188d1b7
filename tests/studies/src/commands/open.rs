//! `cargo xtask study open`: sessions in which something is hidden that no effect of the catalogue is, and sessions that hide nothing.
//!
//! An ordinary laboratory with its imperfections; the generator of its sessions shares nothing with the forward model. A session counts as
//! found where a law or an effect is named, as right where one of the class acts at a site of what is hidden.

use anyhow::Result;
use inference::diagnose::{Diagnosis, Options, Verdict, diagnose};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use worlds::{Background, Design, Foreign, Truth, on_all_cores, session_on, touched_modulus};

/// Prefixes of the ids of the class for which the answer is right.
fn right(foreign: Option<Foreign>) -> &'static [&'static str] {
    match foreign {
        None => &[],
        Some(Foreign::SinusoidalDrift) => &["law.force_y.time", "law.force_x.time"],
        Some(Foreign::StiffInclusion) => &["law.modulus.place", "tissue.layers"],
        Some(Foreign::Damage) => &["law.modulus", "law.guide", "tissue.", "law.force.displacement"],
        Some(Foreign::QuadraticSensor) => &["law.force.force", "law.force.displacement"],
        Some(Foreign::OneSidedTissue) => {
            &["law.modulus", "law.force.displacement", "law.force.force", "law.shape"]
        }
        Some(Foreign::ImageWarp) => {
            &["law.shape_y.place", "law.shape_x.place", "law.shape_position", "law.shape_gain"]
        }
        Some(Foreign::HeldTip) => &["law.tip_support"],
        Some(Foreign::Sleeve) => &["law.guide_turn"],
    }
}

struct Outcome {
    found: bool,
    right: bool,
    held: bool,
    removed: Option<f64>,
    line: String,
}

fn outcome(foreign: Option<Foreign>, number: usize, seed: u64) -> Result<Outcome> {
    let mut random = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(1_000_003).wrapping_add(number as u64));
    let k_kpa = 8.0 * (4.0f64).powf(random.random::<f64>());
    let truth = Truth { k_kpa, tip_load_n: 0.0, effects: Vec::new(), foreign };
    let design = Design::four_runs();
    let background = Background::drawn(&truth, &design, random.random());
    let session = session_on(&truth, &background, &design, random.random());
    let k_kpa = k_kpa * touched_modulus(&truth, &background, &design);
    let Diagnosis { k_ci95_kpa: [low, high], verdict, effects, gap, .. } =
        diagnose(&session, &Options::default(), |_| {})?;
    let is_identified = matches!(verdict, Verdict::Named | Verdict::Ambiguous);
    let classes: Vec<String> = effects
        .iter()
        .map(|effect| {
            format!("{} [{}]", effect.formula.as_deref().unwrap_or(&effect.id), effect.class.join("|"))
        })
        .collect();
    let removed = gap.and_then(|gap| gap.removed);
    let name = foreign.map_or("nothing", Foreign::name);
    Ok(Outcome {
        found: is_identified,
        right: is_identified
            && effects
                .iter()
                .flat_map(|effect| &effect.class)
                .any(|id| right(foreign).iter().any(|start| id.starts_with(start))),
        held: (low..=high).contains(&k_kpa),
        removed,
        line: format!(
            "{name} #{number}: K {k_kpa:.2} ({low:.2} to {high:.2}), {verdict:?} {removed:.2?} {}",
            classes.join(", ")
        ),
    })
}

/// Runs the study: a table, or one line more for each session where `only` names a kind.
///
/// # Errors
/// Where a session cannot be diagnosed.
pub fn run(sessions: usize, seed: u64, only: &str) -> Result<()> {
    println!("| hidden | named | right | K held | removed, median |");
    println!("|---|---|---|---|---|");
    let kinds = std::iter::once(None).chain(Foreign::ALL.map(Some));
    for (place, foreign) in kinds.enumerate() {
        let name = foreign.map_or("nothing", Foreign::name);
        if !name.contains(only) {
            continue;
        }
        let outcomes = on_all_cores(sessions, |number: usize| {
            outcome(foreign, number, seed.wrapping_add(7919 * place as u64))
        })
        .into_iter()
        .collect::<Result<Vec<Outcome>>>()?;
        let mut removed: Vec<f64> = outcomes.iter().filter_map(|one| one.removed).collect();
        removed.sort_by(f64::total_cmp);
        println!(
            "| {name} | {} of {sessions} | {} | {} | {:.2?} |",
            outcomes.iter().filter(|one| one.found).count(),
            outcomes.iter().filter(|one| one.right).count(),
            outcomes.iter().filter(|one| one.held).count(),
            removed.get(removed.len() / 2)
        );
        outcomes
            .iter()
            .filter(|one| !only.is_empty() || one.found != foreign.is_some())
            .for_each(|one| eprintln!("{}", one.line));
    }
    Ok(())
}
