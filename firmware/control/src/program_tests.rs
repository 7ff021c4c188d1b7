//! Programs: paths, times and refusals.

use super::*;

const TRAVEL_UM: i32 = 10_000;

fn loaded(steps: &[Step]) -> Executor {
    let mut executor = Executor::new();
    for (index, step) in steps.iter().enumerate() {
        executor.load(index as u8, *step, TRAVEL_UM).unwrap();
    }
    executor.run(steps.len() as u8, protocol::program_crc(steps), 0, 0, [0.0; 2]).unwrap();
    executor
}

#[test]
fn both_axes_arrive_together_at_the_requested_speed() {
    let mut executor = loaded(&[Step::Move { x_um: 3_000, y_um: 4_000, speed_um_s: 1_000 }]);
    executor.advance(0, false, [0.0; 2]);
    executor.advance(2_525_000, false, [0.0; 2]);
    let [x, y] = executor.setpoint().unwrap();
    assert!((x.position_um - 1_500.0).abs() < 1.0 && (y.position_um - 2_000.0).abs() < 1.0);
    assert!((x.speed_um_s - 600.0).abs() < 0.1 && (y.speed_um_s - 800.0).abs() < 0.1);
    executor.advance(5_050_000, false, [0.0; 2]);
    assert_eq!(executor.setpoint().unwrap()[1], Setpoint { position_um: 4_000.0, speed_um_s: 0.0 });
    assert!(executor.advance(5_051_000, true, [0.0; 2]).completed);
    assert_eq!(executor.phase(), Phase::Idle);
}

#[test]
fn a_ramp_is_even_and_ends_in_its_time_wherever_the_axes_are() {
    let mut executor =
        loaded(&[Step::Ramp { x_um: 800, y_um: -600, duration_ms: 500 }, Step::Hold { duration_ms: 10 }]);
    executor.advance(0, false, [0.0; 2]);
    executor.advance(250_000, false, [0.0; 2]);
    let [x, y] = executor.setpoint().unwrap();
    assert_eq!((x.position_um, y.position_um), (400.0, -300.0));
    assert!((x.speed_um_s - 1_600.0).abs() < 0.1 && (y.speed_um_s + 1_200.0).abs() < 0.1);
    assert_eq!(executor.phase(), Phase::Moving);
    let progress = executor.advance(500_000, false, [0.0; 2]);
    assert_eq!((progress.ended, progress.started), (Some(0), Some(1)));
    assert_eq!(executor.setpoint().unwrap()[0], Setpoint { position_um: 800.0, speed_um_s: 0.0 });
}

#[test]
fn a_last_ramp_slows_down_and_ends_when_the_axes_have_settled() {
    let mut executor = loaded(&[Step::Ramp { x_um: 0, y_um: 8_000, duration_ms: 1_000 }]);
    executor.advance(0, false, [0.0; 2]);
    let mut previous_um = 0.0;
    for t_ms in 1..=1_400_u64 {
        assert!(!executor.advance(t_ms * 1_000, false, [0.0; 2]).completed);
        let [_, y] = executor.setpoint().unwrap();
        // Constant at 8 mm/s, then decelerated at 20 mm/s2; the setpoint never passes the end.
        assert!((-0.01..8.02).contains(&(y.position_um - previous_um)), "{y:?} at {t_ms}");
        if t_ms <= 800 {
            assert!((y.position_um - 8.0 * t_ms as f32).abs() < 0.1, "{y:?} at {t_ms}");
        }
        previous_um = y.position_um;
    }
    assert_eq!(executor.setpoint().unwrap()[1], Setpoint { position_um: 8_000.0, speed_um_s: 0.0 });
    assert!(executor.advance(1_401_000, true, [0.0; 2]).completed);
    let mut executor = loaded(&[Step::Ramp { x_um: 0, y_um: 8_000, duration_ms: 1_000 }]);
    executor.advance(0, false, [0.0; 2]);
    assert!(!executor.advance(4_100_000, false, [0.0; 2]).timed_out);
    assert!(executor.advance(4_300_000, false, [0.0; 2]).timed_out);
}

