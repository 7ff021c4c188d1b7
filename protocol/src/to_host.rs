//! Messages of the device to the host.
//!
//! Answers (such as `Hello`, `Ack`, `Refused`) follow a command; `Samples`, `Event` and periodic `Status` and `Safety` are unsolicited.
//! No message is sent again: later state repeats what may be lost (`Status`, the state and step of every batch, the running count
//! of dropped samples). The order of the variants is the wire format: append, never insert.

use crate::{CalibrationId, CalibrationRecord, Description, Packed, Safety, Status, Text};
use postcard::experimental::max_size::MaxSize;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Head of every frame from the device.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct Envelope {
    /// Differs from one start of the device to the next.
    pub boot_id: u32,
    /// Number of this frame since that start, from 0, wrapping. A jump is a loss.
    pub sequence: u32,
    /// The content.
    pub message: Message,
}

/// Message of the device.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum Message {
    /// Answer to `Request::Hello`.
    Hello(Hello),
    /// The command was carried out, now or at its first arrival.
    Ack {
        /// Id of the command.
        id: u16,
    },
    /// The command was not carried out.
    Refused {
        /// Id of the command.
        id: u16,
        /// Why not.
        refusal: Refusal,
    },
    /// A batch of consecutive samples.
    Samples(Samples),
    /// Something happened.
    Event(Event),
    /// Answer to `Request::Status`; while telemetry is on also unsolicited, ten times a second.
    Status(Status),
    /// Answer to `Request::Calibration`.
    Calibration(CalibrationRecord),
    /// Follows the hello: the connection that it has begun.
    Connected {
        /// Number that every command of the connection carries ([`crate::Command::connection`]).
        connection: u32,
    },
    /// Answer to `Request::Safety`; while telemetry is on also unsolicited, once a second and when the calibration's source, the
    /// tare or the zero has changed.
    Safety(Safety),
    /// Answer to `Request::Describe`.
    Description(Description),
}

/// Identity of the device, and the scales of its data.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct Hello {
    /// [`crate::VERSION`] of the firmware. First, so that it can be read independent of what follows.
    pub protocol_version: u16,
    /// [`crate::schema_hash`] of the firmware's message types.
    pub schema_hash: [u8; 8],
    /// Firmware version, such as `0.1.0`.
    pub firmware_version: Text<16>,
    /// Commit the firmware was built from, with `-dirty` where it had local changes.
    pub commit: Text<20>,
    /// Board name.
    pub board: Text<24>,
    /// Why the device last started.
    pub reset_reason: ResetReason,
    /// Ticks per second of every `_us` time in these messages, 1,000,000.
    pub tick_hz: u32,
    /// Device time when this was sent, microseconds since start.
    pub now_us: u64,
    /// Time between samples, which is the control period, microseconds.
    pub sample_period_us: u32,
    /// Scales of the channels.
    pub scales: Scales,
    /// Calibration that position and force are computed with.
    pub calibration: CalibrationId,
    /// Place and message of the panic that ended the run before this start, if one did.
    pub last_panic: Option<Text<PANIC_BYTES>>,
}

/// Largest number of bytes of a panic that are reported.
pub const PANIC_BYTES: usize = 88;

/// Value of one count of each channel, and the channels' ranges.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct Scales {
    /// Nanometres per position count.
    pub position_nm_per_count: u32,
    /// Nanonewtons per force count.
    pub force_nn_per_count: u32,
    /// Largest distance of guide 2 from its straight-needle position along each axis, micrometres.
    pub travel_um: u32,
    /// Rated range of each force channel, millinewtons.
    pub force_range_mn: u32,
}

/// Why a device started.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum ResetReason {
    /// Power came on.
    PowerOn,
    /// The reset pin or button.
    Pin,
    /// The watchdog was not fed.
    Watchdog,
    /// The firmware requested it.
    Software,
    /// The supply voltage sagged.
    BrownOut,
    /// None of the above.
    Other,
}

/// Why a command was not carried out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum Refusal {
    /// The token is of another start of the device, or the device has forgotten it.
    OtherBoot,
    /// A fault is latched: read the status, remove the cause, clear it.
    Faulted {
        /// Fault.
        fault: Fault,
    },
    /// A program, a retreat or a pulse is pending or running, or the device is about to restart.
    Busy,
    /// A target lies beyond the travel, a retreat does not lead towards its middle, or an axis that has not yet moved in its driven
    /// direction would move without a valid force, or by too many pulses in one direction.
    OutOfTravel,
    /// A number is out of its range.
    OutOfRange,
    /// The loaded steps do not have the checksum that the host sent.
    ProgramMismatch,
    /// The start time has passed.
    TooLate,
    /// A cause to stop exists, or an axis is not at rest.
    CauseRemains,
    /// The command could not be decoded, though its frame was intact: versions differ.
    Unreadable,
    /// The checksum of the loaded calibration is not the one that the host announced, or no rig has such constants
    /// ([`crate::Implausible`]).
    CalibrationInvalid,
    /// The id is not greater than all before it in this connection, and the command is no repeat whose answer is remembered.
    IdUsed,
    /// There is no load to retreat from: no fault is latched, or no load is a cause to stop ([`Fault::allows_retreat`]), or
    /// another cause to stop exists as well.
    NotUnderLoad,
    /// No calibration is stored: acknowledge the constants of the rig as designed first.
    CalibrationNotAcknowledged,
}

