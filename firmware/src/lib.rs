//! Firmware of the needle guide for the microcontroller: tasks, board, and the board's stand-in for QEMU. What it decides is in
//! `control`.
#![no_std]
#![deny(missing_docs)]

#[cfg(feature = "target")]
pub mod app;
#[cfg(feature = "target")]
pub mod board;
#[cfg(any(feature = "qemu", feature = "conformance"))]
pub mod exit;
#[cfg(feature = "qemu")]
pub mod qemu;

/// Commit that this was built from, `-dirty` where files differ from it, `unknown` outside a git repository.
pub const COMMIT: &str = env!("FIRMWARE_GIT");

#[cfg(feature = "flash")]
use defmt_rtt as _;
#[cfg(feature = "qemu")]
use defmt_semihosting as _;
