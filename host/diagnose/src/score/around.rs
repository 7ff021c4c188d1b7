//! The metric of noise and discrepancy around a fit, and scores of directions in it.

use super::directions::{Directions, Hypothesis};
use super::{FitError, Scores};
use crate::evidence::{Elimination, Patterns, Products};
use crate::posterior::Fitted;
use mechanics::effects::Effect;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use std::sync::Arc;

/// Directions of some effects as columns, with their products with each other and with the patterns of the discrepancy. All these are the
/// same for every fit near the one around which they were computed.
#[derive(Debug)]
pub(crate) struct Columns {
    hypotheses: Arc<[(&'static dyn Effect, Vec<Hypothesis>)]>,
    /// Readings of every run by directions.
    of_runs: Vec<DMatrix<f64>>,
    products: Products,
}

impl Columns {
    /// Columns of directions in runs with these patterns.
    pub fn new(directions: Directions, patterns: &Patterns) -> Self {
        let Directions { hypotheses, directions, readings } = directions;
        let of_runs: Vec<DMatrix<f64>> = readings
            .into_iter()
            .enumerate()
            .map(|(run, count)| {
                let values = directions.iter().flat_map(|of_runs| of_runs[run].iter().copied());
                DMatrix::from_iterator(count, directions.len(), values)
            })
            .collect();
        let products = patterns.products(&of_runs);
        Self { hypotheses, of_runs, products }
    }
}

/// A fit in the metric of its noise and discrepancy.
pub(crate) struct Around {
    elimination: Elimination,
    /// Sensitivities of every run's predictions to the parameters, in units of their priors, and the residuals behind them; transposed.
    known: Vec<DMatrix<f64>>,
    /// The same in the coordinates of the patterns.
    known_patterns: DMatrix<f64>,
    /// Posterior precision of the parameters.
    precision: Cholesky<f64, Dyn>,
    /// Products of the parameters' sensitivities and the residuals.
    by_residuals: DVector<f64>,
    modulus_sd: f64,
}

impl Around {
    /// The metric of noise and typical discrepancy, or of a smaller discrepancy if that is the fit's.
    ///
    /// # Errors
    /// Where a size of the discrepancy makes no sense.
    pub fn new(fitted: &Fitted, patterns: &Patterns) -> Result<Self, FitError> {
        let everyday = patterns.everyday();
        let sizes: Vec<f64> = fitted.sizes.iter().zip(everyday).map(|(size, most)| size.min(most)).collect();
        let elimination = patterns.elimination(&sizes).ok_or(FitError::Undetermined)?;
        let (sensitivities, modulus_sd) = fitted.scaled_jacobian();
        let count = sensitivities.first().map_or(0, DMatrix::ncols);
        let known: Vec<DMatrix<f64>> = sensitivities
            .into_iter()
            .zip(&fitted.residuals)
            .map(|(jacobian, residuals)| {
                let mut known = jacobian.insert_column(count, 0.0);
                known.set_column(count, &DVector::from_column_slice(residuals));
                known
            })
            .collect();
        let products = patterns.products(&known);
        let known_patterns = elimination.of(&products);
        let metric = products.among - known_patterns.tr_mul(&known_patterns);
        let precision = metric.view((0, 0), (count, count)) + DMatrix::identity(count, count);
        Ok(Self {
            elimination,
            known: known.iter().map(DMatrix::transpose).collect(),
            known_patterns: known_patterns.transpose(),
            precision: precision.cholesky().ok_or(FitError::Undetermined)?,
            by_residuals: metric.view((0, count), (count, 1)).column(0).into_owned(),
            modulus_sd,
        })
    }

    /// Scores of directions, with the parameters projected out.
    pub fn scores(&self, columns: &Columns) -> Scores {
        let patterns = self.elimination.of(&columns.products);
        let mut gram = columns.products.among.clone();
        gram.gemm(-1.0, &patterns.transpose(), &patterns, 1.0);
        let mut products = -(&self.known_patterns * &patterns);
        for (known, columns) in self.known.iter().zip(&columns.of_runs) {
            products.gemm(1.0, known, columns, 1.0);
        }
        let count = self.by_residuals.len();
        let by_parameters = products.rows(0, count);
        let follow = self.precision.solve(&by_parameters);
        gram.gemm_tr(-1.0, &by_parameters, &follow, 1.0);
        let mut along = products.row(count).transpose();
        along.gemv_tr(-1.0, &follow, &self.by_residuals, 1.0);
        let ln_modulus = follow.row(0).iter().map(|step| self.modulus_sd * step).collect();
        Scores { hypotheses: columns.hypotheses.clone(), gram, along, ln_modulus }
    }
}
