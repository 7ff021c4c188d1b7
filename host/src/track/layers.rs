//! Tracking through layers whose boundary is not known: the boundary is an unknown like any other.
//!
//! The estimator has two segments of depth, and its tissue may jump where they meet. While a run goes on three of them go through it,
//! each with its own place of the jump, and every value is their mixture: their weights are those of their deviations, and the
//! interval of a value has what they differ by in it. When the run has ended its rows are replayed for a jump at every cell, and for
//! none, and the mixture of all of them with the weights of their evidence is what is reported: tissue against depth, means, and the boundary with its
//! interval (Bayesian model averaging; Hoeting, Madigan, Raftery and Volinsky, 1999).

use super::sound::{CELLS, MODES, SoundTracker};
use firmware::steering::{Estimate, Evidence, Refused, Sample, Seen, Settings, Value};
use rayon::prelude::*;

/// Boundaries that are followed while a run goes on, as shares of the depth.
const FOLLOWED: [f64; 3] = [0.25, 0.5, 0.75];
/// Boundaries are looked for between these shares of the depth: beyond them one side is too short for two layers.
const SEARCHED: [f64; 2] = [0.08, 0.92];
/// Probability from which on a boundary is reported: it is more likely than tissue that varies smoothly.
const LIKELY: f64 = 0.5;
/// An interval wider than this share of the depth locates no boundary.
const LOCATED: f64 = 0.4;
/// 97.5 % quantile of the normal distribution.
const NORMAL_975: f64 = 1.959_963_984_540_054;

/// The boundary of two layers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Boundary {
    /// Depth, m: the median.
    pub depth_m: f64,
    /// Its 95 % interval.
    pub ci95_m: [f64; 2],
    /// Stiffness just below over that just above.
    pub stiffness_ratio: f64,
}

/// What is known at the end of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct Layered {
    /// As the estimator gives it.
    pub estimate: Estimate<f64>,
    /// Probability that the tissue jumps somewhere; even odds before the run.
    pub boundary_probability: f64,
    /// Where; nothing where no boundary is established or it is not located.
    pub boundary: Option<Boundary>,
    /// Stiffness of every cell that was reached.
    pub field: Vec<Value<f64>>,
    /// Length of a cell.
    pub cell_m: f64,
}

/// The estimators of a run with two layers at most.
#[derive(Debug, Clone)]
pub struct LayeredTracker {
    followed: Vec<SoundTracker<f64>>,
}

/// A place of the jump, fitted; without one there is none.
struct Candidate {
    boundary_m: Option<f64>,
    evidence: Evidence<f64>,
    estimate: Estimate<f64>,
    field: Vec<Value<f64>>,
}

impl LayeredTracker {
    /// For runs to `settings.reach_m`; nothing where the layout does not fit.
    pub fn new(settings: Settings<f64, MODES>) -> Option<Self> {
        let of_share =
            |share: f64| SoundTracker::new(Settings { segment_m: share * settings.reach_m, ..settings });
        Some(Self { followed: FOLLOWED.into_iter().map(of_share).collect::<Option<_>>()? })
    }

    /// Takes a sample; as the estimator's own.
    ///
    /// # Errors
    /// [`Refused`]; the sample is skipped and nothing else changes.
    pub fn update(&mut self, sample: &Sample<f64>) -> Result<Option<Estimate<f64>>, Refused> {
        let mut found = Vec::with_capacity(self.followed.len());
        for tracker in &mut self.followed {
            if let Some(estimate) = tracker.update(sample)? {
                found.push((estimate, tracker.evidence()));
            }
        }
        let wide = found.iter().map(|(_, evidence)| evidence.wide).fold(f64::INFINITY, f64::min);
        let logs: Vec<f64> = found.iter().map(|(_, evidence)| -0.5 * evidence.squares / wide).collect();
        let estimates: Vec<Estimate<f64>> = found.into_iter().map(|(estimate, _)| estimate).collect();
        Ok(mixed(&estimates, &weights(&logs)))
    }