/// A latched fault: bridges off until it is cleared. The number is what logs and the host show.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
#[repr(u8)]
pub enum Fault {
    /// 0: the emergency stop was pressed or its wire is open.
    EmergencyStop,
    /// 1: the force converter gave too few valid readings, or readings that no motion explains.
    ForceSensor,
    /// 2: a force channel is at the end of its range.
    ForceRange,
    /// 3: a potentiometer reads beyond its track (wire open or shorted) or jumps further than the actuator can move.
    Potentiometer,
    /// 4: an axis did not reach its target in time.
    MoveTimeout,
    /// 5: the force from the tare, or that from the calibration's zero, exceeds the limit that is set.
    ForceLimit,
    /// 6: an axis is beyond its travel and is driven, or moves, further out.
    Travel,
    /// 7: an axis is driven and does not move.
    Stall,
    /// 8: an axis is further from its setpoint than any working axis.
    FollowingError,
    /// 9: codes of a force channel repeat earlier ones more often than real readings do.
    ForceStuck,
    /// 10: a motion was pending or running, and the host that started it sent no accepted command for too long.
    HostSilent,
    /// 11: the device restarted by itself: watchdog, supply, or a panic, which the hello reports.
    Restarted,
    /// 12: the control task was late.
    Overrun,
    /// 13: a motor has used up its duty cycle and must cool.
    MotorHot,
    /// 14: an axis moves against the direction in which it is driven: a table's sign, swapped motor or potentiometer wires.
    WrongWay,
    /// 15: the device had a calibration and has lost it; it works with an earlier one, or with the constants of the rig as designed.
    CalibrationLost,
}

impl Fault {
    /// Every fault, by number.
    pub const ALL: [Self; 16] = [
        Self::EmergencyStop,
        Self::ForceSensor,
        Self::ForceRange,
        Self::Potentiometer,
        Self::MoveTimeout,
        Self::ForceLimit,
        Self::Travel,
        Self::Stall,
        Self::FollowingError,
        Self::ForceStuck,
        Self::HostSilent,
        Self::Restarted,
        Self::Overrun,
        Self::MotorHot,
        Self::WrongWay,
        Self::CalibrationLost,
    ];

    /// The fault of this number.
    pub fn of_number(number: u8) -> Option<Self> {
        Self::ALL.get(usize::from(number)).copied()
    }

    /// Whether `Request::Retreat` can remove the cause of this fault. That of `Travel` ends by itself: it exists while an axis beyond
    /// the travel is driven or moves further out, and a retreat starts at rest.
    pub const fn allows_retreat(self) -> bool {
        matches!(self, Self::ForceRange | Self::ForceLimit)
    }

    /// Whether a wrong calibration can cause this fault, so that storing another one can remove the cause.
    pub const fn may_come_of_calibration(self) -> bool {
        matches!(
            self,
            Self::ForceRange | Self::Potentiometer | Self::Travel | Self::WrongWay | Self::CalibrationLost
        )
    }
}

/// State of the controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum State {
    /// At rest, bridges off.
    Idle,
    /// A program waits for its start time.
    Pending,
    /// A `Move` or `Ramp` step, or a pulse, runs.
    Moving,
    /// A `Hold` step runs.
    Holding,
    /// A `Tare` step runs.
    Taring,
    /// A fault is latched, bridges off.
    Faulted,
    /// A fault is latched and a `Retreat` runs.
    Retreating,
}

/// A batch of consecutive samples, all taken in the same state and step.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct Samples {
    /// Device time of the first sample, microseconds; the others follow at `Hello::sample_period_us`.
    pub t_us: u64,
    /// Samples that the device has dropped since its start (link too slow), up to this batch. They lie before this batch.
    pub dropped: u32,
    /// State in which all of these were taken.
    pub state: State,
    /// Program step in which all of these were taken; 255 outside a program.
    pub step: u8,
    /// Number of samples, at least 1.
    pub count: u8,
    /// The samples, in as few bits as they need: see [`crate::pack`].
    pub packed: Packed,
    /// One bit for each sample, that of the first sample lowest. It is set where the sample repeats an earlier force because
    /// there was no valid reading. Versions up to 5 lack this field.
    pub repeats_force: u32,
}

