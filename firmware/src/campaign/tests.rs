//! The sequences find nothing, and each gap when its measure is disabled.

use super::*;
use crate::control::mutation::Mutation;
use std::format;
use std::vec::Vec;

/// More of them: `NEEDLE_GUIDE_CAMPAIGN=SEQUENCES`; `cargo xtask campaign` runs millions.
fn sequences(otherwise: u64) -> u64 {
    std::env::var("NEEDLE_GUIDE_CAMPAIGN").ok().and_then(|count| count.parse().ok()).unwrap_or(otherwise)
}

#[test]
fn no_sequence_of_commands_gets_round_the_limits() {
    let mut tally = Tally::default();
    let mut found = Vec::new();
    for seed in 1..=sequences(30) {
        match run_in_process(seed) {
            Ok(of_one) => tally.add(of_one),
            Err(violation) => found.push(format!("{violation}")),
        }
    }
    std::println!("{tally}");
    assert!(found.is_empty(), "{} of {}:\n{}", found.len(), tally.sequences, found.join("\n"));
}

/// For each measure a sequence that finds that it is disabled.
const FOUND_BY: [(Mutation, u64); 0] = [];

#[test]
fn each_disabled_measure_is_found() {
    for measure in Mutation::ALL {
        let found = (1..=300).find_map(|seed| {
            Mutation::without(measure, || run_in_process(seed).err()).map(|found| (seed, found))
        });
        std::println!("{measure:?}: {found:?}");
    }
}
