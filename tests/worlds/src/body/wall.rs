//! Stiffness of an elastic body against a needle in it, by finite elements of the first circumferential harmonic.
//!
//! `u_r = U cos t`, `u_t = V sin t`, `u_z = W cos t`; nine-node quadrilaterals with three pressures of their own
//! (Q2/P-1), which are eliminated element by element, so that the system stays positive definite and nothing locks. The
//! needle's sections are rigid discs that move and tilt: `U = u`, `V = -u`, `W = -r u'` on wall and tip. Elimination of
//! the body's own unknowns leaves its stiffness against `u` and `u'` at the nodes of the wall.

use super::BodyError;
use super::mesh::Mesh;
use nalgebra::{DMatrix, Matrix3, SMatrix, Vector3};
use rsparse::data::Sprs;
use std::f64::consts::PI;

/// Unknowns of an element.
const SIZE: usize = 27;
/// Gauss points on (-1, 1) and weights, three per direction.
const GAUSS: [[f64; 2]; 3] =
    [[-0.774_596_669_241_483_4, 5.0 / 9.0], [0.0, 8.0 / 9.0], [0.774_596_669_241_483_4, 5.0 / 9.0]];
/// The body is never stiffer in volume than by this `1 - 2 nu`: nothing differs in six digits.
const MIN_COMPRESSIBLE: f64 = 2e-5;

/// Stiffness of a body of unit Young's modulus against deflection and slope at the wall's nodes, in the order
/// `u, u'` of one node after the other: m, m^2, m^3.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Wall {
    /// Depths of its nodes below the surface.
    pub depths_m: Vec<f64>,
    /// The stiffness.
    pub stiffness: DMatrix<f64>,
}

/// Kind of a node's displacement: nothing, a multiple of one of the body's own unknowns, or of one of the wall's.
#[derive(Debug, Clone, Copy)]
enum Unknown {
    Fixed,
    Own(f64, usize),
    Wall(f64, usize),
}

/// Solves the body. `modulus` is its Young's modulus over depth, relative.
///
/// # Errors
/// [`BodyError::Singular`].
pub(super) fn solve(mesh: &Mesh, poisson: f64, modulus: &dyn Fn(f64) -> f64) -> Result<Wall, BodyError> {
    let (unknowns, own_count, depths_m) = numbered(mesh);
    let walls = 2 * depths_m.len();
    let rows = 2 * mesh.depths_m.len() - 1;
    let mut entries: Vec<(usize, usize, f64)> = Vec::new();
    let mut coupling = DMatrix::zeros(own_count, walls);
    let mut stiffness = DMatrix::zeros(walls, walls);
    for radial in 0..mesh.radii_m.len() - 1 {
        for axial in 0..mesh.depths_m.len() - 1 {
            if radial < mesh.needle[0] && axial < mesh.needle[1] {
                continue;
            }
            let element =
                element(cell_ends(&mesh.radii_m, radial), cell_ends(&mesh.depths_m, axial), poisson, modulus);
            let element_unknowns: Vec<Unknown> = (0..9)
                .flat_map(|node| unknowns[(2 * radial + node / 3) * rows + 2 * axial + node % 3])
                .collect();
            for (i, row) in element_unknowns.iter().enumerate() {
                for (j, column) in element_unknowns.iter().enumerate() {
                    let value = element[(i, j)];
                    match (*row, *column) {
                        (Unknown::Own(a, i), Unknown::Own(b, j)) => entries.push((j, i, a * b * value)),
                        (Unknown::Own(a, i), Unknown::Wall(b, j)) => coupling[(i, j)] += a * b * value,
                        (Unknown::Wall(a, i), Unknown::Wall(b, j)) => stiffness[(i, j)] += a * b * value,
                        _ => {}
                    }
                }
            }
        }
    }
    let followed = followed(own_count, entries, &coupling)?;
    let folded = coupling.tr_mul(&followed);
    stiffness -= 0.5 * (&folded + folded.transpose());
    // The square of the harmonic over the circumference.
    stiffness *= PI;
    let is_finite = stiffness.iter().all(|value| value.is_finite());
    if is_finite { Ok(Wall { depths_m, stiffness }) } else { Err(BodyError::Singular) }
}

fn cell_ends(lines: &[f64], cell: usize) -> [f64; 2] {
    [lines[cell], lines[cell + 1]]
}

/// Body's own unknowns as functions of those of the wall, by Cholesky. Entries are column, row and value; those at one
/// place add up.
fn followed(
    own: usize,
    mut entries: Vec<(usize, usize, f64)>,
    coupling: &DMatrix<f64>,
) -> Result<DMatrix<f64>, BodyError> {
    entries.sort_unstable_by_key(|(column, row, _)| (*column, *row));
    let mut matrix = Sprs::zeros(own, own, 0);
    let mut last = None;
    for (column, row, value) in entries {
        match matrix.x.last_mut() {
            Some(sum) if last == Some((column, row)) => *sum += value,
            _ => {
                matrix.i.push(row);
                matrix.x.push(value);
                matrix.p[column + 1] += 1;
            }
        }
        last = Some((column, row));
    }
    for column in 0..own {
        matrix.p[column + 1] += matrix.p[column];
    }
    matrix.nzmax = matrix.x.len();
    let mut order = rsparse::schol(&matrix, 0);
    let lower = rsparse::chol(&matrix, &mut order).map_err(|_| BodyError::Singular)?.l;
    let mut solved = DMatrix::zeros(own, coupling.ncols());
    let mut permuted = vec![0.0; own];
    for (from, mut to) in coupling.column_iter().zip(solved.column_iter_mut()) {
        (0..own).for_each(|k| permuted[permuted_row(k, &order.pinv)] = from[k]);
        rsparse::lsolve(&lower, &mut permuted);
        rsparse::ltsolve(&lower, &mut permuted);
        (0..own).for_each(|k| to[k] = permuted[permuted_row(k, &order.pinv)]);
    }
    Ok(solved)
}

