//! Model of the tissue, and the body's modulus.

use serde::Serialize;

/// Springs against an elastic body.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FoundationResult {
    /// `springs` or `body`: what Young's modulus is from.
    pub used: &'static str,
    /// `stated`, `evidence` where both were compared, `layers` where both were compared with two layers and these are established, or
    /// `default` where they could not be: springs.
    pub by: &'static str,
    /// Logarithm of the evidence of the body less that of the springs, with the everyday discrepancy that a diagnosis allows for;
    /// nothing where they were not compared.
    pub log_evidence_gain: Option<f64>,
    /// Gain above which the body is used; `None` if they were not compared.
    pub log_evidence_margin: Option<f64>,
    /// Logarithm of the evidence of a modulus that varies with depth, as springs or as a body, less that of the better of the two with
    /// one modulus; 0 where it promises less than 5, `None` where they were not compared.
    pub log_evidence_of_varied: Option<f64>,
    /// The body; `None` where it was not fitted or has no fit.
    pub body: Option<BodyResult>,
    /// Why the body has no fit, or could not be compared with springs.
    pub body_error: Option<String>,
}

/// The needle in an elastic body, fitted to all runs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BodyResult {
    /// Young's modulus.
    pub youngs_modulus_kpa: f64,
    /// Its 95 % interval, from ln E; the uncertainty of Poisson's ratio and of the operator is in it.
    pub ci95_kpa: [f64; 2],
    /// Poisson's ratio, as stated.
    pub poisson: f64,
    /// Its standard deviation, as stated.
    pub poisson_sd: f64,
}
