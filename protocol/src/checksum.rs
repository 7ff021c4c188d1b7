//! The checksum of every frame, CRC-32/ISO-HDLC: the one of zlib, Ethernet and PNG, so that a recording can be checked with any
//! language's standard library.
//!
//! At these frame lengths (below 2974 bits) it finds every error of up to 4 bits and every burst of up to 32. On the device it
//! takes one table of 1 KiB, in flash; a host uses the carry-less multiplication of its processor, if it has one.

/// The checksum of some bytes.
#[inline]
pub(crate) fn crc32(bytes: &[u8]) -> u32 {
    let mut digest = Digest::new();
    digest.update(bytes);
    digest.finish()
}

/// The checksum of bytes that come in parts.
pub(crate) struct Digest(of_target::Digest);

impl Digest {
    pub fn new() -> Self {
        Self(of_target::new())
    }

    pub fn update(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    pub fn finish(self) -> u32 {
        self.0.finalize()
    }
}

#[cfg(target_os = "none")]
mod of_target {
    use crc::{CRC_32_ISO_HDLC, Crc};

    static TABLE: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

    pub type Digest = crc::Digest<'static, u32>;

    pub fn new() -> Digest {
        TABLE.digest()
    }
}

#[cfg(not(target_os = "none"))]
mod of_target {
    pub use crc32fast::Hasher as Digest;

    pub fn new() -> Digest {
        Digest::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crc::{CRC_32_ISO_HDLC, Crc};
    use proptest::prelude::*;
    use std::vec::Vec;

    #[test]
    fn check_value_of_the_catalogue() {
        assert_eq!(crc32(b"123456789"), 0xCBF4_3926);
    }

    proptest! {
        /// The host's multiplication equals the device's table, however the bytes are cut.
        #[test]
        fn host_and_device_agree(bytes: Vec<u8>, cut: prop::sample::Index) {
            let (first, second) = bytes.split_at(cut.index(bytes.len() + 1));
            let mut digest = Digest::new();
            digest.update(first);
            digest.update(second);
            prop_assert_eq!(digest.finish(), Crc::<u32>::new(&CRC_32_ISO_HDLC).checksum(&bytes));
        }
    }
}
