//! The first tier: every hazard of the interlock's table, the link, the machine's faults, and the procedure, through the firmware.

pub mod hazards;
pub mod library;
pub mod machine;
mod ports;
mod program;
pub mod registers;
mod rig_matches;
