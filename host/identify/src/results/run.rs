//! Result of one run: methods, holds, noise, fit.

use crate::ResidualResult;
use formats::session::LateralRun;
use readings::{ChannelFit, ShapeFit};
use serde::Serialize;

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
    /// Fit of each channel by the likelihood's model.
    pub fit: Vec<ChannelResult>,
    /// The shape as measured and as fitted, hold by hold.
    pub shape: Vec<ShapeResult>,
    /// Residuals of every reading, for figures.
    #[serde(skip)]
    pub residuals: Vec<ResidualResult>,
    /// Estimates of the nuisance effects' parameters.
    pub nuisances: Vec<NuisanceResult>,
    /// Sum of squared residuals of the likelihood.
    pub chi_square: Option<f64>,
    /// Number of values minus number of unknowns.
    pub degrees_of_freedom: Option<usize>,
    /// Warnings about the numbers.
    pub warnings: Vec<String>,
    /// Why there are no numbers.
    pub error: Option<String>,
    /// Why the run is not in what is pooled, though it has numbers of its own.
    #[serde(rename = "left_out")]
    pub skipped: Option<String>,
}

impl RunResult {
    /// A run without numbers.
    pub(crate) fn failed(run: &LateralRun, why: String) -> Self {
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
            skipped: None,
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
    /// 95 % interval from noise alone: it covers how far a repeat would scatter, not how far the method is off.
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
    pub(crate) fn gather(points: &[ShapeFit]) -> Vec<Self> {
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
    /// Standard deviation of the prior: where `sd` is not smaller the data do not determine it.
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
    /// Shape points measured.
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
    /// Source of the force.
    pub force_source: &'static str,
    /// Displacement.
    pub displacement_mm: f64,
    /// Source of the displacement.
    pub displacement_source: &'static str,
    /// Shape.
    pub shape_mm: f64,
    /// Source of the shape.
    pub shape_source: &'static str,
}

/// Fit of one channel.
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
