//! Every fault from its cause: the time until it is latched, no drive from then on, and the conditions to clear it.

use super::*;
use crate::limits::{DOUBTFUL_READINGS, EVIDENCE_READINGS, FORCE_READINGS};
use crate::motor::{COOLED_SHARE, ON_LIMIT_PERIODS, STALL_PERIODS};

/// A bench whose guide is moving.
fn moving() -> Bench {
    let mut bench = Bench::new();
    bench.position_um = [0.0; 2];
    bench.run(&[Step::Move { x_um: 0, y_um: 3_000, speed_um_s: 1_000 }]);
    assert!(matches!(bench.periods(300).drive, Drive::Duty(_)));
    bench
}

/// Number of periods until the fault is latched, at most `most`; the bridges must be off in the same period and stay off.
fn periods_to(bench: &mut Bench, fault: Fault, most: u32) -> u32 {
    for period in 1..=most {
        let outputs = bench.period(None);
        if outputs.state == State::Faulted {
            assert_eq!(bench.controller.interlock.latched(), Some(fault));
            assert_eq!(outputs.drive, Drive::Release);
            let reports = |note: &OutboundMessage| matches!(note, OutboundMessage::Event(Event { kind: EventKind::Faulted { fault: reported }, .. }) if *reported == fault);
            assert_eq!(outputs.notes.iter().filter(|note| reports(note)).count(), 1, "{:?}", outputs.notes);
            for _ in 0..300 {
                assert_eq!(bench.period(None).drive, Drive::Release);
            }
            return period;
        }
    }
    panic!("no fault in {most} periods");
}

/// A clear is refused while the cause exists and accepted once it is gone; the guide does not move by itself afterwards.
fn clears_only_without(bench: &mut Bench, remove: impl FnOnce(&mut Bench)) {
    assert_eq!(bench.command(Request::ClearFault), Err(Refusal::CauseRemains));
    remove(bench);
    bench.periods(FORCE_READINGS.into());
    bench.command(Request::ClearFault).expect("the cause is gone");
    let outputs = bench.periods(50);
    assert_eq!((outputs.state, outputs.drive), (State::Idle, Drive::Release));
}

/// An axis that coasts, or whose bridge is shorted, keeps the fault until it is at rest.
#[test]
fn a_fault_is_cleared_only_at_rest() {
    let mut bench = moving();
    bench.emergency_stop = true;
    periods_to(&mut bench, Fault::EmergencyStop, 2);
    bench.emergency_stop = false;
    for _ in 0..400 {
        bench.position_um[1] += 5.0;
        bench.period(None);
    }
    bench.position_um[1] += 5.0;
    assert_eq!(bench.command(Request::ClearFault), Err(Refusal::CauseRemains), "5 mm/s");
    let mut waited = 0;
    while bench.command(Request::ClearFault).is_err() {
        waited += 1;
    }
    assert!((20..=2 * u32::from(crate::axis::STILL_PERIODS)).contains(&waited), "{waited} periods");
    assert_eq!(bench.periods(50).state, State::Idle);
    // Without a latched fault a clear requires no rest: it ends the program.
    bench.run(&[Step::Move { x_um: 0, y_um: 0, speed_um_s: 1_000 }]);
    assert!(matches!(bench.periods(300).drive, Drive::Duty(_)));
    bench.command(Request::ClearFault).expect("nothing is latched");
    assert_eq!(bench.periods(10).state, State::Idle);
}

#[test]
fn force_beyond_the_limit_that_is_set() {
    let mut bench = moving();
    bench.command(Request::Stop).expect("stops");
    let limits = |force_mn, silence_ms| Request::Limits { force_mn, silence_ms };
    assert_eq!(bench.command(limits(0, 1_000)), Err(Refusal::OutOfRange));
    assert_eq!(bench.command(limits(5_001, 1_000)), Err(Refusal::OutOfRange));
    assert_eq!(bench.command(limits(1_000, 199)), Err(Refusal::OutOfRange));
    bench.command(limits(2_000, 1_000)).expect("within the range");
    bench.run(&[Step::Hold { duration_ms: 10_000 }]);
    assert_eq!(bench.command(limits(3_000, 1_000)), Err(Refusal::Busy));
    bench.push_n = [2.1, 0.0];
    assert_eq!(periods_to(&mut bench, Fault::ForceLimit, 10), EVIDENCE_READINGS);
    assert_eq!(bench.command(Request::ClearFault), Err(Refusal::CauseRemains));
    // The screws hold the load: with a higher limit the fault can be cleared.
    bench.command(limits(4_000, 1_000)).expect("nothing runs");
    bench.command(Request::ClearFault).expect("below the new limit");
}

