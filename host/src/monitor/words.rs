//! Names of what the device says, as people read them.

use protocol::{Counters, ResetReason, State};

/// What the controller is doing.
pub fn state(state: State) -> &'static str {
    match state {
        State::Idle => "idle",
        State::Pending => "waiting for its start time",
        State::Moving => "moving",
        State::Holding => "holding",
        State::Taring => "taring",
        State::Faulted => "faulted",
    }
}

/// Why the device last started.
pub fn reset_reason(reason: ResetReason) -> &'static str {
    match reason {
        ResetReason::PowerOn => "power came on",
        ResetReason::Pin => "the reset button or pin",
        ResetReason::Watchdog => "the watchdog",
        ResetReason::Software => "the firmware asked for it",
        ResetReason::BrownOut => "the supply voltage sagged",
        ResetReason::Other => "unknown",
    }
}

/// Every counter with its meaning.
pub fn counters(counters: &Counters) -> [(u32, &'static str); 13] {
    [
        (counters.faults, "faults"),
        (counters.samples_dropped, "samples dropped"),
        (counters.messages_dropped, "messages dropped"),
        (counters.control_overruns, "late control periods"),
        (counters.force_readings_bad, "bad force readings"),
        (counters.force_corrupt, "corrupt force frames"),
        (counters.force_missing, "missing force readings"),
        (counters.force_resets, "force converter resets"),
        (counters.force_saturated, "saturated force periods"),
        (counters.frames_corrupt, "corrupt commands"),
        (counters.frames_overlong, "over-long commands"),
        (counters.frames_unreadable, "unreadable commands"),
        (counters.line_errors, "line errors"),
    ]
}
