//! The whole system on one machine: the firmware in QEMU, the simulated rig in lockstep with it, `guide` at its serial port. The
//! end-to-end tests use it, and so do the demonstration, benches and long runs that `cargo xtask` starts.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod bench;
pub mod beside;
pub mod bringup;
pub mod campaign;
pub mod cosim;
pub mod demo;
pub mod fuzz;
pub mod fuzzed;
pub mod hil;
pub mod imaged;
pub mod images;
pub mod module;
pub mod needle;
mod numbers;
pub mod panics;
pub mod peers;
pub mod pty;
pub mod qemu;
pub mod readme;
pub mod size;
pub mod soak;
pub mod stress;
pub mod suite;
pub mod terminals;
pub mod timing;
pub mod tracking;
pub mod trial;
pub mod wire;

#[cfg(test)]
mod rules;
