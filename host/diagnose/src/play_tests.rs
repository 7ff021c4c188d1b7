//! Distinction of a play, which has memory, from a clearance, which has none: the two are separated by the way back, and are one class if
//! guide 2 only moves away from zero.

use super::*;
use worlds::{Design, Truth, session};

/// Verdict, and named effects with their classes.
fn found(id: &'static str, design: &Design, seed: u64) -> (Verdict, Vec<(String, Vec<String>)>) {
    let truth = Truth { k_kpa: 12.0, tip_load_n: 0.2, effects: vec![(id, vec![0.12])], foreign: None };
    let options = Options { foundation: FoundationChoice::Springs, ..Options::default() };
    let diagnosis = diagnose(&session(&truth, design, seed), &options, |_| {}).expect("a diagnosis");
    let classes = diagnosis.effects.into_iter().map(|effect| (effect.id, effect.class)).collect();
    (diagnosis.verdict, classes)
}

#[test]
fn coming_back_distinguishes_play_from_clearance() {
    for id in ["rig.play", "rig.backlash"] {
        let (verdict, classes) = found(id, &Design::four_runs(), 3);
        assert_eq!(verdict, Verdict::Named, "{classes:?}");
        assert_eq!(classes, [(id.to_owned(), vec![id.to_owned()])]);
    }
}

#[test]
fn play_and_clearance_are_one_class_where_guide_2_only_goes_out() {
    let mut design = Design::four_runs();
    design.lateral.iter_mut().for_each(|plan| plan.levels_mm = vec![0.0, 0.3, 0.6, 0.9, 1.2]);
    for id in ["rig.play", "rig.backlash"] {
        let (verdict, classes) = found(id, &design, 4);
        assert_eq!(verdict, Verdict::Ambiguous, "{classes:?}");
        let [(_, class)] = classes.as_slice() else { panic!("{classes:?}") };
        assert!(["rig.play", "rig.backlash"].iter().all(|one| class.iter().any(|id| id == one)), "{class:?}");
    }
}
