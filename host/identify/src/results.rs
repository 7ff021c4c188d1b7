//! The result of an identification, as `guide identify --json` prints it. Additive only: fields may be added, never
//! removed or changed in meaning.

mod foundation;
mod layers;
mod other;
mod reference;
mod run;

pub use foundation::{BodyResult, FoundationResult};
pub use layers::Layers;
pub use other::OtherResult;
pub use reference::{DepthResult, INDENTATIONS_SCHEMA, IndentationResult, Indentations, Reference};
pub use run::{
    ChannelResult, Energy, EnergyAsPrinted, HoldResult, Likelihood, Methods, NoiseResult, NuisanceResult,
    RunResult, ShapeResult,
};

use mechanics::Needle;
use modulus::prior::PriorResult;
use modulus::walls::WallsResult;
use readings::draws::Draws;
use readings::holds::UnusedPart;
use serde::Serialize;

/// Name and version of this form.
pub(super) const SCHEMA: &str = "guide.identify/1";

/// Everything identified from a session.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Identification {
    /// Name and version of this form.
    pub schema: &'static str,
    /// Name of the session.
    pub session: Option<String>,
    /// Effects that were part of the model.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub effects: Vec<&'static str>,
    /// The lateral runs, in the session's order.
    pub runs: Vec<RunResult>,
    /// K of all runs together.
    pub pooled: Pooled,
    /// K and E by other models that explain what the effects were learned from; empty where the model file has none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub others: Vec<OtherResult>,
    /// Prior of K from many sessions, and K with it; `None` if it was not given. All else is without it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub prior: Option<PriorResult>,
    /// K over the needle's bending stiffness, where that is not known; K itself then refers to the reference needle.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub k_per_ei: Option<KPerEi>,
    /// K of each plane; `None` where guide 2 was displaced in one plane only.
    pub directions: Option<Directions>,
    /// Two layers; `None` where they were not requested or the runs do not determine them.
    pub layers: Option<Layers>,
    /// Springs against an elastic body.
    pub foundation: FoundationResult,
    /// Young's modulus of the tissue: from an elastic body, or by a named relation.
    pub youngs_modulus_kpa: YoungsModulus,
    /// The walls of the tissue, on which every E rests: where they are not stated its interval allows for them.
    pub walls: WallsResult,
    /// Comparison with indentation; nothing without such a measurement.
    pub reference: Option<Reference>,
    /// Rows of the recordings that are not used, with their reason.
    pub unused: Vec<UnusedPart>,
    /// Warnings about the numbers.
    pub warnings: Vec<String>,
    /// Draws from the posterior, where they were requested.
    #[serde(skip)]
    pub draws: Option<Draws>,
}

/// K of all runs together.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Pooled {
    /// Foundation modulus.
    pub k_kpa: f64,
    /// Standard deviation, model error in it.
    pub sd_kpa: f64,
    /// 95 % interval, from ln K, model error in it.
    pub ci95_kpa: [f64; 2],
    /// Intervals by noise alone; `None` if the two are the same, because model error could not be estimated.
    pub noise_alone: Option<NoiseAlone>,
    /// Statement about the rig on which the interval depends most; `None` if model error is not in it.
    pub rests_on: Option<RestsOn>,
    /// Profile likelihood; `None` where it was not requested.
    pub profile: Option<Profile>,
    /// Parametric bootstrap; `None` where it was not requested.
    pub bootstrap: Option<Bootstrap>,
    /// Estimates of the nuisance effects' parameters, shared by the runs.
    pub nuisances: Vec<NuisanceResult>,
    /// Number of runs in it.
    pub runs: usize,
    /// Whether the runs agree (Cochran's Q); nothing for one run.
    pub heterogeneity: Option<Heterogeneity>,
}

/// An assumption on which an interval rests.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RestsOn {
    /// Assumption of the method.
    pub assumption: &'static str,
    /// Share of the variance of ln K that would go if it were exactly known, 0 to 1.
    pub share_of_variance: f64,
}

