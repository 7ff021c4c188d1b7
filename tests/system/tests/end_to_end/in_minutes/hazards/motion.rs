//! Potentiometers, motors and what they move.

use super::*;
use control::motor::STALL_PERIODS;

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_potentiometers_wire_is_open() {
    in_motion(Injection { potentiometer_open: Some(1), ..NOTHING }, Fault::Potentiometer, 2..=2);
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_potentiometers_wire_is_shorted() {
    in_motion(Injection { potentiometer_short: Some(0), ..NOTHING }, Fault::Potentiometer, 2..=2);
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_potentiometer_jumps() {
    let (bench, mut client) = bench(RigConfig::default());
    let jump = Injection { potentiometer_jump_codes: [0, -150], ..NOTHING };
    bench.rig().inject_when(Trigger::Driving { for_periods: 100 }, jump);
    start(&mut client, &[move_y(2_500, 1_000)]);
    await_fault(&mut client, Fault::Potentiometer);
    assert_released(&bench, 2..=2);
    // The new reading is as good as any: only the jump itself is detectable, and it is over.
    clears(&bench, &mut client);
    drop(client);
    bench.stop().unwrap();
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn an_axis_too_weak_for_the_last_step_times_out() {
    let (bench, mut client) = bench(RigConfig::default());
    start(&mut client, &[move_y(0, 2_000)]);
    eventually("the guide is home", || client.status().unwrap().state == State::Idle);
    let jam = Injection { jammed: Some(1), ..NOTHING };
    bench.rig().inject_when(Trigger::Driving { for_periods: 1 }, jam);
    start(&mut client, &[move_y(90, 500)]);
    await_fault(&mut client, Fault::MoveTimeout);
    assert_released(&bench, 3_000..=3_500);
    clears(&bench, &mut client);
    drop(client);
    bench.stop().unwrap();
}

/// A bridge that is shorted moves the axis on although it is off: the fault stands as long as it does.
#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_fault_is_cleared_only_at_rest() {
    let (bench, mut client) = bench(unloaded());
    assert_eq!(ended(&mut client, &[move_y(-8_000, 8_000)]), Outcome::Completed);
    bench.rig().inject(Injection { emergency_stop: true, ..NOTHING });
    await_fault(&mut client, Fault::EmergencyStop);
    bench.rig().inject(Injection { runaway: Some((1, 0.4)), ..NOTHING });
    let start_mm = y_mm(&bench);
    eventually("the axis moves on", || y_mm(&bench) > start_mm + 1.0);
    assert_eq!(refusal(client.request(Request::ClearFault)), Refusal::CauseRemains);
    clears(&bench, &mut client);
    assert_eq!(ended(&mut client, &[move_y(0, 4_000)]), Outcome::Completed);
    drop(client);
    bench.stop().unwrap();
}

fn y_mm(bench: &Bench) -> f64 {
    1e3 * bench.rig().rig(|rig| rig.position_m()[1])
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_runaway_axis_leaves_its_travel() {
    let (bench, mut client) = bench(unloaded());
    // On a busy computer the axis would otherwise be at the end of its track before the test ends the runaway.
    let runaway = Injection { runaway: Some((1, 1.0)), for_periods: Some(60), ..NOTHING };
    bench.rig().inject_when(Trigger::Beyond { axis: 1, position_mm: 9.7 }, runaway);
    start(&mut client, &[move_y(9_900, 4_000)]);
    await_fault(&mut client, Fault::Travel);
    // From 9.7 mm to 0.2 mm beyond the 10 mm at 20 mm/s are 25 periods; the motor gathers speed and the bridge is beyond help.
    assert_released(&bench, 10..=60);
    // The recovery is a clear and a move back; cleared while the axis still rolls on, the fault stands again.
    let mut way_out = || {
        clears(&bench, &mut client);
        ended(&mut client, &[move_y(9_000, 2_000)])
    };
    let outcomes: Vec<Outcome> = std::iter::repeat_with(&mut way_out)
        .take(3)
        .take_while(|outcome| *outcome != Outcome::Completed)
        .collect();
    assert!(outcomes.len() < 3, "{outcomes:?} {:?}", client.status());
    drop(client);
    bench.stop().unwrap();
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_jammed_axis_stalls() {
    let (bench, mut client) = bench(unloaded());
    bench.rig().inject_when(Trigger::Driving { for_periods: 300 }, Injection { jammed: Some(1), ..NOTHING });
    start(&mut client, &[move_y(6_000, 2_000)]);
    await_fault(&mut client, Fault::Stall);
    let least = u64::from(STALL_PERIODS);
    assert_released(&bench, least..=least + 400);
    clears(&bench, &mut client);
    drop(client);
    bench.stop().unwrap();
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_weak_motor_falls_behind() {
    let (bench, mut client) = bench(unloaded());
    // The first motion of an axis is slow: a weak motor keeps up with it.
    start(&mut client, &[move_y(800, 2_000)]);
    eventually("the axis has moved", || client.status().unwrap().state == State::Idle);
    bench
        .rig()
        .inject_when(Trigger::Driving { for_periods: 100 }, Injection { weak: Some((1, 0.4)), ..NOTHING });
    start(&mut client, &[move_y(9_500, 9_500)]);
    await_fault(&mut client, Fault::FollowingError);
    let status = client.status().unwrap();
    let [_, y_m] = client.displacement_m(status.position_counts);
    assert!(y_m < 8e-3, "stopped at {y_m} m, where nothing was missing");
    assert_released(&bench, 100..=1_500);
    clears(&bench, &mut client);
    drop(client);
    bench.stop().unwrap();
}
