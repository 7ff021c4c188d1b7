//! The conformance tests: one list, run on the host by `cargo test` and on the target by a firmware image.
//!
//! They need little stack (a few buffers of one frame) and neither std nor a heap, and report instead of panicking.

mod batches;
mod golden;
mod golden_commands;
mod golden_envelopes;
mod golden_messages;
mod link;
#[cfg(test)]
mod spec;
mod tracking;

use crate::{Command, Envelope, Incoming, Message, Received, Receiver, Request};

/// Result of a test; the error states what is wrong.
pub type Verdict = Result<(), &'static str>;

/// Lists the tests and, on the host, makes a `#[test]` of each.
macro_rules! tests {
    ($($module:ident::$name:ident),* $(,)?) => {
        /// Every test with its name.
        pub const TESTS: &[(&str, fn() -> Verdict)] =
            &[$((concat!(stringify!($module), "::", stringify!($name)), $module::$name)),*];

        #[cfg(test)]
        mod on_host {
            $(#[test]
            fn $name() -> super::Verdict {
                super::$module::$name()
            })*
        }
    };
}

tests![
    golden::commands_encode_to_their_golden_bytes,
    golden::commands_decode_from_their_golden_bytes,
    golden::envelopes_encode_to_their_golden_bytes,
    golden::envelopes_decode_from_their_golden_bytes,
    golden::every_variant_has_golden_bytes,
    golden::schema_hash_is_pinned,
    golden::program_checksum_is_pinned,
    golden::largest_messages_fill_the_frame_bound,
    link::every_bit_flip_of_every_command_is_rejected,
    link::every_bit_flip_of_every_envelope_is_rejected,
    link::every_chunk_size_gives_the_same_command,
    link::every_chunk_size_gives_the_same_envelope,
    link::good_flipped_good,
    link::good_truncated_good,
    link::good_noise_good,
    link::good_overlong_good,
    link::valid_tail_of_an_overlong_frame_is_dropped,
    link::overlong_is_reported_once_and_dropped_until_the_delimiter,
    link::trailing_bytes_are_refused,
    link::short_bodies_are_corrupt,
    link::unreadable_command_gives_its_id,
    link::hello_of_another_version_gives_its_version,
    link::text_beyond_its_capacity_is_unreadable,
    link::output_of_any_length_is_filled_or_refused,
    link::text_is_cut_between_characters,
    batches::packed_bytes_are_golden,
    batches::packed_differences_are_golden,
    batches::extreme_samples_survive,
    batches::batch_closes_when_full,
    batches::batch_closes_before_it_overflows,
    batches::batch_closes_when_the_sample_does_not_continue_it,
    batches::flush_gives_the_rest_once,
    batches::damaged_batches_are_refused_whole,
    batches::bytes_per_sample_are_as_documented,
    tracking::clean_stream_is_clean,
    tracking::missing_frames_are_counted,
    tracking::sequence_wraps,
    tracking::duplicates_and_late_frames_are_counted,
    tracking::restart_is_counted,
    tracking::dropped_samples_are_counted,
    tracking::gaps_in_time_are_counted,
    tracking::reversed_time_is_counted,
    tracking::nothing_is_missing_while_telemetry_is_off,
];

/// Runs every test, hands each verdict to `report` and returns how many passed and how many failed.
pub fn run(mut report: impl FnMut(&str, Verdict)) -> (u32, u32) {
    let (mut passed, mut failed) = (0, 0);
    for (name, test) in TESTS {
        let verdict = test();
        match verdict {
            Ok(()) => passed += 1,
            Err(_) => failed += 1,
        }
        report(name, verdict);
    }
    (passed, failed)
}

/// A message and the bytes of its frame, in hexadecimal.
struct Golden<T> {
    message: fn() -> T,
    frame: &'static str,
}

/// Longer than any frame either way.
type Buffer = [u8; 600];
const BUFFER: Buffer = [0; 600];

const BOOT_ID: u32 = 0xA1B2_C3D4;

const fn command(request: Request) -> Command {
    Command { id: 300, connection: BOOT_ID, request }
}

const fn envelope(message: Message) -> Envelope {
    Envelope { boot_id: BOOT_ID, sequence: 70_000, message }
}

fn check(holds: bool, otherwise: &'static str) -> Verdict {
    if holds { Ok(()) } else { Err(otherwise) }
}

/// The bytes that a hexadecimal text stands for.
fn bytes<'a>(hexadecimal: &str, buffer: &'a mut Buffer) -> Result<&'a [u8], &'static str> {
    let (pairs, []) = hexadecimal.as_bytes().as_chunks::<2>() else {
        return Err("golden bytes: an odd number of digits");
    };
    for (byte, &[high, low]) in buffer.iter_mut().zip(pairs) {
        let digit = |digit: u8| char::from(digit).to_digit(16).and_then(|digit| u8::try_from(digit).ok());
        let (Some(high), Some(low)) = (digit(high), digit(low)) else {
            return Err("golden bytes: not a hexadecimal digit");
        };
        *byte = high << 4 | low;
    }
    buffer.get(..pairs.len()).ok_or("golden bytes: longer than any frame")
}

/// Appends to the bytes in a buffer.
fn append(buffer: &mut Buffer, length: &mut usize, more: &[u8]) -> Verdict {
    let end = *length + more.len();
    buffer.get_mut(*length..end).ok_or("test buffer too short")?.copy_from_slice(more);
    *length = end;
    Ok(())
}

/// Feeds bytes and checks that exactly this message comes out, and nothing else.
fn gives<T: Incoming + PartialEq, const N: usize>(
    receiver: &mut Receiver<T, N>,
    stream: &[u8],
    message: &T,
) -> Verdict {
    let mut arrived = 0;
    for event in receiver.feed(stream) {
        match event {
            Received::Frame(other) if other == *message => arrived += 1,
            Received::Frame(_) => return Err("another message came out"),
            _ => return Err("an intact frame was not received"),
        }
    }
    check(arrived == 1, "the message did not come out exactly once")
}
