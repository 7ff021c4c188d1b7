//! The decoder of OpenIGTLink, fed with bytes as a connection brings them.
//!
//! Input: a byte for the length of the pieces; then either the bytes of the stream, or messages whose header is written here, so that
//! their checksum fits.

use super::Bytes;
use device::igtl::message::HEADER_BYTES;
use device::igtl::message::{Content, Message};
use device::igtl::wire::{Arrival, Decoder, MAX_BODY_BYTES, StreamError};

/// Feeds the decoder.
///
/// # Panics
/// Where it keeps more than a message, pieces matter, or what is read is not what is read again after it was written.
pub fn run(data: &[u8]) {
    let Some((&piece, pieces)) = data.split_first() else { return };
    let stream = if piece & 1 == 0 { pieces.to_vec() } else { messages(Bytes(pieces)) };
    let (whole, outcome) = decoded(&stream, usize::MAX);
    assert_eq!((words(&whole), outcome), {
        let (arrivals, outcome) = decoded(&stream, usize::from(piece >> 1) + 1);
        (words(&arrivals), outcome)
    });
    for arrival in whole {
        if let Arrival::Message(message) = arrival {
            written(&message);
        }
    }
}

/// Everything that comes of a stream in pieces of such a length.
fn decoded(stream: &[u8], piece: usize) -> (Vec<Arrival>, Result<(), StreamError>) {
    let (mut decoder, mut arrivals) = (Decoder::default(), Vec::new());
    for piece in stream.chunks(piece) {
        let outcome = decoder.feed(piece, |arrival| arrivals.push(arrival));
        assert!(decoder.kept() <= HEADER_BYTES + MAX_BODY_BYTES, "{} bytes are kept", decoder.kept());
        if outcome.is_err() {
            return (arrivals, outcome);
        }
    }
    (arrivals, Ok(()))
}

/// Comparable text of arrivals: a number that is none is not equal to itself.
fn words(arrivals: &[Arrival]) -> Vec<String> {
    arrivals.iter().map(|arrival| format!("{arrival:?}")).collect()
}

/// Writes a message and reads it again.
fn written(message: &Message) {
    let again = read_again(message);
    // A name that is no UTF-8 is shown with longer characters and cut; a position is turned by the rounding of its quaternion.
    let shown = format!("{message:?}");
    if let (Content::Position(first_pose), Content::Position(second_pose)) =
        (&message.content, &again.content)
    {
        assert_eq!(first_pose.position_mm, second_pose.position_mm);
        let axis_pairs = first_pose.axes.iter().flatten().zip(second_pose.axes.iter().flatten());
        let difference = axis_pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(difference < 1e-3, "{message:?} is turned: {again:?}");
    } else if !shown.contains('\u{fffd}') {
        assert_eq!(format!("{again:?}"), shown);
    }
    let third = read_again(&again);
    if !matches!(message.content, Content::Position(_)) {
        assert_eq!(format!("{third:?}"), format!("{again:?}"));
    }
}

fn read_again(message: &Message) -> Message {
    match decoded(&message.to_bytes(), usize::MAX).0.pop() {
        Some(Arrival::Message(read)) => read,
        other => panic!("{message:?} is read as {other:?}"),
    }
}

/// The bytes of messages: each a type, a header version, a device name, a stamp and a body.
fn messages(mut bytes: Bytes) -> Vec<u8> {
    let mut stream = Vec::new();
    while !bytes.is_empty() {
        let choice = usize::from(bytes.u8());
        let kind = Content::READ.get(choice % 8).copied().unwrap_or("IMAGE");
        let device: Vec<u8> = bytes.sized().iter().copied().chain([0; 20]).take(20).collect();
        let stamp: [u8; 8] = bytes.array();
        let length = bytes.u16();
        let body = bytes.take(length.into());
        stream.extend(if choice & 8 == 0 { [0, 1] } else { [0, 2] });
        stream.extend(kind.bytes().chain([0; 12]).take(12));
        stream.extend(device);
        stream.extend(stamp);
        stream.extend((body.len() as u64).to_be_bytes());
        stream.extend(crc64(body).to_be_bytes());
        stream.extend(body);
    }
    stream
}

/// CRC-64/ECMA-182, bit by bit.
fn crc64(bytes: &[u8]) -> u64 {
    const POLYNOMIAL: u64 = 0x42F0_E1EB_A9EA_3693;
    bytes.iter().fold(0, |crc, byte| {
        let mixed = crc ^ u64::from(*byte) << 56;
        (0..8).fold(mixed, |crc, _| if crc >> 63 == 0 { crc << 1 } else { crc << 1 ^ POLYNOMIAL })
    })
}
