//! From the deflection of a needle to the force of the body around it: the stiffness of an elastic half space against Legendre
//! patterns of the needle's deflection, solved directly, and the tables that the forward model interpolates
//! (theory, eq. 15 and 18).
//!
//! Per unit of Young's modulus and of depth the matrix of a uniform body depends on the ratio of depth to radius and on Poisson's
//! ratio alone: it is tabulated at Chebyshev's nodes in the logarithm of the one and in the other. A body whose modulus varies with
//! depth is reduced to a few fields: those of the uniform body under every pattern, and how fields change in a few bodies of two
//! layers. Their mutual energies in slices of depth times the modulus of each slice make a stiffness matrix, of which the amplitudes of
//! the changes are eliminated: an upper bound of the true stiffness that is exact for uniform tissue.

use super::fields::{Fields, Pattern};
use super::mesh::{Mesh, Resolution};
use crate::ModelError;
use nalgebra::DMatrix;
use rayon::prelude::*;
use std::f64::consts::PI;
use std::fmt::Write;

/// Legendre polynomials of the needle's deflection below the surface, degrees 0 and up.
pub const MODES: usize = 10;
/// Ratios of depth to radius between which the tables are made.
pub const RATIOS: [f64; 2] = [1.0, 1000.0];
/// Poisson's ratios between which they are made.
pub const POISSON: [f64; 2] = [0.0, 0.5];
/// Nodes of the uniform body's table in the logarithm of the ratio and in Poisson's ratio.
pub const UNIFORM: [usize; 2] = [16, 6];
/// Ratios, Poisson's ratios and nodes of the table of bodies whose modulus varies.
pub const VARIED_RATIOS: [f64; 2] = [4.0, 600.0];
/// As [`POISSON`].
pub const VARIED_POISSON: [f64; 2] = [0.25, 0.5];
/// As [`UNIFORM`].
pub const VARIED: [usize; 2] = [8, 2];
/// Lower ends of the slices over the depth of the needle's tip; the last slice has none.
pub const SLICES: [f64; 14] =
    [0.06, 0.15, 0.25, 0.37, 0.5, 0.63, 0.75, 0.85, 0.94, 1.0, 1.08, 1.25, 1.6, 2.5];
/// Patterns of which the change of the field is kept, the first ones.
const CHANGED: usize = 3;
/// Bodies of two layers that give these changes: boundary over the depth of the tip, modulus below over modulus above.
const LAYERED: [[f64; 2]; 4] = [[1.25, 6.0], [1.0, 0.2], [0.63, 0.2], [0.37, 5.0]];
/// Number of fields of a body whose modulus varies.
pub const FIELDS: usize = MODES + CHANGED * LAYERED.len();

/// The far boundary is so far that it adds less than one part in ten thousand to the stiffness.
const RESOLUTION: Resolution = Resolution { first: 0.3, growth: 1.4, reach: 2000.0 };
/// Cells beside the needle are no longer than this share of its depth.
const CELLS: f64 = 24.0;

/// Chebyshev's nodes between two ends.
pub fn nodes([from, to]: [f64; 2], count: usize) -> Vec<f64> {
    let angle = |i: usize| (i as f64 + 0.5) * PI / count as f64;
    (0..count).map(|i| 0.5 * (from + to) - 0.5 * (to - from) * angle(i).cos()).collect()
}

/// Weights of Chebyshev's nodes at a place: barycentric interpolation.
pub(crate) fn weights(range: [f64; 2], count: usize, at: f64) -> Vec<f64> {
    let nodes = nodes(range, count);
    if let Some(exact_node) = nodes.iter().position(|node| *node == at) {
        return (0..count).map(|i| if i == exact_node { 1.0 } else { 0.0 }).collect();
    }
    let sign = |i: usize| if i.is_multiple_of(2) { 1.0 } else { -1.0 };
    let raw = nodes.iter().enumerate().map(|(i, node)| {
        let angle = (i as f64 + 0.5) * PI / count as f64;
        sign(i) * angle.sin() / (at - node)
    });
    let raw: Vec<f64> = raw.collect();
    let sum: f64 = raw.iter().sum();
    raw.into_iter().map(|weight| weight / sum).collect()
}

