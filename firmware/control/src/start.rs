//! Start state and build of the controller.

use super::commands;
use super::retained::ControllerState;
use protocol::Description;

/// Description of the device's build.
pub const DESCRIPTION: Description = Description {
    protocol_version: protocol::VERSION,
    schema_hash: protocol::schema_hash(),
    max_steps: protocol::MAX_STEPS as u8,
    speed_limit_um_s: protocol::SPEED_LIMIT_UM_S,
    duration_limit_ms: protocol::DURATION_LIMIT_MS,
    tare_limit_ms: protocol::TARE_LIMIT_MS,
    start_limit_us: protocol::START_LIMIT_US,
    retreat_limit_um: protocol::RETREAT_LIMIT_UM as u32,
    silence_limit_ms: protocol::SILENCE_LIMIT_MS,
    answers_remembered: commands::MAX_STORED_ANSWERS as u8,
    connections: commands::CONNECTIONS as u8,
};

/// Inputs from the board at the start.
#[derive(Debug, Clone)]
pub struct Start {
    /// Identity of the boot.
    pub boot_id: u32,
    /// The program before did not end as it should, which someone has to acknowledge before anything moves.
    pub restarted: bool,
    /// Source of the calibration.
    pub origin: Origin,
    /// State that the previous run has left.
    pub retained: Option<ControllerState>,
}

impl Start {
    /// A start with nothing amiss: a stored calibration, and nothing left of a run before.
    pub const fn ordinary(boot_id: u32) -> Self {
        Self { boot_id, restarted: false, origin: Origin::Stored, retained: None }
    }
}

/// Source of a calibration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// It is stored on the device.
    Stored,
    /// It is stored on the device, and beside it what may have been a newer one and cannot be read any more.
    Earlier,
    /// None was ever stored: it is the one of the rig as designed.
    Nominal,
    /// One was stored and cannot be read any more: it is the one of the rig as designed.
    Lost,
}
