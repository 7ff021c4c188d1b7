//! Retreats from a load, and their limits.

use super::*;

/// Retreats along y and returns the outcome.
fn retreat(bench: &mut Bench, y_um: i32) -> Result<RetreatOutcome, Refusal> {
    bench.notes.clear();
    bench.command(Request::Retreat { x_um: 0, y_um })?;
    for _ in 0..10_000 {
        let ended = bench.notes.iter().find_map(|note| match note {
            OutboundMessage::Event(Event { kind: EventKind::RetreatEnded { outcome }, .. }) => Some(*outcome),
            _ => None,
        });
        if let Some(outcome) = ended {
            return Ok(outcome);
        }
        assert_eq!(
            bench.period(None).state == State::Retreating,
            bench.controller.executor.phase() == Phase::Retreating
        );
    }
    panic!("the retreat does not end");
}

#[test]
fn a_load_beyond_the_range_is_removed_by_a_retreat_and_by_nothing_else() {
    let mut bench = at_home();
    bench.command(Request::Limits { force_mn: 5_000, silence_ms: 2_000 }).expect("the range itself");
    assert_eq!(ended(&mut bench, &[to_y(6_000)]), Outcome::Faulted);
    assert!(matches!(bench.controller.interlock.latched(), Some(Fault::ForceRange | Fault::ForceLimit)));
    assert!((5.0..5.2).contains(&force_n(&bench)), "{}", force_n(&bench));
    assert_eq!(bench.command(Request::ClearFault), Err(Refusal::CauseRemains));
    assert_eq!(bench.command(Request::Retreat { x_um: 0, y_um: 0 }), Err(Refusal::OutOfRange));
    assert_eq!(bench.command(Request::Retreat { x_um: 0, y_um: -1_001 }), Err(Refusal::OutOfRange));
    // Only towards the middle, whatever the force.
    assert_eq!(bench.command(Request::Retreat { x_um: 0, y_um: 1_000 }), Err(Refusal::OutOfTravel));
    assert_eq!(bench.command(Request::Retreat { x_um: 0, y_um: 1 }), Err(Refusal::OutOfTravel));
    assert_eq!(retreat(&mut bench, -1_000), Ok(RetreatOutcome::Unloaded));
    assert!((4.1..4.3).contains(&force_n(&bench)), "{}", force_n(&bench));
    assert!(bench.controller.interlock.latched().is_some(), "the fault is still latched");
    assert_eq!(bench.command(Request::Retreat { x_um: 0, y_um: -500 }), Err(Refusal::NotUnderLoad));
    bench.periods(60);
    bench.command(Request::ClearFault).expect("the cause is gone, and the axes are at rest");
    assert_eq!(ended(&mut bench, &[to_y(0)]), Outcome::Completed);
}

/// A load beyond the range, with hum and noise in which single readings show no trend.
#[test]
fn hum_and_noise_do_not_keep_a_load_beyond_the_range() {
    for (noise_n, hum_n) in [(0.02, 0.1), (0.015, 0.0), (0.005, 0.05)] {
        let mut bench = at_home();
        (bench.noise_n, bench.hum_n) = (noise_n, hum_n);
        bench.stiffness_n_per_um = 0.6e-3;
        bench.command(Request::Limits { force_mn: 5_000, silence_ms: 2_000 }).expect("the range itself");
        assert_eq!(ended(&mut bench, &[to_y(9_500)]), Outcome::Faulted);
        bench.push_n[1] = 0.4;
        bench.periods(AT_REST);
        // A further retreat is refused with `NotUnderLoad` once single readings are below the limit too.
        let outcomes: std::vec::Vec<_> = (0..4).map_while(|_| retreat(&mut bench, -1_000).ok()).collect();
        let good = [RetreatOutcome::Unloaded, RetreatOutcome::Moved];
        assert!(
            outcomes.iter().all(|outcome| good.contains(outcome)),
            "{outcomes:?} under {noise_n} N, {hum_n} N"
        );
        bench.periods(AT_REST);
        bench.command(Request::ClearFault).expect("the load is below the limit");
    }
}

