//! Readings that no fit has used, as a model with its discrepancy expects them after the runs that it was fitted to.
//!
//! The amplitudes of the patterns that runs share have a posterior after the residuals of the fitted runs, of mean `mu` and covariance
//! `R^T R` (in sizes); further runs have amplitudes of their own besides, and the parameters of the model are not known exactly. Where these
//! are off by one standard deviation along an axis of their covariance, residuals change by a column, and `mu` with them. So whitened
//! readings of further runs are `Phi s mu + U a + e`, where e is noise, every entry of a has unit variance, and U has a column for each
//! amplitude of the run, each root of a shared one, and each axis of the parameters.
//!
//! Parts of the runs follow each other, each after the parts before it: with `Lambda = I + sum U^T U` and `eta = sum U^T d` over the parts so far,
//! twice minus the logarithm of the density of all of them is `sum d^T d - eta^T Lambda^-1 eta + ln det Lambda`, and a part is what it adds. So
//! parts add up to the density of all, and what one run has in common, as its zero, counts once: the first part tells of it, the others
//! expect it.

use super::{Patterns, scale_columns, sizes_of};
use nalgebra::{DMatrix, DVector};

/// Amplitudes of the patterns that runs share, in sizes of their groups: mean after every column, and a root R of their covariance, `R^T R`.
pub struct SharedAmplitudes {
    means: DMatrix<f64>,
    root: DMatrix<f64>,
}

/// A run that no fit has used.
#[derive(Debug)]
pub struct FurtherRun {
    /// Its number among those of the patterns.
    pub run: usize,
    /// Its whitened residuals, and what they change by where the parameters are off by one standard deviation along each axis of their
    /// covariance.
    pub columns: DMatrix<f64>,
    /// Readings of every part.
    pub parts: Vec<Vec<usize>>,
}

/// Some readings of a run by the density of a model, after the parts before them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ahead {
    /// Square of the readings' distance from what is expected, in the metric of their covariance.
    pub square: f64,
    /// Logarithm of the determinant of that covariance, in units of noise.
    pub ln_determinant: f64,
    /// Number of readings.
    pub readings: usize,
}

/// Knowledge of the amplitudes a.
struct Known {
    precision: DMatrix<f64>,
    by_precision: DVector<f64>,
}

impl Known {
    fn nothing(count: usize) -> Self {
        Self { precision: DMatrix::identity(count, count), by_precision: DVector::zeros(count) }
    }

    /// With so many further amplitudes before the others.
    fn beside(self, own: usize) -> Self {
        let Self { precision, by_precision } = self;
        let count = own + by_precision.len();
        let mut wider = Self::nothing(count);
        wider.precision.view_mut((own, own), precision.shape()).copy_from(&precision);
        wider.by_precision.rows_mut(own, by_precision.len()).copy_from(&by_precision);
        wider
    }

    fn solved(&self) -> Option<Solved> {
        let factor = self.precision.clone().cholesky()?.unpack();
        let solved = factor.solve_lower_triangular(&self.by_precision)?;
        let ln_determinant = 2.0 * factor.diagonal().map(f64::ln).sum();
        Some(Solved { square: solved.norm_squared(), ln_determinant, factor, solved })
    }
}

/// The same with its factor.
struct Solved {
    /// `eta^T Lambda^-1 eta`, and the logarithm of the determinant of Lambda.
    square: f64,
    ln_determinant: f64,
    factor: DMatrix<f64>,
    solved: DVector<f64>,
}

impl Solved {
    /// Knowledge of the last amplitudes alone.
    fn of_last(&self, last: usize) -> Known {
        let first = self.solved.len() - last;
        let root = self.factor.view((first, first), (last, last));
        Known { precision: root * root.transpose(), by_precision: root * self.solved.rows(first, last) }
    }
}

impl Patterns {
    /// Only the first so many runs.
    #[must_use]
    pub fn of_first(&self, count: usize) -> Self {
        let first_runs = self.runs.iter().take(count).cloned().collect();
        Self::new(self.groups.clone(), self.shared_groups.clone(), first_runs)
    }

    /// Shared amplitudes after whitened columns of all runs, as those of [`FurtherRun::columns`]; nothing where a size makes no sense.
    pub fn shared_after(&self, sizes: &[f64], columns: &[DMatrix<f64>]) -> Option<SharedAmplitudes> {
        let reduced = self.reduced(sizes, &self.products(columns), 0)?;
        Some(SharedAmplitudes { means: reduced.root.tr_mul(&reduced.solved), root: reduced.root })
    }

    /// The parts of further runs, one after the other, after what gave the shared amplitudes; nothing where a size makes no sense.
    pub fn ahead(
        &self,
        sizes: &[f64],
        shared: &SharedAmplitudes,
        further_runs: &[FurtherRun],
    ) -> Option<Vec<Ahead>> {
        let Some(first) = further_runs.first() else { return Some(Vec::new()) };
        let in_common = shared.root.nrows() + first.columns.ncols() - 1;
        let mut knowledge = Known::nothing(in_common);
        let mut all_parts = Vec::new();
        for FurtherRun { run, columns, parts } in further_runs {
            let patterns = self.runs.get(*run)?;
            let mut shared_patterns = patterns.shared.clone();
            scale_columns(&mut shared_patterns, &sizes_of(&self.shared_groups, sizes));
            let mut run_patterns = patterns.own.clone();
            scale_columns(&mut run_patterns, &sizes_of(&patterns.own_groups, sizes));
            let distances = columns - &shared_patterns * &shared.means;
            let own_count = run_patterns.ncols();
            let mut unknowns = run_patterns.resize_horizontally(own_count + in_common, 0.0);
            let roots = shared.root.nrows();
            unknowns.columns_mut(own_count, roots).copy_from(&(shared_patterns * shared.root.transpose()));
            unknowns
                .columns_mut(own_count + roots, in_common - roots)
                .copy_from(&distances.columns(1, in_common - roots));
            knowledge = knowledge.beside(own_count);
            let mut so_far = knowledge.solved()?;
            for readings in parts {
                let part_unknowns = unknowns.select_rows(readings);
                let distance = distances.column(0).select_rows(readings);
                knowledge.precision.gemm_tr(1.0, &part_unknowns, &part_unknowns, 1.0);
                knowledge.by_precision.gemv_tr(1.0, &part_unknowns, &distance, 1.0);
                let with_part = knowledge.solved()?;
                all_parts.push(Ahead {
                    square: distance.norm_squared() - (with_part.square - so_far.square),
                    ln_determinant: with_part.ln_determinant - so_far.ln_determinant,
                    readings: readings.len(),
                });
                so_far = with_part;
            }
            knowledge = so_far.of_last(in_common);
        }
        Some(all_parts)
    }
}
