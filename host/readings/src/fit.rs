//! Weighted least squares with parameters shared by all blocks of data and nuisances of each block
//! (theory, eq. 25).
//!
//! Levenberg and Marquardt's method on residuals already divided by their standard deviations. Jacobians are central
//! differences, on the way there one-sided ones. The nuisances are eliminated block by block (Schur complement), so the
//! work grows linearly with the number of runs. The covariance is the inverse of `J^T J` of all parameters together,
//! restricted to the shared ones: their uncertainty includes that of the nuisances.

mod normal;

use mechanics::ModelError;
use nalgebra::DMatrix;
pub use normal::bounded_step;
use normal::{Differences, NEAR, NEGLIGIBLE, Normal, Step};

/// Start and range of a parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameter {
    /// Initial value.
    pub start: f64,
    /// Step of the differences.
    pub step: f64,
    /// Least value.
    pub least: f64,
    /// Greatest value.
    pub most: f64,
    /// Prior; of shared parameters only.
    pub prior: Option<Prior>,
}

/// A normal prior.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prior {
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub sd: f64,
}

impl Prior {
    /// Distance from the mean in standard deviations.
    fn residual(&self, value: f64) -> f64 {
        (self.mean - value) / self.sd
    }
}

impl Parameter {
    /// A parameter without bounds.
    pub fn free(start: f64, step: f64) -> Self {
        Self { start, step, least: f64::NEG_INFINITY, most: f64::INFINITY, prior: None }
    }
}

/// One run's data.
pub trait Block {
    /// The model at values of the shared parameters, for any nuisances.
    type Prepared<'a>
    where
        Self: 'a;

    /// Its nuisances.
    fn nuisances(&self) -> Vec<Parameter>;

    /// Computation that does not depend on the nuisances, done once for all of them.
    ///
    /// # Errors
    /// Where the model cannot be evaluated.
    fn prepare(&self, shared: &[f64]) -> Result<Self::Prepared<'_>, ModelError>;

    /// `(measured - predicted) / sigma` of everything measured, always in the same order and number.
    ///
    /// # Errors
    /// Where the model cannot be evaluated.
    fn residuals(&self, ready: &Self::Prepared<'_>, nuisances: &[f64]) -> Result<Vec<f64>, ModelError>;
}

/// The best parameters and what is known about them.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// Shared parameters.
    pub shared: Vec<f64>,
    /// Their covariance, nuisances included.
    pub covariance: DMatrix<f64>,
    /// Nuisances of each block.
    pub nuisances: Vec<Vec<f64>>,
    /// Residuals of each block.
    pub residuals: Vec<Vec<f64>>,
    /// Sum of squared residuals, those of priors included.
    pub chi_square: f64,
    /// Residuals and priors minus parameters.
    pub degrees_of_freedom: usize,
    /// For each shared parameter, whether it lies on a bound.
    pub at_bound: Vec<bool>,
}

/// Why there is no fit.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FitError {
    /// The model cannot be evaluated where it has to be.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// Residuals that are not finite numbers.
    #[error("the residuals are not finite numbers")]
    NotFinite,
    /// The data do not determine the parameters.
    #[error("the data do not determine the parameters")]
    Undetermined,
    /// No minimum within the allowed number of steps.
    #[error("the fit does not converge")]
    NotConverged,
}

const MAX_STEPS: usize = 200;

/// Finds the parameters with the least sum of squared residuals.
///
/// # Errors
/// [`FitError`]: nothing is returned that is not a minimum.
pub fn fit<B: Block>(shared: &[Parameter], blocks: &[B]) -> Result<Fit, FitError> {
    let parameters: Vec<Vec<Parameter>> = blocks.iter().map(Block::nuisances).collect();
    let start = Point {
        shared: shared.iter().map(|p| p.start.clamp(p.least, p.most)).collect(),
        nuisances: parameters.iter().map(|of| of.iter().map(|p| p.start).collect()).collect(),
    };
    let mut best = Tried::at(start, shared, blocks)?;
    let mut damping = 1e-4;
    let mut differences = Differences::OneSided;
    for _ in 0..MAX_STEPS {
        let normal = Normal::at(&best, shared, &parameters, blocks, differences)?;
        loop {
            if damping >= 1e12 {
                return Err(FitError::NotConverged);
            }
            let Some(step) = normal.step(damping, &best.point.shared, shared) else {
                damping *= 10.0;
                continue;
            };
            let next = Tried::at(best.point.moved(&step, shared), shared, blocks);
            let drop = next.as_ref().map_or(f64::NEG_INFINITY, |next| best.chi_square - next.chi_square);
            // A drop far below the unit of chi-square is no progress any more. So little changes no derivative: the equations of the
            // point before are those of this one.
            let settled = drop.abs() <= 1e-8 * (1.0 + 1e-4 * best.chi_square);
            match next {
                Ok(next) if settled && differences == Differences::Central => {
                    return finish(next, normal, shared, &parameters);
                }
                Ok(next) if settled || drop >= 0.0 => {
                    best = next;
                    damping = (damping * 0.1).max(1e-12);
                    if settled || step.is_within(NEAR, shared, &parameters) {
                        differences = Differences::Central;
                    }
                    break;
                }
                // Below the steps of the derivatives the residuals need not be smooth.
                _ if step.is_within(NEGLIGIBLE, shared, &parameters) => {
                    if differences == Differences::Central {
                        return finish(best, normal, shared, &parameters);
                    }
                    differences = Differences::Central;
                    break;
                }
                _ => damping *= 10.0,
            }
        }
    }
    Err(FitError::NotConverged)
}

