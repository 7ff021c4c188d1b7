//! A zero of the force that nothing in the run measures.

use super::recipe::{K_KPA, Recipe, session};
use super::{identified, on_springs};
use crate::identify;
use modulus::mean_and_sd;
use noise::Noise;

const SESSIONS: usize = 150;

/// Sessions without a hold at zero displacement whose force has a zero that is off by this standard deviation: how many intervals hold
/// the modulus, and what they state on average.
fn covered(zero_sd_n: f64, tared: Option<bool>, stated_zero_n: Option<f64>, seed: u64) -> (usize, f64) {
    let mut noise = Noise::new(seed);
    let (mut covered, mut stated) = (0, Vec::new());
    for _ in 0..SESSIONS {
        let recipe = Recipe {
            levels_mm: vec![1.2],
            force_sd_n: 0.005,
            offset_n: zero_sd_n * noise.normal(),
            ..Recipe::default()
        };
        let mut run = recipe.run("a", &mut noise);
        run.provenance.tared = tared;
        let mut session = session(vec![run]);
        session.noise.force_zero_n = stated_zero_n;
        let pooled = identified(&session).pooled;
        covered += usize::from((pooled.ci95_kpa[0]..=pooled.ci95_kpa[1]).contains(&K_KPA));
        stated.push(pooled.sd_kpa);
    }
    let (mean, _) = mean_and_sd(&stated).expect("many");
    (covered, mean)
}

/// 95 % of 150 are 142.5, with a standard deviation of 2.7.
#[test]
fn a_zero_that_was_not_measured_is_in_the_interval() {
    let (untared, wide) = covered(0.1, Some(false), None, 51);
    let (unstated, as_wide) = covered(0.1, None, None, 52);
    let (tared, narrow) = covered(0.01, Some(true), None, 53);
    let (stated, by_statement) = covered(0.03, None, Some(0.03), 54);
    println!(
        "covered {untared}, {unstated}, {tared}, {stated}; sd {wide:.2}, {as_wide:.2}, {narrow:.2}, {by_statement:.2} kPa"
    );
    for count in [untared, unstated, tared, stated] {
        assert!((133..=150).contains(&count), "{count} of {SESSIONS}");
    }
    assert!(narrow < by_statement && by_statement < wide, "{narrow}, {by_statement}, {wide}");
}

#[test]
fn the_warning_states_the_zero_that_is_assumed_and_what_to_do() {
    let mut noise = Noise::new(55);
    let recipe = Recipe { levels_mm: vec![1.2], ..Recipe::default() };
    let mut warned = |tared: Option<bool>| {
        let mut run = recipe.run("a", &mut noise);
        run.provenance.tared = tared;
        let identification = identify(&session(vec![run]), &on_springs()).expect("identifies");
        identification.runs[0].warnings.iter().find(|line| line.contains("force's zero")).cloned()
    };
    let assumes = |line: Option<String>, parts: [&str; 2]| {
        let line = line.expect("a warning");
        assert!(parts.iter().all(|part| line.contains(part)), "{line}");
    };
    assumes(warned(None), ["standard deviation of 0.1 N", "tared = true"]);
    assumes(warned(Some(false)), ["standard deviation of 0.1 N", "record a hold at zero displacement"]);
    assumes(warned(Some(true)), ["standard deviation of 0.01 N", "after a tare"]);
    let measured = Recipe::default().run("a", &mut noise);
    let identification = identify(&session(vec![measured]), &on_springs()).expect("identifies");
    assert!(
        identification.runs[0].warnings.iter().all(|line| !line.contains("zero")),
        "{:?}",
        identification.runs[0].warnings
    );
}
