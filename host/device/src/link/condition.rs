//! The device's own condition from its status, in the units of a user: the same fields in every document for machines.

use protocol::{Counters, Status};
use serde::Serialize;

/// Load, limits and counters of the device.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Condition {
    /// Share of the processor that is busy, percent.
    pub cpu_percent: f64,
    /// Longest duration of a control period's work since start, microseconds.
    pub longest_period_us: u16,
    /// Largest delay with which a control period has begun since start, microseconds.
    pub latest_start_us: u16,
    /// Bytes of the stack that have never been used.
    pub stack_free_bytes: u32,
    /// Largest number of occupied entries of the outbox since start.
    pub outbox_most: u8,
    /// Share of its duty cycle that the motor of x has used, percent.
    pub motor_duty_used_x_percent: f64,
    /// The same of y.
    pub motor_duty_used_y_percent: f64,
    /// Limit of the force along either axis, from the tare and from the calibration's zero, newtons.
    pub force_limit_n: f64,
    /// Longest silence of the host while a program waits or runs, seconds.
    pub silence_limit_s: f64,
}

impl From<&Status> for Condition {
    fn from(status: &Status) -> Self {
        fn percent(permille: u16) -> f64 {
            f64::from(permille) / 10.0
        }
        let [motor_duty_used_x_percent, motor_duty_used_y_percent] =
            status.motor_budget_permille.map(percent);
        Self {
            cpu_percent: percent(status.load.cpu_permille),
            longest_period_us: status.load.longest_period_us,
            latest_start_us: status.load.latest_start_us,
            stack_free_bytes: status.load.stack_free_bytes,
            outbox_most: status.load.outbox_most,
            motor_duty_used_x_percent,
            motor_duty_used_y_percent,
            force_limit_n: f64::from(status.force_limit_mn) * 1e-3,
            silence_limit_s: f64::from(status.silence_limit_ms) * 1e-3,
        }
    }
}

/// Counters of errors since the device started: the protocol's counters under self-contained names.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[expect(missing_docs, reason = "each is the protocol's counter of nearly that name")]
pub struct ErrorCounters {
    pub samples_dropped: u32,
    pub messages_dropped: u32,
    pub command_frames_corrupt: u32,
    pub command_frames_overlong: u32,
    pub command_frames_unreadable: u32,
    pub force_readings_bad: u32,
    pub control_overruns: u32,
    pub line_errors: u32,
    pub force_frames_corrupt: u32,
    pub force_readings_missing: u32,
    pub force_converter_resets: u32,
    pub force_readings_saturated: u32,
    pub faults: u32,
}

impl From<&Counters> for ErrorCounters {
    fn from(counters: &Counters) -> Self {
        Self {
            samples_dropped: counters.samples_dropped,
            messages_dropped: counters.messages_dropped,
            command_frames_corrupt: counters.frames_corrupt,
            command_frames_overlong: counters.frames_overlong,
            command_frames_unreadable: counters.frames_unreadable,
            force_readings_bad: counters.force_readings_bad,
            control_overruns: counters.control_overruns,
            line_errors: counters.line_errors,
            force_frames_corrupt: counters.force_corrupt,
            force_readings_missing: counters.force_missing,
            force_converter_resets: counters.force_resets,
            force_readings_saturated: counters.force_saturated,
            faults: counters.faults,
        }
    }
}
