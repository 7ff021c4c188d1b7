//! Counts losses between device and host from the frames that arrived.

use crate::{Envelope, Message, Samples};

/// Follows the envelopes of one device in the order of their arrival and reports what is missing between them.
///
/// It takes the sample period from every `Hello`; before the first one (and after a restart, before the next one) it judges no gap
/// in time. Losses between the last envelope before a restart and the restart cannot be determined and are not counted.
#[derive(Debug, Clone, Default)]
pub struct SequenceTracker {
    device: Option<Device>,
    totals: Totals,
}

#[derive(Debug, Clone)]
struct Device {
    boot_id: u32,
    sequence: u32,
    period_us: Option<u32>,
    dropped: Option<u32>,
    next_us: Option<u64>,
}

/// Position of an envelope in the order of the device's frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// The first ever received: what came before it is unknown.
    First,
    /// Later than the one before it, by one or, if frames are missing, more.
    Next,
    /// The first received after a restart of the device: loaded steps, tare and streaming are gone, and a new hello is due.
    Restarted,
    /// The same number as the one before it. Do not use it again.
    Duplicate,
    /// An older number: the frame was reordered or repeated. A reordered one was already counted as missing. Do not use it.
    Late,
}

/// Losses that one envelope reveals.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Arrival {
    /// Its place in the order.
    pub order: Order,
    /// Number of frames that were sent since the envelope before (after a restart: since the restart) and did not arrive.
    pub frames_missing: u32,
    /// Number of samples that the device reports as dropped since the batch before.
    pub samples_dropped: u32,
    /// Samples that are missing in time between the batch before and this one, for any reason: lost with a frame,
    /// dropped by the device, or not taken.
    pub samples_missing: u64,
    /// This batch begins before the end of the batch before: the device's clock or its packing is wrong.
    pub time_reversed: bool,
}

impl Arrival {
    /// Whether the envelope is to be used and reveals no loss.
    pub fn is_clean(&self) -> bool {
        *self == Self::plain(self.order) && matches!(self.order, Order::First | Order::Next)
    }

    const fn plain(order: Order) -> Self {
        Self { order, frames_missing: 0, samples_dropped: 0, samples_missing: 0, time_reversed: false }
    }
}

/// Everything counted so far; no counter wraps.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Totals {
    /// Envelopes that arrived, duplicates and late ones not counted.
    pub frames: u64,
    /// Frames that did not arrive.
    pub frames_missing: u64,
    /// Samples that arrived.
    pub samples: u64,
    /// Samples missing in time, for any reason.
    pub samples_missing: u64,
    /// Samples that the device reports as dropped. They are among those missing in time.
    pub samples_dropped: u64,
    /// Restarts of the device.
    pub restarts: u64,
    /// Envelopes that came twice in a row.
    pub duplicates: u64,
    /// Envelopes that came after a later one.
    pub late: u64,
    /// Batches that began before the end of the batch before.
    pub time_reversals: u64,
}

impl SequenceTracker {
    /// Tracker before any envelope.
    pub fn new() -> Self {
        Self::default()
    }

    /// Everything counted so far.
    pub const fn totals(&self) -> Totals {
        self.totals
    }

    /// Call this when telemetry is switched on: the time in which it was off is no loss.
    pub fn stream_begins(&mut self) {
        if let Some(device) = &mut self.device {
            device.next_us = None;
        }
    }

    /// Takes the next envelope.
    pub fn observe(&mut self, envelope: &Envelope) -> Arrival {
        let mut arrival = self.place(envelope);
        if !matches!(arrival.order, Order::Duplicate | Order::Late)
            && let Some(device) = &mut self.device
        {
            device.sequence = envelope.sequence;
            match &envelope.message {
                Message::Hello(hello) => device.period_us = Some(hello.sample_period_us),
                Message::Samples(samples) => device.batch(samples, &mut arrival),
                _ => {}
            }
        }
        self.totals.add(envelope, &arrival);
        arrival
    }

    /// Compares boot and sequence; another boot begins a new sequence.
    fn place(&mut self, Envelope { boot_id, sequence, .. }: &Envelope) -> Arrival {
        let fresh = |dropped| {
            Some(Device { boot_id: *boot_id, sequence: *sequence, period_us: None, dropped, next_us: None })
        };
        match &self.device {
            None => {
                self.device = fresh(None);
                Arrival::plain(Order::First)
            }
            Some(device) if device.boot_id != *boot_id => {
                self.device = fresh(Some(0));
                Arrival { frames_missing: *sequence, ..Arrival::plain(Order::Restarted) }
            }
            Some(device) => match sequence.wrapping_sub(device.sequence) {
                0 => Arrival::plain(Order::Duplicate),
                ahead if ahead <= u32::MAX / 2 => {
                    Arrival { frames_missing: ahead - 1, ..Arrival::plain(Order::Next) }
                }
                _ => Arrival::plain(Order::Late),
            },
        }
    }
}

impl Device {
    fn batch(&mut self, samples: &Samples, arrival: &mut Arrival) {
        if let Some(previous_dropped) = self.dropped.replace(samples.dropped) {
            arrival.samples_dropped = samples.dropped.saturating_sub(previous_dropped);
        }
        let Some(period_us) = self.period_us.map(u64::from).filter(|&period_us| period_us > 0) else {
            return;
        };
        if let Some(expected_us) = self.next_us {
            // Rounded to whole samples: batches may be timed to the microsecond, but a gap is a number of samples.
            let late_us = samples.t_us.saturating_sub(expected_us);
            arrival.samples_missing = late_us.saturating_add(period_us / 2) / period_us;
            arrival.time_reversed = samples.t_us < expected_us;
        }
        let length_us = period_us.saturating_mul(u64::from(samples.count));
        self.next_us = Some(samples.t_us.saturating_add(length_us));
    }
}

impl Totals {
    fn add(&mut self, envelope: &Envelope, arrival: &Arrival) {
        let count = |counter: &mut u64, by: u64| *counter = counter.saturating_add(by);
        match arrival.order {
            Order::Duplicate => return count(&mut self.duplicates, 1),
            Order::Late => return count(&mut self.late, 1),
            Order::Restarted => count(&mut self.restarts, 1),
            Order::First | Order::Next => {}
        }
        count(&mut self.frames, 1);
        count(&mut self.frames_missing, u64::from(arrival.frames_missing));
        count(&mut self.samples_dropped, u64::from(arrival.samples_dropped));
        count(&mut self.samples_missing, arrival.samples_missing);
        count(&mut self.time_reversals, u64::from(arrival.time_reversed));
        if let Message::Samples(samples) = &envelope.message {
            count(&mut self.samples, u64::from(samples.count));
        }
    }
}
