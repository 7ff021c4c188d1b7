//! Runs against indentations of the same tissue.

use serde::Serialize;

/// Comparison with indentations.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Reference {
    /// Mean modulus of the indentations, which is a Young's modulus; Paper A compares it with K.
    pub k_kpa: f64,
    /// Standard deviation over the indentations; nothing for a single one.
    pub sd_kpa: Option<f64>,
    /// 95 % interval of the mean: from the scatter over the indentations, of a single one from its own fit.
    pub ci95_kpa: Option<[f64; 2]>,
    /// Welch's test against K of the runs, as in Paper A, Table I; `None` where a sample has fewer than two values.
    pub t_test_p: Option<f64>,
    /// Welch's test against Young's modulus of the runs by the named relation: like with like.
    pub t_test_p_youngs: Option<f64>,
    /// Number of indentations.
    pub runs: usize,
    /// The runs of every depth against the indentations, as in Paper A, Table I.
    pub depths: Vec<DepthResult>,
    /// Every indentation.
    pub indentations: Vec<IndentationResult>,
}

/// The runs of one depth.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DepthResult {
    /// Insertion depth.
    pub depth_mm: f64,
    /// Number of runs.
    pub runs: usize,
    /// Mean foundation modulus of the runs (likelihood).
    pub k_kpa: f64,
    /// Its standard deviation over the runs; nothing for a single one.
    pub k_sd_kpa: Option<f64>,
    /// Welch's test of K against the indentations.
    pub t_test_p: Option<f64>,
    /// Mean Young's modulus of the runs by the relation in use.
    pub youngs_modulus_kpa: Option<f64>,
    /// Its standard deviation over the runs.
    pub youngs_modulus_sd_kpa: Option<f64>,
    /// Welch's test of Young's modulus against the indentations.
    pub t_test_p_youngs: Option<f64>,
}

/// One indentation: `F = F0 + E g(d - d0)` fitted to its loading part.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct IndentationResult {
    /// Its name.
    pub id: String,
    /// `flat` or `sphere`.
    pub indenter: &'static str,
    /// Young's modulus.
    pub youngs_modulus_kpa: f64,
    /// Its 95 % interval from the scatter about the curve; nothing for fewer than eight samples.
    pub ci95_kpa: Option<[f64; 2]>,
    /// Force before contact; `None` where the indenter was in contact from the first sample.
    pub force_offset_n: Option<f64>,
    /// Depth reading at contact.
    pub contact_mm: Option<f64>,
    /// Largest depth below contact.
    pub deepest_mm: f64,
    /// Stiffness of the deeper half over that of the shallower one, less 100 %.
    pub nonlinearity_percent: f64,
    /// Root mean square of what the curve leaves.
    pub residual_n: f64,
    /// Force over that of a half space, for the stated thickness.
    pub thickness_factor: f64,
    /// Samples used.
    pub samples: usize,
    /// Warnings about it.
    pub warnings: Vec<String>,
}
