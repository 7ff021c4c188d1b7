//! Messages from the device, one for each entry of the golden bytes.

use super::envelope;
use crate::{
    CalibrationId, CalibrationRecord, CalibrationSource, Counters, Description, Envelope, Event, EventKind,
    Fault, Hello, Load, Message, Packed, PotentiometerTable, PulseOutcome, PulseReport, Refusal, ResetReason,
    Safety, Samples, Scales, State, Status, Stiffness, Tare, Text,
};

pub(super) fn hello(reset_reason: ResetReason, last_panic: Option<&str>) -> Envelope {
    envelope(Message::Hello(Hello {
        protocol_version: 2,
        schema_hash: [0x10, 0x32, 0x54, 0x76, 0x98, 0xBA, 0xDC, 0xFE],
        firmware_version: Text::new("0.1.0"),
        commit: Text::new("0123456789ab-dirty"),
        board: Text::new("B-L475E-IOT01A"),
        reset_reason,
        tick_hz: 1_000_000,
        now_us: 2_500_000,
        sample_period_us: 2_000,
        scales: Scales {
            position_nm_per_count: 100,
            force_nn_per_count: 1_000,
            travel_um: 5_000,
            force_range_mn: 5_000,
        },
        calibration: CalibrationId { id: Text::new("unit-7"), crc: 0xCBF4_3926 },
        last_panic: last_panic.map(Text::new),
    }))
}

pub(super) fn calibration() -> Envelope {
    let table = PotentiometerTable {
        track_codes: [40, 4_055],
        rising_um: [-25_000, -18_750, -12_500, -6_250, 0, 6_250, 12_500, 18_750, 25_000],
        falling_um: [-24_980, -18_730, -12_480, -6_230, 20, 6_270, 12_520, 18_770, 25_020],
    };
    envelope(Message::Calibration(CalibrationRecord {
        id: Text::new("unit-7"),
        potentiometers: [table; 2],
        travel_um: 10_000,
        force_pn_per_code: [[931_323, -1_200], [800, 929_000]],
        force_range_mn: 5_000,
    }))
}

pub(super) fn refused(refusal: Refusal) -> Envelope {
    envelope(Message::Refused { id: 300, refusal })
}

pub(super) fn pulse(outcome: PulseOutcome) -> PulseReport {
    PulseReport {
        axis: 1,
        outcome,
        driven_ms: 31,
        moved_counts: [-2, 171],
        most_moved_counts: [-38, 190],
        force_counts: [400, 51_000],
        most_force_counts: [-9_000, 70_000],
    }
}

pub(super) fn happened(kind: EventKind) -> Envelope {
    envelope(Message::Event(Event { t_us: 4_294_967_296, kind }))
}

/// The batch that `batches::packed_bytes_are_golden` packs.
pub(super) fn samples(state: State) -> Samples {
    let packed = [
        // One bit over 499, one bit over -500, seven bits over 0, seven bits over 99,936; then three times sixteen bits.
        0x01, 0xE6, 0x07, 0x01, 0xE7, 0x07, 0x07, 0x00, 0x07, 0xC0, 0x99, 0x0C, 0x01, 0x80, 0x02, 0x01, 0x02,
        0x01,
    ];
    Samples {
        t_us: 10_000_000,
        dropped: 200,
        state,
        step: 2,
        count: 3,
        packed: Packed::from_slice(&packed).unwrap_or_default(),
        repeats_force: 0,
    }
}

pub(super) fn tare() -> Tare {
    Tare {
        zero_counts: [-70_000, 35],
        sd_counts: [100, 0],
        drift_counts_per_s: [3, -2],
        periods: 1_000,
        readings: 999,
        unique_codes: [24, 1],
    }
}

pub(super) fn safety(calibration: CalibrationSource) -> Envelope {
    envelope(Message::Safety(Safety {
        t_us: 10_000_000,
        calibration,
        tared: true,
        zero_counts: [-70_000, 35],
        cools_in_s: [0, 294],
        proven: [true, false],
    }))
}

pub(super) fn description() -> Envelope {
    envelope(Message::Description(Description {
        protocol_version: 4,
        schema_hash: [0x10, 0x32, 0x54, 0x76, 0x98, 0xBA, 0xDC, 0xFE],
        max_steps: 64,
        speed_limit_um_s: 10_000,
        duration_limit_ms: 3_600_000,
        tare_limit_ms: 60_000,
        start_limit_us: 3_600_000_000,
        retreat_limit_um: 1_000,
        silence_limit_ms: [200, 60_000],
        answers_remembered: 8,
        connections: 4,
    }))
}

pub(super) fn batch(state: State) -> Envelope {
    envelope(Message::Samples(samples(state)))
}

pub(super) fn status(fault: Option<Fault>) -> Envelope {
    envelope(Message::Status(Status {
        t_us: 10_000_000,
        state: State::Idle,
        step: 255,
        fault,
        position_counts: [-15_000, 10_000],
        force_counts: [100_000, -250],
        streaming: true,
        counters: Counters {
            samples_dropped: 1,
            messages_dropped: 2,
            frames_corrupt: 3,
            frames_overlong: 4,
            frames_unreadable: 5,
            force_readings_bad: 6,
            control_overruns: 300,
            line_errors: 7,
            force_corrupt: 8,
            force_missing: 9,
            force_resets: 10,
            force_saturated: 11,
            faults: 12,
        },
        load: Load {
            cpu_permille: 321,
            longest_period_us: 187,
            latest_start_us: 3,
            stack_free_bytes: 70_000,
            outbox_most: 5,
        },
        motor_budget_permille: [1_000, 12],
        force_limit_mn: 4_000,
        silence_limit_ms: 2_000,
        stiffness: [None, Some(Stiffness { slope_mn_per_m: 1_234_567, sd_mn_per_m: 890, readings: 400 })],
        repeats_force: false,
    }))
}
