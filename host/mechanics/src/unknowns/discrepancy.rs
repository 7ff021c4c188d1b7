//! Discrepancy of every real rig and tissue from any model: everyday sizes of the patterns of a diagnosis, by the names
//! that model files have for them.
//!
//! Sizes are those of an ordinary rig, simulated and measured: what a careful laboratory would not notice. Inexact
//! statements about the rig are in the other sections.

pub mod insertion;
pub mod lateral;
