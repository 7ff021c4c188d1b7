//! From measurements to parameters with uncertainty.
//!
//! | item | does |
//! |---|---|
//! | [`identify`] | modulus from the lateral runs of a session; [`energy`]: the published energy balance, for comparison |
//! | [`predict`], [`insertion`] | tip load and path of a needle that advances, for a session and reading by reading |
//! | [`track`] | stiffness and damping over steering runs |
//! | [`diagnose`] | where model and measurement disagree, and which effect is missing |
//! | [`investigate`] | the most informative run about the missing effect, one run after the other |
//! | [`follow`] | since when readings no longer follow a model, said while they come |
//! | [`plan`] | the interval that a lateral run will give |
//! | [`check`] | what each command can do with a session |
//! | [`fit()`], [`LateralData`] | weighted least squares over parameters shared by all runs and nuisances of each run; a lateral run as one of its blocks |
//! | [`draws`], [`sequential`] | draws from posteriors, in the layout of ArviZ; a sequential test, after every reading, of whether readings still follow a model |
//! | [`holds`], [`intervals`] | holds and sweeps in the series of a run; profile likelihood and bootstrap |
//! | [`modulus`], [`relation`], [`indentation`] | from the foundation modulus to Young's modulus; an independent measurement of the latter |
//! | [`prior`], [`summarize()`] | K from many sessions as a prior; the record of a session for `population` |
//!
//! # Example
//!
//! The modulus of simulated tissue, from one lateral run:
//!
//! ```
//! use inference::identify::{Options, identify};
//! # let truth = worlds::Truth { k_kpa: 12.0, tip_load_n: 0.2, effects: Vec::new(), foreign: None };
//! # let session = worlds::session(&truth, &worlds::Design::four_runs(), 3);
//! let found = identify(&session, &Options::default())?;
//! let [low, high] = found.pooled.ci95_kpa;
//! assert!((low..=high).contains(&12.0), "K {} ({low} to {high}) kPa", found.pooled.k_kpa);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod check;
pub mod follow;
pub mod investigate;
pub mod plan;
pub mod predict;
mod summarize;

pub use diagnose::{self, models::OtherModel};
pub use identify;
pub use insertion;
pub use modulus::{self, energy, indentation, prior, relation, walls};
pub use readings::{
    Block, ChannelFit, DisplacementHistory, Fit, FitError, Fixed, ForceZero, HoldData, LateralData, Measured,
    Parameter, Prior, ShapeDatum, ShapeFit, SharedErrors, channel_fits, draws, effect_parameters, fit, holds,
    intervals, sequential, shape_fits,
};
pub use summarize::{summarize, summarize_session};
pub use track;
