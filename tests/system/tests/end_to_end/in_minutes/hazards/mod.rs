//! Every hazard of the interlock's table, from its cause: the simulated rig reads false, jams or sags, the link is cut, the host is
//! silent or mad. Each test asserts how many periods pass until both bridges are off, what is sent on the wire, that nothing is
//! driven afterwards, and what it takes to clear the fault.

mod calibrations;
mod force;
mod limits;
mod link;
mod motion;
mod pulse;
mod time;

use super::library::eventually;
use control::mutation::Mutation;
use device::link::error::fault_text;
use device::link::{Client, LinkError, Telemetry};
use protocol::{EventKind, Fault, Outcome, Refusal, Request, State, Step, program_crc};
use simulation::rig::config::RigConfig;
use std::time::{Duration, Instant};
use system::bench::Bench;
use system::cosim::{Injection, Trigger};
use system::qemu::HANGS;
use system::wire::NoisyWire;

/// Rig seconds per second: what a small machine can do, and no more than it can do evenly.
const SPEED: f64 = 8.0;
/// The host's silence that the tests allow: long enough for a test that is not scheduled for a while.
const SILENCE_MS: u32 = 20_000;
/// Injections at their end.
const NOTHING: Injection = Injection {
    emergency_stop: false,
    corrupt_force: false,
    force_silent: false,
    force_reset: false,
    force_stuck: false,
    force_spike_n: None,
    force_saturated: None,
    force_saturated_once: None,
    potentiometer_open: None,
    potentiometer_short: None,
    potentiometer_jump_codes: [0; 2],
    force_fails: None,
    potentiometers_fail: None,
    hum_n: 0.0,
    jammed: None,
    weak: None,
    runaway: None,
    conversion_us: 0,
    line_baud: None,
    brown_out: false,
    panic: false,
    stack_overflow: false,
    driver_panic: false,
    freeze: false,
    for_periods: None,
};

/// A rig whose needle is too soft to be felt, so that the guide can go as far as it can.
pub fn unloaded() -> RigConfig {
    let mut config = RigConfig::default();
    config.simulation.force.share_of_full_scale *= 0.01;
    // The converter's own noise stays: without it the readings would repeat.
    config.simulation.force.noise_n *= 100.0;
    config
}

/// A rig, and a client with limits that the tests want.
pub fn bench(config: RigConfig) -> (Bench, Client) {
    let bench = Bench::start(config, 41, SPEED, HANGS).unwrap();
    let mut client = Client::connect(&bench.port()).unwrap();
    client.request(Request::Limits { force_mn: 4_000, silence_ms: SILENCE_MS }).unwrap();
    (bench, client)
}

/// Loads a program; the request that runs it.
fn load(client: &mut Client, steps: &[Step], start_us: u64) -> Request {
    for (index, step) in (0..).zip(steps) {
        client.request(Request::LoadStep { index, step: *step }).unwrap();
    }
    Request::Run { steps: steps.len() as u8, crc: program_crc(steps), start_us }
}

/// Starts a program.
pub fn start(client: &mut Client, steps: &[Step]) {
    let run = load(client, steps, 0);
    client.request(run).unwrap();
}

/// Runs a program to its end.
fn ended(client: &mut Client, steps: &[Step]) -> Outcome {
    start(client, steps);
    until(client, |kind| match kind {
        EventKind::ProgramEnded { outcome } => Some(outcome),
        _ => None,
    })
}

/// Waits for an event of the device.
fn until<T>(client: &mut Client, mut found: impl FnMut(EventKind) -> Option<T>) -> T {
    let began = Instant::now();
    loop {
        assert!(began.elapsed() < HANGS, "no such event");
        client.request_status().unwrap();
        if let Some(Telemetry::Event(event)) = client.next(Duration::from_millis(100)).unwrap()
            && let Some(value) = found(event.kind)
        {
            return value;
        }
    }
}

fn refusal(outcome: Result<(), LinkError>) -> Refusal {
    match outcome {
        Err(LinkError::Refused { refusal, .. }) => refusal,
        other => panic!("not refused: {other:?}"),
    }
}

fn move_y(y_um: i32, speed_um_s: u32) -> Step {
    Step::Move { x_um: 0, y_um, speed_um_s }
}

