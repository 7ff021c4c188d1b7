//! Emergency stop and force.

use super::*;
use control::campaign::sensors::{Effect, Failing, Pattern};
use control::limits::DOUBTFUL_READINGS;

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn the_emergency_stop_is_pressed() {
    in_motion(Injection { emergency_stop: true, ..NOTHING }, Fault::EmergencyStop, 1..=1);
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn the_force_converter_falls_silent() {
    let within = u64::from(DOUBTFUL_READINGS);
    in_motion(Injection { force_silent: true, ..NOTHING }, Fault::ForceSensor, within..=within);
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_converter_that_was_saturated_once_and_is_silent_then_is_no_load() {
    let within = u64::from(DOUBTFUL_READINGS);
    in_motion(
        Injection { force_saturated_once: Some(0), ..NOTHING },
        Fault::ForceSensor,
        within..=within + 1,
    );
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn the_force_converters_frames_are_corrupt() {
    let within = u64::from(DOUBTFUL_READINGS);
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
    let within = u64::from(DOUBTFUL_READINGS);
    in_motion(Injection { force_stuck: true, ..NOTHING }, Fault::ForceStuck, within..=within + 1);
}

/// Along y, in motion into the tissue.
fn failing(effect: Effect, pattern: Pattern) -> Injection {
    Injection { force_fails: Some(Failing { effect, pattern, channels: [false, true] }), ..NOTHING }
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn the_force_converter_is_stuck_but_for_its_last_bit() {
    let within = u64::from(DOUBTFUL_READINGS);
    in_motion(failing(Effect::LastBit, Pattern::AllButOneOf(0)), Fault::ForceStuck, within - 1..=within + 1);
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_converter_that_saturates_in_every_second_reading_is_a_load() {
    in_motion(failing(Effect::Saturated, Pattern::AllButOneOf(2)), Fault::ForceRange, 3..=4);
}

/// Into the tissue with a limit of 2 N, while the channel along y drops to zero in every second, two of three or most readings.
#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_force_channel_that_drops_to_zero_now_and_then_hides_no_load() {
    for pattern in [Pattern::AllButOneOf(2), Pattern::AllButOneOf(3), Pattern::Percent(80)] {
        let (bench, mut client) = bench(RigConfig::default());
        client.request(Request::Limits { force_mn: 2_000, silence_ms: SILENCE_MS }).unwrap();
        let trigger = Trigger::Beyond { axis: 1, position_mm: 0.5 };
        bench.rig().inject_when(trigger, failing(Effect::Zero, pattern));
        assert_eq!(ended(&mut client, &[move_y(6_000, 5_000)]), Outcome::Faulted);
        let fault = client.status().unwrap().fault;
        assert!(
            matches!(fault, Some(Fault::ForceStuck | Fault::ForceSensor | Fault::ForceLimit)),
            "{fault:?}"
        );
        let most_n = bench.rig().take_reach().force_n;
        println!("{pattern:?}: {fault:?}, at most {most_n} N");
        assert!(most_n < 2.0 + 0.48 * 1.3 + 0.1, "{most_n} N under {pattern:?}");
        drop(client);
        bench.stop().unwrap();
    }
}

/// Further into the tissue while the mains hums as in the simulated rig's own example: a retreat gets out.
#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn hum_does_not_keep_a_load_beyond_the_range() {
    let (bench, mut client) = bench(RigConfig::default());
    client.request(Request::Limits { force_mn: 5_000, silence_ms: SILENCE_MS }).unwrap();
    assert_eq!(ended(&mut client, &[move_y(9_000, 2_000)]), Outcome::Faulted);
    bench.rig().inject(Injection { hum_n: 0.1, ..NOTHING });
    client.request(Request::Retreat { x_um: 0, y_um: -1_000 }).unwrap();
    let outcome = until(&mut client, |kind| match kind {
        EventKind::RetreatEnded { outcome } => Some(outcome),
        _ => None,
    });
    assert_eq!(outcome, protocol::RetreatOutcome::Unloaded);
    eventually("the fault is cleared", || client.request(Request::ClearFault).is_ok());
    drop(client);
    bench.stop().unwrap();
}
