//! Sequences that once led round a limit, or into a state that no command ends, on the bench of two springs of 1 N/mm.

use super::*;

/// A bench at home, tared.
fn at_home() -> Bench {
    let mut bench = Bench::new();
    bench.position_um = [0.0; 2];
    bench
}

fn to_y(y_um: i32) -> Step {
    Step::Move { x_um: 0, y_um, speed_um_s: 1_000 }
}

fn ended(bench: &mut Bench, steps: &[Step]) -> Outcome {
    bench.notes.clear();
    bench.run(steps);
    bench.finish()
}

fn force_n(bench: &Bench) -> f32 {
    bench.position_um[1] * 1e-3 + bench.push_n[1]
}

/// After so many periods without drive a guide counts as at rest.
const AT_REST: u32 = crate::axis::STILL_PERIODS as u32 + 1;

/// Sends a calibration in pieces and has it stored.
fn store(bench: &mut Bench, record: &CalibrationRecord) -> Result<(), Refusal> {
    let mut buffer = [0; protocol::MAX_CALIBRATION];
    let bytes = record.encode(&mut buffer);
    for (piece, chunk) in (0..).zip(bytes.chunks(protocol::PIECE_BYTES)) {
        let mut bytes = [0; protocol::PIECE_BYTES];
        bytes[..chunk.len()].copy_from_slice(chunk);
        bench.command(Request::LoadCalibration { piece, bytes })?;
    }
    bench.command(Request::StoreCalibration { length: bytes.len() as u8, crc: record.crc() })
}

/// Starts again as the device does after storing, with what the board has kept.
fn restart(bench: &mut Bench, record: CalibrationRecord) {
    let restored = ControllerState::from_bytes(&bench.controller.retained_state().to_bytes());
    let start = Start { retained: restored, ..Start::ordinary(BOOT + 1) };
    let calibration = Calibration::new(record).expect("it was accepted");
    (bench.controller, bench.connection) = connected(calibration, start);
    bench.next_id = 1;
}