/// A load that motion towards the middle does not reduce, because something else presses.
#[test]
fn a_load_that_does_not_fall_ends_the_retreat_near_where_it_began() {
    let mut bench = at_home();
    bench.stiffness_n_per_um = 1e-6;
    assert_eq!(ended(&mut bench, &[to_y(3_000)]), Outcome::Completed);
    bench.push_n = [0.0, 4.5];
    bench.periods(100);
    assert_eq!(retreat(&mut bench, -1_000), Ok(RetreatOutcome::ForceNotFalling));
    assert!((2_600.0..2_750.0).contains(&bench.position_um[1]), "{:?}", bench.position_um);
    // If the load rises towards the middle, every retreat from the third on ends where it began.
    let mut bench = at_home();
    bench.stiffness_n_per_um = -1e-3;
    bench.push_n = [0.0, 3.5];
    assert_eq!(ended(&mut bench, &[to_y(2_000)]), Outcome::Completed);
    bench.command(Request::Limits { force_mn: 1_400, silence_ms: 2_000 }).expect("in range");
    bench.periods(10);
    for _ in 0..20 {
        assert_eq!(retreat(&mut bench, -1_000), Ok(RetreatOutcome::ForceNotFalling));
    }
    assert!(bench.position_um[1] > 1_750.0, "{:?}", bench.position_um);
}

/// The coasting of a motor before a retreat is no part of the retreat: a load measured before the coasting would seem to rise.
#[test]
fn a_retreat_moves_once_the_guide_is_at_rest() {
    let mut bench = at_home();
    assert_eq!(ended(&mut bench, &[to_y(6_000)]), Outcome::Faulted);
    let load_before_n = force_n(&bench);
    bench.runaway = Some(0.2);
    bench.command(Request::Retreat { x_um: 0, y_um: -1_000 }).expect("it is accepted");
    let coasting = bench.periods(30);
    assert_eq!((coasting.state, coasting.drive), (State::Retreating, Drive::Release));
    assert!(force_n(&bench) > load_before_n + 0.1, "more than a load may rise: {}", force_n(&bench));
    bench.runaway = None;
    assert_eq!(bench.command(Request::Retreat { x_um: 0, y_um: -1_000 }), Err(Refusal::Busy));
    // The filter settles, the axes count as at rest, and the load is measured.
    let most = AT_REST + u32::from(crate::retreat::BLOCK_PERIODS) + 60;
    let waited = (0..most).position(|_| matches!(bench.periods(1).drive, Drive::Duty(_)));
    assert!(waited.is_some_and(|waited| waited > 100), "{waited:?}");
    bench.command(Request::Stop).expect("stops");
    bench.periods(AT_REST);
    assert_eq!(retreat(&mut bench, -1_000), Ok(RetreatOutcome::Unloaded), "the load falls");
}

/// The outcome is not `ForceNotFalling`, although the load may remain: it may fall in a retreat that leads back to the middle.
#[test]
fn a_guide_that_coasts_past_the_middle_before_a_retreat_has_moved() {
    let mut bench = at_home();
    bench.stiffness_n_per_um = 1e-6;
    assert_eq!(ended(&mut bench, &[to_y(200)]), Outcome::Completed);
    bench.push_n = [0.0, 4.5];
    bench.periods(100);
    assert_eq!(bench.controller.interlock.latched(), Some(Fault::ForceLimit));
    bench.notes.clear();
    bench.command(Request::Retreat { x_um: 0, y_um: -1_000 }).expect("towards the middle");
    bench.runaway = Some(-0.2);
    bench.periods(75);
    bench.runaway = None;
    assert!(bench.position_um[1] < -50.0, "{:?}", bench.position_um);
    bench.periods(500);
    let outcomes = bench.notes.iter().filter_map(|note| match note {
        OutboundMessage::Event(Event { kind: EventKind::RetreatEnded { outcome }, .. }) => Some(*outcome),
        _ => None,
    });
    assert_eq!(outcomes.collect::<std::vec::Vec<_>>(), [RetreatOutcome::Moved]);
}

/// A shorted bridge drives the guide out of its travel, and no requested motion can end that. If there is a load too, a retreat
/// can remove it once the guide is at rest.
#[test]
fn no_retreat_answers_a_motion_out_of_the_travel() {
    let mut bench = at_home();
    bench.stiffness_n_per_um = 1e-6;
    assert_eq!(ended(&mut bench, &[to_y(9_900)]), Outcome::Completed);
    bench.runaway = Some(1.0);
    while bench.controller.interlock.latched().is_none() {
        bench.periods(1);
    }
    assert_eq!(bench.controller.interlock.latched(), Some(Fault::Travel));
    assert_eq!(bench.command(Request::Retreat { x_um: 0, y_um: -1_000 }), Err(Refusal::NotUnderLoad));
    bench.push_n = [0.0, 4.5];
    bench.periods(10);
    assert_eq!(bench.command(Request::Retreat { x_um: 0, y_um: -1_000 }), Err(Refusal::NotUnderLoad));
    bench.runaway = None;
    bench.periods(AT_REST);
    bench.command(Request::Retreat { x_um: 0, y_um: -1_000 }).expect("the load is the only cause to stop");
}