/// K, and how well it would be known, if the model and what is stated of the rig were exact.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct NoiseAlone {
    /// Foundation modulus.
    pub k_kpa: f64,
    /// Standard deviation.
    pub sd_kpa: f64,
    /// 95 % interval, from ln K.
    pub ci95_kpa: [f64; 2],
}

/// Ratio that shapes and paths determine if the needle's bending stiffness is not known.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct KPerEi {
    /// Foundation modulus over bending stiffness, `K/(E I)`.
    pub k_per_ei_per_m4: f64,
    /// Its 95 % interval.
    pub ci95_per_m4: [f64; 2],
    /// The bending stiffness `E I` that moduli refer to, by convention.
    pub reference_ei_n_m2: f64,
}

impl KPerEi {
    /// Ratio for a modulus that was computed with the reference's bending stiffness; `None` if the needle's own is
    /// known.
    pub fn of(needle: &Needle, k_kpa: f64, ci95_kpa: [f64; 2]) -> Option<Self> {
        let reference_ei_n_m2 = needle.bending_stiffness_n_m2();
        (!needle.stiffness_known).then(|| Self {
            k_per_ei_per_m4: modulus_per_ei(k_kpa, reference_ei_n_m2),
            ci95_per_m4: ci95_kpa.map(|kpa| modulus_per_ei(kpa, reference_ei_n_m2)),
            reference_ei_n_m2,
        })
    }
}

fn modulus_per_ei(kpa: f64, reference_ei_n_m2: f64) -> f64 {
    1e3 * kpa / reference_ei_n_m2
}

/// Profile likelihood of K: all other unknowns fitted again at every K.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Profile {
    /// 95 % interval, where chi-square has risen by 3.84; an end that the data do not give is `null`.
    pub ci95_kpa: [Option<f64>; 2],
    /// Foundation moduli.
    pub k_kpa: Vec<f64>,
    /// Rise of chi-square at each.
    pub delta_chi_square: Vec<f64>,
}

/// Parametric bootstrap of K: data drawn from the fit and fitted again.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Bootstrap {
    /// 95 % interval.
    pub ci95_kpa: [f64; 2],
    /// Number of draws.
    pub count: usize,
    /// Seed of the draws.
    pub seed: u64,
}

/// K of the two planes by themselves.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Directions {
    /// Vertical plane.
    pub y: Likelihood,
    /// Horizontal plane.
    pub x: Likelihood,
    /// K of the horizontal plane over K of the vertical one.
    pub ratio_x_to_y: f64,
    /// 95 % interval of the ratio; 1 outside it means that the tissue is not the same both ways.
    pub ratio_ci95: [f64; 2],
}

/// Cochran's test of a shared ln K.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Heterogeneity {
    /// Sum of squared deviations of the runs over their variances.
    pub q: f64,
    /// Number of runs minus 1.
    pub degrees_of_freedom: usize,
    /// Probability of a larger Q where all runs share one K.
    pub p: f64,
}

/// Young's modulus, from an elastic body or by a named relation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct YoungsModulus {
    /// The modulus; `None` where it is refused.
    pub value: Option<f64>,
    /// Its 95 % interval: that of the body, or K's through the relation; the choice of relation is not in it.
    pub ci95: Option<[f64; 2]>,
    /// Why there is no modulus.
    pub refused: Option<String>,
    /// `body`, or the relation.
    pub relation: &'static str,
    /// Poisson's ratio in it.
    pub poisson: f64,
    /// Least and greatest value by the known relations.
    pub range_kpa: [f64; 2],
    /// The value by each known relation.
    pub relations: Vec<RelationResult>,
}

/// Young's modulus by one relation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RelationResult {
    /// Its name.
    pub relation: &'static str,
    /// The modulus.
    pub youngs_modulus_kpa: f64,
    /// Range in which the relation holds.
    pub validity: &'static str,
}
