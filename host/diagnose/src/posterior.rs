//! Joint fit of a hypothesis to runs: parameters, sizes of the discrepancy, and the evidence (theory, eq. 62).
//!
//! [`Iteration`] goes to the most probable point, [`Fitted`] is the result with its queries.

mod iteration;
mod quantities;
mod round;

pub(super) use iteration::{Iteration, Problem};
pub(super) use round::{MAX_LN_STEP, Metric, jacobian, misfit, residuals};

use super::evidence::{Patterns, Products};
use super::layout::{HeavyTailedParameter, Layout, Prepared, StatedPlace};
use nalgebra::{DMatrix, DVector};
use readings::FitError;
use round::{in_units, prior_sd, products};

/// Two fits are the same whose values differ by less than this, in posterior standard deviations.
const SAME_SD: f64 = 0.3;
/// Rounds of a fit that has to converge.
pub(super) const MAX_ROUNDS: usize = 25;

/// A fitted hypothesis.
#[derive(Debug, Clone)]
pub(super) struct Fitted {
    pub layout: Layout,
    values: Vec<f64>,
    /// Covariance of the parameters, in the scale of the fits.
    pub covariance: DMatrix<f64>,
    /// Whitened residuals of each run.
    pub residuals: Vec<Vec<f64>>,
    /// Sensitivities of the whitened predictions to the parameters, of each run.
    pub jacobian: Vec<DMatrix<f64>>,
    /// Whether a parameter lies on an end of its range.
    pub at_bound: Vec<bool>,
    /// Size of every group of the discrepancy.
    pub sizes: Vec<f64>,
    /// Logarithm of the evidence by Laplace's method, up to a constant that all layouts share.
    pub log_evidence: f64,
    /// Log evidence at the optimum of the model linearised here: the expected value at convergence.
    pub promised: f64,
    /// Whether the fit has converged: the last step was short, or no step lowered the objective.
    pub settled: bool,
}

/// A point of a fit: the values of the parameters, and the residuals there.
struct Point {
    values: Vec<f64>,
    residuals: Vec<Vec<f64>>,
}

impl Fitted {
    /// Fits a layout to runs in at most this number of iterations.
    ///
    /// # Errors
    /// [`FitError`] where there is no fit.
    pub fn new(
        layout: &Layout,
        runs: &[Prepared],
        patterns: &Patterns,
        starts: &[f64],
        sizes: &[f64],
        rounds: usize,
    ) -> Result<Self, FitError> {
        let problem = Problem { layout, runs, patterns, known: &[] };
        Iteration::new(problem, starts, sizes)?.after(rounds)?.finish()
    }

    /// Logarithm of the evidence, or its expected value at convergence if the fit has not converged.
    pub fn worth(&self) -> f64 {
        if self.settled { self.log_evidence } else { self.promised.max(self.log_evidence) }
    }

    /// Parameter values in the scale of the fits.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Whether another fit of the same layout has converged to the same values, within a small fraction of the standard
    /// deviations.
    pub fn is_at(&self, other: &Self) -> bool {
        self.values
            .iter()
            .zip(&other.values)
            .enumerate()
            .all(|(i, (a, b))| (a - b).abs() <= SAME_SD * self.sd(i).min(other.sd(i)))
    }

    /// Standard deviation of a parameter in the scale of the fits.
    pub fn sd(&self, parameter: usize) -> f64 {
        self.covariance[(parameter, parameter)].sqrt()
    }

    /// Sensitivities of every run's predictions to the parameters, in units of the standard deviations of their priors, and this unit of the
    /// first parameter, the logarithm of the modulus.
    pub fn scaled_jacobian(&self) -> (Vec<DMatrix<f64>>, f64) {
        let sds: Vec<f64> = self.layout.parameters(&self.values).iter().map(prior_sd).collect();
        let mut scaled = self.jacobian.clone();
        for jacobian in &mut scaled {
            jacobian.column_iter_mut().zip(&sds).for_each(|(mut column, sd)| column *= *sd);
        }
        (scaled, sds.first().copied().unwrap_or(0.0))
    }

