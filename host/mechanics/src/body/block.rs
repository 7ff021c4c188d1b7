//! The needle in a block: the half space's stiffness with what the walls change (theory, eq. 18a).
//!
//! The walls are far from the needle beside its radius, so that what they do to it is a smooth field: a displacement along the needle per
//! force on it, which adds to that in the half space, `c = (T^-1 + A) F`.

mod half_space;
mod walls;

use super::table::{MODES, Matrix};
use crate::continuum::operator::{legendre, weights};
use crate::quadrature::points;
use crate::{Block, ModelError, Mounting, check};
use nalgebra::{DMatrix, SMatrix};
use std::collections::HashMap;
use std::sync::{Arc, LazyLock, PoisonError, RwLock};
use walls::{DEPTHS, Kernel};

/// Panels of ten Gauss points along the needle.
const PANELS: usize = 3;
/// Blocks whose walls are kept; each takes a second, and a few kilobytes.
const BLOCKS_KEPT: usize = 64;
/// Flexibilities that are kept, of a kilobyte each.
const DEPTHS_KEPT: usize = 4000;

/// Walls by the shape of the block and Poisson's ratio: blocks of one shape share them, whatever their size.
static KERNELS: LazyLock<RwLock<HashMap<[u64; 6], Arc<Kernel>>>> = LazyLock::new(RwLock::default);
/// Flexibilities by the walls, and where the body begins and the tip is, in lengths of the block.
/// Bits of a block's numbers, and of a needle's radius and depth.
type Key = ([u64; 6], [u64; 2]);

static FLEXIBILITIES: LazyLock<RwLock<HashMap<Key, Matrix>>> = LazyLock::new(RwLock::default);

fn key(block: &Block, poisson: f64) -> [u64; 6] {
    let [width, height, length] = block.size_m;
    let [x, y] = block.needle_at_m;
    let walls = 2 * u64::from(block.sides == Mounting::Held) + u64::from(block.far_side == Mounting::Held);
    let ratio = |m: f64| (m / length).to_bits();
    [ratio(width), ratio(height), ratio(x), ratio(y), poisson.to_bits(), walls]
}

fn kernel(block: &Block, poisson: f64) -> Result<Arc<Kernel>, ModelError> {
    let key = key(block, poisson);
    // Nothing panics under the lock.
    if let Some(known) = KERNELS.read().unwrap_or_else(PoisonError::into_inner).get(&key) {
        return Ok(known.clone());
    }
    let kernel = Arc::new(Kernel::solve(block, poisson)?);
    let mut kept = KERNELS.write().unwrap_or_else(PoisonError::into_inner);
    if kept.len() >= BLOCKS_KEPT {
        kept.clear();
    }
    kept.insert(key, kernel.clone());
    Ok(kernel)
}

/// Flexibility that the walls add against the Legendre coefficients of the forces on a needle from `from_m` to `from_m + depth_m` below
/// the surface, times Young's modulus, 1/m.
///
/// # Errors
/// [`ModelError::OutOfRange`] where the block is none or the tip too near the far side, [`ModelError::Singular`].
pub(crate) fn flexibility_per_m(
    block: &Block,
    poisson: f64,
    from_m: f64,
    depth_m: f64,
) -> Result<Matrix, ModelError> {
    block.check()?;
    let [.., length_m] = block.size_m;
    let (top, tip) = (from_m / length_m, (from_m + depth_m) / length_m);
    check(
        "depth_mm",
        1e3 * (from_m + depth_m),
        "nine tenths of the length of the block (body_mm) or less",
        tip <= Block::DEEPEST * (1.0 + 1e-12),
    )?;
    let key = (key(block, poisson), [top, tip].map(f64::to_bits));
    let per_m = |unit: &Matrix| unit.map(|row| row.map(|value| value / length_m));
    if let Some(known) = FLEXIBILITIES.read().unwrap_or_else(PoisonError::into_inner).get(&key) {
        return Ok(per_m(known));
    }
    let kernel = kernel(block, poisson)?;
    let unit = flexibility(&kernel, top, tip);
    let mut kept = FLEXIBILITIES.write().unwrap_or_else(PoisonError::into_inner);
    if kept.len() >= DEPTHS_KEPT {
        kept.clear();
    }
    kept.insert(key, unit);
    Ok(per_m(&unit))
}

/// The walls' response against line loads that are Legendre polynomials of unit moment, between two depths.
fn flexibility(kernel: &Kernel, top: f64, tip: f64) -> Matrix {
    let mut loads = DMatrix::zeros(MODES, kernel.count);
    for panel in 0..PANELS {
        let end = |panel: usize| -1.0 + 2.0 * panel as f64 / PANELS as f64;
        for (x, weight) in points(end(panel), end(panel + 1)) {
            let at = weights(DEPTHS, kernel.count, top + 0.5 * (1.0 + x) * (tip - top));
            for degree in 0..MODES {
                let [value, _] = legendre(degree, x);
                // Over the length the weights are halves of those over (-1, 1).
                let load = (2 * degree + 1) as f64 * 0.5 * weight * value;
                for (node, share) in at.iter().enumerate() {
                    loads[(degree, node)] += load * share;
                }
            }
        }
    }
    let found = &loads * &kernel.response * loads.transpose();
    std::array::from_fn(|i| std::array::from_fn(|j| found[(i, j)]))
}

/// Stiffness of a body with walls: `(T^-1 + A/E)^-1`, from that of the half space and the flexibility that walls add.
///
/// # Errors
/// [`ModelError::Singular`] where the walls leave no body.
pub(crate) fn with_walls(stiffness: &Matrix, flexibility: &Matrix) -> Result<Matrix, ModelError> {
    let matrix = |of: &Matrix| SMatrix::<f64, MODES, MODES>::from_fn(|i, j| of[i][j]);
    let (stiff, added) = (matrix(stiffness), matrix(flexibility));
    let system = SMatrix::<f64, MODES, MODES>::identity() + stiff * added;
    let found = system.lu().solve(&stiff).ok_or(ModelError::Singular)?;
    Ok(std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (found[(i, j)] + found[(j, i)]))))
}

/// As [`with_walls`], of a body whose stiffness is against deflections at nodes, for which `patterns` has the polynomials (a row per node).
///
/// # Errors
/// As [`with_walls`].
pub(crate) fn nodes_with_walls(
    stiffness: DMatrix<f64>,
    patterns: &DMatrix<f64>,
    flexibility: &Matrix,
) -> Result<DMatrix<f64>, ModelError> {
    let added = DMatrix::from_fn(MODES, MODES, |i, j| flexibility[i][j]);
    let forces = &stiffness * patterns;
    let system = DMatrix::identity(MODES, MODES) + &added * patterns.tr_mul(&forces);
    let eliminated = system.lu().solve(&(added * forces.transpose())).ok_or(ModelError::Singular)?;
    Ok(stiffness - forces * eliminated)
}

#[cfg(test)]
mod tests;
