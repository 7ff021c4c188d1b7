//! Samples in and out of batches.
//!
//! A sample is four numbers: position x, position y, force x, force y, each an `i32` count. In [`Samples::packed`] a channel
//! has a fixed number of bits per reading, which depends on the spread of its readings in the batch and not on their absolute
//! value:
//!
//! | in this order | bytes | what |
//! |---|---|---|
//! | four heads, one per channel | 2 to 11 each | |
//! | &nbsp; width | 1 | bits of each reading, 0 to 32, plus 128 if differences are written |
//! | &nbsp; base | 1 to 5 | a postcard `i32` (zigzag varint): base that is added to every reading |
//! | &nbsp; start | 0, or 1 to 5 | a postcard `i32`, for differences only: value to which the first difference is added |
//! | the samples | | each the four readings' bits, the lowest first, without gaps; zeros fill the last byte |
//!
//! A reading is the value of its bits plus the base. If differences are written, the reading before is added too (wrapping).
//! The packer writes each channel in the shorter form: readings while there is only noise, differences while the guide moves or
//! the force rises. With position noise of 3 counts and force noise of 100 counts (standard deviations) a sample takes 3.7
//! bytes packed and 4.6 bytes on the line, its share of the frame (27 bytes for 32 samples) included, against 16 bytes as plain
//! integers. A test holds the code to these numbers.

mod column;

use crate::checksum::Digest;
use crate::{PACKED_BYTES, Packed, Samples, State, Step};
use column::{CHANNELS, Column, MAX_HEAD, Reader, Spread, Writer};
use postcard::experimental::max_size::MaxSize;

/// Largest number of samples in a batch.
pub const MAX_SAMPLES: u8 = 32;

// Two samples always fit, so that one push closes at most one batch.
const _: () = assert!(MAX_SAMPLES >= 2 && PACKED_BYTES >= CHANNELS * (MAX_HEAD + 2 * 4));

/// One reading of every channel, per axis in the order x, y.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Sample {
    /// Position of guide 2, in counts of `Scales::position_nm_per_count`.
    pub position_counts: [i32; 2],
    /// Force relative to the tare, in counts of `Scales::force_nn_per_count`.
    pub force_counts: [i32; 2],
    /// There was no valid reading of the force (missing, or a saturated converter), and the fields repeat the reading before.
    pub repeats_force: bool,
}

impl Sample {
    fn channels(self) -> [i32; CHANNELS] {
        let ([px, py], [fx, fy]) = (self.position_counts, self.force_counts);
        [px, py, fx, fy]
    }

    fn of([px, py, fx, fy]: [i32; CHANNELS], repeats_force: bool) -> Self {
        Self { position_counts: [px, py], force_counts: [fx, fy], repeats_force }
    }
}

/// Gathers samples into batches. Every sample pushed comes out in exactly one batch, in order.
#[derive(Debug)]
pub struct Packer {
    period_us: u32,
    open: Option<Open>,
}

/// A batch that samples are still added to.
#[derive(Debug)]
struct Open {
    t_us: u64,
    dropped: u32,
    state: State,
    step: u8,
    samples: heapless::Vec<Sample, { MAX_SAMPLES as usize }>,
    last: Sample,
    spreads: [Spread; CHANNELS],
}

impl Packer {
    /// `period_us`: nominal time between samples, also in `Hello::sample_period_us`.
    pub const fn new(period_us: u32) -> Self {
        Self { period_us, open: None }
    }

    /// Adds a sample and returns the batch that it completes, if any. A sample completes a batch that it fills. A sample that does
    /// not fit into the open batch, or does not continue it (another state, step or dropped count, or not exactly one period
    /// later), completes that batch and opens the next one.
    ///
    /// `t_us` is the scheduled time of the sample: a batch has one time only, and times with jitter would open a new batch with every
    /// sample.
    pub fn push(
        &mut self,
        t_us: u64,
        state: State,
        step: u8,
        dropped: u32,
        sample: Sample,
    ) -> Option<Samples> {
        let (period_us, head) = (self.period_us, (t_us, state, step, dropped));
        let continues =
            self.open.as_mut().is_some_and(|open| open.is_continued(period_us, head) && open.add(sample));
        if !continues {
            let finished_batch = self.flush();
            let mut samples = heapless::Vec::new();
            // An empty batch has room for one sample.
            let _ = samples.push(sample);
            let spreads = sample.channels().map(Spread::of);
            self.open = Some(Open { t_us, dropped, state, step, samples, last: sample, spreads });
            return finished_batch;
        }
        if self.open.as_ref().is_some_and(|open| open.samples.is_full()) { self.flush() } else { None }
    }

    /// Returns the unfinished batch, if any. The caller flushes before a message that has to follow these samples, and when they end.
    pub fn flush(&mut self) -> Option<Samples> {
        self.open.take().map(|open| open.close())
    }
}

impl Open {
    fn count(&self) -> u8 {
        self.samples.len() as u8
    }

    fn is_continued(&self, period_us: u32, head: (u64, State, u8, u32)) -> bool {
        let next_us = self.t_us.checked_add(u64::from(period_us) * u64::from(self.count()));
        next_us.is_some_and(|next_us| (next_us, self.state, self.step, self.dropped) == head)
    }

