//! Normal equations of a fit: derivatives by differences, nuisances eliminated block by block, and the step that they require.

use super::{Block, FitError, Parameter, Tried, finite};
use mechanics::ModelError;
use nalgebra::{DMatrix, DVector};
use std::borrow::Cow;

/// A step of all parameters.
pub(super) struct Step {
    pub shared: DVector<f64>,
    pub nuisances: Vec<DVector<f64>>,
}

/// A step of this share of a difference is none.
pub(super) const NEGLIGIBLE: f64 = 1e-3;
/// After a step of so many differences the minimum is near: the next one may be the last.
pub(super) const NEAR: f64 = 100.0;

/// Scheme by which derivatives are taken: on the way one-sided differences do, from the point itself, which has
/// been tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Differences {
    OneSided,
    Central,
}

impl Differences {
    /// The two values of a parameter that are distinguished; at a bound only on the inner side.
    fn ends(self, value: f64, Parameter { step, least, most, .. }: &Parameter) -> [f64; 2] {
        match self {
            Self::Central => [(value - step).max(*least), (value + step).min(*most)],
            Self::OneSided if value + step <= *most => [value, value + step],
            Self::OneSided => [value - step, value],
        }
    }
}

impl Step {
    /// Whether every parameter moves by less than so many steps of its differences.
    pub fn is_within(&self, count: f64, shared: &[Parameter], blocks: &[Vec<Parameter>]) -> bool {
        let mut of_blocks = self.nuisances.iter().zip(blocks);
        self.shared.iter().zip(shared).all(|moved| is_small(moved, count))
            && of_blocks.all(|(steps, of)| steps.iter().zip(of).all(|moved| is_small(moved, count)))
    }
}

fn is_small((step, parameter): (&f64, &Parameter), count: f64) -> bool {
    step.abs() < count * parameter.step
}

/// The normal equations of one block.
struct BlockNormal {
    /// Normal matrix of its nuisances.
    own: DMatrix<f64>,
    /// By the shared parameters and, in the last column, the gradient.
    right: DMatrix<f64>,
}

/// The normal equations of all blocks.
pub(super) struct Normal {
    /// Normal matrix of the shared parameters, with the gradient in the last column (and row, as the residuals are one
    /// more column of the Jacobian).
    shared: DMatrix<f64>,
    blocks: Vec<BlockNormal>,
}

impl Normal {
    pub fn at<B: Block>(
        Tried { point, ready, residuals, .. }: &Tried<'_, B>,
        shared: &[Parameter],
        parameters: &[Vec<Parameter>],
        blocks: &[B],
        differences: Differences,
    ) -> Result<Self, FitError> {
        let last = shared.len();
        let mut normal =
            Self { shared: DMatrix::zeros(last + 1, last + 1), blocks: Vec::with_capacity(blocks.len()) };
        for (i, (value, parameter)) in point.shared.iter().zip(shared).enumerate() {
            if let Some(prior) = parameter.prior {
                normal.shared[(i, i)] += prior.sd.powi(-2);
                normal.shared[(i, last)] += prior.residual(*value) / prior.sd;
            }
        }
        let of_blocks = blocks.iter().zip(ready).zip(&point.nuisances).zip(parameters).zip(residuals);
        for ((((block, ready), nuisances), of_block), residuals) in of_blocks {
            let mut by_shared = columns(residuals, &point.shared, shared, differences, |values| {
                block.residuals(&block.prepare(values)?, nuisances)
            })?;
            by_shared.extend_from_slice(residuals);
            let by_shared = DMatrix::from_vec(residuals.len(), last + 1, by_shared);
            let by_own = columns(residuals, nuisances, of_block, differences, |values| {
                block.residuals(ready, values)
            })?;
            let by_own = DMatrix::from_vec(residuals.len(), nuisances.len(), by_own);
            normal.shared.gemm_tr(1.0, &by_shared, &by_shared, 1.0);
            normal.blocks.push(BlockNormal { own: by_own.tr_mul(&by_own), right: by_own.tr_mul(&by_shared) });
        }
        Ok(normal)
    }

    /// The damped step; `None` where the equations are not positive definite. A shared parameter that would leave its range
    /// goes to its bound, and the others go where they are best with it there.
    pub fn step(&self, damping: f64, values: &[f64], parameters: &[Parameter]) -> Option<Step> {
        let (reduced, solved) = self.reduced(damping)?;
        let last = parameters.len();
        let shared = bounded_step(reduced, |i| {
            let (value, Parameter { least, most, .. }) = (values[i], &parameters[i]);
            [least - value, most - value]
        })?;
        let nuisances = solved
            .into_iter()
            .map(|solved| {
                let mut solution = solved.column(last).into_owned();
                solution.gemv(-1.0, &solved.columns(0, last), &shared, 1.0);
                solution
            })
            .collect();
        Some(Step { shared, nuisances })
    }

    pub fn covariance(&self) -> Option<DMatrix<f64>> {
        let (reduced, _) = self.reduced(0.0)?;
        let count = reduced.nrows().saturating_sub(1);
        Some(reduced.resize(count, count, 0.0).cholesky()?.inverse())
    }

