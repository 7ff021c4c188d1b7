//! The diagnosis with what is known of the rig against the diagnosis without: the same rig characterised in air, then sessions in tissue
//! with something hidden, or nothing.

use super::{drawn_rig, options};
use anyhow::{Result, ensure};
use inference::diagnose::{Diagnosis, Options, Verdict, characterize, diagnose};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use worlds::{Design, Truth, ids, on_all_cores, session, strengths};

/// A class of more members is no answer.
const MAX_IN_CLASS: usize = 3;
/// Effects that stand for each other, as in the study of the diagnosis.
const FAMILIES: [&[&str]; 3] = [
    &["tissue.layers", "tissue.gradient", "tissue.entry_gap"],
    &["tissue.shear", "needle.axial_load"],
    &["rig.backlash", "rig.play"],
];
/// Share of sessions in which nothing is hidden.
const NOTHING: f64 = 0.3;

/// A diagnosis in short.
#[derive(Debug, Clone, Copy)]
struct Short {
    /// Size of the class in which the hidden effect is; `None` where it is in none of an answer.
    class: Option<usize>,
    /// Something is named that is neither hidden nor of the rig.
    is_false: bool,
    /// Half-width of the modulus' interval over the modulus, and whether it holds the truth.
    half_width: f64,
    held: bool,
}

/// Hidden effects, and the diagnoses without and with the characterized rig.
struct Pair {
    hidden: Option<&'static str>,
    without: Short,
    with: Short,
}

/// Prints a row without and one with.
pub fn run(sessions: usize, seed: u64) -> Result<()> {
    let pairs =
        on_all_cores(sessions, |number| one(seed.wrapping_mul(1_000_003).wrapping_add(number as u64)));
    let pairs: Vec<Pair> = pairs.into_iter().flatten().collect();
    ensure!(!pairs.is_empty(), "no session could be diagnosed");
    println!(
        "| what is known | effect hidden | named in a class of three at most | named alone | wrong name, effect or none hidden | K covered | \
         mean half-width of K |\n|---|---|---|---|---|---|---|"
    );
    for (name, of) in [
        ("nothing of the rig", (|pair| pair.without) as fn(&Pair) -> Short),
        ("the rig in air (`characterized.toml`)", |pair| pair.with),
    ] {
        let hidden: Vec<Short> = pairs.iter().filter(|pair| pair.hidden.is_some()).map(of).collect();
        let summaries: Vec<Short> = pairs.iter().map(of).collect();
        println!(
            "| {name} | {} | {} | {} | {} | {} | {:.1} % |",
            hidden.len(),
            fraction_text(hidden.iter().filter(|one| one.class.is_some()).count(), hidden.len()),
            fraction_text(hidden.iter().filter(|one| one.class == Some(1)).count(), hidden.len()),
            fraction_text(summaries.iter().filter(|one| one.is_false).count(), summaries.len()),
            fraction_text(summaries.iter().filter(|one| one.held).count(), summaries.len()),
            100.0 * summaries.iter().map(|one| one.half_width).sum::<f64>() / summaries.len() as f64
        );
    }
    let classes = pairs.iter().filter_map(|pair| Some((pair.without.class?, pair.with.class?)));
    let (mut smaller, mut equal, mut larger) = (0, 0, 0);
    for (without, with) in classes {
        match with.cmp(&without) {
            std::cmp::Ordering::Less => smaller += 1,
            std::cmp::Ordering::Equal => equal += 1,
            std::cmp::Ordering::Greater => larger += 1,
        }
    }
    println!(
        "\nclasses of what both name: {smaller} smaller, {equal} equal, {larger} larger with the rig known; {} sessions, seed {seed}",
        pairs.len()
    );
    for pair in pairs.iter().filter(|pair| pair.with.class.is_none() && pair.without.class.is_some()) {
        eprintln!("named without only: {:?}", pair.hidden);
    }
    Ok(())
}

fn fraction_text(count: usize, of: usize) -> String {
    format!("{count} of {of} ({:.0} %)", 100.0 * count as f64 / of.max(1) as f64)
}

/// Whether an effect is one that a rig does not have of its own.
fn is_hideable(id: &str) -> bool {
    id.starts_with("tissue.") || id == "needle.axial_load"
}

/// A session with a rig of its own; `None` where it cannot be diagnosed.
fn one(seed: u64) -> Option<Pair> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let rig = drawn_rig(&mut random)?;
    let hidden = if random.random::<f64>() < NOTHING {
        None
    } else {
        let hideable: Vec<&'static str> = ids().filter(|id| is_hideable(id)).collect();
        let id = *hideable.get(random.random_range(0..hideable.len()))?;
        Some((id, strengths(id)?.get(random.random_range(0..3)).cloned()?))
    };
    let k_kpa = random.random_range(8.0..20.0);
    let in_air = session(&truth(rig.clone(), k_kpa), &Design::in_air(), seed);
    let known_rig = characterize(&in_air, &options()).ok()?.model(None);
    let effects = rig.iter().cloned().chain(hidden.clone()).collect();
    let in_tissue = session(&truth(effects, k_kpa), &Design::nine_runs(), seed ^ 1);
    let plain = Options { seed, ..Options::default() };
    let without_rig = diagnose(&in_tissue, &plain, |_| {}).ok()?;
    let with_rig = diagnose(&in_tissue, &plain.with_rig(Some(&known_rig)), |_| {}).ok()?;
    let hidden = hidden.map(|(id, _)| id);
    let rig_ids: Vec<&str> = rig.iter().map(|(id, _)| *id).collect();
    // The modulus of tissue that varies is no single number.
    let short = |found: &Diagnosis| short(found, hidden, &rig_ids, k_kpa);
    Some(Pair { hidden, without: short(&without_rig), with: short(&with_rig) })
}

fn truth(effects: Vec<(&'static str, Vec<f64>)>, k_kpa: f64) -> Truth {
    Truth { k_kpa, tip_load_n: 0.2, effects, foreign: None }
}

fn short(found: &Diagnosis, hidden: Option<&str>, own: &[&str], k_kpa: f64) -> Short {
    let is_named = matches!(found.verdict, Verdict::Named | Verdict::Ambiguous);
    let classes: Vec<&Vec<String>> =
        found.effects.iter().filter(|_| is_named).map(|one| &one.class).collect();
    let hit = |class: &&&Vec<String>| {
        class.len() <= MAX_IN_CLASS
            && hidden.is_some_and(|hidden| class.iter().any(|id| stands_for(id, hidden)))
    };
    let [low, high] = found.k_ci95_kpa;
    Short {
        class: classes.iter().find(hit).map(|class| class.len()),
        is_false: classes.iter().any(|class| !hit(&class) && !is_own(class, own)),
        half_width: 0.5 * (high - low) / found.k_kpa,
        held: (low..=high).contains(&k_kpa),
    }
}

fn is_own(class: &[String], own: &[&str]) -> bool {
    class.iter().any(|id| own.iter().any(|own| stands_for(id, own)))
}

fn stands_for(id: &str, what: &str) -> bool {
    id == what || FAMILIES.iter().any(|family| family.contains(&id) && family.contains(&what))
}
