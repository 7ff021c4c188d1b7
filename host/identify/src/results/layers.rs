//! Two layers, identified.

use super::Likelihood;
use serde::Serialize;

/// Tissue of two layers.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Layers {
    /// `springs`, whose moduli are K, or `body`, whose moduli are E.
    pub foundation: &'static str,
    /// Modulus above the boundary.
    pub upper: Likelihood,
    /// Modulus below it.
    pub lower: Likelihood,
    /// Modulus below the boundary over modulus above it.
    pub k_ratio: f64,
    /// Its 95 % interval.
    pub k_ratio_ci95: [f64; 2],
    /// Depth of the boundary below the surface.
    pub boundary_mm: f64,
    /// Its standard deviation.
    pub boundary_sd_mm: f64,
    /// Its 95 % interval.
    pub boundary_ci95_mm: [f64; 2],
    /// Fall of chi-square against one modulus for all, for two unknowns more: below about 14 (p = 0.001) a second layer
    /// is not established.
    pub chi_square_gain: f64,
    /// Logarithm of the evidence of two layers less that of one, beside the discrepancy of a diagnosis, which is in all intervals too;
    /// nothing where intervals are those of noise alone.
    pub log_evidence_gain: Option<f64>,
    /// Logarithm of the evidence of a body of two layers less that of springs of two layers; `None` where they were not compared.
    pub body_log_evidence_gain: Option<f64>,
    /// Logarithm of the evidence of two layers less that of the better of springs and body with one modulus; `None` where it was not
    /// computed.
    pub log_evidence_over_single: Option<f64>,
    /// Whether two layers explain the runs better than any single modulus, by at least 5 nats; then no single Young's modulus is reported.
    pub established: bool,
}
