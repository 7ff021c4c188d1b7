//! The sequences find nothing, and each gap when its measure is disabled.

use super::*;
use crate::mutation::Mutation;

/// For each measure a sequence that finds that it is disabled: the first one of the seeds from 1 on.
const FOUND_BY: [(Mutation, u64); Mutation::ALL.len()] = [
    (Mutation::AnyCalibration, 32),
    (Mutation::ForgetAtRestart, 1),
    (Mutation::LimitFromTare, 34),
    (Mutation::NoRetreat, 5),
    (Mutation::RampEndsAtOnce, 25),
    (Mutation::AnyDirection, 53),
    (Mutation::OldFramesAct, 63),
    (Mutation::AnyStart, 14),
    (Mutation::CoolingTooShort, 1_361),
    (Mutation::TwoInARow, 24_121),
    (Mutation::FalseReadings, 32),
    (Mutation::RetreatsClimb, 459),
    (Mutation::BlindRetreat, 11),
    (Mutation::BlindTurned, 4_421),
    (Mutation::ClearInMotion, 294),
    (Mutation::AnyPulse, 22),
];
/// Sequences that once found a gap: of a tare far from the limit, of an axis near the middle whose sign noise decides, of a load that was
/// measured while a channel failed, and of retreats that are stopped one after the other by tables of the wrong sign.
const KEPT: [u64; 6] = [11, 89, 1_712, 4_118, 4_441, 11_512];

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
