//! Behaviour of a fake device, and its faults.

use protocol::{CalibrationSource, Fault, Refusal};

/// Acts of the device when a program is started, in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Act {
    /// A batch of this many samples.
    Batch(usize),
    /// A batch that is damaged on the way.
    Corrupt(usize),
    /// A batch that does not arrive.
    Lost(usize),
    /// Samples that the device itself had to drop.
    Dropped(u64),
    /// Answers to requests, and nothing else, for so many milliseconds.
    Wait(u64),
    /// The program ends well.
    Complete,
    /// As `Complete`, but its event is lost.
    CompleteWithoutEvent,
    /// A fault ends the program.
    Fail(Fault),
    /// The device restarts, which its next event shows.
    Restart,
    /// Waits, up to 5 s, until the status was requested.
    Question,
    /// From here on so many answers get lost.
    LoseAnswers(usize),
    /// Its clock steps back by so many milliseconds.
    ClockBack(u64),
    /// From here on samples repeat the force, or no longer.
    Saturated(bool),
    /// The port goes away, and with it what the host has not read yet: let it wait before.
    Vanish,
}

/// Behaviour of the device.
#[derive(Debug, Clone)]
pub struct Script {
    /// Protocol version it claims.
    pub version: u16,
    /// Schema hash it claims.
    pub schema_hash: [u8; 8],
    /// Answers nothing at all.
    pub mute: bool,
    /// Number of answers (after the hello's) that get lost.
    pub lost_answers: usize,
    /// Time before its first answer, milliseconds: as where a busy machine gives it no processor.
    pub first_answer_after_ms: u64,
    /// Number of statuses that get lost, while their answers arrive, and an older one that was not requested.
    pub lost_statuses: usize,
    /// Reports late, when a program is loaded, that the one before was stopped.
    pub late_end: bool,
    /// Refuses every command but the hello.
    pub refusal: Option<Refusal>,
    /// Longest time of its own clock without a command while a program runs, milliseconds.
    pub silence_limit_ms: u32,
    /// States that limit, and never ends a program for it: what a test of the host's times counts then does not depend on how often a
    /// busy machine lets the host run.
    pub is_patient: bool,
    /// Source of its calibration.
    pub source: CalibrationSource,
    /// Was tared since its start.
    pub tared: bool,
    /// Restarts with the calibration it had, also after a command to keep another.
    pub keeps_no_calibration: bool,
    /// Acts of a running program.
    pub program: Vec<Act>,
}

impl Default for Script {
    fn default() -> Self {
        Self {
            version: protocol::VERSION,
            schema_hash: protocol::schema_hash(),
            mute: false,
            lost_answers: 0,
            first_answer_after_ms: 0,
            lost_statuses: 0,
            late_end: false,
            refusal: None,
            silence_limit_ms: 2_000,
            is_patient: false,
            source: CalibrationSource::Stored,
            tared: true,
            keeps_no_calibration: false,
            program: vec![Act::Batch(32), Act::Complete],
        }
    }
}
