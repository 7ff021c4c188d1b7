//! Models of the peripherals that QEMU lacks, for the firmware in QEMU, as plain logic that is tested on the host.
//!
//! | module | has |
//! |---|---|
//! | [`thumb`] | the instructions that access peripherals, decoded |
//! | [`ads131m02_model`] | the force converter at the far end of its bus |
//! | [`flash_model`] | the flash controller, with power cuts |
//! | [`plant`] | the records exchanged with the simulated rig, once per control period |
//!
//! # Example
//!
//! A driver's `ldr r0, [r1, #0x14]` on the flash controller is decoded and carried out on the model, which is locked after a reset:
//!
//! ```
//! use emulation::flash_model::FlashModel;
//! use emulation::thumb::{Direction, Width, decode};
//!
//! const FLASH: u32 = 0x4002_2000;
//! let mut registers = [0; 16];
//! registers[1] = FLASH;
//! let access = decode(0x6948, 0, &registers).expect("a load from a register");
//! assert_eq!((access.direction, access.width, access.register), (Direction::Load, Width::Word, 0));
//!
//! let control = FlashModel::new().read_register(access.address - FLASH).expect("a register of the model");
//! assert_ne!(access.extend(control) & 1 << 31, 0, "LOCK is set");
//! ```
#![cfg_attr(target_os = "none", no_std)]
#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod ads131m02_model;
pub mod flash_model;
pub mod plant;
pub mod thumb;
