//! Firmware of the needle guide: what does not depend on the hardware, tested on the host, and, for the microcontroller,
//! the board and its stand-in for QEMU.
#![cfg_attr(not(test), no_std)]
#![deny(missing_docs)]

#[cfg(all(feature = "campaign", feature = "target"))]
compile_error!("the campaign is for tests on the host: with it safety measures can be disabled");

#[cfg(any(test, feature = "campaign"))]
extern crate std;

pub mod ads131m02;
#[cfg(any(test, feature = "qemu"))]
pub mod ads131m02_model;
#[cfg(feature = "target")]
pub mod app;
#[cfg(feature = "target")]
pub mod board;
pub mod calibration;
#[cfg(any(test, feature = "campaign"))]
pub mod campaign;
pub mod control;
pub mod flash_model;
pub mod hal;
pub mod plant;
#[cfg(feature = "qemu")]
pub mod qemu;
pub mod slots;
#[cfg(feature = "steering")]
pub mod steering;
pub mod thumb;

/// Commit that this was built from, `-dirty` where files differ from it, `unknown` outside a git repository.
pub const COMMIT: &str = env!("FIRMWARE_GIT");

#[cfg(feature = "flash")]
use defmt_rtt as _;
#[cfg(feature = "qemu")]
use defmt_semihosting as _;
