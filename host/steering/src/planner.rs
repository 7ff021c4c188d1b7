//! Guide moves that minimise the expected squared miss at the target, under limits.
//!
//! The tip at the target is `a + sum_j g_j (p_j - p_(j-1))` for positions `p_j` of the guide at the rests to come, linear in them, with
//! `a` and `g` normally distributed by the posterior of each law. The expected squared miss is a quadratic function of the positions:
//! its uncertain part grows with the moves, so that a large move whose gain is not known costs what it may miss. Limits of travel are
//! bounds of single variables: the quadratic program is solved by projected coordinate descent, planes by themselves.

use crate::estimator::AtTarget;
use crate::unknowns::TISSUE;
use nalgebra::DVector;

/// One law with its weight.
pub(crate) struct Weighted<'a> {
    pub weight: f64,
    pub at: &'a AtTarget,
}

/// How it is planned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Weights {
    /// How many times the uncertain part of the squared miss counts.
    pub caution: f64,
    /// Squared miss per squared move.
    pub effort: f64,
}

/// A plan: what is to be moved at every rest, and what comes of it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Plan {
    /// Position of the guide from each rest on, per plane, m.
    pub guide_m: Vec<[f64; 2]>,
    /// Expected tip at the target, m.
    pub tip_m: [f64; 2],
    /// Covariance of the tip there: xx, xy, yy, m^2.
    pub covariance_m2: [f64; 3],
}

/// The plan from where the guide is now, m.
pub(crate) fn plan(
    laws: &[Weighted],
    now_m: [f64; 2],
    target_m: [f64; 2],
    bounds_m: &[[[f64; 2]; 2]],
    weights: Weights,
) -> Plan {
    let holds = laws.first().map_or(0, |law| law.at.gains.len());
    let mut guide_m = vec![now_m; holds];
    for plane in 0..2 {
        // In moves: squared miss 1/2 m' Q m + q' m.
        let mut quadratic = vec![vec![0.0; holds]; holds];
        let mut linear = vec![0.0; holds];
        for law in laws {
            let at = law.at;
            let error_m = at.tip_m[plane] - target_m[plane];
            // Covariance of what is now predicted with the gains, and of the gains.
            let spread: Vec<DVector<f64>> = at.gain_rows.iter().map(|row| spread_of(at, row)).collect();
            for j in 0..holds {
                let own = weights.caution * at.rows[plane].dot(&spread[j]);
                linear[j] += law.weight * (at.gains[j] * error_m + own);
                for ((to, gain_row), gain) in quadratic[j].iter_mut().zip(&at.gain_rows).zip(&at.gains) {
                    let both: f64 = (0..TISSUE).map(|i| gain_row[i] * spread[j][i]).sum();
                    *to += law.weight * (at.gains[j] * gain + weights.caution * both);
                }
            }
        }
        for (j, row) in quadratic.iter_mut().enumerate() {
            row[j] += weights.effort;
        }
        let bounds: Vec<[f64; 2]> = bounds_m.iter().map(|planes| planes[plane]).collect();
        let positions = bounded(&quadratic, &linear, now_m[plane], &bounds);
        guide_m.iter_mut().zip(positions).for_each(|(to, m)| to[plane] = m);
    }
    let (tip_m, covariance_m2) = outcome(laws, now_m, &guide_m);
    Plan { guide_m, tip_m, covariance_m2 }
}

fn spread_of(at: &AtTarget, row: &[f64; TISSUE]) -> DVector<f64> {
    let tissue = DVector::from_column_slice(row);
    at.covariance.columns(0, TISSUE) * tissue
}

/// Tip at the target and its covariance if the guide is moved like this.
pub(crate) fn outcome(laws: &[Weighted], now_m: [f64; 2], guide_m: &[[f64; 2]]) -> ([f64; 2], [f64; 3]) {
    let (mut mean, mut square) = ([0.0; 2], [0.0; 3]);
    for law in laws {
        let at = law.at;
        let mut rows = at.rows.clone();
        let mut tip_m = at.tip_m;
        let mut before_m = now_m;
        for (hold, to_m) in guide_m.iter().enumerate() {
            for plane in 0..2 {
                let moved_m = to_m[plane] - before_m[plane];
                tip_m[plane] += at.gains[hold] * moved_m;
                (0..TISSUE).for_each(|i| rows[plane][i] += at.gain_rows[hold][i] * moved_m);
            }
            before_m = *to_m;
        }
        let spread = [0, 1].map(|plane: usize| &at.covariance * &rows[plane]);
        let covariance = [rows[0].dot(&spread[0]), rows[0].dot(&spread[1]), rows[1].dot(&spread[1])];
        for (i, [a, b]) in [[0, 0], [0, 1], [1, 1]].into_iter().enumerate() {
            square[i] += law.weight * (covariance[i] + tip_m[a] * tip_m[b]);
        }
        (0..2).for_each(|plane| mean[plane] += law.weight * tip_m[plane]);
    }
    let covariance =
        [square[0] - mean[0] * mean[0], square[1] - mean[0] * mean[1], square[2] - mean[1] * mean[1]];
    (mean, covariance)
}

