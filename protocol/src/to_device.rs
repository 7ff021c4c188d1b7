//! Commands of the host to the device.
//!
//! Every [`Command`] is answered by exactly one `Ack` or `Refused` with the same id (and, where the table lists one, by a further
//! message before it). A command that arrives twice (the host repeats it when no answer came) is executed once and
//! answered twice; `Stop` and `Hello` are carried out each time. The order of the variants is the wire format: append, never insert.
//!
//! | request | answer | effect |
//! |---|---|---|
//! | `Hello` | `Hello`, `Connected`, `Ack` | a new connection; the only request (with `Stop`) whose token is ignored |
//! | `Status` | `Status`, `Ack` | none |
//! | `Stream` | `Ack` | telemetry batches on or off |
//! | `LoadStep` | `Ack` | stores one step of the motion program |
//! | `Run` | `Ack`, then events | starts the loaded program at a device time |
//! | `Stop` | `Ack` | ends any motion at once, bridges off; telemetry goes on |
//! | `ClearFault` | `Ack` | leaves the fault state if its cause is gone and both axes are at rest |
//! | `Limits` | `Ack` | force limit and longest silence of the host, until the next start of the device |
//! | `LoadCalibration` | `Ack` | takes one piece of a calibration |
//! | `StoreCalibration` | `Ack` | stores the calibration and restarts with it |
//! | `Calibration` | `Calibration`, `Ack` | none |
//! | `Retreat` | `Ack`, then an event | unloads the guide while a fault is latched |
//! | `AcknowledgeCalibration` | `Ack` | works with the constants of the rig as designed, or of an earlier calibration, until the next start |
//! | `Describe` | `Description`, `Ack` | none |
//! | `Safety` | `Safety`, `Ack` | none |
//! | `Pulse` | `Ack`, then an event | drives one motor briefly, without a loop |

use crate::PIECE_BYTES;
use postcard::experimental::max_size::MaxSize;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Largest number of steps of a motion program.
pub const MAX_STEPS: usize = 64;

/// One request with its identity.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct Command {
    /// Chosen by the host, greater than that of every command before it in this connection; the answer carries it. An id that has
    /// been used is never carried out again.
    pub id: u16,
    /// Token of the connection, from the answer to `Hello` ([`crate::Message::Connected`]). It belongs to one start of the device,
    /// so that no command meant for the state before a restart is carried out after it. Ignored for [`Request::Hello`] and
    /// [`Request::Stop`]. Up to version 3 this was the device's boot id.
    #[serde(alias = "boot_id")]
    pub connection: u32,
    /// Request to the device.
    pub request: Request,
}

