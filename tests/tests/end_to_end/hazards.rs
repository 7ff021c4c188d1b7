//! Every hazard of the interlock's table, from its cause: the simulated rig lies, jams or sags, the link is cut, the host is
//! silent or mad. Each test asserts how many periods pass until both bridges are off, what is said on the wire, that nothing is
//! driven afterwards, and what it takes to clear the fault.

use super::library::eventually;
use firmware::control::interlock::{STALE_LIMIT_PERIODS, STUCK_LIMIT_READINGS};
use firmware::control::motor::{ON_LIMIT_PERIODS, STALL_PERIODS};
use firmware::plant::NEVER;
use host::link::{Client, LinkError, Telemetry};
use host::rig::config::RigConfig;
use protocol::{EventKind, Fault, Refusal, Request, ResetReason, State, Step, program_crc};
use std::time::{Duration, Instant};
use tests::bench::Bench;
use tests::cosim::{Injection, Trigger};
use tests::wire::NoisyWire;

/// Everything ends after this, whatever hangs: the longest takes 70 s of the device's time.
const LIMIT: Duration = Duration::from_secs(300);
/// Rig seconds per second: what a small machine can do, and no more than it can do evenly.
const SPEED: f64 = 8.0;
/// The host's silence that the tests allow: long enough for a test that is not scheduled for a while.
const SILENCE_MS: u32 = 20_000;
/// What injections do when they are over.
const NOTHING: Injection = Injection {
    emergency_stop: false,
    corrupt_force: false,
    force_silent: false,
    force_reset: false,
    force_stuck: false,
    force_spike_n: None,
    force_saturated: None,
    potentiometer_open: None,
    potentiometer_short: None,
    potentiometer_jump_codes: [0; 2],
    jammed: None,
    weak: None,
    runaway: None,
    conversion_us: 0,
    line_bytes: None,
    brown_out: false,
    panic: false,
    freeze: false,
};

/// A rig whose needle is too soft to be felt, so that the guide can go as far as it can.
fn unloaded() -> RigConfig {
    let mut config = RigConfig::default();
    config.simulation.force.share_of_full_scale *= 0.01;
    config
}

fn bench(config: RigConfig) -> (Bench, Client) {
    let bench = Bench::start(config, 41, SPEED, LIMIT).unwrap();
    let mut client = Client::connect(&bench.port()).unwrap();
    client.request(Request::Limits { force_mn: 4_000, silence_ms: SILENCE_MS }).unwrap();
    (bench, client)
}

fn start(client: &mut Client, steps: &[Step]) {
    for (index, step) in (0..).zip(steps) {
        client.request(Request::LoadStep { index, step: *step }).unwrap();
    }
    client.request(Request::Run { steps: steps.len() as u8, crc: program_crc(steps), start_us: 0 }).unwrap();
}

fn move_y(y_um: i32, speed_um_s: u32) -> Step {
    Step::Move { x_um: 0, y_um, speed_um_s }
}

/// Waits for the fault; the event that tells it has its device time, seconds.
fn await_fault(client: &mut Client, fault: Fault) -> f64 {
    let began = Instant::now();
    let mut told_s = None;
    while client.status().unwrap().state != State::Faulted {
        assert!(began.elapsed() < LIMIT / 2, "no fault");
    }
    while let Some(telemetry) = client.waiting() {
        if let Telemetry::Event(event) = telemetry
            && let EventKind::Faulted { fault: told } = event.kind
        {
            assert_eq!((told, told_s), (fault, None));
            told_s = Some(event.t_us as f64 * 1e-6);
        }
    }
    assert_eq!(client.status().unwrap().fault, Some(fault));
    told_s.expect("the fault is told once, as it happens")
}

/// Asserts that the bridges went off in time and stayed off, and says how soon.
fn assert_released(bench: &Bench, within: std::ops::RangeInclusive<u64>) {
    let since = bench.rig().steps();
    eventually("time passes", || bench.rig().steps() > since + 200);
    let reaction = bench.rig().reaction().expect("something was injected");
    let periods = reaction.periods().expect("the bridges are off");
    println!("bridges off after {periods} periods");
    assert!(within.contains(&periods), "{periods} periods, expected {within:?}");
    assert_eq!(reaction.driven_after_release, 0, "driven again");
}

/// Refused while the cause is there; cleared without it, and nothing moves by itself.
fn clears_only_without_the_cause(bench: &Bench, client: &mut Client) {
    let refusal = client.request(Request::ClearFault).unwrap_err();
    assert!(matches!(refusal, LinkError::Refused { refusal: Refusal::CauseRemains, .. }), "{refusal}");
    clears(bench, client);
}

fn clears(bench: &Bench, client: &mut Client) {
    bench.rig().inject(NOTHING);
    eventually("the fault is cleared", || client.request(Request::ClearFault).is_ok());
    assert_eq!(client.status().unwrap().state, State::Idle);
    assert!(!bench.rig().bridges_driven());
}

