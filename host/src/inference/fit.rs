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
}

impl Parameter {
    /// A parameter without bounds.
    pub fn free(start: f64, step: f64) -> Self {
        Self { start, step, least: f64::NEG_INFINITY, most: f64::INFINITY }
    }
}

/// One run's data.
pub trait Block {
    /// Its nuisances.
    fn nuisances(&self) -> Vec<Parameter>;

    /// `(measured - predicted) / sigma` of everything measured, always in the same order and number.
    ///
    /// # Errors
    /// Where the model cannot be evaluated.
    fn residuals(&self, shared: &[f64], nuisances: &[f64]) -> Result<Vec<f64>, ModelError>;
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
    /// Sum of squared residuals.
    pub chi_square: f64,
    /// Residuals minus parameters.
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
    let mut point = Point {
        shared: shared.iter().map(|p| p.start.clamp(p.least, p.most)).collect(),
        nuisances: parameters.iter().map(|of| of.iter().map(|p| p.start).collect()).collect(),
    };
    let mut residuals = point.residuals(blocks)?;
    let mut chi_square = sum_of_squares(&residuals);
    let mut damping = 1e-4;
    for _ in 0..MAX_STEPS {
        let normal = Normal::at(&point, &residuals, shared, &parameters, blocks)?;
        let (mut moved, mut settled) = (false, false);
        while !moved && damping < 1e12 {
            let Some(step) = normal.step(damping) else {
                damping *= 10.0;
                continue;
            };
            let next = point.moved(&step, shared);
            let tried = next.residuals(blocks);
            let value = tried.as_ref().map_or(f64::INFINITY, |residuals| sum_of_squares(residuals));
            // A drop far below the unit of chi-square is no progress any more.
            settled = (chi_square - value).abs() <= 1e-8 * (1.0 + 1e-4 * chi_square);
            if let (true, Ok(tried)) = (value <= chi_square || settled, tried) {
                (point, residuals, chi_square, moved) = (next, tried, value.min(chi_square), true);
                damping = (damping * 0.1).max(1e-12);
            } else {
                damping *= 10.0;
            }
        }
        if settled || !moved {
            return if moved {
                finish(point, shared, &parameters, blocks)
            } else {
                Err(FitError::NotConverged)
            };
        }
    }
    Err(FitError::NotConverged)
}

fn finish<B: Block>(
    point: Point,
    shared: &[Parameter],
    parameters: &[Vec<Parameter>],
    blocks: &[B],
) -> Result<Fit, FitError> {
    let residuals = point.residuals(blocks)?;
    let normal = Normal::at(&point, &residuals, shared, parameters, blocks)?;
    let covariance = normal.covariance().ok_or(FitError::Undetermined)?;
    let count: usize = residuals.iter().map(Vec::len).sum();
    let unknowns = shared.len() + parameters.iter().map(Vec::len).sum::<usize>();
    let at_bound = point.shared.iter().zip(shared).map(|(value, p)| value <= &p.least || value >= &p.most);
    Ok(Fit {
        at_bound: at_bound.collect(),
        covariance,
        chi_square: sum_of_squares(&residuals),
        degrees_of_freedom: count.saturating_sub(unknowns),
        shared: point.shared,
        nuisances: point.nuisances,
        residuals,
    })
}

fn sum_of_squares(residuals: &[Vec<f64>]) -> f64 {
    residuals.iter().flatten().map(|r| r * r).sum()
}

/// Values of all parameters.
#[derive(Debug, Clone)]
struct Point {
    shared: Vec<f64>,
    nuisances: Vec<Vec<f64>>,
}

