//! One channel of a batch: the encoding with the fewest bits for all of its readings, and these bits.

/// Channels of a sample.
pub(super) const CHANNELS: usize = 4;
/// Most bytes of a column's head: its width, the base and the start.
pub(super) const MAX_HEAD: usize = 1 + 2 * MAX_NUMBER;
/// Most bytes of an `i32` as postcard writes it.
const MAX_NUMBER: usize = 5;
/// Set in the first byte of the head of a column that holds differences.
const DIFFERENCES: u8 = 0x80;
/// Most bits of a reading.
const MAX_WIDTH: u8 = 32;

/// Encoding of one channel of a batch: every reading, or every difference from the reading before, less the smallest of them
/// (`base`), in `width` bits.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Column {
    /// Bits of each reading, at most 32.
    pub width: u8,
    /// Base that is added to each reading.
    pub base: i32,
    /// For differences: value to which the first difference is added.
    pub start: Option<i32>,
}

impl Column {
    /// Reads a head; returns it and the bytes after it.
    pub fn read(bytes: &[u8]) -> Option<(Self, &[u8])> {
        let (first, tail) = bytes.split_first()?;
        let width = first & !DIFFERENCES;
        if width > MAX_WIDTH {
            return None;
        }
        let (base, tail) = postcard::take_from_bytes(tail).ok()?;
        if first & DIFFERENCES == 0 {
            return Some((Self { width, base, start: None }, tail));
        }
        let (start, tail) = postcard::take_from_bytes(tail).ok()?;
        Some((Self { width, base, start: Some(start) }, tail))
    }

    /// Writes the head.
    pub fn write(&self, output: &mut Writer<'_>) {
        output.byte(self.width | if self.start.is_some() { DIFFERENCES } else { 0 });
        for number in core::iter::once(self.base).chain(self.start) {
            output.number(number);
        }
    }

    /// Bits of the head and of `count` readings.
    pub fn bits(&self, count: u8) -> usize {
        let head = 1 + number_bytes(self.base) + self.start.map_or(0, number_bytes);
        8 * head + usize::from(count) * usize::from(self.width)
    }

    /// State that encodes or decodes the readings in their order.
    pub fn readings(&self) -> Readings {
        let keep = if self.start.is_some() { !0 } else { 0 };
        Readings { width: self.width, keep, base: self.base, last: self.start.unwrap_or_default() }
    }
}

/// The readings of a column, one after the other.
#[derive(Debug, Clone, Copy)]
pub(super) struct Readings {
    /// Bits of a reading.
    pub width: u8,
    /// All ones where differences are written.
    keep: i32,
    base: i32,
    last: i32,
}

impl Readings {
    /// Encodes the next reading; the code is less than 2 to the power of the width.
    #[inline]
    pub fn written(&mut self, reading: i32) -> u32 {
        let predicted = (self.last & self.keep).wrapping_add(self.base);
        self.last = reading;
        reading.wrapping_sub(predicted) as u32
    }

    /// Decodes the next reading.
    #[inline]
    pub fn read(&mut self, written: u32) -> i32 {
        self.last = (self.last & self.keep).wrapping_add(self.base).wrapping_add(written as i32);
        self.last
    }
}

/// Bytes of a number as postcard writes it: zigzag, then seven bits a byte.
fn number_bytes(number: i32) -> usize {
    let zigzag = (number << 1 ^ number >> 31) as u32;
    (38 - (zigzag | 1).leading_zeros() as usize) / 7
}

/// The least and the greatest of some numbers.
#[derive(Debug, Clone, Copy)]
struct Range {
    least: i32,
    greatest: i32,
}

impl Range {
    const fn of(number: i32) -> Self {
        Self { least: number, greatest: number }
    }

    fn with(self, number: i32) -> Self {
        Self { least: self.least.min(number), greatest: self.greatest.max(number) }
    }

    fn width(self) -> u8 {
        let most = self.greatest.wrapping_sub(self.least) as u32;
        (u32::BITS - most.leading_zeros()) as u8
    }
}

/// Range of a channel's readings, from which its encoding follows.
#[derive(Debug, Clone, Copy)]
pub(super) struct Spread {
    first: i32,
    readings: Range,
    /// `None` while there is a single reading.
    differences: Option<Range>,
}

impl Spread {
    /// Range of one reading.
    pub const fn of(reading: i32) -> Self {
        Self { first: reading, readings: Range::of(reading), differences: None }
    }

