//! Two layers fitted to the lateral runs of a session, with the discrepancy of a diagnosis in all intervals, without any search for
//! effects.

use super::averaged::interval;
use super::layout::Scale;
use super::posterior::Fitted;
use super::{
    DiagnoseError, DiscrepancyFitInput, FitError, Layout, MAX_ROUNDS, Noise, Noises, Session, fit_start,
    runs_of,
};
use mechanics::Support;
use mechanics::effects::effect;
use rayon::prelude::*;

/// An estimate and its interval of 95 %.
pub type Interval = (f64, [f64; 2]);

/// Two layers, with the discrepancy in all intervals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TwoLayers {
    /// Modulus above the boundary, Pa.
    pub upper_pa: Interval,
    /// Modulus below it, Pa.
    pub lower_pa: Interval,
    /// Modulus below over modulus above.
    pub ratio: Interval,
    /// Depth of the boundary.
    pub boundary_mm: Interval,
    /// Logarithm of the evidence of two layers, up to what springs and bodies share.
    pub log_evidence: f64,
    /// The same less that of one layer.
    pub log_evidence_gain: f64,
}

/// Fits two layers to all runs of a session from several starts: modulus above the boundary in Pa, ratio, and boundary in mm. The
/// likelihood has many maxima in the boundary: values are those of the one with the most evidence, intervals those of the mixture of all,
/// each with its evidence as weight.
///
/// # Errors
/// [`DiagnoseError`] where no run can be used or no start has a fit.
pub fn two_layers(
    session: &Session,
    input: &DiscrepancyFitInput<'_>,
    starts: &[[f64; 3]],
) -> Result<TwoLayers, DiagnoseError> {
    let layers = effect("tissue.layers").ok_or(FitError::Undetermined)?;
    let (runs, _) = runs_of(session)?;
    let noise = Noise::of(&runs, &session.stated_noise());
    let effects = input.given.iter().map(|(effect, _)| *effect).collect();
    let layout = Layout::new(&session.rig, &runs, effects);
    let noises = Noises { session: noise, reference: noise };
    let springs = fit_start(&layout, &runs, &noises, input.given, input.discrepancy)?;
    let single_modulus = match input.body {
        Some(poisson) => springs.on(Support::Body { poisson, block: session.tissue.block() })?,
        None => springs,
    };
    let layout = single_modulus.fitted.layout.with(layers);
    // From large sizes the fit would stay where the discrepancy explains everything.
    let everyday = single_modulus.patterns.everyday();
    let sizes: Vec<f64> =
        single_modulus.fitted.sizes.iter().zip(everyday).map(|(size, most)| size.min(most)).collect();
    let mut fits: Vec<Fitted> = starts
        .par_iter()
        .filter_map(|[upper_pa, ratio, boundary_mm]| {
            let mut values = single_modulus.fitted.values().to_vec();
            if let Some(first) = values.first_mut() {
                *first = upper_pa.ln();
            }
            let infos = layers.parameters().iter().zip([ratio, boundary_mm]);
            values.extend(infos.map(|(info, value)| Scale::of(info).inside(*value)));
            Fitted::new(&layout, &single_modulus.runs, &single_modulus.patterns, &values, &sizes, MAX_ROUNDS)
                .ok()
        })
        .collect();
    fits.retain(|fit| !fit.at_bound.contains(&true));
    fits.sort_by(|a, b| b.log_evidence.total_cmp(&a.log_evidence));
    // Starts that lead to the same end are one.
    let mut ends: Vec<Fitted> = Vec::new();
    for fit in fits {
        if !ends.iter().any(|end| end.is_at(&fit)) {
            ends.push(fit);
        }
    }
    let best = ends.first().ok_or(FitError::Undetermined)?;
    let boundary_parameter = layout.first_of(layout.effects.len().saturating_sub(1));
    let weight = |fit: &Fitted| (fit.log_evidence - best.log_evidence).exp();
    // Moduli, ratio and boundary are logarithms inside the fits.
    let mixed = |of: &dyn Fn(&Fitted) -> (f64, f64)| -> Result<Interval, FitError> {
        let weighted_moments: Vec<(f64, f64, f64)> = ends
            .iter()
            .map(|fit| {
                let (value, sd) = of(fit);
                (weight(fit), value, sd)
            })
            .collect();
        let ends = interval(&weighted_moments).ok_or(FitError::Undetermined)?;
        Ok((of(best).0.exp(), ends.map(f64::exp)))
    };
    let parameter_of = |parameter: usize| move |fit: &Fitted| (fit.values()[parameter], fit.sd(parameter));
    let lower = |fit: &Fitted| {
        let variance = |i: usize, j: usize| fit.covariance[(i, j)];
        let variance = variance(0, 0)
            + 2.0 * variance(0, boundary_parameter)
            + variance(boundary_parameter, boundary_parameter);
        (fit.values()[0] + fit.values()[boundary_parameter], variance.max(0.0).sqrt())
    };
    Ok(TwoLayers {
        upper_pa: mixed(&parameter_of(0))?,
        lower_pa: mixed(&lower)?,
        ratio: mixed(&parameter_of(boundary_parameter))?,
        boundary_mm: mixed(&parameter_of(boundary_parameter + 1))?,
        log_evidence: best.log_evidence,
        log_evidence_gain: best.log_evidence - single_modulus.fitted.log_evidence,
    })
}
