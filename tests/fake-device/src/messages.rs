//! The messages of a device at rest.

use super::PERIOD_US;
use protocol::{
    CalibrationId, CalibrationRecord, Counters, Hello, Load, PotentiometerTable, ResetReason, Scales, State,
    Status, Text,
};

/// The greeting of a device of this version that has just been switched on.
pub fn hello() -> Hello {
    Hello {
        protocol_version: protocol::VERSION,
        schema_hash: protocol::schema_hash(),
        firmware_version: Text::new("0.0.0"),
        commit: Text::new("fake"),
        board: Text::new("fake"),
        reset_reason: ResetReason::PowerOn,
        tick_hz: 1_000_000,
        now_us: 0,
        sample_period_us: PERIOD_US,
        scales: Scales {
            position_nm_per_count: 1_000,
            force_nn_per_count: 50_000,
            travel_um: 10_000,
            force_range_mn: 5_000,
        },
        calibration: CalibrationId { id: Text::new("simulated"), crc: 1 },
        last_panic: None,
    }
}

/// The calibration that a fake starts with.
pub fn calibration() -> CalibrationRecord {
    let table = [-10_240, -7_680, -5_120, -2_560, 0, 2_560, 5_120, 7_680, 10_240];
    let potentiometer = PotentiometerTable {
        track_codes: [40, 4_055],
        rising_um: table,
        falling_um: table.map(|um| um - 20),
    };
    CalibrationRecord {
        id: Text::new("fake-1"),
        potentiometers: [potentiometer; 2],
        travel_um: 10_000,
        force_pn_per_code: [[931_000, 12_000], [-8_000, 925_000]],
        force_range_mn: 5_000,
    }
}

/// A device at rest, at the start of its clock.
pub fn status() -> Status {
    Status {
        t_us: 0,
        state: State::Idle,
        step: u8::MAX,
        fault: None,
        position_counts: [1, 2],
        force_counts: [3, 4],
        streaming: true,
        counters: Counters::default(),
        load: Load::default(),
        motor_budget_permille: [0; 2],
        force_limit_mn: 4_000,
        silence_limit_ms: 2_000,
        stiffness: [None; 2],
        repeats_force: false,
    }
}
