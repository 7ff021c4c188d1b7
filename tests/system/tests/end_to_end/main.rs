//! The firmware in QEMU against the simulated rig, from end to end: driven with the host library and with the program
//! `guide`. They need QEMU, so `cargo test` skips them and `cargo xtask test` runs them; what the pages show
//! without a rig is held to the programs by both.

mod boards;
mod bringup;
mod characterize;
mod foreign;
mod hazards;
mod igtl;
mod image;
mod library;
mod machine;
mod ports;
mod program;
mod python;
mod readme;
mod registers;
mod rig_matches;
mod steer;
mod web;
