//! Two layers from runs at several depths: a modulus each and the boundary between them.
//!
//! The fit has several minima in the boundary (a face that no run reaches through moves nothing), so it is started from boundaries
//! spread over the depths of the runs. Intervals of noise alone are far too narrow, since imperfections of an ordinary laboratory move
//! a boundary by millimetres: every minimum is fitted again beside the discrepancy of a diagnosis, and evidence weights them.

use super::fitting::{K_RANGE_PA, NORMAL_975, VARIED_ERROR, ln_k_parameter};
use super::model_error::for_diagnosis;
use super::options::TissueModel;
use super::{Fitted, FoundationChoice, Layers, Likelihood, Options};
use diagnose::{DiscrepancyFitInput, FOUNDATION_MARGIN, Interval, TwoLayers, two_layers};
use formats::session::Session;
use mechanics::Support;
use mechanics::effects::{Effect, effect};
use modulus::walls::WallsResult;
use readings::{Fit, LateralData, Parameter, fit};

/// Log evidence of two layers over the best single modulus that establishes them, as a diagnosis requires of an effect.
const ESTABLISHED: f64 = 5.0;
/// Moduli of a body's layers differ by such a factor at most.
const BODY_CONTRAST: f64 = 11.5;
/// Starts of the boundary.
const STARTS: u32 = 6;

/// Boundaries closer than this are one start.
const APART_MM: f64 = 0.5;

/// Fits two layers to all runs; `None` where runs at fewer than two depths or no fit determine them.
///
/// Unless the tissue is stated to be springs or a body, the evidence of both with two layers decides: what one modulus explains better as
/// the one may be layers of the other. `support` is what is used where their evidence is not computed.
pub(super) fn layers(
    session: &Session,
    runs: &[Fitted],
    support: Support,
    options: &Options,
    tissue: TissueModel,
) -> Option<Layers> {
    let depths_mm = || runs.iter().map(|run| 1e3 * run.data.depth_m);
    let (deepest_mm, shallowest_mm) =
        (depths_mm().fold(0.0, f64::max), depths_mm().fold(f64::INFINITY, f64::min));
    if deepest_mm - shallowest_mm < 1.0 {
        return None;
    }
    let for_diagnosis = options.model_error.then(|| for_diagnosis(session, runs, options).ok()).flatten();
    let Some((fitted_runs, fixed_effects)) = for_diagnosis else {
        let by_noise = ByNoise::new(runs, support, deepest_mm)?;
        return Layers::of(by_noise.fits.first()?, support, by_noise.single_chi_square);
    };
    let supports = match tissue.foundation {
        FoundationChoice::Springs => vec![Support::Springs],
        FoundationChoice::Body => vec![tissue.body()],
        FoundationChoice::Auto => vec![Support::Springs, tissue.body()],
    };
    let of = |support: Support, by_noise: &ByNoise| {
        let body = match support {
            Support::Springs => None,
            Support::Body { poisson, .. } => Some(poisson),
        };
        let (known_parameters, discrepancy) = (options.known.as_slice(), &options.discrepancy);
        let input = DiscrepancyFitInput {
            given: &fixed_effects,
            known: known_parameters,
            discrepancy,
            body,
            draws: None,
        };
        two_layers(&fitted_runs, &input, &by_noise.starts()).ok()
    };
    let fitted_supports = supports.into_iter().filter_map(|support| {
        let by_noise = ByNoise::new(runs, support, deepest_mm)?;
        let two_layers = of(support, &by_noise)?;
        Some((support, by_noise, two_layers))
    });
    let candidates: Vec<(Support, ByNoise, TwoLayers)> = fitted_supports.collect();
    let body_gain = match candidates.as_slice() {
        [(_, _, springs), (_, _, body)] => Some(body.log_evidence - springs.log_evidence),
        _ => None,
    };
    let chosen = usize::from(body_gain.is_some_and(|gain| gain > FOUNDATION_MARGIN));
    let (support, by_noise, best) = candidates.get(chosen)?;
    // The uncertainty of Poisson's ratio moves both moduli.
    let other_body = support.is_body().then(|| tissue.other_body()).flatten();
    let other_layers = other_body.and_then(|other_body| of(other_body, by_noise));
    let by_poisson = other_layers
        .map_or(0.0, |other_layers| NORMAL_975 * (other_layers.upper_pa.0 / best.upper_pa.0).ln());
    let chi_square_gain = by_noise.single_chi_square - by_noise.fits.first()?.chi_square;
    let layers = Layers::with_discrepancy(best, *support, by_poisson, chi_square_gain);
    Some(Layers { body_log_evidence_gain: body_gain, ..layers })
}

/// Fits with noise alone, best first.
struct ByNoise {
    fits: Vec<Fit>,
    /// Chi-square of one modulus.
    single_chi_square: f64,
}

