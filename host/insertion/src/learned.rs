//! Information of earlier insertions about the next: possible candidates and sizes with their weights, and the normal
//! distribution of the unknowns under each.

use super::basis::Basis;
use super::candidates::Candidate;
use super::scales::Scales;
use nalgebra::{DMatrix, DVector};
use std::sync::Arc;

/// Information of earlier insertions about the next.
#[derive(Debug, Clone)]
pub struct Learned {
    /// Possible sizes of the unknowns.
    pub scales: Vec<Scales>,
    /// Possible combinations of candidate and sizes.
    pub(super) parts: Vec<Part>,
    /// The candidates of the parts, with the responses of the next insertion.
    pub(super) nodes: Vec<Node>,
}

impl Learned {
    /// Number of combinations, and of different candidates among them: what a prediction costs.
    pub fn counts(&self) -> [usize; 2] {
        [self.parts.len(), self.nodes.len()]
    }
}

/// A candidate with the responses of the next insertion.
#[derive(Debug, Clone)]
pub(super) struct Node {
    pub candidate: Candidate,
    pub gap_m: f64,
    pub basis: Arc<Basis>,
}

/// One candidate with one set of sizes, and what then is known of the next insertion.
#[derive(Debug, Clone)]
pub(super) struct Part {
    /// Number among the nodes.
    pub node: usize,
    /// Number among the scales.
    pub scales: usize,
    /// Logarithm of its weight, up to a constant.
    pub ln_weight: f64,
    /// Per vector of unknowns of an insertion.
    pub normals: Vec<Normal>,
}

/// Start of the search for a posterior, found once for all folds of a session.
#[derive(Debug, Clone)]
pub struct Start {
    pub(super) candidates: Vec<Candidate>,
    pub(super) likeliest: Vec<f64>,
}

/// A normal distribution of one vector of unknowns.
#[derive(Debug, Clone)]
pub(super) struct Normal {
    pub mean: DVector<f64>,
    pub covariance: DMatrix<f64>,
}

impl Normal {
    /// Takes in one measured combination of the unknowns; returns its log likelihood.
    pub fn update(&mut self, row: &DVector<f64>, measured: f64, variance: f64) -> f64 {
        let spread = &self.covariance * row;
        let total = row.dot(&spread) + variance;
        let error = measured - row.dot(&self.mean);
        self.mean.axpy(error / total, &spread, 1.0);
        self.covariance.ger(-1.0 / total, &spread, &spread, 1.0);
        -0.5 * (error * error / total + total.ln())
    }
}
