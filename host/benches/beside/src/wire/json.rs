//! JSON by `serde_json`, a line per message.

use super::{Codec, Sums};
use crate::link::{BATCH, BOOT_ID, PERIOD_US, time_us};
use protocol::Sample;
use serde::{Deserialize, Serialize};

#[derive(Serialize, Deserialize)]
struct Batched {
    boot_id: u32,
    sequence: u32,
    t_us: u64,
    dropped: u32,
    state: u8,
    step: u8,
    /// Position x, y and force x, y of each.
    samples: Vec<[i32; 4]>,
}

#[derive(Serialize, Deserialize)]
struct One {
    boot_id: u32,
    sequence: u32,
    t_us: u64,
    dropped: u32,
    state: u8,
    step: u8,
    sample: [i32; 4],
}

fn numbers(sample: &Sample) -> [i32; 4] {
    let Sample { position_counts: [px, py], force_counts: [fx, fy], .. } = *sample;
    [px, py, fx, fy]
}

fn sample([px, py, fx, fy]: [i32; 4]) -> Sample {
    Sample { position_counts: [px, py], force_counts: [fx, fy], repeats_force: false }
}

fn put(message: &impl Serialize, line: &mut Vec<u8>) {
    serde_json::to_writer(&mut *line, message).expect("numbers");
    line.push(b'\n');
}

/// The lines of a stream.
fn lines(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(|byte| *byte == b'\n').filter(|line| !line.is_empty())
}

/// 32 samples a line.
pub struct Batch;

impl Codec for Batch {
    fn name(&self) -> &'static str {
        "serde_json, 32 samples a line"
    }

    fn encode(&self, samples: &[Sample], line: &mut Vec<u8>) {
        for (sequence, batch) in samples.chunks(BATCH).enumerate() {
            let message = Batched {
                boot_id: BOOT_ID,
                sequence: sequence as u32,
                t_us: time_us(BATCH * sequence),
                dropped: 0,
                state: 3,
                step: 2,
                samples: batch.iter().map(numbers).collect(),
            };
            put(&message, line);
        }
    }

    fn decode(&self, line: &[u8], sums: &mut Sums) {
        for line in lines(line) {
            let batch: Batched = serde_json::from_slice(line).expect("a batch");
            let times = (batch.t_us..).step_by(PERIOD_US as usize);
            times.zip(batch.samples).for_each(|(t_us, numbers)| sums.take(t_us, sample(numbers)));
        }
    }
}

/// A line per sample.
pub struct Single;

impl Codec for Single {
    fn name(&self) -> &'static str {
        "serde_json, a line per sample"
    }

    fn encode(&self, samples: &[Sample], line: &mut Vec<u8>) {
        for (sequence, of) in samples.iter().enumerate() {
            let message = One {
                boot_id: BOOT_ID,
                sequence: sequence as u32,
                t_us: time_us(sequence),
                dropped: 0,
                state: 3,
                step: 2,
                sample: numbers(of),
            };
            put(&message, line);
        }
    }

    fn decode(&self, line: &[u8], sums: &mut Sums) {
        for line in lines(line) {
            let single: One = serde_json::from_slice(line).expect("a sample");
            sums.take(single.t_us, sample(single.sample));
        }
    }
}
