//! Frames: how a message becomes bytes on the line, and how the receiver finds it again.

use crate::checksum::crc32;
use crate::{Command, Envelope, Message};
use core::marker::PhantomData;
use postcard::experimental::max_size::MaxSize;
use serde::{Serialize, de::DeserializeOwned};

pub(crate) const CRC_BYTES: usize = 4;

/// Bytes between the delimiters for a message that encodes to `payload` bytes at most.
const fn body_bytes(payload: usize) -> usize {
    corncobs::max_encoded_len(payload + CRC_BYTES) - 1
}

/// Largest number of bytes between the delimiters of a frame from the device.
pub const MAX_BODY_TO_HOST: usize = body_bytes(Envelope::POSTCARD_MAX_SIZE);
/// Largest number of bytes between the delimiters of a frame from the host.
pub const MAX_BODY_TO_DEVICE: usize = body_bytes(Command::POSTCARD_MAX_SIZE);
/// Largest frame from the device, bytes, both delimiters included.
pub const MAX_FRAME_TO_HOST: usize = MAX_BODY_TO_HOST + 2;
/// Largest frame from the host, bytes, both delimiters included.
pub const MAX_FRAME_TO_DEVICE: usize = MAX_BODY_TO_DEVICE + 2;

/// Largest number of bytes before stuffing, both ways. Below 254 bytes stuffing adds one byte and is one-to-one: no two bodies
/// decode to the same bytes, so that a changed body cannot be taken for the original.
pub(crate) const MAX_PLAIN: usize = 253;
const _: () = assert!(Envelope::POSTCARD_MAX_SIZE + CRC_BYTES <= MAX_PLAIN);
const _: () = assert!(Command::POSTCARD_MAX_SIZE + CRC_BYTES <= MAX_PLAIN);

/// Why a message did not become a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum EncodeError {
    /// The output is shorter than the frame: [`MAX_FRAME_TO_HOST`] or [`MAX_FRAME_TO_DEVICE`] bytes always suffice.
    #[error("the output buffer is too short for the frame")]
    OutputTooShort,
}

/// Writes the frame of a message to the host and returns its bytes.
pub fn encode_envelope<'a>(envelope: &Envelope, output: &'a mut [u8]) -> Result<&'a [u8], EncodeError> {
    encode(envelope, output)
}

/// Writes the frame of a command to the device and returns its bytes.
pub fn encode_command<'a>(command: &Command, output: &'a mut [u8]) -> Result<&'a [u8], EncodeError> {
    encode(command, output)
}

fn encode<'a>(message: &impl Serialize, output: &'a mut [u8]) -> Result<&'a [u8], EncodeError> {
    let mut plain = [0; MAX_PLAIN];
    let payload = postcard::to_slice(message, &mut plain).map_err(|_| EncodeError::OutputTooShort)?.len();
    seal(&mut plain, payload, output)
}

/// Adds the checksum to the first `payload` bytes of `plain`, stuffs and delimits them.
pub(crate) fn seal<'a>(
    plain: &mut [u8; MAX_PLAIN],
    payload: usize,
    output: &'a mut [u8],
) -> Result<&'a [u8], EncodeError> {
    let plain = plain.get_mut(..payload + CRC_BYTES).ok_or(EncodeError::OutputTooShort)?;
    let (head, tail) = plain.split_at_mut(payload);
    tail.copy_from_slice(&crc32(head).to_le_bytes());

    let (first, body) = output.split_first_mut().ok_or(EncodeError::OutputTooShort)?;
    *first = 0;
    // For fewer than 254 bytes the largest stuffed length is also the only one.
    let stuffed =
        body.get_mut(..corncobs::max_encoded_len(plain.len())).ok_or(EncodeError::OutputTooShort)?;
    let end = 1 + corncobs::encode_buf(plain, stuffed);
    output.get(..end).ok_or(EncodeError::OutputTooShort)
}

/// A message that a [`Receiver`] can receive, with the part of it that is readable in every version of the protocol.
pub trait Incoming: DeserializeOwned {
    /// Part of a message that is readable although the message does not decode.
    type Salvage;

    /// Reads that part from an intact payload, where it has the same place in every version of the protocol.
    fn salvage(payload: &[u8]) -> Option<Self::Salvage>;

    /// Reads the message of an intact payload, which the message must fill exactly.
    fn read(payload: &[u8]) -> Option<Self> {
        exactly(payload)
    }
}

/// The message, if it fills the payload to the last byte.
fn exactly<T: DeserializeOwned>(payload: &[u8]) -> Option<T> {
    match postcard::take_from_bytes(payload) {
        Ok((message, [])) => Some(message),
        _ => None,
    }
}

impl Incoming for Envelope {
    /// The `protocol_version` of a `Hello`.
    type Salvage = u16;

    fn salvage(payload: &[u8]) -> Option<u16> {
        peek_hello_version(payload)
    }

    fn read(payload: &[u8]) -> Option<Self> {
        exactly(payload).or_else(|| {
            // Up to version 5 `Samples` and `Status` lack their last field; it is read as zero.
            let mut longer = [0; MAX_PLAIN];
            longer.get_mut(..payload.len())?.copy_from_slice(payload);
            let envelope: Self = exactly(longer.get(..=payload.len())?)?;
            matches!(envelope.message, Message::Samples(_) | Message::Status(_)).then_some(envelope)
        })
    }
}

