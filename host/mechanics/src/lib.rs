//! The forward model: the expected reading of every sensor, for a model and an experiment.
//!
//! [`predict`] is the only entry point: identification, simulation and diagnosis all call it. It is pure: no clock, no
//! randomness, no input or output. Underneath, [`BeamProblem`] is the needle as a beam in the tissue, which is a row of springs or
//! an elastic body ([`Support`]), and [`Beam`] its solution per unit load; the model is linear, so displacement levels are multiples
//! of one [`Beam`].
//!
//! # Example
//!
//! Force that holds guide 2 when it is moved by 1.2 mm, with the needle 30 mm deep in tissue of 12 kPa:
//!
//! ```
//! use mechanics::{Beam, Foundation, Needle, Rig};
//!
//! let rig = Rig::two_guides(Needle::gauge_18(), 0.060, 0.070);
//! let beam = Beam::solve(&rig, &Foundation::uniform(12e3)?, 0.030)?;
//! let per_newton = beam.guide2_force();
//! let force_n = 1.2e-3 / per_newton.deflection_m(rig.guide2_m);
//! assert!((0.5..2.5).contains(&force_n), "{force_n} N");
//! // The needle turns in its guides: the tip moves further than guide 2.
//! let tip_m = force_n * per_newton.deflection_m(0.100);
//! assert!(tip_m > 1.2e-3, "{tip_m} m");
//! # Ok::<(), mechanics::ModelError>(())
//! ```
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod banded;
mod beam;
mod block;
pub mod body;
mod cache;
mod carried;
pub mod continuum;
mod course;
mod departure;
pub mod effects;
pub mod elements;
mod foundation;
pub mod growth;
pub mod inner;
pub mod insertion;
mod lateral;
pub mod modes;
mod predict;
mod prepared;
mod prestress;
mod problem;
mod profile;
pub mod quadrature;
mod rig;
mod series;
pub mod steering;
mod support;
pub mod terms;
pub mod unknowns;
mod varied;
mod yielding;

pub use beam::{Beam, Response};
pub use block::{Block, Mounting};
pub use cache::Cache;
pub use foundation::{Foundation, Layer};
pub use insertion::{BevelLoad, Cutting, Insertion, TipLaw};
pub use lateral::Drive;
pub use predict::{
    Channels, DriveSample, Experiment, ForceSample, Lateral, LateralForce, Model, Plane, Series, ShapeImage,
    ShapePoint, predict, predict_with,
};
pub use prepared::{ObservationPlan, PreparedNeedle};
pub use problem::{BeamProblem, Give, TissueLaw};
pub use profile::Profile;
pub use rig::{Guides, Needle, Rig, Tolerances};
pub use steering::{BaseDrive, Dynamics, Steering};
pub use support::Support;

/// Why the model could not be evaluated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ModelError {
    /// A parameter lies outside what the model is defined for.
    #[error("{name}: {value} is out of range, expected {expected}")]
    OutOfRange {
        /// Name with unit.
        name: &'static str,
        /// Offending value.
        value: f64,
        /// Accepted values.
        expected: &'static str,
    },
    /// An experiment without a drive sample has no position of guide 2.
    #[error("a lateral experiment needs at least one drive sample")]
    NoDrive,
    /// A steering run needs masses, damping and the needle's length.
    #[error("the model has no dynamics: a steering run cannot be predicted")]
    NoDynamics,
    /// Newton's method does not come to an end.
    #[error("the equilibrium of the needle is not found")]
    NotConverged,
    /// Property that the model of an elastic body around the needle lacks.
    #[error("{what} is not available on an elastic body, expected tissue made of springs")]
    NotOnBody {
        /// Name of the effect or of the experiment.
        what: &'static str,
    },
    /// The equations have no unique solution in floating point.
    #[error("the beam equations are singular in floating point")]
    Singular,
}

/// Accepts a value for which `good` holds; NaN never passes.
///
/// # Errors
/// [`ModelError::OutOfRange`] where it does not.
pub fn check(name: &'static str, value: f64, expected: &'static str, good: bool) -> Result<(), ModelError> {
    if good && value.is_finite() { Ok(()) } else { Err(ModelError::OutOfRange { name, value, expected }) }
}
