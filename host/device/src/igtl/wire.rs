//! Divides the bytes of a connection into messages: has no socket, so that anything can be fed to it.

use super::image;
use super::message::{CRC, Content, HEADER_BYTES, MAX_POINTS, Message, MessageError, POINT_BYTES, unpadded};
use super::tracked::stated_invalid;
use std::time::Duration;

/// Largest body that is kept but for images that are wanted. Larger ones and those of other types are passed over without being kept.
pub const MAX_BODY_BYTES: usize = MAX_POINTS * POINT_BYTES + 4_096;
/// Largest body that is passed over: an image of a gigabyte is none.
pub const MAX_SKIPPED_BYTES: u64 = 1 << 30;

/// The bytes are not OpenIGTLink, or framing is lost: the connection cannot be used any more.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum StreamError {
    /// Header version.
    #[error("a message with header version {0}, expected 1 or 2: the peer does not use OpenIGTLink")]
    Version(u16),
    /// Size of the body.
    #[error("a message of {0} bytes, expected at most {MAX_SKIPPED_BYTES}")]
    Size(u64),
}

/// Result of receiving bytes.
#[derive(Debug, Clone, PartialEq)]
pub enum Arrival {
    /// A message.
    Message(Message),
    /// One that cannot be read.
    Unreadable(MessageError),
    /// One of a type that is not read, or too large: type and device name.
    Skipped(String, String),
    /// One whose metadata state that it is no measurement: type, device name, and what they state.
    Invalid(String, String, String),
}

/// Cuts bytes into messages; keeps at most one message.
#[derive(Debug, Default)]
pub struct Decoder {
    kept: Vec<u8>,
    /// Bytes that are passed over.
    skip: u64,
    has_images: bool,
}

/// Content of a header.
struct Header {
    version: u16,
    kind: String,
    device: String,
    stamp: Duration,
    body_bytes: u64,
    crc: u64,
}

impl Header {
    fn read(bytes: &[u8; HEADER_BYTES]) -> Option<Self> {
        let (version, tail) = bytes.split_first_chunk::<2>()?;
        let (kind, tail) = tail.split_first_chunk::<12>()?;
        let (device, tail) = tail.split_first_chunk::<20>()?;
        let (seconds, tail) = tail.split_first_chunk::<4>()?;
        let (fraction, tail) = tail.split_first_chunk::<4>()?;
        let (body_bytes, tail) = tail.split_first_chunk::<8>()?;
        let crc = tail.first_chunk::<8>()?;
        // A second has 2^32 parts; to the nearest nanosecond, so that a stamp is read as it was meant.
        let nanoseconds = (u64::from(u32::from_be_bytes(*fraction)) * 1_000_000_000 + (1 << 31)) >> 32;
        Some(Self {
            version: u16::from_be_bytes(*version),
            kind: unpadded(kind),
            device: unpadded(device),
            stamp: Duration::from_secs(u32::from_be_bytes(*seconds).into())
                + Duration::from_nanos(nanoseconds),
            body_bytes: u64::from_be_bytes(*body_bytes),
            crc: u64::from_be_bytes(*crc),
        })
    }

    /// The message with this body.
    fn message(self, body: &[u8]) -> Arrival {
        let Self { kind, device, stamp, .. } = self;
        if CRC.checksum(body) != self.crc {
            return Arrival::Unreadable(MessageError::Checksum { kind, device });
        }
        let parts = match self.version {
            1 => Some((body, Vec::new())),
            _ => within_extended(body),
        };
        let Some((content, metadata)) = parts else {
            return Arrival::Unreadable(MessageError::Extended { kind, device });
        };
        if let Some(stated) = stated_invalid(&device, &metadata) {
            return Arrival::Invalid(kind, device, stated);
        }
        match Content::read(&kind, &device, content) {
            Some(Ok(content)) => Arrival::Message(Message { device, stamp, content }),
            Some(Err(why)) => Arrival::Unreadable(why),
            None => Arrival::Skipped(kind, device),
        }
    }
}

/// A message's body without what is around it, and its metadata.
type Extended<'b> = (&'b [u8], Vec<(String, String)>);

