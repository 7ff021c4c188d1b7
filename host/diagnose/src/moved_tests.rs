//! Effects of rig and needle in sessions of insertions alone, in which guide 2 is moved or the needle is turned.

use super::*;
use worlds::{Design, Truth, session};

fn diagnosed(effects: Vec<(&'static str, Vec<f64>)>, seed: u64) -> Diagnosis {
    let truth = Truth { k_kpa: 12.0, tip_load_n: 0.2, effects, foreign: None };
    let options = Options { foundation: FoundationChoice::Springs, ..Options::default() };
    diagnose(&session(&truth, &Design::moved_insertions(), seed), &options, |_| {}).expect("a diagnosis")
}

#[track_caller]
fn assert_in_class(id: &'static str, values: &[f64], seed: u64) {
    let diagnosis = diagnosed(vec![(id, values.to_vec())], seed);
    let [named] = diagnosis.effects.as_slice() else { panic!("{id}: {diagnosis:#?}") };
    assert!(named.class.iter().any(|one| one == id), "{id}: {diagnosis:#?}");
    if named.id == id {
        let infos = mechanics::effects::effect(id).expect("an effect").parameters();
        for (info, value) in infos.iter().zip(values) {
            let Estimate { ci95: [low, high], .. } = named.parameters[info.name];
            // Nearly all true values lie in a range that is twice as wide as the interval.
            let half = 0.5 * (high - low);
            assert!((low - half..=high + half).contains(value), "{id} {}: {low} to {high}", info.name);
        }
    }
}

#[test]
fn a_frame_that_gives_is_found_by_moving_guide_2_in_insertions() {
    assert_in_class("rig.frame_compliance", &[0.3], 1);
}

#[test]
fn backlash_is_found_by_moving_guide_2_in_insertions() {
    assert_in_class("rig.backlash", &[0.2], 1);
}

#[test]
fn a_bent_needle_is_found_by_turning_it_in_insertions() {
    assert_in_class("needle.prebend", &[0.25, 0.1], 1);
}

/// The depth of an event in insertions is known no better than the readings around it, which are means over a millimetre.
#[test]
fn readings_of_insertions_are_a_millimetre_apart() {
    let truth = Truth { k_kpa: 12.0, tip_load_n: 0.2, effects: Vec::new(), foreign: None };
    let session = session(&truth, &Design::moved_insertions(), 1);
    let (runs, _) = runs_of(&session).expect("runs");
    let layout = Layout::new(&session.rig, &runs, Vec::new());
    let spacing_m = layout.spacing_m(0.0433).expect("readings around it");
    assert!((0.5e-3..=1.5e-3).contains(&spacing_m), "{spacing_m}");
    assert_eq!([-0.01, 0.2].map(|depth_m| layout.spacing_m(depth_m)), [None; 2]);
}

/// With one guide at rest and an unknown rear no modulus is identifiable; if the guide moves, it is.
#[test]
fn a_guide_that_rests_is_a_limit() {
    let truth = Truth { k_kpa: 12.0, tip_load_n: 0.2, effects: Vec::new(), foreign: None };
    let resting_diagnosis = |design: Design| {
        let mut session = session(&truth, &design, 1);
        session.rig.guides = mechanics::Guides::One { rear_rotation_n_m_per_rad: [None; 2] };
        session.rig.entry_m -= session.rig.guide2_m;
        session.rig.guide2_m = 0.0;
        let options = Options { foundation: FoundationChoice::Springs, ..Options::default() };
        let diagnosis = diagnose(&session, &options, |_| {}).expect("a diagnosis");
        // Neither the file nor the text has a modulus that is not identified.
        let is_identified = diagnosis.k_status == ModulusStatus::Identified;
        let model = diagnosis.model();
        assert_eq!(
            (model.modulus_pa.is_some(), model.modulus_ci95_pa.is_some()),
            (is_identified, is_identified)
        );
        let text = diagnosis.k_status.modulus_text(diagnosis.k_kpa, diagnosis.k_ci95_kpa);
        assert_eq!(text.starts_with("not identifiable"), !is_identified, "{text}");
        assert_eq!(diagnosis.limits.iter().any(|limit| limit.contains("not identifiable")), !is_identified);
        !is_identified
    };
    let only = |mut design: Design, numbers: [usize; 2]| {
        design.lateral.clear();
        design.insertion = numbers.map(|number| design.insertion[number].clone()).to_vec();
        design
    };
    assert!(resting_diagnosis(only(Design::insertions(), [0, 2])));
    assert!(!resting_diagnosis(only(Design::moved_insertions(), [0, 1])));
}