    /// The equations of the shared parameters with the nuisances where they are best, and how these follow, block by block.
    fn reduced(&self, damping: f64) -> Option<(DMatrix<f64>, Vec<DMatrix<f64>>)> {
        let mut reduced = damped(&self.shared, damping);
        let mut solved = Vec::with_capacity(self.blocks.len());
        for BlockNormal { own, right } in &self.blocks {
            let follow = damped(own, damping).cholesky()?.solve(right);
            reduced.gemm_tr(-1.0, right, &follow, 1.0);
            solved.push(follow);
        }
        Some((reduced, solved))
    }
}

/// Solves symmetric equations whose last column is their right-hand side (their last row is not used), keeping every
/// step within its room: one that would leave it goes to its end, and the others go where they are best with it there.
/// `None` if they are not positive definite.
pub fn bounded_step(mut equations: DMatrix<f64>, room: impl Fn(usize) -> [f64; 2]) -> Option<DVector<f64>> {
    let last = equations.nrows().checked_sub(1)?;
    loop {
        let matrix = equations.view((0, 0), (last, last)).into_owned();
        let mut step = equations.view((0, last), (last, 1)).column(0).into_owned();
        matrix.cholesky()?.solve_mut(&mut step);
        let limiting = step.iter().enumerate().find(|(i, step)| {
            let [least, most] = room(*i);
            **step < least || **step > most
        });
        let Some((index, step_length)) = limiting else { return Some(step) };
        let [least, most] = room(index);
        // A step that is known: its column moves to the right-hand side. The margin keeps rounding from finding it again.
        let clamped_step = step_length.clamp(least, most) * (1.0 - 1e-12);
        for row in 0..last {
            equations[(row, last)] -= equations[(row, index)] * clamped_step;
            (equations[(row, index)], equations[(index, row)]) = (0.0, 0.0);
        }
        (equations[(index, index)], equations[(index, last)]) = (1.0, clamped_step);
    }
}

fn damped(matrix: &DMatrix<f64>, damping: f64) -> DMatrix<f64> {
    let mut damped = matrix.clone();
    for i in 0..damped.nrows() {
        damped[(i, i)] *= 1.0 + damping;
    }
    damped
}

/// Minus the derivatives of the residuals, which are `here` at the point itself: column by column.
fn columns(
    here: &[f64],
    values: &[f64],
    parameters: &[Parameter],
    differences: Differences,
    residuals: impl Fn(&[f64]) -> Result<Vec<f64>, ModelError>,
) -> Result<Vec<f64>, FitError> {
    let rows = here.len();
    let mut jacobian = Vec::with_capacity(rows * (values.len() + 1));
    let mut shifted = values.to_vec();
    for (column, (value, parameter)) in values.iter().zip(parameters).enumerate() {
        let mut evaluated = |end: f64| {
            if end == *value {
                return Ok(Cow::Borrowed(here));
            }
            shifted[column] = end;
            finite(residuals(&shifted)?).map(Cow::Owned)
        };
        let [lower_value, upper_value] = differences.ends(*value, parameter);
        let (lower_residuals, upper_residuals) = (evaluated(lower_value)?, evaluated(upper_value)?);
        let per_unit = 1.0 / (upper_value - lower_value);
        let pairs = lower_residuals.iter().zip(upper_residuals.iter()).take(rows);
        jacobian.extend(
            pairs.map(|(lower_residuals, upper_residuals)| (lower_residuals - upper_residuals) * per_unit),
        );
        jacobian.resize(rows * (column + 1), 0.0);
        shifted[column] = *value;
    }
    Ok(jacobian)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_beyond_its_room_ends_there_and_the_others_follow() {
        let mean = DVector::from_vec(vec![1.0, -0.5, 0.2]);
        let covariance = DMatrix::from_row_slice(3, 3, &[1.0, 0.8, 0.1, 0.8, 1.0, -0.2, 0.1, -0.2, 0.5]);
        let information = covariance.try_inverse().expect("regular");
        let step = bounded_by([[-10.0, 10.0], [0.0, 10.0], [-10.0, 0.1]], &information, &mean);
        let mut best = (f64::INFINITY, DVector::zeros(3));
        for (a, b, c) in (0..400).flat_map(|a| (0..40).flat_map(move |b| (0..40).map(move |c| (a, b, c)))) {
            let [a, b, c] = [0.005 * f64::from(a), 0.02 * f64::from(b), 0.1 - 0.02 * f64::from(c)];
            let x = DVector::from_vec(vec![a, b, c]);
            if misfit(&x, &mean, &information) < best.0 {
                best = (misfit(&x, &mean, &information), x);
            }
        }
        assert!((&step - &best.1).amax() < 6e-3, "{step} {}", best.1);
        assert!(misfit(&step, &mean, &information) <= best.0 + 1e-9);
        // With room enough nothing ends anywhere.
        assert!((bounded_by([[-10.0, 10.0]; 3], &information, &mean) - mean).amax() < 1e-12);
    }

    /// Beside the best of a fine grid.
    fn misfit(x: &DVector<f64>, mean: &DVector<f64>, information: &DMatrix<f64>) -> f64 {
        (x - mean).dot(&(information * (x - mean)))
    }

    fn bounded_by(room: [[f64; 2]; 3], information: &DMatrix<f64>, mean: &DVector<f64>) -> DVector<f64> {
        let mut equations = information.clone().resize(4, 4, 0.0);
        equations.view_mut((0, 3), (3, 1)).copy_from(&(information * mean));
        bounded_step(equations, |i| room[i]).expect("positive definite")
    }
}
