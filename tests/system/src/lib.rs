//! The whole system on one machine: the firmware in QEMU, the simulated rig in lockstep with it, `guide` at its serial port. The
//! end-to-end tests use it, and so do the demonstration, benches and long runs that `cargo xtask` starts.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod bench;
#[cfg(feature = "checks")]
pub mod beside;
#[cfg(feature = "checks")]
pub mod bringup;
pub mod cosim;
pub mod demo;
#[cfg(feature = "checks")]
pub mod fuzz;
#[cfg(feature = "checks")]
pub mod fuzzed;
#[cfg(feature = "checks")]
pub mod hil;
#[cfg(feature = "checks")]
pub mod imaged;
pub mod images;
#[cfg(feature = "checks")]
pub mod left_running;
#[cfg(feature = "checks")]
pub mod module;
pub mod needle;
#[cfg(feature = "checks")]
mod numbers;
#[cfg(feature = "checks")]
pub mod on_target;
#[cfg(feature = "checks")]
pub mod panics;
#[cfg(feature = "checks")]
pub mod peers;
pub mod pty;
pub mod qemu;
#[cfg(feature = "checks")]
pub mod readme;
#[cfg(feature = "checks")]
pub mod sequences;
#[cfg(feature = "checks")]
pub mod size;
pub mod terminals;
#[cfg(feature = "checks")]
pub mod timing;
#[cfg(feature = "checks")]
pub mod tracking;
pub mod wire;

#[cfg(test)]
mod rules;
