//! Timeouts of the host, and numbers of attempts.

use std::time::Duration;

/// Number of times a command is sent before it fails.
pub const TRIES: u32 = 5;
/// Number of times a request is made that is acknowledged without its answer.
pub const REQUESTS: u32 = 5;
/// Time for which one answer is awaited: several times the longest command and answer at the slowest link the
/// firmware has.
pub const ANSWER_TIMEOUT: Duration = Duration::from_millis(600);
/// Time without any message after which a streaming device counts as gone.
pub const SILENCE_LIMIT: Duration = Duration::from_secs(3);
