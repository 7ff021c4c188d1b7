use super::*;
use crate::found_in;
use mechanics::effects::effect;
use worlds::{Design, Truth, session};

fn with_backlash() -> Session {
    let effects = vec![("rig.backlash", vec![0.12])];
    session(&Truth { k_kpa: 12.0, tip_load_n: 0.2, effects, foreign: None }, &Design::four_runs(), 3)
}

#[test]
fn a_trial_is_worth_what_the_search_finds_and_shrinks_what_was_held_out() {
    let session = with_backlash();
    let mut bench = Workbench::new(&session, &Options::default()).expect("a workbench");
    let backlash = effect("rig.backlash").expect("an effect");
    let trial = bench.fit(&[backlash]).expect("a trial");
    let (_, search_result) = found_in(&session);
    let member = search_result.members.first().expect("found");
    assert!(
        (trial.log_evidence_gain - member.gain).abs() < 0.05,
        "{} {}",
        trial.log_evidence_gain,
        member.gain
    );
    let gap = trial.held_out.as_ref().expect("held out");
    assert!(gap.after.chi2_reduced < 0.6 * gap.before.chi2_reduced, "{gap:?}");
    let [learned_before, learned_after] = &trial.learned;
    assert!(
        learned_after.chi2_reduced < 0.6 * learned_before.chi2_reduced,
        "{learned_before:?} {learned_after:?}"
    );
    let size = trial.effects[0].parameters.values().next().expect("a parameter");
    assert!((size.value - 0.12).abs() < 0.04, "{size:?}");
    assert!(trial.points.iter().all(|point| point.noise_sd > 0.0 && point.before.is_finite()));
}

#[test]
fn what_was_tried_before_makes_no_difference() {
    let session = with_backlash();
    let options = Options::default();
    let [backlash, gain] = ["rig.backlash", "sensor.force_gain"].map(|id| effect(id).expect("an effect"));
    let mut first = Workbench::new(&session, &options).expect("a workbench");
    let two_effects = first.fit(&[gain, backlash]).expect("a trial");
    let no_effects = first.fit(&[]).expect("a trial");
    let again = first.fit(&[backlash, gain]).expect("a trial");
    let mut second = Workbench::new(&session, &options).expect("a workbench");
    second.fit(&[gain]).expect("a trial");
    assert_eq!(two_effects, again);
    assert_eq!(two_effects, second.fit(&[backlash, gain, gain]).expect("a trial"));
    assert_eq!(no_effects.log_evidence_gain, 0.0);
    assert_eq!(no_effects.learned[0], no_effects.learned[1]);
    assert!(no_effects.points.iter().all(|point| point.before == point.after));
}

#[test]
fn an_effect_that_the_rig_cannot_have_is_rejected() {
    let session = with_backlash();
    let mut bench = Workbench::new(&session, &Options::default()).expect("a workbench");
    let rear = effect("rig.rear_rotation").expect("an effect");
    assert!(!bench.applicable().iter().any(|one| one.id() == rear.id()));
    assert!(matches!(bench.fit(&[rear]), Err(DiagnoseError::Fit(_))));
}
