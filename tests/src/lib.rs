//! What the end-to-end tests and `cargo xtask` share: set-up, images, QEMU, the simulated rig beside it.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod bench;
pub mod cosim;
pub mod demo;
pub mod images;
pub mod qemu;
pub mod setup;
pub mod size;
pub mod stress;
pub mod study;
pub mod suite;
pub mod timing;
pub mod tracking;
pub mod wire;
