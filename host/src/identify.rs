//! Identifying the tissue's modulus from the lateral runs of a session: every method side by side, run by run and pooled.
//!
//! Per run: the energy balance of Paper A (Lehmann et al.) as printed and corrected, and the likelihood of the exact
//! beam, which is the recommended one. Pooled: one likelihood fit of all runs with a shared K. A run that cannot be
//! identified is reported with its reason and left out of the pool; it never contributes a number.

mod prepare;
mod reference;
mod results;

pub use results::{
    ChannelResult, Energy, EnergyAsPrinted, Heterogeneity, HoldResult, Identification, Likelihood, Methods,
    NoiseResult, Pooled, Reference, RelationResult, RunResult, YoungsModulus,
};

use crate::inference::energy::energy_modulus;
use crate::inference::modulus::Relation;
use crate::inference::{Block, Fit, FitError, LateralData, Parameter, channel_fits, fit};
use crate::levels::HoldCriteria;
use crate::session::{LateralRun, Session};
use prepare::{Prepared, prepare};
use statrs::distribution::{ChiSquared, ContinuousCDF, StudentsT};
use std::path::PathBuf;

/// What the user may choose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Relation that turns K into Young's modulus.
    pub relation: Relation,
    /// Poisson's ratio of the tissue in that relation.
    pub poisson: f64,
    /// What counts as a hold.
    pub criteria: HoldCriteria,
}

impl Default for Options {
    fn default() -> Self {
        Self { relation: Relation::Vesic, poisson: 0.5, criteria: HoldCriteria::default() }
    }
}

/// Why a run cannot be identified.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RunError {
    /// Guide 2 is never held still.
    #[error("{}: displacement_y_mm: no hold found in {duration_s:.1} s, expected guide 2 held still for {least_s} s or more", path.display())]
    NoHold {
        /// The force file.
        path: PathBuf,
        /// Length of the recording.
        duration_s: f64,
        /// Shortest hold.
        least_s: f64,
    },
    /// All holds have gaps.
    #[error("{}: lost_before: all {holds} holds have gaps, expected at least one complete hold", path.display())]
    AllLost {
        /// The force file.
        path: PathBuf,
        /// Number of holds.
        holds: usize,
    },
    /// Guide 2 is never displaced.
    #[error("{}: displacement_y_mm: no hold is displaced (largest {largest_mm:.3} mm), expected a lateral displacement", path.display())]
    NoDisplacement {
        /// The force file.
        path: PathBuf,
        /// Largest displacement of a hold.
        largest_mm: f64,
    },
    /// Not enough of the shape was seen.
    #[error("{}: z_mm: {found} shape points inside the tissue during displaced holds, expected at least 3", path.display())]
    TooFewPoints {
        /// The shape file.
        path: PathBuf,
        /// Number of points.
        found: usize,
    },
    /// Tissue and needle push back; here they pull.
    #[error("{}: force_y_n: {force_n:.3} N at {displacement_mm:.3} mm, expected force and displacement of the same sign", path.display())]
    ForceSign {
        /// The force file.
        path: PathBuf,
        /// Force along the displacement.
        force_n: f64,
        /// Displacement.
        displacement_mm: f64,
    },
    /// The modulus runs to the end of the range.
    #[error("{}: K runs to its bound of {bound_kpa} kPa, expected force and shape that a tissue explains", path.display())]
    AtBound {
        /// The force file.
        path: PathBuf,
        /// The bound.
        bound_kpa: f64,
    },
    /// There is no best modulus.
    #[error("{}: {cause}, expected force and shape that a tissue explains", path.display())]
    Fit {
        /// The force file.
        path: PathBuf,
        /// Why.
        cause: FitError,
    },
}

/// Why a session cannot be identified.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum IdentifyError {
    /// It has no lateral runs.
    #[error("{}: lateral: missing, expected at least one [[lateral]] run", path.display())]
    NoRuns {
        /// The session file.
        path: PathBuf,
    },
    /// None of its runs can be identified.
    #[error("no run can be identified: {}", reasons.iter().map(|(id, why)| format!("{id}: {why}")).collect::<Vec<_>>().join("; "))]
    AllFailed {
        /// Id and reason of each run.
        reasons: Vec<(String, RunError)>,
    },
}

