//! Live state of the device, as `guide monitor` shows it.
//!
//! The [`worker`] owns the link and reports what happens on it; the [`State`] is what follows from that. Drawing it is the program's.

pub mod health;
pub mod report;
pub mod state;
pub mod traces;
pub mod worker;

mod command;
mod session;

#[cfg(test)]
mod testing;

pub use command::UserCommand;
pub use state::{Event, State};
pub use worker::Worker;
