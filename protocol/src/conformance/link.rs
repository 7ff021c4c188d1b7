//! The receiver under every kind of damage.

use super::{
    BUFFER, Buffer, Golden, Verdict, append, bytes, check, command, envelope, gives,
    golden_commands::COMMANDS, golden_envelopes::ENVELOPES,
};
use crate::{
    Command, CommandReceiver, Envelope, EnvelopeReceiver, Incoming, Losses, Message, Received, Receiver,
    Request, Text, encode_command, encode_envelope,
    frame::{CRC_BYTES, MAX_BODY_TO_DEVICE, MAX_BODY_TO_HOST, MAX_PLAIN, seal},
};

const CORRUPT: Losses = Losses { corrupt: 1, overlong: 0, unreadable: 0 };
const OVERLONG: Losses = Losses { corrupt: 0, overlong: 1, unreadable: 0 };
const UNREADABLE: Losses = Losses { corrupt: 0, overlong: 0, unreadable: 1 };

/// Feeds a frame with one bit flipped, and a delimiter: no message may come out, and the loss must be counted.
fn flips<T: Incoming, const N: usize>(golden: &[Golden<T>]) -> Verdict {
    golden.iter().try_for_each(|Golden { frame, .. }| {
        let mut buffer = BUFFER;
        let frame = bytes(frame, &mut buffer)?;
        for bit in 0..frame.len() * 8 {
            let mut receiver = Receiver::<T, N>::new();
            let mut events = 0;
            for byte in frame
                .iter()
                .enumerate()
                .map(|(at, &byte)| byte ^ if at == bit / 8 { 1 << (bit % 8) } else { 0 })
                .chain([0])
            {
                match receiver.push(byte) {
                    None => {}
                    Some(Received::Corrupt | Received::Overlong) => events += 1,
                    Some(Received::Frame(_)) => return Err("a frame with a flipped bit gave a message"),
                    Some(Received::Unreadable(_)) => {
                        return Err("a frame with a flipped bit passed its checksum");
                    }
                }
            }
            let Losses { corrupt, overlong, unreadable } = receiver.losses();
            check(events >= 1, "a flipped bit went unnoticed")?;
            check(corrupt + overlong + unreadable == events, "events and counters disagree")?;
        }
        Ok(())
    })
}

pub(super) fn every_bit_flip_of_every_command_is_rejected() -> Verdict {
    flips::<_, MAX_BODY_TO_DEVICE>(COMMANDS)
}

pub(super) fn every_bit_flip_of_every_envelope_is_rejected() -> Verdict {
    flips::<_, MAX_BODY_TO_HOST>(ENVELOPES)
}

fn chunks<T: Incoming + PartialEq, const N: usize>(golden: &[Golden<T>]) -> Verdict {
    golden.iter().try_for_each(|Golden { message, frame }| {
        let mut buffer = BUFFER;
        let frame = bytes(frame, &mut buffer)?;
        let message = message();
        for size in 1..=frame.len() {
            let mut receiver = Receiver::<T, N>::new();
            let mut arrived = 0;
            for chunk in frame.chunks(size) {
                for event in receiver.feed(chunk) {
                    match event {
                        Received::Frame(other) if other == message => arrived += 1,
                        _ => return Err("a frame in chunks gave something else"),
                    }
                }
            }
            check(arrived == 1, "a frame in chunks did not come out exactly once")?;
        }
        Ok(())
    })
}

pub(super) fn every_chunk_size_gives_the_same_command() -> Verdict {
    chunks::<_, MAX_BODY_TO_DEVICE>(COMMANDS)
}

pub(super) fn every_chunk_size_gives_the_same_envelope() -> Verdict {
    chunks::<_, MAX_BODY_TO_HOST>(ENVELOPES)
}

