//! The study of `guide characterize`: rigs in air by the independent generator, each with some of the effects that a rig can have: the
//! coverage of the intervals, and what a diagnosis in tissue gains by them.

mod known;

use anyhow::{Result, ensure};
use formats::NORMAL_975;
use inference::diagnose::{CharacterizeOptions, Standing, characterize};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use worlds::random::normal;
use worlds::{Design, Truth, on_all_cores, session, strengths};

/// Possible effects of a rig; each has half of them.
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
/// Estimates further off than this are printed, standard deviations.
const FAR_SD: f64 = 4.0;

/// Estimate of a parameter from one rig: error, half-width of the interval, whether it holds the
/// truth.
struct Estimate {
    name: String,
    error: f64,
    half_width: f64,
    held: bool,
    identified: bool,
}

/// Prints a row per parameter, and the diagnosis without and with what is known of the rig.
pub fn run(sessions: usize, seed: u64, only: &str) -> Result<()> {
    ensure!((1..=100_000).contains(&sessions), "--sessions is {sessions}, expected 1 to 100000");
    ensure!(["", "intervals", "known"].contains(&only), "--only is {only}, expected intervals or known");
    if only != "known" {
        intervals(sessions, seed);
    }
    if only != "intervals" {
        known::run(sessions, seed)?;
    }
    Ok(())
}

fn intervals(sessions: usize, seed: u64) {
    let rig_estimates =
        on_all_cores(sessions, |number| one(seed.wrapping_mul(1_000_003).wrapping_add(number as u64)));
    let mut rows: BTreeMap<String, Vec<Estimate>> = BTreeMap::new();
    let mut failed = 0;
    for rig in rig_estimates {
        match rig {
            Some(estimates) => estimates.into_iter().for_each(|one| {
                rows.entry(one.name.clone()).or_default().push(one);
            }),
            None => failed += 1,
        }
    }
    println!(
        "| parameter | rigs | identified | covered | RMS error | mean half-width | width over that of the RMS error |\n\
         |---|---|---|---|---|---|---|"
    );
    let mut sums = [0; 2];
    for (name, estimates) in &rows {
        let identified: Vec<&Estimate> = estimates.iter().filter(|one| one.identified).collect();
        let count = identified.len().max(1) as f64;
        let covered_count = identified.iter().filter(|one| one.held).count();
        sums = [sums[0] + covered_count, sums[1] + identified.len()];
        let rms = (identified.iter().map(|one| one.error * one.error).sum::<f64>() / count).sqrt();
        let half = identified.iter().map(|one| one.half_width).sum::<f64>() / count;
        println!(
            "| {name} | {} | {} | {:.1} % | {rms:.5} | {half:.5} | {:.2} |",
            estimates.len(),
            identified.len(),
            100.0 * covered_count as f64 / count,
            half / (NORMAL_975 * rms)
        );
    }
    println!(
        "\nall: {} of {} covered ({:.1} %), {failed} of {sessions} rigs failed",
        sums[0],
        sums[1],
        100.0 * sums[0] as f64 / sums[1].max(1) as f64
    );
}

/// Effects of a rig with their values.
type Effects = Vec<(&'static str, Vec<f64>)>;

/// Effects of a rig.
fn drawn_rig(random: &mut ChaCha8Rng) -> Option<Effects> {
    let mut effects = Effects::new();
    for id in EFFECTS {
        let [weak, _, strong] = strengths(id)?;
        let quantile: f64 = random.random();
        if random.random::<f64>() < 0.5 {
            effects.push((id, weak.iter().zip(&strong).map(|(a, b)| a + quantile * (b - a)).collect()));
        }
    }
    effects.push(("sensor.force_gain", vec![GAIN_SD * normal(random)]));
    effects.push(("needle.stiffness", vec![STIFFNESS_SD * normal(random)]));
    Some(effects)
}

/// Statements about the rig.
fn options() -> CharacterizeOptions {
    CharacterizeOptions { force_gain_sd: Some(GAIN_SD), ..CharacterizeOptions::default() }
}

/// A rig; nothing where it cannot be characterised.
fn one(seed: u64) -> Option<Vec<Estimate>> {
    let effects = drawn_rig(&mut ChaCha8Rng::seed_from_u64(seed))?;
    let truth = Truth { k_kpa: 10.0, tip_load_n: 0.2, effects: effects.clone(), foreign: None };
    let characterization = characterize(&session(&truth, &Design::in_air(), seed), &options()).ok()?;
    let effect_texts = effects.iter().map(|(id, values)| format!("{id} {values:.4?}"));
    let effect_text = effect_texts.collect::<Vec<_>>().join(", ");
    let mut previous_effect = "";
    let mut index = 0;
    Some(
        characterization
            .parameters
            .iter()
            .map(|one| {
                index = if one.effect == previous_effect { index + 1 } else { 0 };
                previous_effect = one.effect;
                let truth = value_of(&effects, one.effect, index);
                let [low, high] = one.ci95;
                let sds = (one.value - truth) / one.sd;
                if sds.abs() > FAR_SD {
                    eprintln!(
                        "{seed}: {} {} {:.5} for {truth:.5}, {sds:+.1} sd; {effect_text}",
                        one.effect, one.parameter, one.value
                    );
                }
                Estimate {
                    name: format!("{} {}", one.effect, one.parameter),
                    error: one.value - truth,
                    half_width: NORMAL_975 * one.sd,
                    held: (low..=high).contains(&truth),
                    identified: one.standing != Standing::NotIdentifiable,
                }
            })
            .collect(),
    )
}

/// A true value in the catalogue's terms: there the crosstalk acts on a drift too, in the generator the drift comes after it.
fn value_of(effects: &Effects, effect: &str, index: usize) -> f64 {
    let crosstalk = raw_value("sensor.crosstalk", 0, effects);
    match effect {
        "sensor.force_drift" => {
            (raw_value(effect, index, effects) - crosstalk * raw_value(effect, 1 - index.min(1), effects))
                / (1.0 - crosstalk * crosstalk)
        }
        _ => raw_value(effect, index, effects),
    }
}

fn raw_value(id: &str, index: usize, effects: &[(&'static str, Vec<f64>)]) -> f64 {
    let values = effects.iter().find(|(own, _)| *own == id).map(|(_, values)| values.as_slice());
    values.and_then(|values| values.get(index)).copied().unwrap_or(0.0)
}
