//! Young's modulus from the needle in an elastic body, fitted to the same runs as the springs, and which of the two explains them.

use super::fitting::{Estimate, fit_alone, ln_k_parameter, unknowns};
use super::{Fitted, Options, Pooled, pool};
use crate::inference::{FitError, LateralData, Parameter, fit};
use crate::model::Support;
use serde::Serialize;

/// What the tissue is taken as.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FoundationChoice {
    /// Independent springs.
    Springs,
    /// An elastic body.
    Body,
    /// Both are fitted, and the evidence decides.
    #[default]
    Auto,
}

impl FoundationChoice {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Springs, Self::Body, Self::Auto];

    /// Its name in options.
    pub fn name(self) -> &'static str {
        match self {
            Self::Springs => "springs",
            Self::Body => "body",
            Self::Auto => "auto",
        }
    }
}

/// Springs against an elastic body.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FoundationResult {
    /// `springs` or `body`: what Young's modulus is from.
    pub used: &'static str,
    /// `stated`, or `evidence` where both were fitted.
    pub by: &'static str,
    /// Logarithm of the evidence of the body less that of the springs, from the same data; nothing where one was not fitted.
    pub log_evidence_gain: Option<f64>,
    /// The body; nothing where it was not asked for or has no fit.
    pub body: Option<BodyResult>,
    /// Why the body has no fit.
    pub body_error: Option<String>,
}

/// The needle in an elastic body, fitted to all runs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BodyResult {
    /// Young's modulus.
    pub youngs_modulus_kpa: f64,
    /// Its 95 % interval, from ln E; the uncertainty of Poisson's ratio and of the operator is in it.
    pub ci95_kpa: [f64; 2],
    /// Poisson's ratio, as stated.
    pub poisson: f64,
    /// Its standard deviation, as stated.
    pub poisson_sd: f64,
}

/// Relative error of the operator, at 95 %: table, interpolation and mesh.
const OPERATOR_ERROR: f64 = 1e-3;
/// The same where the modulus varies with depth.
const VARIED_ERROR: f64 = 1e-2;

/// Fits the body to the runs that the springs were fitted to, and compares.
pub(super) fn compare(
    runs: &[Fitted],
    springs: &Pooled,
    options: &Options,
    warnings: &mut Vec<String>,
) -> FoundationResult {
    let choice = options.foundation;
    let mut result = FoundationResult {
        used: Support::Springs.name(),
        by: if choice == FoundationChoice::Auto { "evidence" } else { "stated" },
        log_evidence_gain: None,
        body: None,
        body_error: None,
    };
    if choice == FoundationChoice::Springs {
        return result;
    }
    let support = Support::Body { poisson: options.poisson };
    match fitted(runs, support).and_then(|fitted| Ok((body(&fitted, options, warnings)?, fitted))) {
        Ok((body, fitted)) => {
            let springs = evidence(runs, 1e3 * springs.k_kpa);
            let gain = evidence(&fitted, 1e3 * body.youngs_modulus_kpa).and_then(|body| Ok(body - springs?));
            result.log_evidence_gain = gain.ok();
            if choice == FoundationChoice::Body || result.log_evidence_gain.is_some_and(|gain| gain > 0.0) {
                result.used = support.name();
            }
            result.body = Some(body);
        }
        Err(why) => {
            warnings.push(format!("no Young's modulus from an elastic body: {why}"));
            result.body_error = Some(why.to_string());
        }
    }
    result
}

/// The runs as of a body, each fitted by itself; where the noise of the shape is not stated it is that of these fits.
fn fitted(runs: &[Fitted], support: Support) -> Result<Vec<Fitted>, FitError> {
    let of_run = |run: &Fitted| {
        let mut data = LateralData { support, ..run.data.clone() };
        let found = fit_alone(&mut data, run.known_shape_noise)?;
        if found.at_bound.first() == Some(&true) {
            return Err(FitError::Undetermined);
        }
        let estimate = Estimate::of(&found, run.known_noise);
        let (ln_k, variance) = (estimate.ln_k, estimate.sd_ln.powi(2));
        Ok(Fitted {
            data,
            ln_k,
            variance,
            known_noise: run.known_noise,
            known_shape_noise: run.known_shape_noise,
        })
    };
    runs.iter().map(of_run).collect()
}

/// Young's modulus of all runs, with what Poisson's ratio and the operator add to its interval.
fn body(runs: &[Fitted], options: &Options, warnings: &mut Vec<String>) -> Result<BodyResult, FitError> {
    let plain = Options { profile: false, bootstrap: 0, ..options.clone() };
    let mut notes = Vec::new();
    let pooled = pool::pool(runs, &plain, &mut notes);
    warnings.extend(notes.into_iter().map(|note| format!("elastic body, where K stands for E: {note}")));
    let value = pooled.k_kpa;
    let mut by_poisson = 0.0;
    if options.poisson_sd > 0.0 {
        // The stiffer the body sideways the softer the modulus that explains the runs.
        let step =
            if options.poisson > options.poisson_sd { -options.poisson_sd } else { options.poisson_sd };
        let poisson = (options.poisson + step).clamp(0.0, 0.5);
        let other = fitted(runs, Support::Body { poisson })?;
        by_poisson = 1.96 * (pool::pool(&other, &plain, &mut Vec::new()).k_kpa / value).ln();
    }
    let varies = |id: &str| matches!(id, "tissue.layers" | "tissue.gradient");
    let all =
        options.fixed.iter().map(|(effect, _)| effect.id()).chain(options.nuisances.iter().map(|n| n.id()));
    let operator = if all.into_iter().any(varies) { VARIED_ERROR } else { OPERATOR_ERROR };
    let end = |kpa: f64| {
        let by_data = (kpa / value).ln();
        value * by_data.hypot(by_poisson).hypot(operator).copysign(by_data).exp()
    };
    Ok(BodyResult {
        youngs_modulus_kpa: value,
        ci95_kpa: pooled.ci95_kpa.map(end),
        poisson: options.poisson,
        poisson_sd: options.poisson_sd,
    })
}

/// Logarithm of the evidence of the runs' joint fit, by Laplace's method, without what springs and body share: flat in the
/// logarithm of the modulus over the same range, the same nuisances, the same data.
fn evidence(runs: &[Fitted], modulus_pa: f64) -> Result<f64, FitError> {
    let blocks: Vec<LateralData> = runs.iter().map(|run| run.data.clone()).collect();
    let effects = blocks.first().map(|block| block.effects.clone()).unwrap_or_default();
    let start = Parameter { start: modulus_pa.ln(), ..ln_k_parameter() };
    let best = fit(&unknowns(start, &effects), &blocks)?;
    // What the normal density of the shape's readings is divided by, where its standard deviation is estimated.
    let scales: f64 = blocks.iter().map(|block| block.shape_values() as f64 * block.shape_sd_m.ln()).sum();
    let volume = 0.5 * best.covariance.determinant().ln();
    Ok(volume - 0.5 * best.chi_square - scales)
}