#[test]
fn a_guide_that_does_not_come_to_rest_is_not_driven_by_a_retreat() {
    let mut bench = at_home();
    assert_eq!(ended(&mut bench, &[to_y(6_000)]), Outcome::Faulted);
    // The axis moves back and forth by more than the noise of an axis at rest.
    bench.notes.clear();
    bench.command(Request::Retreat { x_um: 0, y_um: -1_000 }).expect("it is accepted");
    let mut periods = 0;
    while bench.controller.executor.phase() == Phase::Retreating {
        bench.runaway = Some(if periods % 80 < 40 { -0.4 } else { 0.4 });
        assert_eq!(bench.period(None).drive, Drive::Release);
        periods += 1;
    }
    assert!((900..=1_002).contains(&periods), "{periods} periods");
    let ended = bench.notes.iter().any(|note| {
        let stopped = EventKind::RetreatEnded { outcome: RetreatOutcome::Stopped };
        matches!(note, OutboundMessage::Event(Event { kind, .. }) if *kind == stopped)
    });
    assert!(ended, "{:?}", bench.notes);
}

#[test]
fn a_retreat_ends_where_anything_else_is_wrong() {
    let mut bench = at_home();
    assert_eq!(bench.command(Request::Retreat { x_um: 0, y_um: -500 }), Err(Refusal::NotUnderLoad));
    assert_eq!(ended(&mut bench, &[to_y(6_000)]), Outcome::Faulted);
    bench.push_n = [0.0, 0.4];
    bench.emergency_stop = true;
    bench.periods(100);
    assert_eq!(bench.command(Request::Retreat { x_um: 0, y_um: -500 }), Err(Refusal::NotUnderLoad));
    bench.emergency_stop = false;
    bench.command(Request::Retreat { x_um: 0, y_um: -500 }).expect("starts");
    assert!((0..300).any(|_| matches!(bench.periods(1).drive, Drive::Duty(_))));
    assert_eq!(bench.command(Request::Limits { force_mn: 900, silence_ms: 2_000 }), Err(Refusal::Busy));
    bench.emergency_stop = true;
    assert_eq!(bench.periods(1).drive, Drive::Release);
    bench.emergency_stop = false;
    bench.periods(2);
    bench.command(Request::Retreat { x_um: 0, y_um: -500 }).expect("starts");
    bench.periods(50);
    bench.command(Request::Stop).expect("stops");
    assert_eq!(bench.last.as_ref().map(|last| last.drive), Some(Drive::Release));
    assert_eq!(bench.periods(1).state, State::Faulted);
}

#[test]
fn a_saturated_converter_is_unloaded_towards_the_straight_needle_only() {
    let mut bench = at_home();
    assert_eq!(ended(&mut bench, &[to_y(3_000)]), Outcome::Completed);
    bench.force_fault = Some(ForceFault::Saturated { channel: 1 });
    bench.periods(100);
    assert_eq!(bench.controller.interlock.latched(), Some(Fault::ForceRange));
    assert_eq!(bench.command(Request::ClearFault), Err(Refusal::CauseRemains));
    assert_eq!(bench.command(Request::Retreat { x_um: 0, y_um: 500 }), Err(Refusal::OutOfTravel));
    assert_eq!(bench.command(Request::Retreat { x_um: 500, y_um: 0 }), Err(Refusal::OutOfTravel));
    assert_eq!(retreat(&mut bench, -1_000), Ok(RetreatOutcome::Moved));
    assert!((bench.position_um[1] - 2_000.0).abs() < 60.0, "{:?}", bench.position_um);
    // Before an axis has moved in its driven direction, the middle may lie in the other direction.
    let record = Calibration::nominal_record();
    restart(&mut bench, record);
    bench.periods(100);
    assert_eq!(bench.command(Request::Retreat { x_um: 0, y_um: -500 }), Err(Refusal::OutOfTravel));
    bench.force_fault = None;
    bench.periods(crate::limits::FORCE_READINGS.into());
    bench.command(Request::ClearFault).expect("the cause is gone");
}
