//! Why a run or a session cannot be identified.

use diagnose::IN_AIR;
use readings::FitError;
use std::path::PathBuf;

/// Why a run cannot be identified.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RunError {
    /// The needle is in nothing.
    #[error("{IN_AIR}")]
    InAir,
    /// Guide 2 is never held still.
    #[error("{}: displacement_y_mm: no hold found in {duration_s:.1} s, expected guide 2 held still for {least_s} s or more", path.display())]
    NoHold {
        /// The force file.
        path: PathBuf,
        /// Length of the recording.
        duration_s: f64,
        /// Shortest hold.
        least_s: f64,
    },
    /// All holds have gaps.
    #[error("{}: lost_before: all {holds} holds have gaps, expected at least one complete hold", path.display())]
    AllLost {
        /// The force file.
        path: PathBuf,
        /// Number of holds.
        holds: usize,
    },
    /// Guide 2 is never displaced.
    #[error("{}: displacement_y_mm: no hold is displaced (largest {largest_mm:.3} mm), expected a lateral displacement", path.display())]
    NoDisplacement {
        /// The force file.
        path: PathBuf,
        /// Largest displacement of a hold.
        largest_mm: f64,
    },
    /// Not enough of the shape was measured.
    #[error("{}: z_mm: {found} shape points inside the tissue during displaced holds, expected at least 3", path.display())]
    TooFewPoints {
        /// The shape file.
        path: PathBuf,
        /// Number of points.
        found: usize,
    },
    /// Tissue and needle push back; here they pull.
    #[error("{}: force_y_n: {force_n:.3} N at {displacement_mm:.3} mm, expected force and displacement of the same sign", path.display())]
    ForceSign {
        /// The force file.
        path: PathBuf,
        /// Force along the displacement.
        force_n: f64,
        /// Displacement.
        displacement_mm: f64,
    },
    /// Near the surface the needle follows guide 2; here it goes the other way.
    #[error("{}: deflection_y_mm: {slope:.2} times the displacement of guide 2 near the surface, expected a needle that follows it; is the sign of the shape or of the displacement reversed?", path.display())]
    ShapeSign {
        /// The shape file.
        path: PathBuf,
        /// Deflection over displacement.
        slope: f64,
    },
    /// The modulus runs to the end of the range.
    #[error("{}: K reaches its bound of {bound_kpa} kPa, expected force and shape that a tissue explains", path.display())]
    AtBound {
        /// The force file.
        path: PathBuf,
        /// The bound.
        bound_kpa: f64,
    },
    /// There is no best modulus.
    #[error("{}: {cause}, expected force and shape that a tissue explains", path.display())]
    Fit {
        /// The force file.
        path: PathBuf,
        /// Why.
        cause: FitError,
    },
}

/// Why a session cannot be identified.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum IdentifyError {
    /// It has no lateral runs.
    #[error("{}: lateral: missing, expected at least one [[lateral]] run", path.display())]
    NoRuns {
        /// The session file.
        path: PathBuf,
    },
    /// None of its indentations gives a modulus.
    #[error("no indentation gives a modulus: {}", reasons.join("; "))]
    NoIndentation {
        /// Reason for each run.
        reasons: Vec<String>,
    },
    /// None of its runs can be identified.
    #[error("no run can be identified: {}", suspicions.iter().cloned().chain(reasons.iter().map(|(id, why)| format!("{id}: {why}"))).collect::<Vec<_>>().join("; "))]
    AllFailed {
        /// Suspected errors of units and signs, before anything is fitted.
        suspicions: Vec<String>,
        /// Id and reason of each run.
        reasons: Vec<(String, RunError)>,
    },
}