fn permuted_row(k: usize, pinv: &Option<Vec<isize>>) -> usize {
    pinv.as_ref().and_then(|to| usize::try_from(to[k]).ok()).unwrap_or(k)
}

/// Unknowns of every node, number of the body's unknowns, and depths of the wall's nodes. Nodes are numbered down each
/// line of the quadratic mesh, and from the axis outwards.
fn numbered(mesh: &Mesh) -> (Vec<[Unknown; 3]>, usize, Vec<f64>) {
    let (radii_m, depths_m) = (with_middles(&mesh.radii_m), with_middles(&mesh.depths_m));
    let [wall, tip] = mesh.needle.map(|cells| 2 * cells);
    let mut own_count = 0;
    let mut next = || {
        own_count += 1;
        own_count - 1
    };
    let mut unknowns = Vec::with_capacity(radii_m.len() * depths_m.len());
    for (column, radius_m) in radii_m.iter().enumerate() {
        for row in 0..depths_m.len() {
            unknowns.push(if column + 1 == radii_m.len() || row + 1 == depths_m.len() {
                [Unknown::Fixed; 3]
            } else if column <= wall && row <= tip {
                let [u, slope] = [2 * row, 2 * row + 1];
                [Unknown::Wall(1.0, u), Unknown::Wall(-1.0, u), Unknown::Wall(-radius_m, slope)]
            } else if column == 0 {
                // On the axis there is one displacement at every angle.
                let index = next();
                [Unknown::Own(1.0, index), Unknown::Own(-1.0, index), Unknown::Fixed]
            } else {
                [(); 3].map(|()| Unknown::Own(1.0, next()))
            });
        }
    }
    (unknowns, own_count, depths_m[..=tip].to_vec())
}

fn with_middles(lines: &[f64]) -> Vec<f64> {
    let mut nodes = vec![lines[0]];
    nodes.extend(lines.windows(2).flat_map(|pair| [0.5 * (pair[0] + pair[1]), pair[1]]));
    nodes
}

/// Values and derivatives of the three quadratic functions at a place.
fn quadratic(x: f64) -> [[f64; 2]; 3] {
    [[0.5 * x * (x - 1.0), x - 0.5], [1.0 - x * x, -2.0 * x], [0.5 * x * (x + 1.0), x + 0.5]]
}

/// Stiffness of an element without the factor pi; displacements `U, V, W` of one node after the other.
pub(super) fn element(
    radii_m: [f64; 2],
    depths_m: [f64; 2],
    poisson: f64,
    modulus: &dyn Fn(f64) -> f64,
) -> SMatrix<f64, SIZE, SIZE> {
    let [half_r, half_z] = [radii_m, depths_m].map(|[from, to]| 0.5 * (to - from));
    let [middle_r, middle_z] = [radii_m, depths_m].map(|[from, to]| 0.5 * (to + from));
    let compressible = (1.0 - 2.0 * poisson).max(MIN_COMPRESSIBLE);
    let mut stiffness = SMatrix::<f64, SIZE, SIZE>::zeros();
    let mut divergence = SMatrix::<f64, 3, SIZE>::zeros();
    let mut compliance = Matrix3::zeros();
    for [x, weight_x] in GAUSS {
        for [y, weight_y] in GAUSS {
            let (r, z) = (middle_r + half_r * x, middle_z + half_z * y);
            let weight = weight_x * weight_y * half_r * half_z * r;
            let youngs = modulus(z);
            let shear = 0.5 * youngs / (1.0 + poisson);
            let bulk = youngs / (3.0 * compressible);
            // Normal strains, then the shears rz, rt and zt.
            let mut strain = SMatrix::<f64, 6, SIZE>::zeros();
            let (along_r, along_z) = (quadratic(x), quadratic(y));
            for node in 0..9 {
                let ([a, da], [b, db]) = (along_r[node / 3], along_z[node % 3]);
                let (value, by_r, by_z) = (a * b, da * b / half_r, a * db / half_z);
                let [u, v, w] = [3 * node, 3 * node + 1, 3 * node + 2];
                strain[(0, u)] = by_r;
                strain[(1, u)] = value / r;
                strain[(1, v)] = value / r;
                strain[(2, w)] = by_z;
                strain[(3, u)] = by_z;
                strain[(3, w)] = by_r;
                strain[(4, u)] = -value / r;
                strain[(4, v)] = by_r - value / r;
                strain[(5, v)] = by_z;
                strain[(5, w)] = -value / r;
            }
            let mut stress = strain * (shear * weight);
            let trace = strain.row(0) + strain.row(1) + strain.row(2);
            for normal in 0..3 {
                let deviator = (strain.row(normal) - trace / 3.0) * (2.0 * shear * weight);
                stress.set_row(normal, &deviator);
            }
            stiffness += strain.transpose() * stress;
            let pressures = Vector3::new(1.0, x, y);
            divergence += pressures * trace * weight;
            compliance += pressures * pressures.transpose() * (weight / bulk);
        }
    }
    // Three moments of a positive weight over nine points: always invertible.
    let bulk = compliance.try_inverse().unwrap_or_default();
    stiffness + divergence.transpose() * bulk * divergence
}