/// Something that happened, with its device time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct Event {
    /// Device time, microseconds.
    pub t_us: u64,
    /// Kind of the event.
    pub kind: EventKind,
}

/// Event of the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum EventKind {
    /// The step with this index began.
    StepStarted {
        /// Index in the program.
        index: u8,
    },
    /// The step with this index was completed.
    StepEnded {
        /// Index in the program.
        index: u8,
    },
    /// A tare was completed.
    Tared(Tare),
    /// The program has ended; the bridges are off.
    ProgramEnded {
        /// Outcome.
        outcome: Outcome,
    },
    /// A fault was latched.
    Faulted {
        /// Fault.
        fault: Fault,
    },
    /// A tare was rejected; the zero is unchanged.
    TareRejected {
        /// Result of the tare.
        tare: Tare,
        /// Why it was rejected.
        problem: TareProblem,
    },
    /// A retreat has ended; the bridges are off and the fault is still latched.
    RetreatEnded {
        /// Outcome.
        outcome: RetreatOutcome,
    },
    /// A pulse has ended; the bridges are off.
    PulseEnded(PulseReport),
}

/// Readings of all channels during a pulse of one motor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct PulseReport {
    /// Axis that was driven: 0 for x, 1 for y.
    pub axis: u8,
    /// Reason for the end of the drive.
    pub outcome: PulseOutcome,
    /// Duration of the drive, milliseconds.
    pub driven_ms: u8,
    /// Change of the rest position of x and y by the pulse, position counts: mean of 20 readings after it less that of 20
    /// readings before.
    pub moved_counts: [i32; 2],
    /// Largest deviation of a reading of x and y from the position before the pulse, position counts.
    pub most_moved_counts: [i32; 2],
    /// Change of the force of x and y by the pulse, at rest, force counts.
    pub force_counts: [i32; 2],
    /// Largest deviation of a reading of x and y from the force before the pulse, force counts.
    pub most_force_counts: [i32; 2],
}

/// Reason for the end of a pulse's drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum PulseOutcome {
    /// The requested duration was over.
    Completed,
    /// The axis had moved far enough.
    Reached,
    /// The other axis moved.
    OtherAxis,
    /// A force had changed by [`crate::PULSE_FORCE_MN`].
    Force,
    /// `Request::Stop`, or a fault.
    Stopped,
}

/// Why a tare was rejected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum TareProblem {
    /// The zero would lie further from the calibration's zero than [`TARE_ZERO_PERCENT`] of the rated range: the needle is loaded.
    FarFromZero,
    /// The force changed by more than [`TARE_CHANGE_PERCENT`] of the rated range during the tare: it is still settling.
    Settling,
}

/// Largest distance of a tare's zero from that of the calibration, percent of the rated range.
pub const TARE_ZERO_PERCENT: u32 = 20;
/// Largest change of the force during a tare, percent of the rated range.
pub const TARE_CHANGE_PERCENT: u32 = 1;

/// Outcome of a retreat.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum RetreatOutcome {
    /// The load is below the limit, and either there is a margin or the load no longer falls.
    Unloaded,
    /// The guide has moved by the requested distance, or to the middle of the travel or past it; the cause may remain.
    Moved,
    /// The force rose or did not fall.
    ForceNotFalling,
    /// Another cause to stop appeared, `Stop` came, or the guide did not come to rest or reach its target in time.
    Stopped,
}

/// Result of a tare: the new zero of the force, and its quality.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct Tare {
    /// Mean force of x and y, the new zero, in force counts from the calibration's zero.
    pub zero_counts: [i32; 2],
    /// Standard deviation of a single reading of x and y about the drift, in force counts.
    pub sd_counts: [u32; 2],
    /// Drift of x and y: slope of a straight line through the readings, in force counts per second.
    pub drift_counts_per_s: [i32; 2],
    /// Duration, control periods.
    pub periods: u32,
    /// Number of control periods with a valid reading.
    pub readings: u32,
    /// Different codes that the converter gave on channel 0 and 1; [`UNIQUE_CODES`] stands for that many or more.
    pub unique_codes: [u8; 2],
}

/// Number of different codes up to which a tare counts. A working converter gives another code nearly every time.
pub const UNIQUE_CODES: u8 = 24;

/// Outcome of a program.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum Outcome {
    /// Every step was completed.
    Completed,
    /// `Request::Stop` ended it.
    Stopped,
    /// A fault ended it.
    Faulted,
    /// A tare among its steps was rejected.
    TareRejected,
}
