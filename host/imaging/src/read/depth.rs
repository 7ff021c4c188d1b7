//! Samples of 16 bit as the 8 bit that detection has: shifted by what the brightest sample of the sequence needs, so that a scanner's 10 or
//! 12 bit in 16 are not dark.
//!
//! Where samples may be below zero, black is the darkest of the sequence but one: the darkest may be the fill beside the image, far below all
//! others, and one level less of an image without fill changes nothing.

/// Format of samples in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Depth {
    /// One byte.
    Eight,
    /// Two bytes.
    Sixteen {
        /// The first byte is the high one.
        is_big_endian: bool,
        /// Samples may be below zero.
        is_signed: bool,
        /// Sample that is black, 0 or below it; so are those below this one.
        black: i32,
        /// Bits that are dropped.
        shift: u32,
    },
}

impl Depth {
    /// Bytes of a sample.
    pub(super) fn bytes(self) -> usize {
        match self {
            Self::Eight => 1,
            Self::Sixteen { .. } => 2,
        }
    }

    /// The samples with 8 bit.
    pub(super) fn samples(self, bytes: Vec<u8>) -> Vec<u8> {
        match self {
            Self::Eight => bytes,
            Self::Sixteen { shift, .. } => {
                let (pairs, _) = bytes.as_chunks::<2>();
                pairs.iter().map(|pair| shifted(self.value(*pair), shift)).collect()
            }
        }
    }

    /// A sample of two bytes; none of one.
    fn sample(self, pair: [u8; 2]) -> Option<i32> {
        let Self::Sixteen { is_big_endian, is_signed, .. } = self else { return None };
        let value = if is_big_endian { u16::from_be_bytes(pair) } else { u16::from_le_bytes(pair) };
        Some(if is_signed { value.cast_signed().into() } else { value.into() })
    }

    /// Brightness of a sample above black.
    fn value(self, pair: [u8; 2]) -> u16 {
        let Self::Sixteen { black, .. } = self else { return pair[0].into() };
        above(self.sample(pair).unwrap_or(black), black)
    }

    /// Number of different samples below zero, as far as it matters: the fill beside an image is one.
    #[cfg(feature = "dicom")]
    pub(super) fn levels_below_zero(self, bytes: &[u8]) -> usize {
        let (pairs, _) = bytes.as_chunks::<2>();
        let mut below = pairs.iter().filter_map(|pair| self.sample(*pair)).filter(|sample| *sample < 0);
        let Some(first) = below.next() else { return 0 };
        if below.any(|sample| sample != first) { 2 } else { 1 }
    }
}

/// Brightness of a sample above black.
fn above(sample: i32, black: i32) -> u16 {
    u16::try_from((sample - black).max(0)).unwrap_or(u16::MAX)
}

/// The darkest two samples that differ, and the brightest.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Extremes {
    darkest: [Option<i32>; 2],
    brightest: Option<i32>,
}

impl Extremes {
    /// Adds samples.
    pub(super) fn add(&mut self, depth: Depth, bytes: &[u8]) {
        let (pairs, _) = bytes.as_chunks::<2>();
        for sample in pairs.iter().filter_map(|pair| depth.sample(*pair)) {
            self.brightest = self.brightest.max(Some(sample));
            self.darkest = match self.darkest {
                [Some(first), second] if sample > first => {
                    [Some(first), Some(second.map_or(sample, |second| second.min(sample)))]
                }
                [Some(first), _] if sample < first => [Some(sample), Some(first)],
                [None, _] => [Some(sample), None],
                same => same,
            };
        }
    }

    /// The format with black and the bits that these samples need.
    pub(super) fn fit(self, depth: Depth) -> Depth {
        let Depth::Sixteen { is_big_endian, is_signed, .. } = depth else { return depth };
        let black = self.darkest[1].or(self.darkest[0]).unwrap_or(0).min(0);
        let shift = shift_for(above(self.brightest.unwrap_or(black), black));
        Depth::Sixteen { is_big_endian, is_signed, black, shift }
    }
}

/// A sample of 16 bit in 8.
pub(super) fn shifted(value: u16, shift: u32) -> u8 {
    u8::try_from(value.checked_shr(shift).unwrap_or(0)).unwrap_or(u8::MAX)
}

/// Bits to be dropped so that a sample as bright as this one has 8.
pub(super) fn shift_for(greatest: u16) -> u32 {
    (u16::BITS - greatest.leading_zeros()).saturating_sub(8)
}
