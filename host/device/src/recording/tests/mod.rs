//! Recordings that are written, cut, damaged, recovered and exported.

mod damage;
mod link;
mod written;

use super::transcript::Transcript;
use super::views::RecordingInfo;
use super::writer::Writer;
use fake_device as fake;
use noise::Noise;
use protocol::{
    CalibrationId, Command, Envelope, Event, EventKind, Fault, Hello, Message, Packer, Request, ResetReason,
    Sample, Scales, State, Tare, Text,
};
use std::fs;
use std::path::Path;

const PERIOD_US: u32 = 1_000;
const BOOT_ID: u32 = 0xA1B2_C3D4;
/// Host time at which the device sends its hello.
const HOST_NS: u64 = 1_700_000_000_000_000_000;
/// Device time at which it does.
const HELLO_US: u64 = 4_000_000;

fn hello() -> Hello {
    Hello {
        protocol_version: protocol::VERSION,
        schema_hash: protocol::schema_hash(),
        firmware_version: Text::new("0.1.0"),
        commit: Text::new("abc"),
        board: Text::new("test"),
        reset_reason: ResetReason::PowerOn,
        tick_hz: 1_000_000,
        now_us: HELLO_US,
        sample_period_us: PERIOD_US,
        scales: Scales {
            position_nm_per_count: 100,
            force_nn_per_count: 10_000,
            travel_um: 10_000,
            force_range_mn: 5_000,
        },
        calibration: CalibrationId { id: fake::calibration().id, crc: fake::calibration().crc() },
        last_panic: None,
    }
}

/// Messages of a device from its hello on: batches, ten statuses a second, an event of every kind. It never
/// ends.
struct Stream {
    noise: Noise,
    packer: Packer,
    sequence: u32,
    t_us: u64,
    events: Vec<EventKind>,
    next: Vec<Message>,
}

impl Stream {
    fn new() -> Self {
        let tare = Tare {
            zero_counts: [5, -6],
            sd_counts: [7, 8],
            drift_counts_per_s: [1, -1],
            periods: 1_000,
            readings: 999,
            unique_codes: [24, 24],
        };
        Self {
            noise: Noise::new(7),
            packer: Packer::new(PERIOD_US),
            sequence: 41,
            t_us: HELLO_US + 500,
            events: vec![
                EventKind::Faulted { fault: Fault::Stall },
                EventKind::ProgramEnded { outcome: protocol::Outcome::Completed },
                EventKind::Tared(tare),
                EventKind::StepEnded { index: 0 },
                EventKind::StepStarted { index: 0 },
            ],
            next: vec![Message::Ack { id: 3 }, Message::Hello(hello())],
        }
    }
}

impl Iterator for Stream {
    type Item = Envelope;

    fn next(&mut self) -> Option<Envelope> {
        while self.next.is_empty() {
            self.t_us += u64::from(PERIOD_US);
            let position = (3.0 * self.noise.normal()) as i32;
            let force = (100.0 * self.noise.normal()) as i32;
            let sample = Sample {
                position_counts: [position, 8_000 + position],
                force_counts: [force, 40_000 + force],
                repeats_force: false,
            };
            let closed = self.packer.push(self.t_us, State::Holding, 2, 0, sample);
            let period = self.t_us / u64::from(PERIOD_US);
            if period.is_multiple_of(100) {
                let status =
                    protocol::Status { t_us: self.t_us, state: State::Holding, step: 2, ..fake::status() };
                self.next.push(Message::Status(status));
            }
            if period.is_multiple_of(250)
                && let Some(kind) = self.events.pop()
            {
                self.next.push(Message::Event(Event { t_us: self.t_us, kind }));
            }
            self.next.extend(closed.map(Message::Samples));
        }
        let envelope = Envelope { boot_id: BOOT_ID, sequence: self.sequence, message: self.next.pop()? };
        self.sequence = self.sequence.wrapping_add(1);
        Some(envelope)
    }
}

fn about() -> RecordingInfo {
    let rig = "[needle]\nyoungs_modulus_gpa = 200.0\nouter_diameter_mm = 1.27\ninner_diameter_mm = 1.0\n\
               [rig]\nguide2_mm = 60.0\nentry_mm = 70.0\n";
    RecordingInfo::new("record", "d30-1", 30.0, rig.to_owned())
}

/// Records envelopes, a chunk for every five of them, and how long the file is.
fn record(path: &Path, envelopes: &[Envelope]) -> u64 {
    let mut transcript = begun(path);
    for (index, envelope) in envelopes.iter().enumerate() {
        transcript.envelope(envelope, HOST_NS).expect("records");
        if index == 1 {
            let request = Request::Stream { enable: true };
            transcript.command(&Command { id: 4, connection: BOOT_ID, request }).expect("records");
        }
        if index % 5 == 4 {
            transcript.flush().expect("writes");
        }
    }
    transcript.finish().expect("finishes")
}

fn begun(path: &Path) -> Transcript {
    Transcript::new(Writer::create(path, false).expect("a new file"), Some(about()), None)
}

/// A message as the format's own reader gives it.
struct Read {
    topic: String,
    log_ns: u64,
    publish_ns: u64,
    data: Vec<u8>,
}

/// All messages, by the format's own reader, which compares every checksum.
fn messages(path: &Path) -> Vec<Read> {
    let bytes = fs::read(path).expect("reads");
    let stream = mcap::MessageStream::new(&bytes).expect("a recording");
    stream
        .map(|message| {
            let message = message.expect("intact");
            Read {
                topic: message.channel.topic.clone(),
                log_ns: message.log_time,
                publish_ns: message.publish_time,
                data: message.data.into_owned(),
            }
        })
        .collect()
}

fn encoded(envelope: &Envelope) -> Vec<u8> {
    let mut buffer = [0; protocol::MAX_FRAME_TO_HOST];
    protocol::encode_envelope(envelope, &mut buffer).expect("fits").to_vec()
}

/// The frames of a recording.
fn frames(path: &Path) -> Vec<Vec<u8>> {
    messages(path).into_iter().filter(|read| read.topic == "/frames").map(|read| read.data).collect()
}