    /// No more samples: the boundary and what is known beside it.
    pub fn finish(&mut self) -> Option<Layered> {
        let finished: Vec<Option<Estimate<f64>>> =
            self.followed.par_iter_mut().map(|tracker| tracker.finish()).collect();
        let cost = |of: &(&SoundTracker<f64>, f64)| of.0.evidence().cost;
        let reached = self.followed.iter().zip(finished);
        let reached = reached.filter_map(|(tracker, estimate)| Some((tracker, estimate?.depth_m)));
        let (best, reach_m) =
            reached.filter(|(_, depth_m)| *depth_m > 0.0).min_by(|a, b| cost(a).total_cmp(&cost(b)))?;
        let cell_m = best.settings().cell_m;
        let cells = ((reach_m / cell_m).ceil() as usize).min(CELLS);
        let [first, last] = SEARCHED.map(|share| (share * reach_m / cell_m).round().max(1.0) as usize);
        let places: Vec<Option<f64>> =
            (first..=last).map(|cell| Some(cell_m * cell as f64)).chain([None]).collect();
        let candidate = |boundary_m: Option<f64>| {
            let mut tracker = best.resegmented(boundary_m.unwrap_or(2.0 * reach_m));
            let estimate = tracker.finish()?;
            let field = (0..cells).filter_map(|cell| tracker.stiffness_at(cell)).collect();
            Some(Candidate { boundary_m, evidence: tracker.evidence(), estimate, field })
        };
        let found: Vec<Candidate> = places.into_par_iter().filter_map(candidate).collect();
        averaged(&found, reach_m, cell_m)
    }
}

/// The mixture of all places.
fn averaged(found: &[Candidate], reach_m: f64, cell_m: f64) -> Option<Layered> {
    let wide = found.iter().map(|one| one.evidence.wide).fold(f64::INFINITY, f64::min);
    let places = found.iter().filter(|one| one.boundary_m.is_some()).count().max(1) as f64;
    // Even odds for a boundary and for none, and for all places alike.
    let log = |one: &Candidate| {
        let Evidence { cost, occam, .. } = one.evidence;
        let prior = if one.boundary_m.is_some() { -places.ln() } else { 0.0 };
        -0.5 * cost / wide - occam + prior
    };
    let weights = weights(&found.iter().map(log).collect::<Vec<_>>());
    let estimates: Vec<Estimate<f64>> = found.iter().map(|one| one.estimate).collect();
    let estimate = mixed(&estimates, &weights)?;
    let cells = found.iter().map(|one| one.field.len()).min()?;
    let of_cell = |cell: usize| {
        let values: Vec<Value<f64>> = found.iter().filter_map(|one| one.field.get(cell).copied()).collect();
        mixed_stiffness(&values, &weights)
    };
    let field: Vec<Value<f64>> = (0..cells).map(of_cell).collect();
    let boundaries = found.iter().zip(&weights).filter_map(|(one, weight)| Some((one.boundary_m?, *weight)));
    let boundaries: Vec<(f64, f64)> = boundaries.collect();
    let probability: f64 = boundaries.iter().map(|(_, weight)| weight).sum();
    let boundary = (probability >= LIKELY).then(|| located(&boundaries, &field, cell_m)).flatten();
    let boundary = boundary.filter(|found| found.ci95_m[1] - found.ci95_m[0] <= LOCATED * reach_m);
    Some(Layered { estimate, boundary_probability: probability, boundary, field, cell_m })
}