/// Feeds good, bad and good bytes: exactly the two good messages come out, and the bad bytes are counted as these losses.
fn sandwich<T: Incoming + PartialEq, const N: usize>(
    (good, message): (&[u8], &T),
    bad: &[u8],
    cost: Losses,
) -> Verdict {
    let mut receiver = Receiver::<T, N>::new();
    let mut arrived = 0;
    for part in [good, bad, good] {
        for event in receiver.feed(part) {
            match event {
                Received::Frame(other) if other == *message => arrived += 1,
                Received::Frame(_) => return Err("bad bytes gave a message"),
                _ => {}
            }
        }
    }
    check(arrived == 2, "a good frame beside bad bytes was lost")?;
    check(receiver.losses() == cost, "bad bytes were counted as something else")
}

/// Damages a golden frame of this length in its buffer and returns the new length.
type Spoil<'a> = &'a dyn Fn(&mut Buffer, usize) -> usize;

fn sandwiches_of<T: Incoming + PartialEq, const N: usize>(
    good: (&[u8], &T),
    golden: &[Golden<T>],
    spoil: Spoil<'_>,
    cost: Losses,
) -> Verdict {
    golden.iter().try_for_each(|Golden { frame, .. }| {
        let mut bad = BUFFER;
        let length = bytes(frame, &mut bad)?.len();
        let length = spoil(&mut bad, length);
        sandwich::<T, N>(good, bad.get(..length).ok_or("test buffer too short")?, cost)
    })
}

/// Receives a good frame, a damaged golden frame and a good frame, for every golden frame of both directions.
fn sandwiches(spoil: Spoil<'_>, cost: Losses) -> Verdict {
    let mut buffer = BUFFER;
    let message = command(Request::Stop);
    let good = encode_command(&message, &mut buffer).map_err(|_| "a command was not encoded")?;
    sandwiches_of::<_, MAX_BODY_TO_DEVICE>((good, &message), COMMANDS, spoil, cost)?;
    let message = envelope(Message::Ack { id: 9 });
    let good = encode_envelope(&message, &mut buffer).map_err(|_| "a message was not encoded")?;
    sandwiches_of::<_, MAX_BODY_TO_HOST>((good, &message), ENVELOPES, spoil, cost)
}

pub(super) fn good_flipped_good() -> Verdict {
    let flip_last = |frame: &mut Buffer, length: usize| {
        if let Some(byte) = frame.get_mut(length - 2) {
            *byte ^= if *byte == 0x40 { 0x20 } else { 0x40 };
        }
        length
    };
    sandwiches(&flip_last, CORRUPT)
}

pub(super) fn good_truncated_good() -> Verdict {
    // An opening delimiter alone is no loss; otherwise the next opening delimiter ends the remainder.
    sandwiches(&|_, _| 1, Losses::default())?;
    for kept in 2..16 {
        sandwiches(&|_, length| kept.min(length - 2), CORRUPT)?;
    }
    for missing in 2..16 {
        sandwiches(&|_, length| length.saturating_sub(missing).max(2), CORRUPT)?;
    }
    // A frame that lacks its closing delimiter is still complete, as the opening delimiter of the next frame ends it.
    let mut buffer = BUFFER;
    let message = command(Request::Stop);
    let length = encode_command(&message, &mut buffer).map_err(|_| "a command was not encoded")?.len();
    let open = buffer.get(..length - 1).ok_or("test buffer too short")?;
    let mut receiver = CommandReceiver::new();
    check(receiver.feed(open).next().is_none(), "a frame came out before it was closed")?;
    gives(&mut receiver, &[0], &message)
}

pub(super) fn good_noise_good() -> Verdict {
    for length in 1..=MAX_BODY_TO_DEVICE {
        let noise = |buffer: &mut Buffer, _: usize| {
            let mut state = 12_345_u32;
            for byte in buffer.iter_mut().take(length) {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                *byte = u8::try_from(state >> 24).unwrap_or_default().max(1);
            }
            length
        };
        sandwiches(&noise, CORRUPT)?;
    }
    Ok(())
}

