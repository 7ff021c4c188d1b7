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
    /// Whether the previous run ended abnormally: the host has to clear the fault that reports it before anything moves.
    pub restarted: bool,
    /// Source of the calibration.
    pub origin: Origin,
    /// State from the previous run.
    pub retained: Option<ControllerState>,
}

impl Start {
    /// A normal start: a stored calibration, and no state from a previous run.
    pub const fn ordinary(boot_id: u32) -> Self {
        Self { boot_id, restarted: false, origin: Origin::Stored, retained: None }
    }
}

/// Source of a calibration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// It is stored on the device.
    Stored,
    /// It is stored on the device, beside a damaged record that may have been newer.
    Earlier,
    /// No calibration was ever stored, and the constants of the rig as designed are used.
    Nominal,
    /// The stored one is damaged, and the constants of the rig as designed are used.
    Lost,
}
