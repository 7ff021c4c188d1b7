//! Lateral runs as data: from the series of a run to the likelihood of what they say about the tissue.
//!
//! | item | does |
//! |---|---|
//! | [`holds`] | holds and sweeps in the series of a run, their means and noise |
//! | [`LateralData`] | a lateral run as one block of a fit: shared modulus, own displacements, force zero and effects |
//! | [`outliers`] | the rule by which single values are left out |
//! | [`fit()`] | weighted least squares over parameters shared by all runs and nuisances of each run |
//! | [`draws`] | draws from posteriors, in the layout of ArviZ |
//! | [`intervals`] | profile likelihood and bootstrap of such a fit |
//! | [`sequential`] | whether readings still follow a model, asked after every one of them |
//!
//! The crates above identify, diagnose and plan with them.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod draws;
mod fit;
pub mod holds;
pub mod intervals;
mod lateral;
pub mod outliers;
pub mod sequential;

pub use fit::{Block, Fit, FitError, Parameter, Prior, bounded_step, fit};
pub use lateral::{
    ChannelFit, DisplacementHistory, Fixed, ForceZero, HoldData, LateralData, Measured, ShapeDatum, ShapeFit,
    SharedErrors, channel_fits, effect_parameters, shape_fits,
};
