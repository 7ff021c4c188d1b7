//! Boundary between two layers: posterior of the boundary's depth, over how much the layers vary
//! within (theory, eq. 56).
//!
//! A hypothesis is a depth of the boundary, or none, and a standard deviation of what varies within a layer. The rows
//! of the run are fitted again under each (Gauss-Newton over all rows); weights are those of the evidence by Laplace's
//! method (Bayesian model averaging; Hoeting, Madigan, Raftery and Volinsky, 1999). The variation of layers has to be
//! an unknown too: layers that may vary freely imitate a boundary that is centimetres away, and uniform ones are not
//! what every tissue has.

use super::mixture::{mixed, mixed_stiffness, weights};
use super::online::{CELLS, OnlineTracker};
use estimator::{Estimate, Evidence, Value};
use mechanics::unknowns::tissue::FIELD_VARIATIONS;
use rayon::prelude::*;

/// Boundaries lie between these shares of the depth: beyond them one side is too short for two layers.
const SEARCHED: [f64; 2] = [0.08, 0.92];
/// First places: so many cells apart.
const COARSE_CELLS: f64 = 2.0;
/// Places about the likely ones: so far apart.
const FINE_M: f64 = 1e-3;
/// Likely is a hypothesis with this probability or more; where there are more of them than this, the boundary is not located by
/// finer places either.
const LIKELY_WEIGHT: f64 = 1e-3;
const MAX_REFINED: usize = 16;
/// Probability from which on a boundary is reported: it is more likely than tissue that varies smoothly.
const REPORTED: f64 = 0.5;

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

/// Estimates at the end of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct Layered {
    /// As the estimator gives it.
    pub estimate: Estimate<f64>,
    /// Probability that the tissue jumps somewhere; even odds before the run.
    pub boundary_probability: f64,
    /// Position of the boundary; `None` if no boundary is established.
    pub boundary: Option<Boundary>,
    /// Stiffness of every cell that was reached.
    pub field: Vec<Value<f64>>,
    /// Length of a cell.
    pub cell_m: f64,
}

/// A boundary's depth, if there is one, and the index of its variation.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Hypothesis {
    boundary_m: Option<f64>,
    variation: usize,
}

/// A hypothesis, fitted.
struct Fitted {
    hypothesis: Hypothesis,
    evidence: Evidence<f64>,
    estimate: Estimate<f64>,
    /// Stiffness of the common cells.
    field: Vec<Value<f64>>,
    /// Logarithm of the stiffness below the boundary over that above.
    log_ratio: f64,
}

/// The rows of a run under every hypothesis, from a tracker that has them.
pub(super) fn posterior(tracker: &OnlineTracker<f64>, reach_m: f64) -> Option<Layered> {
    let cell_m = tracker.settings().cell_m;
    let [first_m, last_m] = SEARCHED.map(|share| share * reach_m);
    let count = ((last_m - first_m) / (COARSE_CELLS * cell_m)).ceil().max(1.0) as usize;
    let coarse_m = (last_m - first_m) / count as f64;
    let boundaries = (0..=count).map(|i| Some(first_m + coarse_m * i as f64)).chain([None]);
    let mut fits = fit(
        boundaries
            .flat_map(|boundary_m| {
                (0..FIELD_VARIATIONS.len()).map(move |variation| Hypothesis { boundary_m, variation })
            })
            .collect(),
        reach_m,
        tracker,
    );
    let likely: Vec<Hypothesis> = fits
        .iter()
        .zip(probabilities(&fits, [first_m, last_m]))
        .filter(|(one, weight)| one.hypothesis.boundary_m.is_some() && *weight >= LIKELY_WEIGHT)
        .map(|(one, _)| one.hypothesis)
        .collect();
    if likely.len() <= MAX_REFINED {
        let steps = (coarse_m / FINE_M).ceil().max(1.0) as i32;
        let fine_m = coarse_m / f64::from(steps);
        let mut finer: Vec<Hypothesis> = Vec::new();
        for one in &likely {
            for step in (1 - steps..steps).filter(|step| *step != 0) {
                let Some(boundary_m) = one.boundary_m.map(|at_m| at_m + f64::from(step) * fine_m) else {
                    continue;
                };
                if (first_m..=last_m).contains(&boundary_m)
                    && !finer.iter().any(|other| {
                        other.variation == one.variation
                            && other.boundary_m.is_some_and(|m| (m - boundary_m).abs() < 0.1 * fine_m)
                    })
                {
                    finer.push(Hypothesis { boundary_m: Some(boundary_m), variation: one.variation });
                }
            }
        }
        fits.extend(fit(finer, reach_m, tracker));
    }
    averaged(&fits, [first_m, last_m], cell_m)
}

