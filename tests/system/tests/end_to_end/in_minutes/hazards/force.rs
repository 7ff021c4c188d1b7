//! Emergency stop and force.

use super::*;
use control::limits::{STALE_LIMIT_PERIODS, STUCK_LIMIT_READINGS};

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn the_emergency_stop_is_pressed() {
    in_motion(Injection { emergency_stop: true, ..NOTHING }, Fault::EmergencyStop, 1..=1);
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn the_force_converter_falls_silent() {
    let within = u64::from(STALE_LIMIT_PERIODS);
    in_motion(Injection { force_silent: true, ..NOTHING }, Fault::ForceSensor, within..=within);
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_converter_that_was_saturated_once_and_is_silent_then_is_no_load() {
    let within = u64::from(STALE_LIMIT_PERIODS);
    in_motion(
        Injection { force_saturated_once: Some(0), ..NOTHING },
        Fault::ForceSensor,
        within..=within + 1,
    );
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn the_force_converters_frames_are_corrupt() {
    let within = u64::from(STALE_LIMIT_PERIODS);
    in_motion(Injection { corrupt_force: true, ..NOTHING }, Fault::ForceSensor, within..=within);
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn one_reset_of_the_force_converter_is_counted_and_survived() {
    let (bench, mut client) = bench(RigConfig::default());
    let reset = Injection { force_reset: true, ..NOTHING };
    bench.rig().inject_when(Trigger::Driving { for_periods: 100 }, reset);
    start(&mut client, &[move_y(800, 1_000)]);
    eventually("the program ends", || client.status().unwrap().state == State::Idle);
    let counters = client.status().unwrap().counters;
    assert_eq!((counters.force_resets, counters.force_readings_bad, counters.faults), (1, 1, 0));
    drop(client);
    bench.stop().unwrap();
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn the_force_exceeds_the_sensors_range() {
    let spike = Injection { force_spike_n: Some([0.0, -9.0]), ..NOTHING };
    in_motion(spike, Fault::ForceRange, 2..=2);
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn the_force_converter_saturates() {
    in_motion(Injection { force_saturated: Some(0), ..NOTHING }, Fault::ForceRange, 2..=2);
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_force_spike_exceeds_the_limit() {
    let (bench, mut client) = bench(RigConfig::default());
    start(&mut client, &[move_y(0, 2_000), Step::Tare { duration_ms: 200 }]);
    eventually("the force is zero", || client.status().unwrap().state == State::Idle);
    client.request(Request::Limits { force_mn: 2_500, silence_ms: SILENCE_MS }).unwrap();
    let spike = Injection { force_spike_n: Some([2.6, 0.0]), ..NOTHING };
    bench.rig().inject_when(Trigger::Driving { for_periods: 100 }, spike);
    start(&mut client, &[move_y(1_000, 1_000)]);
    await_fault(&mut client, Fault::ForceLimit);
    assert_released(&bench, 2..=2);
    clears_only_without_the_cause(&bench, &mut client);
    drop(client);
    bench.stop().unwrap();
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn the_force_converter_is_stuck() {
    // The last good reading is the first of the equal ones.
    let within = u64::from(STUCK_LIMIT_READINGS);
    in_motion(Injection { force_stuck: true, ..NOTHING }, Fault::ForceStuck, within..=within + 1);
}