#[test]
fn a_ramp_to_the_end_of_the_travel_slows_down_before_a_hold() {
    let ramp = |y_um| [Step::Ramp { x_um: 0, y_um, duration_ms: 1_000 }, Step::Hold { duration_ms: 9 }];
    let ends_ms = |y_um, settled| {
        let mut executor = loaded(&ramp(y_um));
        executor.advance(0, false, [0.0; 2]);
        (1..2_000_u64).find(|t_ms| executor.advance(t_ms * 1_000, settled, [0.0; 2]).ended.is_some())
    };
    assert_eq!(ends_ms(9_500, false), Some(1_000));
    // The end is later by v / 2 a (10 mm/s at 20 mm/s2), and not before the axes have settled.
    assert_eq!(ends_ms(-10_000, true), Some(1_250));
    assert_eq!(ends_ms(-10_000, false), None);
}

#[test]
fn a_start_too_far_ahead_is_refused() {
    let mut executor = Executor::new();
    let steps = [Step::Hold { duration_ms: 5 }];
    executor.load(0, steps[0], TRAVEL_UM).unwrap();
    let crc = protocol::program_crc(&steps);
    for start_us in [7 + START_LIMIT_US + 1, u64::MAX] {
        assert_eq!(executor.run(1, crc, start_us, 7, [0.0; 2]), Err(Refusal::OutOfRange));
    }
    assert_eq!(executor.run(1, crc, 7 + START_LIMIT_US, 7, [0.0; 2]), Ok(()));
}

#[test]
fn a_move_that_never_settles_times_out() {
    let mut executor = loaded(&[Step::Move { x_um: 0, y_um: 1_000, speed_um_s: 1_000 }]);
    executor.advance(0, false, [0.0; 2]);
    assert!(!executor.advance(4_400_000, false, [0.0; 2]).timed_out);
    assert!(executor.advance(4_700_000, false, [0.0; 2]).timed_out);
}

#[test]
fn steps_follow_each_other_without_a_period_lost() {
    let mut executor = loaded(&[Step::Hold { duration_ms: 2 }, Step::Tare { duration_ms: 1 }]);
    assert_eq!(executor.advance(10_000, false, [0.0; 2]).started, Some(0));
    assert_eq!(executor.advance(11_000, false, [0.0; 2]), ProgramProgress::default());
    let change = executor.advance(12_000, false, [0.0; 2]);
    assert_eq!((change.ended, change.started, change.tare_finished), (Some(0), Some(1), false));
    let end = executor.advance(13_000, false, [0.0; 2]);
    assert_eq!((end.ended, end.completed, end.tare_finished), (Some(1), true, true));
}

#[test]
fn steps_and_programs_that_cannot_run_are_refused() {
    let mut executor = Executor::new();
    let hold = Step::Hold { duration_ms: 5 };
    let beyond_travel = Step::Move { x_um: 0, y_um: TRAVEL_UM + 1, speed_um_s: 100 };
    let without_speed = Step::Move { x_um: 0, y_um: 0, speed_um_s: 0 };
    assert_eq!(executor.load(0, beyond_travel, TRAVEL_UM), Err(Refusal::OutOfTravel));
    assert_eq!(executor.load(0, without_speed, TRAVEL_UM), Err(Refusal::OutOfRange));
    assert_eq!(executor.load(0, Step::Tare { duration_ms: 0 }, TRAVEL_UM), Err(Refusal::OutOfRange));
    assert_eq!(executor.load(MAX_STEPS as u8, hold, TRAVEL_UM), Err(Refusal::OutOfRange));
    assert_eq!(executor.load(0, hold, TRAVEL_UM), Ok(()));
    let crc = protocol::program_crc(&[hold]);
    assert_eq!(executor.run(0, protocol::program_crc(&[]), 0, 0, [0.0; 2]), Err(Refusal::OutOfRange));
    assert_eq!(executor.run(1, crc ^ 1, 0, 0, [0.0; 2]), Err(Refusal::ProgramMismatch));
    assert_eq!(executor.run(1, crc, 500, 500, [0.0; 2]), Err(Refusal::TooLate));
    let ramp = Step::Ramp { x_um: 0, y_um: 5_000, duration_ms: 501 };
    assert_eq!(executor.load(1, ramp, TRAVEL_UM), Ok(()));
    let combined_crc = protocol::program_crc(&[hold, ramp]);
    assert_eq!(executor.run(2, combined_crc, 0, 0, [0.0, -100.0]), Err(Refusal::OutOfRange));
    assert_eq!(executor.run(1, crc, 501, 500, [0.0; 2]), Ok(()));
    assert_eq!(executor.phase(), Phase::Pending);
    assert_eq!(executor.run(1, crc, 0, 500, [0.0; 2]), Err(Refusal::Busy));
    assert_eq!(executor.load(0, hold, TRAVEL_UM), Err(Refusal::Busy));
}