/// The whole of it for a cause that appears while the guide moves and stays.
fn in_motion(injection: Injection, fault: Fault, within: std::ops::RangeInclusive<u64>) {
    let (bench, mut client) = bench(RigConfig::default());
    bench.rig().inject_when(Trigger::Driving { for_periods: 100 }, injection);
    start(&mut client, &[move_y(2_500, 1_000)]);
    await_fault(&mut client, fault);
    assert_released(&bench, within);
    clears_only_without_the_cause(&bench, &mut client);
    drop(client);
    bench.stop().unwrap();
}

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
    // The new reading is as good as any: only the jump itself tells, and it is over.
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
fn a_runaway_axis_leaves_its_travel() {
    let (bench, mut client) = bench(unloaded());
    let runaway = Injection { runaway: Some((1, 1.0)), ..NOTHING };
    bench.rig().inject_when(Trigger::Beyond { axis: 1, position_mm: 9.7 }, runaway);
    start(&mut client, &[move_y(9_900, 4_000)]);
    await_fault(&mut client, Fault::Travel);
    // From 9.7 mm to 0.2 mm beyond the 10 mm at 20 mm/s are 25 periods; the motor gathers speed and the bridge is beyond help.
    assert_released(&bench, 10..=60);
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

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn the_force_converter_is_stuck() {
    // The last good reading is the first of the equal ones.
    let within = u64::from(STUCK_LIMIT_READINGS);
    in_motion(Injection { force_stuck: true, ..NOTHING }, Fault::ForceStuck, within..=within + 1);
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn the_host_is_killed() {
    let (bench, mut client) = bench(RigConfig::default());
    client.request(Request::Limits { force_mn: 4_000, silence_ms: 1_500 }).unwrap();
    start(&mut client, &[move_y(1_000, 2_000), Step::Hold { duration_ms: 600_000 }]);
    // The time of a status is that of the period in which its question was heard.
    let heard_us = client.status().unwrap().t_us;
    let began = Instant::now();
    let told_us = loop {
        assert!(began.elapsed() < LIMIT / 2, "no fault");
        if let Some(Telemetry::Event(event)) = client.next(Duration::from_millis(100)).unwrap()
            && event.kind == (EventKind::Faulted { fault: Fault::HostSilent })
        {
            break event.t_us;
        }
    };
    assert_eq!(told_us - heard_us, 1_501_000, "the first period after the time that is set");
    eventually("the bridges are off", || !bench.rig().bridges_driven());
    clears(&bench, &mut client);
    drop(client);
    bench.stop().unwrap();
}

/// A program runs, and then the link has these troubles: the device stops, and tells when it is heard again.
fn without_a_host(trouble: impl FnOnce(&NoisyWire)) -> protocol::Counters {
    let (bench, client) = bench(RigConfig::default());
    drop(client);
    let wire = NoisyWire::connect(&bench.folder().join("serial"), 5).unwrap();
    let mut client = Client::connect(&wire.port()).unwrap();
    client.request(Request::Limits { force_mn: 4_000, silence_ms: 1_500 }).unwrap();
    start(&mut client, &[move_y(1_000, 2_000), Step::Hold { duration_ms: 600_000 }]);
    let heard_us = client.status().unwrap().t_us;
    trouble(&wire);
    eventually("the silence is long", || bench.rig().steps() * 1_000 > heard_us + 2_500_000);
    assert!(!bench.rig().bridges_driven());
    wire.babble(0.0);
    wire.mend();
    eventually("it is heard again", || client.status().is_ok());
    let status = client.status().unwrap();
    assert_eq!((status.state, status.fault), (State::Faulted, Some(Fault::HostSilent)));
    drop(client);
    drop(wire);
    bench.stop().unwrap();
    status.counters
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn the_link_is_cut() {
    let counters = without_a_host(NoisyWire::cut);
    assert_eq!((counters.control_overruns, counters.faults), (0, 1));
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_babbling_host_is_no_host() {
    let counters = without_a_host(|wire| wire.babble(2.0));
    assert!(counters.frames_corrupt + counters.frames_overlong > 0, "{counters:?}");
    assert_eq!((counters.control_overruns, counters.faults), (0, 1));
}

/// The device restarts in mid-motion: it says why, drives nothing, and has the fault acknowledged before it moves again.
fn restarts(injection: Injection, within: std::ops::RangeInclusive<u64>) -> protocol::Hello {
    let (bench, mut client) = bench(RigConfig::default());
    bench.rig().inject_when(Trigger::Driving { for_periods: 100 }, injection);
    start(&mut client, &[move_y(2_500, 1_000)]);
    eventually("the device restarts", || bench.rig().resets() > 0);
    bench.rig().inject(NOTHING);
    drop(client);
    let mut client = None;
    eventually("it answers again", || {
        client = Client::connect(&bench.port()).ok();
        client.is_some()
    });
    let mut client = client.unwrap();
    assert_released(&bench, within);
    let status = client.status().unwrap();
    assert_eq!((status.state, status.fault), (State::Faulted, Some(Fault::Restarted)));
    let run = client.request(Request::Run { steps: 1, crc: 0, start_us: 0 }).unwrap_err();
    let faulted = Refusal::Faulted { fault: Fault::Restarted };
    assert!(matches!(run, LinkError::Refused { refusal, .. } if refusal == faulted), "{run}");
    clears(&bench, &mut client);
    let hello = client.hello().clone();
    drop(client);
    bench.stop().unwrap();
    hello
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_control_task_that_hangs_is_reset() {
    // The watchdog's 4 ms, from the last period that ended.
    let hello = restarts(Injection { conversion_us: NEVER, ..NOTHING }, 4..=6);
    assert_eq!((hello.reset_reason, hello.last_panic), (ResetReason::Watchdog, None));
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn the_supply_sags_in_mid_motion() {
    let hello = restarts(Injection { brown_out: true, ..NOTHING }, 1..=2);
    assert_eq!((hello.reset_reason, hello.last_panic), (ResetReason::BrownOut, None));
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_panic_restarts_and_is_told() {
    let hello = restarts(Injection { panic: true, ..NOTHING }, 1..=2);
    assert_eq!(hello.reset_reason, ResetReason::Software);
    let told = hello.last_panic.expect("the panic is told");
    assert!(told.contains(".rs:") && told.contains("the plant asks for a panic"), "{told}");
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_slow_converter_makes_control_late() {
    let (bench, mut client) = bench(RigConfig::default());
    let slow = Injection { conversion_us: 700, ..NOTHING };
    bench.rig().inject_when(Trigger::Driving { for_periods: 100 }, slow);
    start(&mut client, &[move_y(2_500, 1_000)]);
    // Nobody is heard while control takes all the time there is.
    let released = || bench.rig().reaction().is_some_and(|reaction| reaction.periods().is_some());
    eventually("the bridges are off", released);
    bench.rig().inject(NOTHING);
    await_fault(&mut client, Fault::Overrun);
    // Two conversions of 0.7 ms make a period 0.5 ms too long, so that every other one begins late, and the second is the fault.
    assert_released(&bench, 2..=12);
    clears(&bench, &mut client);
    assert!(client.status().unwrap().counters.control_overruns >= 2);
    drop(client);
    bench.stop().unwrap();
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_motor_that_never_rests_is_locked_out() {
    let (bench, mut client) = bench(unloaded());
    let to_and_fro: Vec<_> = (0..60)
        .map(|step| Step::Ramp { x_um: 0, y_um: if step % 2 == 0 { 900 } else { -900 }, duration_ms: 1_500 })
        .collect();
    let began_us = client.status().unwrap().t_us;
    start(&mut client, &to_and_fro);
    let hot_s = await_fault(&mut client, Fault::MotorHot);
    let driven_s = hot_s - began_us as f64 * 1e-6;
    let limit_s = f64::from(ON_LIMIT_PERIODS) * 1e-3;
    assert!((limit_s..limit_s + 10.0).contains(&driven_s), "locked out after {driven_s} s");
    assert!(!bench.rig().bridges_driven());
    let status = client.status().unwrap();
    assert_eq!(status.motor_budget_permille[1], 1_000);
    let refusal = client.request(Request::ClearFault).unwrap_err();
    assert!(matches!(refusal, LinkError::Refused { refusal: Refusal::CauseRemains, .. }), "{refusal}");
    drop(client);
    bench.stop().unwrap();
}

/// Half a minute of flipped bits, cuts and programs: see `cargo xtask stress` for longer.
#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_bad_cable_costs_samples_that_are_counted_and_nothing_else() {
    let args = tests::stress::Args { minutes: 0.4, bit_error_rate: 1e-4, seed: 3 };
    let survived = tests::stress::run(args).unwrap();
    println!("{survived}");
    assert!(survived.samples > 10_000 && survived.cuts > 0 && survived.programs > 0, "{survived}");
    assert!(survived.losses.frames_corrupt > 10 && survived.flipped_bits[1] > 10, "{survived}");
}

/// The table of hazards names these tests and no others.
#[test]
fn every_row_of_the_table_of_hazards_has_its_tests() {
    let table = include_str!("../../../firmware/src/control/interlock.rs");
    let here = include_str!("hazards.rs");
    let rows: Vec<_> =
        table.lines().filter(|line| line.starts_with("//! | ") && line.contains("| `")).collect();
    assert_eq!(rows.len(), Fault::ALL.len());
    for (fault, row) in Fault::ALL.into_iter().zip(rows) {
        let cells: Vec<_> = row.trim_start_matches("//!").split('|').map(str::trim).collect();
        assert_eq!(cells[1], (fault as u8).to_string(), "{row}");
        assert_eq!(cells[2], format!("`{fault:?}`"), "{row}");
        for test in cells[6].split(", ") {
            let name = test.trim_matches('`');
            assert!(here.contains(&format!("fn {name}()")), "{fault:?}: no test {name}");
        }
    }
}
