//! Messages about the device: its status, its safety state and the description of its build.

use crate::{Fault, State};
use postcard::experimental::max_size::MaxSize;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Conditions, besides the status, that decide whether the guide may move and what the force is relative to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct Safety {
    /// Device time, microseconds.
    pub t_us: u64,
    /// Source of the constants.
    pub calibration: CalibrationSource,
    /// A tare was completed since the device started. Without a tare the force is relative to the calibration's zero.
    pub tared: bool,
    /// Zero of the force along x and y, in force counts from the calibration's zero.
    pub zero_counts: [i32; 2],
    /// Rest until motor x and motor y are cool enough for `MotorHot` to be cleared, seconds; 0 for a cool motor.
    pub cools_in_s: [u16; 2],
    /// Whether axis x and axis y have moved in their driven direction since the start. Until then an axis is driven slowly.
    pub proven: [bool; 2],
}

/// Source of the rig's constants.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub enum CalibrationSource {
    /// From the calibration that is stored on the device.
    Stored,
    /// None is stored. The constants are those of the rig as designed; they have not been acknowledged since the start.
    Nominal,
    /// The constants of the rig as designed, acknowledged since the start, so that programs run.
    NominalAcknowledged,
}

/// Description of the device's build.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct Description {
    /// [`crate::VERSION`].
    pub protocol_version: u16,
    /// [`crate::schema_hash`].
    pub schema_hash: [u8; 8],
    /// Largest number of steps of a program.
    pub max_steps: u8,
    /// Fastest path, micrometres per second.
    pub speed_limit_um_s: u32,
    /// Longest hold or ramp, milliseconds.
    pub duration_limit_ms: u32,
    /// Longest tare, milliseconds.
    pub tare_limit_ms: u32,
    /// Longest time between a request and the start of its program, microseconds.
    pub start_limit_us: u64,
    /// Largest motion of a retreat along each axis, micrometres.
    pub retreat_limit_um: u32,
    /// Least and greatest silence of the host that can be set, milliseconds.
    pub silence_limit_ms: [u32; 2],
    /// Number of answers per connection that are kept for repeated commands.
    pub answers_remembered: u8,
    /// Number of connections whose tokens are valid at the same time.
    pub connections: u8,
}

/// State and counters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct Status {
    /// Device time, microseconds.
    pub t_us: u64,
    /// State of the controller.
    pub state: State,
    /// Program step; 255 outside a program.
    pub step: u8,
    /// The latched fault.
    pub fault: Option<Fault>,
    /// Latest position of guide 2 along x and y that was not rejected, in position counts.
    pub position_counts: [i32; 2],
    /// Latest force along x and y that was not rejected, relative to the tare, in force counts.
    pub force_counts: [i32; 2],
    /// Telemetry is on.
    pub streaming: bool,
    /// Counters since start.
    pub counters: Counters,
    /// Load of the processor.
    pub load: Load,
    /// Share of their duty cycle that the motors x and y have used, per thousand; at 1000 they must rest.
    pub motor_budget_permille: [u16; 2],
    /// Limit of the force along either axis, relative to the tare and from the calibration's zero, millinewtons.
    pub force_limit_mn: u32,
    /// Longest time without an accepted command of the connection that started the motion, milliseconds.
    pub silence_limit_ms: u32,
    /// Lateral stiffness along x and y since the last tare; none before guide 2 has moved far enough to determine it.
    pub stiffness: [Option<Stiffness>; 2],
    /// There is no valid reading of the force in this period (missing, or a saturated converter), and `force_counts` repeats an
    /// earlier one. Versions up to 5 lack this field.
    pub repeats_force: bool,
}

/// Load of the processor. Times are those of the device's clock, rounded up to its microsecond.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct Load {
    /// Share of the last tenth of a second that was not idle, per thousand.
    pub cpu_permille: u16,
    /// Longest work of a control period since start, from its wake-up to its last output, microseconds.
    pub longest_period_us: u16,
    /// Largest delay with which a control period has begun since start, microseconds.
    pub latest_start_us: u16,
    /// Bytes of the stack that have never been used.
    pub stack_free_bytes: u32,
    /// Largest number of occupied entries of the outbox (batches, answers, events) since start.
    pub outbox_most: u8,
}

/// Slope of a straight line through force against displacement, fitted online on the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct Stiffness {
    /// Slope, millinewtons per metre.
    pub slope_mn_per_m: i32,
    /// Its standard error, millinewtons per metre.
    pub sd_mn_per_m: u32,
    /// Filtered readings that it was fitted to.
    pub readings: u32,
}

/// Counters of errors since start; none wraps.
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
    /// Control periods without a valid force reading: wrong checksum, nothing new, reset, saturated channel or failed bus.
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
