//! Commands: what the host asks of the device.
//!
//! Every [`Command`] is answered by exactly one `Ack` or `Refused` with the same id (and, where the table says so, by a further
//! message before it). A command that arrives twice (the host repeats it when no answer came) is executed once and
//! answered twice. The order of the variants is the wire format: append, never insert.
//!
//! | request | answer | effect |
//! |---|---|---|
//! | `Hello` | `Hello`, `Ack` | none; the only request (with `Stop`) that any boot id may send |
//! | `Status` | `Status`, `Ack` | none |
//! | `Stream` | `Ack` | telemetry batches on or off |
//! | `LoadStep` | `Ack` | stores one step of the motion program |
//! | `Run` | `Ack`, then events | starts the loaded program at a device time |
//! | `Stop` | `Ack` | ends any motion at once, bridges off; telemetry goes on |
//! | `ClearFault` | `Ack` | leaves the fault state if its cause is gone |
//! | `Limits` | `Ack` | force limit and longest silence of the host, until the next start of the device |
//! | `LoadCalibration` | `Ack` | takes one piece of a calibration |
//! | `StoreCalibration` | `Ack` | keeps the calibration and restarts with it |
//! | `Calibration` | `Calibration`, `Ack` | none |

use crate::PIECE_BYTES;
use postcard::experimental::max_size::MaxSize;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Most steps a motion program can have.
pub const MAX_STEPS: usize = 64;

/// One request with its identity.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct Command {
    /// Chosen by the host, increasing by one per new command; the answer carries it.
    pub id: u16,
    /// The boot the host believes it talks to. A device that has restarted since refuses, so that no command meant for the
    /// state before the restart is carried out after it. Ignored for [`Request::Hello`] and [`Request::Stop`].
    pub boot_id: u32,
    /// What to do.
    pub request: Request,
}

/// What the host can ask for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum Request {
    /// Who are you? Never assumed to have been said at boot.
    Hello,
    /// State, fault and counters, now.
    Status,
    /// Switch telemetry batches on or off.
    Stream {
        /// True: send every sample from now on.
        enable: bool,
    },
    /// Store step `index` of the motion program; refused while a program is pending or running.
    LoadStep {
        /// Position in the program, from 0, below [`MAX_STEPS`].
        index: u8,
        /// The step.
        step: Step,
    },
    /// Run the first `steps` loaded steps.
    Run {
        /// Number of steps, at least 1.
        steps: u8,
        /// [`crate::program_crc`] of these steps: the device runs what the host meant or nothing.
        crc: u32,
        /// Device time at which to start, microseconds; 0 means now. A time in the past is refused.
        start_us: u64,
    },
    /// End any motion at once and switch the bridges off (the lead screws hold). Not a safety device: a frame can be lost;
    /// the emergency-stop input is the safety device.
    Stop,
    /// Leave the latched fault state.
    ClearFault,
    /// Set what the interlocks compare with. Refused while a program is pending or running, and for values out of range.
    Limits {
        /// Largest force along either axis relative to the tare, millinewtons: 1 to the sensor's rated range.
        force_mn: u32,
        /// Longest time without an intact command while a program is pending or running, milliseconds: see
        /// [`SILENCE_LIMIT_MS`].
        silence_ms: u32,
    },
    /// Take one piece of an encoded calibration record.
    LoadCalibration {
        /// Number of the piece, from 0; the record's byte is this times [`PIECE_BYTES`].
        piece: u8,
        /// The bytes; those beyond the record's end do not matter.
        bytes: [u8; PIECE_BYTES],
    },
    /// Keep the loaded calibration and restart with it. Refused while a program is pending or running.
    StoreCalibration {
        /// Bytes of the record.
        length: u8,
        /// [`crate::calibration_crc`] of them: the device keeps what the host meant or nothing.
        crc: u32,
    },
    /// Which calibration do you work with?
    Calibration,
}

/// Least and greatest time that the host may be silent while a program runs, milliseconds.
pub const SILENCE_LIMIT_MS: [u32; 2] = [200, 60_000];

/// One step of a motion program.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum Step {
    /// Move guide 2 to a position relative to its straight-needle position, both axes arriving together; ends when both
    /// axes have settled.
    Move {
        /// Target along x, micrometres.
        x_um: i32,
        /// Target along y, micrometres.
        y_um: i32,
        /// Speed along the path, micrometres per second, above 0.
        speed_um_s: u32,
    },
    /// Stay for a time.
    Hold {
        /// Duration, milliseconds.
        duration_ms: u32,
    },
    /// Average the force for a time and make that the zero of both force channels.
    Tare {
        /// Duration, milliseconds, above 0.
        duration_ms: u32,
    },
    /// Move guide 2 at an even speed so that the setpoint arrives after this time; ends then, without waiting for the axes to
    /// settle.
    Ramp {
        /// Target along x, micrometres.
        x_um: i32,
        /// Target along y, micrometres.
        y_um: i32,
        /// Duration, milliseconds, above 0.
        duration_ms: u32,
    },
}
