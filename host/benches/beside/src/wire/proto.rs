//! Protocol buffers by `prost`, each message with its length before it: batches of samples as messages, batches of packed columns,
//! and a message per sample. No checksum.

use super::{Codec, Sums};
use crate::link::{BATCH, BOOT_ID, PERIOD_US, time_us};
use prost::Message;
use protocol::Sample;

#[derive(Message)]
struct Reading {
    #[prost(sint32, tag = "1")]
    position_x: i32,
    #[prost(sint32, tag = "2")]
    position_y: i32,
    #[prost(sint32, tag = "3")]
    force_x: i32,
    #[prost(sint32, tag = "4")]
    force_y: i32,
}

#[derive(Message)]
struct Head {
    #[prost(uint32, tag = "1")]
    boot_id: u32,
    #[prost(uint32, tag = "2")]
    sequence: u32,
    #[prost(uint64, tag = "3")]
    t_us: u64,
    #[prost(uint32, tag = "4")]
    dropped: u32,
    #[prost(uint32, tag = "5")]
    state: u32,
    #[prost(uint32, tag = "6")]
    step: u32,
}

#[derive(Message)]
struct Readings {
    #[prost(message, optional, tag = "1")]
    head: Option<Head>,
    #[prost(message, repeated, tag = "2")]
    readings: Vec<Reading>,
}

#[derive(Message)]
struct Packed {
    #[prost(message, optional, tag = "1")]
    head: Option<Head>,
    #[prost(sint32, repeated, tag = "2")]
    position_x: Vec<i32>,
    #[prost(sint32, repeated, tag = "3")]
    position_y: Vec<i32>,
    #[prost(sint32, repeated, tag = "4")]
    force_x: Vec<i32>,
    #[prost(sint32, repeated, tag = "5")]
    force_y: Vec<i32>,
}

fn head(sequence: usize, first: usize) -> Head {
    Head { boot_id: BOOT_ID, sequence: sequence as u32, t_us: time_us(first), dropped: 0, state: 3, step: 2 }
}

fn reading(sample: &Sample) -> Reading {
    let Sample { position_counts: [position_x, position_y], force_counts: [force_x, force_y], .. } = *sample;
    Reading { position_x, position_y, force_x, force_y }
}

fn sample(of: &Reading) -> Sample {
    Sample {
        position_counts: [of.position_x, of.position_y],
        force_counts: [of.force_x, of.force_y],
        repeats_force: false,
    }
}

fn put(message: &impl Message, line: &mut Vec<u8>) {
    message.encode_length_delimited(line).expect("room");
}

fn each<M: Message + Default>(mut line: &[u8], mut take: impl FnMut(M)) {
    while !line.is_empty() {
        take(M::decode_length_delimited(&mut line).expect("a message"));
    }
}

/// 32 samples as messages in one.
pub struct Batch;

impl Codec for Batch {
    fn name(&self) -> &'static str {
        "prost, 32 samples a message"
    }

    fn encode(&self, samples: &[Sample], line: &mut Vec<u8>) {
        for (sequence, batch) in samples.chunks(BATCH).enumerate() {
            let readings = batch.iter().map(reading).collect();
            put(&Readings { head: Some(head(sequence, BATCH * sequence)), readings }, line);
        }
    }

    fn decode(&self, line: &[u8], sums: &mut Sums) {
        each(line, |batch: Readings| {
            let times = (batch.head.unwrap_or_default().t_us..).step_by(PERIOD_US as usize);
            times.zip(&batch.readings).for_each(|(t_us, reading)| sums.take(t_us, sample(reading)));
        });
    }
}

/// 32 samples as four packed columns.
pub struct Columns;

impl Codec for Columns {
    fn name(&self) -> &'static str {
        "prost, 32 samples as packed columns"
    }

    fn encode(&self, samples: &[Sample], line: &mut Vec<u8>) {
        for (sequence, batch) in samples.chunks(BATCH).enumerate() {
            let column = |of: fn(&Sample) -> i32| batch.iter().map(of).collect();
            let message = Packed {
                head: Some(head(sequence, BATCH * sequence)),
                position_x: column(|sample| sample.position_counts[0]),
                position_y: column(|sample| sample.position_counts[1]),
                force_x: column(|sample| sample.force_counts[0]),
                force_y: column(|sample| sample.force_counts[1]),
            };
            put(&message, line);
        }
    }

    fn decode(&self, line: &[u8], sums: &mut Sums) {
        each(line, |batch: Packed| {
            let times = (batch.head.unwrap_or_default().t_us..).step_by(PERIOD_US as usize);
            let positions = batch.position_x.iter().zip(&batch.position_y);
            let forces = batch.force_x.iter().zip(&batch.force_y);
            for (t_us, ((&px, &py), (&fx, &fy))) in times.zip(positions.zip(forces)) {
                sums.take(
                    t_us,
                    Sample { position_counts: [px, py], force_counts: [fx, fy], repeats_force: false },
                );
            }
        });
    }
}

#[derive(Message)]
struct One {
    #[prost(message, optional, tag = "1")]
    head: Option<Head>,
    #[prost(message, optional, tag = "2")]
    reading: Option<Reading>,
}

/// A message per sample.
pub struct Single;

impl Codec for Single {
    fn name(&self) -> &'static str {
        "prost, a message per sample"
    }

    fn encode(&self, samples: &[Sample], line: &mut Vec<u8>) {
        for (sequence, of) in samples.iter().enumerate() {
            put(&One { head: Some(head(sequence, sequence)), reading: Some(reading(of)) }, line);
        }
    }

    fn decode(&self, line: &[u8], sums: &mut Sums) {
        each(line, |one: One| {
            sums.take(one.head.unwrap_or_default().t_us, sample(&one.reading.unwrap_or_default()));
        });
    }
}