pub(super) fn good_overlong_good() -> Verdict {
    let overlong = |buffer: &mut Buffer, _: usize| {
        buffer.fill(0x55);
        buffer.len()
    };
    sandwiches(&overlong, OVERLONG)
}

/// A receiver that started again when its buffer is full would take the tails of these bodies for frames.
fn valid_tails<T: Incoming, const N: usize>(golden: &[Golden<T>]) -> Verdict {
    golden.iter().try_for_each(|Golden { frame, .. }| {
        let mut valid = BUFFER;
        let body = bytes(frame, &mut valid)?.strip_prefix(&[0]).ok_or("a frame without a delimiter")?;
        for filler in 1..=N + 2 {
            let (mut crafted, mut length) = ([0x01; 600], filler);
            append(&mut crafted, &mut length, body)?;
            let crafted = crafted.get(..length).ok_or("test buffer too short")?;
            let mut receiver = Receiver::<T, N>::new();
            let frames = receiver.feed(crafted).filter(|event| matches!(event, Received::Frame(_))).count();
            check(frames == 0, "the tail of a bad frame gave a message")?;
            let overlong = length - 1 > N;
            check(
                receiver.losses() == if overlong { OVERLONG } else { CORRUPT },
                "a bad frame was miscounted",
            )?;
        }
        Ok(())
    })
}

pub(super) fn valid_tail_of_an_overlong_frame_is_dropped() -> Verdict {
    valid_tails::<_, MAX_BODY_TO_DEVICE>(COMMANDS)?;
    valid_tails::<_, MAX_BODY_TO_HOST>(ENVELOPES)
}

pub(super) fn overlong_is_reported_once_and_dropped_until_the_delimiter() -> Verdict {
    let mut receiver = CommandReceiver::new();
    for _ in 0..MAX_BODY_TO_DEVICE {
        check(receiver.push(7).is_none(), "reported before it was too long")?;
    }
    check(receiver.push(7) == Some(Received::Overlong), "not reported when it was too long")?;
    for _ in 0..1000 {
        check(receiver.push(7).is_none(), "reported twice")?;
    }
    check(receiver.push(0).is_none(), "reported at its delimiter")?;
    check(receiver.losses() == OVERLONG, "not counted once")
}

/// Writes the intact frame of any payload and returns its length.
fn sealed(payload: &[u8], output: &mut Buffer) -> Result<usize, &'static str> {
    let mut plain = [0; MAX_PLAIN];
    plain.get_mut(..payload.len()).ok_or("test payload too long")?.copy_from_slice(payload);
    seal(&mut plain, payload.len(), output).map(<[u8]>::len).map_err(|_| "a payload was not sealed")
}

fn payload<'a>(message: &impl serde::Serialize, buffer: &'a mut Buffer) -> Result<&'a [u8], &'static str> {
    postcard::to_slice(message, buffer).map(|bytes| &*bytes).map_err(|_| "a payload was not encoded")
}

/// Feeds an intact payload that must not decode, and returns the part of it that was readable.
fn unreadable<T: Incoming, const N: usize>(payload: &[u8]) -> Result<Option<T::Salvage>, &'static str> {
    let mut frame = BUFFER;
    let length = sealed(payload, &mut frame)?;
    let mut receiver = Receiver::<T, N>::new();
    let mut events = receiver.feed(frame.get(..length).ok_or("test buffer too short")?);
    let (first, second) = (events.next(), events.next());
    drop(events);
    check(second.is_none() && receiver.losses() == UNREADABLE, "not counted as unreadable, once")?;
    match first {
        Some(Received::Unreadable(salvage)) => Ok(salvage),
        _ => Err("an intact payload of other types was not reported as unreadable"),
    }
}

