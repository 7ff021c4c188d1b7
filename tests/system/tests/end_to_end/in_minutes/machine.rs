//! The machine under the firmware when it fails: resets, slow conversions, a slow line. Other tests check the
//! firmware's response.

use device::link::{Client, Telemetry};
use protocol::Request;
use simulation::rig::config::RigConfig;
use std::thread;
use std::time::{Duration, Instant};
use system::bench::Bench;
use system::cosim::{Injection, Trigger};
use system::qemu::HANGS;

/// Rig seconds per second.
const SPEED: f64 = 4.0;

/// A simulated rig at a pace that a small machine keeps.
pub fn bench(seed: u64) -> Bench {
    Bench::start(RigConfig::default(), seed, SPEED, HANGS).unwrap()
}

fn eventually(what: &str, mut holds: impl FnMut() -> bool) {
    let began = Instant::now();
    while !holds() {
        assert!(began.elapsed() < HANGS, "never: {what}");
        thread::sleep(Duration::from_millis(10));
    }
}

/// Waits until so many periods have passed; returns how many really have.
fn pass(bench: &Bench, periods: u64) -> u64 {
    let start_step = bench.rig().steps();
    eventually("time goes on", || bench.rig().steps() >= start_step + periods);
    bench.rig().steps() - start_step
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_supply_that_sags_starts_the_firmware_again_with_the_same_rig() {
    let bench = bench(31);
    let boot_id = Client::connect(&bench.port()).unwrap().boot_id();
    let injection_step = bench.rig().steps() + 50;
    let sag = Injection { brown_out: true, ..Injection::default() };
    bench.rig().inject_when(Trigger::AtStep(injection_step), sag);
    eventually("the firmware starts again", || bench.rig().resets() == 1);
    assert_eq!(bench.rig().reaction().unwrap().injected_at_step, injection_step);
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
fn slow_conversions_cost_the_device_the_time_they_take() {
    let bench = bench(33);
    let mut client = Client::connect(&bench.port()).unwrap();
    let mut overruns = |conversion_us| {
        let overruns_before = client.status().unwrap().counters.control_overruns;
        bench.rig().inject(Injection { conversion_us, ..Injection::default() });
        pass(&bench, 60);
        bench.rig().inject(Injection::default());
        client.status().unwrap().counters.control_overruns - overruns_before
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
    let mut client = Client::connect(&bench.port()).unwrap();
    client.request(Request::Stream { enable: true }).unwrap();
    limit_line(Some(30_000), &bench);
    pass(&bench, 50);
    let (first_step, sent) = bench.rig().sent();
    pass(&bench, 200);
    let (last_step, sent_total) = bench.rig().sent();
    let (bytes, periods) = (sent_total - sent, last_step - first_step);
    // A byte may be on the line at either end; without a limit it would be thousands of bytes.
    assert!((3 * periods - 3..=3 * periods + 3).contains(&bytes), "{bytes} bytes in {periods} periods");
    limit_line(None, &bench);
    client.request(Request::Stream { enable: false }).unwrap();
    assert_eq!(client.losses(), Default::default(), "late is not lost");
    drop(client);
    bench.stop().unwrap();
}

fn limit_line(line_baud: Option<u32>, bench: &Bench) {
    bench.rig().inject(Injection { line_baud, ..Injection::default() })
}

/// Samples beyond the line's capacity are dropped in whole batches, each of which both ends count, and control does
/// not notice.
#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_line_too_slow_for_the_samples_drops_whole_batches() {
    let bench = bench(35);
    let mut client = Client::connect(&bench.port()).unwrap();
    client.request(Request::Stream { enable: true }).unwrap();
    let mut received = Vec::new();
    let mut receive = |client: &mut Client, periods: u64| {
        let end_step = bench.rig().steps() + periods;
        while bench.rig().steps() < end_step {
            if let Some(Telemetry::Samples(batch)) = client.next(Duration::from_millis(20)).unwrap() {
                received.push((batch.lost_before, batch.points));
            }
        }
    };
    receive(&mut client, 200);
    bench.rig().inject(Injection { line_baud: Some(22_000), ..Injection::default() });
    receive(&mut client, 4_000);
    bench.rig().inject(Injection::default());
    receive(&mut client, 1_000);
    let status = client.status().unwrap();
    client.request(Request::Stream { enable: false }).unwrap();
    let lost: u64 = received.iter().map(|(lost, _)| lost).sum();
    assert!((1_000..3_000).contains(&lost), "{lost} samples lost where half of 4000 fit");
    assert_eq!(u64::from(status.counters.samples_dropped), lost, "the device counts the same");
    assert_eq!((status.counters.control_overruns, status.counters.messages_dropped), (0, 0));
    let mut expected_s = received[0].1[0].time_s;
    for (lost, points) in &received {
        expected_s += *lost as f64 * 1e-3;
        for point in points {
            assert!((point.time_s - expected_s).abs() < 1e-6, "{} instead of {expected_s}", point.time_s);
            expected_s += 1e-3;
        }
    }
    drop(client);
    bench.stop().unwrap();
}
