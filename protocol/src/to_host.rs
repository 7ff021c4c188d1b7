//! Messages: what the device tells the host.
//!
//! Answers (`Hello`, `Ack`, `Refused`, `Status`) follow a command; `Samples`, `Event` come on their own. None is ever sent
//! again: what may go missing is repeated in later state (`Status`, the state and step of every batch, the running count of
//! dropped samples). The order of the variants is the wire format: append, never insert.

use crate::{CalibrationId, CalibrationRecord, Packed, Text};
use postcard::experimental::max_size::MaxSize;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// What every frame from the device starts with.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct Envelope {
    /// Differs from one start of the device to the next.
    pub boot_id: u32,
    /// Number of this frame since that start, from 0, wrapping. A jump is a loss.
    pub sequence: u32,
    /// The content.
    pub message: Message,
}

/// What the device can say.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum Message {
    /// Answer to `Request::Hello`.
    Hello(Hello),
    /// The command was carried out, or had been already.
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
    /// Answer to `Request::Status`; while telemetry is on also unasked, ten times a second.
    Status(Status),
    /// Answer to `Request::Calibration`.
    Calibration(CalibrationRecord),
    /// Follows the hello: the connection that it has begun.
    Connected {
        /// What every command of it carries ([`crate::Command::connection`]).
        connection: u32,
    },
    /// Answer to `Request::Safety`; while telemetry is on also unasked, when it has changed and once a second.
    Safety(Safety),
    /// Answer to `Request::Describe`.
    Description(Description),
}

/// Who the device is and how to read what it sends.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct Hello {
    /// [`crate::VERSION`] of the firmware. First, so that it can be read whatever follows.
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
    /// How to read the channels.
    pub scales: Scales,
    /// Calibration that position and force are computed with.
    pub calibration: CalibrationId,
    /// Place and message of the panic that ended the run before this start, if one did.
    pub last_panic: Option<Text<PANIC_BYTES>>,
}

/// Most bytes of a panic that are told.
pub const PANIC_BYTES: usize = 88;

/// Value of one count of each channel, and the channels' ranges.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct Scales {
    /// Nanometres per position count.
    pub position_nm_per_count: u32,
    /// Nanonewtons per force count.
    pub force_nn_per_count: u32,
    /// Guide 2 can be sent this far from its straight-needle position along each axis, micrometres.
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
    /// The firmware asked for it.
    Software,
    /// The supply voltage sagged.
    BrownOut,
    /// None of the above.
    Other,
}

/// Why a command was not carried out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum Refusal {
    /// The device has restarted since the host said hello.
    OtherBoot,
    /// A fault is latched: read the status, remove the cause, clear it.
    Faulted {
        /// Which.
        fault: Fault,
    },
    /// A program is pending or running.
    Busy,
    /// A step's target lies beyond the travel.
    OutOfTravel,
    /// A speed or a duration is zero or beyond its limit, or a step index is.
    OutOfRange,
    /// The loaded steps are not the ones the host meant (checksum).
    ProgramMismatch,
    /// The start time has passed.
    TooLate,
    /// The fault's cause is still there.
    CauseRemains,
    /// The command could not be decoded, though its frame was intact: versions differ.
    Unreadable,
    /// The loaded calibration is not the one that was meant (checksum), or no rig has such constants
    /// ([`crate::Implausible`]).
    CalibrationInvalid,
    /// The id has been used in this connection: by another command, or so long ago that its answer is forgotten.
    IdUsed,
    /// There is no load to retreat from: no fault of [`Fault::allows_retreat`] is latched, its cause is gone, or another cause to
    /// stop is there as well.
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
    /// 1: the force converter gave no valid reading for too long.
    ForceSensor,
    /// 2: a force channel is at the end of its range.
    ForceRange,
    /// 3: a potentiometer reads beyond its track (wire open or shorted) or jumps further than the actuator can move.
    Potentiometer,
    /// 4: an axis did not reach its target in time.
    MoveTimeout,
    /// 5: the force relative to the tare exceeds the limit that is set.
    ForceLimit,
    /// 6: an axis is beyond its travel and was driven further out.
    Travel,
    /// 7: an axis is driven and does not move.
    Stall,
    /// 8: an axis is further from its setpoint than it can be.
    FollowingError,
    /// 9: the force converter's codes do not change at all, as no real reading does.
    ForceStuck,
    /// 10: no intact command came from the host for too long while a program was pending or running.
    HostSilent,
    /// 11: the device restarted by itself: watchdog, supply, or a panic, which the hello tells.
    Restarted,
    /// 12: the control task was late.
    Overrun,
    /// 13: a motor has used up its duty cycle and must cool.
    MotorHot,
    /// 14: an axis moves against the direction in which it is driven: a table's sign, swapped motor or potentiometer wires.
    WrongWay,
    /// 15: the device had a calibration and has lost it; it works with the constants of the rig as designed.
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

    /// `Request::Retreat` is a way out of this fault: its cause stays as long as the guide stays where it is.
    pub const fn allows_retreat(self) -> bool {
        matches!(self, Self::ForceRange | Self::ForceLimit | Self::Travel)
    }

    /// A wrong calibration can be the cause of this fault, so that storing another one is a way out of it.
    pub const fn may_come_of_calibration(self) -> bool {
        matches!(
            self,
            Self::ForceRange | Self::Potentiometer | Self::Travel | Self::WrongWay | Self::CalibrationLost
        )
    }
}

