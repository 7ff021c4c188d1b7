//! Inverse of the covariance of noise and discrepancy, applied to whole columns.

use super::{Patterns, scale_columns, sizes_of};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// `S^-1` with `S = I + Phi diag(s^2) Phi^T`.
#[derive(Debug)]
pub struct Inverse {
    /// For each run, its readings by all patterns; every pattern is multiplied by the size of its group.
    patterns: Vec<DMatrix<f64>>,
    factor: Cholesky<f64, Dyn>,
}

impl Patterns {
    /// Inverse at these sizes; `None` for an invalid size.
    pub fn inverse(&self, sizes: &[f64]) -> Option<Inverse> {
        let shared = self.shared_groups.len();
        let shared_sizes = sizes_of(&self.shared_groups, sizes);
        let count = shared + self.runs.iter().map(|run| run.own_groups.len()).sum::<usize>();
        let mut normal = DMatrix::identity(count, count);
        let mut run_patterns = Vec::with_capacity(self.runs.len());
        let mut first = shared;
        for run in &self.runs {
            let mut patterns = DMatrix::zeros(run.own.nrows(), count);
            patterns.columns_mut(0, shared).copy_from(&run.shared);
            patterns.columns_mut(first, run.own.ncols()).copy_from(&run.own);
            scale_columns(&mut patterns.columns_mut(0, shared), &shared_sizes);
            let run_sizes = sizes_of(&run.own_groups, sizes);
            scale_columns(&mut patterns.columns_mut(first, run.own.ncols()), &run_sizes);
            first += run.own.ncols();
            normal.gemm_tr(1.0, &patterns, &patterns, 1.0);
            run_patterns.push(patterns);
        }
        Some(Inverse { patterns: run_patterns, factor: normal.cholesky()? })
    }
}

impl Inverse {
    /// Number of basis functions.
    pub fn count(&self) -> usize {
        self.factor.l_dirty().nrows()
    }

    /// Effect of amplitudes, in units of their standard deviations, on the readings of each run.
    pub fn of_amplitudes(&self, amplitudes: &DMatrix<f64>) -> Vec<DMatrix<f64>> {
        self.patterns.iter().map(|patterns| patterns * amplitudes).collect()
    }

    /// `S^-1 C` of columns with one part per run.
    pub fn of(&self, columns: &[DMatrix<f64>]) -> Vec<DMatrix<f64>> {
        let width = columns.first().map_or(0, DMatrix::ncols);
        let mut projections = DMatrix::zeros(self.count(), width);
        for (patterns, part) in self.patterns.iter().zip(columns) {
            projections.gemm_tr(1.0, patterns, part, 1.0);
        }
        let amplitudes = self.factor.solve(&projections);
        self.patterns.iter().zip(columns).map(|(patterns, part)| part - patterns * &amplitudes).collect()
    }

    /// `S^-1 c` of one column with one part per run.
    pub fn of_column(&self, column: &[Vec<f64>]) -> Vec<DVector<f64>> {
        let run_columns: Vec<DMatrix<f64>> =
            column.iter().map(|part| DMatrix::from_column_slice(part.len(), 1, part)).collect();
        self.of(&run_columns).iter().map(|part| part.column(0).into_owned()).collect()
    }

    /// The diagonal of `S^-1`, run by run.
    pub fn diagonal(&self) -> Vec<DVector<f64>> {
        let diagonals = self.patterns.iter().map(|patterns| {
            let mut root = patterns.transpose();
            self.factor.l_dirty().solve_lower_triangular_mut(&mut root);
            DVector::from_iterator(root.ncols(), root.column_iter().map(|column| 1.0 - column.norm_squared()))
        });
        diagonals.collect()
    }
}
