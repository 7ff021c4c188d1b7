//! Products and factors of the equations of the evidence.

use nalgebra::{Cholesky, DMatrix, Dyn};

/// Columns of a block of products of which one triangle is needed.
const BLOCK: usize = 32;
/// Side of a triangle that is inverted column by column.
const SMALL_BLOCK: usize = 12;

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
/// into what these inverses serve, so that they consist of products of matrices, which libraries have for every processor.
pub(super) fn inverse_root(factor: &Cholesky<f64, Dyn>) -> DMatrix<f64> {
    let lower = factor.l_dirty();
    let mut root = DMatrix::zeros(lower.nrows(), lower.ncols());
    invert_block(lower, &mut root, 0, lower.nrows());
    root
}

/// The inverse of the triangle of so many rows and columns behind the first ones:
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
