//! Evidence and intervals integrated over the sizes of the discrepancy instead of at their most probable values (theory, eq.
//! 61).
//!
//! With `G = M^-1` and `m = G L b` of the evidence, the second derivatives of `-ln Z` with respect to the logarithms of the sizes of
//! groups g and h are
//!
//! `H_gh = 2 d_gh sum_g (G_jj + m_j^2) - 2 sum_gh G_jk^2 - 4 sum_gh m_j G_jk m_k`
//!
//! plus those of the prior. The log evidence integrated over the sizes is smaller by `ln det(H) / 2`, up to a constant (Laplace).
//! Mean and covariance of the parameters depend on the sizes: along each principal axis of H they are evaluated at three points,
//! weighted by the evidence there, and the excess second moments of all axes are added (Rue, Martino and Chopin, "Approximate
//! Bayesian inference for latent Gaussian models by using integrated nested Laplace approximations", 2009).

use super::{Evidence, Patterns, Products, Reduced};
use nalgebra::{DMatrix, DVector};

/// Distance of the outer points on an axis, in standard deviations, and their weight for a normal density (Gauss-Hermite).
const POINT_SD: f64 = 1.732_050_807_568_877_2;
const POINT_WEIGHT: f64 = 1.0 / 6.0;
/// Largest factor between the weight of a point and its weight for a normal density.
const MAX_SKEW: f64 = 4.0;

impl Patterns {
    /// Groups with free sizes, and the second derivatives of minus the log evidence with respect to the logarithms of these sizes.
    fn curvature(&self, sizes: &[f64], products: &Products) -> Option<(Vec<usize>, DMatrix<f64>)> {
        let reduced = self.reduced_beside_residuals(sizes, products)?;
        let free = self.free();
        let curvature = self.curvature_of(sizes, &reduced, &free);
        Some((free, curvature))
    }

    /// The second derivatives after elimination.
    pub(super) fn curvature_of(&self, sizes: &[f64], reduced: &Reduced, free: &[usize]) -> DMatrix<f64> {
        let shared = self.shared_groups.len();
        let kept_count = reduced.root.ncols();
        let parameters = kept_count - shared;
        let covariance = reduced.root.transpose() * &reduced.root;
        let amplitudes = &covariance * reduced.right.column(0);
        let own_count: usize = self.runs.iter().map(|run| run.own_groups.len()).sum();
        // Patterns of runs first, then shared ones.
        let count = own_count + shared;
        let mut by_shared = DMatrix::zeros(own_count, kept_count);
        let mut inverse = DMatrix::zeros(count, count);
        let mut mean = DVector::zeros(count);
        let mut groups = Vec::with_capacity(count);
        for (run, (root, right)) in self.runs.iter().zip(&reduced.runs) {
            let (first, length) = (groups.len(), run.own_groups.len());
            let upper = root.transpose() * right;
            let mut of_run = by_shared.rows_mut(first, length);
            for (column, place) in upper.column_iter().zip(run.places(shared, parameters)) {
                of_run.set_column(place, &column);
            }
            let own_mean = upper.column(upper.ncols() - 1) - of_run * &amplitudes;
            mean.rows_mut(first, length).copy_from(&own_mean);
            inverse.view_mut((first, first), (length, length)).gemm_tr(1.0, root, root, 0.0);
            groups.extend_from_slice(&run.own_groups);
        }
        groups.extend_from_slice(&self.shared_groups);
        let spread = &by_shared * &covariance;
        inverse.view_mut((0, 0), (own_count, own_count)).gemm(1.0, &spread, &by_shared.transpose(), 1.0);
        let shared_spread = spread.columns(0, shared);
        inverse.view_mut((0, own_count), (own_count, shared)).copy_from(&(-shared_spread));
        inverse.view_mut((own_count, 0), (shared, own_count)).copy_from(&(-shared_spread.transpose()));
        inverse
            .view_mut((own_count, own_count), (shared, shared))
            .copy_from(&covariance.view((0, 0), (shared, shared)));
        mean.rows_mut(own_count, shared).copy_from(&amplitudes.rows(0, shared));

        let mut curvature_matrix = DMatrix::zeros(self.groups.len(), self.groups.len());
        for (k, h) in groups.iter().enumerate() {
            let column = inverse.column(k);
            curvature_matrix[(*h, *h)] += 2.0 * (column[k] + mean[k] * mean[k]);
            for (j, g) in groups.iter().enumerate() {
                let value = column[j];
                curvature_matrix[(*g, *h)] -= 2.0 * value * (value + 2.0 * mean[j] * mean[k]);
            }
        }
        let mut curvature =
            DMatrix::from_fn(free.len(), free.len(), |i, j| curvature_matrix[(free[i], free[j])]);
        for (i, g) in free.iter().enumerate() {
            let group = &self.groups[*g];
            let size_ratio = sizes[*g] / group.everyday;
            curvature[(i, i)] += match group.tail {
                Some(tail) if size_ratio >= 1.0 => size_ratio * (2.0 * size_ratio - 1.0) / (tail * tail),
                _ => 1.0 / (group.smaller_sd_ln * group.smaller_sd_ln),
            };
        }
        curvature
    }