/// Value and derivative of the Legendre polynomial of a degree.
pub(crate) fn legendre(degree: usize, x: f64) -> [f64; 2] {
    let (mut previous, mut now) = ([0.0, 0.0], [1.0, 0.0]);
    for n in 0..degree {
        let n = n as f64;
        let value = ((2.0 * n + 1.0) * x * now[0] - n * previous[0]) / (n + 1.0);
        let slope = ((2.0 * n + 1.0) * (now[0] + x * now[1]) - n * previous[1]) / (n + 1.0);
        (previous, now) = (now, [value, slope]);
    }
    now
}

/// A needle in a body, in radii of the needle.
#[derive(Debug, Clone)]
struct Case {
    depth: f64,
    poisson: f64,
    mesh: Mesh,
}

impl Case {
    fn new(depth: f64, poisson: f64, faces: &[f64], fineness: f64) -> Self {
        let growth = 1.0 + (RESOLUTION.growth - 1.0) / fineness;
        let resolution = Resolution { first: RESOLUTION.first / fineness, growth, ..RESOLUTION };
        Self { depth, poisson, mesh: Mesh::along(1.0, depth, resolution, CELLS * fineness, faces) }
    }

    /// Fields of the first patterns in a body of this modulus at a depth.
    fn fields(&self, patterns: usize, modulus: impl Fn(f64) -> f64) -> Result<Fields, ModelError> {
        let shapes: Vec<_> = (0..patterns)
            .map(|degree| {
                move |z: f64| {
                    let [u, slope] = legendre(degree, 2.0 * z / self.depth - 1.0);
                    [u, 2.0 * slope / self.depth]
                }
            })
            .collect();
        let patterns: Vec<Pattern<'_>> = shapes.iter().map(|shape| shape as Pattern<'_>).collect();
        Fields::solve(&self.mesh, self.poisson, &self.rows(modulus), &patterns)
    }

    /// Modulus in the middle of every row of cells.
    fn rows(&self, modulus: impl Fn(f64) -> f64) -> Vec<f64> {
        self.mesh.depths_m.windows(2).map(|ends| modulus(0.5 * (ends[0] + ends[1]))).collect()
    }
}

/// Stiffness against the patterns of a needle inserted to `depth` in a body of `modulus` at a depth, solved directly: per unit of
/// depth, all lengths in radii of the needle. `faces` are the depths where the modulus jumps; `fineness` divides the elements.
///
/// # Errors
/// [`ModelError::Singular`].
pub fn direct(
    depth: f64,
    poisson: f64,
    modulus: impl Fn(f64) -> f64,
    faces: &[f64],
    fineness: f64,
) -> Result<DMatrix<f64>, ModelError> {
    let case = Case::new(depth, poisson, faces, fineness);
    let energies = case.fields(MODES, &modulus)?.energies(&case.mesh);
    let rows = case.rows(modulus);
    let total = energies.iter().zip(rows).fold(DMatrix::zeros(MODES, MODES), |sum, (row, e)| sum + row * e);
    Ok(total / depth)
}

/// Entries on and below the diagonal, row by row.
fn lower(matrix: &DMatrix<f64>) -> impl Iterator<Item = f64> {
    (0..matrix.nrows()).flat_map(move |i| (0..=i).map(move |j| matrix[(i, j)]))
}