fn fit(
    hypotheses: Vec<Hypothesis>,
    reach_m: f64,
    tracker: &estimator::Tracker<f64, 5, 60, 18, 256>,
) -> Vec<Fitted> {
    hypotheses.into_par_iter().filter_map(|one| fitted(tracker, one, reach_m)).collect()
}

/// Cells of about the settings' length with a face at the boundary.
fn cell_length_m(cell_m: f64, boundary_m: f64, reach_m: f64) -> f64 {
    let cells = (boundary_m / cell_m - 1e-9).ceil().max(1.0);
    let shorter_m = boundary_m / cells;
    let has_room = shorter_m * CELLS as f64 >= reach_m;
    if has_room || cells < 2.0 { shorter_m } else { boundary_m / (cells - 1.0) }
}

fn fitted(tracker: &OnlineTracker<f64>, hypothesis: Hypothesis, reach_m: f64) -> Option<Fitted> {
    let tracker_cell_m = tracker.settings().cell_m;
    let Hypothesis { boundary_m, variation } = hypothesis;
    let cell_m =
        boundary_m.map_or(tracker_cell_m, |boundary_m| cell_length_m(tracker_cell_m, boundary_m, reach_m));
    let segment_m = boundary_m.unwrap_or(2.0 * reach_m);
    let mut tracker = tracker.resegmented(segment_m, cell_m, FIELD_VARIATIONS.get(variation)?.0.mean());
    let estimate = tracker.finish()?;
    let cells = ((reach_m / tracker_cell_m).ceil() as usize).min(CELLS);
    let field: Vec<Value<f64>> = (0..cells)
        .filter_map(|cell| stiffness_at(tracker_cell_m * (cell as f64 + 0.5), &tracker, cell_m))
        .collect();
    let log_ratio = boundary_m.map_or(Some(0.0), |boundary_m| {
        let [above_value, below_value] =
            [-0.5, 0.5].map(|cells| stiffness_at(boundary_m + cells * cell_m, &tracker, cell_m));
        Some((below_value?.value / above_value?.value).ln())
    })?;
    Some(Fitted { hypothesis, evidence: tracker.evidence(), estimate, field, log_ratio })
}

fn stiffness_at(
    depth_m: f64,
    tracker: &estimator::Tracker<f64, 5, 60, 18, 256>,
    cell_m: f64,
) -> Option<Value<f64>> {
    tracker.stiffness_at(((depth_m / cell_m) as usize).min(CELLS - 1))
}

/// The part of the depth that a place stands for: half the way to its neighbours of the same variation.
fn part_m(found: &[Fitted], index: usize, [first_m, last_m]: [f64; 2]) -> Option<[f64; 2]> {
    let Hypothesis { boundary_m, variation } = found.get(index)?.hypothesis;
    let position_m = boundary_m?;
    let other_boundaries = found.iter().map(|one| one.hypothesis).filter(|one| one.variation == variation);
    let (mut low_m, mut high_m) = (first_m, last_m);
    for other_m in other_boundaries.filter_map(|one| one.boundary_m) {
        if other_m < position_m {
            low_m = low_m.max(0.5 * (other_m + position_m));
        } else if other_m > position_m {
            high_m = high_m.min(0.5 * (other_m + position_m));
        }
    }
    Some([low_m, high_m])
}

/// Probabilities of the hypotheses: even odds for a boundary and for none, and for all depths.
fn probabilities(found: &[Fitted], range_m: [f64; 2]) -> Vec<f64> {
    let wide = found.iter().map(|one| one.evidence.wide).fold(f64::INFINITY, f64::min);
    weights(
        &found
            .iter()
            .enumerate()
            .map(|(index, one)| {
                let Evidence { cost, occam, .. } = one.evidence;
                let range_fraction = part_m(found, index, range_m)
                    .map_or(1.0, |[low, high]| (high - low) / (range_m[1] - range_m[0]));
                let odds = FIELD_VARIATIONS.get(one.hypothesis.variation).map_or(0.0, |(_, odds)| *odds);
                -0.5 * cost / wide - occam + (odds * range_fraction).ln()
            })
            .collect::<Vec<_>>(),
    )
}