#[test]
fn force_beyond_the_rated_range() {
    let mut bench = moving();
    bench.push_n = [0.0, -5.5];
    assert_eq!(periods_to(&mut bench, Fault::ForceRange, 10), EVIDENCE_READINGS);
    clears_only_without(&mut bench, |bench| bench.push_n = [0.0; 2]);
}

#[test]
fn a_saturated_converter() {
    let mut bench = moving();
    bench.force_fault = Some(ForceFault::Saturated { channel: 1 });
    assert_eq!(periods_to(&mut bench, Fault::ForceRange, 10), EVIDENCE_READINGS);
    clears_only_without(&mut bench, |bench| bench.force_fault = None);
}

#[test]
fn one_outlying_reading_is_not_a_fault() {
    let mut bench = moving();
    bench.push_n = [9.0; 2];
    bench.potentiometer_codes = Some([4_095, 0]);
    bench.periods(1);
    (bench.push_n, bench.potentiometer_codes) = ([0.0; 2], None);
    assert_eq!(bench.periods(10).state, State::Moving);
}

#[test]
fn a_force_sensor_that_falls_silent() {
    let mut bench = moving();
    bench.force_fault = Some(ForceFault::Crc);
    // Noise may have repeated a code before.
    let latch_readings = DOUBTFUL_READINGS - 2..=DOUBTFUL_READINGS;
    assert!(latch_readings.contains(&periods_to(&mut bench, Fault::ForceSensor, 100)));
    clears_only_without(&mut bench, |bench| bench.force_fault = None);
}

#[test]
fn a_force_sensor_that_repeats_itself() {
    let mut bench = Bench::new();
    bench.run(&[Step::Hold { duration_ms: 60_000 }]);
    bench.force_stuck = true;
    // The first of the repeated readings differs from the one before it.
    assert_eq!(periods_to(&mut bench, Fault::ForceStuck, 100), DOUBTFUL_READINGS + 1);
    clears_only_without(&mut bench, |bench| bench.force_stuck = false);
}

/// Reads forces that all differ, except in the readings for which `repeats` holds: there the first axis repeats its force or, with
/// `misses`, the reading is missing. Returns the fault that is latched after a second.
fn fault_of(repeats: impl Fn(u32) -> bool, misses: bool) -> Option<Fault> {
    let mut bench = Bench::new();
    (bench.position_um, bench.noise_n) = ([0.0; 2], 0.0);
    let mut force_mn = 0;
    for period in 0..1_000 {
        let fails = repeats(period);
        bench.force_fault = (fails && misses).then_some(ForceFault::NotReady);
        if !fails {
            force_mn = (force_mn + 1) % 50;
        }
        bench.push_n = [1e-3 * force_mn as f32, 1e-3 * (period % 50) as f32];
        bench.period(None);
    }
    bench.controller.interlock.latched()
}

/// Readings that repeat by chance, some of them close together, are no fault. A channel that fails in every second reading is.
#[test]
fn a_channel_is_stuck_where_it_repeats_more_often_than_noise_does() {
    assert_eq!(fault_of(|period| period % 4 == 0, false), None, "8 of 32");
    assert_eq!(fault_of(|period| period % 32 < 7, false), None, "7 in a row, 7 of 32");
    assert_eq!(fault_of(|period| period % 32 < 8, false), Some(Fault::ForceStuck), "8 in a row");
    assert_eq!(fault_of(|period| period % 2 == 0, false), Some(Fault::ForceStuck), "16 of 32");
    assert_eq!(fault_of(|period| period % 8 < 3, false), Some(Fault::ForceStuck), "12 of 32");
    assert_eq!(fault_of(|period| period % 4 == 0, true), Some(Fault::ForceSensor), "8 of 32 missing");
    assert_eq!(fault_of(|period| period % 5 == 0, true), None, "6 or 7 of 32 missing");
}

#[test]
fn a_potentiometer_off_its_track() {
    for codes in [[2_048, 4_095], [0, 2_048]] {
        let mut bench = moving();
        bench.potentiometer_codes = Some(codes);
        assert_eq!(periods_to(&mut bench, Fault::Potentiometer, 10), EVIDENCE_READINGS);
        clears_only_without(&mut bench, |bench| bench.potentiometer_codes = None);
    }
}

#[test]
fn a_potentiometer_that_jumps() {
    let mut bench = moving();
    bench.potentiometer_codes = Some([2_048 + 200, 2_048]);
    assert_eq!(periods_to(&mut bench, Fault::Potentiometer, 10), EVIDENCE_READINGS);
}

