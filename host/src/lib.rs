//! Physical model, inference, session files, link and simulated rig of the needle guide.
//!
//! Dependencies point one way: the program `guide` calls workflows, workflows call inference, inference calls the
//! forward [`model`]; everything else is a leaf. Inside the library every quantity is in SI units; names at the
//! surfaces (files, options, results) carry their unit.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod calibration_file;
pub mod check;
pub mod continuum;
pub mod diagnose;
pub mod figures;
pub mod identify;
pub mod igtl;
pub mod inference;
pub mod levels;
pub mod link;
pub mod model;
pub mod model_file;
pub mod monitor;
pub mod plan;
pub mod predict;
pub mod record;
pub mod recording;
pub mod report;
pub mod rig;
pub mod session;
pub mod simulate;
pub mod sweep;
pub mod tare;
#[cfg(test)]
mod testing;
pub mod track;
