//! Fixed-capacity text and bytes with their schema and their largest encoding.

use core::{fmt, ops::Deref};
use postcard::experimental::max_size::MaxSize;
use postcard_schema::{
    Schema,
    schema::{DataModelType, NamedType},
};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

/// Largest size of the packed samples of a batch, bytes. With it payload and checksum of every frame have fewer than 254
/// bytes, so that byte stuffing always adds one byte.
pub const PACKED_BYTES: usize = 211;

/// Bytes of the varint that holds a length up to `capacity`.
const fn length_bytes(capacity: usize) -> usize {
    let mut bytes = 1;
    let mut remaining_length = capacity >> 7;
    while remaining_length > 0 {
        bytes += 1;
        remaining_length >>= 7;
    }
    bytes
}

/// UTF-8 text of at most `N` bytes. On the wire: length as a varint, then the bytes.
#[derive(Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Text<const N: usize>(heapless::String<N>);

impl<const N: usize> Text<N> {
    /// The text, cut at the last character that still fits.
    pub fn new(text: &str) -> Self {
        let mut shortened = heapless::String::new();
        for character in text.chars() {
            if shortened.push(character).is_err() {
                break;
            }
        }
        Self(shortened)
    }

    /// The text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl<const N: usize> Deref for Text<N> {
    type Target = str;

    fn deref(&self) -> &str {
        &self.0
    }
}

impl<const N: usize> fmt::Display for Text<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self.as_str(), f)
    }
}

impl<const N: usize> fmt::Debug for Text<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self.as_str(), f)
    }
}

impl<const N: usize> Schema for Text<N> {
    const SCHEMA: &'static NamedType = &NamedType { name: "Text", ty: &DataModelType::String };
}

impl<const N: usize> MaxSize for Text<N> {
    const POSTCARD_MAX_SIZE: usize = N + length_bytes(N);
}

/// The packed bytes of a batch: see [`crate::pack`]. On the wire: length as a varint, then the bytes.
#[derive(Clone, Default, PartialEq, Eq)]
pub struct Packed(heapless::Vec<u8, PACKED_BYTES>);

impl Packed {
    /// These bytes, if there are at most [`PACKED_BYTES`].
    pub fn from_slice(bytes: &[u8]) -> Option<Self> {
        heapless::Vec::from_slice(bytes).ok().map(Self)
    }
}

impl Deref for Packed {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.0
    }
}

impl fmt::Debug for Packed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for byte in self.iter() {
            write!(f, "{byte:02x}")?;
        }
        Ok(())
    }
}

impl Serialize for Packed {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_bytes(self)
    }
}

impl<'de> Deserialize<'de> for Packed {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Bytes;
        impl de::Visitor<'_> for Bytes {
            type Value = Packed;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "at most {PACKED_BYTES} bytes")
            }

            fn visit_bytes<E: de::Error>(self, bytes: &[u8]) -> Result<Packed, E> {
                Packed::from_slice(bytes).ok_or_else(|| E::invalid_length(bytes.len(), &self))
            }
        }
        deserializer.deserialize_bytes(Bytes)
    }
}

impl Schema for Packed {
    const SCHEMA: &'static NamedType = &NamedType { name: "Packed", ty: &DataModelType::ByteArray };
}

impl MaxSize for Packed {
    const POSTCARD_MAX_SIZE: usize = PACKED_BYTES + length_bytes(PACKED_BYTES);
}
