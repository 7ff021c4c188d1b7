//! The sequences find nothing, and each gap when its measure is disabled.

use super::*;
use crate::mutation::Mutation;

/// For each measure a sequence that finds that it is disabled: the first one of the seeds from 1 on.
const FOUND_BY: [(Mutation, u64); Mutation::ALL.len()] = [
    (Mutation::AnyCalibration, 127),
    (Mutation::ForgetAtRestart, 1),
    (Mutation::LimitFromTare, 34),
    (Mutation::NoRetreat, 5),
    (Mutation::RampEndsAtOnce, 25),
    (Mutation::AnyDirection, 53),
    (Mutation::OldFramesAct, 63),
    (Mutation::AnyStart, 1),
    (Mutation::CoolingTooShort, 929),
    (Mutation::SilentAfterSaturation, 49),
    (Mutation::RetreatsClimb, 11),
    (Mutation::LargestLoadAlone, 9_709),
    (Mutation::BlindRetreat, 118),
    (Mutation::BlindTurned, 39_192),
    (Mutation::ClearInMotion, 294),
    (Mutation::HastyRetreat, 1_067),
    (Mutation::AnyPulse, 22),
];
/// Sequences that once found a gap, or what must hold stated too narrowly: of coupled axes, whose ways out closed each other; of axes
/// that a retreat led to their other side; of ways out that stayed closed by a load that a tare or a low limit had made, or by one from
/// before a converter was silent; of a load from the tare that the recovery took for one from the calibration's zero; of a way out so
/// short that a retreat passed it, and of one by a calibration of the wrong sign.
const KEPT: [u64; 17] = [
    8_021, 14_697, 21_709, 34_436, 36_035, 38_091, 39_954, 44_880, 70_348, 229_987, 40_088_205, 40_272_395,
    41_049_846, 45_011_577, 45_030_965, 48_023_864, 49_016_517,
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