/// Waits for the fault; its device time by its event, seconds.
pub fn await_fault(client: &mut Client, fault: Fault) -> f64 {
    let began = Instant::now();
    let mut fault_s = None;
    while client.status().unwrap().state != State::Faulted {
        assert!(began.elapsed() < HANGS, "no fault");
    }
    while let Some(telemetry) = client.waiting() {
        if let Telemetry::Event(event) = telemetry
            && let EventKind::Faulted { fault: reported } = event.kind
        {
            assert_eq!((reported, fault_s), (fault, None));
            fault_s = Some(event.t_us as f64 * 1e-6);
        }
    }
    assert_eq!(client.status().unwrap().fault, Some(fault));
    fault_s.expect("the fault is reported once, as it happens")
}

/// Asserts that the bridges went off in time and stayed off, and prints how soon.
fn assert_released(bench: &Bench, within: std::ops::RangeInclusive<u64>) {
    let start_step = bench.rig().steps();
    eventually("time passes", || bench.rig().steps() > start_step + 200);
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

/// Every test of a hazard, and the unit tests of faults that take too long here.
fn tests_of_hazards() -> String {
    [
        include_str!("calibrations.rs"),
        include_str!("force.rs"),
        include_str!("limits.rs"),
        include_str!("link.rs"),
        include_str!("motion.rs"),
        include_str!("pulse.rs"),
        include_str!("time.rs"),
        include_str!("../../at_length/hazards.rs"),
        include_str!("../../../../../../firmware/control/src/tests/findings.rs"),
        include_str!("../../../../../sequences/tests/patterns.rs"),
    ]
    .concat()
}

/// The cells of a Markdown table's row.
fn cells(row: &str) -> Vec<&str> {
    row.trim_start_matches("//!").trim().trim_matches('|').split('|').map(str::trim).collect()
}

fn names_tests(cell: &str, row: &str) {
    let tests = tests_of_hazards();
    for test in cell.split(", ") {
        let name = test.trim_matches('`');
        assert!(tests.contains(&format!("fn {name}()")), "no test {name}: {row}");
    }
}

/// The table of hazards names these tests and no others.
#[test]
fn every_row_of_the_table_of_hazards_has_its_tests() {
    let table = include_str!("../../../../../../firmware/control/src/interlock.rs");
    let rows: Vec<_> =
        table.lines().filter(|line| line.starts_with("//! | ") && line.contains("| `")).collect();
    assert_eq!(rows.len(), Fault::ALL.len());
    for (fault, row) in Fault::ALL.into_iter().zip(rows) {
        let cells = cells(row);
        assert_eq!(cells[..2], [(fault as u8).to_string(), format!("`{fault:?}`")], "{row}");
        names_tests(cells[5], row);
    }
}

/// The protocol's chapter has the recovery from every fault, with the cause that the program prints and the test that carries it out.
#[test]
fn every_fault_has_a_recovery_that_a_test_carries_out() {
    let chapter = include_str!("../../../../../../protocol/spec/protocol.md");
    for fault in Fault::ALL {
        let begins = format!("| {} | `{fault:?}` | ", fault as u8);
        let row = chapter.lines().find(|line| line.starts_with(&begins));
        let row = row.unwrap_or_else(|| panic!("no row of {fault:?}"));
        let cells = cells(row);
        assert_eq!(cells.len(), 5, "{row}");
        assert_eq!(cells[2], fault_text(fault).cause, "{row}");
        assert!(cells[3].contains("`ClearFault`") || fault == Fault::CalibrationLost, "{row}");
        names_tests(cells[4], row);
    }
}

/// Each safety measure that tests can disable names the tests through QEMU of what it prevents.
#[test]
fn every_safety_measure_has_a_test_through_qemu() {
    let table = include_str!("../../../../../../firmware/control/src/mutation.rs");
    for measure in Mutation::ALL {
        let begins = format!("//! | `{measure:?}` | ");
        let row = table.lines().find(|line| line.starts_with(&begins));
        let row = row.unwrap_or_else(|| panic!("no row of {measure:?}"));
        names_tests(cells(row)[2], row);
    }
}
