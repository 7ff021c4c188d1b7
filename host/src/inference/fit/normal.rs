//! Normal equations of a fit: derivatives by differences, nuisances eliminated block by block, and the step that they ask for.

use super::{Block, FitError, Parameter, Tried, finite};
use crate::model::ModelError;
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

/// How derivatives are taken: on the way one-sided differences do, from the point itself, which has been tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Differences {
    OneSided,
    Central,
}

impl Differences {
    /// The two values of a parameter that are told apart; at a bound only on the inner side.
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
        let small = |(step, parameter): (&f64, &Parameter)| step.abs() < count * parameter.step;
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
pub(super) struct Normal {
    shared: DMatrix<f64>,
    shared_gradient: DVector<f64>,
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
            let by_shared = columns(residuals, &point.shared, shared, differences, |values| {
                block.residuals(&block.ready(values)?, nuisances)
            })?;
            let by_own = columns(residuals, nuisances, of_block, differences, |values| {
                block.residuals(ready, values)
            })?;
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
    pub fn step(&self, damping: f64, values: &[f64], parameters: &[Parameter]) -> Option<Step> {
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

    pub fn covariance(&self) -> Option<DMatrix<f64>> {
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

/// Minus the derivatives of the residuals, which are `here` at the point itself.
fn columns(
    here: &[f64],
    values: &[f64],
    parameters: &[Parameter],
    differences: Differences,
    residuals: impl Fn(&[f64]) -> Result<Vec<f64>, ModelError>,
) -> Result<DMatrix<f64>, FitError> {
    let rows = here.len();
    let mut jacobian = Vec::with_capacity(rows * values.len());
    let mut shifted = values.to_vec();
    for (column, (value, parameter)) in values.iter().zip(parameters).enumerate() {
        let mut at = |end: f64| {
            if end == *value {
                return Ok(Cow::Borrowed(here));
            }
            shifted[column] = end;
            finite(residuals(&shifted)?).map(Cow::Owned)
        };
        let [from, to] = differences.ends(*value, parameter);
        let (below, above) = (at(from)?, at(to)?);
        let per_unit = 1.0 / (to - from);
        let pairs = below.iter().zip(above.iter()).take(rows);
        jacobian.extend(pairs.map(|(below, above)| (below - above) * per_unit));
        jacobian.resize(rows * (column + 1), 0.0);
        shifted[column] = *value;
    }
    Ok(DMatrix::from_vec(rows, values.len(), jacobian))
}
