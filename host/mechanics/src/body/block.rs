//! The needle in a block: the half space's stiffness with what the walls change (theory, eq. 15).
//!
//! The walls are far from the needle beside its radius, so that what they do to it is a smooth field: a displacement
//! along the needle per force on it, which adds to that in the half space, `c = (T^-1 + A) F`. If the needle is not in
//! the middle, a block that bends would move it along its axis too; its guides hold it, and the required force is
//! eliminated.

mod half_space;
mod walls;

use super::table::{MODES, Matrix};
use crate::continuum::operator::{legendre, weights};
use crate::quadrature::points;
use crate::{Block, ModelError, Mounting, check};
use nalgebra::{DMatrix, SMatrix};
use std::collections::HashMap;
use std::f64::consts::PI;
use std::sync::{Arc, LazyLock, PoisonError, RwLock};
use walls::{DEPTHS, Kernel};

/// Panels of ten Gauss points along the needle.
const PANELS: usize = 3;
/// Blocks whose walls are kept; each takes a second, and a few kilobytes.
const BLOCKS_KEPT: usize = 64;
/// Flexibilities that are kept, of a kilobyte each.
const DEPTHS_KEPT: usize = 4000;

/// Flexibility that walls add against the coefficients of lateral forces, that between these and a uniform force along
/// the needle, and that of the latter.
#[derive(Debug, Clone, Copy)]
struct Added {
    lateral: Matrix,
    mixed: [f64; MODES],
    axial: f64,
}

impl Added {
    /// With a needle that is held along its axis, in a half space that gives there by `axial`.
    fn held(&self, axial: f64) -> Matrix {
        let coupled = |i: usize, j: usize| self.mixed[i] * self.mixed[j] / (axial + self.axial);
        std::array::from_fn(|i| std::array::from_fn(|j| self.lateral[i][j] - coupled(i, j)))
    }
}

/// Displacement of a rigid needle along its axis per force in a half space, per unit of Young's modulus (Randolph and Wroth 1978, a pile
/// without its base).
fn axial_per_m(poisson: f64, radius_m: f64, depth_m: f64) -> f64 {
    let reach = (2.5 * (1.0 - poisson) * depth_m / radius_m).max(std::f64::consts::E);
    reach.ln() * (1.0 + poisson) / (PI * depth_m)
}

/// Walls by the shape of the block and Poisson's ratio: blocks of one shape share them, whatever their size.
static KERNELS: LazyLock<RwLock<HashMap<[u64; 6], Arc<Kernel>>>> = LazyLock::new(RwLock::default);
/// Bits of a block's numbers, and of where the body begins and the tip is.
type Key = ([u64; 6], [u64; 2]);

/// Flexibilities by the walls, and where the body begins and the tip is, in lengths of the block.
static FLEXIBILITIES: LazyLock<RwLock<HashMap<Key, Added>>> = LazyLock::new(RwLock::default);

fn key(block: &Block, poisson: f64) -> [u64; 6] {
    let [width, height, length] = block.size_m;
    let [x, y] = block.needle_at_m;
    let walls = 2 * u64::from(block.sides == Mounting::Held) + u64::from(block.far_side == Mounting::Held);
    [
        ratio_bits(width, length),
        ratio_bits(height, length),
        ratio_bits(x, length),
        ratio_bits(y, length),
        poisson.to_bits(),
        walls,
    ]
}

/// Bits of a length over the block's, as part of a key.
fn ratio_bits(m: f64, length: f64) -> u64 {
    (m / length).to_bits()
}

fn kernel(block: &Block, poisson: f64) -> Result<Arc<Kernel>, ModelError> {
    let key = key(block, poisson);
    // No code under the lock can panic.
    if let Some(cached) = KERNELS.read().unwrap_or_else(PoisonError::into_inner).get(&key) {
        return Ok(cached.clone());
    }
    let kernel = Arc::new(Kernel::solve(block, poisson)?);
    let mut cache = KERNELS.write().unwrap_or_else(PoisonError::into_inner);
    if cache.len() >= BLOCKS_KEPT {
        cache.clear();
    }
    cache.insert(key, kernel.clone());
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
    radius_m: f64,
    [from_m, depth_m]: [f64; 2],
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
    let axial = length_m * axial_per_m(poisson, radius_m, depth_m);
    let held_per_m = |unit: &Added| unit.held(axial).map(|row| row.map(|value| value / length_m));
    if let Some(cached) = FLEXIBILITIES.read().unwrap_or_else(PoisonError::into_inner).get(&key) {
        return Ok(held_per_m(cached));
    }
    let kernel = kernel(block, poisson)?;
    let unit = flexibility(&kernel, top, tip);
    let mut cache = FLEXIBILITIES.write().unwrap_or_else(PoisonError::into_inner);
    if cache.len() >= DEPTHS_KEPT {
        cache.clear();
    }
    cache.insert(key, unit);
    Ok(held_per_m(&unit))
}

/// The walls' response against line loads that are Legendre polynomials of unit moment, between two depths.
fn flexibility(kernel: &Kernel, top: f64, tip: f64) -> Added {
    let mut loads = DMatrix::zeros(MODES, kernel.count);
    for panel in 0..PANELS {
        for (x, weight) in points(panel_end(panel), panel_end(panel + 1)) {
            let depth_weights = weights(DEPTHS, kernel.count, top + 0.5 * (1.0 + x) * (tip - top));
            for degree in 0..MODES {
                let [value, _] = legendre(degree, x);
                // Over the length the weights are halves of those over (-1, 1).
                let load = (2 * degree + 1) as f64 * 0.5 * weight * value;
                for (node, share) in depth_weights.iter().enumerate() {
                    loads[(degree, node)] += load * share;
                }
            }
        }
    }
    let count = kernel.count;
    let flexibility_part = |row: usize, column: usize| {
        let response = kernel.response.view((row * count, column * count), (count, count));
        &loads * response * loads.transpose()
    };
    let (lateral, mixed, axial) = (flexibility_part(0, 0), flexibility_part(0, 1), flexibility_part(1, 1));
    Added {
        lateral: std::array::from_fn(|i| std::array::from_fn(|j| lateral[(i, j)])),
        mixed: std::array::from_fn(|i| mixed[(i, 0)]),
        axial: axial[(0, 0)],
    }
}

/// End of a panel of the depth from -1 to 1.
fn panel_end(panel: usize) -> f64 {
    -1.0 + 2.0 * panel as f64 / PANELS as f64
}

/// Stiffness of a body with walls: `(T^-1 + A/E)^-1`, from that of the half space and the flexibility that walls add.
///
/// # Errors
/// [`ModelError::Singular`] where the walls leave no body.
pub(crate) fn with_walls(stiffness: &Matrix, flexibility: &Matrix) -> Result<Matrix, ModelError> {
    let (stiff, added) = (to_matrix(stiffness), to_matrix(flexibility));
    let system = SMatrix::<f64, MODES, MODES>::identity() + stiff * added;
    let solution = system.lu().solve(&stiff).ok_or(ModelError::Singular)?;
    Ok(std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (solution[(i, j)] + solution[(j, i)]))))
}

fn to_matrix(of: &Matrix) -> SMatrix<f64, MODES, MODES> {
    SMatrix::<f64, MODES, MODES>::from_fn(|i, j| of[i][j])
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
