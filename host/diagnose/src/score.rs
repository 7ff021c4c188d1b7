//! Score of every effect of the catalogue without a fit (theory, eq. 63 and 64).
//!
//! Around the current fit an effect of amplitude a (in units of an ordinary size) changes the predictions by `a d`. The part of
//! d in the span of the parameters' sensitivities is projected out, and the remainder is projected on the residuals: the
//! efficient score. With a normal prior of the amplitude the evidence of each effect over the current model has a closed form,
//! which is averaged over the possible places or times of the effect.

mod around;
mod directions;
mod power;
mod unseen;

pub(super) use around::{Around, Columns};
pub(super) use directions::Directions;
pub(super) use power::NamedFrom;
pub(super) use unseen::Unseen;

use super::evidence::Patterns;
use super::layout::{HeavyTailed, Prepared, Scale, prior};
use super::posterior::Fitted;
use super::weights::stated_ln_odds;
use directions::Hypothesis;
use mechanics::effects::{Effect, all, neutral};
use nalgebra::{DMatrix, DVector};
use readings::FitError;
use std::sync::Arc;

/// An effect's score.
#[derive(Debug, Clone)]
pub(super) struct Score {
    pub effect: &'static dyn Effect,
    /// Gain of chi-square at the best hypothesis.
    pub chi_square: f64,
    /// Logarithm of the evidence over the current model.
    pub log_evidence: f64,
    /// Start values for a fit: values at the best hypotheses and amplitudes. They include neighbours of the best place, because
    /// another place may be the best for a large effect.
    pub starts: Vec<Vec<f64>>,
    /// Whether the session can identify this effect: a likely size would be significant, or there is evidence for a larger one.
    pub is_identifiable: bool,
}

/// One amplitude of an effect at one place.
#[derive(Debug, Clone)]
pub(super) struct Amplitude {
    pub effect: &'static dyn Effect,
    /// Number of its parameter.
    pub parameter: usize,
    /// Number and value of the parameter that is a place or a time.
    pub place: Option<(usize, f64)>,
    /// Number of its direction.
    pub column: usize,
    /// Step of the parameter, in the scale of the fits.
    pub step: f64,
    /// Standard deviation of the prior, in the scale of the fits.
    pub prior_sd: f64,
}

