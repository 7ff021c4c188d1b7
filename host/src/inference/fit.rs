//! Weighted least squares with parameters shared by all blocks of data and nuisances of each block.
//!
//! Levenberg and Marquardt's method on residuals already divided by their standard deviations. Jacobians are central
//! differences. The nuisances are eliminated block by block (Schur complement), so the work grows linearly with the
//! number of runs. The covariance is the inverse of `J^T J` of all parameters together, restricted to the shared ones:
//! their uncertainty includes that of the nuisances.

use crate::model::ModelError;
use nalgebra::{DMatrix, DVector};

/// Where a parameter starts and may go.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameter {
    /// First guess.
    pub start: f64,
    /// Step of the central differences.
    pub step: f64,
    /// Least value.
    pub least: f64,
    /// Greatest value.
    pub most: f64,
    /// What is known of it beforehand; of shared parameters only.
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
    type Ready<'a>
    where
        Self: 'a;

    /// Its nuisances.
    fn nuisances(&self) -> Vec<Parameter>;

    /// What does not depend on the nuisances, done once for all of them.
    ///
    /// # Errors
    /// Where the model cannot be evaluated.
    fn ready(&self, shared: &[f64]) -> Result<Self::Ready<'_>, ModelError>;

    /// `(measured - predicted) / sigma` of everything measured, always in the same order and number.
    ///
    /// # Errors
    /// Where the model cannot be evaluated.
    fn residuals(&self, ready: &Self::Ready<'_>, nuisances: &[f64]) -> Result<Vec<f64>, ModelError>;
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
    for _ in 0..MAX_STEPS {
        let normal = Normal::at(&best, shared, &parameters, blocks)?;
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
                Ok(next) if settled => return finish(next, normal, shared, &parameters),
                Ok(next) if drop >= 0.0 => {
                    best = next;
                    damping = (damping * 0.1).max(1e-12);
                    break;
                }
                // Below the steps of the derivatives the residuals need not be smooth.
                _ if step.is_negligible(shared, &parameters) => {
                    return finish(best, normal, shared, &parameters);
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
        let squared =
            |(value, p): (&f64, &Parameter)| p.prior.map_or(0.0, |prior| prior.residual(*value).powi(2));
        self.shared.iter().zip(shared).map(squared).sum()
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
    ready: Vec<B::Ready<'a>>,
    residuals: Vec<Vec<f64>>,
    chi_square: f64,
}

impl<'a, B: Block> Tried<'a, B> {
    fn at(point: Point, shared: &[Parameter], blocks: &'a [B]) -> Result<Self, FitError> {
        let ready: Vec<_> =
            blocks.iter().map(|block| block.ready(&point.shared)).collect::<Result<_, _>>()?;
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
    // Without a way out of the loop several are looked at at once.
    if residuals.iter().fold(true, |all, r| all & r.is_finite()) {
        Ok(residuals)
    } else {
        Err(FitError::NotFinite)
    }
}

/// A step of all parameters.
struct Step {
    shared: DVector<f64>,
    nuisances: Vec<DVector<f64>>,
}

/// A step of this share of a difference is none.
const NEGLIGIBLE: f64 = 1e-3;

impl Step {
    /// Whether no parameter moves by more than a small share of the step of its differences.
    fn is_negligible(&self, shared: &[Parameter], blocks: &[Vec<Parameter>]) -> bool {
        let small = |(step, parameter): (&f64, &Parameter)| step.abs() < NEGLIGIBLE * parameter.step;
        let mut of_blocks = self.nuisances.iter().zip(blocks);
        self.shared.iter().zip(shared).all(small)
            && of_blocks.all(|(steps, of)| steps.iter().zip(of).all(small))
    }
}

/// The normal equations of one block: `[shared, cross^T; cross, own] step = [shared_gradient; own_gradient]`.
struct BlockNormal {
    own: DMatrix<f64>,
    cross: DMatrix<f64>,
    own_gradient: DVector<f64>,
}

/// The normal equations of all blocks.
struct Normal {
    shared: DMatrix<f64>,
    shared_gradient: DVector<f64>,
    blocks: Vec<BlockNormal>,
}

impl Normal {
    fn at<B: Block>(
        Tried { point, ready, residuals, .. }: &Tried<'_, B>,
        shared: &[Parameter],
        parameters: &[Vec<Parameter>],
        blocks: &[B],
    ) -> Result<Self, FitError> {
        let mut normal = Self {
            shared: DMatrix::zeros(shared.len(), shared.len()),
            shared_gradient: DVector::zeros(shared.len()),
            blocks: Vec::with_capacity(blocks.len()),
        };
        for (i, (value, parameter)) in point.shared.iter().zip(shared).enumerate() {
            if let Some(prior) = parameter.prior {
                normal.shared[(i, i)] += prior.sd.powi(-2);
                normal.shared_gradient[i] += prior.residual(*value) / prior.sd;
            }
        }
        let of_blocks = blocks.iter().zip(ready).zip(&point.nuisances).zip(parameters).zip(residuals);
        for ((((block, ready), nuisances), of_block), residuals) in of_blocks {
            // Minus the derivative of the residuals, one column per parameter.
            let by_shared = columns(residuals.len(), &point.shared, shared, |values| {
                block.residuals(&block.ready(values)?, nuisances)
            })?;
            let by_own =
                columns(residuals.len(), nuisances, of_block, |values| block.residuals(ready, values))?;
            let residuals = DVector::from_column_slice(residuals);
            normal.shared.gemm_tr(1.0, &by_shared, &by_shared, 1.0);
            normal.shared_gradient.gemv_tr(1.0, &by_shared, &residuals, 1.0);
            normal.blocks.push(BlockNormal {
                own: by_own.tr_mul(&by_own),
                cross: by_own.tr_mul(&by_shared),
                own_gradient: by_own.tr_mul(&residuals),
            });
        }
        Ok(normal)
    }

    /// The damped step; nothing where the equations are not positive definite. A shared parameter that would leave its range
    /// goes to its bound, and the others go where they are best with it there.
    fn step(&self, damping: f64, values: &[f64], parameters: &[Parameter]) -> Option<Step> {
        let mut reduced = damped(&self.shared, damping);
        let mut gradient = self.shared_gradient.clone();
        let mut solved = Vec::with_capacity(self.blocks.len());
        for block in &self.blocks {
            let own = damped(&block.own, damping).cholesky()?;
            let (cross, own_gradient) = (own.solve(&block.cross), own.solve(&block.own_gradient));
            reduced.gemm_tr(-1.0, &block.cross, &cross, 1.0);
            gradient.gemv_tr(-1.0, &block.cross, &own_gradient, 1.0);
            solved.push((cross, own_gradient));
        }
        let room = values.iter().zip(parameters).map(|(value, p)| [p.least - value, p.most - value]);
        let shared = bounded_step(reduced, gradient, &room.collect::<Vec<_>>())?;
        let of_block = |(cross, mut own): (DMatrix<f64>, DVector<f64>)| {
            own.gemv(-1.0, &cross, &shared, 1.0);
            own
        };
        let nuisances = solved.into_iter().map(of_block).collect();
        Some(Step { shared, nuisances })
    }

    fn covariance(&self) -> Option<DMatrix<f64>> {
        let mut reduced = self.shared.clone();
        for block in &self.blocks {
            reduced -= block.cross.tr_mul(&block.own.clone().cholesky()?.solve(&block.cross));
        }
        Some(reduced.cholesky()?.inverse())
    }
}

/// Solves `matrix step = right`, keeping every step within its room.
fn bounded_step(
    mut matrix: DMatrix<f64>,
    mut right: DVector<f64>,
    room: &[[f64; 2]],
) -> Option<DVector<f64>> {
    loop {
        let step = matrix.clone().cholesky()?.solve(&right);
        let beyond = step.iter().zip(room).position(|(step, [least, most])| step < least || step > most);
        let Some(index) = beyond else { return Some(step) };
        let [least, most] = room[index];
        // A step that is known: its column moves to the right-hand side. The margin keeps rounding from finding it again.
        let known = step[index].clamp(least, most) * (1.0 - 1e-12);
        for row in 0..right.len() {
            right[row] -= matrix[(row, index)] * known;
            (matrix[(row, index)], matrix[(index, row)]) = (0.0, 0.0);
        }
        (matrix[(index, index)], right[index]) = (1.0, known);
    }
}

fn damped(matrix: &DMatrix<f64>, damping: f64) -> DMatrix<f64> {
    let mut damped = matrix.clone();
    for i in 0..damped.nrows() {
        damped[(i, i)] *= 1.0 + damping;
    }
    damped
}

fn columns(
    rows: usize,
    values: &[f64],
    parameters: &[Parameter],
    residuals: impl Fn(&[f64]) -> Result<Vec<f64>, ModelError>,
) -> Result<DMatrix<f64>, FitError> {
    let mut jacobian = Vec::with_capacity(rows * values.len());
    let mut shifted = values.to_vec();
    for (column, (value, parameter)) in values.iter().zip(parameters).enumerate() {
        let mut at = |value: f64| {
            shifted[column] = value;
            finite(residuals(&shifted)?)
        };
        // At a bound only the inner side.
        let from = (value - parameter.step).max(parameter.least);
        let to = (value + parameter.step).min(parameter.most);
        let (below, above) = (at(from)?, at(to)?);
        let per_unit = 1.0 / (to - from);
        jacobian.extend(below.iter().zip(&above).take(rows).map(|(below, above)| (below - above) * per_unit));
        jacobian.resize(rows * (column + 1), 0.0);
        shifted[column] = *value;
    }
    Ok(DMatrix::from_vec(rows, values.len(), jacobian))
}

#[cfg(test)]
#[path = "fit_tests.rs"]
mod tests;
