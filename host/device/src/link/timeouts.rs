//! How long the host waits for the device, and how often it tries.

use std::time::Duration;

/// How often a command is sent before its answer is given up.
pub const TRIES: u32 = 5;
/// How often a request is made that is acknowledged without its answer.
pub const REQUESTS: u32 = 5;
/// How long one answer is awaited: several times the longest command and answer at the slowest link the firmware has.
pub const ANSWER_TIMEOUT: Duration = Duration::from_millis(600);
/// How long the device may send nothing while it streams before it counts as gone.
pub const SILENCE_LIMIT: Duration = Duration::from_secs(3);
