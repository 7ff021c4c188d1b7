//! What stands in for hardware where the firmware runs in QEMU, as far as it is plain logic: tested on the host.
//!
//! | module | has |
//! |---|---|
//! | [`thumb`] | the instructions that access peripherals, decoded |
//! | [`ads131m02_model`] | the force converter at the far end of its bus |
//! | [`flash_model`] | the flash controller, with power cuts |
//! | [`plant`] | the records exchanged with the simulated rig, once per control period |
#![cfg_attr(target_os = "none", no_std)]
#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod ads131m02_model;
pub mod flash_model;
pub mod plant;
pub mod thumb;
