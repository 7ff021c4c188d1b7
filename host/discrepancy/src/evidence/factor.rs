//! Matrix products and Cholesky factors of the evidence.

use nalgebra::{Cholesky, DMatrix, Dyn};

/// Number of columns of a block of a symmetric product.
const BLOCK: usize = 32;
/// Side of the largest triangle that is inverted column by column.
const SMALL_BLOCK: usize = 12;

/// Subtracts the scalar products of columns from the lower triangle of a matrix, in which the columns have these places, in increasing
/// order. The products are computed in blocks, because a single product would compute both triangles.
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

/// Inverse R of the lower triangle L of a Cholesky factor, so that `(L L^T)^-1 = R^T R`. A diagnosis spends most of its time here and in
/// products with R; therefore the inverse is computed by matrix products, which libraries optimise for every processor.
pub(super) fn inverse_root(factor: &Cholesky<f64, Dyn>) -> DMatrix<f64> {
    let lower = factor.l_dirty();
    let mut root = DMatrix::zeros(lower.nrows(), lower.ncols());
    invert_block(lower, &mut root, 0, lower.nrows());
    root
}

/// Inverse of the triangle with `side` rows and columns that begins at row `first`:
/// `[A, 0; C, B]^-1 = [A^-1, 0; -B^-1 C A^-1, B^-1]`.
fn invert_block(lower: &DMatrix<f64>, root: &mut DMatrix<f64>, first: usize, side: usize) {
    if side <= SMALL_BLOCK {
        for j in first..first + side {
            // Columns of the root begin on the diagonal.
            let remaining_side = first + side - j;
            root[(j, j)] = 1.0;
            lower
                .view((j, j), (remaining_side, remaining_side))
                .solve_lower_triangular_mut(&mut root.view_mut((j, j), (remaining_side, 1)));
        }
        return;
    }
    let upper_side = side / 2;
    let (middle, lower_side) = (first + upper_side, side - upper_side);
    invert_block(lower, root, first, upper_side);
    invert_block(lower, root, middle, lower_side);
    let by_upper = lower.view((middle, first), (lower_side, upper_side))
        * root.view((first, first), (upper_side, upper_side));
    let corner = root.view((middle, middle), (lower_side, lower_side)) * by_upper;
    root.view_mut((middle, first), (lower_side, upper_side)).copy_from(&-corner);
}