/// Scores of the whole catalogue around a fit.
#[derive(Debug)]
pub(super) struct Scores {
    hypotheses: Arc<[(&'static dyn Effect, Vec<Hypothesis>)]>,
    /// Scalar products of the directions, the parameters' part taken off.
    gram: DMatrix<f64>,
    /// Scalar products of directions and residuals.
    along: DVector<f64>,
    /// Change of the fitted logarithm of the modulus per amplitude in the data.
    ln_modulus: Vec<f64>,
}

/// Largest ratio of the variance of the noise to the assumed variance, which is an estimate.
pub(super) const NOISE_TOLERANCE: f64 = 1.1;
/// Rounds in which the normal prior that stands for one with heavy tails is adapted to an amplitude. If the data determine the amplitude, the
/// prior has a small share in it, and every round multiplies the error by that share; if they do not, the prior hardly changes. A fit ends
/// at the same prior, in more rounds.
const REWEIGHTINGS: usize = 4;
/// A likely effect of fewer standard deviations than this is not identifiable.
const MIN_SIGNIFICANCE: f64 = 2.0;

/// Residuals of all runs in one column.
pub(super) fn stacked(residuals: &[Vec<f64>]) -> DVector<f64> {
    DVector::from_iterator(residuals.iter().map(Vec::len).sum(), residuals.iter().flatten().copied())
}

impl Scores {
    /// Scores all effects that are not in the model, in the metric of noise and typical discrepancy.
    ///
    /// # Errors
    /// Where the model cannot be evaluated.
    pub fn new(fitted: &Fitted, runs: &[Prepared], patterns: &Patterns) -> Result<Self, FitError> {
        Self::of(&all(), fitted, runs, patterns)
    }

    /// The same of some effects.
    ///
    /// # Errors
    /// Where the model cannot be evaluated.
    pub fn of(
        effects: &[&'static dyn Effect],
        fitted: &Fitted,
        runs: &[Prepared],
        patterns: &Patterns,
    ) -> Result<Self, FitError> {
        Self::along(Directions::of(effects, fitted, runs), fitted, patterns)
    }

    /// Scores of these directions around the fit, in the metric of noise and typical discrepancy.
    ///
    /// # Errors
    /// Where a size of the discrepancy makes no sense.
    pub fn along(directions: Directions, fitted: &Fitted, patterns: &Patterns) -> Result<Self, FitError> {
        Ok(Around::new(fitted, patterns)?.scores(&Columns::new(directions, patterns)))
    }

    /// The scores of the session, best first.
    pub fn ranked(&self) -> Vec<Score> {
        let mut scores: Vec<Score> = self
            .hypotheses
            .iter()
            .map(|(effect, hypotheses)| {
                let of_ways: Vec<HypothesisScore> =
                    hypotheses.iter().map(|hypothesis| self.score(hypothesis, &self.along)).collect();
                let best = (0..hypotheses.len())
                    .max_by(|a, b| of_ways[*a].log_evidence.total_cmp(&of_ways[*b].log_evidence));
                let best = best.unwrap_or(0);
                let log_evidence =
                    mean_of_exponentials(of_ways.iter().map(|hypothesis| hypothesis.log_evidence));
                let is_seen = log_evidence > stated_ln_odds();
                let visible: Vec<bool> =
                    hypotheses.iter().map(|hypothesis| self.is_visible(hypothesis)).collect();
                // The chi-square of a hypothesis that the runs cannot show is a quotient of rounding errors.
                let of_visible = of_ways.iter().zip(&visible).filter(|(_, is_visible)| **is_visible);
                Score {
                    effect: *effect,
                    chi_square: of_visible.map(|(hypothesis, _)| hypothesis.chi_square).fold(0.0, f64::max),
                    log_evidence,
                    starts: [Some(best), best.checked_sub(1), Some(best + 1)]
                        .into_iter()
                        .flatten()
                        .filter_map(|number| Some((hypotheses.get(number)?, of_ways.get(number)?)))
                        .map(|(hypothesis, score)| start(*effect, hypothesis, &score.amplitudes))
                        .collect(),
                    is_identifiable: is_seen || visible.contains(&true),
                }
            })
            .collect();
        scores.sort_by(|a, b| b.log_evidence.total_cmp(&a.log_evidence));
        scores
    }

    /// Whether a likely effect would be significant in the runs.
    fn is_visible(&self, hypothesis: &Hypothesis) -> bool {
        hypothesis.columns.iter().zip(&hypothesis.precisions).any(|(column, precision)| {
            self.gram[(*column, *column)] > MIN_SIGNIFICANCE * MIN_SIGNIFICANCE * precision
        })
    }

    /// Every amplitude of every hypothesis, in the order of the catalogue.
    pub fn amplitudes(&self) -> Vec<Amplitude> {
        let of_hypothesis = |effect: &'static dyn Effect, hypothesis: &Hypothesis| {
            let infos = effect.parameters();
            let place = infos.iter().position(|info| !info.nodes.is_empty());
            let free = infos.iter().enumerate().filter(|(_, info)| info.nodes.is_empty());
            let columns = hypothesis.columns.iter().zip(&hypothesis.precisions);
            free.zip(&hypothesis.probes)
                .zip(columns)
                .map(|(((index, info), probe), (column, precision))| {
                    let probe: &Vec<f64> = probe;
                    let (column, precision): (&usize, &f64) = (column, precision);
                    let prior_sd = prior(info).sd;
                    Amplitude {
                        effect,
                        parameter: index,
                        place: place.and_then(|place| Some((place, *probe.get(place)?))),
                        column: *column,
                        step: precision.sqrt() * prior_sd,
                        prior_sd,
                    }
                })
                .collect::<Vec<_>>()
        };
        let all = self.hypotheses.iter();
        all.flat_map(|(effect, more)| more.iter().flat_map(|one| of_hypothesis(*effect, one))).collect()
    }

    /// Scalar products of the directions with each other and with the residuals, and the derivatives of the logarithm of the
    /// modulus along them.
    pub fn products(&self) -> (&DMatrix<f64>, &DVector<f64>, &[f64]) {
        (&self.gram, &self.along, &self.ln_modulus)
    }

    /// Part of a hypothesis's score that is independent of the residuals.
    fn prepared(&self, hypothesis: &Hypothesis) -> Option<PreparedHypothesis> {
        self.prepared_with(hypothesis, &hypothesis.precisions)
    }

    /// The same with these precisions of the prior.
    fn prepared_with(&self, hypothesis: &Hypothesis, precisions: &[f64]) -> Option<PreparedHypothesis> {
        let k = hypothesis.columns.len();
        let gram = DMatrix::from_fn(k, k, |i, j| self.gram[(hypothesis.columns[i], hypothesis.columns[j])]);
        let prior = DMatrix::from_diagonal(&DVector::from_column_slice(precisions));
        let factor = (gram + prior).cholesky()?;
        let log_determinant = 2.0 * factor.l().diagonal().map(f64::ln).sum();
        let log_prior: f64 = precisions.iter().map(|p| p.ln()).sum();
        // Half of the prior of a one-sided amplitude lies where it cannot be; the other half counts twice.
        let sides = hypothesis.two_sided.iter().filter(|two| !**two).count() as f64 * std::f64::consts::LN_2;
        Some(PreparedHypothesis {
            covariance: factor.inverse(),
            occam: 0.5 * (log_determinant - log_prior),
            sides,
        })
    }

    /// Log evidence of a hypothesis by the projections of the residuals on all directions.
    fn log_evidence(
        hypothesis: &Hypothesis,
        prepared: Option<&PreparedHypothesis>,
        along: &DVector<f64>,
    ) -> f64 {
        let Some(PreparedHypothesis { covariance, occam, sides }) = prepared else {
            return f64::NEG_INFINITY;
        };
        let mut gain = 0.0;
        for ((i, row), two_sided) in
            hypothesis.columns.iter().zip(covariance.row_iter()).zip(&hypothesis.two_sided)
        {
            let amplitude: f64 =
                row.iter().zip(&hypothesis.columns).map(|(value, j)| value * along[*j]).sum();
            if amplitude <= 0.0 && !two_sided {
                return -occam;
            }
            gain += along[*i] * amplitude;
        }
        0.5 * gain - occam + sides
    }

    fn score(&self, hypothesis: &Hypothesis, along: &DVector<f64>) -> HypothesisScore {
        let k = hypothesis.columns.len();
        let b = DVector::from_fn(k, |i, _| along[hypothesis.columns[i]]);
        let Some((prepared, tails)) = self.under_heavy_tails(hypothesis, &b) else {
            return HypothesisScore::none(k);
        };
        let log_evidence = Self::log_evidence(hypothesis, Some(&prepared), along) + tails;
        let mut amplitudes = &prepared.covariance * &b;
        let wrong_side = amplitudes.iter().zip(&hypothesis.two_sided).any(|(a, two)| *a <= 0.0 && !two);
        if wrong_side {
            amplitudes.fill(0.0);
            return HypothesisScore { chi_square: 0.0, log_evidence, amplitudes };
        }
        let gram = DMatrix::from_fn(k, k, |i, j| self.gram[(hypothesis.columns[i], hypothesis.columns[j])]);
        let slack = 1e-9 * gram.trace().max(1e-300);
        let free = (gram + DMatrix::identity(k, k) * slack).cholesky();
        let chi_square = free.map_or(b.dot(&amplitudes), |free| b.dot(&free.solve(&b)));
        HypothesisScore { chi_square, log_evidence, amplitudes }
    }
}

impl Scores {
    /// The normal prior that stands for one with heavy tails around the amplitudes of these projections, and the logarithm of the density of
    /// the latter over that of the former: as in a fit ([`super::layout::HeavyTailed`]).
    fn under_heavy_tails(
        &self,
        hypothesis: &Hypothesis,
        projections: &DVector<f64>,
    ) -> Option<(PreparedHypothesis, f64)> {
        let unit = HeavyTailed { scale: 1.0 };
        let mut prepared = self.prepared(hypothesis)?;
        let in_scales = |prepared: &PreparedHypothesis| {
            let amplitudes = &prepared.covariance * projections;
            let scales = hypothesis.precisions.iter().map(|precision| precision.sqrt());
            amplitudes.iter().zip(scales).map(|(amplitude, scale)| amplitude * scale).collect::<Vec<f64>>()
        };
        for _ in 0..REWEIGHTINGS {
            let precisions = hypothesis.precisions.iter().zip(in_scales(&prepared));
            let precisions: Vec<f64> =
                precisions.map(|(precision, value)| precision / unit.sd_at(value).powi(2)).collect();
            prepared = self.prepared_with(hypothesis, &precisions)?;
        }
        let tails = in_scales(&prepared).into_iter().map(|value| unit.ln_over_normal(value)).sum();
        Some((prepared, tails))
    }
}

/// A hypothesis before the residuals are known.
struct PreparedHypothesis {
    /// Posterior covariance of its amplitudes.
    covariance: DMatrix<f64>,
    /// Minus the logarithm of its Occam factor.
    occam: f64,
    /// Logarithm of a factor of 2 for every one-sided amplitude.
    sides: f64,
}

struct HypothesisScore {
    chi_square: f64,
    log_evidence: f64,
    amplitudes: DVector<f64>,
}

impl HypothesisScore {
    fn none(k: usize) -> Self {
        Self { chi_square: 0.0, log_evidence: f64::NEG_INFINITY, amplitudes: DVector::zeros(k) }
    }
}

/// Values at an amplitude, within what is likely.
fn start(effect: &dyn Effect, hypothesis: &Hypothesis, amplitudes: &DVector<f64>) -> Vec<f64> {
    let mut values = hypothesis.probes.first().cloned().unwrap_or_else(|| neutral(effect));
    let mut amplitudes = amplitudes.iter();
    for ((value, info), index) in values.iter_mut().zip(effect.parameters()).zip(0..) {
        if !info.nodes.is_empty() {
            continue;
        }
        let scale = Scale::of(info);
        let probe =
            hypothesis.probes.get(index).and_then(|probe| probe.get(index)).copied().unwrap_or(*value);
        let step = scale.inside(probe) - scale.inside(info.neutral);
        let amplitude = amplitudes.next().copied().unwrap_or(0.0);
        let [low, high] = info.likely.map(|end| scale.inside(end));
        let inside = (scale.inside(info.neutral) + amplitude * step).clamp(low, high);
        *value = scale.outside(inside);
    }
    values
}

/// `ln mean exp`.
fn mean_of_exponentials(logs: impl Iterator<Item = f64> + Clone) -> f64 {
    let largest = logs.clone().fold(f64::NEG_INFINITY, f64::max);
    if !largest.is_finite() {
        return largest;
    }
    let (sum, count) = logs.fold((0.0, 0.0), |(sum, count), log| (sum + (log - largest).exp(), count + 1.0));
    largest + (sum / count).ln()
}