/// The content between extended header and metadata, as header version 2 has them, and the metadata.
fn within_extended(body: &[u8]) -> Option<Extended<'_>> {
    let (header, after) = body.split_first_chunk::<2>()?;
    let (metadata_header, tail) = after.split_first_chunk::<2>()?;
    let metadata = tail.first_chunk::<4>()?;
    let header_bytes = usize::from(u16::from_be_bytes(*metadata_header));
    let metadata_bytes = usize::try_from(u32::from_be_bytes(*metadata)).ok()?.checked_add(header_bytes)?;
    let end = body.len().checked_sub(metadata_bytes)?;
    let content = body.get(usize::from(u16::from_be_bytes(*header))..end)?;
    Some((content, entries(body.get(end..)?, header_bytes)?))
}

/// Most entries of metadata that are looked at.
const MAX_ENTRIES: usize = 1_024;

/// Keys and values: sizes of all first, the texts behind them.
fn entries(metadata: &[u8], header_bytes: usize) -> Option<Vec<(String, String)>> {
    let (header, mut texts) = metadata.split_at_checked(header_bytes)?;
    let Some((count, sizes)) = header.split_first_chunk::<2>() else { return Some(Vec::new()) };
    let count = usize::from(u16::from_be_bytes(*count)).min(MAX_ENTRIES);
    // Size of the key (2 bytes), encoding of the value (2), size of the value (4).
    let (sizes, _) = sizes.as_chunks::<8>();
    fn take(bytes: usize, texts: &mut &[u8]) -> Option<String> {
        let (text, tail) = texts.split_at_checked(bytes)?;
        *texts = tail;
        Some(unpadded(text))
    }
    sizes
        .get(..count)?
        .iter()
        .map(|[a, b, _, _, c, d, e, f]| {
            let key = take(usize::from(u16::from_be_bytes([*a, *b])), &mut texts)?;
            let value = take(usize::try_from(u32::from_be_bytes([*c, *d, *e, *f])).ok()?, &mut texts)?;
            Some((key, value))
        })
        .collect()
}

impl Decoder {
    /// One that reads images too; keeps at most one of [`image::MAX_PIXEL_BYTES`].
    pub fn with_images() -> Self {
        Self { has_images: true, ..Self::default() }
    }

    /// Takes what has arrived and passes on what it completes, in order.
    ///
    /// # Errors
    /// [`StreamError`]: nothing after it can be understood.
    pub fn feed(&mut self, mut bytes: &[u8], mut on_arrival: impl FnMut(Arrival)) -> Result<(), StreamError> {
        while !bytes.is_empty() {
            if self.skip > 0 {
                let passed = usize::try_from(self.skip).unwrap_or(usize::MAX).min(bytes.len());
                self.skip -= passed as u64;
                bytes = bytes.get(passed..).unwrap_or_default();
                continue;
            }
            let wanted_bytes = HEADER_BYTES + self.header().map_or(0, |header| header.body_bytes as usize);
            let (chunk, tail) = bytes.split_at(wanted_bytes.saturating_sub(self.kept.len()).min(bytes.len()));
            self.kept.extend_from_slice(chunk);
            bytes = tail;
            if let Some(arrival) = self.complete()? {
                on_arrival(arrival);
            }
        }
        Ok(())
    }

    /// Whether a message has begun and is not complete.
    pub fn is_inside(&self) -> bool {
        self.skip > 0 || !self.kept.is_empty()
    }

    /// Bytes that are kept.
    pub fn kept(&self) -> usize {
        self.kept.len()
    }

    fn header(&self) -> Option<Header> {
        self.kept.first_chunk().and_then(Header::read)
    }

    /// Message that the kept bytes complete.
    fn complete(&mut self) -> Result<Option<Arrival>, StreamError> {
        let Some(header) = self.header() else { return Ok(None) };
        if !(1..=2).contains(&header.version) {
            return Err(StreamError::Version(header.version));
        }
        if header.body_bytes > MAX_SKIPPED_BYTES {
            return Err(StreamError::Size(header.body_bytes));
        }
        let is_image = header.kind == "IMAGE";
        let most_bytes = if is_image { image::MAX_BODY_BYTES } else { MAX_BODY_BYTES };
        let is_read = Content::READ.contains(&header.kind.as_str()) && (self.has_images || !is_image);
        if header.body_bytes > most_bytes as u64 || !is_read {
            self.skip = header.body_bytes;
            self.kept.clear();
            return Ok(Some(Arrival::Skipped(header.kind, header.device)));
        }
        let body = self.kept.get(HEADER_BYTES..).unwrap_or_default();
        if (body.len() as u64) < header.body_bytes {
            return Ok(None);
        }
        let arrival = header.message(body);
        self.kept.clear();
        Ok(Some(arrival))
    }
}
