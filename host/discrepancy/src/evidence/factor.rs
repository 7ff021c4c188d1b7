//! Products and factors of the equations of the evidence.

use nalgebra::{Cholesky, DMatrix, Dyn};

/// Columns of a block of products of which one triangle is needed.
const BLOCK: usize = 32;

/// Takes the scalar products of columns off the lower triangle of a matrix in which they have these places, in increasing order; block by
/// block, as one product would compute both triangles.
pub(super) fn take_off_products(matrix: &mut DMatrix<f64>, columns: &DMatrix<f64>, places: &[usize]) {
    let transposed = columns.transpose();
    let mut start = 0;
    while start < places.len() {
        let width = BLOCK.min(places.len() - start);
        let products = transposed.rows_range(start..) * columns.columns(start, width);
        for (j, column) in products.column_iter().enumerate() {
            for (value, row) in column.iter().zip(&places[start..]).skip(j) {
                matrix[(*row, places[start + j])] -= value;
            }
        }
        start += width;
    }
}

pub(super) fn ln_diagonal(factor: &Cholesky<f64, Dyn>) -> f64 {
    factor.l_dirty().diagonal().iter().map(|value| value.ln()).sum()
}

/// Inverse of the lower triangle L of a factor: the inverse of `L L^T` is its transpose times itself. Most of the time of a diagnosis goes
/// into these inverses; this takes a sixth of the operations of a solution of the unit matrix, and a product of matrices.
pub(super) fn inverse_root(factor: &Cholesky<f64, Dyn>) -> DMatrix<f64> {
    let lower = factor.l_dirty();
    let side = lower.nrows();
    let mut root = DMatrix::identity(side, side);
    for j in 0..side {
        // Columns of the root begin on the diagonal.
        let remaining_side = side - j;
        lower
            .view((j, j), (remaining_side, remaining_side))
            .solve_lower_triangular_mut(&mut root.view_mut((j, j), (remaining_side, 1)));
    }
    root
}
