//! Predictive density of held-out readings under a model with its discrepancy, given the runs to which it was fitted.
//!
//! Given the residuals of the fitted runs, the amplitudes of the shared functions have a posterior with mean `mu` and
//! covariance `R^T R` (in units of their sizes). A further run also has amplitudes of its own, and the parameters of the model
//! are uncertain: a step along a column of a root of their covariance changes the residuals by a column, and `mu`
//! accordingly. So the whitened readings of further runs are `Phi s mu + U a + e`, where e is noise and a has
//! independent entries of unit variance. U has a column for each amplitude of the run itself, each row of the root R, and
//! each column of the root of the parameters' covariance.
//!
//! The parts of the runs are predicted one after the other, each given the parts before it. With `Lambda = I + sum U^T U` and
//! `eta = sum U^T d` over the parts so far, minus twice the logarithm of their joint density is `sum d^T d - eta^T Lambda^-1
//! eta + ln det Lambda`, and the term of a part is its increment. So the terms add up to the value for all parts, and a common
//! error of a run, such as its zero, counts once: the first part estimates it for the others.

use super::{Patterns, scale_columns, sizes_of};
use nalgebra::{DMatrix, DVector};

/// Posterior of the amplitudes of the shared functions, in units of their sizes: the mean given each column, and a root R of
/// the covariance `R^T R`.
pub struct SharedAmplitudes {
    means: DMatrix<f64>,
    root: DMatrix<f64>,
}

/// A held-out run.
#[derive(Debug)]
pub struct FurtherRun {
    /// Number of the run in the basis.
    pub run: usize,
    /// Its whitened residuals, then their change along each column of a root of the parameters' covariance.
    pub columns: DMatrix<f64>,
    /// Readings of every part.
    pub parts: Vec<Vec<usize>>,
}

/// Predictive density of some readings of a run, given the parts before them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ahead {
    /// Squared Mahalanobis distance of the readings from their expectation.
    pub square: f64,
    /// Logarithm of the determinant of the predictive covariance of the readings, in units of the noise.
    pub ln_determinant: f64,
    /// Number of readings.
    pub readings: usize,
}

/// Posterior of the amplitudes a: its precision Lambda, and the precision times the mean, eta.
struct Known {
    precision: DMatrix<f64>,
    by_precision: DVector<f64>,
}

impl Known {
    fn nothing(count: usize) -> Self {
        Self { precision: DMatrix::identity(count, count), by_precision: DVector::zeros(count) }
    }

    /// The same posterior with `own` further amplitudes, which have their prior, before the others.
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

/// A posterior with the Cholesky factor of its precision.
struct Solved {
    /// `eta^T Lambda^-1 eta`, and the logarithm of the determinant of Lambda.
    square: f64,
    ln_determinant: f64,
    factor: DMatrix<f64>,
    solved: DVector<f64>,
}

impl Solved {
    /// Marginal posterior of the last amplitudes.
    fn of_last(&self, last: usize) -> Known {
        let first = self.solved.len() - last;
        let root = self.factor.view((first, first), (last, last));
        Known { precision: root * root.transpose(), by_precision: root * self.solved.rows(first, last) }
    }
}

impl Patterns {
    /// The patterns of the first `count` runs.
    #[must_use]
    pub fn of_first(&self, count: usize) -> Self {
        let first_runs = self.runs.iter().take(count).cloned().collect();
        Self::new(self.groups.clone(), self.shared_groups.clone(), first_runs)
    }

    /// Posterior of the shared amplitudes given whitened columns of all runs, in the order of [`FurtherRun::columns`]; `None`
    /// for an invalid size.
    pub fn shared_after(&self, sizes: &[f64], columns: &[DMatrix<f64>]) -> Option<SharedAmplitudes> {
        let reduced = self.reduced(sizes, &self.products(columns), 0)?;
        Some(SharedAmplitudes { means: reduced.root.tr_mul(&reduced.solved), root: reduced.root })
    }

    /// Densities of the parts of further runs, one after the other, given the shared amplitudes; `None` for an invalid size.
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
