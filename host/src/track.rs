//! Tracking: stiffness and damping of the tissue online, from steering runs.
pub mod kalman;
pub mod method;
pub mod published;
pub mod sound;
pub mod study;

use crate::model::ModelError;

/// Why a steering run cannot be tracked.
#[derive(Debug, thiserror::Error)]
pub enum TrackError {
    /// The forward model refuses it.
    #[error("the needle cannot be modelled: {0}")]
    Model(#[from] ModelError),
    /// The estimator's sizes do not fit each other.
    #[error("the estimator's layout does not fit its number of parameters")]
    Layout,
}

#[cfg(test)]
mod tests;
