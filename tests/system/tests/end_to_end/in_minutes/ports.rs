//! Ports that do not work: `guide` reports it in one line and fails.

use protocol::{
    Command as ToDevice, CommandReceiver, Envelope, Hello, MAX_FRAME_TO_HOST, Message, Received, ResetReason,
    Scales, Text, encode_envelope,
};
use serialport::{SerialPort, TTYPort};
use simulation::rig::config::RigConfig;
use std::io::{Read, Write};
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use system::bench::Bench;
use system::images::build_guide;
use system::qemu::HANGS;

/// Runs `guide status`, which must fail; returns its message.
fn status_fails(port: &str) -> String {
    let output = Command::new(build_guide().unwrap()).args(["status", "--port", port]).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(output.stdout.is_empty());
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(message.lines().count(), 1, "{message}");
    assert!(message.starts_with("error: ") && message.contains(port), "{message}");
    message
}

/// Does something with a pty's far end while `guide` tries the near one.
fn with_far_end(answer: impl Fn(&ToDevice) -> Option<Envelope> + Send + Sync) -> String {
    let (mut far_port, near_port) = TTYPort::pair().unwrap();
    let port = near_port.name().unwrap();
    // `guide` opens the near end by its name; until then the far one reads errors.
    drop(near_port);
    far_port.set_timeout(Duration::from_millis(20)).unwrap();
    let is_finished = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let mut receiver = CommandReceiver::new();
            let mut bytes = [0; 64];
            while !is_finished.load(Ordering::Acquire) {
                let Ok(length) = far_port.read(&mut bytes) else {
                    std::thread::sleep(Duration::from_millis(2));
                    continue;
                };
                for received in receiver.feed(&bytes[..length]) {
                    let Received::Frame(command) = received else { continue };
                    if let Some(envelope) = answer(&command) {
                        let mut buffer = [0; MAX_FRAME_TO_HOST];
                        far_port.write_all(encode_envelope(&envelope, &mut buffer).unwrap()).unwrap();
                    }
                }
            }
        });
        let message = status_fails(&port);
        is_finished.store(true, Ordering::Release);
        message
    })
}

fn hello(protocol_version: u16, schema_hash: [u8; 8]) -> Option<Envelope> {
    let hello = Hello {
        protocol_version,
        schema_hash,
        firmware_version: Text::new("9.9.9"),
        commit: Text::new("abcdef"),
        board: Text::new("fake"),
        reset_reason: ResetReason::PowerOn,
        tick_hz: 1_000_000,
        now_us: 1,
        sample_period_us: 1_000,
        scales: Scales { position_nm_per_count: 1, force_nn_per_count: 1, travel_um: 1, force_range_mn: 1 },
        calibration: Default::default(),
        last_panic: None,
    };
    Some(Envelope { boot_id: 1, sequence: 0, message: Message::Hello(hello) })
}

#[test]
#[ignore = "builds guide: cargo xtask test runs it"]
fn a_port_that_is_not_there() {
    let message = status_fails("/dev/no-such-port");
    assert!(message.contains("no such port"), "{message}");
}

#[test]
#[ignore = "builds guide: cargo xtask test runs it"]
fn a_port_that_does_not_answer() {
    let message = with_far_end(|_| None);
    assert!(message.contains("no answer"), "{message}");
}

#[test]
#[ignore = "builds guide: cargo xtask test runs it"]
fn a_device_of_another_protocol_version() {
    let message = with_far_end(|_| hello(protocol::VERSION + 1, protocol::schema_hash()));
    assert!(message.contains(&format!("protocol version {}", protocol::VERSION + 1)), "{message}");
}

#[test]
#[ignore = "builds guide: cargo xtask test runs it"]
fn a_device_with_other_message_types() {
    let message = with_far_end(|_| hello(protocol::VERSION, protocol::schema_hash().map(|byte| !byte)));
    assert!(message.contains("message types differ"), "{message}");
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_port_in_use() {
    let bench = Bench::at_terminal(RigConfig::default(), 31, 4.0, HANGS).unwrap();
    let port = bench.port();
    let first_client = device::link::Client::connect(&port).unwrap();
    let message = status_fails(&port);
    assert!(message.contains("in use by another program"), "{message}");
    drop(first_client);
    bench.stop().unwrap();
}
