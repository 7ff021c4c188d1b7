//! Samples in and out of batches.
//!
//! A sample is four numbers: position x, position y, force x, force y, each an `i32` count. [`Samples::packed`] holds the
//! first sample of the batch as it is and every later one as its difference from the one before (wrapping), each number as
//! a postcard `i32`: zigzag, then a varint of 1 to 5 bytes. Consecutive readings differ by little more than their noise, so
//! that most numbers take one or two bytes whatever their absolute value: with position noise of 3 counts and force noise of
//! 100 counts (standard deviations) a sample takes 5.4 bytes packed and 6.3 bytes on the line, its share of the frame (27
//! bytes for 32 samples) included, against 16 bytes as plain integers. A test holds the code to these numbers.

use crate::{PACKED_BYTES, Packed, Samples, State, Step};
use postcard::experimental::max_size::MaxSize;

/// Most samples in a batch.
pub const MAX_SAMPLES: u8 = 32;

/// Most bytes one sample takes in [`Samples::packed`].
const WORST: usize = <[i32; 4]>::POSTCARD_MAX_SIZE;

// A batch is never closed by the sample that opens it: so one push closes at most one batch.
const _: () = assert!(MAX_SAMPLES >= 2 && PACKED_BYTES >= 2 * WORST);

/// One reading of every channel, per axis in the order x, y.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Sample {
    /// Position of guide 2, in counts of `Scales::position_nm_per_count`.
    pub position_counts: [i32; 2],
    /// Force relative to the tare, in counts of `Scales::force_nn_per_count`.
    pub force_counts: [i32; 2],
}

impl Sample {
    fn combine(self, other: Self, each: impl Fn(i32, i32) -> i32) -> Self {
        let both = |[ax, ay]: [i32; 2], [bx, by]: [i32; 2]| [each(ax, bx), each(ay, by)];
        Self {
            position_counts: both(self.position_counts, other.position_counts),
            force_counts: both(self.force_counts, other.force_counts),
        }
    }
}

/// Gathers samples into batches. Every sample pushed comes out in exactly one batch, in order.
#[derive(Debug)]
pub struct Packer {
    period_us: u32,
    open: Option<Samples>,
    last: Sample,
}

impl Packer {
    /// `period_us`: nominal time between samples, which is also what `Hello::sample_period_us` says.
    pub const fn new(period_us: u32) -> Self {
        Self { period_us, open: None, last: Sample { position_counts: [0; 2], force_counts: [0; 2] } }
    }

    /// Adds a sample and returns the batch that is complete by that, if any: the one before it, where this sample does not
    /// continue it (another state, step or dropped count, or not exactly one period later), or the one that it fills.
    ///
    /// `t_us` is the scheduled time of the sample: a batch holds one time only, and a time that jitters would open a new
    /// batch with every sample.
    pub fn push(
        &mut self,
        t_us: u64,
        state: State,
        step: u8,
        dropped: u32,
        sample: Sample,
    ) -> Option<Samples> {
        let continues = self.open.as_ref().is_some_and(|open| {
            let next_us = open.t_us.checked_add(u64::from(self.period_us) * u64::from(open.count));
            (next_us, open.state, open.step, open.dropped) == (Some(t_us), state, step, dropped)
        });
        let before = if continues { None } else { self.open.take() };

        let difference = match self.open {
            Some(_) => sample.combine(self.last, i32::wrapping_sub),
            None => sample,
        };
        let open = self.open.get_or_insert_with(|| Samples {
            t_us,
            dropped,
            state,
            step,
            count: 0,
            packed: Packed::default(),
        });
        append(&mut open.packed, difference);
        open.count += 1;
        self.last = sample;

        let full = open.count == MAX_SAMPLES || open.packed.len() + WORST > PACKED_BYTES;
        if full { self.open.take() } else { before }
    }

    /// The batch begun, if any: to bound the delay when samples are slow, or when they end.
    pub fn flush(&mut self) -> Option<Samples> {
        self.open.take()
    }
}

fn append(packed: &mut Packed, Sample { position_counts: [px, py], force_counts: [fx, fy] }: Sample) {
    let mut encoded = [0; WORST];
    let fits = postcard::to_slice(&[px, py, fx, fy], &mut encoded).is_ok_and(|bytes| packed.append(bytes));
    assert!(fits, "room for a whole sample is left after every push");
}

/// Why the packed bytes of a batch were refused. Nothing of such a batch is used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum UnpackError {
    /// A batch of no samples is never sent.
    #[error("a batch of no samples")]
    Empty,
    /// The bytes end, or hold a number too large, before `count` samples are complete.
    #[error("the packed bytes end or break within sample {index} of {count}")]
    Broken {
        /// The sample, from 0.
        index: u8,
        /// The number of samples announced.
        count: u8,
    },
    /// Bytes are left over.
    #[error("{bytes} bytes are left over after the last sample")]
    Trailing {
        /// How many.
        bytes: usize,
    },
}

