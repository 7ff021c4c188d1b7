//! From measurements to parameters with uncertainty.
//!
//! [`fit`] is weighted least squares over parameters shared by all runs and nuisances of each run; [`LateralData`] is a
//! lateral run as one of its blocks. [`energy`] is the energy balance of Paper A (Lehmann et al.), for comparison.
//! [`insertion`] is the tip load and the path of a needle that advances.
//! [`modulus`] relates the foundation modulus to Young's modulus; [`indentation`] is an independent measurement of the latter.
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
pub mod diagnose;
pub mod energy;
mod fit;
pub mod holds;
pub mod identify;
pub mod indentation;
pub mod insertion;
pub mod intervals;
mod lateral;
pub mod modulus;
#[cfg(test)]
mod monte_carlo;
pub mod plan;
pub mod predict;
pub mod prior;
pub mod relation;
mod summarize;
pub mod track;

pub use fit::{Block, Fit, FitError, Parameter, Prior, fit};
pub use lateral::{
    ChannelFit, DisplacementHistory, Fixed, ForceZero, HoldData, LateralData, Measured, ShapeDatum, ShapeFit,
    channel_fits, effect_parameters, shape_fits,
};
pub use summarize::{summarize, summarize_session};
