//! Message types, framing and loss accounting shared by the firmware and the host.
//!
//! ```
//! use protocol::{Command, CommandReceiver, MAX_FRAME_TO_DEVICE, Received, Request, encode_command};
//!
//! let command = Command { id: 7, boot_id: 0x1234_5678, request: Request::Stop };
//! let mut buffer = [0; MAX_FRAME_TO_DEVICE];
//! let frame = encode_command(&command, &mut buffer)?;
//!
//! let mut receiver = CommandReceiver::new();
//! assert!(receiver.feed(b"noise").next().is_none());
//! let events: Vec<_> = receiver.feed(frame).collect();
//! assert_eq!(events, [Received::Corrupt, Received::Frame(command)]);
//! # Ok::<(), protocol::EncodeError>(())
//! ```
#![no_std]
#![forbid(unsafe_code)]
#![deny(missing_docs)]

#[cfg(test)]
extern crate std;

#[cfg(any(test, feature = "conformance"))]
pub mod conformance;
pub mod frame;
pub mod pack;
#[cfg(test)]
mod properties;
mod text;
mod to_device;
mod to_host;
pub mod tracker;

pub use frame::{
    CommandReceiver, EncodeError, EnvelopeReceiver, Incoming, Losses, MAX_FRAME_TO_DEVICE, MAX_FRAME_TO_HOST,
    Received, Receiver, encode_command, encode_envelope, peek_hello_version,
};
pub use pack::{MAX_SAMPLES, Packer, Sample, UnpackError, program_crc};
pub use text::{PACKED_BYTES, Packed, Text};
pub use to_device::*;
pub use to_host::*;
pub use tracker::{Arrival, Order, SequenceTracker, Totals};

/// Version of this protocol: messages, framing and their meaning.
pub const VERSION: u16 = 1;

/// Hash of the types of everything that is sent, both ways.
pub const fn schema_hash() -> [u8; 8] {
    use postcard_schema::key::hash::fnv1a64::hash_ty_path;
    const HASH: [u8; 8] = hash_ty_path::<(Command, Envelope)>("needle-guide");
    HASH
}
