//! The study of `guide characterize`: rigs in air by the independent generator, each with some of the effects that a rig can have.

use anyhow::{Result, ensure};
use inference::diagnose::{CharacterizeOptions, Standing, characterize};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::collections::BTreeMap;
use worlds::{Design, Truth, on_all_cores, session, strengths};

/// What a rig may have; each has half of them.
const EFFECTS: [&str; 8] = [
    "rig.clamp_compliance",
    "rig.frame_compliance",
    "rig.backlash",
    "rig.play",
    "rig.friction",
    "sensor.force_drift",
    "sensor.crosstalk",
    "sensor.delay",
];
/// Standard deviations of what is stated: a gain after a calibration with weights.
const GAIN_SD: f64 = 0.01;
/// Standard deviation of the needle's stiffness about what is stated.
const STIFFNESS_SD: f64 = 0.05;
/// Half-width of a 95 % interval.
const NORMAL_975: f64 = 1.959_963_984_540_054;

/// What one rig gave of a parameter: error, half-width of the interval, whether it holds the truth.
struct Estimate {
    name: String,
    error: f64,
    half_width: f64,
    held: bool,
    identified: bool,
}

/// Prints a row per parameter.
pub fn run(sessions: usize, seed: u64) -> Result<()> {
    ensure!((1..=100_000).contains(&sessions), "--sessions is {sessions}, expected 1 to 100000");
    let all = on_all_cores(sessions, |number| one(seed.wrapping_mul(1_000_003).wrapping_add(number as u64)));
    let mut rows: BTreeMap<String, Vec<Estimate>> = BTreeMap::new();
    let mut failed = 0;
    for rig in all {
        match rig {
            Some(estimates) => estimates.into_iter().for_each(|one| {
                rows.entry(one.name.clone()).or_default().push(one);
            }),
            None => failed += 1,
        }
    }
    println!(
        "| parameter | rigs | identified | held by its 95 % interval | RMS error | mean half-width | width over that of the RMS error |\n\
         |---|---|---|---|---|---|---|"
    );
    let mut sums = [0; 2];
    for (name, estimates) in &rows {
        let identified: Vec<&Estimate> = estimates.iter().filter(|one| one.identified).collect();
        let count = identified.len().max(1) as f64;
        let held = identified.iter().filter(|one| one.held).count();
        sums = [sums[0] + held, sums[1] + identified.len()];
        let rms = (identified.iter().map(|one| one.error * one.error).sum::<f64>() / count).sqrt();
        let half = identified.iter().map(|one| one.half_width).sum::<f64>() / count;
        println!(
            "| {name} | {} | {} | {:.1} % | {rms:.5} | {half:.5} | {:.2} |",
            estimates.len(),
            identified.len(),
            100.0 * held as f64 / count,
            half / (NORMAL_975 * rms)
        );
    }
    println!(
        "\nall: {} of {} held ({:.1} %), {failed} of {sessions} rigs failed",
        sums[0],
        sums[1],
        100.0 * sums[0] as f64 / sums[1].max(1) as f64
    );
    Ok(())
}

/// A rig; nothing where it cannot be characterised.
fn one(seed: u64) -> Option<Vec<Estimate>> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut effects: Vec<(&'static str, Vec<f64>)> = Vec::new();
    for id in EFFECTS {
        let [weak, _, strong] = strengths(id)?;
        let share: f64 = random.random();
        if random.random::<f64>() < 0.5 {
            effects.push((id, weak.iter().zip(&strong).map(|(a, b)| a + share * (b - a)).collect()));
        }
    }
    let mut normal = |sd: f64| sd * Distribution::<f64>::sample(&StandardNormal, &mut random);
    effects.push(("sensor.force_gain", vec![normal(GAIN_SD)]));
    effects.push(("needle.stiffness", vec![normal(STIFFNESS_SD)]));
    let truth = Truth { k_kpa: 10.0, tip_load_n: 0.2, effects: effects.clone(), foreign: None };
    let options = CharacterizeOptions { force_gain_sd: Some(GAIN_SD), ..CharacterizeOptions::default() };
    let found = characterize(&session(&truth, &Design::in_air(), seed), &options).ok()?;
    let mut before = "";
    let mut index = 0;
    let estimate = |one: &inference::diagnose::CharacterizedParameter| {
        index = if one.effect == before { index + 1 } else { 0 };
        before = one.effect;
        let truth = effects.iter().find(|(id, _)| *id == one.effect);
        let truth = truth.and_then(|(_, values)| values.get(index)).copied().unwrap_or(0.0);
        let [low, high] = one.ci95;
        Estimate {
            name: format!("{} {}", one.effect, one.parameter),
            error: one.value - truth,
            half_width: NORMAL_975 * one.sd,
            held: (low..=high).contains(&truth),
            identified: one.standing != Standing::NotIdentifiable,
        }
    };
    Some(found.parameters.iter().map(estimate).collect())
}