    /// Scalar products of the parameters' sensitivities, in units of their priors, and of columns (one matrix per run) behind them.
    pub fn products_beside_parameters(&self, patterns: &Patterns, columns: &[DMatrix<f64>]) -> Products {
        let joined = |(jacobian, columns): (DMatrix<f64>, &DMatrix<f64>)| {
            let count = jacobian.ncols();
            let mut joined = jacobian.resize_horizontally(count + columns.ncols(), 0.0);
            joined.columns_mut(count, columns.ncols()).copy_from(columns);
            joined
        };
        let joined: Vec<DMatrix<f64>> =
            self.scaled_jacobian().0.into_iter().zip(columns).map(joined).collect();
        patterns.products(&joined)
    }

    /// Products of the columns in the metric of noise and discrepancy of these sizes, with the parameters projected out, and
    /// the derivative of the fitted logarithm of the modulus along each column.
    pub fn eliminated(
        &self,
        patterns: &Patterns,
        sizes: &[f64],
        products: &Products,
    ) -> Option<(DMatrix<f64>, Vec<f64>)> {
        let parameters = self.layout.parameters(&self.values);
        let count = parameters.len();
        let metric_products = patterns.in_metric(sizes, products)?;
        let remaining_count = metric_products.nrows() - count;
        let mut pattern_block = metric_products.view((0, 0), (count, count)).into_owned();
        for i in 0..count {
            pattern_block[(i, i)] += 1.0;
        }
        let cross_block = metric_products.view((0, count), (count, remaining_count)).into_owned();
        let follow = pattern_block.cholesky()?.solve(&cross_block);
        let mut remaining_block =
            metric_products.view((count, count), (remaining_count, remaining_count)).into_owned();
        remaining_block.gemm_tr(-1.0, &cross_block, &follow, 1.0);
        let modulus_sd = parameters.first().map_or(0.0, prior_sd);
        Some((remaining_block, follow.row(0).iter().map(|step| modulus_sd * step).collect()))
    }

    /// The same fit with the readings of one more run.
    pub fn with_run(&self, residuals: Vec<f64>, jacobian: DMatrix<f64>) -> Self {
        let mut more = self.clone();
        more.residuals.push(residuals);
        more.jacobian.push(jacobian);
        more
    }

    /// Variance of the logarithm of the modulus with a discrepancy of these sizes; `None` for an invalid size.
    pub fn ln_modulus_variance(&self, patterns: &Patterns, sizes: &[f64]) -> Option<f64> {
        let nothing: Vec<DMatrix<f64>> =
            self.residuals.iter().map(|residuals| DMatrix::zeros(residuals.len(), 0)).collect();
        let own = patterns.in_metric(sizes, &self.products_beside_parameters(patterns, &nothing))?;
        let count = own.nrows();
        let covariance = (own + DMatrix::identity(count, count)).cholesky()?.inverse();
        let sd = self.layout.parameters(&self.values).first().map_or(0.0, prior_sd);
        Some(covariance[(0, 0)] * sd * sd)
    }

    /// Residuals of runs, then their change along each column of a root of the parameters' covariance, the Cholesky factor: the joint density
    /// is the same for every root. `None` if the covariance has no factor.
    pub fn with_spread(
        &self,
        residuals: &[Vec<f64>],
        jacobian: &[DMatrix<f64>],
    ) -> Option<Vec<DMatrix<f64>>> {
        let root = self.covariance.clone().cholesky()?.unpack();
        let columns = residuals.iter().zip(jacobian).map(|(residuals, jacobian)| {
            let mut columns = (jacobian * &root).insert_column(0, 0.0);
            columns.set_column(0, &DVector::from_column_slice(residuals));
            columns
        });
        Some(columns.collect())
    }

    /// Derivative of the whitened predictions of other runs with respect to the parameters.
    ///
    /// # Errors
    /// Where the model cannot be evaluated.
    pub fn jacobian_of(
        &self,
        runs: &[Prepared],
        residuals: &[Vec<f64>],
    ) -> Result<Vec<DMatrix<f64>>, FitError> {
        jacobian(&self.layout, runs, &self.values, &self.layout.parameters(&self.values), residuals, &[])
    }

