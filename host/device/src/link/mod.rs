//! The link to the device: port, frames, commands, motion programs.

pub mod client;
pub mod condition;
mod constants;
pub mod display;
pub mod error;
pub(crate) mod keepalive;
pub mod port;
pub mod program;
mod retreat;
pub mod run;
pub(crate) mod silence;
pub mod telemetry;
mod timeouts;
mod wire;

pub use client::Client;
pub use constants::{Limits, named};
pub use error::LinkError;
pub use program::Program;
pub use run::{RunOptions, run};
pub use telemetry::{Batch, Point, Telemetry};
pub use timeouts::SILENCE_LIMIT;
pub use wire::{LinkLosses, Tap};

#[cfg(test)]
mod tests;
