//! The sequences find nothing, and each gap when its measure is disabled.

use super::*;
use crate::mutation::Mutation;

/// For each measure a sequence that finds that it is disabled: the first one of the seeds from 1 on.
const FOUND_BY: [(Mutation, u64); Mutation::ALL.len()] = [
    (Mutation::AnyCalibration, 141),
    (Mutation::ForgetAtRestart, 1),
    (Mutation::LimitFromTare, 31),
    (Mutation::NoRetreat, 591),
    (Mutation::RampEndsAtOnce, 346),
    (Mutation::AnyDirection, 34),
    (Mutation::OldFramesAct, 59),
    (Mutation::AnyStart, 13),
    (Mutation::CoolingTooShort, 192),
    (Mutation::SilentAfterSaturation, 49),
    (Mutation::RetreatsClimb, 55),
    (Mutation::LargestLoadAlone, 789),
    (Mutation::BlindRetreat, 250),
    (Mutation::BlindTurned, 18_543),
    (Mutation::ClearInMotion, 8_301),
    (Mutation::HastyRetreat, 6_683_484),
    (Mutation::AnyPulse, 22),
];
/// Sequences that once found a gap, or what must hold stated too narrowly.
const KEPT: [u64; 14] = [
    14,
    716,
    1_015,
    1_176,
    1_270,
    2_900,
    4_000,
    4_039,
    5_230,
    500_168_171,
    500_207_963,
    800_067_804,
    6_714_285,
    6_733_877,
];

/// `cargo xtask campaign` runs as many as are requested.
#[test]
fn no_sequence_of_commands_gets_round_the_limits() {
    let mut tally = CampaignCounts::default();
    for seed in (1..=40).chain(KEPT).chain(FOUND_BY.map(|(_, seed)| seed)) {
        tally.add(run_in_process(seed).unwrap_or_else(|violation| panic!("{violation}")));
    }
    std::println!("{tally}");
    assert!(tally.commands > 2_000 && tally.faults > 40 && tally.restarts > 10, "{tally}");
}

#[test]
fn each_disabled_measure_is_found() {
    for (measure, (named, seed)) in Mutation::ALL.into_iter().zip(FOUND_BY) {
        assert_eq!(measure, named);
        let found = Mutation::without(measure, || run_in_process(seed).err());
        let found = found.unwrap_or_else(|| panic!("{measure:?}: sequence {seed} finds nothing"));
        std::println!("{measure:?}: {found}");
    }
}

#[test]
fn a_sequence_depends_on_its_seed_alone() {
    assert_eq!(run_in_process(7), run_in_process(7));
    assert_ne!(run_in_process(7), run_in_process(9));
}