    /// A column (one part per run) with the parameters projected out, in the metric of noise alone.
    pub fn less_parameters(&self, column: &[DVector<f64>]) -> Option<Vec<Vec<f64>>> {
        let parameters = self.layout.parameters(&self.values);
        let sds = DVector::from_iterator(parameters.len(), parameters.iter().map(prior_sd));
        let count = sds.len();
        let (mut normal, mut projection) = (DMatrix::zeros(count, count), DVector::zeros(count));
        for (jacobian, part) in self.jacobian.iter().zip(column) {
            normal.gemm_tr(1.0, jacobian, jacobian, 1.0);
            projection.gemv_tr(1.0, jacobian, part, 1.0);
        }
        let scaled = DMatrix::from_fn(count, count, |i, j| sds[i] * normal[(i, j)] * sds[j]);
        let factor = (scaled + DMatrix::identity(count, count)).cholesky()?;
        let moved = factor.solve(&projection.component_mul(&sds)).component_mul(&sds);
        let reduced_residual = |(jacobian, part): (&DMatrix<f64>, &DVector<f64>)| {
            let residual: DVector<f64> = part - jacobian * &moved;
            residual.data.as_vec().clone()
        };
        Some(self.jacobian.iter().zip(column).map(reduced_residual).collect())
    }

    /// The same fit with intervals that are integrated over the sizes of the discrepancy and include the heavy tails of the
    /// priors.
    pub fn over_sizes(mut self, patterns: &Patterns) -> Self {
        let parameters = self.layout.parameters(&self.values);
        let point = Point { values: self.values.clone(), residuals: self.residuals.clone() };
        let products = products(patterns, &parameters, &point, &self.jacobian);
        if let Some(covariance) = patterns.integrated_covariance(&self.sizes, &products) {
            self.covariance = in_units(&covariance, &parameters);
        }
        self.over_tails()
    }

    /// The same integrated over the heavy tails of priors, for which normal ones stand in a fit. The likelihood of such a
    /// parameter is normal, but its product with a heavy-tailed prior is not; the other parameters follow its mean and variance.
    fn over_tails(mut self) -> Self {
        for HeavyTailedParameter { parameter, center, prior } in self.layout.heavy_tailed() {
            let (value, variance) = (self.values[parameter], self.covariance[(parameter, parameter)]);
            let Some((mean, with_tails)) = prior.moments(value - center, variance) else { continue };
            let mean = center + mean;
            let regression = self.covariance.column(parameter) / variance;
            for (value_of, slope) in self.values.iter_mut().zip(regression.iter()) {
                *value_of += slope * (mean - value);
            }
            self.covariance += &regression * regression.transpose() * (with_tails - variance);
        }
        // The regression is linear and may move a value out of the range of its parameter; therefore the values are clipped.
        let ranges = self.layout.parameters(&self.values);
        for (value, range) in self.values.iter_mut().zip(&ranges) {
            *value = value.clamp(range.least, range.most);
        }
        self
    }

    /// For each stated quantity of the rig, the fraction of the variance of the logarithm of the modulus that would vanish if
    /// it were exactly known; largest first.
    pub fn rests_on(&self, patterns: &Patterns) -> Vec<(&'static str, f64)> {
        let variance = self.covariance[(0, 0)];
        let mut fractions: Vec<(&'static str, f64)> = self
            .layout
            .stated()
            .map(|StatedPlace { parameter, name, .. }| {
                let common = self.covariance[(0, parameter)].powi(2);
                (name, common / (variance * self.covariance[(parameter, parameter)]))
            })
            .collect();
        let parameters = self.layout.parameters(&self.values);
        let point = Point { values: self.values.clone(), residuals: self.residuals.clone() };
        let products = products(patterns, &parameters, &point, &self.jacobian);
        let ln_variance = |sizes: &[f64]| patterns.evidence(sizes, &products).map(|e| e.covariance[(0, 0)]);
        let Some(with_all) = ln_variance(&self.sizes) else { return fractions };
        for (number, group) in patterns.groups.iter().enumerate().filter(|(_, group)| group.tail.is_none()) {
            let mut sizes = self.sizes.clone();
            if let Some(size) = sizes.get_mut(number) {
                *size = 0.0;
            }
            if let Some(reduced_ln) = ln_variance(&sizes) {
                fractions.push((group.name, 1.0 - reduced_ln / with_all));
            }
        }
        fractions.sort_by(|a, b| b.1.total_cmp(&a.1));
        fractions
    }

    /// The same fit with these values and this covariance.
    pub fn with_moments(self, values: Vec<f64>, covariance: DMatrix<f64>) -> Self {
        Self { values, covariance, ..self }
    }

    /// The same fit with sizes and evidence of another one.
    pub fn with_evidence_of(self, other: &Self) -> Self {
        Self { log_evidence: other.log_evidence, sizes: other.sizes.clone(), ..self }
    }
}
