//! The link beside what one would send the same samples with: bytes on the line and time, per sample.
//!
//! The content is the same for all: 3200 samples of four counts with the noise of the rig's sensors, device time, state, step and
//! the count of dropped samples, and a number of the frame. Peers send it as batches of 32 and as one message per sample. Every
//! peer gives back all samples, and the sums of them are compared.

mod json;
mod mavlink;
mod proto;

use crate::clock::Clock;
use crate::link::{self, SAMPLES, samples};
use anyhow::{Result, ensure};
use protocol::Sample;
use std::hint::black_box;

/// One way to send samples.
pub struct Measured {
    /// What it is.
    pub name: String,
    /// Bytes on the line, per sample.
    pub bytes: f64,
    /// Seconds to make them, per sample.
    pub encode_s: f64,
    /// Seconds to read them, per sample.
    pub decode_s: f64,
}

/// A way to send samples, as the comparison needs it.
trait Way {
    fn name(&self) -> &'static str;
    /// Writes all samples to the line.
    fn encode(&self, samples: &[Sample], line: &mut Vec<u8>);
    /// Reads the line, giving every sample with its time.
    fn decode(&self, line: &[u8], take: &mut dyn FnMut(u64, Sample));
}

/// Our own frames.
struct Ours;

impl Way for Ours {
    fn name(&self) -> &'static str {
        "ours: packed batches, CRC-32, COBS"
    }

    fn encode(&self, samples: &[Sample], line: &mut Vec<u8>) {
        link::encode(samples, line);
    }

    fn decode(&self, line: &[u8], take: &mut dyn FnMut(u64, Sample)) {
        link::decode(line, take);
    }
}

/// Sum over everything that was read: what makes two ways the same.
fn sum_of(way: &dyn Way, line: &[u8]) -> (u64, i64, usize) {
    let (mut times, mut counts, mut samples) = (0_u64, 0_i64, 0);
    way.decode(line, &mut |t_us, sample| {
        let Sample { position_counts: [a, b], force_counts: [c, d] } = sample;
        times = times.wrapping_add(t_us);
        counts += i64::from(a) - 3 * i64::from(b) + 5 * i64::from(c) - 7 * i64::from(d);
        samples += 1;
    });
    (times, counts, samples)
}

/// Measures all ways; ours is first.
pub fn measure(clock: &mut Clock, seed: u32) -> Result<Vec<Measured>> {
    let samples = samples(seed);
    let ways: [&dyn Way; 8] = [
        &Ours,
        &proto::Columns,
        &proto::Batch,
        &proto::Single,
        &mavlink::Batch,
        &mavlink::Single,
        &json::Batch,
        &json::Single,
    ];
    let mut all = Vec::new();
    let mut first = None;
    for way in ways {
        let mut line = Vec::new();
        way.encode(&samples, &mut line);
        let sum = sum_of(way, &line);
        ensure!(sum.2 == SAMPLES, "{}: {} samples", way.name(), sum.2);
        ensure!(*first.get_or_insert(sum) == sum, "{}: other samples", way.name());
        let bytes = line.len() as f64 / SAMPLES as f64;
        let decode_s = clock.seconds(&format!("decode {}", way.name()), || sum_of(way, black_box(&line)))?;
        let encode_s = clock.seconds(&format!("encode {}", way.name()), || {
            line.clear();
            way.encode(black_box(&samples), &mut line);
            line.len()
        })?;
        let of_sample = |seconds: f64| seconds / SAMPLES as f64;
        all.push(Measured {
            name: way.name().to_owned(),
            bytes,
            encode_s: of_sample(encode_s),
            decode_s: of_sample(decode_s),
        });
    }
    Ok(all)
}
