//! Results of a population, as they go into JSON.

use crate::agreement::Agreement;
use crate::summary::Interval;
use serde::Serialize;
use std::collections::BTreeMap;

/// Name and version of this form.
pub const POPULATION_SCHEMA: &str = "guide.population/2";

/// The result over all sessions.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Population {
    /// Name and version of this form.
    pub schema: &'static str,
    /// Sessions that were given, that have a modulus, and that count in it.
    pub sessions: Counts,
    /// Labels that the groups are formed by.
    pub by: Vec<String>,
    /// Covariates of the mean.
    pub covariates: Vec<String>,
    /// K of each group.
    pub groups: Vec<GroupResult>,
    /// Effects that groups of sessions share, and drift.
    pub shared_effects: Vec<SharedEffect>,
    /// Distribution of effects over sessions, beside the shared ones; those that are absent are not
    /// listed.
    pub spread: Vec<EffectSpread>,
    /// Number of tests that the probabilities are adjusted for.
    pub tests: usize,
    /// Sessions that do not count, failed or unexplained, and those that count less, far from the others.
    pub listed: Vec<ListedSession>,
    /// Rigs, needles and sites that measured the same subjects.
    pub agreement: Vec<Agreement>,
    /// Tip load by needle and tissue.
    pub tip_load: Vec<TipLoadResult>,
    /// Median of the discrepancy's sizes as multiples of those of an ordinary rig.
    pub discrepancy: BTreeMap<String, f64>,
    /// Every session that has a modulus.
    pub rows: Vec<SessionRow>,
    /// Remarks.
    pub warnings: Vec<String>,
}

/// Numbers of sessions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Counts {
    /// Records.
    pub given: usize,
    /// With a modulus.
    pub with_modulus: usize,
    /// Number of sessions that count in means and spreads.
    pub used: usize,
}

/// K of one group of sessions.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GroupResult {
    /// Values of the labels, joined.
    pub group: String,
    /// Sessions that count.
    pub sessions: usize,
    /// Subjects among them.
    pub subjects: usize,
    /// Geometric mean of K at the mean of the covariates.
    pub k_kpa: Interval,
    /// Logarithm of that and its standard error: the half width of the interval over the quantile of Student's t.
    pub ln_k: [f64; 2],
    /// Degrees of freedom of the mean, those of the level that counts.
    pub degrees_of_freedom: f64,
    /// Standard deviation of ln K between sessions of all levels together: 0.1 is about 10 % of K.
    pub tau: f64,
    /// Its 95 % interval.
    pub tau_ci95: Option<[f64; 2]>,
    /// By Paule and Mandel, nesting ignored.
    pub tau_paule_mandel: f64,
    /// Every level from the outermost; last that of the sessions.
    pub levels: Vec<LevelResult>,
    /// Interval of a new subject's K: of a new group of the innermost level, or of a new session where there are no levels.
    pub new_subject95_kpa: Option<[f64; 2]>,
    /// Interval of K in a session of a new subject.
    pub new_session95_kpa: Option<[f64; 2]>,
    /// Degrees of freedom of that.
    pub new_session_degrees_of_freedom: Option<f64>,
    /// Share of the variance of ln K that is between sessions, percent.
    pub i_squared_percent: f64,
    /// Cochran's Q, nesting ignored.
    pub q: f64,
    /// Its degrees of freedom.
    pub q_degrees_of_freedom: usize,
    /// Its p.
    pub q_p: f64,
    /// Standard deviation of ln K that stated errors have in common, where sessions scatter less than these.
    pub common_sd: Option<f64>,
    /// Slopes of ln K by covariate.
    pub slopes: BTreeMap<String, Interval>,
    /// The same with the listed sessions that have a modulus: mean and tau.
    pub with_listed: Option<WithListed>,
    /// Draws, if they are requested: draws of `ln_k_kpa` and of the standard deviation of ln K of every level,
    /// `tau_subject`, `tau_session`, ...
    #[serde(skip_serializing_if = "Option::is_none")]
    pub draws: Option<BTreeMap<String, Vec<f64>>>,
}

/// The spread of one level of a group of sessions.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LevelResult {
    /// Its label; `session` is the last.
    pub level: String,
    /// Its groups; of the last level sessions.
    pub groups: usize,
    /// Standard deviation of ln K; `None` where the level cannot be told from the one within it.
    pub tau: Option<f64>,
    /// Its 95 % interval.
    pub tau_ci95: Option<[f64; 2]>,
    /// Its degrees of freedom.
    pub degrees_of_freedom: usize,
    /// Intraclass correlation of two sessions of a group of this level, as measured; not of sessions.
    pub icc: Option<f64>,
    /// Its 95 % interval.
    pub icc_ci95: Option<[f64; 2]>,
}

