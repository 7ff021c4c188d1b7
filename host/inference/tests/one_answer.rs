//! One question has one answer, whichever command is asked: the modulus of a session in which nothing is missing.

use diagnose::FoundationChoice;
use worlds::{Design, Truth};

/// The modulus by a diagnosis and by an identification of the same session under the same model, with their intervals.
fn moduli_kpa(design: &Design, tip_load_n: f64, seed: u64) -> [(f64, [f64; 2]); 2] {
    let truth = Truth { k_kpa: 6.0 + seed as f64, tip_load_n, effects: Vec::new(), foreign: None };
    let session = worlds::session(&truth, design, seed);
    let options = diagnose::Options {
        foundation: FoundationChoice::Springs,
        discovery: false,
        ..diagnose::Options::default()
    };
    let diagnosis = diagnose::diagnose(&session, &options, |_| {}).expect("a diagnosis");
    assert_eq!(diagnosis.effects, [], "seed {seed}");
    let identification =
        identify::identify(&session, &identify::Options::default()).expect("an identification");
    let pooled = identification.pooled;
    [(diagnosis.k_kpa, diagnosis.k_ci95_kpa), (pooled.k_kpa, pooled.ci95_kpa)]
}

/// The diagnosis leaves other models in question, so that its interval may be the wider one; insertions, which it has besides, may move K by such a part of the interval.
fn agree(design: &Design, tip_load_n: f64, by_insertions: f64, seeds: impl Iterator<Item = u64>) {
    for seed in seeds {
        let [(diagnosed_kpa, [low_kpa, high_kpa]), (identified_kpa, [least_kpa, most_kpa])] =
            moduli_kpa(design, tip_load_n, seed);
        let moved = (diagnosed_kpa - identified_kpa).abs() / (most_kpa - least_kpa);
        assert!(moved <= by_insertions + 1e-6, "seed {seed}: {diagnosed_kpa} and {identified_kpa} kPa");
        let ratio = (high_kpa - low_kpa) / (most_kpa - least_kpa);
        assert!(
            (0.99 - by_insertions..1.3).contains(&ratio),
            "seed {seed}: {low_kpa} to {high_kpa}, {least_kpa} to {most_kpa} kPa"
        );
    }
}

/// Part of the width of the interval by which insertions, whose modulus is one of their own, may move K.
const BY_INSERTIONS: f64 = 0.05;

#[test]
fn a_diagnosis_has_the_modulus_of_an_identification() {
    agree(&Design::four_runs(), 0.2, 0.0, 1..3);
    agree(&Design::insertions(), 0.2, BY_INSERTIONS, 3..4);
}

#[test]
#[ignore = "a minute: cargo xtask test --all runs it"]
fn twenty_diagnoses_have_the_moduli_of_their_identifications() {
    agree(&Design::four_runs(), 0.2, 0.0, 4..14);
    agree(&Design::insertions(), 0.3, BY_INSERTIONS, 14..24);
}
