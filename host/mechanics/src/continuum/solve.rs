//! Lateral stiffness of an elastic body around a needle, by finite elements of the first circumferential harmonic.
//!
//! `u_r = U cos t`, `u_t = V sin t`, `u_z = W cos t` over the meridian plane; quadratic displacements and a continuous bilinear
//! pressure (Taylor-Hood), so that nothing locks up to a Poisson's ratio of one half. The needle's sections move as rigid discs,
//! `U = u(z)`, `V = -u(z)`, `W = 0` at the wall; what is left after all other unknowns are eliminated is the stiffness against
//! `u` at the nodes of the wall (theory, eq. 17).

use super::mesh::Mesh;
use super::sparse::Sparse;
use crate::ModelError;
use nalgebra::DMatrix;
use std::f64::consts::PI;

/// Stiffness of the body against the needle's deflection, per unit of its Young's modulus.
#[derive(Debug, Clone)]
pub struct WallStiffness {
    /// Depths of the nodes along the needle.
    pub depths_m: Vec<f64>,
    /// Force at each node per deflection of each, metres (N/m per Pa).
    pub matrix_m: DMatrix<f64>,
}

/// An unknown that a degree of freedom stands for.
#[derive(Debug, Clone, Copy)]
pub(super) enum Unknown {
    Fixed,
    /// Sign and index.
    Free(f64, usize),
    /// The needle's deflection at a node of the wall.
    Wall(f64, usize),
}

/// Gauss points on (-1, 1) and weights: three per direction.
const GAUSS: [(f64, f64); 3] =
    [(-0.774_596_669_241_483_4, 5.0 / 9.0), (0.0, 8.0 / 9.0), (0.774_596_669_241_483_4, 5.0 / 9.0)];

/// Solves for the stiffness of a body with this Poisson's ratio.
///
/// # Errors
/// [`ModelError::Singular`] where the equations have no solution.
pub fn wall_stiffness(mesh: &Mesh, poisson: f64) -> Result<WallStiffness, ModelError> {
    let numbering = Numbering::new(mesh);
    let (free, walls) = (numbering.free, numbering.walls);
    let shear = 0.5 / (1.0 + poisson);
    let bulk_compliance = bulk_compliance(poisson);

    let mut inner = Sparse::new(free);
    let mut coupling = DMatrix::zeros(free, walls);
    let mut matrix_m = DMatrix::zeros(walls, walls);
    for axial in 0..mesh.depths_m.len() - 1 {
        for radial in 0..mesh.radii_m.len() - 1 {
            if mesh.is_needle(radial, axial) {
                continue;
            }
            let unknowns = numbering.of_cell(mesh, radial, axial);
            let cell = cell_matrix(mesh, radial, axial, 1, shear, bulk_compliance);
            for (i, row) in unknowns.iter().enumerate() {
                for (j, column) in unknowns.iter().enumerate() {
                    let value = cell[i][j];
                    match (*row, *column) {
                        (Unknown::Free(a, i), Unknown::Free(b, j)) => inner.add(i, j, a * b * value),
                        (Unknown::Free(a, i), Unknown::Wall(b, j)) => coupling[(i, j)] += a * b * value,
                        (Unknown::Wall(a, i), Unknown::Wall(b, j)) => matrix_m[(i, j)] += a * b * value,
                        _ => {}
                    }
                }
            }
        }
    }
    let eliminated = inner.solve(&coupling)?;
    matrix_m -= coupling.tr_mul(&eliminated);
    // The harmonics' squares over the circumference.
    matrix_m *= PI;
    if matrix_m.iter().all(|value| value.is_finite()) {
        Ok(WallStiffness { depths_m: wall_depths_m(mesh), matrix_m })
    } else {
        Err(ModelError::Singular)
    }
}

/// `1 / lambda` per unit of Young's modulus; nothing for an incompressible body.
pub(super) fn bulk_compliance(poisson: f64) -> f64 {
    (1.0 + poisson) * (1.0 - 2.0 * poisson) / poisson.max(1e-6)
}

/// Nodes along the needle: ends and middles of its cells.
fn wall_depths_m(mesh: &Mesh) -> Vec<f64> {
    let (top, bottom) = mesh.needle;
    let lines = &mesh.depths_m[top..=bottom];
    let mut depths_m: Vec<f64> =
        lines.windows(2).flat_map(|ends| [ends[0], 0.5 * (ends[0] + ends[1])]).collect();
    depths_m.extend(lines.last());
    depths_m
}

/// Unknown of every degree of freedom.
pub(super) struct Numbering {
    /// U, V, W of every node of the quadratic mesh, row by row of depth.
    displacements: Vec<[Unknown; 3]>,
    /// Pressure of every corner.
    pressures: Vec<Unknown>,
    /// Number of free unknowns.
    pub(super) free: usize,
    walls: usize,
}