/// Request of the host.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum Request {
    /// Begin a connection, and request the identity of the device. Required after every start of the device.
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
        /// [`crate::program_crc`] of these steps: the device runs the program that the host meant, or nothing.
        crc: u32,
        /// Device time at which to start, microseconds; 0 means now. A time in the past is refused, and one more than
        /// [`START_LIMIT_US`] ahead.
        start_us: u64,
    },
    /// End any motion at once and switch the bridges off (the lead screws hold). A frame can be lost: the safety device is the
    /// emergency-stop input, not this request.
    Stop,
    /// Leave the latched fault state.
    ClearFault,
    /// Set the limits of the interlocks. Refused while a program is pending or running, and for values out of range.
    Limits {
        /// Largest force along either axis, millinewtons: 1 to the sensor's rated range. It holds relative to the tare and, so that
        /// no sequence of tares moves it, from the calibration's zero as well.
        force_mn: u32,
        /// Longest time without an accepted command of the connection that started the motion, milliseconds: see
        /// [`SILENCE_LIMIT_MS`].
        silence_ms: u32,
    },
    /// Take one piece of an encoded calibration record.
    LoadCalibration {
        /// Number of the piece, from 0. The piece begins at this number times [`PIECE_BYTES`] in the record.
        piece: u8,
        /// The bytes; those beyond the record's end do not matter.
        bytes: [u8; PIECE_BYTES],
    },
    /// Keep the loaded calibration and restart with it. Refused while a program is pending or running, and while a fault is
    /// latched that no calibration can cause ([`crate::Fault::may_come_of_calibration`]).
    StoreCalibration {
        /// Bytes of the record.
        length: u8,
        /// [`crate::calibration_crc`] of these bytes: the device keeps the record that the host meant, or nothing.
        crc: u32,
    },
    /// Request for the calibration in use.
    Calibration,
    /// Unload guide 2 while a fault is latched: a slow motion of at most [`RETREAT_LIMIT_UM`] along each axis. The device ends it when
    /// the force rises or does not fall. Accepted only while a load is the only cause to stop: every cause is that of a fault which
    /// [allows a retreat](crate::Fault::allows_retreat).
    Retreat {
        /// Displacement along x, micrometres.
        x_um: i32,
        /// Displacement along y, micrometres.
        y_um: i32,
    },
    /// Work with the constants of the rig as designed, or of an earlier calibration, until the next start. Without this, no program
    /// and no pulse runs on a device that has no stored calibration. Clears [`crate::Fault::CalibrationLost`].
    AcknowledgeCalibration,
    /// Request for the description of the build: version, schema hash, limits of all requests.
    Describe,
    /// Tare, calibration and motor heat, now.
    Safety,
    /// Drive one motor briefly at a low duty, without a position loop, and report the response of all channels, which reveals wiring
    /// errors. Both bridges are off before and after it. Refused where [`Request::Run`] is, for values out of range, and where pulses
    /// would add up in one direction or leave the travel.
    Pulse {
        /// 0: x, 1: y.
        axis: u8,
        /// Duty in thousandths, up to [`PULSE_DUTY_LIMIT_PERMILLE`] either way.
        duty_permille: i16,
        /// Longest drive, 1 to [`PULSE_LIMIT_MS`] milliseconds.
        duration_ms: u8,
    },
}

/// Largest motion of guide 2 along each axis in one [`Request::Retreat`], micrometres.
pub const RETREAT_LIMIT_UM: i32 = 1_000;
/// Longest [`Request::Pulse`], milliseconds.
pub const PULSE_LIMIT_MS: u8 = 50;
/// Greatest duty of a [`Request::Pulse`], thousandths. In the longest pulse an actuator with a dead band of at least 0.12 and a
/// no-load speed of at most 22 mm/s moves by no more than [`PULSE_BOUND_UM`], whichever wires are swapped.
pub const PULSE_DUTY_LIMIT_PERMILLE: u16 = 350;
/// Largest motion of one [`Request::Pulse`], micrometres.
pub const PULSE_BOUND_UM: i32 = 300;
/// Change of force along either channel that ends the drive of a [`Request::Pulse`], millinewtons. The motor then moves by
/// another 86 um at most, so that the change stays below 1 N on up to [`PULSE_STIFFNESS_N_PER_MM`].
pub const PULSE_FORCE_MN: u32 = 300;
/// Stiffness of tissue and needle up to which a [`Request::Pulse`] changes no force by more than 1 N, newtons per millimetre.
pub const PULSE_STIFFNESS_N_PER_MM: u32 = 8;
/// Longest time between a request and the start of its program, microseconds.
pub const START_LIMIT_US: u64 = 3_600_000_000;
/// Fastest path that a step may request, micrometres per second.
pub const SPEED_LIMIT_UM_S: u32 = 10_000;
/// Longest hold or ramp, milliseconds.
pub const DURATION_LIMIT_MS: u32 = 3_600_000;
/// Longest tare, milliseconds.
pub const TARE_LIMIT_MS: u32 = 60_000;

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
    /// Hold the position for a time.
    Hold {
        /// Duration, milliseconds.
        duration_ms: u32,
    },
    /// Average the force for a time and make the mean the zero of both force channels. A zero far from the calibration's, or one
    /// that is taken while the force still changes, is rejected, and the program ends: [`crate::TareProblem`].
    Tare {
        /// Duration, milliseconds, above 0.
        duration_ms: u32,
    },
    /// Move guide 2 at constant speed so that the setpoint arrives after this time. The step ends then, without waiting for the
    /// axes to settle. In the last step of a program, and near the end of the travel, the setpoint decelerates and arrives later,
    /// and the step ends when both axes have settled.
    Ramp {
        /// Target along x, micrometres.
        x_um: i32,
        /// Target along y, micrometres.
        y_um: i32,
        /// Duration, milliseconds, above 0.
        duration_ms: u32,
    },
}
