//! Frames of the device, as they go over the link: raw frames of the last half minute for every page, bounded.

use device::link::Tap;
use protocol::{Command, Envelope, MAX_FRAME_TO_HOST, Message, encode_envelope};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

/// Frames that are kept, bytes: half a minute at the rate of the device and more. A page that is further behind has lost frames, which it
/// counts by their numbers.
const MAX_BYTES: usize = 512 << 10;

/// The frames that are kept.
#[derive(Debug, Default)]
pub(crate) struct Frames {
    /// The greeting of the present connection; its number is that of the frame before the next one.
    hello: Option<Envelope>,
    /// It is not among the frames yet.
    is_new: bool,
    /// Number of the first frame and the frames, as they go over the link.
    first: u64,
    kept: VecDeque<(Envelope, Vec<u8>)>,
    bytes: usize,
}

impl Frames {
    fn take(&mut self, envelope: &Envelope) {
        if matches!(envelope.message, Message::Hello(_)) {
            (self.hello, self.is_new) = (Some(envelope.clone()), true);
            return;
        }
        if std::mem::take(&mut self.is_new)
            && let Some(hello) = self.hello_before(envelope)
        {
            self.keep(hello);
        }
        self.keep(envelope.clone());
    }

    /// The greeting with the number before that of a frame: what came between them was for the program alone.
    fn hello_before(&self, next: &Envelope) -> Option<Envelope> {
        let hello = self.hello.clone()?;
        Some(Envelope { boot_id: next.boot_id, sequence: next.sequence.wrapping_sub(1), ..hello })
    }

    fn keep(&mut self, envelope: Envelope) {
        let Some(frame) = encoded(&envelope) else { return };
        self.bytes += frame.len();
        self.kept.push_back((envelope, frame));
        while self.bytes > MAX_BYTES
            && let Some((_, oldest)) = self.kept.pop_front()
        {
            self.bytes -= oldest.len();
            self.first += 1;
        }
    }

    /// The frames from this number on, and the number after them; a page that has none yet receives the greeting before the oldest one.
    pub fn since(&self, from: Option<u64>) -> (Vec<u8>, u64) {
        let next = self.first + self.kept.len() as u64;
        let begin = from.unwrap_or(self.first).max(self.first);
        let mut bytes = Vec::new();
        if from.is_none()
            && let Some((first, _)) = self.kept.front()
            && !matches!(first.message, Message::Hello(_))
            && let Some(hello) = self.hello_before(first).as_ref().and_then(encoded)
        {
            bytes.extend(hello);
        }
        let skipped = usize::try_from(begin - self.first).unwrap_or(usize::MAX);
        self.kept.iter().skip(skipped).for_each(|(_, frame)| bytes.extend(frame));
        (bytes, next)
    }
}

fn encoded(envelope: &Envelope) -> Option<Vec<u8>> {
    let mut buffer = [0; MAX_FRAME_TO_HOST];
    encode_envelope(envelope, &mut buffer).ok().map(<[u8]>::to_vec)
}

/// A tap that keeps what the device sends.
pub(crate) struct FramesTap(pub Arc<Mutex<Frames>>);

impl Tap for FramesTap {
    fn received(&mut self, envelope: &Envelope) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take(envelope);
    }

    fn sent(&mut self, _: &Command) {}
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::{EnvelopeReceiver, Order, Received, SequenceTracker};

    fn hello(sequence: u32) -> Envelope {
        Envelope { boot_id: 7, sequence, message: Message::Hello(fake_device::hello()) }
    }

    fn ack(sequence: u32) -> Envelope {
        Envelope { boot_id: 7, sequence, message: Message::Ack { id: sequence as u16 } }
    }

    fn received(bytes: &[u8]) -> Vec<Envelope> {
        let mut receiver = EnvelopeReceiver::new();
        let envelopes = receiver.feed(bytes).map(|found| match found {
            Received::Frame(envelope) => envelope,
            other => panic!("{other:?}"),
        });
        envelopes.collect()
    }

    #[test]
    fn a_page_that_comes_late_receives_what_is_kept_and_then_what_is_new() {
        let mut frames = Frames::default();
        frames.take(&hello(3));
        (9..20).for_each(|sequence| frames.take(&ack(sequence)));
        let (bytes, next) = frames.since(None);
        let envelopes = received(&bytes);
        assert!(matches!(envelopes[0].message, Message::Hello(_)));
        let mut tracker = SequenceTracker::new();
        assert!(
            envelopes.iter().all(|envelope| tracker.observe(envelope).is_clean()),
            "nothing counts as lost"
        );
        assert_eq!(envelopes.len(), 12);
        frames.take(&ack(20));
        let (bytes, _) = frames.since(Some(next));
        assert_eq!(received(&bytes), [ack(20)]);
    }

    #[test]
    fn what_is_kept_is_bounded_and_a_page_that_is_behind_sees_the_gap() {
        let mut frames = Frames::default();
        frames.take(&ack(0));
        let (_, next) = frames.since(None);
        let many = 2 * MAX_BYTES as u32 / 8;
        (1..many).for_each(|sequence| frames.take(&ack(sequence)));
        assert!(frames.bytes <= MAX_BYTES);
        let (bytes, _) = frames.since(Some(next));
        let mut tracker = SequenceTracker::new();
        tracker.observe(&ack(0));
        let arrival = tracker.observe(&received(&bytes)[0]);
        assert_eq!(arrival.order, Order::Next);
        assert!(arrival.frames_missing > 0);
        assert_eq!(tracker.totals().frames_missing, u64::from(many) - 1 - received(&bytes).len() as u64);
    }
}
