//! The result of an identification, as `guide identify --json` prints it. Additive only: fields may be added, never
//! removed or changed in meaning.

use super::{FoundationResult, Layers, ResidualResult};
use crate::inference::{ChannelFit, ShapeFit};
use crate::levels::Unused;
use crate::model::Needle;
use crate::session::LateralRun;
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
    /// K over the needle's bending stiffness, where that is not known; K itself then refers to the reference needle.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub k_per_ei: Option<KPerEi>,
    /// K of each plane; nothing where guide 2 was displaced in one plane only.
    pub directions: Option<Directions>,
    /// Two layers; nothing where they were not asked for or the runs do not determine them.
    pub layers: Option<Layers>,
    /// Springs against an elastic body.
    pub foundation: FoundationResult,
    /// Young's modulus of the tissue: from an elastic body, or by a named relation.
    pub youngs_modulus_kpa: YoungsModulus,
    /// Comparison with indentation; nothing without such a measurement.
    pub reference: Option<Reference>,
    /// What of the recordings is not used, with its reason.
    pub unused: Vec<Unused>,
    /// What to know before trusting the numbers.
    pub warnings: Vec<String>,
}

/// One lateral run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunResult {
    /// Its name.
    pub id: String,
    /// Insertion depth.
    pub depth_mm: f64,
    /// Every method's result.
    pub methods: Methods,
    /// Holds found.
    pub holds: Vec<HoldResult>,
    /// Standard deviations used.
    pub noise: Option<NoiseResult>,
    /// How well the likelihood's model meets each channel.
    pub fit: Vec<ChannelResult>,
    /// The shape as measured and as fitted, hold by hold.
    pub shape: Vec<ShapeResult>,
    /// What the fit leaves of every reading, for figures.
    #[serde(skip)]
    pub residuals: Vec<ResidualResult>,
    /// What was found of the nuisance effects' parameters.
    pub nuisances: Vec<NuisanceResult>,
    /// Sum of squared residuals of the likelihood.
    pub chi_square: Option<f64>,
    /// Number of values minus number of unknowns.
    pub degrees_of_freedom: Option<usize>,
    /// What to know before trusting the numbers.
    pub warnings: Vec<String>,
    /// Why there are no numbers.
    pub error: Option<String>,
    /// Why the run is not in what is pooled, though it has numbers of its own.
    pub left_out: Option<String>,
}

impl RunResult {
    /// A run without numbers.
    pub(super) fn failed(run: &LateralRun, why: String) -> Self {
        Self {
            id: run.id.clone(),
            depth_mm: 1e3 * run.depth_m,
            methods: Methods::default(),
            holds: Vec::new(),
            noise: None,
            fit: Vec::new(),
            shape: Vec::new(),
            residuals: Vec::new(),
            nuisances: Vec::new(),
            chi_square: None,
            degrees_of_freedom: None,
            warnings: Vec::new(),
            error: Some(why),
            left_out: None,
        }
    }
}

/// The methods side by side.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Methods {
    /// Energy balance as printed in Paper A (work `2 F u`): for comparison with published numbers only.
    pub energy_as_printed: EnergyAsPrinted,
    /// Energy balance with the right work `F u`; biased by its shape polynomials.
    pub energy: Energy,
    /// Likelihood of the exact beam: the recommended one.
    pub likelihood: Likelihood,
    /// The same from displacement and shape alone: for a rig without a force sensor, or one that is not trusted.
    pub likelihood_without_force: Likelihood,
}

/// Energy balance as printed.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct EnergyAsPrinted {
    /// Foundation modulus.
    pub k_kpa: Option<f64>,
}

/// Energy balance, corrected.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Energy {
    /// Foundation modulus.
    pub k_kpa: Option<f64>,
    /// Standard deviation from noise alone, without the bias.
    pub sd_kpa: Option<f64>,
    /// 95 % interval from noise alone: it says how far a repeat would scatter, not how far the method is off.
    pub ci95_kpa: Option<[f64; 2]>,
}

/// Likelihood of the exact beam.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Likelihood {
    /// Foundation modulus.
    pub k_kpa: Option<f64>,
    /// Standard deviation.
    pub sd_kpa: Option<f64>,
    /// 95 % interval, from ln K.
    pub ci95_kpa: Option<[f64; 2]>,
}

/// The shape of one hold in one plane; lists of equal length.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct ShapeResult {
    /// Number of the hold among those used, from 0.
    pub hold: usize,
    /// `y` or `x`.
    pub plane: &'static str,
    /// Position along the needle.
    pub z_mm: Vec<f64>,
    /// Deflection as measured.
    pub measured_mm: Vec<f64>,
    /// Deflection of the fitted beam.
    pub fitted_mm: Vec<f64>,
}

