//! MAVLink 2 by `mavlink-core`: its frames, its checksum, its cut of trailing zeros; two messages of a dialect of our own, made as
//! its generator makes them. A payload has at most 255 bytes, which is 15 samples.

use super::{Codec, Sums};
use crate::link::{PERIOD_US, time_us};
use mavlink_core::bytes::Bytes;
use mavlink_core::bytes_mut::BytesMut;
use mavlink_core::error::ParserError;
use mavlink_core::utils::remove_trailing_zeroes;
use mavlink_core::{MAVLinkV2MessageRaw, MavHeader, MavlinkReader, MavlinkVersion, Message};
use protocol::Sample;

/// Samples of a batch.
const MAX_SAMPLES: usize = 15;
const BATCH_ID: u32 = 50_001;
const SINGLE_ID: u32 = 50_002;

/// Samples from a time on; the fields stand by size, as MAVLink orders them.
#[derive(Debug, Clone, Copy, Default)]
struct Telemetry {
    id: u32,
    t_us: u64,
    dropped: u32,
    count: usize,
    state: u8,
    step: u8,
    samples: [[i32; 4]; MAX_SAMPLES],
}

impl Message for Telemetry {
    fn message_id(&self) -> u32 {
        self.id
    }

    fn message_name(&self) -> &'static str {
        if self.id == BATCH_ID { "SAMPLES" } else { "SAMPLE" }
    }

    fn target_system_id(&self) -> Option<u8> {
        None
    }

    fn target_component_id(&self) -> Option<u8> {
        None
    }

    fn target_system_id_mut(&mut self) -> Option<&mut u8> {
        None
    }

    fn target_component_id_mut(&mut self) -> Option<&mut u8> {
        None
    }

    fn ser(&self, _version: MavlinkVersion, payload: &mut [u8]) -> usize {
        let mut bytes = BytesMut::new(payload);
        bytes.put_u64_le(self.t_us);
        bytes.put_u32_le(self.dropped);
        let field_count = if self.id == BATCH_ID { MAX_SAMPLES } else { 1 };
        self.samples[..field_count].iter().flatten().for_each(|number| bytes.put_i32_le(*number));
        if self.id == BATCH_ID {
            bytes.put_u8(self.count as u8);
        }
        bytes.put_u8(self.state);
        bytes.put_u8(self.step);
        let length = bytes.len();
        remove_trailing_zeroes(&payload[..length])
    }

    fn parse(_version: MavlinkVersion, id: u32, payload: &[u8]) -> Result<Self, ParserError> {
        // The bytes that were cut off are zeros.
        let mut whole = [0; 255];
        whole[..payload.len()].copy_from_slice(payload);
        let mut bytes = Bytes::new(&whole);
        let mut telemetry = Self { id, count: 1, ..Self::default() };
        telemetry.t_us = bytes.get_u64_le()?;
        telemetry.dropped = bytes.get_u32_le()?;
        let field_count = if id == BATCH_ID { MAX_SAMPLES } else { 1 };
        for number in telemetry.samples[..field_count].iter_mut().flatten() {
            *number = bytes.get_i32_le()?;
        }
        if id == BATCH_ID {
            telemetry.count = usize::from(bytes.get_u8()?);
        }
        telemetry.state = bytes.get_u8()?;
        telemetry.step = bytes.get_u8()?;
        Ok(telemetry)
    }

    fn message_id_from_name(name: &str) -> Option<u32> {
        match name {
            "SAMPLES" => Some(BATCH_ID),
            "SAMPLE" => Some(SINGLE_ID),
            _ => None,
        }
    }

    fn default_message_from_id(id: u32) -> Option<Self> {
        matches!(id, BATCH_ID | SINGLE_ID).then(|| Self { id, ..Self::default() })
    }

    fn extra_crc(id: u32) -> u8 {
        if id == BATCH_ID { 17 } else { 91 }
    }
}

fn encode(samples: &[Sample], id: u32, size: usize, line: &mut Vec<u8>) {
    for (sequence, batch) in samples.chunks(size).enumerate() {
        let mut message = Telemetry {
            id,
            t_us: time_us(size * sequence),
            count: batch.len(),
            state: 3,
            step: 2,
            ..Telemetry::default()
        };
        for (to, Sample { position_counts: [px, py], force_counts: [fx, fy], .. }) in
            message.samples.iter_mut().zip(batch)
        {
            *to = [*px, *py, *fx, *fy];
        }
        let mut raw = MAVLinkV2MessageRaw::new();
        let header = MavHeader { system_id: 1, component_id: 1, sequence: sequence as u8 };
        raw.serialize_message(header, &message);
        line.extend_from_slice(raw.raw_bytes());
    }
}

fn decode(line: &[u8], sums: &mut Sums) {
    let mut reader = MavlinkReader::new(line);
    while let Ok((_, message)) = reader.read_message::<Telemetry>(MavlinkVersion::V2) {
        let times = (message.t_us..).step_by(PERIOD_US as usize);
        for (t_us, [px, py, fx, fy]) in times.zip(&message.samples[..message.count]) {
            sums.take(
                t_us,
                Sample { position_counts: [*px, *py], force_counts: [*fx, *fy], repeats_force: false },
            );
        }
    }
}

/// As many samples as a payload holds.
pub struct Batch;

impl Codec for Batch {
    fn name(&self) -> &'static str {
        "MAVLink 2, 15 samples a message"
    }

    fn encode(&self, samples: &[Sample], line: &mut Vec<u8>) {
        encode(samples, BATCH_ID, MAX_SAMPLES, line);
    }

    fn decode(&self, line: &[u8], sums: &mut Sums) {
        decode(line, sums);
    }
}

/// A message per sample.
pub struct Single;

impl Codec for Single {
    fn name(&self) -> &'static str {
        "MAVLink 2, a message per sample"
    }

    fn encode(&self, samples: &[Sample], line: &mut Vec<u8>) {
        encode(samples, SINGLE_ID, 1, line);
    }

    fn decode(&self, line: &[u8], sums: &mut Sums) {
        decode(line, sums);
    }
}
