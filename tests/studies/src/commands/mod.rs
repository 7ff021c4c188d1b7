//! Studies whose tables need more than a few lines.

pub mod blocks;
pub mod bodies;
pub mod calibration;
pub mod characterize;
pub mod clean;
pub mod diagnosis;
pub mod follow;
mod follow_steered;
pub mod imperfect;
pub mod indentation;
pub mod investigate;
pub mod nesting;
pub mod open;
pub mod population;
pub mod recorded;
pub mod stated;
pub mod tipload;

use std::path::{Path, PathBuf};

/// Root of the workspace.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}
