//! Firmware of the needle guide for the microcontroller: tasks, drivers of the boards, and the peripherals that QEMU lacks. All decisions are
//! in the crate `control`, whose front page has an example.
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