impl ByNoise {
    fn new(runs: &[Fitted], support: Support, deepest_mm: f64) -> Option<Self> {
        let effect = effect("tissue.layers")?;
        let mut blocks: Vec<LateralData> =
            runs.iter().map(|run| LateralData { support, ..run.data.clone() }).collect();
        let single = fit(&[ln_k_parameter()], &without_effects(&blocks)).ok()?;
        blocks.iter_mut().for_each(|block| block.effects = vec![effect]);
        let start_ln_k = single.shared.first().copied()?;
        let mut fits: Vec<Fit> = (0..STARTS)
            .filter_map(|i| {
                let start_fraction = (f64::from(i) + 0.5) / f64::from(STARTS);
                fit(&unknowns(effect, support, start_ln_k, start_fraction * deepest_mm, deepest_mm), &blocks)
                    .ok()
            })
            .collect();
        fits.sort_by(|a, b| a.chi_square.total_cmp(&b.chi_square));
        (!fits.is_empty()).then_some(Self { fits, single_chi_square: single.chi_square })
    }

    /// Modulus above the boundary in Pa, ratio and boundary in mm of every minimum.
    fn starts(&self) -> Vec<[f64; 3]> {
        let mut starts: Vec<[f64; 3]> = Vec::new();
        for found in &self.fits {
            let &[ln_k, ratio, boundary_mm] = found.shared.as_slice() else { continue };
            if starts.iter().all(|[.., other_mm]| (other_mm - boundary_mm).abs() > APART_MM) {
                starts.push([ln_k.exp(), ratio, boundary_mm]);
            }
        }
        starts
    }
}

fn without_effects(blocks: &[LateralData]) -> Vec<LateralData> {
    blocks.iter().map(|block| LateralData { effects: Vec::new(), ..block.clone() }).collect()
}

/// `ln K` above the boundary, ratio of the moduli, boundary: all free within their ranges.
fn unknowns(
    effect: &dyn Effect,
    support: Support,
    ln_k: f64,
    boundary_mm: f64,
    deepest_mm: f64,
) -> Vec<Parameter> {
    let mut unknowns = vec![Parameter { start: ln_k, ..ln_k_parameter() }];
    let parameters = effect.parameters().iter().zip([(1.3, 1e-4), (boundary_mm, 1e-3)]);
    unknowns.extend(parameters.map(|(info, (start, step))| {
        let [least, most] = info.range;
        Parameter { start, step, least, most, prior: None }
    }));
    if let [_, ratio, boundary] = unknowns.as_mut_slice() {
        boundary.most = deepest_mm;
        if support.is_body() {
            // The operator's moduli do not differ by more.
            ratio.least = ratio.least.max(1.0 / BODY_CONTRAST);
            ratio.most = ratio.most.min(BODY_CONTRAST);
        }
    }
    unknowns
}

/// An interval whose ends are so much farther, in quadrature and logarithms.
fn widened((value, ends): Interval, by: f64) -> [f64; 2] {
    ends.map(|end| {
        let ln = (end / value).ln();
        value * ln.hypot(by).copysign(ln).exp()
    })
}

impl Layers {
    /// Compared with the better single modulus: `single_body_gain` is the log evidence of a body of one modulus less that of springs of
    /// one.
    pub(super) fn over_single(mut self, single_body_gain: Option<f64>) -> Self {
        let body_ahead = single_body_gain.unwrap_or(0.0);
        let other_ahead = if self.foundation == "body" { -body_ahead } else { body_ahead };
        self.log_evidence_over_single = self.log_evidence_gain.map(|gain| gain - other_ahead.max(0.0));
        self.established = self.log_evidence_over_single.is_some_and(|gain| gain >= ESTABLISHED);
        self
    }

    /// With what walls that are not stated may do to E of each; K does not depend on them.
    pub(super) fn with_walls(mut self, walls: &WallsResult) -> Self {
        if self.foundation == "body" {
            for layer in [&mut self.upper, &mut self.lower] {
                layer.ci95_kpa =
                    layer.k_kpa.zip(layer.ci95_kpa).map(|(value, ends)| walls.widened(value, ends));
            }
        }
        self
    }

