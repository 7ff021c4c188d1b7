//! Displacement fields of the body around a needle that is bent in given patterns, and their energies by depth.
//!
//! The needle's sections stay plane and normal to its axis: at its wall and its tip `U = u(z)`, `V = -u(z)`, `W = -r u'(z)`. Fields
//! of two patterns have a mutual energy, which is the entry of the stiffness matrix of the patterns; the energy of each slice of
//! depth is what that entry grows by per unit of Young's modulus there while the fields stay as they are.

use super::mesh::Mesh;
use super::solve::{Numbering, Unknown, bulk_compliance, cell_matrix};
use super::sparse::Sparse;
use crate::ModelError;
use nalgebra::DMatrix;
use std::f64::consts::PI;

/// Displacements of a cell's nodes.
const MOTIONS: usize = 27;
/// The same and the pressures of its corners.
const LOCAL: usize = 31;

/// A pattern of the needle's deflection: deflection and slope at a depth.
pub type Pattern<'a> = &'a dyn Fn(f64) -> [f64; 2];

/// Fields in a body, one per pattern, cell by cell.
#[derive(Debug, Clone)]
pub struct Fields {
    /// Row of depth of every cell with tissue, and its fields: displacements, and pressures per unit of Young's modulus.
    cells: Vec<(usize, usize, Vec<[f64; LOCAL]>)>,
    poisson: f64,
}

impl Fields {
    /// Solves for the fields of `patterns` in a body whose Young's modulus, per unit, is given for every row of cells.
    ///
    /// # Errors
    /// [`ModelError::Singular`] where the equations have no solution.
    pub fn solve(
        mesh: &Mesh,
        poisson: f64,
        modulus: &[f64],
        patterns: &[Pattern<'_>],
    ) -> Result<Self, ModelError> {
        let numbering = Numbering::new(mesh);
        let mut matrix = Sparse::new(numbering.free);
        let mut load = DMatrix::zeros(numbering.free, patterns.len());
        for (radial, axial) in tissue(mesh) {
            let cell_stiffness = scaled(cell(mesh, radial, axial, poisson), modulus[axial]);
            let unknowns = numbering.of_cell(mesh, radial, axial);
            let imposed_values: Vec<[f64; LOCAL]> =
                patterns.iter().map(|pattern| given(mesh, radial, axial, pattern)).collect();
            for (row, of_row) in unknowns.iter().zip(&cell_stiffness) {
                let Unknown::Free(a, i) = *row else { continue };
                for (column, value) in unknowns.iter().zip(of_row) {
                    if let Unknown::Free(b, j) = *column {
                        matrix.add(i, j, a * b * value);
                    }
                }
                for (pattern, imposed_values) in imposed_values.iter().enumerate() {
                    load[(i, pattern)] -=
                        a * of_row.iter().zip(imposed_values).map(|(k, u)| k * u).sum::<f64>();
                }
            }
        }
        let solution = matrix.solve(&load)?;
        let cells = tissue(mesh).map(|(radial, axial)| {
            let unknowns = numbering.of_cell(mesh, radial, axial);
            let of_pattern = |(number, pattern): (usize, &Pattern<'_>)| {
                let mut values = given(mesh, radial, axial, pattern);
                for (value, unknown) in values.iter_mut().zip(&unknowns) {
                    if let Unknown::Free(sign, index) = *unknown {
                        *value = sign * solution[(index, number)];
                    }
                }
                values[MOTIONS..].iter_mut().for_each(|pressure| *pressure /= modulus[axial]);
                values
            };
            (radial, axial, patterns.iter().enumerate().map(of_pattern).collect())
        });
        Ok(Self { cells: cells.collect(), poisson })
    }

    /// These fields and, behind them, how the first `count` of others differ from their own first ones: the needle does not move
    /// in those.
    pub fn and_changes(mut self, others: &Self, count: usize) -> Self {
        for ((.., own), (.., others)) in self.cells.iter_mut().zip(&others.cells) {
            for number in 0..count {
                let change = std::array::from_fn(|i| others[number][i] - own[number][i]);
                own.push(change);
            }
        }
        self
    }

    /// Mutual energies of the fields per unit of Young's modulus, in each row of cells, metres.
    pub fn energies(&self, mesh: &Mesh) -> Vec<DMatrix<f64>> {
        let count = self.cells.first().map_or(0, |(.., fields)| fields.len());
        let mut rows = vec![DMatrix::zeros(count, count); mesh.depths_m.len() - 1];
        for (radial, axial, fields) in &self.cells {
            let matrix = cell(mesh, *radial, *axial, self.poisson);
            for (i, a) in fields.iter().enumerate() {
                let mut forces = [0.0; LOCAL];
                for (row, force) in forces.iter_mut().enumerate() {
                    // The pressures' own part is an energy too; what couples them with displacements is not.
                    let (columns, sign) =
                        if row < MOTIONS { (0..MOTIONS, 1.0) } else { (MOTIONS..LOCAL, -1.0) };
                    *force = sign * columns.map(|column| matrix[row][column] * a[column]).sum::<f64>();
                }
                for (j, b) in fields.iter().enumerate().take(i + 1) {
                    let energy = PI * forces.iter().zip(b).map(|(f, u)| f * u).sum::<f64>();
                    rows[*axial][(i, j)] += energy;
                    if i != j {
                        rows[*axial][(j, i)] += energy;
                    }
                }
            }
        }
        rows
    }
}

fn tissue(mesh: &Mesh) -> impl Iterator<Item = (usize, usize)> {
    let cells = (0..mesh.depths_m.len() - 1)
        .flat_map(|axial| (0..mesh.radii_m.len() - 1).map(move |radial| (radial, axial)));
    cells.filter(|(radial, axial)| !mesh.is_needle(*radial, *axial))
}

fn cell(mesh: &Mesh, radial: usize, axial: usize, poisson: f64) -> [[f64; LOCAL]; LOCAL] {
    cell_matrix(mesh, radial, axial, 1, 0.5 / (1.0 + poisson), bulk_compliance(poisson))
}

/// A cell's matrix for another Young's modulus.
fn scaled(mut matrix: [[f64; LOCAL]; LOCAL], modulus: f64) -> [[f64; LOCAL]; LOCAL] {
    for (row, values) in matrix.iter_mut().enumerate() {
        for (column, value) in values.iter_mut().enumerate() {
            match (row < MOTIONS, column < MOTIONS) {
                (true, true) => *value *= modulus,
                (false, false) => *value /= modulus,
                _ => {}
            }
        }
    }
    matrix
}

/// Displacements that the needle imposes on the nodes of a cell that lie on it; 0 elsewhere.
fn given(mesh: &Mesh, radial: usize, axial: usize, pattern: &Pattern<'_>) -> [f64; LOCAL] {
    let mut values = [0.0; LOCAL];
    if radial > 0 && radial != 1 {
        return values;
    }
    for node in 0..9 {
        let (column, row) = (2 * radial + node % 3, 2 * axial + node / 3);
        if column <= 2 && (2 * mesh.needle.0..=2 * mesh.needle.1).contains(&row) {
            let [u, slope] = pattern(at(&mesh.depths_m, row));
            values[3 * node..3 * node + 3].copy_from_slice(&[u, -u, -at(&mesh.radii_m, column) * slope]);
        }
    }
    values
}

/// Place of a node of the quadratic mesh between the lines.
fn at(lines: &[f64], node: usize) -> f64 {
    let (low, high) = (lines[node / 2], lines[node.div_ceil(2)]);
    0.5 * (low + high)
}