/// What the controller is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum State {
    /// At rest, bridges off.
    Idle,
    /// A program waits for its start time.
    Pending,
    /// A `Move` step runs.
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
}

/// Something that happened, with its device time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct Event {
    /// Device time, microseconds.
    pub t_us: u64,
    /// What.
    pub kind: EventKind,
}

/// What can happen.
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
        /// How.
        outcome: Outcome,
    },
    /// A fault was latched.
    Faulted {
        /// Which.
        fault: Fault,
    },
    /// A tare was rejected: the zero is the one from before.
    TareRejected {
        /// What was found.
        tare: Tare,
        /// Why it was rejected.
        problem: TareProblem,
    },
    /// A retreat has ended; the bridges are off and the fault is still latched.
    RetreatEnded {
        /// How.
        outcome: RetreatOutcome,
    },
}

/// Why a tare was rejected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum TareProblem {
    /// The zero would lie further from the calibration's zero than [`TARE_ZERO_PERCENT`] of the rated range: the needle is loaded.
    FarFromZero,
    /// The force has changed by more than [`TARE_CHANGE_PERCENT`] of the rated range meanwhile: it still settles.
    Settling,
}

/// Furthest that a tare may move the zero from that of the calibration, percent of the rated range.
pub const TARE_ZERO_PERCENT: u32 = 20;
/// Most that the force may change during a tare, percent of the rated range.
pub const TARE_CHANGE_PERCENT: u32 = 1;

/// How a retreat ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum RetreatOutcome {
    /// The cause of the fault is gone, with a margin.
    Unloaded,
    /// The guide has moved by what was asked for; the cause remains.
    Moved,
    /// The force did not fall: try another direction.
    ForceNotFalling,
    /// Another cause to stop appeared, `Stop` came, or the axis did not get there in time.
    Stopped,
}

/// What a tare found: the readings that are zero from now on, and how good they were.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct Tare {
    /// Mean of x and y before, in force counts from the converter's own zero.
    pub zero_counts: [i32; 2],
    /// Standard deviation of a single reading of x and y about the drift, in force counts.
    pub sd_counts: [u32; 2],
    /// Drift of x and y: slope of a straight line through the readings, in force counts per second.
    pub drift_counts_per_s: [i32; 2],
    /// Control periods that it lasted.
    pub periods: u32,
    /// Valid readings among them.
    pub readings: u32,
    /// Different codes that the converter gave on channel 0 and 1; [`UNIQUE_CODES`] stands for that many or more.
    pub unique_codes: [u8; 2],
}

/// Different codes that a tare tells apart. A sound converter gives another code nearly every time.
pub const UNIQUE_CODES: u8 = 24;

/// How a program ended.
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

/// What decides whether the guide may move and what the force means, beside the status.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct Safety {
    /// Device time, microseconds.
    pub t_us: u64,
    /// Where the constants come from.
    pub calibration: CalibrationSource,
    /// A tare was completed since the device started. Without one, the force counts from the calibration's zero.
    pub tared: bool,
    /// Zero of the force along x and y, in force counts from the calibration's zero.
    pub zero_counts: [i32; 2],
    /// Time of rest until the motors x and y have cooled so far that `MotorHot` can be cleared, seconds; 0 for one that has.
    pub cools_in_s: [u16; 2],
    /// The axes x and y have moved the way they were driven since the start; until then they are driven slowly.
    pub proven: [bool; 2],
}

