//! Inference from insertions: tip load, path and its band, learned from earlier insertions of the same rig and tissue.
//!
//! The model is linear in everything but the modulus K and the gap between guide 2 and the tissue (theory, eq. 42): an
//! offset of the tip sensor, the angle of entry, guide 2 off its zero, the place of the surface, the tip load and its process noise along
//! depth (stationary, with a memory that is learned) are normal unknowns, so that given K and gap the smoother is exact ([`Posterior`]). The
//! posterior of K and gap is climbed and covered by a grid as fine as it is narrow ([`learn`]), on responses that are solved once per
//! session ([`Candidates`]): their uncertainty is carried through. Insertions of one rig share a part of these unknowns; how much, is
//! learned from them.
//!
//! [`published`] is the tip load of Paper A (Lehmann et al.), section III; [`baselines`] are what one would do without mechanics.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod baselines;
mod basis;
mod candidates;
mod drawn;
mod evidence;
mod fold;
mod inverse;
mod lattice;
mod layout;
mod learn;
mod learned;
mod motion;
mod path;
mod place;
mod posterior;
pub mod published;
mod quadrature;
mod rear;
mod scales;
mod search;
mod weights;

#[cfg(test)]
mod tests;

pub use candidates::{Candidate, Candidates, Tissue};
pub use drawn::PathDraw;
pub use layout::Layout;
pub use learn::{learn, learn_from, start};
pub use learned::{Learned, Start};
pub use path::{Bin, PathError, TipPath, direction_scatter_rad, row_scatter_m};
pub use posterior::{Identifiability, Moments, OnlinePosterior, Posterior};
pub use rear::Rear;
pub use scales::{ReadingNoise, Scales, variance_of_median};