impl Samples {
    /// The samples with their device times, once it is sure that the packed bytes are exactly `count` samples.
    pub fn unpack(&self, period_us: u32) -> Result<Unpacked<'_>, UnpackError> {
        if self.count == 0 {
            return Err(UnpackError::Empty);
        }
        let unpacked =
            Unpacked { rest: &self.packed, left: self.count, next_us: self.t_us, period_us, last: None };
        // What is plainly whole needs no trial.
        if is_plainly(&self.packed, 4 * usize::from(self.count)) {
            return Ok(unpacked);
        }
        let mut trial = unpacked.clone();
        for index in 0..self.count {
            if trial.next().is_none() {
                return Err(UnpackError::Broken { index, count: self.count });
            }
        }
        match trial.rest.len() {
            0 => Ok(unpacked),
            bytes => Err(UnpackError::Trailing { bytes }),
        }
    }
}

/// Whether the bytes are so many varints for sure: as many last bytes, at the end one too, and none of five bytes, the fifth of which
/// might hold too much. Passes without branches.
fn is_plainly(bytes: &[u8], numbers: usize) -> bool {
    let last_bytes = bytes.iter().filter(|byte| **byte < 0x80).count();
    let four = |window: &[u8]| window.iter().fold(0x80, |all, byte| all & byte);
    let long = bytes.windows(4).fold(0, |any, window| any | four(window));
    last_bytes == numbers && long == 0 && bytes.last().is_some_and(|byte| *byte < 0x80)
}

/// The samples of a batch, each with its device time in microseconds: see [`Samples::unpack`].
#[derive(Debug, Clone)]
pub struct Unpacked<'a> {
    rest: &'a [u8],
    left: u8,
    next_us: u64,
    period_us: u32,
    last: Option<Sample>,
}

impl Iterator for Unpacked<'_> {
    type Item = (u64, Sample);

    fn next(&mut self) -> Option<Self::Item> {
        self.left = self.left.checked_sub(1)?;
        let ([px, py, fx, fy], rest) = match short(self.rest) {
            Some(short) => short,
            None => postcard::take_from_bytes::<[i32; 4]>(self.rest).ok()?,
        };
        self.rest = rest;
        let read = Sample { position_counts: [px, py], force_counts: [fx, fy] };
        let sample = self.last.map_or(read, |last| last.combine(read, i32::wrapping_add));
        self.last = Some(sample);
        let t_us = self.next_us;
        self.next_us = t_us.saturating_add(u64::from(self.period_us));
        Some((t_us, sample))
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        (usize::from(self.left), Some(usize::from(self.left)))
    }
}

impl ExactSizeIterator for Unpacked<'_> {}

/// Four numbers from the first eight bytes, and what follows them: nothing where there are not so many bytes, or the numbers take more.
/// All lengths are found in one word, so that no guess about them can be wrong.
fn short(bytes: &[u8]) -> Option<([i32; 4], &[u8])> {
    let word = u64::from_le_bytes(*bytes.first_chunk()?);
    let mut ends = !word & 0x8080_8080_8080_8080;
    let (mut numbers, mut end) = ([0; 4], 0);
    for number in &mut numbers {
        let start = end;
        if ends == 0 {
            return None;
        }
        // Past the bit that marks the last byte.
        end = ends.trailing_zeros() + 1;
        ends &= ends - 1;
        let of = (word >> start) & (u64::MAX >> (64 - (end - start)));
        // Seven bits of each byte; of five bytes at most, as there are three other numbers.
        let groups = (of & 0x7F)
            | (of >> 1 & 0x3F80)
            | (of >> 2 & 0x1F_C000)
            | (of >> 3 & 0xFE0_0000)
            | (of >> 4 & 0x7_F000_0000);
        let zigzag = u32::try_from(groups).ok()?;
        *number = (zigzag >> 1) as i32 ^ -((zigzag & 1) as i32);
    }
    Some((numbers, bytes.get(end as usize / 8..)?))
}

/// Checksum of a motion program, for `Request::Run`: the frame's CRC-32 over the steps as they are encoded in `LoadStep`,
/// one after the other.
pub fn program_crc(steps: &[Step]) -> u32 {
    let mut digest = crate::frame::CRC.digest();
    for step in steps {
        let mut encoded = [0; Step::POSTCARD_MAX_SIZE];
        match postcard::to_slice(step, &mut encoded) {
            Ok(bytes) => digest.update(bytes),
            Err(_) => unreachable!("a step fits its own largest size"),
        }
    }
    digest.finalize()
}