pub(super) fn trailing_bytes_are_refused() -> Verdict {
    let mut buffer = BUFFER;
    for extra in [&[0][..], &[0, 0], &[1, 2, 3]] {
        let mut longer = BUFFER;
        let mut length = 0;
        append(&mut longer, &mut length, payload(&command(Request::Stop), &mut buffer)?)?;
        append(&mut longer, &mut length, extra)?;
        let longer = longer.get(..length).ok_or("test buffer too short")?;
        let id = unreadable::<Command, MAX_BODY_TO_DEVICE>(longer)?;
        check(id == Some(300), "the id of a command with trailing bytes was not read")?;

        let (mut longer, mut length) = (BUFFER, 0);
        append(&mut longer, &mut length, payload(&envelope(Message::Ack { id: 9 }), &mut buffer)?)?;
        append(&mut longer, &mut length, extra)?;
        let longer = longer.get(..length).ok_or("test buffer too short")?;
        let version = unreadable::<Envelope, MAX_BODY_TO_HOST>(longer)?;
        check(version.is_none(), "a version was read from something other than a hello")?;
    }
    Ok(())
}

pub(super) fn short_bodies_are_corrupt() -> Verdict {
    for length in 1..=CRC_BYTES {
        let body = [1; CRC_BYTES];
        let mut receiver = EnvelopeReceiver::new();
        let stream = body.iter().take(length).chain(&[0]);
        let events =
            stream.filter_map(|&byte| receiver.push(byte)).filter(|event| *event == Received::Corrupt);
        check(events.count() == 1, "a body too short for its checksum was not corrupt")?;
    }
    Ok(())
}

pub(super) fn unreadable_command_gives_its_id() -> Verdict {
    let mut buffer = BUFFER;
    let unknown_request = payload(&(300_u16, 5_u32, 200_u32), &mut buffer)?;
    let id = unreadable::<Command, MAX_BODY_TO_DEVICE>(unknown_request)?;
    check(id == Some(300), "the id of an unknown request was not read")?;
    let id = unreadable::<Command, MAX_BODY_TO_DEVICE>(&[0xFF, 0xFF, 0xFF, 0xFF])?;
    check(id.is_none(), "an id was read from something other than a command")
}

pub(super) fn hello_of_another_version_gives_its_version() -> Verdict {
    let mut buffer = BUFFER;
    let hello = payload(&(1_u32, 2_u32, 0_u32, 2_u16, "fields of version two"), &mut buffer)?;
    let version = unreadable::<Envelope, MAX_BODY_TO_HOST>(hello)?;
    check(version == Some(2), "the version of another hello was not read")?;
    let other_version = payload(&(1_u32, 2_u32, 200_u32, 2_u16), &mut buffer)?;
    let version = unreadable::<Envelope, MAX_BODY_TO_HOST>(other_version)?;
    check(version.is_none(), "a version was read from something other than a hello")
}

pub(super) fn text_beyond_its_capacity_is_unreadable() -> Verdict {
    let mut buffer = BUFFER;
    let hello = payload(&(1_u32, 2_u32, 0_u32, 1_u16, [0_u8; 8], "seventeen letters"), &mut buffer)?;
    let version = unreadable::<Envelope, MAX_BODY_TO_HOST>(hello)?;
    check(version == Some(1), "the version of a hello with a long text was not read")
}

pub(super) fn output_of_any_length_is_filled_or_refused() -> Verdict {
    COMMANDS.iter().try_for_each(|Golden { message, frame }| {
        let mut buffer = BUFFER;
        let frame = bytes(frame, &mut buffer)?;
        for length in 0..=frame.len() + 1 {
            let mut output = BUFFER;
            let output = output.get_mut(..length).ok_or("test buffer too short")?;
            let encoded = encode_command(&message(), output);
            let expected = if length < frame.len() { None } else { Some(frame) };
            check(encoded.ok() == expected, "an output was neither filled nor refused")?;
        }
        Ok(())
    })
}

pub(super) fn text_is_cut_between_characters() -> Verdict {
    check(Text::<4>::new("µmµ").as_str() == "µm", "a character was split")?;
    check(Text::<5>::new("µmµ").as_str() == "µmµ", "a text that fits was cut")?;
    check(Text::<0>::new("x").is_empty(), "a text of no capacity is not empty")
}
