//! Runs against indentations of the same tissue.

use serde::Serialize;

/// Comparison with indentations.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Reference {
    /// Mean modulus of the indentations, which is a Young's modulus; Paper A compares it with K.
    pub k_kpa: f64,
    /// Standard deviation over the indentations; nothing for a single one.
    pub sd_kpa: Option<f64>,
    /// 95 % interval of the mean: from the scatter over the indentations beside what each leaves open; of a single one that of its own fit.
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

/// Document of [`Indentations`].
pub const INDENTATIONS_SCHEMA: &str = "guide.indentations/1";

/// Young's modulus of tissue that was indented, in a session without lateral runs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Indentations {
    /// The document's name and version.
    pub schema: &'static str,
    /// Name of the session.
    pub session: Option<String>,
    /// Mean Young's modulus.
    pub youngs_modulus_kpa: f64,
    /// Standard deviation over the indentations; nothing for a single one.
    pub sd_kpa: Option<f64>,
    /// 95 % interval of the mean: from the scatter over the indentations beside what each leaves open; of a single one that of its own fit.
    pub ci95_kpa: Option<[f64; 2]>,
    /// Every indentation.
    pub indentations: Vec<IndentationResult>,
    /// Skipped parts, and measurements that are needed.
    pub warnings: Vec<String>,
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
    /// `flat`, `sphere` or `cone`.
    pub indenter: &'static str,
    /// Young's modulus.
    pub youngs_modulus_kpa: f64,
    /// Its 95 % interval with contact point, offset and drift of the force integrated out; nothing for fewer than eight samples.
    pub ci95_kpa: Option<[f64; 2]>,
    /// Force before contact; `None` where the indenter was in contact from the first sample.
    pub force_offset_n: Option<f64>,
    /// Depth reading at contact.
    pub contact_mm: Option<f64>,
    /// Its 95 % interval.
    pub contact_ci95_mm: Option<[f64; 2]>,
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
