//! The interface between the needle guide's firmware and its host. This page is the interface control document.
//!
//! Two streams of bytes, one each way, over anything that carries eight-bit bytes in order (a UART, a USB serial port, a
//! pseudo terminal). Bytes may be damaged or lost anywhere; a damaged frame is not taken for a message, and losses are counted.
//! This page specifies the bytes on the line, the types document the fields. Tests compare the numbers of the page with the code,
//! most of them by [`conformance`](#conformance), which also runs on the microcontroller.
//!
//! # A frame
//!
//! | on the wire, in this order | bytes | what |
//! |---|---|---|
//! | delimiter | 1 | `0x00`: ends any noise before it |
//! | body, byte-stuffed ([COBS]) | | holds no `0x00`; 1 byte longer than payload and checksum |
//! | &nbsp; payload | 3 to 247 | the message in [postcard] format |
//! | &nbsp; checksum | 4 | CRC-32/ISO-HDLC of the payload, little-endian: the one of zlib, Ethernet and PNG |
//! | delimiter | 1 | `0x00` |
//!
//! | bound, bytes | from the device | from the host |
//! |---|---|---|
//! | payload | 247 | 26 |
//! | frame, both delimiters included | 254 ([`MAX_FRAME_TO_HOST`]) | 33 ([`MAX_FRAME_TO_DEVICE`]) |
//!
//! The largest messages reach these bounds. Payload and checksum have fewer than 254 bytes, so that stuffing adds exactly one byte
//! and a payload has one encoding only. Any number of delimiters between two frames, from one on, is valid.
//!
//! A receiver ([`Receiver`]) drops a body that is longer than the bound, up to the next delimiter; it unstuffs any other, compares
//! the checksum, and only then reads the message, which must fill the payload to its last byte. A frame that fails is counted as
//! over-long, corrupt or unreadable ([`Losses`]) and does not affect its neighbours; the receiver does not request it again.
//!
//! `Stop`, sent as command 300 of the connection `0xA1B2C3D4`:
//!
//! ```
//! use protocol::{Command, MAX_FRAME_TO_DEVICE, Request, encode_command};
//!
//! let stop = Command { id: 300, connection: 0xA1B2_C3D4, request: Request::Stop };
//! let mut buffer = [0; MAX_FRAME_TO_DEVICE];
//! assert_eq!(
//!     encode_command(&stop, &mut buffer)?,
//!     [
//!         0x00, // delimiter
//!         0x0D, // stuffing: the next zero would be 13 bytes on, which is the end
//!         0xAC, 0x02, // id, a varint
//!         0xD4, 0x87, 0xCB, 0x8D, 0x0A, // connection, a varint
//!         0x05, // the sixth request
//!         0xE9, 0xF3, 0x12, 0x47, // checksum of the eight bytes before it
//!         0x00, // delimiter
//!     ]
//! );
//! # Ok::<(), protocol::EncodeError>(())
//! ```
//!
//! # Requests and messages
//!
//! The host sends a [`Command`]: `id`, `connection`, [`Request`]. The device sends an [`Envelope`]: `boot_id`, `sequence`,
//! [`Message`]. The number is the index of the variant, as it is encoded.
//!
//! | | request | answers, in order | effect |
//! |---|---|---|---|
//! | 0 | `Hello` | `Hello`, `Connected`, `Ack` | a new connection, whose token every further command carries |
//! | 1 | `Status` | `Status`, `Ack` | none |
//! | 2 | `Stream { enable }` | `Ack` | telemetry batches on or off |
//! | 3 | `LoadStep { index, step }` | `Ack` | stores one [`Step`] of the motion program |
//! | 4 | `Run { steps, crc, start_us }` | `Ack` | starts the program at a device time if its steps have this checksum; events follow |
//! | 5 | `Stop` | `Ack` | ends any motion at once; telemetry goes on |
//! | 6 | `ClearFault` | `Ack` | leaves the fault state if its cause is gone and both axes are at rest |
//! | 7 | `Limits { force_mn, silence_ms }` | `Ack` | force limit and longest silence of the host, until the next start |
//! | 8 | `LoadCalibration { piece, bytes }` | `Ack` | takes 16 bytes of an encoded [`CalibrationRecord`] |
//! | 9 | `StoreCalibration { length, crc }` | `Ack` | stores the record if it has this checksum, and restarts with it |
//! | 10 | `Calibration` | `Calibration`, `Ack` | none |
//! | 11 | `Retreat { x_um, y_um }` | `Ack` | unloads the guide while a fault is latched; an event follows |
//! | 12 | `AcknowledgeCalibration` | `Ack` | works with the constants of the rig as designed, or of an earlier calibration, until the next start |
//! | 13 | `Describe` | `Description`, `Ack` | none |
//! | 14 | `Safety` | `Safety`, `Ack` | none |
//! | 15 | `Pulse { axis, duty_permille, duration_ms }` | `Ack` | drives one motor briefly; an event follows |
//!
//! | | message | when |
//! |---|---|---|
//! | 0 | [`Hello`] | on request: version, schema hash, board, clock, sample period, value of a count, calibration, last panic |
//! | 1 | `Ack { id }` | the command was carried out, now or at its first arrival |
//! | 2 | `Refused { id, refusal }` | the command was not carried out, and why: [`Refusal`] |
//! | 3 | [`Samples`] | while telemetry is on: a batch is full, its state or step has ended, or an answer or event follows it |
//! | 4 | [`Event`] | a step began or ended; a tare was completed or rejected; a program, a retreat or a pulse ended; a fault was latched |
//! | 5 | [`Status`] | on request, and ten times a second while telemetry is on: state, fault, position, force, counters, load, stiffness |
//! | 6 | [`CalibrationRecord`] | on request |
//! | 7 | `Connected { connection }` | after the hello |
//! | 8 | [`Safety`] | on request; while telemetry is on also once a second, and when calibration, tare or zero changes |
//! | 9 | [`Description`] | on request |
//!
//! `protocol/spec/protocol.md` lists the refusals of each request in each state, the remedy of each refusal and fault, and the
//! changes from version to version. The schema and the test vectors for other languages are beside it.
//!
//! # Rules
//!
//! * **Handshake.** The host always sends a hello first, and again after every start of the device. The version has the same place
//!   in every version of the protocol, so that two versions can detect that they differ ([`peek_hello_version`]). With equal
//!   [`VERSION`] the [`schema_hash`] of all types must be equal too, or the host sends nothing further.
//! * **Commands are carried out once.** The host waits for `Ack` or `Refused` with the id of its command and sends the same
//!   frame again when none comes; the device answers a repeat as it did before and does nothing else. Ids only grow within a
//!   connection: a used id whose answer is forgotten, or that comes with another request, is refused. `Stop` and `Hello` are
//!   carried out each time. One command is under way at a time.
//! * **Connections.** A command without a valid token is refused (`Hello` and `Stop` excepted). A token is valid for one start of
//!   the device, so that no command from before a restart is carried out after it. An envelope of another boot informs the host of
//!   the restart.
//! * **Sequence.** Envelopes are numbered from 0 at each boot, wrapping; each number is one more than the one before. A jump forward
//!   by n (less than 2³¹) means that n - 1 frames are lost. The same number is a duplicate, an earlier number is late, and neither
//!   is used ([`SequenceTracker`]).
//! * **Time.** Device microseconds since boot, in 64 bits. A batch has the time of its first sample; the others follow at
//!   `Hello::sample_period_us`. A gap in the times means lost samples, on either side; those that the device itself
//!   had to drop are counted in `Samples::dropped`.
//! * **Silence.** While a program is pending or running, or a retreat runs, accepted commands of the connection that started it are
//!   keepalives. After `silence_ms` without one the device latches a fault or ends the retreat, and switches the bridges off.
//! * **The device sends no message again.** Later state repeats what may be lost: every batch has state and step, `Status` has
//!   state, fault and counters, so that a host that missed an event still finds the end of a program.
//! * **Change.** Variants are appended, never inserted; any other change of a type raises [`VERSION`]. Either changes the
//!   schema hash, which a test pins. A field that is appended to [`Samples`] or [`Status`] is zero in what older versions have recorded.
//!
//! # Samples are packed
//!
//! A sample is four numbers of 32 bits, a thousand times a second: as plain integers 16 bytes. A batch ([`Packer`], at most
//! [`MAX_SAMPLES`]) stores, for each channel, the readings or their differences less the smallest of them, in as few bits as
//! the largest of these needs. With position noise of 3 counts and force noise of 100 counts a sample takes
//!
//! | | bytes |
//! |---|---|
//! | as plain integers | 16 |
//! | packed | 3.7 |
//! | packed, on the wire, with its share of the frame | 4.6 |
//!
//! at any position and force: the readings of a batch spread by little more than the noise, or than the motion in a period. This is
//! 4.6 kB/s of the 46 kB/s that 460,800 baud carry, so that a line that was disturbed for a while catches up, and a file of
//! frames stays small. A batch can be used only as a whole, which the checksum of the frame requires anyway. See [`pack`].
//!
//! # Conformance
//!
//! With the feature `conformance` the module of that name holds the tests of this page as a list that needs neither std nor a
//! heap: golden bytes of every message both ways, every single-bit error, every way of cutting the stream, every kind of bad
//! frame between good ones, every kind of loss. The firmware's image `conformance` runs it on the target.
//!
//! # Using it
//!
//! ```
//! use protocol::{Command, CommandReceiver, MAX_FRAME_TO_DEVICE, Received, Request, encode_command};
//!
//! let command = Command { id: 7, connection: 0x1234_5678, request: Request::Stop };
//! let mut buffer = [0; MAX_FRAME_TO_DEVICE];
//! let frame = encode_command(&command, &mut buffer)?;
//!
//! let mut receiver = CommandReceiver::new();
//! assert!(receiver.feed(b"noise").next().is_none());
//! let events: Vec<_> = receiver.feed(frame).collect();
//! assert_eq!(events, [Received::Corrupt, Received::Frame(command)]);
//! # Ok::<(), protocol::EncodeError>(())
//! ```
//!
//! # Example
//!
//! A byte of the first of two frames is damaged on the way to the host; the second arrives, and the loss is counted:
//!
//! ```
//! use protocol::{Envelope, EnvelopeReceiver, MAX_FRAME_TO_HOST, Message, Received, encode_envelope};
//!
//! let acknowledged = |id| Envelope { boot_id: 1, sequence: u32::from(id), message: Message::Ack { id } };
//! let mut buffer = [0; MAX_FRAME_TO_HOST];
//! let mut line = encode_envelope(&acknowledged(7), &mut buffer)?.to_vec();
//! line[5] ^= 0x10;
//! line.extend_from_slice(encode_envelope(&acknowledged(8), &mut buffer)?);
//!
//! let mut receiver = EnvelopeReceiver::new();
//! let arrived: Vec<_> = receiver.feed(&line).collect();
//! assert_eq!(arrived, [Received::Corrupt, Received::Frame(acknowledged(8))]);
//! assert_eq!(receiver.losses().corrupt, 1);
//! # Ok::<(), protocol::EncodeError>(())
//! ```
//!
//! [COBS]: https://doi.org/10.1109/90.769765
//! [postcard]: https://postcard.jamesmunns.com/wire-format
#![no_std]
#![forbid(unsafe_code)]
#![deny(missing_docs)]
// Invalid input cannot cause a panic.
#![cfg_attr(
    not(test),
    deny(clippy::indexing_slicing, clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::todo)
)]

