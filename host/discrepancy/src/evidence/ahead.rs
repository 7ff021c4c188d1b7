//! Readings that no fit has used, as a model with its discrepancy expects them after the runs that it was fitted to.
//!
//! The amplitudes of the patterns that runs share have a posterior after the residuals of the fitted runs, of mean `mu` and covariance C (in
//! sizes); further runs have amplitudes of their own besides. Readings of such a run are then normal, of mean `Phi s mu` and covariance
//! `I + Phi s C s Phi^T + Phi_own s^2 Phi_own^T`.

use super::{Patterns, scale_columns, sizes_of};
use nalgebra::{DMatrix, DVector};

/// Amplitudes of the patterns that runs share, in sizes of their groups: mean, and a root R of their covariance, `R^T R`.
pub struct SharedAmplitudes {
    mean: DVector<f64>,
    root: DMatrix<f64>,
}

/// Some readings of a run by the density of a model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ahead {
    /// Square of the readings' distance from what is expected, in the metric of their covariance.
    pub square: f64,
    /// Logarithm of the determinant of that covariance, in units of noise.
    pub ln_determinant: f64,
    /// Number of readings.
    pub readings: usize,
}

impl Patterns {
    /// Only the first so many runs.
    #[must_use]
    pub fn of_first(&self, count: usize) -> Self {
        let first_runs = self.runs.iter().take(count).cloned().collect();
        Self::new(self.groups.clone(), self.shared_groups.clone(), first_runs)
    }

    /// Shared amplitudes after whitened residuals of all runs; nothing where a size makes no sense.
    pub fn shared_after(&self, sizes: &[f64], residuals: &[Vec<f64>]) -> Option<SharedAmplitudes> {
        let columns: Vec<DMatrix<f64>> =
            residuals.iter().map(|part| DMatrix::from_column_slice(part.len(), 1, part)).collect();
        let reduced = self.reduced(sizes, &self.products(&columns), 0)?;
        Some(SharedAmplitudes { mean: reduced.root.tr_mul(&reduced.solved.column(0)), root: reduced.root })
    }

    /// These readings of a run, of whitened residuals `residuals`, after what gave the shared amplitudes; nothing where a size makes no
    /// sense.
    pub fn ahead(
        &self,
        run: usize,
        readings: &[usize],
        sizes: &[f64],
        shared: &SharedAmplitudes,
        residuals: &[f64],
    ) -> Option<Ahead> {
        let patterns = self.runs.get(run)?;
        let mut shared_patterns = patterns.shared.select_rows(readings);
        scale_columns(&mut shared_patterns, &sizes_of(&self.shared_groups, sizes));
        let mut run_patterns = patterns.own.select_rows(readings);
        scale_columns(&mut run_patterns, &sizes_of(&patterns.own_groups, sizes));
        let by_root = &shared_patterns * shared.root.transpose();
        let mut covariance = DMatrix::identity(readings.len(), readings.len());
        covariance += &by_root * by_root.transpose() + &run_patterns * run_patterns.transpose();
        let measured = readings.iter().map(|at| residuals.get(*at).copied());
        let measured = DVector::from_vec(measured.collect::<Option<Vec<f64>>>()?);
        let distance = measured - shared_patterns * &shared.mean;
        let factor = covariance.cholesky()?;
        Some(Ahead {
            square: distance.dot(&factor.solve(&distance)),
            ln_determinant: 2.0 * super::ln_diagonal(&factor),
            readings: readings.len(),
        })
    }
}