impl Numbering {
    pub(super) fn new(mesh: &Mesh) -> Self {
        let (columns, rows) = (2 * mesh.radii_m.len() - 1, 2 * mesh.depths_m.len() - 1);
        let (top, bottom) = (2 * mesh.needle.0, 2 * mesh.needle.1);
        let mut free = 0;
        let mut next = || {
            free += 1;
            free - 1
        };
        let full_space = mesh.needle.0 > 0;
        let mut displacements = Vec::with_capacity(columns * rows);
        for row in 0..rows {
            for column in 0..columns {
                let is_boundary = column == columns - 1 || row == rows - 1 || (full_space && row == 0);
                // Inside the needle nothing is assembled, so that its degrees of freedom do not count.
                let on_needle = column <= 2 && (top..=bottom).contains(&row);
                displacements.push(if is_boundary {
                    [Unknown::Fixed; 3]
                } else if on_needle {
                    let node = row - top;
                    [Unknown::Wall(1.0, node), Unknown::Wall(-1.0, node), Unknown::Fixed]
                } else if column == 0 {
                    // On the axis the displacement has one direction at every angle.
                    let index = next();
                    [Unknown::Free(1.0, index), Unknown::Free(-1.0, index), Unknown::Fixed]
                } else {
                    [0; 3].map(|_| Unknown::Free(1.0, next()))
                });
            }
        }
        let mut pressures = Vec::new();
        for _ in &mesh.depths_m {
            for column in 0..mesh.radii_m.len() {
                pressures.push(if column == 0 { Unknown::Fixed } else { Unknown::Free(1.0, next()) });
            }
        }
        Self { displacements, pressures, free, walls: bottom - top + 1 }
    }

    /// The 27 displacements of a cell, node by node, and its 4 pressures.
    pub(super) fn of_cell(&self, mesh: &Mesh, radial: usize, axial: usize) -> [Unknown; 31] {
        mesh.gather(radial, axial, &self.displacements, &self.pressures, Unknown::Fixed)
    }
}

/// Quadratic shape functions on (-1, 1) and their derivatives.
fn quadratic(x: f64) -> ([f64; 3], [f64; 3]) {
    ([0.5 * x * (x - 1.0), 1.0 - x * x, 0.5 * x * (x + 1.0)], [x - 0.5, -2.0 * x, x + 0.5])
}

/// Stiffness of a cell in a circumferential harmonic n, `u_r = U cos nt`, `u_t = V sin nt`, `u_z = W cos nt`, without the integral of
/// the harmonic's square over the circumference: pi, or 2 pi where n is 0.
pub(super) fn cell_matrix(
    mesh: &Mesh,
    radial: usize,
    axial: usize,
    harmonic: usize,
    shear: f64,
    bulk_compliance: f64,
) -> [[f64; 31]; 31] {
    let order = harmonic as f64;
    let (r0, r1) = (mesh.radii_m[radial], mesh.radii_m[radial + 1]);
    let (z0, z1) = (mesh.depths_m[axial], mesh.depths_m[axial + 1]);
    let mut matrix = [[0.0; 31]; 31];
    for (x, weight_x) in GAUSS {
        for (y, weight_y) in GAUSS {
            let r = 0.5 * (r0 + r1) + 0.5 * x * (r1 - r0);
            let weight = weight_x * weight_y * 0.25 * (r1 - r0) * (z1 - z0) * r;
            let ((nr, dnr), (nz, dnz)) = (quadratic(x), quadratic(y));
            // Strains rr, tt, zz, rz, rt, tz and the divergence of every degree of freedom.
            let mut strains = [[0.0; 6]; 27];
            let mut divergence = [0.0; 27];
            for node in 0..9 {
                let (i, j) = (node % 3, node / 3);
                let n = nr[i] * nz[j];
                let by_r = dnr[i] * nz[j] * 2.0 / (r1 - r0);
                let by_z = nr[i] * dnz[j] * 2.0 / (z1 - z0);
                let n_r = n / r;
                strains[3 * node] = [by_r, n_r, 0.0, by_z, -order * n_r, 0.0];
                strains[3 * node + 1] = [0.0, order * n_r, 0.0, 0.0, by_r - n_r, by_z];
                strains[3 * node + 2] = [0.0, 0.0, by_z, by_r, 0.0, -order * n_r];
                divergence[3 * node..3 * node + 3].copy_from_slice(&[by_r + n_r, order * n_r, by_z]);
            }
            let pressure: [f64; 4] = std::array::from_fn(|corner| {
                linear_weight(x, corner % 2 == 1) * linear_weight(y, corner / 2 == 1)
            });
            let moduli = [2.0, 2.0, 2.0, 1.0, 1.0, 1.0].map(|factor| factor * shear * weight);
            for i in 0..27 {
                for j in 0..27 {
                    let energy: f64 = (0..6).map(|k| strains[i][k] * moduli[k] * strains[j][k]).sum();
                    matrix[i][j] += energy;
                }
                for (corner, p) in pressure.iter().enumerate() {
                    matrix[i][27 + corner] += weight * divergence[i] * p;
                    matrix[27 + corner][i] += weight * divergence[i] * p;
                }
            }
            for (a, p) in pressure.iter().enumerate() {
                for (b, q) in pressure.iter().enumerate() {
                    matrix[27 + a][27 + b] -= weight * bulk_compliance * p * q;
                }
            }
        }
    }
    matrix
}

/// Linear shape function of one end, from -1 to 1.
fn linear_weight(at: f64, high: bool) -> f64 {
    0.5 * if high { 1.0 + at } else { 1.0 - at }
}
