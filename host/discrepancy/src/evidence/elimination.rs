//! Scalar products of many columns in the metric of noise and discrepancy, where only few of the products are needed.
//!
//! `C^T S^-1 C = C^T C - V^T V`, where `V` depends only on the columns' scalar products with the basis functions. Once these
//! products are known, other sizes need no further pass over the readings.

use super::factor::inverse_root;
use super::{Patterns, Products, sizes_of};
use nalgebra::{DMatrix, DVector};

/// Elimination of the basis functions at some sizes.
#[derive(Debug)]
pub struct Elimination {
    runs: Vec<OfRun>,
    shared_sizes: DVector<f64>,
    /// Inverse of the Cholesky factor of the shared patterns, after those of single runs were eliminated.
    root: DMatrix<f64>,
}

/// Patterns of one run alone.
#[derive(Debug)]
struct OfRun {
    sizes: DVector<f64>,
    /// Inverse of the Cholesky factor of these patterns.
    root: DMatrix<f64>,
    /// Shared patterns that the run shows, and `root` times the scalar products with them.
    shown: Vec<usize>,
    by_shown: DMatrix<f64>,
}

impl Patterns {
    /// Elimination at these sizes; `None` for an invalid size.
    pub fn elimination(&self, sizes: &[f64]) -> Option<Elimination> {
        let shared_sizes = sizes_of(&self.shared_groups, sizes);
        let count = shared_sizes.len();
        let mut normal = DMatrix::from_fn(count, count, |i, j| {
            shared_sizes[i] * self.shared_gram[(i, j)] * shared_sizes[j] + f64::from(i == j)
        });
        let mut runs = Vec::with_capacity(self.runs.len());
        for run in &self.runs {
            let sizes = sizes_of(&run.own_groups, sizes);
            let run_normal = DMatrix::from_fn(sizes.len(), sizes.len(), |i, j| {
                sizes[i] * run.own_gram[(i, j)] * sizes[j] + f64::from(i == j)
            });
            let root = inverse_root(&run_normal.cholesky()?);
            let sized = DMatrix::from_fn(sizes.len(), run.shown.len(), |i, j| {
                sizes[i] * run.own_by_shown[(i, j)] * shared_sizes[run.shown[j]]
            });
            let by_shown = &root * sized;
            let eliminated = by_shown.tr_mul(&by_shown);
            for (j, column) in eliminated.column_iter().enumerate() {
                for (i, value) in column.iter().enumerate() {
                    normal[(run.shown[i], run.shown[j])] -= value;
                }
            }
            runs.push(OfRun { sizes, root, shown: run.shown.clone(), by_shown });
        }
        Some(Elimination { runs, shared_sizes, root: inverse_root(&normal.cholesky()?) })
    }
}

impl Elimination {
    /// `V` of columns with these products: the components of each column along the basis functions, in orthogonal coordinates.
    pub fn of(&self, products: &Products) -> DMatrix<f64> {
        let mut coordinates = Vec::with_capacity(self.runs.len() + 1);
        let mut shared = products.shared.clone();
        scale_rows(&mut shared, &self.shared_sizes);
        for (run, own) in self.runs.iter().zip(&products.own) {
            let mut sized = own.clone();
            scale_rows(&mut sized, &run.sizes);
            let run_coordinates = &run.root * sized;
            let eliminated = run.by_shown.transpose() * &run_coordinates;
            for (row, place) in eliminated.row_iter().zip(&run.shown) {
                let mut shared_row = shared.row_mut(*place);
                shared_row -= row;
            }
            coordinates.push(run_coordinates);
        }
        coordinates.push(&self.root * shared);
        let rows = coordinates.iter().map(DMatrix::nrows).sum();
        let mut stacked = DMatrix::zeros(rows, products.among.ncols());
        let mut first = 0;
        for block in coordinates {
            stacked.rows_mut(first, block.nrows()).copy_from(&block);
            first += block.nrows();
        }
        stacked
    }
}

fn scale_rows(matrix: &mut DMatrix<f64>, sizes: &DVector<f64>) {
    for mut column in matrix.column_iter_mut() {
        column.component_mul_assign(sizes);
    }
}
