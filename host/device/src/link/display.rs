//! Names of what the device reports, as people read them.

use protocol::{CalibrationSource, Counters, Request, ResetReason, State};

/// Text for the controller's state.
pub fn state(state: State) -> &'static str {
    match state {
        State::Idle => "idle",
        State::Pending => "waiting for its start time",
        State::Moving => "moving",
        State::Holding => "holding",
        State::Taring => "taring",
        State::Faulted => "faulted",
        State::Retreating => "retreating from a load",
    }
}

/// Text for the cause of the device's last start.
pub fn reset_reason(reason: ResetReason) -> &'static str {
    match reason {
        ResetReason::PowerOn => "power-on",
        ResetReason::Pin => "its reset pin",
        ResetReason::Watchdog => "its watchdog",
        ResetReason::Software => "its firmware",
        ResetReason::BrownOut => "a sagging supply",
        ResetReason::Other => "an unknown cause",
    }
}

/// Text for the source of the rig's constants.
pub fn calibration_source(source: CalibrationSource) -> &'static str {
    match source {
        CalibrationSource::Stored => "stored",
        CalibrationSource::Nominal => "nominal",
        CalibrationSource::NominalAcknowledged => "nominal, acknowledged",
    }
}

/// Every counter with its meaning.
pub fn counters(counters: &Counters) -> [(u32, &'static str); 13] {
    [
        (counters.samples_dropped, "samples dropped by the device"),
        (counters.messages_dropped, "messages dropped by the device"),
        (counters.frames_corrupt, "corrupt command frames"),
        (counters.frames_overlong, "over-long command frames"),
        (counters.frames_unreadable, "unreadable command frames"),
        (counters.line_errors, "errors of the serial line"),
        (counters.force_readings_bad, "bad force readings"),
        (counters.force_corrupt, "corrupt frames of the force converter"),
        (counters.force_missing, "periods without a new force reading"),
        (counters.force_resets, "resets of the force converter"),
        (counters.force_saturated, "saturated force readings"),
        (counters.control_overruns, "late control periods"),
        (counters.faults, "faults latched"),
    ]
}

/// A request by its name in the command line.
pub fn request_name(request: &Request) -> &'static str {
    match request {
        Request::Hello => "hello",
        Request::Status => "status",
        Request::Stream { .. } => "stream",
        Request::LoadStep { .. } => "load step",
        Request::Run { .. } => "run",
        Request::Stop => "stop",
        Request::ClearFault => "clear",
        Request::Limits { .. } => "limits",
        Request::LoadCalibration { .. } => "load calibration",
        Request::StoreCalibration { .. } => "store calibration",
        Request::Calibration => "calibration",
        Request::Retreat { .. } => "retreat",
        Request::AcknowledgeCalibration => "acknowledge calibration",
        Request::Describe => "describe",
        Request::Safety => "safety",
        Request::Pulse { .. } => "pulse",
    }
}
