//! The result of a diagnosis, as written to JSON.

use super::Multiples;
use super::data::Channel;
use super::known::Moved;
use super::posterior::Fitted;
use super::prospects::Prospects;
use formats::model_file::Alternative;
use mechanics::Support;
use modulus::walls::WallsResult;
use readings::draws::Draws;
use serde::Serialize;
use std::collections::BTreeMap;

/// Name and version of this document.
pub(super) const SCHEMA: &str = "guide.diagnose/2";

/// The outcome in one word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// The session shows no missing effect.
    Adequate,
    /// The missing effect has a name.
    Named,
    /// One of a few effects is missing; a measurement would identify it.
    Ambiguous,
    /// An effect is missing that is not in the catalogue or that the session cannot identify.
    Unexplained,
}

/// The outcome of the workflow.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Diagnosis {
    /// Draws from the posterior, where they were requested.
    #[serde(skip)]
    pub draws: Option<Draws>,
    /// Expected information of planned runs, if there are any.
    #[serde(skip)]
    pub prospects: Option<Prospects>,
    /// Name and version of this document.
    pub schema: &'static str,
    /// Name of the session.
    pub session: Option<String>,
    /// The outcome in one word.
    pub verdict: Verdict,
    /// Missing effects that were added to the model.
    pub effects: Vec<FoundEffect>,
    /// Regions in which model and measurement disagree: without effects, or, if the verdict is unexplained, under the final
    /// model.
    #[serde(rename = "where")]
    pub regions: Vec<RegionResult>,
    /// Regions in which they still disagree under the final model, beyond usual imperfections.
    pub left: Vec<RegionResult>,
    /// Measurement that would separate the members of a class.
    pub next_measurement: Option<NextMeasurement>,
    /// Misfit of held-out data, before and after effects were added.
    pub gap: Option<HeldOutMisfit>,
    /// Every effect that was scored, best first.
    pub ranking: Vec<Ranked>,
    /// The file with the final model, if it was written.
    pub model_file: Option<String>,
    /// Foundation of the tissue, springs or an elastic body, and the evidence of both.
    pub foundation: FoundationResult,
    /// The walls of the tissue, on which every E depends. If they are not stated, the interval of E includes their uncertainty.
    /// `None` if there is no E.
    pub walls: Option<WallsResult>,
    /// Reference, and the difference of the session from it; `None` if there is no reference.
    pub reference: Option<ReferenceResult>,
    /// Foundation modulus K: that of the final model on springs; for a body that of springs with the same effects.
    pub k_kpa: f64,
    /// 95 % interval of K.
    pub k_ci95_kpa: [f64; 2],
    /// Whether the runs identify the modulus, K and E alike. If they do not, its interval is that of the prior.
    pub k_status: ModulusStatus,
    /// Mean modulus, under the final model, of the tissue that was reached: K of springs or E of a body as in `foundation`;
    /// `None` if the model has none.
    pub mean_modulus: Option<MeanModulus>,
    /// Tip load under the final model, where there are insertions.
    pub tip_load_n: Option<f64>,
    /// 95 % interval of the tip load.
    pub tip_load_ci95_n: Option<[f64; 2]>,
    /// Effects of the model that the diagnosis started from.
    pub given: Vec<String>,
    /// These effects with their parameters under the final model.
    #[serde(skip)]
    pub given_effects: Vec<FoundEffect>,
    /// Other plausible models, for the model file.
    #[serde(skip)]
    pub alternatives: Vec<Alternative>,
    /// Parameters of the rig that have changed, the clearest change first. If there is any, the regions and the misfit "before"
    /// are those with the known values.
    pub moved_since: Vec<Moved>,
    /// Effects that improve the fit without explaining the misfit; they are not named.
    pub partial: Vec<String>,
    /// Remaining difference between the final model and the measurement, and whether it matters.
    pub remaining: RemainingResult,
    /// Imperfections that are larger than in an ordinary rig, as a model file has them.
    #[serde(skip)]
    pub multiples: Multiples,
    /// Smooth structure in the residuals before and after.
    pub adequacy: [AdequacyResult; 2],
    /// Standard deviation of the remaining smooth discrepancy, by channel and unit, if the verdict is unexplained.
    pub discrepancy: BTreeMap<String, f64>,
    /// Smallest log evidence of an effect that is named, if it is the only explanation.
    pub margin: f64,
    /// Division of the session.
    pub split: String,
    /// Noise of the fits to the training runs, by channel and unit: standard deviation of a reading.
    pub noise: BTreeMap<String, f64>,
    /// Effects with a probability between 5 and 95 %, too low for a name. The intervals of the modulus and of the tip load
    /// include the models with them.
    pub near_margin: Vec<String>,
    /// Effects that are not identifiable from this session.
    pub not_identifiable: Vec<String>,
    /// Limits of the session, and measurements that would remove them.
    pub limits: Vec<String>,
    /// Remarks.
    pub warnings: Vec<String>,
}

