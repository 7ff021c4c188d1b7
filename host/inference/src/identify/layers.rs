//! Two layers from runs at several depths: a modulus each and the boundary between them.
//!
//! The fit has several minima in the boundary (a face that no run reaches beyond changes nothing), so it is started from boundaries
//! spread over the depths of the runs, and the best is taken.

use super::fitting::{K_RANGE_PA, NORMAL_975, ln_k_parameter};
use super::{Fitted, Likelihood};
use crate::{Fit, LateralData, Parameter, fit};
use mechanics::Support;
use mechanics::effects::{Effect, effect};
use serde::Serialize;

/// Moduli of a body's layers differ by such a factor at most.
const BODY_CONTRAST: f64 = 11.5;
/// Starts of the boundary.
const STARTS: u32 = 6;

/// Tissue of two layers.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Layers {
    /// `springs`, whose moduli are K, or `body`, whose moduli are E.
    pub foundation: &'static str,
    /// Modulus above the boundary.
    pub upper: Likelihood,
    /// Modulus below it.
    pub lower: Likelihood,
    /// Depth of the boundary below the surface.
    pub boundary_mm: f64,
    /// Its standard deviation.
    pub boundary_sd_mm: f64,
    /// Its 95 % interval.
    pub boundary_ci95_mm: [f64; 2],
    /// Fall of chi-square against one modulus for all, for two unknowns more: below about 14 (p = 0.001) a second layer
    /// is not established.
    pub chi_square_gain: f64,
}

/// Fits two layers to all runs; nothing where runs at fewer than two depths or no fit determine them.
pub(super) fn layers(runs: &[Fitted]) -> Option<Layers> {
    let effect = effect("tissue.layers")?;
    let mut blocks: Vec<LateralData> = runs.iter().map(|run| run.data.clone()).collect();
    let deepest_mm = blocks.iter().map(|block| 1e3 * block.depth_m).fold(0.0, f64::max);
    let shallowest_mm = blocks.iter().map(|block| 1e3 * block.depth_m).fold(f64::INFINITY, f64::min);
    if deepest_mm - shallowest_mm < 1.0 {
        return None;
    }
    let support = blocks.first()?.support;
    let single = fit(&[ln_k_parameter()], &without_effects(&blocks)).ok()?;
    blocks.iter_mut().for_each(|block| block.effects = vec![effect]);
    let start_ln_k = single.shared.first().copied()?;
    let best = (0..STARTS)
        .filter_map(|i| {
            let share = (f64::from(i) + 0.5) / f64::from(STARTS);
            fit(&unknowns(effect, support, start_ln_k, share * deepest_mm, deepest_mm), &blocks).ok()
        })
        .min_by(|a, b| a.chi_square.total_cmp(&b.chi_square))?;
    Layers::of(&best, support, single.chi_square)
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

impl Layers {
    fn of(fit: &Fit, support: Support, single_chi_square: f64) -> Option<Self> {
        let &[ln_k, ratio, boundary_mm] = fit.shared.as_slice() else { return None };
        if fit.at_bound.contains(&true) {
            return None;
        }
        let variance = |i: usize, j: usize| fit.covariance.get((i, j)).copied().unwrap_or(f64::NAN);
        // ln K of the lower layer is ln K + ln ratio.
        let lower_variance = variance(0, 0) + 2.0 * variance(0, 1) / ratio + variance(1, 1) / ratio.powi(2);
        let of = |ln_k: f64, variance: f64| {
            let sd_ln = variance.sqrt();
            let k_kpa = 1e-3 * ln_k.exp();
            let end = |direction: f64| k_kpa * (direction * NORMAL_975 * sd_ln).exp();
            Likelihood {
                k_kpa: Some(k_kpa),
                sd_kpa: Some(k_kpa * sd_ln),
                ci95_kpa: Some([end(-1.0), end(1.0)]),
            }
        };
        let boundary_sd_mm = variance(2, 2).sqrt();
        let half_mm = NORMAL_975 * boundary_sd_mm;
        let lower_ln_k = ln_k + ratio.ln();
        let [least, most] = K_RANGE_PA.map(f64::ln);
        let sound =
            boundary_sd_mm.is_finite() && lower_variance > 0.0 && (least..=most).contains(&lower_ln_k);
        sound.then(|| Self {
            foundation: support.name(),
            upper: of(ln_k, variance(0, 0)),
            lower: of(lower_ln_k, lower_variance),
            boundary_mm,
            boundary_sd_mm,
            boundary_ci95_mm: [boundary_mm - half_mm, boundary_mm + half_mm],
            chi_square_gain: single_chi_square - fit.chi_square,
        })
    }
}