impl ShapeResult {
    /// Gathers the points of a fit.
    pub(super) fn gather(points: &[ShapeFit]) -> Vec<Self> {
        let mut results: Vec<Self> = Vec::new();
        for point in points {
            let plane = if point.plane == 0 { "y" } else { "x" };
            if results.last().is_none_or(|last| (last.hold, last.plane) != (point.level, plane)) {
                results.push(Self { hold: point.level, plane, ..Self::default() });
            }
            if let Some(last) = results.last_mut() {
                last.z_mm.push(1e3 * point.z_m);
                last.measured_mm.push(1e3 * point.measured_m);
                last.fitted_mm.push(1e3 * point.fitted_m);
            }
        }
        results
    }
}

/// A parameter of an effect that was taken as unknown.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NuisanceResult {
    /// Id of the effect.
    pub effect: &'static str,
    /// Name of the parameter, with unit.
    pub parameter: &'static str,
    /// Its value, prior and data together.
    pub value: f64,
    /// Standard deviation.
    pub sd: f64,
    /// Standard deviation of the prior: where `sd` is not smaller the data say nothing of it.
    pub prior_sd: f64,
}

/// A hold of guide 2.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HoldResult {
    /// First time.
    pub from_s: f64,
    /// Last time.
    pub to_s: f64,
    /// `zero`, `loading` or `unloading`.
    pub path: &'static str,
    /// Mean vertical displacement.
    pub displacement_y_mm: f64,
    /// Mean vertical force.
    pub force_y_n: f64,
    /// Mean horizontal displacement.
    pub displacement_x_mm: Option<f64>,
    /// Mean horizontal force.
    pub force_x_n: Option<f64>,
    /// Standard error of the vertical force.
    pub force_y_se_n: Option<f64>,
    /// Number of samples.
    pub samples: usize,
    /// Shape points seen.
    pub shape_points: usize,
    /// Whether the hold was used; a hold with lost samples is not.
    pub used: bool,
}

/// Standard deviations of single readings, and where they come from: `stated` in the session or `estimated` from the
/// scatter within holds (force, displacement) and from the fit's residuals (shape).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NoiseResult {
    /// Force.
    pub force_n: f64,
    /// Where it comes from.
    pub force_source: &'static str,
    /// Displacement.
    pub displacement_mm: f64,
    /// Where it comes from.
    pub displacement_source: &'static str,
    /// Shape.
    pub shape_mm: f64,
    /// Where it comes from.
    pub shape_source: &'static str,
}

/// How well one channel is met.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ChannelResult {
    /// `displacement`, `force` or `shape`.
    pub channel: &'static str,
    /// Sum of squared residuals.
    pub chi_square: f64,
    /// Number of values.
    pub count: usize,
}

impl From<(&'static str, ChannelFit)> for ChannelResult {
    fn from((channel, fit): (&'static str, ChannelFit)) -> Self {
        Self { channel, chi_square: fit.chi_square, count: fit.count }
    }
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
    /// What they are by noise alone; nothing where the two are the same, because model error could not be estimated.
    pub noise_alone: Option<NoiseAlone>,
    /// Profile likelihood; nothing where it was not asked for.
    pub profile: Option<Profile>,
    /// Parametric bootstrap; nothing where it was not asked for.
    pub bootstrap: Option<Bootstrap>,
    /// What was found of the nuisance effects' parameters, shared by the runs.
    pub nuisances: Vec<NuisanceResult>,
    /// Number of runs in it.
    pub runs: usize,
    /// Whether the runs agree (Cochran's Q); nothing for one run.
    pub heterogeneity: Option<Heterogeneity>,
}

/// How well K would be known if the model were exact.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct NoiseAlone {
    /// Standard deviation.
    pub sd_kpa: f64,
    /// 95 % interval, from ln K.
    pub ci95_kpa: [f64; 2],
}

/// What shapes and paths determine of a tissue where the needle's bending stiffness is not known.
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
    /// Of a modulus that was computed with the reference's bending stiffness; nothing where the needle's own is known.
    pub(crate) fn of(needle: &Needle, k_kpa: f64, ci95_kpa: [f64; 2]) -> Option<Self> {
        let reference_ei_n_m2 = needle.bending_stiffness_n_m2();
        let per_m4 = |kpa: f64| 1e3 * kpa / reference_ei_n_m2;
        (!needle.stiffness_known).then(|| Self {
            k_per_ei_per_m4: per_m4(k_kpa),
            ci95_per_m4: ci95_kpa.map(per_m4),
            reference_ei_n_m2,
        })
    }
}

/// Profile likelihood of K: all other unknowns fitted anew at every K.
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
    /// The modulus; nothing where it is refused.
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
    /// What the relation holds for.
    pub validity: &'static str,
}

/// Comparison with indentations.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Reference {
    /// Mean modulus of the indentations, which is a Young's modulus; Paper A compares it with K.
    pub k_kpa: f64,
    /// Standard deviation over the indentations; nothing for a single one.
    pub sd_kpa: Option<f64>,
    /// 95 % interval of the mean: from the scatter over the indentations, of a single one from its own fit.
    pub ci95_kpa: Option<[f64; 2]>,
    /// Welch's test against K of the runs, as in Paper A, Table I; nothing where a sample has fewer than two values.
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
    /// Force before contact; nothing where the indenter was in contact from the first sample.
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
    /// What to know before trusting it.
    pub warnings: Vec<String>,
}
