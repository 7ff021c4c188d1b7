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
    /// Name.
    pub name: String,
    /// Bytes on the line, per sample.
    pub bytes: f64,
    /// Seconds to make them, per sample.
    pub encode_s: f64,
    /// Seconds to read them, per sample.
    pub decode_s: f64,
}

/// A way to send samples, as the comparison needs it.
trait Codec {
    fn name(&self) -> &'static str;
    /// Writes all samples to the line.
    fn encode(&self, samples: &[Sample], line: &mut Vec<u8>);
    /// Reads the line and sums every sample with its time.
    fn decode(&self, line: &[u8], sums: &mut Sums);
}

/// Our own frames.
struct Ours;

impl Codec for Ours {
    fn name(&self) -> &'static str {
        "ours: packed batches, CRC-32, COBS"
    }

    fn encode(&self, samples: &[Sample], line: &mut Vec<u8>) {
        link::encode(samples, line);
    }

    fn decode(&self, line: &[u8], sums: &mut Sums) {
        link::decode(line, |t_us, sample| sums.take(t_us, sample));
    }
}

/// Sums over everything that was read: what makes two ways the same.
#[derive(Default, PartialEq, Eq)]
struct Sums {
    times_us: u64,
    counts: i64,
    samples: usize,
}

impl Sums {
    #[inline]
    fn take(&mut self, t_us: u64, sample: Sample) {
        let Sample { position_counts: [a, b], force_counts: [c, d], .. } = sample;
        self.times_us = self.times_us.wrapping_add(t_us);
        self.counts += i64::from(a) - 3 * i64::from(b) + 5 * i64::from(c) - 7 * i64::from(d);
        self.samples += 1;
    }
}

fn sums_of(way: &dyn Codec, line: &[u8]) -> Sums {
    let mut sums = Sums::default();
    way.decode(line, &mut sums);
    sums
}

/// Measures all ways; ours is first.
pub fn measure(clock: &mut Clock, seed: u32) -> Result<Vec<Measured>> {
    let samples = samples(seed);
    let codecs: [&dyn Codec; 8] = [
        &Ours,
        &proto::Columns,
        &proto::Batch,
        &proto::Single,
        &mavlink::Batch,
        &mavlink::Single,
        &json::Batch,
        &json::Single,
    ];
    let mut rows = Vec::new();
    let mut first = None;
    for way in codecs {
        let mut line = Vec::new();
        way.encode(&samples, &mut line);
        let sums = sums_of(way, &line);
        ensure!(sums.samples == SAMPLES, "{}: {} samples", way.name(), sums.samples);
        match &first {
            None => first = Some(sums),
            Some(ours) => ensure!(*ours == sums, "{}: other samples", way.name()),
        }
        let bytes = line.len() as f64 / SAMPLES as f64;
        let decode_s = clock.seconds(&format!("decode {}", way.name()), || sums_of(way, black_box(&line)))?;
        let encode_s = clock.seconds(&format!("encode {}", way.name()), || {
            line.clear();
            way.encode(black_box(&samples), &mut line);
            line.len()
        })?;
        let of_sample = |seconds: f64| seconds / SAMPLES as f64;
        rows.push(Measured {
            name: way.name().to_owned(),
            bytes,
            encode_s: of_sample(encode_s),
            decode_s: of_sample(decode_s),
        });
    }
    Ok(rows)
}