#[test]
fn an_axis_driven_beyond_its_travel_may_be_driven_back() {
    let mut bench = Bench::new();
    bench.position_um = [0.0, 9_900.0];
    bench.push_n = [0.0, -9.0];
    bench.run(&[Step::Move { x_um: 0, y_um: 10_000, speed_um_s: 500 }]);
    bench.periods(10);
    bench.runaway = Some(1.0);
    assert!(periods_to(&mut bench, Fault::Travel, 40) < 30);
    (bench.runaway, bench.position_um) = (None, [0.0, 10_400.0]);
    bench.periods(FORCE_READINGS.into());
    bench.command(Request::ClearFault).expect("nothing drives it outward");
    bench.run(&[Step::Move { x_um: 0, y_um: 9_000, speed_um_s: 2_000 }]);
    bench.notes.clear();
    assert_eq!(bench.finish(), Outcome::Completed);
}

#[test]
fn a_jammed_axis_stalls_before_it_times_out() {
    let mut bench = moving();
    bench.strength = 0.0;
    let periods = periods_to(&mut bench, Fault::Stall, 5_000);
    assert!((STALL_PERIODS..1_000).contains(&periods), "{periods} periods");
    bench.command(Request::ClearFault).expect("nothing is driven");
}

#[test]
fn a_weak_motor_falls_behind() {
    let mut bench = Bench::new();
    bench.position_um = [0.0; 2];
    bench.strength = 0.3;
    bench.run(&[Step::Move { x_um: 0, y_um: 9_000, speed_um_s: 9_500 }]);
    periods_to(&mut bench, Fault::FollowingError, 2_000);
}

#[test]
fn an_axis_that_cannot_finish_times_out() {
    let mut bench = Bench::new();
    bench.position_um = [0.0; 2];
    bench.strength = 0.0;
    // The distance is too small for a duty at which a standstill counts as a stall.
    bench.run(&[Step::Move { x_um: 0, y_um: 50, speed_um_s: 1_000 }]);
    let periods = periods_to(&mut bench, Fault::MoveTimeout, 10_000);
    assert!((3_000..4_000).contains(&periods), "{periods} periods");
}

#[test]
fn a_silent_host_ends_a_program_and_only_a_program() {
    let mut bench = Bench::new();
    bench.request_periods = 0;
    assert_eq!(bench.periods(5_000).state, State::Idle);
    bench.run(&[Step::Hold { duration_ms: 60_000 }]);
    assert_eq!(periods_to(&mut bench, Fault::HostSilent, 5_000), 2_001);
    bench.command(Request::ClearFault).expect("the host sends commands again");
}

/// Commands of another program, with an invalid token, with a valid token of its own, or as a new connection.
#[test]
fn only_the_conversation_that_started_a_program_keeps_it_alive() {
    let mut bench = Bench::new();
    let mut fault_after = |act: &mut dyn FnMut(&mut Bench)| {
        bench.run(&[Step::Hold { duration_ms: 6_000 }]);
        bench.request_periods = 0;
        for _ in 0..5 {
            bench.periods(700);
            act(&mut bench);
        }
        let fault = bench.controller.interlock.latched();
        bench.command(Request::ClearFault).expect("it speaks");
        bench.command(Request::Stop).expect("it speaks");
        fault
    };
    let mut other_conversation = 0;
    let refused = fault_after(&mut |bench| {
        let status = Command { id: 1, connection: 77, request: Request::Status };
        assert_eq!(bench.answer(status), Err(Refusal::OtherBoot));
    });
    let other_keeps_alive = fault_after(&mut |bench| {
        if other_conversation == 0 {
            other_conversation = bench.controller.conversation.begin();
        }
        let id = bench.next_id;
        bench.next_id += 1;
        bench
            .answer(Command { id, connection: other_conversation, request: Request::Status })
            .expect("a valid token");
    });
    let mut hellos = 0;
    let hello = fault_after(&mut |bench| {
        // More hellos would replace the connection of the program.
        hellos += 1;
        if hellos <= 2 {
            bench.answer(Command { id: 0, connection: 0, request: Request::Hello }).expect("always");
        }
    });
    let its_own = fault_after(&mut |bench| bench.command(Request::Status).expect("answered"));
    let silent = Some(Fault::HostSilent);
    assert_eq!([refused, other_keeps_alive, hello, its_own], [silent, silent, silent, None]);
}

/// A faulty line, or a program between host and device, sends the host's last frames again. Each is answered as before, and none
/// is a keepalive.
#[test]
fn repeated_frames_keep_no_program_alive() {
    let mut bench = Bench::new();
    bench.request_periods = 0;
    let hello = Command { id: 0, connection: bench.connection, request: Request::Hello };
    bench.run(&[Step::Hold { duration_ms: 6_000 }]);
    let status = Command { id: bench.next_id, connection: bench.connection, request: Request::Status };
    bench.next_id += 1;
    bench.answer(status).expect("a new command");
    let mut repeats = 0;
    while bench.controller.interlock.latched().is_none() {
        bench.periods(698);
        for frame in [status, hello] {
            bench.answer(frame).expect("a repeated frame is answered as before");
        }
        repeats += 1;
        assert!(repeats < 5, "still alive");
    }
    assert_eq!((repeats, bench.controller.interlock.latched()), (3, Some(Fault::HostSilent)));
}

