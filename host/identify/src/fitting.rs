//! Fitting the beam to runs: unknowns, first guess, and what is known of ln K afterwards.

use super::outliers::take_outliers;
use super::prepare::Prepared;
use super::{Likelihood, NuisanceResult, RunError};
pub(super) use formats::NORMAL_975;
use formats::session::LateralRun;
use mechanics::effects::Effect;
use mechanics::unknowns::sensors::SHAPE_NOISE;
use readings::{Block, Fit, FitError, LateralData, Parameter, channel_fits, effect_parameters, fit};
use statrs::distribution::{ChiSquared, ContinuousCDF, StudentsT};

/// Relative error of a body's operator where the modulus varies with depth, at 95 %: table, interpolation and mesh.
pub(super) const VARIED_ERROR: f64 = 1e-2;
/// Range of K: softer than any tissue, stiffer than any.
pub(super) const K_RANGE_PA: [f64; 2] = [10.0, 1e7];
/// Below this probability residuals are larger than the noise explains.
const IMPROBABLE: f64 = 1e-3;
const LN_STEP: f64 = 1e-4;

/// Fits without outliers are repeated so often: the first ones hide smaller ones.
const OUTLIER_ROUNDS: usize = 3;

/// Fits one run.
pub(super) fn fit_run(prepared: &mut Prepared, run: &LateralRun) -> Result<Fit, RunError> {
    let failed = |cause| RunError::Fit { path: run.force_path.clone(), cause };
    let points = prepared.data.shape_values() / prepared.data.planes.max(1);
    let mut best = fit_alone(&mut prepared.data, prepared.known_shape_noise).map_err(failed)?;
    let mut outliers = 0;
    for _ in 0..OUTLIER_ROUNDS {
        match take_outliers(&mut prepared.data, &best) {
            0 => break,
            more => outliers += more,
        }
        best = fit_alone(&mut prepared.data, prepared.known_shape_noise).map_err(failed)?;
    }
    if outliers > 0 {
        prepared.warnings.push(format!(
            "{outliers} of {points} points of the shape are outliers (single points far from their neighbours), and are excluded from the fit"
        ));
    }
    if best.at_bound.first() == Some(&true) {
        let modulus_kpa = 1e-3 * best.shared.first().copied().unwrap_or(f64::NAN).exp();
        let bound_kpa = (1e3 * modulus_kpa).round() / 1e3;
        return Err(RunError::AtBound { path: run.force_path.clone(), bound_kpa });
    }
    Ok(best)
}

/// Fits one run's data; where the noise of the shape is not known it is taken from the fit's residuals.
pub(super) fn fit_alone(data: &mut LateralData, known_shape_noise: bool) -> Result<Fit, FitError> {
    let mut start_values = unknowns(start(data), &data.effects);
    let mut best = fit(&start_values, std::slice::from_ref(data))?;
    if !known_shape_noise {
        for _ in 0..4 {
            let [_, _, shape] = channel_fits(data, &best, 0);
            // K is an unknown that the shape determines most of.
            let freedom = (shape.count as f64 - 1.0).max(1.0);
            let scale = (shape.chi_square / freedom).sqrt();
            data.shape_sd_m = (data.shape_sd_m * scale).max(SHAPE_NOISE.least());
            start_values.iter_mut().zip(&best.shared).for_each(|(parameter, value)| parameter.start = *value);
            best = fit(&start_values, std::slice::from_ref(data))?;
        }
    }
    Ok(best)
}

pub(super) fn ln_k_parameter() -> Parameter {
    let [least, most] = K_RANGE_PA;
    Parameter { start: 1e4f64.ln(), step: LN_STEP, least: least.ln(), most: most.ln(), prior: None }
}

