//! What every real rig and tissue leave behind any model: everyday sizes of the patterns of a diagnosis, by the names that model files
//! have for them.
//!
//! Sizes are those of an ordinary rig, simulated and measured: what a careful laboratory would not notice. What is stated of the rig and
//! not exact is in the other sections.

pub mod insertion;
pub mod lateral;