    fn with_discrepancy(found: &TwoLayers, support: Support, by_poisson: f64, chi_square_gain: f64) -> Self {
        let operator = if support.is_body() { VARIED_ERROR } else { 0.0 };
        let of = |modulus_pa: Interval| {
            let (value_kpa, ci95_kpa) =
                (1e-3 * modulus_pa.0, widened(modulus_pa, operator.hypot(by_poisson)).map(|pa| 1e-3 * pa));
            Likelihood {
                k_kpa: Some(value_kpa),
                sd_kpa: Some(value_kpa * sd_ln(ci95_kpa)),
                ci95_kpa: Some(ci95_kpa),
            }
        };
        let (boundary_mm, boundary_ci95_mm) = found.boundary_mm;
        Self {
            foundation: support.name(),
            upper: of(found.upper_pa),
            lower: of(found.lower_pa),
            k_ratio: found.ratio.0,
            k_ratio_ci95: widened(found.ratio, operator),
            boundary_mm,
            boundary_sd_mm: 0.5 * (boundary_ci95_mm[1] - boundary_ci95_mm[0]) / NORMAL_975,
            boundary_ci95_mm,
            chi_square_gain,
            log_evidence_gain: Some(found.log_evidence_gain),
            body_log_evidence_gain: None,
            log_evidence_over_single: None,
            established: false,
        }
    }

    /// From noise alone: where the discrepancy of a diagnosis is not requested or not possible.
    fn of(fit: &Fit, support: Support, single_chi_square: f64) -> Option<Self> {
        let &[ln_k, ratio, boundary_mm] = fit.shared.as_slice() else { return None };
        if fit.at_bound.contains(&true) {
            return None;
        }
        let variance = |i: usize, j: usize| fit.covariance.get((i, j)).copied().unwrap_or(f64::NAN);
        // ln K of the lower layer is ln K + ln ratio.
        let lower_variance = variance(0, 0) + 2.0 * variance(0, 1) / ratio + variance(1, 1) / ratio.powi(2);
        let boundary_sd_mm = variance(2, 2).sqrt();
        let half_mm = NORMAL_975 * boundary_sd_mm;
        let lower_ln_k = ln_k + ratio.ln();
        let [least, most] = K_RANGE_PA.map(f64::ln);
        let sound =
            boundary_sd_mm.is_finite() && lower_variance > 0.0 && (least..=most).contains(&lower_ln_k);
        let half_ratio = NORMAL_975 * variance(1, 1).sqrt() / ratio;
        sound.then(|| Self {
            foundation: support.name(),
            k_ratio: ratio,
            k_ratio_ci95: [ratio * (-half_ratio).exp(), ratio * half_ratio.exp()],
            upper: likelihood_of(ln_k, variance(0, 0)),
            lower: likelihood_of(lower_ln_k, lower_variance),
            boundary_mm,
            boundary_sd_mm,
            boundary_ci95_mm: [boundary_mm - half_mm, boundary_mm + half_mm],
            chi_square_gain: single_chi_square - fit.chi_square,
            log_evidence_gain: None,
            body_log_evidence_gain: None,
            log_evidence_over_single: None,
            established: false,
        })
    }
}

/// Likelihood of a modulus from its logarithm, which is normal.
fn likelihood_of(ln_k: f64, variance: f64) -> Likelihood {
    let sd_ln = variance.sqrt();
    let k_kpa = 1e-3 * ln_k.exp();
    Likelihood {
        k_kpa: Some(k_kpa),
        sd_kpa: Some(k_kpa * sd_ln),
        ci95_kpa: Some([interval_end(-1.0, k_kpa, sd_ln), interval_end(1.0, k_kpa, sd_ln)]),
    }
}

fn interval_end(direction: f64, k_kpa: f64, sd_ln: f64) -> f64 {
    k_kpa * (direction * NORMAL_975 * sd_ln).exp()
}

fn sd_ln([low, high]: [f64; 2]) -> f64 {
    0.5 * (high / low).ln() / NORMAL_975
}

#[cfg(test)]
mod tests {
    use super::*;

    fn layers(foundation: &'static str, gain: Option<f64>) -> Layers {
        Layers {
            foundation,
            upper: Likelihood::default(),
            lower: Likelihood::default(),
            k_ratio: 2.0,
            k_ratio_ci95: [1.8, 2.2],
            boundary_mm: 15.0,
            boundary_sd_mm: 1.0,
            boundary_ci95_mm: [13.0, 17.0],
            chi_square_gain: 50.0,
            log_evidence_gain: gain,
            body_log_evidence_gain: None,
            log_evidence_over_single: None,
            established: false,
        }
    }

    #[test]
    fn layers_are_established_against_the_better_single_modulus() {
        // Springs of two layers 12 nats ahead of springs of one, in what a body of one modulus explains 10 nats better.
        let result = layers("springs", Some(12.0)).over_single(Some(10.0));
        assert_eq!((result.log_evidence_over_single, result.established), (Some(2.0), false));
        let result = layers("springs", Some(12.0)).over_single(Some(-10.0));
        assert_eq!((result.log_evidence_over_single, result.established), (Some(12.0), true));
        let decided = layers("body", Some(12.0)).over_single(Some(-10.0));
        assert_eq!((decided.log_evidence_over_single, decided.established), (Some(2.0), false));
        assert!(layers("body", Some(6.0)).over_single(None).established);
        assert!(!layers("body", None).over_single(Some(3.0)).established);
    }
}