/// The start of an earlier program of another host arrives again: that host has not started the program that runs.
#[test]
fn a_repeated_start_of_another_connection_takes_no_program_over() {
    let mut bench = Bench::new();
    let hold = |duration_ms| [Step::Hold { duration_ms }];
    bench.run(&hold(100));
    let start = Request::Run { steps: 1, crc: program_crc(&hold(100)), start_us: 0 };
    let repeated = Command { id: bench.next_id - 1, connection: bench.connection, request: start };
    assert_eq!(bench.finish(), Outcome::Completed);
    bench.connection = bench.controller.conversation.begin();
    bench.run(&hold(6_000));
    bench.answer(repeated).expect("a repeated frame is answered as before");
    // The host of the program goes on with its requests of the status.
    bench.periods(5_000);
    assert_eq!(bench.controller.interlock.latched(), None);
}

#[test]
fn late_periods_end_a_program_and_are_only_counted_at_rest() {
    let mut bench = Bench::new();
    bench.late_us = 600;
    assert_eq!(bench.periods(10).state, State::Idle);
    bench.late_us = 0;
    bench.periods(20);
    bench.run(&[Step::Hold { duration_ms: 60_000 }]);
    bench.late_us = 600;
    assert_eq!(bench.periods(1).state, State::Holding);
    bench.late_us = 0;
    assert_eq!(bench.periods(100).state, State::Holding, "one late period is no fault");
    bench.late_us = 600;
    assert_eq!(periods_to(&mut bench, Fault::Overrun, 10), 2);
    assert!(bench.controller.control_overruns > 12);
}

#[test]
fn a_restart_is_acknowledged_before_anything_moves() {
    let mut bench = Bench::new();
    let start = Start { restarted: true, ..Start::ordinary(BOOT) };
    (bench.controller, bench.connection) = connected(Calibration::default(), start);
    assert_eq!(bench.periods(1).state, State::Faulted);
    let run = Request::Run { steps: 1, crc: 0, start_us: 0 };
    assert_eq!(bench.command(run), Err(Refusal::Faulted { fault: Fault::Restarted }));
    // The run before the restart may have been moving the guide.
    assert_eq!(bench.command(Request::ClearFault), Err(Refusal::CauseRemains), "the guide may still coast");
    bench.periods(u32::from(crate::axis::STILL_PERIODS));
    bench.command(Request::ClearFault).expect("acknowledged");
    bench.run(&[Step::Hold { duration_ms: 10 }]);
}

#[test]
fn a_motor_that_never_rests_is_locked_out_until_it_has_cooled() {
    let mut bench = Bench::new();
    bench.position_um = [0.0; 2];
    let back_and_forth: std::vec::Vec<_> = (0..60)
        .map(|step| Step::Ramp { x_um: 0, y_um: if step % 2 == 0 { 900 } else { -900 }, duration_ms: 2_000 })
        .collect();
    bench.run(&back_and_forth);
    let periods = periods_to(&mut bench, Fault::MotorHot, 200_000);
    assert!((ON_LIMIT_PERIODS..ON_LIMIT_PERIODS + 5_000).contains(&periods), "{periods} periods");
    assert_eq!(bench.command(Request::ClearFault), Err(Refusal::CauseRemains));
    let mut resting_s = 0;
    while bench.command(Request::ClearFault).is_err() {
        bench.periods(1_000);
        resting_s += 1;
    }
    assert!((200..300).contains(&resting_s), "{resting_s} s of rest for {COOLED_SHARE} of the limit");
}

#[test]
fn a_calibration_is_handed_out_once_it_is_complete_and_nothing_runs() {
    let mut bench = Bench::new();
    let record = protocol::CalibrationRecord { travel_um: 7_000, ..Calibration::nominal_record() };
    let mut buffer = [0; protocol::MAX_CALIBRATION];
    let bytes = record.encode(&mut buffer);
    let store = Request::StoreCalibration { length: bytes.len() as u8, crc: record.crc() };
    assert_eq!(bench.command(store), Err(Refusal::CalibrationInvalid));
    for (piece, chunk) in (0..).zip(bytes.chunks(protocol::PIECE_BYTES)) {
        let mut bytes = [0; protocol::PIECE_BYTES];
        bytes[..chunk.len()].copy_from_slice(chunk);
        bench.command(Request::LoadCalibration { piece, bytes }).expect("nothing runs");
    }
    bench.run(&[Step::Hold { duration_ms: 100 }]);
    assert_eq!(bench.command(store), Err(Refusal::Busy));
    assert_eq!(bench.finish(), Outcome::Completed);
    bench.command(store).expect("complete, and with this checksum");
    assert_eq!(bench.last.as_ref().and_then(|outputs| outputs.store.clone()), Some(record));
}
