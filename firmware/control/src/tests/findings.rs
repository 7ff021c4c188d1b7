//! Sequences that once circumvented a limit, or led into a state that no command ends, on the bench of two springs of 1 N/mm.

mod retreats;

use super::*;

/// A bench with guide 2 at home.
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

/// Number of periods without drive after which a guide counts as at rest.
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

/// Starts the controller again as the device does after storing, with the state that the board has retained.
fn restart(bench: &mut Bench, record: CalibrationRecord) {
    let restored = ControllerState::from_bytes(&bench.controller.retained_state().to_bytes());
    let start = Start { retained: restored, ..Start::ordinary(BOOT + 1) };
    let calibration = Calibration::new(record).expect("it was accepted");
    (bench.controller, bench.connection) = connected(calibration, start);
    bench.next_id = 1;
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
    // Fault and heat survive any restart.
    restart(&mut bench, record.clone());
    assert_eq!(bench.periods(1).state, State::Faulted);
    assert_eq!(bench.command(Request::ClearFault), Err(Refusal::CauseRemains));
    assert!(bench.controller.budgets[1].used() > 0.99);
    // The reported time is the one that cooling takes.
    let reported_s = u32::from(bench.controller.safety(0).cools_in_s[1]);
    assert!((200..310).contains(&reported_s), "{reported_s} s");
    bench.periods((reported_s - 2) * 1_000);
    assert_eq!(bench.command(Request::ClearFault), Err(Refusal::CauseRemains));
    bench.periods(3_000);
    bench.command(Request::ClearFault).expect("it has cooled");
    store(&mut bench, &record).expect("no fault is latched");
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
fn a_calibration_in_a_wrong_unit_is_refused() {
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
fn a_position_table_of_the_wrong_sign_is_detected_within_a_third_of_a_millimetre() {
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
            // Without a needle no force stops the axis.
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
            let overshoot_um = most_um - y_um.abs() as f32;
            assert!(
                overshoot_um < if last || y_um.abs() > 9_000 { 60.0 } else { 250.0 },
                "{overshoot_um} beyond {y_um}"
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
    // The hello is repeated, and then the old frame.
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
    // If an earlier calibration takes its place, the device works with that one and reports the loss.
    let start = Start { origin: Origin::Earlier, ..Start::ordinary(BOOT) };
    (bench.controller, bench.connection) = connected(Calibration::default(), start);
    assert_eq!(bench.periods(1).state, State::Faulted);
    assert_eq!(bench.controller.safety(0).calibration, CalibrationSource::Stored);
    bench.command(Request::AcknowledgeCalibration).expect("acknowledged");
    assert_eq!(bench.periods(1).state, State::Idle);
    // If another fault was latched before, it can be cleared only when the loss is acknowledged.
    let hot = ControllerState { fault: Some(Fault::Stall), ..ControllerState::default() };
    let mut bench = lost(Some(hot));
    assert_eq!(bench.controller.interlock.latched(), Some(Fault::Stall));
    assert_eq!(bench.command(Request::ClearFault), Err(Refusal::CauseRemains));
    bench.command(Request::AcknowledgeCalibration).expect("acknowledged");
    bench.periods(AT_REST);
    bench.command(Request::ClearFault).expect("the cause is gone");
}
