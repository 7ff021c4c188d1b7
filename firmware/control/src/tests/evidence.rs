//! No sensor that fails now and then hides a load, and no ordinary noise is one.

use super::*;
use crate::campaign::sensors::{Effect, Pattern};

/// What a motor may move after the force has reached the limit, micrometres: as the interlock's table states it, at a full speed of
/// 20 mm/s. The bench's motors have no lag, which is 240 um of it.
const DETECTED_UM: f32 = 240.0;

/// Drives into a spring with a limit of 2 N; the largest true force and the fault.
fn drive_into(
    stiffness_n_per_um: f32,
    speed_um_s: u32,
    fail_from_um: f32,
    fail: impl Fn(&mut Bench),
) -> (f32, Option<Fault>) {
    let mut bench = Bench::new();
    bench.position_um = [0.0; 2];
    bench.stiffness_n_per_um = stiffness_n_per_um;
    bench.noise_n = 0.005;
    bench.command(Request::Limits { force_mn: 2_000, silence_ms: 2_000 }).expect("within the range");
    // The axes prove themselves, so that they may go as fast as they can.
    bench.run(&[
        Step::Move { x_um: 220, y_um: 220, speed_um_s: 2_000 },
        Step::Move { x_um: 0, y_um: 0, speed_um_s: 2_000 },
    ]);
    assert_eq!(bench.finish(), Outcome::Completed);
    bench.notes.clear();
    bench.run(&[Step::Move { x_um: 0, y_um: 9_000, speed_um_s }]);
    let mut most_n = 0.0_f32;
    let mut failing = false;
    for _ in 0..12_000 {
        if !failing && bench.position_um[1] >= fail_from_um {
            failing = true;
            bench.kept = None;
            fail(&mut bench);
        }
        bench.period(None);
        most_n = most_n.max(bench.position_um[1].abs() * stiffness_n_per_um);
        if bench.controller.interlock.latched().is_some() {
            break;
        }
    }
    bench.periods(50);
    most_n = most_n.max(bench.position_um[1].abs() * stiffness_n_per_um);
    (most_n, bench.controller.interlock.latched())
}

#[test]
fn no_pattern_of_failing_force_channels_lets_the_force_exceed_its_limit() {
    for (stiffness_n_per_um, speed_um_s) in [(1e-3, 10_000), (1e-3, 1_000), (8e-3, 10_000), (0.3e-3, 10_000)]
    {
        let reaches_um = 2.0 / stiffness_n_per_um;
        for failing in Failing::all() {
            for share in [0.0, 0.5, 0.98] {
                let (most_n, fault) =
                    drive_into(stiffness_n_per_um, speed_um_s, share * reaches_um, |bench| {
                        bench.force_fails = Some(failing);
                    });
                let allowed_n = 2.0 + DETECTED_UM * stiffness_n_per_um + 0.02;
                assert!(
                    most_n < allowed_n && fault.is_some(),
                    "{failing:?} from {share}, {stiffness_n_per_um} N/um, {speed_um_s} um/s: {most_n} N, {fault:?}"
                );
            }
        }
    }
}

#[test]
fn no_pattern_of_failing_potentiometers_lets_the_force_exceed_its_limit() {
    for failing in Failing::all() {
        for share in [0.0, 0.5, 0.98] {
            let (most_n, fault) = drive_into(1e-3, 10_000, share * 2_000.0, |bench| {
                bench.potentiometers_fail = Some(failing);
            });
            assert!(
                most_n < 2.0 + DETECTED_UM * 1e-3 && fault.is_some(),
                "{failing:?} from {share}: {most_n} N, {fault:?}"
            );
        }
    }
}

/// A dead channel that has noise, and one whose false readings have: no code is repeated, but no motion explains the jumps.
#[test]
fn readings_that_no_motion_explains_are_a_fault_while_moving() {
    for (every, within) in [(1, 2), (2, 4), (3, 6)] {
        let mut bench = Bench::new();
        bench.position_um = [0.0; 2];
        bench.run(&[Step::Move { x_um: 0, y_um: 2_000, speed_um_s: 1_000 }]);
        bench.periods(1_500);
        let push_n = -bench.position_um[1] * 1e-3;
        let mut periods = 0;
        while bench.controller.interlock.latched().is_none() {
            periods += 1;
            bench.push_n[1] = if periods % every == 0 { push_n } else { 0.0 };
            bench.period(None);
            assert!(periods <= within, "one of {every}");
        }
        assert_eq!(bench.controller.interlock.latched(), Some(Fault::ForceSensor));
    }
    // At rest a hand may load the needle as fast as it likes.
    let mut bench = Bench::new();
    bench.run(&[Step::Hold { duration_ms: 1_000 }]);
    bench.push_n = [1.5; 2];
    assert_eq!(bench.finish(), Outcome::Completed);
}

#[test]
fn a_potentiometer_at_its_rail_in_every_second_reading_is_a_fault_and_is_not_shown() {
    let mut bench = Bench::new();
    bench.position_um = [0.0, 3_000.0];
    bench.periods(100);
    bench.potentiometers_fail = Some(Failing {
        effect: Effect::Saturated,
        pattern: Pattern::AllButOneOf(2),
        channels: [false, true],
    });
    for _ in 0..100 {
        bench.command(Request::Status).expect("answered");
        let shown = bench.notes.iter().rev().find_map(|note| match note {
            OutboundMessage::Status(status) => Some(status.position_counts[1]),
            _ => None,
        });
        assert!(shown.is_some_and(|um| (um - 3_000).abs() < 30), "{shown:?}");
    }
    assert_eq!(bench.controller.interlock.latched(), Some(Fault::Potentiometer));
}

/// An hour of it is 3,600,000 readings; the chance of a false fault is derived in `limits`.
#[test]
fn ordinary_noise_is_no_fault() {
    for (noise_n, hum_n) in [(0.02, 0.1), (0.4e-3, 0.0), (0.005, 0.05)] {
        let mut bench = Bench::new();
        (bench.noise_n, bench.hum_n) = (noise_n, hum_n);
        bench.position_um = [0.0; 2];
        bench.command(Request::Limits { force_mn: 2_000, silence_ms: 2_000 }).expect("within the range");
        for _ in 0..6 {
            // To 1.7 N, and back at the greatest speed.
            bench.notes.clear();
            bench.run(&[
                Step::Move { x_um: 0, y_um: 1_700, speed_um_s: 10_000 },
                Step::Hold { duration_ms: 3_000 },
                Step::Move { x_um: 1_200, y_um: -1_200, speed_um_s: 10_000 },
            ]);
            assert_eq!(bench.finish(), Outcome::Completed, "{:?}", bench.controller.interlock.latched());
        }
    }
}