/// Range of K: softer than any tissue, stiffer than any.
const K_RANGE_PA: [f64; 2] = [10.0, 1e7];
/// Below this probability residuals are larger than the noise explains.
const IMPROBABLE: f64 = 1e-3;
const LN_STEP: f64 = 1e-4;

/// Identifies all lateral runs of a session.
///
/// # Errors
/// [`IdentifyError`] where not a single run gives a modulus.
pub fn identify(session: &Session, options: &Options) -> Result<Identification, IdentifyError> {
    if session.lateral.is_empty() {
        return Err(IdentifyError::NoRuns { path: session.dir.join("session.toml") });
    }
    let mut runs = Vec::new();
    let mut fitted = Vec::new();
    let mut reasons = Vec::new();
    let mut warnings = Vec::new();
    for run in &session.lateral {
        match identify_run(session, run, options) {
            Ok((result, of_run)) => {
                warnings.extend(result.warnings.iter().map(|warning| format!("run {}: {warning}", run.id)));
                runs.push(result);
                fitted.push(of_run);
            }
            Err(why) => {
                warnings.push(format!("run {} is left out: {why}", run.id));
                runs.push(RunResult::failed(run, why.to_string()));
                reasons.push((run.id.clone(), why));
            }
        }
    }
    if fitted.is_empty() {
        return Err(IdentifyError::AllFailed { reasons });
    }
    let pooled = pool(&fitted, &mut warnings);
    let depths_m: f64 = fitted.iter().map(|run| run.data.depth_m).sum();
    let depth_m = depths_m / fitted.len() as f64;
    let youngs = reference::youngs_modulus(session, &pooled, depth_m, options);
    let [least, most] = youngs.range_kpa;
    warnings.push(format!(
        "Young's modulus depends on the relation: {least:.1} to {most:.1} kPa by those known; K does not"
    ));
    let reference = reference::reference(session, &fitted, depth_m, options, &mut warnings);
    Ok(Identification {
        schema: results::SCHEMA,
        session: session.name.clone(),
        runs,
        pooled,
        youngs_modulus_kpa: youngs,
        reference,
        warnings,
    })
}

/// A run's data and its own estimate of ln K.
struct Fitted {
    data: LateralData,
    ln_k: f64,
    variance: f64,
    known_noise: bool,
}

fn identify_run(
    session: &Session,
    run: &LateralRun,
    options: &Options,
) -> Result<(RunResult, Fitted), RunError> {
    let mut prepared = prepare(session, run, &options.criteria)?;
    let best = fit_run(&mut prepared, run, session.noise.shape_m)?;
    let estimate = Estimate::of(&best, prepared.known_noise);
    if let Some(widened) = estimate.widened {
        prepared.warnings.push(format!(
            "residuals are {:.2} times the stated noise: interval widened by as much",
            widened.sqrt()
        ));
    }
    let (as_printed, energy) = energy(session, &mut prepared);
    let channels = channel_fits(&prepared.data, &best, 0);
    let result = RunResult {
        id: run.id.clone(),
        depth_mm: 1e3 * run.depth_m,
        methods: Methods { energy_as_printed: as_printed, energy, likelihood: estimate.likelihood() },
        holds: prepared.holds,
        noise: Some(NoiseResult { shape_mm: 1e3 * prepared.data.shape_sd_m, ..prepared.noise }),
        fit: ["displacement", "force", "shape"].into_iter().zip(channels).map(ChannelResult::from).collect(),
        chi_square: Some(best.chi_square),
        degrees_of_freedom: Some(best.degrees_of_freedom),
        warnings: prepared.warnings,
        error: None,
    };
    let fitted = Fitted {
        data: prepared.data,
        ln_k: estimate.ln_k,
        variance: estimate.sd_ln.powi(2),
        known_noise: prepared.known_noise,
    };
    Ok((result, fitted))
}