/// Quantiles of the boundary: every place stands for the cell about it.
fn located(boundaries: &[(f64, f64)], field: &[Value<f64>], cell_m: f64) -> Option<Boundary> {
    let total: f64 = boundaries.iter().map(|(_, weight)| weight).sum();
    let quantile = |share: f64| {
        let mut below = 0.0;
        for (place_m, weight) in boundaries {
            let within = weight / total;
            if below + within >= share {
                return place_m + cell_m * ((share - below) / within - 0.5);
            }
            below += within;
        }
        boundaries.last().map_or(f64::NAN, |(place_m, _)| place_m + 0.5 * cell_m)
    };
    let depth_m = quantile(0.5);
    let [low_m, high_m] = [quantile(0.025), quantile(0.975)];
    // Cells well on either side.
    let above = ((low_m / cell_m).floor() as usize).checked_sub(1)?;
    let below = (high_m / cell_m).ceil() as usize;
    let (upper, lower) = (field.get(above)?, field.get(below.min(field.len().checked_sub(1)?))?);
    let stiffness_ratio = lower.value / upper.value;
    Some(Boundary { depth_m, ci95_m: [low_m, high_m], stiffness_ratio })
}

/// Weights that sum to 1 from logarithms.
fn weights(logs: &[f64]) -> Vec<f64> {
    let most = logs.iter().copied().filter(|log| log.is_finite()).fold(f64::NEG_INFINITY, f64::max);
    let raw: Vec<f64> =
        logs.iter().map(|log| if log.is_finite() { (log - most).exp() } else { 0.0 }).collect();
    let total: f64 = raw.iter().sum();
    let even = 1.0 / logs.len().max(1) as f64;
    raw.into_iter().map(|weight| if total > 0.0 { weight / total } else { even }).collect()
}

/// Estimates as one: what they differ by is in the intervals; what is simulated is that of the likeliest.
fn mixed(estimates: &[Estimate<f64>], weights: &[f64]) -> Option<Estimate<f64>> {
    let heaviest = weights.iter().zip(estimates).max_by(|a, b| a.0.total_cmp(b.0));
    let (_, first) = heaviest?;
    let stiffness: Vec<Value<f64>> = estimates.iter().map(|one| one.stiffness).collect();
    let damping: Vec<Value<f64>> = estimates.iter().map(|one| one.damping).collect();
    let sum = |of: fn(&Estimate<f64>) -> f64| estimates.iter().zip(weights).map(|(e, w)| w * of(e)).sum();
    Some(Estimate {
        stiffness: mixed_stiffness(&stiffness, weights),
        damping: mixed_damping(&damping, weights, first.damping.seen),
        correlation: sum(|one| one.correlation),
        ..*first
    })
}

/// Stiffness: in logarithms.
fn mixed_stiffness(values: &[Value<f64>], weights: &[f64]) -> Value<f64> {
    let mean: f64 = values.iter().zip(weights).map(|(value, weight)| weight * value.value.ln()).sum();
    let variance: f64 = values
        .iter()
        .zip(weights)
        .map(|(value, weight)| {
            let own = 0.5 * (value.high / value.low).ln() / NORMAL_975;
            weight * (own.powi(2) + (value.value.ln() - mean).powi(2))
        })
        .sum();
    let sd = variance.sqrt();
    let factor = (NORMAL_975 * sd.min(20.0)).exp();
    let seen = if sd < 0.5 { Seen::Yes } else { Seen::No };
    Value { value: mean.exp(), low: mean.exp() / factor, high: mean.exp() * factor, seen }
}

/// Damping, which may be nothing; `seen` is that of the likeliest.
fn mixed_damping(values: &[Value<f64>], weights: &[f64], seen: Seen) -> Value<f64> {
    let sum = |of: &dyn Fn(&Value<f64>) -> f64| -> f64 {
        values.iter().zip(weights).map(|(value, weight)| weight * of(value)).sum()
    };
    let mean = sum(&|value| value.value);
    let apart = |value: &Value<f64>| (NORMAL_975 * (value.value - mean)).powi(2);
    let below = sum(&|value| (value.value - value.low).powi(2) + apart(value)).sqrt();
    let above = sum(&|value| (value.high - value.value).powi(2) + apart(value)).sqrt();
    let low = (mean - below).max(0.0);
    let seen = if seen == Seen::Yes && low <= 0.0 { Seen::AtMost } else { seen };
    Value { value: mean, low, high: mean + above, seen }
}
