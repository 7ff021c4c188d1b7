//! Samples of 16 bit as the 8 bit that detection has: shifted by what the brightest sample of the sequence needs, so that a scanner's 10 or
//! 12 bit in 16 are not dark.

/// Format of samples in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Depth {
    /// One byte.
    Eight,
    /// Two bytes.
    Sixteen {
        /// The first byte is the high one.
        is_big_endian: bool,
        /// Below zero is black.
        is_signed: bool,
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

    /// Greatest of the samples.
    pub(super) fn greatest(self, bytes: &[u8]) -> u16 {
        let (pairs, _) = bytes.as_chunks::<2>();
        pairs.iter().map(|pair| self.value(*pair)).max().unwrap_or(0)
    }

    fn value(self, pair: [u8; 2]) -> u16 {
        let Self::Sixteen { is_big_endian, is_signed, .. } = self else { return pair[0].into() };
        let value = if is_big_endian { u16::from_be_bytes(pair) } else { u16::from_le_bytes(pair) };
        if is_signed { value.cast_signed().max(0).cast_unsigned() } else { value }
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
