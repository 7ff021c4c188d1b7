//! One iteration of a fit: residuals, sensitivities and their products, the step and its length.

use super::super::evidence::{Elimination, Evidence, Patterns, Products};
use super::super::layout::{Layout, Prepared};
use super::Point;
use nalgebra::{DMatrix, DVector};
use readings::{FitError, Parameter, bounded_step};

/// Longest step of the logarithm of the modulus, and of other parameters in standard deviations of their priors.
pub(crate) const MAX_LN_STEP: f64 = 0.7;
const MAX_STEP_SD: f64 = 1.2;
/// Largest number of halvings of a step.
const MAX_HALVINGS: usize = 5;

/// Converts a covariance from units of the priors to the scale of the fits.
pub(super) fn in_units(covariance: &DMatrix<f64>, parameters: &[Parameter]) -> DMatrix<f64> {
    let sds: Vec<f64> = parameters.iter().map(prior_sd).collect();
    DMatrix::from_fn(sds.len(), sds.len(), |i, j| sds[i] * covariance[(i, j)] * sds[j])
}

/// Standard deviation of the prior; parameters without one have a wide one.
pub(super) fn prior_sd(parameter: &Parameter) -> f64 {
    parameter.prior.map_or(1e3, |prior| prior.sd)
}

/// From the prior mean to a value, in prior standard deviations.
pub(super) fn from_prior(parameter: &Parameter, value: f64) -> f64 {
    parameter.prior.map_or(0.0, |prior| (value - prior.mean) / prior.sd)
}

/// Whitened residuals of every run.
pub(crate) fn residuals(
    layout: &Layout,
    runs: &[Prepared],
    values: &[f64],
) -> Result<Vec<Vec<f64>>, FitError> {
    runs.iter()
        .map(|run| {
            let residuals = run.residuals(layout, values)?;
            if residuals.iter().all(|r| r.is_finite()) { Ok(residuals) } else { Err(FitError::NotFinite) }
        })
        .collect()
}

/// Derivatives of the whitened predictions with respect to the parameters: the known ones of the first parameters, then central differences,
/// which are one-sided at the end of a range.
pub(crate) fn jacobian(
    layout: &Layout,
    runs: &[Prepared],
    values: &[f64],
    parameters: &[Parameter],
    here: &[Vec<f64>],
    known: &[DMatrix<f64>],
) -> Result<Vec<DMatrix<f64>>, FitError> {
    let mut run_columns: Vec<DMatrix<f64>> =
        here.iter().map(|residuals| DMatrix::zeros(residuals.len(), parameters.len())).collect();
    let first = known.first().map_or(0, DMatrix::ncols);
    for (matrix, known) in run_columns.iter_mut().zip(known) {
        matrix.columns_mut(0, first).copy_from(known);
    }
    for (index, parameter) in parameters.iter().enumerate().skip(first) {
        let (lower_end, upper_end) = (
            (values[index] - parameter.step).max(parameter.least),
            (values[index] + parameter.step).min(parameter.most),
        );
        let residuals_at = |value: f64| {
            let mut values = values.to_vec();
            values[index] = value;
            residuals(layout, runs, &values)
        };
        let (lower_residuals, upper_residuals) = (residuals_at(lower_end)?, residuals_at(upper_end)?);
        for ((matrix, lower_residuals), upper_residuals) in
            run_columns.iter_mut().zip(&lower_residuals).zip(&upper_residuals)
        {
            let mut column = matrix.column_mut(index);
            for ((slope, lower_residuals), upper_residuals) in
                column.iter_mut().zip(lower_residuals).zip(upper_residuals)
            {
                *slope = (lower_residuals - upper_residuals) / (upper_end - lower_end);
            }
        }
    }
    Ok(run_columns)
}

/// Scalar products of the sensitivities, in units of the priors, and of the residuals at the prior means.
pub(super) fn products(
    patterns: &Patterns,
    parameters: &[Parameter],
    point: &Point,
    jacobian: &[DMatrix<f64>],
) -> Products {
    let count = parameters.len();
    let sds: Vec<f64> = parameters.iter().map(prior_sd).collect();
    let prior_distances: Vec<f64> =
        parameters.iter().zip(&point.values).map(|(p, v)| from_prior(p, *v)).collect();
    let columns = |(jacobian, residuals): (&DMatrix<f64>, &Vec<f64>)| {
        let mut columns = jacobian.clone().resize_horizontally(count + 1, 0.0);
        let mut last = DVector::from_column_slice(residuals);
        for (j, (sd, prior_distances)) in sds.iter().zip(&prior_distances).enumerate() {
            let mut column = columns.column_mut(j);
            column *= *sd;
            // The residuals at the prior means according to the linearised model.
            last.axpy(*prior_distances, &column, 1.0);
        }
        columns.set_column(count, &last);
        columns
    };
    let columns: Vec<DMatrix<f64>> = jacobian.iter().zip(&point.residuals).map(columns).collect();
    patterns.products(&columns)
}

