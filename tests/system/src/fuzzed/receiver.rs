//! The receivers of both ends of the link, fed with bytes as a line brings them.
//!
//! Input: bytes in pieces of the length in the first byte.

use super::sealed;
use protocol::frame::{Incoming, MAX_BODY_TO_DEVICE, MAX_BODY_TO_HOST};
use protocol::{
    Command, CommandReceiver, Envelope, Losses, MAX_FRAME_TO_DEVICE, MAX_FRAME_TO_HOST, Message, Order,
    Received, Receiver, Request, SequenceTracker, encode_command, encode_envelope,
};
use std::fmt::Debug;

/// Feeds both receivers.
///
/// # Panics
/// Where the books do not balance, pieces matter, or a sound frame after a zero byte does not arrive.
pub fn run(data: &[u8]) {
    let Some((&piece, stream)) = data.split_first() else { return };
    let piece = usize::from(piece).max(1);

    let stop = Command { id: 7, connection: 1, request: Request::Stop };
    let mut buffer = [0; MAX_FRAME_TO_DEVICE];
    let frame = encode_command(&stop, &mut buffer).expect("the bound suffices");
    fed::<Command, MAX_BODY_TO_DEVICE>(stream, piece, frame, &stop);

    let ack = Envelope { boot_id: 1, sequence: 9, message: Message::Ack { id: 7 } };
    let mut buffer = [0; MAX_FRAME_TO_HOST];
    let frame = encode_envelope(&ack, &mut buffer).expect("the bound suffices");
    let received = fed::<Envelope, MAX_BODY_TO_HOST>(stream, piece, frame, &ack);
    tracked(&received);

    // The device's receiver gets through a checksum too.
    let events: Vec<_> = CommandReceiver::new().feed(&sealed(stream)).collect();
    assert_eq!(events.len(), 1, "a frame is one event");
}

/// Everything that comes of a stream; its books, whole and in pieces, and the sound frame behind it.
fn fed<T, const N: usize>(stream: &[u8], piece: usize, frame: &[u8], sound: &T) -> Vec<T>
where
    T: Incoming + PartialEq + Debug + Clone,
    T::Salvage: PartialEq + Debug + Clone,
{
    let mut receiver = Receiver::<T, N>::new();
    let whole: Vec<_> = receiver.feed(stream).collect();
    let mut in_pieces = Receiver::<T, N>::new();
    let mut pieces = Vec::new();
    for piece in stream.chunks(piece) {
        pieces.extend(in_pieces.feed(piece));
    }
    assert_eq!(whole, pieces, "the same in pieces");
    assert_eq!(receiver.losses(), in_pieces.losses());
    // A body is not kept beyond its bound, for any input.
    assert!(size_of_val(&receiver) <= N + 64);

    // One event for each complete body, and one for a last one that is too long already.
    let mut bodies: Vec<&[u8]> = stream.split(|&byte| byte == 0).collect();
    let last = bodies.pop().unwrap_or_default();
    let complete = bodies.iter().filter(|body| !body.is_empty()).count();
    assert_eq!(whole.len(), complete + usize::from(last.len() > N), "one event per body");
    let expected = Losses {
        corrupt: count_where(|event| matches!(event, Received::Corrupt), &whole),
        overlong: count_where(|event| matches!(event, Received::Overlong), &whole),
        unreadable: count_where(|event| matches!(event, Received::Unreadable(_)), &whole),
    };
    assert_eq!(receiver.losses(), expected, "what cannot be used is counted");
    let longer = bodies.iter().chain([&last]).filter(|body| body.len() > N).count();
    assert_eq!(longer, expected.overlong as usize);

    let events: Vec<_> = receiver.feed(frame).collect();
    assert_eq!(
        events.last(),
        Some(&Received::Frame(sound.clone())),
        "a sound frame after a zero byte arrives"
    );
    let frames = whole.into_iter().filter_map(|event| match event {
        Received::Frame(frame) => Some(frame),
        _ => None,
    });
    frames.collect()
}

fn count_where<T: Incoming>(is: fn(&Received<T>) -> bool, whole: &[Received<T>]) -> u32 {
    whole.iter().filter(|event| is(event)).count() as u32
}

/// The books of the loss accounting over these envelopes.
fn tracked(envelopes: &[Envelope]) {
    let mut tracker = SequenceTracker::new();
    let (mut used_count, mut skipped, mut samples, mut missing) = (0, 0, 0, 0_u64);
    for envelope in envelopes {
        let arrival = tracker.observe(envelope);
        if matches!(arrival.order, Order::Duplicate | Order::Late) {
            skipped += 1;
            continue;
        }
        used_count += 1;
        missing = missing.saturating_add(arrival.samples_missing);
        if let Message::Samples(batch) = &envelope.message {
            samples += u64::from(batch.count);
        }
    }
    let totals = tracker.totals();
    assert_eq!((totals.frames, totals.duplicates + totals.late), (used_count, skipped));
    assert_eq!((totals.samples, totals.samples_missing), (samples, missing));
}
