//! Points of an integration over the posterior: a grid of modulus and gap about each top, and draws of the scales.

use super::candidates::Candidate;
use super::fold::{Fold, Solved, Top};
use super::search;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::sync::Arc;

/// Grid points further behind the best one than this are not used, and so many standard deviations apart are two of them.
const MIN_LN_POINT: f64 = 7.0;
const GRID_SDS: f64 = 1.25;
const MAX_POINTS: usize = 160;
/// Draws of scales and candidate, in pairs on both sides of the likeliest scales; their spread against the posterior's.
const PAIRS: usize = 40;
const SPREAD: f64 = 1.1;
/// Grid points are drawn with this power of their weight: scales that differ from the likeliest make the posterior wider.
const FLATTENED: f64 = 0.6;
/// The draws are always the same.
const SEED: u64 = 20;

/// A point of a grid about a top.
pub(super) struct GridPoint {
    pub solved: Arc<Solved>,
    pub ln: f64,
    /// Logarithm of the area that it stands for.
    pub ln_area: f64,
}

impl Fold<'_> {
    /// Points about the tops, in the principal axes of each, as far as any of them weighs anything.
    pub(super) fn grid(&self, tops: &[Top]) -> Vec<GridPoint> {
        let mut grid: Vec<GridPoint> = Vec::new();
        let mut most = f64::NEG_INFINITY;
        for top in tops {
            let [[a, b], [_, d]] = top.covariance;
            // Lower triangular root of the covariance.
            let first = a.max(0.0).sqrt();
            let slope_ratio = if first > 0.0 { b / first } else { 0.0 };
            let second = (d - slope_ratio * slope_ratio).max(0.0).sqrt();
            let middle = top.solved.candidate;
            let ln_area = [first, second].iter().filter(|sd| **sd > 0.0).map(|sd| (GRID_SDS * sd).ln()).sum();
            let mut open = vec![([0_i32; 2], middle.rear_share)];
            let mut visited: Vec<[i32; 2]> = vec![[0; 2]];
            while let Some((grid_index, rear_share)) = open.pop() {
                let [i, j] = grid_index.map(|i| GRID_SDS * f64::from(i));
                let candidate = Candidate {
                    modulus_ln: middle.modulus_ln + first * i,
                    gap_ln: middle.gap_ln + slope_ratio * i + second * j,
                    rear_share,
                };
                let Some(solved) = self.solve_about_rear(candidate, &top.likeliest) else { continue };
                let ln = self.ln_posterior(&solved, &top.likeliest);
                if ln < most - MIN_LN_POINT || !ln.is_finite() {
                    continue;
                }
                most = most.max(ln);
                let rear_share = solved.candidate.rear_share;
                grid.push(GridPoint { solved: Arc::new(solved), ln, ln_area });
                for (di, dj) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
                    let next = [grid_index[0] + di, grid_index[1] + dj];
                    let is_flat = (di != 0 && first == 0.0) || (dj != 0 && second == 0.0);
                    if !is_flat && !visited.contains(&next) && visited.len() < MAX_POINTS {
                        visited.push(next);
                        // The nearest first, so that those that are omitted are far.
                        open.insert(0, (next, rear_share));
                    }
                }
            }
        }
        grid.retain(|point| point.ln > most - MIN_LN_POINT);
        grid
    }

    /// Draws about the likeliest scales from a normal distribution a little wider than the posterior along each scale, with the
    /// logarithm of its density: points of an integration over the scales by importance sampling.
    pub(super) fn draws(&self, top: &Top) -> Vec<(Vec<f64>, f64)> {
        let active = self.active();
        let sds = search::widths(&self.cost(&top.solved), &top.likeliest, &active);
        let mut rng = ChaCha8Rng::seed_from_u64(SEED);
        let mut draws = Vec::with_capacity(2 * PAIRS);
        for _ in 0..PAIRS {
            let mut z: Vec<f64> = sds.iter().map(|_| StandardNormal.sample(&mut rng)).collect();
            // An unknown that the recordings do not determine stays at its mean.
            z.iter_mut().enumerate().filter(|(i, _)| !active.contains(i)).for_each(|(_, z)| *z = 0.0);
            let ln = -0.5 * z.iter().map(|z: &f64| z * z).sum::<f64>();
            for sign in [-1.0, 1.0] {
                let moved = top.likeliest.iter().zip(&sds).zip(&z);
                draws.push((moved.map(|((x, sd), z)| x + sign * SPREAD * sd * z).collect(), ln));
            }
        }
        draws
    }
}

/// For each point, the sum of the flattened shares up to and including it, and the logarithm of its own.
pub(super) fn cumulative_shares(grid: &[GridPoint]) -> Vec<(f64, f64)> {
    let most = grid.iter().map(flattened).fold(f64::NEG_INFINITY, f64::max);
    let total: f64 = grid.iter().map(|point| (flattened(point) - most).exp()).sum();
    let mut end = 0.0;
    grid.iter()
        .map(|point| {
            let ln = flattened(point) - most - total.ln();
            end += ln.exp();
            (end, ln)
        })
        .collect()
}

/// Logarithm of a cell's mass, made flatter to spread nodes.
fn flattened(point: &GridPoint) -> f64 {
    FLATTENED * (point.ln + point.ln_area)
}