/// Whether the runs identify the modulus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ModulusStatus {
    /// They do.
    Identified,
    /// No load of known size acts on the needle, so that every modulus explains the runs with some tip load; or the
    /// best-fitting modulus is at an end of its range.
    NotIdentified,
}

/// Mean of the modulus over depth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct MeanModulus {
    /// Lower end of the averaged depths, which begin at the surface.
    pub to_depth_mm: f64,
    /// The mean.
    pub modulus_kpa: Estimate,
}

/// A session compared with its reference.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReferenceResult {
    /// Name of the reference.
    pub session: Option<String>,
    /// Modulus of the reference under the final model, of the springs or of the body as in `foundation`.
    pub modulus_kpa: Estimate,
    /// Modulus of the session over that of the reference.
    pub modulus_ratio: Estimate,
}

/// Springs or an elastic body.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FoundationResult {
    /// `springs` or `body`.
    pub used: &'static str,
    /// Log evidence of a body over springs, both without effects; `None` if one of them was not tried.
    pub log_evidence_of_body: Option<f64>,
    /// Young's modulus of the final model, if the tissue is modelled as a body.
    pub youngs_modulus_kpa: Option<Estimate>,
    /// Poisson's ratio at which it was estimated.
    pub poisson: Option<f64>,
    /// Young's modulus of a body without effects, whether it is used or not.
    pub youngs_modulus_of_plain_body_kpa: Option<Estimate>,
    /// Modulus of springs without effects.
    pub k_of_plain_springs_kpa: Estimate,
}

impl FoundationResult {
    /// Comparison if only springs were tried.
    pub(super) fn springs(body: Option<(f64, Fitted)>, plain: &Fitted) -> Self {
        Self {
            used: "springs",
            log_evidence_of_body: body.as_ref().map(|(gain, _)| *gain),
            youngs_modulus_kpa: None,
            poisson: None,
            youngs_modulus_of_plain_body_kpa: body.as_ref().map(|(_, body)| modulus_kpa(body)),
            k_of_plain_springs_kpa: modulus_kpa(plain),
        }
    }

    /// The same comparison with the moduli of fits to all runs.
    pub(super) fn fitted_again(&self, last: &Fitted, springs: &Fitted) -> Self {
        let youngs_modulus_kpa = self.youngs_modulus_kpa.map(|_| modulus_kpa(last));
        Self { youngs_modulus_kpa, k_of_plain_springs_kpa: modulus_kpa(springs), ..self.clone() }
    }

    /// Comparison of the final fit, the plain springs, and the plain body with its log evidence
    /// over them.
    pub(super) fn of(last: &Fitted, springs: &Fitted, body: Option<(f64, Fitted)>) -> Self {
        let plain = Self::springs(body, springs);
        match last.layout.support {
            Support::Springs => plain,
            Support::Body { poisson, .. } => Self {
                used: "body",
                youngs_modulus_kpa: Some(modulus_kpa(last)),
                poisson: Some(poisson),
                ..plain
            },
        }
    }
}

fn modulus_kpa(fitted: &Fitted) -> Estimate {
    let (value, ci95) = fitted.modulus_pa();
    Estimate { value: 1e-3 * value, ci95: ci95.map(|end| 1e-3 * end) }
}

/// An effect that was added to the model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FoundEffect {
    /// Its id.
    pub id: String,
    /// Its parameters by name.
    pub parameters: BTreeMap<String, Estimate>,
    /// Log evidence over the model without it.
    pub log_evidence_gain: f64,
    /// Probability that this effect or an alternative to it is missing.
    pub probability: f64,
    /// The class: the smallest set of effects with 95 % of the probability, itself among them, most probable first.
    pub class: Vec<String>,
    /// Probability of each member of the class.
    pub class_probability: Vec<f64>,
    /// Formula of a law, with its values.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub formula: Option<String>,
}

