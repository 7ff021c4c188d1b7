//! The sequences find nothing, and each gap when its measure is disabled.

use super::*;
use control::mutation::Mutation;

/// For each measure a sequence that finds that it is disabled: the first one of the seeds from 1 on.
const FOUND_BY: [(Mutation, u64); Mutation::ALL.len()] = [
    (Mutation::AnyCalibration, 114),
    (Mutation::ForgetAtRestart, 2),
    (Mutation::LimitFromTare, 2),
    (Mutation::NoRetreat, 1),
    (Mutation::RampEndsAtOnce, 37),
    (Mutation::AnyDirection, 267),
    (Mutation::OldFramesAct, 16),
    (Mutation::AnyStart, 16),
    (Mutation::CoolingTooShort, 1_361),
    (Mutation::TwoInARow, 2_614),
    (Mutation::FalseReadings, 24),
    (Mutation::RetreatsClimb, 7_334),
    (Mutation::BlindRetreat, 27),
    (Mutation::BlindTurned, 2_586),
    (Mutation::ClearInMotion, 100),
    (Mutation::AnyPulse, 53),
];
/// A sequence that once found a gap, in the judge: a potentiometer that stands still hides which way tables of the wrong sign lead.
const KEPT: [u64; 1] = [3_000_408];

/// `cargo xtask sequences` runs as many as are requested.
#[test]
fn no_sequence_of_commands_gets_round_the_limits() {
    let mut tally = CampaignCounts::default();
    for seed in (1..=40).chain(KEPT).chain(FOUND_BY.map(|(_, seed)| seed)) {
        tally.add(run_in_process(seed).unwrap_or_else(|violation| panic!("{violation}")));
    }
    println!("{tally}");
    assert!(tally.commands > 2_000 && tally.faults > 40 && tally.restarts > 10, "{tally}");
}

#[test]
fn each_disabled_measure_is_found() {
    for (measure, (named, seed)) in Mutation::ALL.into_iter().zip(FOUND_BY) {
        assert_eq!(measure, named);
        let violation = Mutation::without(measure, || run_in_process(seed).err());
        let violation = violation.unwrap_or_else(|| panic!("{measure:?}: sequence {seed} finds nothing"));
        println!("{measure:?}: {violation}");
    }
}

#[test]
fn a_sequence_depends_on_its_seed_alone() {
    assert_eq!(run_in_process(7), run_in_process(7));
    assert_ne!(run_in_process(7), run_in_process(9));
}
