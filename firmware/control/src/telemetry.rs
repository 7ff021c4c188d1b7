//! The controller's output to the link: samples in batches, messages between them, in order.
//!
//! The outbox is bounded, and the controller never waits for it. If only the places that are reserved for answers and events are
//! free, a complete batch is dropped and its samples are counted, so that the host finds one gap of known length.

use super::{OutboundMessage, Outputs, PERIOD_US};
use protocol::{Packer, Samples};

/// One frame's content.
#[derive(Debug, Clone, PartialEq)]
pub enum Item {
    /// A batch of samples.
    Batch(Samples),
    /// An answer, an event or the state.
    OutboundMessage(OutboundMessage),
}

/// The queue towards the link.
pub trait Outbox {
    /// Free places.
    fn room(&self) -> usize;
    /// Appends an item; false where the queue is full.
    fn put(&mut self, item: Item) -> bool;
}

/// Number of places that batches may not take.
pub const RESERVED_FOR_MESSAGES: usize = 8;

/// Packs the controller's samples and puts batches and messages into the outbox.
#[derive(Debug)]
pub struct Telemetry {
    packer: Packer,
    streaming: bool,
    samples_dropped: u32,
    messages_dropped: u32,
}

impl Telemetry {
    /// Telemetry off.
    #[expect(clippy::new_without_default, reason = "`Telemetry::new()` is clearer at its only use")]
    pub const fn new() -> Self {
        Self { packer: Packer::new(PERIOD_US), streaming: false, samples_dropped: 0, messages_dropped: 0 }
    }

    /// Samples dropped since start.
    pub fn samples_dropped(&self) -> u32 {
        self.samples_dropped
    }

    /// Answers and events dropped since start.
    pub fn messages_dropped(&self) -> u32 {
        self.messages_dropped
    }

    /// Queues the output of one period; `t_us` is its device time.
    pub fn send(&mut self, t_us: u64, outputs: &Outputs, outbox: &mut impl Outbox) {
        for note in &outputs.notes {
            // The samples before an answer or an event are sent before it; for the periodic state the batch is not cut short.
            let report = matches!(note, OutboundMessage::Report(_) | OutboundMessage::SafetyReport(_));
            if !report && let Some(batch) = self.packer.flush() {
                self.batch(batch, outbox);
            }
            // A periodic state is dropped where there is little room: the next one supersedes it.
            let is_superseded = report && outbox.room() <= RESERVED_FOR_MESSAGES;
            if let OutboundMessage::Stream(enable) = note {
                self.streaming = *enable;
            } else if is_superseded {
                continue;
            } else if !outbox.put(Item::OutboundMessage(*note)) {
                self.messages_dropped = self.messages_dropped.saturating_add(1);
            }
        }
        if self.streaming {
            // The number of dropped samples is set when the batch is queued; here it is the same for all samples.
            let batch = self.packer.push(t_us, outputs.state, outputs.step, 0, outputs.sample);
            if let Some(batch) = batch {
                self.batch(batch, outbox);
            }
        }
    }

    fn batch(&mut self, mut batch: Samples, outbox: &mut impl Outbox) {
        batch.dropped = self.samples_dropped;
        let count = u32::from(batch.count);
        if outbox.room() <= RESERVED_FOR_MESSAGES || !outbox.put(Item::Batch(batch)) {
            self.samples_dropped = self.samples_dropped.saturating_add(count);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Drive, NO_STEP, OutboundMessages};
    use super::*;
    use proptest::prelude::*;
    use protocol::{Sample, State};
    use std::collections::VecDeque;
    use std::vec::Vec;

    struct Queue {
        items: VecDeque<Item>,
        places: usize,
    }

    impl Outbox for Queue {
        fn room(&self) -> usize {
            self.places - self.items.len()
        }

        fn put(&mut self, item: Item) -> bool {
            let fits = self.room() > 0;
            if fits {
                self.items.push_back(item);
            }
            fits
        }
    }

    fn outputs(t_ms: u64, notes: &[OutboundMessage]) -> Outputs {
        let mut messages = OutboundMessages::new();
        for note in notes {
            messages.push(*note).expect("few notes");
        }
        Outputs {
            drive: Drive::Release,
            led: false,
            state: State::Idle,
            step: NO_STEP,
            sample: Sample { position_counts: [t_ms as i32, 0], ..Sample::default() },
            notes: messages,
            keep: false,
            store: None,
        }
    }

    proptest! {
        /// However much the link takes and when: every sample arrives once and in order, or lies in a gap whose length the next
        /// batch reports.
        #[test]
        fn every_sample_arrives_or_is_counted_before_the_next_batch(
            takes in prop::collection::vec((0_usize..3, any::<bool>(), prop::option::of(0_u16..4)), 50..600),
        ) {
            let mut telemetry = Telemetry::new();
            let mut queue = Queue { items: VecDeque::new(), places: 12 };
            let mut arrived = Vec::new();
            telemetry.send(0, &outputs(0, &[OutboundMessage::Stream(true)]), &mut queue);
            for (t_ms, (take, rarely, note)) in (1_u64..).zip(takes) {
                let notes: Vec<_> = note.filter(|_| rarely && t_ms % 7 == 0).map(OutboundMessage::Ack).into_iter().collect();
                telemetry.send(t_ms * 1_000, &outputs(t_ms, &notes), &mut queue);
                if t_ms % 20 == 0 {
                    arrived.extend((0..take).filter_map(|_| queue.items.pop_front()));
                }
            }
            // The outbox drains, and the next message flushes the rest of the packer.
            arrived.extend(queue.items.drain(..));
            telemetry.send(1_000_000_000, &outputs(1_000_000, &[OutboundMessage::Stream(false)]), &mut queue);
            arrived.extend(queue.items.drain(..));
            let (mut next_us, mut dropped) = (0, 0);
            for item in arrived {
                let Item::Batch(batch) = item else { continue };
                let gap = batch.t_us - next_us;
                prop_assert_eq!(gap, u64::from(batch.dropped - dropped) * 1_000);
                for (t_us, sample) in batch.unpack(PERIOD_US).expect("a whole batch") {
                    prop_assert_eq!(sample.position_counts[0], (t_us / 1_000) as i32);
                    next_us = t_us + 1_000;
                }
                dropped = batch.dropped;
            }
            // A batch dropped at the very end is in the counter.
            prop_assert!(telemetry.samples_dropped() >= dropped);
        }
    }

    #[test]
    fn messages_have_places_that_batches_cannot_take() {
        let mut telemetry = Telemetry::new();
        let mut queue = Queue { items: VecDeque::new(), places: RESERVED_FOR_MESSAGES + 2 };
        telemetry.send(0, &outputs(0, &[OutboundMessage::Stream(true)]), &mut queue);
        for t_ms in 1..1_000 {
            telemetry.send(t_ms * 1_000, &outputs(t_ms, &[]), &mut queue);
        }
        assert_eq!(queue.items.len(), 2);
        assert!(telemetry.samples_dropped() > 800);
        for id in 0..RESERVED_FOR_MESSAGES as u16 {
            telemetry.send(1_000_000, &outputs(1_000, &[OutboundMessage::Ack(id)]), &mut queue);
        }
        assert_eq!((queue.room(), telemetry.messages_dropped()), (0, 0));
        telemetry.send(1_001_000, &outputs(1_001, &[OutboundMessage::Ack(99)]), &mut queue);
        assert_eq!(telemetry.messages_dropped(), 1);
    }
}
