//! Where a model and measurements disagree, which law is missing, and by how much it reduces the misfit: for any forward model.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod evidence;
pub mod weights;
