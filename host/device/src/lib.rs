//! The host's side of the needle guide: its link, what is recorded from it, and what is passed on to others.
//!
//! | module | does |
//! |---|---|
//! | [`air`] | motion programs in air, by which a rig is characterised |
//! | [`bringup`] | a new rig, step by step: what is wired or mounted wrong |
//! | [`calibrate`] | constants of a rig from known loads and a gauge |
//! | [`monitor`] | what the device does, live |
//! | [`link`] | commands, telemetry and motion programs over the serial port |
//! | [`recording`] | raw recordings of everything that went over the link, lossless |
//! | [`record`] | sessions acquired from the device |
//! | [`steer`] | guide 2 of the device under the controller that steers a needle |
//! | [`sweep`] | ultrasound sweeps by an external command |
//! | [`tare`] | whether readings are quiet enough for a zero |
//! | [`igtl`] | OpenIGTLink, for navigation software |
//! | [`words`] | command lines of other programs, as the system's shells read them |
//!
//! # Example
//!
//! A built-in motion program, as it is sent to the device:
//!
//! ```
//! use device::link::Program;
//!
//! let program = Program::load("staircase")?;
//! assert!(!program.device_steps().is_empty());
//! # Ok::<(), device::link::program::ProgramError>(())
//! ```
#![forbid(unsafe_code)]
#![deny(missing_docs)]

#[cfg(test)]
extern crate self as device;

pub mod air;
pub mod bringup;
pub mod calibrate;
pub mod igtl;
pub mod link;
pub mod monitor;
pub mod record;
pub mod recording;
pub mod steer;
pub mod sweep;
pub mod tare;
pub mod words;