/// `ln K` and the parameters of the effects.
pub(super) fn unknowns(ln_k: Parameter, effects: &[&'static dyn Effect]) -> Vec<Parameter> {
    let mut unknowns = vec![ln_k];
    unknowns.extend(effect_parameters(effects));
    unknowns
}

/// Starts where the measured displacements, taken as true, fit best: a scan over the whole range of K.
pub(super) fn start(data: &LateralData) -> Parameter {
    let parameter = ln_k_parameter();
    let nuisances: Vec<f64> = data.nuisances().iter().map(|p| p.start).collect();
    let neutral: Vec<f64> =
        data.effects.iter().flat_map(|effect| effect.parameters()).map(|info| info.neutral).collect();
    let grid = (1..28).map(|i| parameter.least + (parameter.most - parameter.least) * f64::from(i) / 28.0);
    let best = grid
        .map(|ln_k| (chi_square_at(ln_k, &neutral, &nuisances, data), ln_k))
        .min_by(|a, b| a.0.total_cmp(&b.0));
    Parameter { start: best.map_or(parameter.start, |(_, ln_k)| ln_k), ..parameter }
}

/// Sum of squares at a modulus, with every other parameter at its start.
fn chi_square_at(ln_k: f64, neutral: &[f64], nuisances: &[f64], data: &LateralData) -> f64 {
    let mut shared = vec![ln_k];
    shared.extend(neutral);
    let residuals = data.prepare(&shared).and_then(|ready| data.residuals(&ready, nuisances));
    let residuals = residuals.unwrap_or_else(|_| vec![f64::INFINITY]);
    residuals.iter().map(|r| r * r).sum::<f64>()
}

/// Estimates of the effects' parameters.
pub(super) fn nuisance_results(effects: &[&'static dyn Effect], fit: &Fit) -> Vec<NuisanceResult> {
    let parameters =
        effects.iter().flat_map(|effect| effect.parameters().iter().map(move |info| (effect, info)));
    let estimates =
        fit.shared.iter().zip(fit.covariance.diagonal().iter().copied().collect::<Vec<_>>()).skip(1);
    parameters
        .zip(estimates)
        .map(|((effect, info), (value, variance))| NuisanceResult {
            effect: effect.id(),
            parameter: info.name,
            value: *value,
            sd: variance.sqrt(),
            prior_sd: info.prior_sd,
        })
        .collect()
}

/// ln K with what is known about it.
pub(super) struct Estimate {
    pub ln_k: f64,
    pub sd_ln: f64,
    pub quantile: f64,
    /// Factor on the variance because residuals exceed the stated noise.
    pub widened: Option<f64>,
}

impl Estimate {
    pub fn of(fit: &Fit, known_noise: bool) -> Self {
        let freedom = fit.degrees_of_freedom as f64;
        let probability = ChiSquared::new(freedom).map_or(1.0, |chi| chi.sf(fit.chi_square));
        let widened = (probability < IMPROBABLE).then_some(fit.chi_square / freedom);
        let variance = fit.covariance.get((0, 0)).copied().unwrap_or(f64::NAN) * widened.unwrap_or(1.0);
        let quantile = if known_noise && widened.is_none() { NORMAL_975 } else { student_975(freedom) };
        Self {
            ln_k: fit.shared.first().copied().unwrap_or(f64::NAN),
            sd_ln: variance.sqrt(),
            quantile,
            widened,
        }
    }

    pub fn k_kpa(&self) -> f64 {
        1e-3 * self.ln_k.exp()
    }

    pub fn ci95_kpa(&self) -> [f64; 2] {
        let half = self.quantile * self.sd_ln;
        [1e-3 * (self.ln_k - half).exp(), 1e-3 * (self.ln_k + half).exp()]
    }

    pub fn likelihood(&self) -> Likelihood {
        let k_kpa = self.k_kpa();
        Likelihood { k_kpa: Some(k_kpa), sd_kpa: Some(k_kpa * self.sd_ln), ci95_kpa: Some(self.ci95_kpa()) }
    }
}

pub(super) fn student_975(freedom: f64) -> f64 {
    StudentsT::new(0.0, 1.0, freedom.max(1.0)).map_or(NORMAL_975, |t| t.inverse_cdf(0.975))
}