/// Fits one run; where the noise of the shape is not stated it is taken from the fit's residuals.
fn fit_run(prepared: &mut Prepared, run: &LateralRun, stated_shape_m: Option<f64>) -> Result<Fit, RunError> {
    let failed = |cause: FitError| RunError::Fit { path: run.force_path.clone(), cause };
    let mut best = fit(&[start(&prepared.data)], std::slice::from_ref(&prepared.data)).map_err(failed)?;
    if stated_shape_m.is_none() {
        for _ in 0..4 {
            let [_, _, shape] = channel_fits(&prepared.data, &best, 0);
            // K is an unknown that the shape determines most of.
            let freedom = (shape.count as f64 - 1.0).max(1.0);
            let scale = (shape.chi_square / freedom).sqrt();
            prepared.data.shape_sd_m = (prepared.data.shape_sd_m * scale).max(prepare::LEAST_SHAPE_SD_M);
            let near =
                Parameter { start: best.shared.first().copied().unwrap_or_default(), ..ln_k_parameter() };
            best = fit(&[near], std::slice::from_ref(&prepared.data)).map_err(failed)?;
        }
    }
    if best.at_bound.contains(&true) {
        let modulus_kpa = 1e-3 * best.shared.first().copied().unwrap_or(f64::NAN).exp();
        let bound_kpa = (1e3 * modulus_kpa).round() / 1e3;
        return Err(RunError::AtBound { path: run.force_path.clone(), bound_kpa });
    }
    Ok(best)
}

fn ln_k_parameter() -> Parameter {
    let [least, most] = K_RANGE_PA;
    Parameter { start: 1e4f64.ln(), step: LN_STEP, least: least.ln(), most: most.ln() }
}

/// Starts where the measured displacements, taken as true, fit best: a scan over the whole range of K.
fn start(data: &LateralData) -> Parameter {
    let parameter = ln_k_parameter();
    let nuisances: Vec<f64> = data.nuisances().iter().map(|p| p.start).collect();
    let chi_square = |ln_k: f64| {
        let residuals = data.residuals(&[ln_k], &nuisances).unwrap_or_else(|_| vec![f64::INFINITY]);
        residuals.iter().map(|r| r * r).sum::<f64>()
    };
    let grid = (1..28).map(|i| parameter.least + (parameter.most - parameter.least) * f64::from(i) / 28.0);
    let best = grid.map(|ln_k| (chi_square(ln_k), ln_k)).min_by(|a, b| a.0.total_cmp(&b.0));
    Parameter { start: best.map_or(parameter.start, |(_, ln_k)| ln_k), ..parameter }
}

/// ln K with what is known about it.
struct Estimate {
    ln_k: f64,
    sd_ln: f64,
    quantile: f64,
    /// Factor on the variance because residuals exceed the stated noise.
    widened: Option<f64>,
}

