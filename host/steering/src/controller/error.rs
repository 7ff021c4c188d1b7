//! Errors of a steering run.

use crate::plant::PlantError;
use mechanics::ModelError;

/// Why a run could not be carried out.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SteerError {
    /// The plant.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// The model.
    #[error("the needle of the plant cannot be computed: {0}")]
    Model(#[from] ModelError),
    /// The target.
    #[error("target {name} is {value} mm, expected {expected}")]
    Target {
        /// Coordinate.
        name: &'static str,
        /// Its value.
        value: f64,
        /// Valid content.
        expected: String,
    },
    /// Readings of the tip far from where the model has it.
    #[error(
        "{count} consecutive tip readings lie outside the band that the model predicts at {depth_mm:.1} mm"
    )]
    TipOutsideBand {
        /// Number of them.
        count: usize,
        /// Depth.
        depth_mm: f64,
    },
    /// The same reading again and again.
    #[error(
        "the last {count} tip readings are the same to the digit: the tracker repeats its last value; is its view blocked?"
    )]
    TipFrozen {
        /// Number of them.
        count: usize,
    },
    /// Readings that were taken long before they arrive.
    #[error(
        "{count} consecutive tip readings are too old (the last {age_s:.1} s, where the plant states {stated_s:.1} s): the tracker or the \
         connection to it lags"
    )]
    TipLate {
        /// Number of them.
        count: usize,
        /// Age of the last, s.
        age_s: f64,
        /// Stated delay, s.
        stated_s: f64,
    },
    /// The needle does not follow.
    #[error(
        "the needle is {reported_mm:.1} mm deep, expected {commanded_mm:.1} mm: was it released, or is it stuck?"
    )]
    NeedleOffDepth {
        /// Commanded, mm.
        commanded_mm: f64,
        /// Reported, mm.
        reported_mm: f64,
    },
    /// Rotations of a needle that cannot be turned.
    #[error(
        "the plant states that its needle cannot be turned (`can_rotate` is false), expected true where rotations are planned"
    )]
    CannotRotate,
    /// No reading of the tip.
    #[error(
        "no new valid tip reading for {silence_s:.1} s while the needle was pushed and {waited_s:.1} s at rest"
    )]
    TipSilent {
        /// While pushed.
        silence_s: f64,
        /// At rest.
        waited_s: f64,
    },
}

impl SteerError {
    /// Name of the fault in results.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Plant(error) => error.name(),
            Self::Model(_) => "model",
            Self::Target { .. } => "target",
            Self::TipOutsideBand { .. } => "tip_outside_band",
            Self::TipFrozen { .. } => "tip_frozen",
            Self::TipLate { .. } => "tip_late",
            Self::NeedleOffDepth { .. } => "needle_off_depth",
            Self::CannotRotate => "cannot_rotate",
            Self::TipSilent { .. } => "tip_silent",
        }
    }
}
