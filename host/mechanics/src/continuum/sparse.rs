//! Sparse linear equations with many right-hand sides: LU with a fill-reducing order and threshold pivoting, which the pressures of
//! an incompressible body need.

use crate::ModelError;
use nalgebra::DMatrix;
use rsparse::data::{Nmrc, Sprs};

/// Order of elimination: minimum degree of `A + A^T`, as for a symmetric pattern.
const SYMMETRIC_ORDER: i8 = 0;
/// A pivot on the diagonal is taken unless it is smaller than this share of the largest of its column.
const PIVOT_SHARE: f64 = 1e-3;

/// A square matrix, entry by entry; entries at the same place add up.
pub(super) struct Sparse {
    size: usize,
    /// Column, row, value.
    entries: Vec<(usize, usize, f64)>,
}

impl Sparse {
    /// Zeros.
    pub(super) fn new(size: usize) -> Self {
        Self { size, entries: Vec::new() }
    }

    /// Adds to an entry; `row` and `column` are below the size.
    pub(super) fn add(&mut self, row: usize, column: usize, value: f64) {
        self.entries.push((column, row, value));
    }

    /// Solutions for the columns of `right`.
    ///
    /// # Errors
    /// [`ModelError::Singular`].
    pub(super) fn solve(self, right: &DMatrix<f64>) -> Result<DMatrix<f64>, ModelError> {
        let size = self.size;
        let matrix = self.compressed();
        let mut order = rsparse::sqr(&matrix, SYMMETRIC_ORDER, false);
        let Nmrc { l, u, pinv, .. } =
            rsparse::lu(&matrix, &mut order, PIVOT_SHARE).map_err(|_| ModelError::Singular)?;
        let mut solved = DMatrix::zeros(size, right.ncols());
        let mut permuted = vec![0.0; size];
        for (from, mut to) in right.column_iter().zip(solved.column_iter_mut()) {
            for k in 0..size {
                permuted[permuted_row(&pinv, k)] = from[k];
            }
            rsparse::lsolve(&l, &mut permuted);
            rsparse::usolve(&u, &mut permuted);
            for k in 0..size {
                to[permuted_row(&order.q, k)] = permuted[k];
            }
        }
        Ok(solved)
    }

    /// Column by column, every place once.
    fn compressed(mut self) -> Sprs<f64> {
        self.entries.sort_unstable_by_key(|(column, row, _)| (*column, *row));
        self.entries.dedup_by(|next, kept| {
            let is_same_entry = (next.0, next.1) == (kept.0, kept.1);
            if is_same_entry {
                kept.2 += next.2;
            }
            is_same_entry
        });
        let mut matrix = Sprs::zeros(self.size, self.size, self.entries.len());
        for (at, (column, row, value)) in self.entries.into_iter().enumerate() {
            matrix.i[at] = row;
            matrix.x[at] = value;
            matrix.p[column + 1] += 1;
        }
        for column in 0..self.size {
            matrix.p[column + 1] += matrix.p[column];
        }
        matrix
    }
}

/// Row to which a permutation moves a row; the same row without a permutation.
fn permuted_row(permutation: &Option<Vec<isize>>, k: usize) -> usize {
    permutation.as_ref().and_then(|to| usize::try_from(to[k]).ok()).unwrap_or(k)
}

#[cfg(test)]
mod tests {
    use super::*;
    use noise::Noise;

    #[test]
    fn solutions_are_those_of_the_dense_matrix_zeros_on_the_diagonal_included() {
        let (size, mut noise) = (40, Noise::new(3));
        let mut dense = DMatrix::zeros(size, size);
        let mut sparse = Sparse::new(size);
        for row in 0..size {
            for column in [row, (7 * row + 3) % size, (row + 1) % size] {
                // The last quarter stands for pressures: nothing on the diagonal.
                let value = if row == column && row >= 30 { 0.0 } else { noise.normal() };
                dense[(row, column)] += value;
                sparse.add(row, column, value);
            }
        }
        let right = DMatrix::from_fn(size, 3, |_, _| noise.normal());
        let expected = dense.lu().solve(&right).expect("regular");
        let solution = sparse.solve(&right).expect("regular");
        assert!((solution - &expected).amax() < 1e-9 * expected.amax());
    }

    #[test]
    fn a_singular_matrix_is_refused() {
        let mut sparse = Sparse::new(2);
        for (row, column) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            sparse.add(row, column, 1.0);
        }
        assert_eq!(sparse.solve(&DMatrix::zeros(2, 1)), Err(ModelError::Singular));
    }
}