/// The fit at a point, given its normal equations.
fn finish<B: Block>(
    Tried { point, residuals, chi_square, .. }: Tried<'_, B>,
    normal: Normal,
    shared: &[Parameter],
    parameters: &[Vec<Parameter>],
) -> Result<Fit, FitError> {
    let covariance = normal.covariance().ok_or(FitError::Undetermined)?;
    let priors = shared.iter().filter(|parameter| parameter.prior.is_some()).count();
    let count = residuals.iter().map(Vec::len).sum::<usize>() + priors;
    let unknowns = shared.len() + parameters.iter().map(Vec::len).sum::<usize>();
    let at_bound = point.shared.iter().zip(shared).map(|(value, p)| {
        let slack = 1e-9 * (p.most - p.least).min(1.0);
        *value <= p.least + slack || *value >= p.most - slack
    });
    Ok(Fit {
        at_bound: at_bound.collect(),
        covariance,
        chi_square,
        degrees_of_freedom: count.saturating_sub(unknowns),
        shared: point.shared,
        nuisances: point.nuisances,
        residuals,
    })
}

/// Values of all parameters.
#[derive(Debug, Clone)]
struct Point {
    shared: Vec<f64>,
    nuisances: Vec<Vec<f64>>,
}

impl Point {
    fn prior_squares(&self, shared: &[Parameter]) -> f64 {
        self.shared
            .iter()
            .zip(shared)
            .map(|(value, p)| p.prior.map_or(0.0, |prior| prior.residual(*value).powi(2)))
            .sum()
    }

    fn moved(&self, step: &Step, shared: &[Parameter]) -> Self {
        let mut next = self.clone();
        for ((value, step), p) in next.shared.iter_mut().zip(step.shared.iter()).zip(shared) {
            *value = (*value + step).clamp(p.least, p.most);
        }
        for (values, steps) in next.nuisances.iter_mut().zip(&step.nuisances) {
            values.iter_mut().zip(steps.iter()).for_each(|(value, step)| *value += step);
        }
        next
    }
}

/// A point and how well the data are met there.
struct Tried<'a, B: Block + 'a> {
    point: Point,
    /// The model of each block at the shared parameters.
    ready: Vec<B::Prepared<'a>>,
    residuals: Vec<Vec<f64>>,
    chi_square: f64,
}

impl<'a, B: Block> Tried<'a, B> {
    fn at(point: Point, shared: &[Parameter], blocks: &'a [B]) -> Result<Self, FitError> {
        let ready: Vec<_> =
            blocks.iter().map(|block| block.prepare(&point.shared)).collect::<Result<_, _>>()?;
        let of_blocks = blocks.iter().zip(&ready).zip(&point.nuisances);
        let residuals = of_blocks
            .map(|((block, ready), nuisances)| finite(block.residuals(ready, nuisances)?))
            .collect::<Result<Vec<_>, _>>()?;
        let squares: f64 = residuals.iter().flatten().map(|r| r * r).sum();
        let chi_square = squares + point.prior_squares(shared);
        Ok(Self { point, ready, residuals, chi_square })
    }
}

fn finite(residuals: Vec<f64>) -> Result<Vec<f64>, FitError> {
    // Without an exit from the loop several are examined at once.
    if residuals.iter().fold(true, |all, r| all & r.is_finite()) {
        Ok(residuals)
    } else {
        Err(FitError::NotFinite)
    }
}

#[cfg(test)]
#[path = "fit_tests.rs"]
mod tests;