/// The step to the most probable point of the linearised model within the ranges, shortened if it is too long; `None` if there is none. A
/// parameter that would leave its range stays at the bound, and the others are solved for conditional on that: otherwise a clearance, for
/// example, would compensate for a negative compliance.
pub(super) fn step(parameters: &[Parameter], values: &[f64], evidence: &Evidence) -> Option<Vec<f64>> {
    let count = parameters.len();
    let precision = evidence.covariance.clone().cholesky()?.inverse();
    let prior_distances: Vec<f64> =
        parameters.iter().zip(values).map(|(p, value)| from_prior(p, *value)).collect();
    let gradient = &precision * (&evidence.mean - DVector::from_column_slice(&prior_distances));
    let mut equations = precision.resize(count + 1, count + 1, 0.0);
    equations.view_mut((0, count), (count, 1)).copy_from(&gradient);
    let bounded = bounded_step(equations, |i| {
        [parameters[i].least, parameters[i].most]
            .map(|end| from_prior(&parameters[i], end) - prior_distances[i])
    })?;
    let wanted_steps: Vec<f64> = bounded.iter().zip(parameters).map(|(step, p)| step * prior_sd(p)).collect();
    let limit = |index: usize, p: &Parameter| {
        if index == 0 { MAX_LN_STEP } else { MAX_STEP_SD * prior_sd(p) }
    };
    let step_fraction = wanted_steps
        .iter()
        .zip(parameters)
        .enumerate()
        .map(|(index, (step, p))| limit(index, p) / step.abs().max(f64::MIN_POSITIVE))
        .fold(1.0, f64::min);
    let is_in_range = |((step, p), value): ((&f64, &Parameter), &f64)| {
        (value + step_fraction * step).clamp(p.least, p.most) - value
    };
    Some(wanted_steps.iter().zip(parameters).zip(values).map(is_in_range).collect())
}

/// The metric of noise and discrepancy of some sizes.
pub(crate) struct Metric<'a> {
    patterns: &'a Patterns,
    elimination: Elimination,
}

impl<'a> Metric<'a> {
    /// `None` for an invalid size.
    pub fn new(patterns: &'a Patterns, sizes: &[f64]) -> Option<Self> {
        Some(Self { patterns, elimination: patterns.elimination(sizes)? })
    }

    /// Squares of whitened residuals.
    pub fn misfit(&self, residuals: &[Vec<f64>]) -> f64 {
        let columns: Vec<DMatrix<f64>> =
            residuals.iter().map(|r| DMatrix::from_column_slice(r.len(), 1, r)).collect();
        let products = self.patterns.products(&columns);
        products.among[(0, 0)] - self.elimination.of(&products).norm_squared()
    }

    /// Twice the objective: squares of the residuals and of the distances from the prior means.
    pub(super) fn squares(&self, parameters: &[Parameter], point: &Point) -> f64 {
        let pairs = parameters.iter().zip(&point.values);
        self.misfit(&point.residuals) + pairs.map(|(p, v)| from_prior(p, *v).powi(2)).sum::<f64>()
    }

    /// The same at these values; `None` where the model has no solution.
    pub fn squares_at(&self, layout: &Layout, runs: &[Prepared], values: &[f64]) -> Option<f64> {
        let parameters = layout.parameters(values);
        let point = Point { residuals: residuals(layout, runs, values).ok()?, values: values.to_vec() };
        Some(self.squares(&parameters, &point))
    }
}

/// Squares of whitened residuals in the metric of noise and discrepancy of these sizes.
pub(crate) fn misfit(patterns: &Patterns, sizes: &[f64], residuals: &[Vec<f64>]) -> Option<f64> {
    Some(Metric::new(patterns, sizes)?.misfit(residuals))
}

/// The point after a whole step; `None` if the model has no solution there.
pub(super) fn stepped(layout: &Layout, runs: &[Prepared], from: &Point, step: &[f64]) -> Option<Point> {
    let values: Vec<f64> = from.values.iter().zip(step).map(|(value, step)| value + step).collect();
    Some(Point { residuals: residuals(layout, runs, &values).ok()?, values })
}

/// The first of a step, its half, its quarter and so on that makes the objective smaller; `None` where none does.
pub(super) fn descend(
    layout: &Layout,
    runs: &[Prepared],
    metric: &Metric<'_>,
    parameters: &[Parameter],
    from: &Point,
    step: &[f64],
) -> Option<Point> {
    let squares_before = metric.squares(parameters, from);
    let mut step_fraction = 1.0;
    for _ in 0..=MAX_HALVINGS {
        let values: Vec<f64> =
            from.values.iter().zip(step).map(|(value, step)| value + step_fraction * step).collect();
        step_fraction *= 0.5;
        // A step to values for which the model has no solution was too long.
        let Ok(residuals) = residuals(layout, runs, &values) else { continue };
        let point = Point { values, residuals };
        if metric.squares(parameters, &point) <= squares_before {
            return Some(point);
        }
    }
    None
}
