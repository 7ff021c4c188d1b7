//! A line that is nearly full, for most of a minute of the device's time.

use crate::in_minutes::machine::bench;
use device::link::Client;
use device::link::Telemetry;
use protocol::Request;
use std::time::Duration;
use system::cosim::{BITS_PER_BYTE, Injection};

#[test]
#[ignore = "needs QEMU: cargo xtask test --all runs it"]
fn a_line_filled_to_nine_tenths_loses_nothing() {
    let bench = bench(36);
    let mut client = Client::connect(&bench.port()).unwrap();
    client.request(Request::Stream { enable: true }).unwrap();
    let (mut samples, mut lost) = (0, 0);
    // Bytes and periods while it receives.
    let mut receive = |client: &mut Client, periods: u64| {
        let (first_step, sent) = bench.rig().sent();
        while bench.rig().steps() < first_step + periods {
            if let Some(Telemetry::Samples(batch)) = client.next(Duration::from_millis(20)).unwrap() {
                (samples, lost) = (samples + batch.points.len() as u64, lost + batch.lost_before);
            }
        }
        let (last_step, sent_total) = bench.rig().sent();
        (sent_total - sent, last_step - first_step)
    };
    let (bytes, periods) = receive(&mut client, 4_000);
    let needed_baud = (bytes * u64::from(BITS_PER_BYTE) * 1_000).div_ceil(periods) as u32;
    let line_baud = needed_baud * 100 / 96;
    bench.rig().inject(Injection { line_baud: Some(line_baud), ..Injection::default() });
    let (bytes, periods) = receive(&mut client, 40_000);
    let used_fraction =
        (bytes * u64::from(BITS_PER_BYTE) * 1_000) as f64 / periods as f64 / f64::from(line_baud);
    let counters = client.status().unwrap().counters;
    bench.rig().inject(Injection::default());
    client.request(Request::Stream { enable: false }).unwrap();
    assert!((0.9..1.0).contains(&used_fraction), "{used_fraction} of {line_baud} baud are used");
    assert!(samples > 43_000, "{samples} samples");
    assert_eq!(
        (lost, counters.samples_dropped, counters.messages_dropped),
        (0, 0, 0),
        "at {used_fraction} of {line_baud} baud"
    );
    assert_eq!(client.losses(), Default::default());
    drop(client);
    bench.stop().unwrap();
}