impl Incoming for Command {
    /// The `id`, which the refusal of an unreadable command needs.
    type Salvage = u16;

    fn salvage(payload: &[u8]) -> Option<u16> {
        postcard::take_from_bytes::<u16>(payload).ok().map(|(id, _)| id)
    }
}

/// The protocol version in the payload of an `Envelope` that holds a `Hello`, independent of what follows it.
pub fn peek_hello_version(payload: &[u8]) -> Option<u16> {
    const HELLO: u32 = 0;
    match postcard::take_from_bytes::<(u32, u32, u32, u16)>(payload) {
        Ok(((_boot_id, _sequence, HELLO, version), _)) => Some(version),
        _ => None,
    }
}

/// Event that a [`Receiver`] finds in the bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Received<T: Incoming> {
    /// An intact message.
    Frame(T),
    /// A body that failed its byte stuffing or its checksum.
    Corrupt,
    /// A body longer than any message; everything up to the next delimiter is dropped.
    Overlong,
    /// An intact body whose payload is no message of this version: the other side has other types.
    Unreadable(Option<T::Salvage>),
}

/// Counts of bytes and frames that a [`Receiver`] could not use; the counters stop at their largest
/// value.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Losses {
    /// Bodies that failed their byte stuffing or their checksum.
    pub corrupt: u32,
    /// Bodies longer than any message.
    pub overlong: u32,
    /// Intact bodies that did not decode.
    pub unreadable: u32,
}

/// Finds messages in a stream of bytes: bytes in, events out, the same however the stream is cut into chunks.
///
/// It holds one body of at most `N` bytes. Work per byte is bounded: a push, or at a delimiter one pass over that body.
#[derive(Debug)]
pub struct Receiver<T, const N: usize> {
    body: heapless::Vec<u8, N>,
    dropping: bool,
    losses: Losses,
    message: PhantomData<fn() -> T>,
}

/// The device's receiver.
pub type CommandReceiver = Receiver<Command, MAX_BODY_TO_DEVICE>;
/// The host's receiver.
pub type EnvelopeReceiver = Receiver<Envelope, MAX_BODY_TO_HOST>;

impl<T: Incoming, const N: usize> Default for Receiver<T, N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T: Incoming, const N: usize> Receiver<T, N> {
    /// A receiver in the state after a delimiter.
    pub const fn new() -> Self {
        let losses = Losses { corrupt: 0, overlong: 0, unreadable: 0 };
        Self { body: heapless::Vec::new(), dropping: false, losses, message: PhantomData }
    }

    /// Takes one byte. Delimiters with nothing between them are no event.
    #[inline]
    pub fn push(&mut self, byte: u8) -> Option<Received<T>> {
        if byte != 0 {
            if self.dropping || self.fill(&[byte]) > 0 {
                return None;
            }
            self.dropping = true;
            self.losses.overlong = self.losses.overlong.saturating_add(1);
            return Some(Received::Overlong);
        }
        let event = if self.dropping || self.body.is_empty() { None } else { Some(self.open()) };
        self.dropping = false;
        self.body.clear();
        match event {
            Some(Received::Corrupt) => self.losses.corrupt = self.losses.corrupt.saturating_add(1),
            Some(Received::Unreadable(_)) => {
                self.losses.unreadable = self.losses.unreadable.saturating_add(1)
            }
            _ => {}
        }
        event
    }

    /// Takes a chunk and yields its events. Exhaust the iterator: it takes the bytes only up to the last event that it has yielded.
    pub fn feed<'a>(&'a mut self, chunk: &'a [u8]) -> impl Iterator<Item = Received<T>> + 'a {
        let mut unread = chunk;
        core::iter::from_fn(move || {
            while !unread.is_empty() {
                // The bytes before the next delimiter are copied together, as far as they fit; the next byte is handled by itself.
                let (ordinary, _) = memchr::memchr(0, unread)
                    .and_then(|zero| unread.split_at_checked(zero))
                    .unwrap_or((unread, &[]));
                let consumed_bytes = if self.dropping { ordinary.len() } else { self.fill(ordinary) };
                let (byte, later) = unread.get(consumed_bytes..)?.split_first()?;
                unread = later;
                if let Some(event) = self.push(*byte) {
                    return Some(event);
                }
            }
            None
        })
    }

    /// Takes as many bytes as fit and returns how many.
    fn fill(&mut self, bytes: &[u8]) -> usize {
        let room = N - self.body.len();
        let fits = bytes.get(..room).unwrap_or(bytes);
        self.body.extend_from_slice(fits).map_or(0, |()| fits.len())
    }

    /// Reads the complete body: first the checksum, then the message, which must fill the payload exactly.
    #[inline]
    fn open(&mut self) -> Received<T> {
        let plain = corncobs::decode_in_place(&mut self.body).ok().and_then(|length| self.body.get(..length));
        let Some((payload, crc)) = plain.and_then(|plain| plain.split_last_chunk::<CRC_BYTES>()) else {
            return Received::Corrupt;
        };
        if crc32(payload) != u32::from_le_bytes(*crc) {
            return Received::Corrupt;
        }
        match T::read(payload) {
            Some(message) => Received::Frame(message),
            None => Received::Unreadable(T::salvage(payload)),
        }
    }

    /// Losses so far.
    pub const fn losses(&self) -> Losses {
        self.losses
    }
}