    /// Adds a sample, if it fits.
    fn add(&mut self, sample: Sample) -> bool {
        let mut spreads = self.spreads;
        let pairs = self.last.channels().into_iter().zip(sample.channels());
        for (spread, (last, reading)) in spreads.iter_mut().zip(pairs) {
            *spread = spread.with(last, reading);
        }
        let count = self.count() + 1;
        let fits = |bits: usize| bits.div_ceil(8) <= PACKED_BYTES;
        // The upper bound is cheap and nearly always suffices; if it does not, the exact size is computed.
        let fits = fits(spreads.iter().map(|spread| spread.most_bits(count)).sum())
            || fits(spreads.iter().map(|spread| spread.column(count).bits(count)).sum());
        if !fits || self.samples.push(sample).is_err() {
            return false;
        }
        (self.last, self.spreads) = (sample, spreads);
        true
    }

    fn close(self) -> Samples {
        let columns = self.spreads.map(|spread| spread.column(self.count()));
        let mut buffer = [0; PACKED_BYTES];
        let mut writer = Writer::new(&mut buffer);
        columns.iter().for_each(|column| column.write(&mut writer));
        let mut readings = columns.map(|column| column.readings());
        for sample in &self.samples {
            for (readings, reading) in readings.iter_mut().zip(sample.channels()) {
                writer.bits(readings.written(reading), readings.width);
            }
        }
        let packed = writer.end().and_then(Packed::from_slice);
        assert!(packed.is_some(), "a sample is added only where it fits");
        let count = self.count();
        let repeats_force = (0..)
            .zip(&self.samples)
            .fold(0, |bits, (index, sample)| bits | u32::from(sample.repeats_force) << (index % u32::BITS));
        let Self { t_us, dropped, state, step, .. } = self;
        Samples { t_us, dropped, state, step, count, packed: packed.unwrap_or_default(), repeats_force }
    }
}

/// Why the packed bytes of a batch were refused. No sample of such a batch is used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum UnpackError {
    /// A batch of no samples is never sent.
    #[error("a batch of no samples")]
    Empty,
    /// The bytes end within a head, or it has a width or a number too large.
    #[error("the header of channel {channel} is truncated or invalid")]
    Head {
        /// The channel, from 0.
        channel: u8,
    },
    /// The number of bytes is not the one that the heads require.
    #[error("the samples have {found} bytes where their widths need {expected}")]
    Length {
        /// Number of bytes that these samples take.
        expected: usize,
        /// Number of bytes that are there.
        found: usize,
    },
}

impl Samples {
    /// The samples with their device times, after a check that the packed bytes are exactly `count` samples.
    pub fn unpack(&self, period_us: u32) -> Result<Unpacked<'_>, UnpackError> {
        if self.count == 0 {
            return Err(UnpackError::Empty);
        }
        let mut columns = [Column::default(); CHANNELS];
        let mut unread = &*self.packed;
        for (channel, column) in (0..).zip(&mut columns) {
            (*column, unread) = Column::read(unread).ok_or(UnpackError::Head { channel })?;
        }
        let widths: usize = columns.iter().map(|column| usize::from(column.width)).sum();
        let expected = (widths * usize::from(self.count)).div_ceil(8);
        if unread.len() != expected {
            return Err(UnpackError::Length { expected, found: unread.len() });
        }
        Ok(Unpacked {
            channels: Reader::of(&columns),
            bits: unread,
            at: 0,
            width: widths as u32,
            left: self.count,
            repeats_force: self.repeats_force,
            next_us: self.t_us,
            period_us,
        })
    }
}

/// The samples of a batch, each with its device time in microseconds: see [`Samples::unpack`].
#[derive(Debug, Clone)]
pub struct Unpacked<'a> {
    channels: [Reader; CHANNELS],
    bits: &'a [u8],
    at: usize,
    /// Bits of a sample.
    width: u32,
    left: u8,
    /// A bit for each sample, the next one lowest.
    repeats_force: u32,
    next_us: u64,
    period_us: u32,
}

impl Iterator for Unpacked<'_> {
    type Item = (u64, Sample);

    #[inline]
    fn next(&mut self) -> Option<Self::Item> {
        self.left = self.left.checked_sub(1)?;
        let (bytes, bit_offset) = (self.bits, self.at);
        self.at += self.width as usize;
        let counts = if self.width <= column::MAX_AT_ONCE {
            let bits = column::bits(bytes, bit_offset);
            self.channels.each_mut().map(|channel| channel.of_sample(bits))
        } else {
            self.channels.each_mut().map(|channel| channel.at(bytes, bit_offset))
        };
        let t_us = self.next_us;
        self.next_us = t_us.saturating_add(u64::from(self.period_us));
        let repeats_force = self.repeats_force & 1 != 0;
        self.repeats_force >>= 1;
        Some((t_us, Sample::of(counts, repeats_force)))
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        (usize::from(self.left), Some(usize::from(self.left)))
    }
}

impl ExactSizeIterator for Unpacked<'_> {}

/// Checksum of a motion program, for `Request::Run`: the frame's CRC-32 over the steps as they are encoded in `LoadStep`,
/// one after the other.
pub fn program_crc(steps: &[Step]) -> u32 {
    let mut digest = Digest::new();
    for step in steps {
        let mut encoded = [0; Step::POSTCARD_MAX_SIZE];
        match postcard::to_slice(step, &mut encoded) {
            Ok(bytes) => digest.update(bytes),
            Err(_) => unreachable!("a step fits its own largest size"),
        }
    }
    digest.finish()
}
