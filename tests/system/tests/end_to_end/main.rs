//! The firmware in QEMU against the simulated rig, from end to end: driven with the host library and with the program
//! `guide`. They need QEMU, so `cargo test` skips them; `cargo xtask test` runs those of [`in_minutes`], with `--all`
//! those of [`at_length`] too. Pages without a rig are compared with the programs beside them.

mod at_length;
mod in_minutes;
mod readme;
