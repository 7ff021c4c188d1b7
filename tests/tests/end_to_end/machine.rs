//! The machine under the firmware when it fails: resets, slow conversions, a slow line. What the firmware makes of it is
//! tested elsewhere.

use firmware::plant::NEVER;
use host::link::Client;
use host::rig::config::RigConfig;
use protocol::{Request, ResetReason};
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};
use tests::bench::Bench;
use tests::cosim::{Injection, Trigger};
use tests::wire::{Direction, NoisyWire};

/// Everything ends after this, whatever hangs.
const LIMIT: Duration = Duration::from_secs(60);
/// Rig seconds per second.
const SPEED: f64 = 4.0;

fn bench(seed: u64) -> Bench {
    Bench::start(RigConfig::default(), seed, SPEED, LIMIT).unwrap()
}

/// Patient: a device that spins on a register takes the computer far longer than one that sleeps.
fn eventually(what: &str, mut holds: impl FnMut() -> bool) {
    let began = Instant::now();
    while !holds() {
        assert!(began.elapsed() < Duration::from_secs(40), "never: {what}");
        thread::sleep(Duration::from_millis(10));
    }
}

/// Waits until so many periods have passed; returns how many really have.
fn pass(bench: &Bench, periods: u64) -> u64 {
    let from = bench.rig().steps();
    eventually("time goes on", || bench.rig().steps() >= from + periods);
    bench.rig().steps() - from
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_supply_that_sags_starts_the_firmware_again_with_the_same_rig() {
    let bench = bench(31);
    let boot_id = Client::connect(&bench.port()).unwrap().boot_id();
    let at = bench.rig().steps() + 50;
    let sag = Injection { brown_out: true, ..Injection::default() };
    bench.rig().inject_when(Trigger::AtStep(at), sag);
    eventually("the firmware starts again", || bench.rig().resets() == 1);
    assert_eq!(bench.rig().reaction().unwrap().injected_at_step, at);
    pass(&bench, 200);
    let mut client = Client::connect(&bench.port()).unwrap();
    assert_ne!(client.boot_id(), boot_id);
    client.status().unwrap();
    assert_eq!(bench.rig().resets(), 1, "once");
    drop(client);
    bench.stop().unwrap();
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_conversion_that_never_ends_is_ended_by_the_watchdog() {
    let bench = bench(32);
    bench.rig().inject(Injection { conversion_us: NEVER, ..Injection::default() });
    let from = bench.rig().steps();
    eventually("the watchdog resets", || bench.rig().resets() == 1);
    let periods = bench.rig().steps() - from;
    // It was fed up to 100 ms before, waits 500 ms, and the test looks every 40 ms of the rig's time.
    assert!((380..700).contains(&periods), "reset after {periods} ms");
    bench.rig().inject(Injection::default());
    let client = Client::connect(&bench.port()).unwrap();
    assert_eq!(client.hello().reset_reason, ResetReason::Watchdog);
    drop(client);
    bench.stop().unwrap();
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn slow_conversions_cost_the_device_the_time_they_take() {
    let bench = bench(33);
    let mut client = Client::connect(&bench.port()).unwrap();
    let mut overruns = |conversion_us| {
        let before = client.status().unwrap().counters.control_overruns;
        bench.rig().inject(Injection { conversion_us, ..Injection::default() });
        pass(&bench, 60);
        bench.rig().inject(Injection::default());
        client.status().unwrap().counters.control_overruns - before
    };
    // The driver converts four times per period.
    assert_eq!(overruns(200), 0, "800 us fit in");
    assert!(overruns(400) > 10, "1600 us do not");
    drop(client);
    bench.stop().unwrap();
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn the_line_carries_no_more_than_its_rate() {
    let bench = bench(34);
    let wire = NoisyWire::connect(Path::new(&bench.port()), 1).unwrap();
    let mut client = Client::connect(&wire.port()).unwrap();
    client.request(Request::Stream { enable: true }).unwrap();
    let carried = || wire.counters(Direction::ToHost).bytes;
    let line = |line_bytes| bench.rig().inject(Injection { line_bytes, ..Injection::default() });
    line(Some(3));
    pass(&bench, 50);
    let from = carried();
    let periods = pass(&bench, 200);
    let bytes = carried() - from;
    // Up to 20 ms of the rig pass between looking at the two counters.
    assert!((3 * periods - 60..=3 * periods + 60).contains(&bytes), "{bytes} bytes in {periods} periods");
    line(None);
    client.request(Request::Stream { enable: false }).unwrap();
    assert_eq!(client.losses(), Default::default(), "late is not lost");
    drop(client);
    bench.stop().unwrap();
}