#[cfg(test)]
extern crate std;

pub mod calibration;
mod checksum;
mod condition;
#[cfg(any(test, feature = "conformance"))]
pub mod conformance;
pub mod frame;
pub mod pack;
pub mod plausible;
#[cfg(test)]
mod properties;
mod text;
mod to_device;
mod to_host;
pub mod tracker;

pub use calibration::{
    CODES_PER_KNOT, CalibrationId, CalibrationRecord, KNOTS, MAX_CALIBRATION, PIECE_BYTES,
    PotentiometerTable, calibration_crc,
};
pub use condition::*;
pub use frame::{
    CommandReceiver, EncodeError, EnvelopeReceiver, Incoming, Losses, MAX_FRAME_TO_DEVICE, MAX_FRAME_TO_HOST,
    Received, Receiver, encode_command, encode_envelope, peek_hello_version,
};
pub use pack::{MAX_SAMPLES, Packer, Sample, UnpackError, program_crc};
pub use plausible::Implausible;
pub use text::{PACKED_BYTES, Packed, Text};
pub use to_device::*;
pub use to_host::*;
pub use tracker::{Arrival, Order, SequenceTracker, Totals};

/// Version of this protocol: messages, framing and their meaning.
pub const VERSION: u16 = 6;

/// Hash of the types of everything that is sent, both ways.
pub const fn schema_hash() -> [u8; 8] {
    use postcard_schema::key::hash::fnv1a64::hash_ty_path;
    const HASH: [u8; 8] = hash_ty_path::<(Command, Envelope)>("needle-guide");
    HASH
}