/// A group with the sessions that do not count.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct WithListed {
    /// Sessions.
    pub sessions: usize,
    /// Geometric mean of K.
    pub k_kpa: Interval,
    /// Standard deviation of ln K between sessions.
    pub tau: f64,
}

/// Way in which sessions of a group share an effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SharedKind {
    /// The same in all of them.
    Shared,
    /// From a date on.
    Step,
    /// Growing linearly with time, from the first date on.
    Trend,
}

/// An effect that a group shares.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SharedEffect {
    /// Its id.
    pub effect: String,
    /// Place or time at which it acts, where it has one.
    pub at: Option<(String, f64)>,
    /// The label: `rig`, `needle`, `tissue`, `day` or `all`.
    pub label: String,
    /// Its value.
    pub group: String,
    /// Way in which the sessions share it.
    pub kind: SharedKind,
    /// Sessions that have it.
    pub sessions: usize,
    /// Its parameters; of a trend their values on the last date.
    pub parameters: Vec<SharedParameter>,
    /// Log evidence over the model without it.
    pub log_evidence: f64,
    /// Probability by chance times the number of tests.
    pub p_adjusted: f64,
    /// First date with it.
    pub began: Option<String>,
    /// The dates between which it began with 95 % probability: the first is that of the last session before.
    pub began_ci95: Option<[String; 2]>,
    /// The check on sessions that took no part.
    pub held_out: HeldOut,
    /// Effects and groups that explain it about as well.
    pub class: Vec<Competing>,
}

/// One parameter of a shared effect.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SharedParameter {
    /// Its name, with the unit.
    pub name: String,
    /// Its value.
    #[serde(flatten)]
    pub estimate: Interval,
}

/// The value from one half of the sessions in the other half, both ways.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct HeldOut {
    /// Sessions of both halves.
    pub sessions: usize,
    /// Change of chi-square of the held-out half; negative is a smaller misfit.
    pub misfit_change_chi2: f64,
}

/// An effect in a group that explains the sessions about as well.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Competing {
    /// Its id.
    pub effect: String,
    /// The label.
    pub label: String,
    /// Its value.
    pub group: String,
    /// Way in which the sessions share it.
    pub kind: SharedKind,
    /// Log evidence.
    pub log_evidence: f64,
}

/// Distribution of an effect over all sessions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SpreadKind {
    /// In none.
    Absent,
    /// The same in all.
    Shared,
    /// Around a common mean.
    Varying,
    /// In single sessions.
    Single,
}

/// The spread of an effect over all sessions.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EffectSpread {
    /// Its id.
    pub effect: String,
    /// Place or time at which it acts, where it has one.
    pub at: Option<(String, f64)>,
    /// Distribution of the effect.
    pub kind: SpreadKind,
    /// Sessions in which it is identifiable.
    pub sessions: usize,
    /// Sessions that name it by themselves.
    pub named_by_sessions: usize,
    /// Log evidence of the same effect in all sessions over none.
    pub log_evidence_shared: f64,
    /// Log evidence of an effect that varies.
    pub log_evidence_varying: f64,
    /// Log evidence of an effect in single sessions.
    pub log_evidence_single: f64,
    /// Probability that estimates of the same value differ as much.
    pub heterogeneity_p: f64,
}

/// A session that does not count, or counts less.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ListedSession {
    /// Its folder.
    pub session: String,
    /// Why.
    pub reason: String,
    /// Its weight beside one that is not listed.
    pub weight: f64,
}

/// Tip load of a group.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TipLoadResult {
    /// Needle, where it is stated.
    pub needle: Option<String>,
    /// Tissue, where it is stated.
    pub tissue: Option<String>,
    /// Sessions.
    pub sessions: usize,
    /// Mean.
    pub load_n: Interval,
    /// Standard deviation between sessions; `None` where there is one session alone.
    pub between_n: Option<f64>,
}

/// One session in the population.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SessionRow {
    /// Its folder.
    pub session: String,
    /// Its group.
    pub group: String,
    /// Its rig.
    pub rig: Option<String>,
    /// Its date.
    pub date: Option<String>,
    /// K, shared effects corrected.
    pub k_kpa: Interval,
    /// K as it is in the record.
    pub k_recorded_kpa: f64,
    /// Estimate of its true K from itself and its group; `None` where the session does not count.
    pub k_shrunk_kpa: Option<Interval>,
    /// Distance from what all other sessions predict, in standard deviations of that.
    pub residual: Option<f64>,
    /// Its degrees of freedom; `None` where it is standard normal.
    pub residual_degrees_of_freedom: Option<f64>,
    /// Probability of a larger distance in at least one of the sessions of the group.
    pub p_adjusted: Option<f64>,
    /// Its weight beside a session that is not listed.
    pub weight: f64,
    /// Whether it counts.
    pub used: bool,
}