/// The mixture of all hypotheses.
fn averaged(found: &[Fitted], range_m: [f64; 2], cell_m: f64) -> Option<Layered> {
    let weights = probabilities(found, range_m);
    let estimates: Vec<Estimate<f64>> = found.iter().map(|one| one.estimate).collect();
    let estimate = mixed(&estimates, &weights)?;
    let cells = found.iter().map(|one| one.field.len()).min()?;
    let field: Vec<Value<f64>> = (0..cells)
        .map(|cell| {
            let values: Vec<Value<f64>> =
                found.iter().filter_map(|one| one.field.get(cell).copied()).collect();
            mixed_stiffness(&values, &weights)
        })
        .collect();
    let weighted_ends: Vec<([f64; 2], f64)> = (0..found.len())
        .zip(&weights)
        .filter_map(|(index, weight)| Some((part_m(found, index, range_m)?, *weight)))
        .collect();
    let probability: f64 = weighted_ends.iter().map(|(_, weight)| weight).sum();
    let boundary = (probability >= REPORTED).then(|| {
        let [low_m, depth_m, high_m] =
            [0.025, 0.5, 0.975].map(|share| quantile(&weighted_ends, share * probability));
        let with_boundary = found.iter().zip(&weights).filter(|(one, _)| one.hypothesis.boundary_m.is_some());
        let log_ratio: f64 = with_boundary.map(|(one, weight)| weight * one.log_ratio).sum();
        Boundary { depth_m, ci95_m: [low_m, high_m], stiffness_ratio: (log_ratio / probability).exp() }
    });
    Some(Layered { estimate, boundary_probability: probability, boundary, field, cell_m })
}

/// Depth above which the boundary lies with probability `share`, each part's probability spread evenly over it.
fn quantile(parts: &[([f64; 2], f64)], share: f64) -> f64 {
    let least_m = parts.iter().map(|([low_m, _], _)| *low_m).fold(f64::INFINITY, f64::min);
    let most_m = parts.iter().map(|([_, high_m], _)| *high_m).fold(f64::NEG_INFINITY, f64::max);
    let (mut low_m, mut high_m) = (least_m, most_m);
    for _ in 0..50 {
        let middle_m = 0.5 * (low_m + high_m);
        if mass_below(middle_m, parts) < share { low_m = middle_m } else { high_m = middle_m }
    }
    0.5 * (low_m + high_m)
}

fn mass_below(depth_m: f64, parts: &[([f64; 2], f64)]) -> f64 {
    parts
        .iter()
        .map(|([low_m, high_m], weight)| {
            let length_m = (high_m - low_m).max(f64::MIN_POSITIVE);
            weight * ((depth_m - low_m) / length_m).clamp(0.0, 1.0)
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_the_mixture_of_even_parts() {
        // A quarter of the probability on 0 to 1, three on 1 to 4.
        let weighted_ranges = [([0.0, 1.0], 0.25), ([1.0, 4.0], 0.75)];
        for (share, expected) in [(0.125, 0.5), (0.25, 1.0), (0.5, 2.0), (1.0, 4.0)] {
            assert!((quantile(&weighted_ranges, share) - expected).abs() < 1e-9, "{share}");
        }
    }

    #[test]
    fn cells_have_a_face_at_the_boundary_and_reach_the_deepest_row() {
        for boundary_mm in [7.0, 18.3, 40.0, 73.1] {
            for reach_mm in [80.0, 119.0] {
                let cell_mm = 1e3 * cell_length_m(2e-3, 1e-3 * boundary_mm, 1e-3 * reach_mm);
                let faces: f64 = boundary_mm / cell_mm;
                assert!((faces - faces.round()).abs() < 1e-9, "{boundary_mm}: {cell_mm}");
                assert!(cell_mm * CELLS as f64 >= reach_mm && cell_mm < 2.8, "{boundary_mm}: {cell_mm}");
            }
        }
    }
}
