//! Inputs and outputs of one control period.

use crate::hal::Readings;
use protocol::{CalibrationRecord, Command, Counters, Event, Load, Refusal, Safety, Sample, State, Status};

/// Messages of the controller in one period; the link task turns each into a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OutboundMessage {
    /// Send the hello.
    Hello,
    /// A connection has begun: its token.
    Connected(u32),
    /// Switch telemetry on or off.
    Stream(bool),
    /// A command was carried out.
    Ack(u16),
    /// A command was refused.
    Refused(u16, Refusal),
    /// Something happened.
    Event(Event),
    /// The state, on request.
    Status(Status),
    /// The state, unsolicited.
    Report(Status),
    /// The calibration, on request.
    Calibration,
    /// The safety state (tare, calibration, heat), on request.
    Safety(Safety),
    /// The safety state, unsolicited.
    SafetyReport(Safety),
    /// Description of the device's build, on request.
    Description,
}

/// The messages of one period. It has room for a fault and the end of a program, an answer of three parts, the end of a step with
/// its tare, the end of the program or the start of the next step, and two reports.
pub type OutboundMessages = heapless::Vec<OutboundMessage, 12>;

/// Everything that goes into one control period.
#[derive(Debug, Clone)]
pub struct Inputs {
    /// Device time at which this period was due, microseconds since start.
    pub now_us: u64,
    /// Delay of its start, microseconds.
    pub late_us: u32,
    /// Readings of the sensors.
    pub readings: Readings,
    /// A command that arrived.
    pub command: Option<Command>,
    /// Counters that other tasks keep; the controller adds its own before it reports them.
    pub counters: Counters,
    /// Load of the processor.
    pub load: Load,
}

/// Command to the bridges.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Drive {
    /// Off; the lead screws hold.
    Release,
    /// Duty of axis x and y, -1 to 1, against brake.
    Duty([f32; 2]),
}

/// Everything that comes out of one control period.
#[derive(Debug, Clone)]
pub struct Outputs {
    /// Command to the bridges.
    pub drive: Drive,
    /// The status light.
    pub led: bool,
    /// State of this period.
    pub state: State,
    /// Program step of this period; [`NO_STEP`](super::NO_STEP) outside a program.
    pub step: u8,
    /// The sample of this period.
    pub sample: Sample,
    /// Answers and events, in order.
    pub notes: OutboundMessages,
    /// Whether to keep [`super::Controller::retained_state`] for the next start.
    pub keep: bool,
    /// Keep this calibration and restart with it, once the answer has gone out.
    pub store: Option<CalibrationRecord>,
}