/// Waits for the end of a retreat.
fn retreat(bench: &mut Bench, y_um: i32) -> Result<RetreatOutcome, Refusal> {
    bench.notes.clear();
    bench.command(Request::Retreat { x_um: 0, y_um })?;
    for _ in 0..10_000 {
        let found = bench.notes.iter().find_map(|note| match note {
            OutboundMessage::Event(Event { kind: EventKind::RetreatEnded { outcome }, .. }) => Some(*outcome),
            _ => None,
        });
        if let Some(outcome) = found {
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
    assert!(bench.controller.interlock.latched().is_some(), "the fault still stands");
    assert_eq!(bench.command(Request::Retreat { x_um: 0, y_um: -500 }), Err(Refusal::NotUnderLoad));
    bench.periods(60);
    bench.command(Request::ClearFault).expect("the cause is gone, and the axes are at rest");
    assert_eq!(ended(&mut bench, &[to_y(0)]), Outcome::Completed);
}

/// The trap of a load beyond the range, under hum and noise that single readings cannot be compared in.
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
        // Until it is below the limit for single readings too: `NotUnderLoad`.
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

/// A load that the way to the middle does not take off: something else presses.
#[test]
fn a_load_that_does_not_fall_ends_the_retreat_near_where_it_began() {
    let mut bench = at_home();
    bench.stiffness_n_per_um = 1e-6;
    assert_eq!(ended(&mut bench, &[to_y(3_000)]), Outcome::Completed);
    bench.push_n = [0.0, 4.5];
    bench.periods(100);
    assert_eq!(retreat(&mut bench, -1_000), Ok(RetreatOutcome::ForceNotFalling));
    assert!((2_600.0..2_750.0).contains(&bench.position_um[1]), "{:?}", bench.position_um);
    // It rises towards the middle: from the third on, each try ends where the one before did.
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

/// Coasting of a motor before a retreat is no part of it: counted from before, the load would have risen on its way
/// out.
#[test]
fn a_retreat_sets_out_when_the_guide_is_at_rest() {
    let mut bench = at_home();
    assert_eq!(ended(&mut bench, &[to_y(6_000)]), Outcome::Faulted);
    let load_before_n = force_n(&bench);
    bench.runaway = Some(0.2);
    bench.command(Request::Retreat { x_um: 0, y_um: -1_000 }).expect("it is accepted");
    let rolls = bench.periods(30);
    assert_eq!((rolls.state, rolls.drive), (State::Retreating, Drive::Release));
    assert!(force_n(&bench) > load_before_n + 0.1, "more than a load may rise: {}", force_n(&bench));
    bench.runaway = None;
    assert_eq!(bench.command(Request::Retreat { x_um: 0, y_um: -1_000 }), Err(Refusal::Busy));
    // The filter follows, the axes are at rest, and the load is measured.
    let most = AT_REST + u32::from(crate::retreat::BLOCK_PERIODS) + 60;
    let waited = (0..most).position(|_| matches!(bench.periods(1).drive, Drive::Duty(_)));
    assert!(waited.is_some_and(|waited| waited > 100), "{waited:?}");
    bench.command(Request::Stop).expect("stops");
    bench.periods(AT_REST);
    assert_eq!(retreat(&mut bench, -1_000), Ok(RetreatOutcome::Unloaded), "the way out is open");
}

#[test]
fn a_guide_that_does_not_come_to_rest_is_not_driven_by_a_retreat() {
    let mut bench = at_home();
    assert_eq!(ended(&mut bench, &[to_y(6_000)]), Outcome::Faulted);
    // Back and forth by more than an axis at rest does.
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
    // If no axis has shown that it moves the way it is driven, the middle may lie in the other direction.
    let record = Calibration::nominal_record();
    restart(&mut bench, record);
    bench.periods(100);
    assert_eq!(bench.command(Request::Retreat { x_um: 0, y_um: -500 }), Err(Refusal::OutOfTravel));
    bench.force_fault = None;
    bench.periods(crate::limits::FORCE_READINGS.into());
    bench.command(Request::ClearFault).expect("the cause is gone");
}

#[test]
fn storing_a_calibration_wipes_neither_a_fault_nor_the_heat_of_the_motors() {
    let mut bench = at_home();
    let back_and_forth: std::vec::Vec<_> = (0..60)
        .map(|step| Step::Ramp { x_um: 0, y_um: if step % 2 == 0 { 900 } else { -900 }, duration_ms: 2_000 })
        .collect();
    bench.run(&back_and_forth);
    while bench.controller.interlock.latched().is_none() {
        bench.period(None);
    }
    let hot = Fault::MotorHot;
    assert_eq!(bench.controller.interlock.latched(), Some(hot));
    let record = Calibration::nominal_record();
    assert_eq!(store(&mut bench, &record), Err(Refusal::Faulted { fault: hot }));
    // Any restart goes on with both.
    restart(&mut bench, record.clone());
    assert_eq!(bench.periods(1).state, State::Faulted);
    assert_eq!(bench.command(Request::ClearFault), Err(Refusal::CauseRemains));
    assert!(bench.controller.budgets[1].used() > 0.99);
    // The reported time is the one that it takes.
    let reported_s = u32::from(bench.controller.safety(0).cools_in_s[1]);
    assert!((200..310).contains(&reported_s), "{reported_s} s");
    bench.periods((reported_s - 2) * 1_000);
    assert_eq!(bench.command(Request::ClearFault), Err(Refusal::CauseRemains));
    bench.periods(3_000);
    bench.command(Request::ClearFault).expect("it has cooled");
    store(&mut bench, &record).expect("no fault stands");
    let hold = Step::Hold { duration_ms: 5 };
    bench.command(Request::LoadStep { index: 0, step: hold }).expect("loads");
    let run = Request::Run { steps: 1, crc: program_crc(&[hold]), start_us: 0 };
    assert_eq!(bench.command(run), Err(Refusal::Busy), "it is about to restart");
    restart(&mut bench, record);
    let budget_used = bench.controller.budgets[1].used();
    assert!(budget_used > 0.5, "{budget_used}");
}

#[test]
fn a_fault_that_a_calibration_may_have_caused_accepts_another_one_and_stays_latched() {
    let mut bench = at_home();
    bench.potentiometer_codes = Some([2_048, 4_080]);
    bench.periods(3);
    assert_eq!(bench.controller.interlock.latched(), Some(Fault::Potentiometer));
    let mut record = Calibration::nominal_record();
    record.potentiometers[1].track_codes = [40, 4_090];
    store(&mut bench, &record).expect("the recovery from a wrong track");
    restart(&mut bench, record);
    bench.periods(AT_REST);
    assert_eq!(bench.controller.interlock.latched(), Some(Fault::Potentiometer), "it survives");
    bench.command(Request::ClearFault).expect("the cause is gone");
}

#[test]
fn a_calibration_slipped_by_a_unit_is_refused() {
    let mut bench = at_home();
    let nominal = Calibration::nominal_record();
    for power in [-3, -2, -1, 1, 2, 3] {
        let record = CalibrationRecord {
            force_pn_per_code: nominal
                .force_pn_per_code
                .map(|row| row.map(|pn| (f64::from(pn) * 10_f64.powi(power)) as i32)),
            ..nominal.clone()
        };
        assert_eq!(store(&mut bench, &record), Err(Refusal::CalibrationInvalid), "gains times 1e{power}");
    }
    let record = CalibrationRecord { force_pn_per_code: [[1, 0], [0, 1]], ..nominal };
    assert_eq!(store(&mut bench, &record), Err(Refusal::CalibrationInvalid));
}

#[test]
fn a_position_table_of_the_wrong_sign_is_noticed_within_a_third_of_a_millimetre() {
    for (speed_um_s, distance_um) in [(200, 500), (1_000, 500), (10_000, 8_000)] {
        let mut record = Calibration::nominal_record();
        for table in &mut record.potentiometers {
            (table.rising_um, table.falling_um) =
                (table.rising_um.map(|um| -um), table.falling_um.map(|um| -um));
        }
        let mut bench = at_home();
        restart(&mut bench, record);
        bench.run(&[Step::Move { x_um: distance_um, y_um: 0, speed_um_s }]);
        for _ in 0..5_000 {
            bench.period(None);
        }
        assert_eq!(bench.controller.interlock.latched(), Some(Fault::WrongWay), "{speed_um_s} um/s");
        assert!(bench.position_um[0].abs() < 300.0, "{:?} at {speed_um_s} um/s", bench.position_um);
    }
}

#[test]
fn tares_under_load_do_not_move_the_limit() {
    let mut bench = at_home();
    bench.command(Request::Limits { force_mn: 400, silence_ms: 2_000 }).expect("within the range");
    let (mut y_um, mut most_n) = (0, 0.0_f32);
    for _ in 0..10 {
        y_um += 300;
        let steps = [to_y(y_um), Step::Hold { duration_ms: 300 }, Step::Tare { duration_ms: 200 }];
        bench.notes.clear();
        for (index, step) in steps.iter().enumerate() {
            let _ = bench.command(Request::LoadStep { index: index as u8, step: *step });
        }
        let _ = bench.command(Request::Run { steps: 3, crc: program_crc(&steps), start_us: 0 });
        for _ in 0..3_000 {
            bench.period(None);
            most_n = most_n.max(force_n(&bench));
        }
    }
    assert_eq!(bench.controller.interlock.latched(), Some(Fault::ForceLimit));
    assert!(most_n < 0.45, "{most_n} N at a limit of 0.4 N");
}

#[test]
fn a_tare_far_from_zero_or_on_a_settling_force_is_rejected_and_ends_the_program() {
    let rejected = |bench: &Bench| {
        bench.notes.iter().find_map(|note| match note {
            OutboundMessage::Event(Event { kind: EventKind::TareRejected { problem, .. }, .. }) => {
                Some(*problem)
            }
            _ => None,
        })
    };
    let mut bench = at_home();
    let steps = [to_y(1_300), Step::Hold { duration_ms: 100 }, Step::Tare { duration_ms: 200 }, to_y(0)];
    assert_eq!(ended(&mut bench, &steps), Outcome::TareRejected);
    assert_eq!(rejected(&bench), Some(TareProblem::FarFromZero));
    assert_eq!((bench.controller.force.zero_counts(), bench.periods(1).state), ([0; 2], State::Idle));
    assert!((bench.position_um[1] - 1_300.0).abs() < 60.0, "the steps after it are not run");
    bench.notes.clear();
    assert_eq!(ended(&mut bench, &[to_y(0)]), Outcome::Completed);
    bench.notes.clear();
    bench.run(&[Step::Tare { duration_ms: 500 }]);
    for _ in 0..600 {
        bench.push_n[0] += 0.2e-3;
        bench.period(None);
    }
    assert_eq!(rejected(&bench), Some(TareProblem::Settling));
    assert!(!bench.controller.safety(0).tared);
    assert_eq!(ended(&mut bench, &[Step::Tare { duration_ms: 500 }]), Outcome::Completed);
    assert!(bench.controller.safety(0).tared);
}

#[test]
fn a_ramp_as_the_last_step_rests_within_the_travel() {
    for (y_um, duration_ms) in [(10_000, 1_000), (-10_000, 1_000), (10_000, 1_100), (300, 30)] {
        for last in [true, false] {
            let mut bench = at_home();
            // No needle: nothing holds it back.
            bench.stiffness_n_per_um = 1e-6;
            let mut steps = std::vec![Step::Ramp { x_um: 0, y_um, duration_ms }];
            if !last {
                steps.push(Step::Hold { duration_ms: 400 });
            }
            bench.run(&steps);
            let mut most_um = 0.0_f32;
            for _ in 0..4_000 {
                bench.period(None);
                most_um = most_um.max(bench.position_um[1].abs());
            }
            assert_eq!(bench.controller.interlock.latched(), None);
            let final_um = bench.position_um[1];
            assert!((final_um - y_um as f32).abs() <= REENGAGE_ERROR_UM, "{final_um} for {y_um}");
            let distance_left_um = most_um - y_um.abs() as f32;
            assert!(
                distance_left_um < if last || y_um.abs() > 9_000 { 60.0 } else { 250.0 },
                "{distance_left_um} beyond {y_um}"
            );
        }
    }
}

#[test]
fn a_frame_from_before_never_moves_the_guide_again() {
    let mut bench = at_home();
    let steps = [Step::Hold { duration_ms: 5 }];
    bench.command(Request::LoadStep { index: 0, step: steps[0] }).expect("loads");
    let request = Request::Run { steps: 1, crc: program_crc(&steps), start_us: 0 };
    let run = Command { id: bench.next_id, connection: bench.connection, request };
    bench.next_id += 1;
    bench.answer(run).expect("runs");
    for _ in 0..20 {
        bench.command(Request::Status).expect("answered");
    }
    assert_eq!(bench.answer(run), Err(Refusal::IdUsed));
    // A hello that comes again, and the frame after it.
    bench.answer(Command { id: 0, connection: 0, request: Request::Hello }).expect("always");
    assert_eq!(bench.answer(run), Err(Refusal::IdUsed));
    // The same id with another content.
    let clear = Command { request: Request::ClearFault, ..run };
    assert_eq!(bench.answer(clear), Err(Refusal::IdUsed));
    assert_eq!(
        bench
            .notes
            .iter()
            .filter(|note| {
                matches!(note, OutboundMessage::Event(Event { kind: EventKind::StepStarted { .. }, .. }))
            })
            .count(),
        1
    );
}

#[test]
fn the_constants_of_the_rig_as_designed_are_acknowledged_before_anything_moves() {
    let hold = Step::Hold { duration_ms: 5 };
    let run = Request::Run { steps: 1, crc: program_crc(&[hold]), start_us: 0 };
    let mut bench = at_home();
    let start = Start { origin: Origin::Nominal, ..Start::ordinary(BOOT) };
    (bench.controller, bench.connection) = connected(Calibration::default(), start);
    assert_eq!(bench.periods(1).state, State::Idle);
    bench.command(Request::LoadStep { index: 0, step: hold }).expect("loads");
    assert_eq!(bench.command(run), Err(Refusal::CalibrationNotAcknowledged));
    bench.command(Request::AcknowledgeCalibration).expect("acknowledged");
    bench.command(run).expect("runs");
}

#[test]
fn a_lost_calibration_is_a_fault_until_it_is_acknowledged_or_another_is_stored() {
    let lost = |retained| {
        let mut bench = at_home();
        let start = Start { origin: Origin::Lost, retained, ..Start::ordinary(BOOT) };
        (bench.controller, bench.connection) = connected(Calibration::default(), start);
        assert_eq!(bench.periods(1).state, State::Faulted);
        bench
    };
    let mut bench = lost(None);
    assert_eq!(bench.controller.interlock.latched(), Some(Fault::CalibrationLost));
    assert_eq!(bench.command(Request::ClearFault), Err(Refusal::CauseRemains));
    bench.command(Request::AcknowledgeCalibration).expect("acknowledged");
    assert_eq!(bench.periods(1).state, State::Idle);
    assert_eq!(bench.controller.safety(0).calibration, CalibrationSource::NominalAcknowledged);
    let mut bench = lost(None);
    let record = CalibrationRecord { id: protocol::Text::new("unit-8"), ..Calibration::nominal_record() };
    store(&mut bench, &record).expect("the recovery");
    restart(&mut bench, record);
    assert_eq!(bench.periods(1).state, State::Idle);
    // An earlier one takes its place, which is what it works with, and not in silence.
    let start = Start { origin: Origin::Earlier, ..Start::ordinary(BOOT) };
    (bench.controller, bench.connection) = connected(Calibration::default(), start);
    assert_eq!(bench.periods(1).state, State::Faulted);
    assert_eq!(bench.controller.safety(0).calibration, CalibrationSource::Stored);
    bench.command(Request::AcknowledgeCalibration).expect("acknowledged");
    assert_eq!(bench.periods(1).state, State::Idle);
    // Beside a fault that was latched before: that one is cleared first, and then this one shows.
    let hot = ControllerState { fault: Some(Fault::Stall), ..ControllerState::default() };
    let mut bench = lost(Some(hot));
    assert_eq!(bench.controller.interlock.latched(), Some(Fault::Stall));
    assert_eq!(bench.command(Request::ClearFault), Err(Refusal::CauseRemains));
    bench.command(Request::AcknowledgeCalibration).expect("acknowledged");
    bench.periods(AT_REST);
    bench.command(Request::ClearFault).expect("the cause is gone");
}
