//! Commands of the user to the device.

use crate::link::Program;
use std::sync::Arc;

/// Commands of the user.
#[derive(Debug, Clone, PartialEq)]
pub enum UserCommand {
    /// Make the present force zero.
    Tare,
    /// Move guide 2 along x and y from where it was last sent, metres.
    Jog([f64; 2]),
    /// Bring guide 2 to where the needle is straight.
    Home,
    /// Run a motion program; its sweeps are not taken.
    Run(Arc<Program>),
    /// End any motion at once.
    Stop,
    /// Leave the fault state.
    Clear,
    /// Move out of the load that has caused the fault, against the larger force.
    Retreat,
}