impl Estimate {
    fn of(fit: &Fit, known_noise: bool) -> Self {
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

    fn k_kpa(&self) -> f64 {
        1e-3 * self.ln_k.exp()
    }

    fn ci95_kpa(&self) -> [f64; 2] {
        let half = self.quantile * self.sd_ln;
        [1e-3 * (self.ln_k - half).exp(), 1e-3 * (self.ln_k + half).exp()]
    }

    fn likelihood(&self) -> Likelihood {
        let k_kpa = self.k_kpa();
        Likelihood { k_kpa: Some(k_kpa), sd_kpa: Some(k_kpa * self.sd_ln), ci95_kpa: Some(self.ci95_kpa()) }
    }
}

/// 97.5 % quantile of the normal distribution.
const NORMAL_975: f64 = 1.959_963_984_540_054;

fn student_975(freedom: f64) -> f64 {
    StudentsT::new(0.0, 1.0, freedom.max(1.0)).map_or(NORMAL_975, |t| t.inverse_cdf(0.975))
}

/// The energy balance over the displaced levels with enough shape, weighted by the square of the displacement.
fn energy(session: &Session, prepared: &mut Prepared) -> (EnergyAsPrinted, Energy) {
    let (mut weights, mut printed, mut corrected, mut variance) = (0.0, 0.0, 0.0, 0.0);
    for balance in &mut prepared.balances {
        balance.shape_sd_m = prepared.data.shape_sd_m;
        if let Some(modulus) = energy_modulus(&session.rig, prepared.data.depth_m, balance) {
            let weight = balance.displacement_m.value.powi(2);
            weights += weight;
            printed += weight * modulus.as_printed_pa;
            corrected += weight * modulus.corrected_pa;
            variance += (weight * modulus.corrected_sd_pa).powi(2);
        }
    }
    if weights <= 0.0 {
        return (EnergyAsPrinted::default(), Energy::default());
    }
    let kpa = |sum_pa: f64| 1e-3 * sum_pa / weights;
    if corrected <= 0.0 {
        prepared.warnings.push("the energy balance gives no positive modulus".to_owned());
        return (EnergyAsPrinted { k_kpa: (printed > 0.0).then(|| kpa(printed)) }, Energy::default());
    }
    let (k_kpa, sd_kpa) = (kpa(corrected), kpa(variance.sqrt()));
    let half_kpa = NORMAL_975 * sd_kpa;
    let ci95_kpa = Some([(k_kpa - half_kpa).max(0.0), k_kpa + half_kpa]);
    (
        EnergyAsPrinted { k_kpa: Some(kpa(printed)) },
        Energy { k_kpa: Some(k_kpa), sd_kpa: Some(sd_kpa), ci95_kpa },
    )
}

/// One fit of all runs with a shared K, and whether the runs agree on it.
fn pool(runs: &[Fitted], warnings: &mut Vec<String>) -> Pooled {
    let weight: f64 = runs.iter().map(|run| 1.0 / run.variance).sum();
    let mean = runs.iter().map(|run| run.ln_k / run.variance).sum::<f64>() / weight;
    let q: f64 = runs.iter().map(|run| (run.ln_k - mean).powi(2) / run.variance).sum();
    let freedom = runs.len() as f64 - 1.0;
    let p = ChiSquared::new(freedom).ok().map(|chi| chi.sf(q));
    let differ = p.is_some_and(|p| p < 0.05);

    // Where the joint fit fails the weighted mean of ln K, which is its first-order form, stands in for it.
    let blocks: Vec<LateralData> = runs.iter().map(|run| run.data.clone()).collect();
    let joint = fit(&[Parameter { start: mean, ..ln_k_parameter() }], &blocks);
    let known_noise = runs.iter().all(|run| run.known_noise);
    let mut estimate = match &joint {
        Ok(joint) => Estimate::of(joint, known_noise),
        Err(why) => {
            warnings.push(format!(
                "joint fit of all runs: {why}; the weighted mean of the runs is pooled instead"
            ));
            let quantile = student_975(freedom);
            Estimate { ln_k: mean, sd_ln: weight.recip().sqrt(), quantile, widened: None }
        }
    };
    if differ {
        // Runs that differ more than their noise tell how well a shared K is known.
        estimate.sd_ln = estimate.sd_ln.max((q / freedom / weight).sqrt());
        estimate.quantile = student_975(freedom);
        warnings.push(format!(
            "the runs disagree on K beyond their noise (p = {:.2e}): the pooled interval is widened, and one K may not describe this tissue",
            p.unwrap_or_default()
        ));
    }
    let k_kpa = estimate.k_kpa();
    Pooled {
        k_kpa,
        sd_kpa: k_kpa * estimate.sd_ln,
        ci95_kpa: estimate.ci95_kpa(),
        runs: runs.len(),
        heterogeneity: p.map(|p| Heterogeneity { q, degrees_of_freedom: runs.len() - 1, p }),
    }
}

#[cfg(test)]
mod tests;
