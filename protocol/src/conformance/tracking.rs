//! Tests of the losses that the tracker reports.

use super::{Verdict, check};
use crate::{
    Arrival, CalibrationId, Envelope, Hello, Message, Order, Packed, ResetReason, Samples, Scales,
    SequenceTracker, State, Text, Totals,
};

const PERIOD_US: u32 = 2_000;
const BATCH: u8 = 10;

fn ack(boot_id: u32, sequence: u32) -> Envelope {
    Envelope { boot_id, sequence, message: Message::Ack { id: 1 } }
}

fn hello(boot_id: u32, sequence: u32) -> Envelope {
    let scales = Scales { position_nm_per_count: 1, force_nn_per_count: 1, travel_um: 1, force_range_mn: 1 };
    let hello = Hello {
        protocol_version: crate::VERSION,
        schema_hash: crate::schema_hash(),
        firmware_version: Text::default(),
        commit: Text::default(),
        board: Text::default(),
        reset_reason: ResetReason::PowerOn,
        tick_hz: 1_000_000,
        now_us: 0,
        sample_period_us: PERIOD_US,
        scales,
        calibration: CalibrationId::default(),
        last_panic: None,
    };
    Envelope { boot_id, sequence, message: Message::Hello(hello) }
}

/// A batch of ten samples, of which the first is sample number `first` since start.
fn batch(boot_id: u32, sequence: u32, first: u64, dropped: u32) -> Envelope {
    let t_us = first * u64::from(PERIOD_US);
    let samples = Samples {
        t_us,
        dropped,
        state: State::Idle,
        step: 255,
        count: BATCH,
        packed: Packed::default(),
        repeats_force: 0,
    };
    Envelope { boot_id, sequence, message: Message::Samples(samples) }
}

const fn in_order(order: Order) -> Arrival {
    Arrival { order, frames_missing: 0, samples_dropped: 0, samples_missing: 0, time_reversed: false }
}

const NEXT: Arrival = in_order(Order::Next);

/// A tracker that has received a hello and one batch, samples 0 to 9, of boot 1, sequence 0 and 1.
fn begun() -> SequenceTracker {
    let mut tracker = SequenceTracker::new();
    tracker.observe(&hello(1, 0));
    tracker.observe(&batch(1, 1, 0, 0));
    tracker
}

pub(super) fn clean_stream_is_clean() -> Verdict {
    let mut tracker = SequenceTracker::new();
    check(tracker.observe(&hello(1, 500)) == in_order(Order::First), "the first frame was not the first")?;
    for index in 1..100 {
        let arrival = tracker.observe(&batch(1, 500 + index, u64::from(index) * 10, 7));
        check(arrival == NEXT && arrival.is_clean(), "a clean stream was not clean")?;
    }
    check(tracker.totals() == Totals { frames: 100, samples: 990, ..Totals::default() }, "totals are wrong")
}

pub(super) fn missing_frames_are_counted() -> Verdict {
    let mut tracker = begun();
    let arrival = tracker.observe(&batch(1, 5, 40, 0));
    let lost = Arrival { frames_missing: 3, samples_missing: 30, ..NEXT };
    check(arrival == lost && !arrival.is_clean(), "three lost frames were not reported")?;
    check(tracker.observe(&ack(1, 6)) == NEXT, "the loss was reported twice")?;
    let totals = tracker.totals();
    check(totals.frames_missing == 3 && totals.samples_missing == 30, "totals are wrong")
}

pub(super) fn sequence_wraps() -> Verdict {
    let mut tracker = SequenceTracker::new();
    tracker.observe(&ack(1, u32::MAX));
    check(tracker.observe(&ack(1, 0)) == NEXT, "a wrap was a loss")?;
    tracker.observe(&ack(1, u32::MAX / 2));
    tracker.observe(&ack(1, u32::MAX - 1));
    let arrival = tracker.observe(&ack(1, 2));
    check(arrival == Arrival { frames_missing: 3, ..NEXT }, "a loss across the wrap was miscounted")
}

pub(super) fn duplicates_and_late_frames_are_counted() -> Verdict {
    let mut tracker = begun();
    let totals_before = tracker.totals();
    check(tracker.observe(&batch(1, 1, 0, 0)) == in_order(Order::Duplicate), "a duplicate was not one")?;
    check(tracker.observe(&hello(1, 0)) == in_order(Order::Late), "a late frame was not late")?;
    check(tracker.totals() == Totals { duplicates: 1, late: 1, ..totals_before }, "totals are wrong")?;
    check(tracker.observe(&batch(1, 2, 10, 0)) == NEXT, "a late frame disturbed the order")
}

pub(super) fn restart_is_counted() -> Verdict {
    let mut tracker = begun();
    let arrival = tracker.observe(&batch(2, 3, 1_000, 0));
    check(
        arrival == Arrival { frames_missing: 3, ..in_order(Order::Restarted) },
        "a restart was not reported",
    )?;
    check(!arrival.is_clean(), "a restart was clean")?;
    // No hello of this boot yet: no period, and so no gap.
    check(tracker.observe(&batch(2, 4, 2_000, 0)) == NEXT, "a gap was judged without a period")?;
    tracker.observe(&hello(2, 5));
    tracker.observe(&batch(2, 6, 2_010, 0));
    let arrival = tracker.observe(&batch(2, 7, 2_021, 0));
    check(arrival == Arrival { samples_missing: 1, ..NEXT }, "a gap after a restart was not reported")?;
    check(tracker.totals().restarts == 1, "totals are wrong")
}

pub(super) fn dropped_samples_are_counted() -> Verdict {
    let mut tracker = begun();
    let arrival = tracker.observe(&batch(1, 2, 25, 15));
    let dropped = Arrival { samples_dropped: 15, samples_missing: 15, ..NEXT };
    check(arrival == dropped, "dropped samples were not reported")?;
    check(tracker.observe(&batch(1, 3, 35, 15)) == NEXT, "dropped samples were reported twice")?;
    tracker.observe(&batch(2, 0, 0, 4));
    check(tracker.totals().samples_dropped == 19, "samples dropped since a restart were not counted")
}

pub(super) fn gaps_in_time_are_counted() -> Verdict {
    let mut tracker = begun();
    check(
        tracker.observe(&batch(1, 2, 12, 0)) == Arrival { samples_missing: 2, ..NEXT },
        "a gap went unnoticed",
    )?;
    check(tracker.totals().samples_missing == 2, "totals are wrong")
}

pub(super) fn reversed_time_is_counted() -> Verdict {
    let mut tracker = begun();
    check(
        tracker.observe(&batch(1, 2, 9, 0)) == Arrival { time_reversed: true, ..NEXT },
        "reversed time unnoticed",
    )?;
    check(tracker.totals().time_reversals == 1, "totals are wrong")
}

pub(super) fn nothing_is_missing_while_telemetry_is_off() -> Verdict {
    let mut tracker = begun();
    tracker.stream_begins();
    check(tracker.observe(&batch(1, 2, 5_000, 0)) == NEXT, "the time without telemetry was a loss")?;
    check(tracker.observe(&batch(1, 3, 5_010, 0)) == NEXT, "a clean stream was not clean")
}
