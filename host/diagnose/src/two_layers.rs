//! Fit of two layers to the lateral runs of a session, without a search for effects; all intervals include the discrepancy of a
//! diagnosis.

use super::averaged::interval;
use super::known::Released;
use super::layout::Scale;
use super::posterior::Fitted;
use super::{
    DiagnoseError, DiscrepancyFitInput, FitError, Layout, MAX_ROUNDS, Noise, Noises, Session, fit_start,
    known, runs_of,
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
    /// Logarithm of the evidence of two layers, up to a constant that springs and bodies share.
    pub log_evidence: f64,
    /// Log evidence of two layers over one layer.
    pub log_evidence_gain: f64,
}

/// Fits two layers to all runs of a session from several starts: modulus above the boundary in Pa, ratio, and boundary in mm.
/// The likelihood has many maxima along the boundary. Values are those of the maximum with the largest evidence; intervals are
/// those of the mixture of all maxima, weighted by their evidence. Known parameters that the runs contradict with a single modulus become free.
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
    let mut layout = Layout::new(&session.rig, &runs, effects);
    layout.known = input.known.into();
    let noises = Noises { session: noise, reference: noise };
    let Released { start: springs, .. } = known::released(&mut layout, |layout| {
        fit_start(layout, &runs, &noises, input.given, input.discrepancy)
    })?;
    let single_modulus = match input.body {
        Some(poisson) => springs.on(Support::Body { poisson, block: session.tissue.block() })?,
        None => springs,
    };
    let layout = single_modulus.fitted.layout.with(layers);
    // If the fit started at large sizes, the discrepancy would continue to explain everything.
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
    // Fits that have converged to the same values are the same.
    let mut ends: Vec<Fitted> = Vec::new();
    for fit in fits {
        if !ends.iter().any(|end| end.is_at(&fit)) {
            ends.push(fit);
        }
    }
    let best = ends.first().ok_or(FitError::Undetermined)?;
    let ratio_parameter = layout.first_of(layout.effects.len().saturating_sub(1));
    let lower_pa = mixed(&ends, |fit| {
        let variance = fit.covariance[(0, 0)]
            + 2.0 * fit.covariance[(0, ratio_parameter)]
            + fit.covariance[(ratio_parameter, ratio_parameter)];
        (fit.values()[0] + fit.values()[ratio_parameter], variance.max(0.0).sqrt())
    })?;
    Ok(TwoLayers {
        upper_pa: mixed(&ends, |fit| moments_of(fit, 0))?,
        lower_pa,
        ratio: mixed(&ends, |fit| moments_of(fit, ratio_parameter))?,
        boundary_mm: mixed(&ends, |fit| moments_of(fit, ratio_parameter + 1))?,
        log_evidence: best.log_evidence,
        log_evidence_gain: best.log_evidence - single_modulus.fitted.log_evidence,
    })
}

/// Value of a quantity in the fit with the largest evidence, and its interval over all fits. Moduli, ratio and boundary are logarithms inside
/// the fits, and are returned in their own units.
fn mixed(fits: &[Fitted], moments: impl Fn(&Fitted) -> (f64, f64)) -> Result<Interval, FitError> {
    let best = fits.first().ok_or(FitError::Undetermined)?;
    let weighted_moments = fits.iter().map(|fit| {
        let (value, sd) = moments(fit);
        ((fit.log_evidence - best.log_evidence).exp(), value, sd)
    });
    let ends = interval(&weighted_moments.collect::<Vec<_>>()).ok_or(FitError::Undetermined)?;
    Ok((moments(best).0.exp(), ends.map(f64::exp)))
}

/// Value and standard deviation of a parameter.
fn moments_of(fit: &Fitted, parameter: usize) -> (f64, f64) {
    (fit.values()[parameter], fit.sd(parameter))
}

#[cfg(test)]
mod tests {
    use super::super::tests::truth;
    use super::super::{KnownParameter, Multiples};
    use super::*;
    use mechanics::effects::Effect;
    use worlds::{Design, session};

    /// Two layers in a session whose model contains an effect with a known parameter.
    fn with_known(session: &Session, id: &str, parameter: &str, known: Option<(f64, f64)>) -> TwoLayers {
        let given: Vec<(&'static dyn Effect, Vec<f64>)> =
            effect(id).into_iter().map(|one| (one, vec![one.parameters()[0].neutral])).collect();
        let known_parameters = known.map(|(value, sd)| KnownParameter {
            effect: id.to_owned(),
            parameter: parameter.to_owned(),
            value,
            sd,
        });
        let input = DiscrepancyFitInput {
            given: &given,
            known: known_parameters.as_slice(),
            discrepancy: &Multiples::new(),
            body: None,
            draws: None,
        };
        two_layers(session, &input, &[[12e3, 2.0, 15.0]]).expect("two layers")
    }

    fn layered() -> Session {
        session(&truth(vec![("tissue.layers", vec![2.0, 15.0])]), &Design::four_runs(), 3)
    }

    fn width_ln((_, [low, high]): Interval) -> f64 {
        (high / low).ln()
    }

    /// A force gain scales all moduli, so that their intervals depend on what is known of the gain.
    #[test]
    fn the_intervals_of_two_layers_use_what_is_known_of_the_rig() {
        let session = layered();
        let [unknown, known] =
            [None, Some((0.0, 1e-4))].map(|known| with_known(&session, "sensor.force_gain", "gain", known));
        assert!(width_ln(known.lower_pa) < 0.9 * width_ln(unknown.lower_pa), "{known:?} {unknown:?}");
    }

    /// A known value that the runs contradict is released, as in a diagnosis: otherwise it moves the moduli.
    #[test]
    fn two_layers_do_not_rest_on_a_known_value_that_the_runs_contradict() {
        let session = layered();
        let [unknown, contradicted] =
            [None, Some((0.3, 0.02))].map(|known| with_known(&session, "sensor.shape_scale", "scale", known));
        let moved = (contradicted.upper_pa.0 / unknown.upper_pa.0).ln().abs();
        assert!(moved < 0.01, "{contradicted:?} {unknown:?}");
    }
}