    /// Smallest curvature that is used, half of that of the widest prior below its everyday size, `1 / smaller_sd_ln^2`.
    fn min_curvature(&self) -> f64 {
        let widest = self.groups.iter().map(|group| group.smaller_sd_ln).fold(0.0, f64::max);
        0.5 / (widest * widest)
    }

    /// Change of the log evidence by integration over the sizes around their most probable values, up to a constant that all
    /// hypotheses share; `None` for an invalid size. A size that the data determine lowers it more than one whose posterior is as
    /// wide as its prior.
    pub fn ln_volume_of_sizes(&self, sizes: &[f64], products: &Products) -> Option<f64> {
        let (_, curvature) = self.curvature(sizes, products)?;
        if curvature.is_empty() {
            return Some(0.0);
        }
        Some(self.ln_volume(&curvature.symmetric_eigenvalues()))
    }

    /// The same from the eigenvalues of the second derivatives.
    pub(super) fn ln_volume(&self, curvatures: &DVector<f64>) -> f64 {
        let least = self.min_curvature();
        -0.5 * curvatures.iter().map(|value| value.max(least).ln()).sum::<f64>()
    }

    /// Covariance of the parameters, in units of their priors, with the sizes integrated over; that at the most probable sizes
    /// if the integral does not exist.
    pub fn integrated_covariance(&self, sizes: &[f64], products: &Products) -> Option<DMatrix<f64>> {
        let base_evidence = self.evidence(sizes, products)?;
        let Some((free, curvature)) = self.curvature(sizes, products) else {
            return Some(base_evidence.covariance);
        };
        if free.is_empty() {
            return Some(base_evidence.covariance);
        }
        let eigen = curvature.symmetric_eigen();
        let mut total = base_evidence.covariance.clone();
        for (axis, value) in eigen.eigenvectors.column_iter().zip(eigen.eigenvalues.iter()) {
            let sd = value.max(self.min_curvature()).sqrt().recip();
            let points: Vec<(f64, Evidence)> = [-1.0, 1.0]
                .into_iter()
                .filter_map(|sign| {
                    let mut moved = sizes.to_vec();
                    for (group, along) in free.iter().zip(axis.iter()) {
                        moved[*group] *= (sign * POINT_SD * sd * along).exp();
                    }
                    self.evidence(&moved, products)
                })
                .map(|evidence| (POINT_WEIGHT * skew(&base_evidence, &evidence), evidence))
                .collect();
            let weights = 1.0 - 2.0 * POINT_WEIGHT + points.iter().map(|(weight, _)| weight).sum::<f64>();
            for (weight, evidence) in &points {
                total += moments_beyond(&base_evidence, evidence) * (weight / weights);
            }
        }
        let is_valid = total.clone().cholesky().is_some();
        Some(if is_valid { total } else { base_evidence.covariance })
    }
}

/// Ratio of the density at a point to that of the normal approximation.
fn skew(here: &Evidence, there: &Evidence) -> f64 {
    let normal = 0.5 * POINT_SD * POINT_SD;
    (here.minus_ln + normal - there.minus_ln).exp().clamp(MAX_SKEW.recip(), MAX_SKEW)
}

/// Excess of the second moments at a point over the values at the likeliest sizes.
fn moments_beyond(here: &Evidence, there: &Evidence) -> DMatrix<f64> {
    let mean_difference = &there.mean - &here.mean;
    &there.covariance - &here.covariance + &mean_difference * mean_difference.transpose()
}