    /// The ranges with one more reading, which follows `last`.
    pub fn with(&self, last: i32, reading: i32) -> Self {
        let difference = reading.wrapping_sub(last);
        Self {
            first: self.first,
            readings: self.readings.with(reading),
            differences: Some(self.differences.map_or(Range::of(difference), |range| range.with(difference))),
        }
    }

    /// Upper bound of the bits of `count` readings.
    pub fn most_bits(&self, count: u8) -> usize {
        8 * (1 + MAX_NUMBER) + usize::from(count) * usize::from(self.readings.width())
    }

    /// The shorter encoding of `count` readings: as they are, or as differences.
    pub fn column(&self, count: u8) -> Column {
        let plain = Column { width: self.readings.width(), base: self.readings.least, start: None };
        let Some(range) = self.differences else { return plain };
        // With this start the first difference is the smallest one, so that its code is zero.
        let start = self.first.wrapping_sub(range.least);
        let differences = Column { width: range.width(), base: range.least, start: Some(start) };
        if differences.bits(count) < plain.bits(count) { differences } else { plain }
    }
}

/// Writes bytes, then bits, the lowest first, from the start of a buffer. Readings that do not fit are omitted: see
/// [`Writer::end`].
pub(super) struct Writer<'a> {
    buffer: &'a mut [u8],
    length: usize,
    bits: u64,
    filled: u32,
}

impl<'a> Writer<'a> {
    pub fn new(buffer: &'a mut [u8]) -> Self {
        Self { buffer, length: 0, bits: 0, filled: 0 }
    }

    fn byte(&mut self, byte: u8) {
        if let Some(slot) = self.buffer.get_mut(self.length) {
            *slot = byte;
        }
        self.length += 1;
    }

    fn number(&mut self, number: i32) {
        let mut encoded = [0; MAX_NUMBER];
        let bytes = postcard::to_slice(&number, &mut encoded).map_or(&[][..], |bytes| bytes);
        bytes.iter().for_each(|byte| self.byte(*byte));
    }

    /// Adds a number of at most `width` bits.
    pub fn bits(&mut self, number: u32, width: u8) {
        self.bits |= u64::from(number) << self.filled;
        self.filled += u32::from(width);
        while self.filled >= u8::BITS {
            self.byte(self.bits as u8);
            self.bits >>= u8::BITS;
            self.filled -= u8::BITS;
        }
    }

    /// Fills the last byte with zeros and returns all bytes, if they fitted.
    pub fn end(mut self) -> Option<&'a [u8]> {
        if self.filled > 0 {
            self.byte(self.bits as u8);
        }
        self.buffer.get(..self.length)
    }
}

/// Bits that [`bits`] returns from any position: up to seven of the 64 bits of a word lie before the position.
pub(super) const MAX_AT_ONCE: u32 = u64::BITS - 7;

/// At least [`MAX_AT_ONCE`] bits from bit `at` on; zeros beyond the end.
#[inline]
pub(super) fn bits(bytes: &[u8], at: usize) -> u64 {
    let tail = bytes.get(at / 8..).unwrap_or_default();
    let word = tail.first_chunk().copied().unwrap_or_else(|| {
        let mut word = [0; 8];
        word.iter_mut().zip(tail).for_each(|(to, from)| *to = *from);
        word
    });
    u64::from_le_bytes(word) >> (at % 8)
}

/// Reads one column from consecutive samples.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reader {
    /// Offset of the column in a sample, bits.
    shift: u32,
    /// Mask with as many ones as the column has bits.
    mask: u32,
    readings: Readings,
}

impl Reader {
    /// Readers of the columns, in their order.
    pub fn of(columns: &[Column; CHANNELS]) -> [Self; CHANNELS] {
        let mut shift = 0;
        columns.map(|column| {
            let mask = ((1_u64 << column.width) - 1) as u32;
            let reader = Self { shift, mask, readings: column.readings() };
            shift += u32::from(column.width);
            reader
        })
    }

    /// The next reading, from all bits of its sample.
    #[inline]
    pub fn of_sample(&mut self, bits: u64) -> i32 {
        self.readings.read((bits >> self.shift) as u32 & self.mask)
    }

    /// The next reading, from a sample that is longer than a word and begins at bit `at`.
    #[inline]
    pub fn at(&mut self, bytes: &[u8], at: usize) -> i32 {
        self.readings.read(bits(bytes, at + self.shift as usize) as u32 & self.mask)
    }
}