/// Positions that minimise `1/2 m' Q m + q' m` of the moves between them, from `now` on, each within its bounds.
fn bounded(quadratic: &[Vec<f64>], linear: &[f64], now: f64, bounds: &[[f64; 2]]) -> Vec<f64> {
    let count = linear.len();
    let mut positions: Vec<f64> = bounds.iter().map(|[low, high]| now.clamp(*low, *high)).collect();
    let before = |positions: &[f64], j: usize| j.checked_sub(1).map_or(now, |i| positions[i]);
    let mut moves: Vec<f64> = (0..count).map(|j| positions[j] - before(&positions, j)).collect();
    let gradient =
        |moves: &[f64], j: usize| linear[j] + quadratic[j].iter().zip(moves).map(|(q, m)| q * m).sum::<f64>();
    for _ in 0..400 {
        let mut furthest = 0.0_f64;
        for j in 0..count {
            // Raising position j raises move j and lowers move j+1.
            let next = j + 1 < count;
            let slope = gradient(&moves, j) - if next { gradient(&moves, j + 1) } else { 0.0 };
            let curvature = quadratic[j][j]
                + if next { quadratic[j + 1][j + 1] - 2.0 * quadratic[j][j + 1] } else { 0.0 };
            let to = (positions[j] - slope / curvature.max(1e-12)).clamp(bounds[j][0], bounds[j][1]);
            let step = to - positions[j];
            positions[j] = to;
            moves[j] += step;
            if next {
                moves[j + 1] -= step;
            }
            furthest = furthest.max(step.abs());
        }
        // The same for all positions from one rest on, which are moved together as far as the bounds let them.
        for j in 0..count {
            let free = positions[j..].iter().zip(&bounds[j..]);
            let (down, up) = free.fold((f64::NEG_INFINITY, f64::INFINITY), |(down, up), (p, [low, high])| {
                (down.max(low - p), up.min(high - p))
            });
            let step = (-gradient(&moves, j) / quadratic[j][j].max(1e-12)).clamp(down.min(0.0), up.max(0.0));
            positions[j..].iter_mut().for_each(|p| *p += step);
            moves[j] += step;
            furthest = furthest.max(step.abs());
        }
        if furthest < 1e-8 {
            break;
        }
    }
    positions
}

/// Probability that a normally distributed point lies within a radius of the target.
pub(crate) fn probability_within(miss_m: [f64; 2], covariance_m2: [f64; 3], radius_m: f64) -> f64 {
    let [xx, xy, yy] = covariance_m2;
    // Along the axes of the ellipse.
    let half = 0.5 * (xx - yy);
    let root = half.hypot(xy);
    let middle = 0.5 * (xx + yy);
    let sds = [(middle + root).max(1e-16).sqrt(), (middle - root).max(1e-16).sqrt()];
    let turn = 0.5 * xy.atan2(half);
    let (sin, cos) = turn.sin_cos();
    let at = [cos * miss_m[0] + sin * miss_m[1], -sin * miss_m[0] + cos * miss_m[1]];
    // Midpoints over the first axis, exactly over the second.
    let count = 400;
    let [low, high] = [(-radius_m).max(at[0] - 8.0 * sds[0]), radius_m.min(at[0] + 8.0 * sds[0])];
    if high <= low {
        return 0.0;
    }
    let width = (high - low) / f64::from(count);
    (0..count)
        .map(|i| {
            let x = low + width * (f64::from(i) + 0.5);
            let half_chord = (radius_m * radius_m - x * x).max(0.0).sqrt();
            let density =
                (-0.5 * ((x - at[0]) / sds[0]).powi(2)).exp() / (sds[0] * std::f64::consts::TAU.sqrt());
            let below = |y: f64| normal_cdf((y - at[1]) / sds[1]);
            width * density * (below(half_chord) - below(-half_chord))
        })
        .sum::<f64>()
        .clamp(0.0, 1.0)
}

fn normal_cdf(x: f64) -> f64 {
    0.5 * statrs::function::erf::erfc(-x / std::f64::consts::SQRT_2)
}
