//! Inference from insertions: tip load, path and its band, learned from earlier insertions of the same rig and tissue.
//!
//! The model is linear in everything but the modulus K and the gap between guide 2 and the tissue (`model.md`, section 4): an
//! offset of the tip sensor, the angle of entry, the tip load and its wander with depth (stationary, with a memory that is learned) are
//! normal unknowns, so that given K and gap the smoother is exact ([`Belief`]). K and gap lie on a grid of [`Candidates`] whose weights
//! follow from the evidence: their uncertainty is carried through. Insertions of one rig share a part of these unknowns; how
//! much, is learned from them ([`learn`]).
//!
//! [`published`] is the tip load of Paper A (Lehmann et al.), section III; [`baselines`] are what one would do without mechanics.

pub mod baselines;
mod basis;
mod belief;
mod learn;
mod path;
pub mod published;
mod scales;

#[cfg(test)]
mod tests;

pub use basis::{Candidate, Candidates, Layout, Tissue};
pub use belief::{Belief, Live, Moments};
pub use learn::{Learned, learn};
pub(crate) use path::median;
pub use path::{Bin, PathError, TipPath, row_scatter_m};
pub use scales::Scales;
pub(crate) use scales::of_median;