/// A parameter with its interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Its interval of 95 %.
    pub ci95: [f64; 2],
}

/// A region in which model and measurement disagree.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RegionResult {
    /// The sensor.
    pub channel: String,
    /// The coordinate.
    pub coordinate: String,
    /// Begin of the region.
    pub from: f64,
    /// End of the region.
    pub to: f64,
    /// Measured less predicted. If the sign changes with the displacement, positive is towards the displacement.
    pub mean_residual: f64,
    /// Whether it changes sign with the displacement.
    pub changes_sign_with_level: bool,
    /// Unit of the residual.
    pub unit: String,
    /// Size in standard deviations.
    pub sigma: f64,
}

/// Next measurement.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NextMeasurement {
    /// Kind of the measurement.
    pub kind: String,
    /// Text of the measurement.
    pub what: String,
    /// The effects that it separates.
    pub separates: Vec<String>,
    /// Expected divergence (chi-square) of the pair that it separates least.
    pub expected_divergence: f64,
}

/// Misfit of held-out data, before and after effects were added.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HeldOutMisfit {
    /// The runs with held-out data.
    pub heldout_runs: Vec<String>,
    /// Misfit of the model that the diagnosis started from.
    pub before: Misfit,
    /// Misfit of the final model.
    pub after: Misfit,
    /// Fraction of the misfit above noise that was removed; `None` without such a misfit.
    pub removed: Option<f64>,
    /// Its interval of 95 %.
    pub removed_ci95: Option<[f64; 2]>,
    /// All held-out residuals, for figures.
    #[serde(skip)]
    pub points: Vec<ResidualPoint>,
}

/// Residual of a reading before and after effects were added, measured less predicted, in the unit of its channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ResidualPoint {
    /// The sensor.
    pub channel: Channel,
    /// Abscissa, mm: displacement of guide 2 for a force, depth below the surface for a deflection, depth for a tip.
    pub at_mm: f64,
    /// Under the model that the diagnosis started from.
    pub before: f64,
    /// Under the final model.
    pub after: f64,
}

/// Misfit of one model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Misfit {
    /// Chi-square per datum.
    pub chi2_reduced: f64,
    /// Root mean square by channel and unit.
    pub rmse: BTreeMap<String, f64>,
}

/// Size of the remaining difference.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RemainingSize {
    /// The difference is noise.
    WithinNoise,
    /// Structure that changes K by no more than its interval.
    Small,
    /// Structure that changes K by more than its interval.
    Large,
}

/// Remaining difference between the final model and the measurement.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RemainingResult {
    /// Size of the difference.
    pub size: RemainingSize,
    /// Root mean square of the remaining smooth misfit, by channel and unit.
    pub rms: BTreeMap<String, f64>,
    /// Remaining fraction of the held-out misfit above noise; `None` without such a misfit.
    pub share_of_gap: Option<f64>,
    /// Relative change of K if the discrepancy is omitted from the fit.
    pub k_change_without_discrepancy: f64,
    /// Imperfections whose most probable size exceeds that of an ordinary rig, as a multiple of the ordinary size.
    pub above_everyday: BTreeMap<String, f64>,
}

/// An effect's rank.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Ranked {
    /// Its id.
    pub id: String,
    /// Gain of chi-square according to its score.
    pub score_chi2: f64,
    /// Log evidence over the starting model, of the fit with it or, without such a fit, according to its score.
    pub log_evidence_gain: f64,
    /// Whether a model with it was fitted.
    pub refitted: bool,
}

/// Smooth structure in the residuals of a model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AdequacyResult {
    /// Chi-square in smooth functions of the coordinates.
    pub chi_square: f64,
    /// Number of these functions.
    pub functions: usize,
    /// p-value relative to noise alone.
    pub p: f64,
    /// p-value relative to noise and the typical imperfections of rig and tissue.
    pub p_beside_everyday_discrepancy: f64,
    /// Reduced chi-square of every channel.
    pub channels: BTreeMap<String, f64>,
}