/// Where the constants of the rig come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum CalibrationSource {
    /// From the calibration that is stored on the device.
    Stored,
    /// None is stored: those of the rig as designed, which nobody has acknowledged since the start.
    Nominal,
    /// The same, acknowledged: programs run.
    NominalAcknowledged,
}

/// What the device was built for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct Description {
    /// [`crate::VERSION`].
    pub protocol_version: u16,
    /// [`crate::schema_hash`].
    pub schema_hash: [u8; 8],
    /// Most steps of a program.
    pub max_steps: u8,
    /// Fastest path, micrometres per second.
    pub speed_limit_um_s: u32,
    /// Longest hold or ramp, milliseconds.
    pub duration_limit_ms: u32,
    /// Longest tare, milliseconds.
    pub tare_limit_ms: u32,
    /// Most that a start may lie ahead, microseconds.
    pub start_limit_us: u64,
    /// Most that a retreat moves along each axis, micrometres.
    pub retreat_limit_um: u32,
    /// Least and greatest silence of the host that can be set, milliseconds.
    pub silence_limit_ms: [u32; 2],
    /// Answers of a connection that are remembered for repeats.
    pub answers_remembered: u8,
    /// Connections whose tokens are valid at a time.
    pub connections: u8,
}

/// State and counters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct Status {
    /// Device time, microseconds.
    pub t_us: u64,
    /// What the controller is doing.
    pub state: State,
    /// Program step; 255 outside a program.
    pub step: u8,
    /// The latched fault.
    pub fault: Option<Fault>,
    /// Position of guide 2 along x and y, in position counts.
    pub position_counts: [i32; 2],
    /// Force along x and y relative to the tare, in force counts.
    pub force_counts: [i32; 2],
    /// Telemetry is on.
    pub streaming: bool,
    /// Counters since start.
    pub counters: Counters,
    /// How busy the processor is.
    pub load: Load,
    /// Share of their duty cycle that the motors x and y have used, per thousand; at 1000 they must rest.
    pub motor_budget_permille: [u16; 2],
    /// Limit of the force along either axis, relative to the tare and from the calibration's zero, millinewtons.
    pub force_limit_mn: u32,
    /// Longest time without an intact command while a program is pending or running, milliseconds.
    pub silence_limit_ms: u32,
    /// Lateral stiffness along x and y since the last tare; none before guide 2 has moved far enough to tell.
    pub stiffness: [Option<Stiffness>; 2],
}

/// How busy the processor is. Times are those of the device's clock, rounded up to its microsecond.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct Load {
    /// Share of the last tenth of a second that was not idle, per thousand.
    pub cpu_permille: u16,
    /// Longest work of a control period since start, from its wake-up to its last output, microseconds.
    pub longest_period_us: u16,
    /// Latest begin of a control period since start, microseconds after it was due.
    pub latest_start_us: u16,
    /// Bytes of the stack that have never been used.
    pub stack_free_bytes: u32,
    /// Most places of the way out (batches, answers, events) that were taken at once since start.
    pub outbox_most: u8,
}

/// Slope of a straight line through force against displacement, fitted on the device as readings come.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct Stiffness {
    /// Slope, millinewtons per metre.
    pub slope_mn_per_m: i32,
    /// Its standard error, millinewtons per metre.
    pub sd_mn_per_m: u32,
    /// Filtered readings that it was fitted to.
    pub readings: u32,
}

/// What has gone wrong since start, counted; none wraps.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct Counters {
    /// Samples dropped because the link was too slow.
    pub samples_dropped: u32,
    /// Answers or events dropped for the same reason.
    pub messages_dropped: u32,
    /// Command frames that failed their checksum or their byte stuffing.
    pub frames_corrupt: u32,
    /// Command frames that were over-long.
    pub frames_overlong: u32,
    /// Command frames that were intact but could not be decoded.
    pub frames_unreadable: u32,
    /// Control periods without a valid force reading, for any of the four reasons that follow or a failed bus.
    pub force_readings_bad: u32,
    /// Control periods that began late by more than half a period.
    pub control_overruns: u32,
    /// Errors of the serial line: overrun, framing, noise.
    pub line_errors: u32,
    /// Frames of the force converter that failed their checksum.
    pub force_corrupt: u32,
    /// Periods in which the force converter had nothing new.
    pub force_missing: u32,
    /// Resets of the force converter.
    pub force_resets: u32,
    /// Periods in which a force channel was saturated.
    pub force_saturated: u32,
    /// Faults latched.
    pub faults: u32,
}