impl Point {
    fn residuals<B: Block>(&self, blocks: &[B]) -> Result<Vec<Vec<f64>>, FitError> {
        let of_block =
            |(block, nuisances): (&B, &Vec<f64>)| finite(block.residuals(&self.shared, nuisances)?);
        blocks.iter().zip(&self.nuisances).map(of_block).collect()
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

fn finite(residuals: Vec<f64>) -> Result<Vec<f64>, FitError> {
    if residuals.iter().all(|r| r.is_finite()) { Ok(residuals) } else { Err(FitError::NotFinite) }
}

/// A step of all parameters.
struct Step {
    shared: DVector<f64>,
    nuisances: Vec<DVector<f64>>,
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
        point: &Point,
        residuals: &[Vec<f64>],
        shared: &[Parameter],
        parameters: &[Vec<Parameter>],
        blocks: &[B],
    ) -> Result<Self, FitError> {
        let mut normal = Self {
            shared: DMatrix::zeros(shared.len(), shared.len()),
            shared_gradient: DVector::zeros(shared.len()),
            blocks: Vec::with_capacity(blocks.len()),
        };
        for (((block, nuisances), of_block), residuals) in
            blocks.iter().zip(&point.nuisances).zip(parameters).zip(residuals)
        {
            // Minus the derivative of the residuals, one column per parameter.
            let by_shared =
                columns(residuals.len(), &point.shared, shared, |values| block.residuals(values, nuisances))?;
            let by_own = columns(residuals.len(), nuisances, of_block, |values| {
                block.residuals(&point.shared, values)
            })?;
            let residuals = DVector::from_column_slice(residuals);
            normal.shared += by_shared.tr_mul(&by_shared);
            normal.shared_gradient += by_shared.tr_mul(&residuals);
            normal.blocks.push(BlockNormal {
                own: by_own.tr_mul(&by_own),
                cross: by_own.tr_mul(&by_shared),
                own_gradient: by_own.tr_mul(&residuals),
            });
        }
        Ok(normal)
    }

    /// The damped step; nothing where the equations are not positive definite.
    fn step(&self, damping: f64) -> Option<Step> {
        let mut reduced = damped(&self.shared, damping);
        let mut gradient = self.shared_gradient.clone();
        let mut solved = Vec::with_capacity(self.blocks.len());
        for block in &self.blocks {
            let own = damped(&block.own, damping).cholesky()?;
            let (cross, own_gradient) = (own.solve(&block.cross), own.solve(&block.own_gradient));
            reduced -= block.cross.tr_mul(&cross);
            gradient -= block.cross.tr_mul(&own_gradient);
            solved.push((cross, own_gradient));
        }
        let shared = reduced.cholesky()?.solve(&gradient);
        let nuisances = solved.into_iter().map(|(cross, own)| own - cross * &shared).collect();
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
    let mut jacobian = DMatrix::zeros(rows, values.len());
    let mut shifted = values.to_vec();
    for (column, (value, parameter)) in values.iter().zip(parameters).enumerate() {
        let mut at = |value: f64| {
            shifted[column] = value;
            finite(residuals(&shifted)?)
        };
        let (below, above) = (at(value - parameter.step)?, at(value + parameter.step)?);
        for (row, (below, above)) in below.iter().zip(&above).take(rows).enumerate() {
            jacobian[(row, column)] = (below - above) / (2.0 * parameter.step);
        }
        shifted[column] = *value;
    }
    Ok(jacobian)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Exponential decays with a shared rate and an amplitude each, at times 0, 1, ..
    struct Decay(Vec<f64>);

    impl Block for Decay {
        fn nuisances(&self) -> Vec<Parameter> {
            vec![Parameter::free(1.0, 1e-5)]
        }

        fn residuals(&self, shared: &[f64], nuisances: &[f64]) -> Result<Vec<f64>, ModelError> {
            let predicted = |t: usize| nuisances[0] * (-shared[0] * t as f64).exp();
            Ok(self.0.iter().enumerate().map(|(t, y)| (y - predicted(t)) / 0.1).collect())
        }
    }

    const RATE: Parameter = Parameter { start: 2.0, step: 1e-5, least: 0.0, most: 5.0 };

    fn decay(amplitude: f64, rate: f64, count: usize) -> Decay {
        Decay((0..count).map(|t| amplitude * (-rate * t as f64).exp()).collect())
    }

    #[test]
    fn shared_rate_and_own_amplitudes_are_found() {
        let fit = fit(&[RATE], &[decay(3.0, 0.3, 6), decay(-1.0, 0.3, 4)]).expect("fits");
        assert!((fit.shared[0] - 0.3).abs() < 1e-6 && fit.chi_square < 1e-8);
        assert!((fit.nuisances[0][0] - 3.0).abs() < 1e-5 && (fit.nuisances[1][0] + 1.0).abs() < 1e-5);
        assert_eq!((fit.degrees_of_freedom, fit.at_bound[0]), (7, false));
        // The information of the shared rate is the sum of what the runs have after their amplitudes are eliminated.
        let information = |amplitude: f64, count: usize| {
            let e = |t: usize| (-0.3 * t as f64).exp();
            let (mut aa, mut ar, mut rr) = (0.0, 0.0, 0.0);
            for t in 0..count {
                let (by_a, by_r) = (e(t) / 0.1, -amplitude * t as f64 * e(t) / 0.1);
                (aa, ar, rr) = (aa + by_a * by_a, ar + by_a * by_r, rr + by_r * by_r);
            }
            rr - ar * ar / aa
        };
        let expected = 1.0 / (information(3.0, 6) + information(-1.0, 4));
        assert!((fit.covariance[(0, 0)] / expected - 1.0).abs() < 1e-5);
    }

    #[test]
    fn bounds_hold_and_are_reported() {
        let fit = fit(&[Parameter { least: 0.5, ..RATE }], &[decay(3.0, 0.3, 6)]).expect("fits");
        assert_eq!((fit.shared[0], fit.at_bound[0]), (0.5, true));
    }

    #[test]
    fn nonsense_is_an_error() {
        assert_eq!(fit(&[RATE], &[Decay(vec![f64::NAN, 1.0])]), Err(FitError::NotFinite));
        // One point cannot determine rate and amplitude.
        assert!(fit(&[RATE], &[decay(3.0, 0.3, 1)]).is_err());
    }
}