/// The table of uniform bodies as text: a line per ratio and Poisson's ratio.
///
/// # Errors
/// [`ModelError::Singular`].
pub fn uniform_table(progress: impl Fn(f64, f64) + Sync) -> Result<String, ModelError> {
    let mut text = String::from(
        "# Stiffness of an elastic half space against Legendre patterns of a needle's deflection, per unit of Young's modulus and\n\
         # depth: `cargo xtask study operator`. depth/radius, Poisson's ratio, entries on and below the diagonal row by row.\n",
    );
    for (ratio, poisson, matrices) in cases(RATIOS, POISSON, UNIFORM, |ratio, poisson| {
        progress(ratio, poisson);
        Ok(vec![direct(ratio, poisson, |_| 1.0, &[], 1.0)?])
    })? {
        let _ = write!(text, "{ratio:.9},{poisson:.9}");
        matrices.iter().flat_map(lower).for_each(|value| {
            let _ = write!(text, ",{value:.8e}");
        });
        text.push('\n');
    }
    Ok(text)
}

/// The table of bodies whose modulus varies with depth, [`planes`] of `f32`: for every ratio and Poisson's ratio and every slice the
/// mutual energies of the fields per unit of depth, entries on and below the diagonal row by row.
///
/// # Errors
/// [`ModelError::Singular`].
pub fn varied_table(progress: impl Fn(f64, f64) + Sync) -> Result<Vec<u8>, ModelError> {
    let table = cases(VARIED_RATIOS, VARIED_POISSON, VARIED, |ratio, poisson| {
        progress(ratio, poisson);
        reduced(ratio, poisson)
    })?;
    let values = table.iter().flat_map(|(.., slices)| slices.iter().flat_map(lower));
    Ok(planes(&values.map(|value| value as f32).collect::<Vec<_>>()))
}

/// The lowest bytes of all numbers, then the next ones: signs and exponents side by side, which an eighth less is left of where the
/// table is packed, as in the page for browsers.
pub(super) fn planes(values: &[f32]) -> Vec<u8> {
    (0..4).flat_map(|plane| values.iter().map(move |value| value.to_le_bytes()[plane])).collect()
}

/// The numbers in [`planes`].
pub(crate) fn from_planes(bytes: &[u8]) -> Vec<f64> {
    let count = bytes.len() / 4;
    let number = |k: usize| f32::from_le_bytes(std::array::from_fn(|plane| bytes[plane * count + k]));
    (0..count).map(|k| f64::from(number(k))).collect()
}

/// Mutual energies of the reduced body's fields in every slice, per unit of depth.
fn reduced(depth: f64, poisson: f64) -> Result<Vec<DMatrix<f64>>, ModelError> {
    let faces: Vec<f64> = SLICES.iter().map(|end| end * depth).collect();
    let case = Case::new(depth, poisson, &faces, 1.0);
    let mut fields = case.fields(MODES, |_| 1.0)?;
    for [boundary, below] in LAYERED {
        fields = fields
            .and_changes(&case.fields(CHANGED, |z| if z < boundary * depth { 1.0 } else { below })?, CHANGED);
    }
    let mut slices = vec![DMatrix::zeros(FIELDS, FIELDS); SLICES.len() + 1];
    for (row, z) in fields.energies(&case.mesh).into_iter().zip(case.rows(|z| z)) {
        slices[faces.partition_point(|end| *end < z)] += row / depth;
    }
    Ok(slices)
}

type Found = (f64, f64, Vec<DMatrix<f64>>);

/// Solves at every node, ratio by ratio.
fn cases(
    ratios: [f64; 2],
    poisson: [f64; 2],
    [of_ratio, of_poisson]: [usize; 2],
    solve: impl Fn(f64, f64) -> Result<Vec<DMatrix<f64>>, ModelError> + Sync,
) -> Result<Vec<Found>, ModelError> {
    let of_ratio = nodes(ratios.map(f64::ln), of_ratio);
    let of_poisson = nodes(poisson, of_poisson);
    let solved_cases: Vec<[f64; 2]> =
        of_ratio.iter().flat_map(|ln| of_poisson.iter().map(|poisson| [ln.exp(), *poisson])).collect();
    solved_cases
        .into_par_iter()
        .map(|[ratio, poisson]| Ok((ratio, poisson, solve(ratio, poisson)?)))
        .collect()
}
