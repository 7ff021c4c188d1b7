//! The inverse of a small symmetric matrix: most of the time of a prediction is spent here.

use pulp::Simd;
use std::array::from_fn;

/// So many pivots are taken off the other rows together, which are then read and written once for all of them.
const PIVOTS: usize = 4;

/// Memory for inverses of one size, so that none is requested for each.
pub(super) struct Inverter {
    size: usize,
    /// Length of a row with the zeros behind its last column: whole registers, and whole blocks of pivots.
    width: usize,
    rows: Vec<f64>,
    /// The rows of the pivots of a block.
    pivots: [Vec<f64>; PIVOTS],
}

impl Inverter {
    pub fn new<S: Simd>(_: S, size: usize) -> Self {
        let width = size.next_multiple_of(PIVOTS.max(S::F64_LANES));
        Self { size, width, rows: vec![0.0; size * width], pivots: from_fn(|_| vec![0.0; width]) }
    }

    /// Replaces a symmetric, positive definite matrix by its inverse (Gauss and Jordan, without pivoting) and returns the logarithm of
    /// its determinant; `None` where it is not positive definite in floating point.
    #[inline(always)]
    pub fn invert<S: Simd>(&mut self, simd: S, square: &mut [f64]) -> Option<f64> {
        let Self { size, width, rows, pivots } = self;
        let (size, width) = (*size, *width);
        for (row, values) in rows.chunks_exact_mut(width).zip(square.chunks_exact(size)) {
            row.iter_mut().zip(values).for_each(|(to, value)| *to = *value);
        }
        let mut ln_determinant = 0.0;
        for first in (0..size).step_by(PIVOTS) {
            let (earlier_rows, remaining_rows) = rows.split_at_mut(first * width);
            let count = remaining_rows.len().min(PIVOTS * width);
            let (pivot_rows, later_rows) = remaining_rows.split_at_mut(count);
            reduced(simd, pivot_rows, first, pivots, &mut ln_determinant)?;
            let mut square = [[0.0; PIVOTS]; PIVOTS];
            for (row, kept) in square.iter_mut().zip(pivots.iter()) {
                *row = *kept.get(first..)?.first_chunk()?;
            }
            for row in earlier_rows.chunks_exact_mut(width).chain(later_rows.chunks_exact_mut(width)) {
                take_off(simd, row, first, pivots, &square)?;
            }
        }
        for (row, values) in rows.chunks_exact(width).zip(square.chunks_exact_mut(size)) {
            values.iter_mut().zip(row).for_each(|(to, value)| *to = *value);
        }
        Some(ln_determinant)
    }
}

/// Takes the pivots of a block, the first of which is in this column, off its own rows, one after the other, keeps each pivot's row as
/// it is then, and adds the logarithms of the pivots; `None` where one is not positive.
#[inline(always)]
fn reduced<S: Simd>(
    simd: S,
    own: &mut [f64],
    first: usize,
    pivots: &mut [Vec<f64>; PIVOTS],
    ln_determinant: &mut f64,
) -> Option<()> {
    for (number, kept) in pivots.iter_mut().enumerate() {
        let (width, column) = (kept.len(), first + number);
        let Some(row) = own.get_mut(number * width..(number + 1) * width) else {
            // The last block may have fewer rows.
            kept.fill(0.0);
            continue;
        };
        let pivot_value = row.get_mut(column)?;
        let pivot = *pivot_value;
        if !(pivot > 0.0 && pivot.is_finite()) {
            return None;
        }
        *ln_determinant += pivot.ln();
        *pivot_value = 1.0;
        row.iter_mut().for_each(|value| *value /= pivot);
        kept.copy_from_slice(row);
        for (other, row) in own.chunks_exact_mut(width).enumerate() {
            if other != number {
                let factor = simd.splat_f64s(std::mem::take(row.get_mut(column)?));
                for (value, kept) in S::as_mut_simd_f64s(row).0.iter_mut().zip(S::as_simd_f64s(kept).0) {
                    *value = simd.sub_f64s(*value, simd.mul_f64s(factor, *kept));
                }
            }
        }
    }
    Some(())
}

/// Takes the pivots of a block off another row; `square` is where their rows and columns cross.
#[inline(always)]
fn take_off<S: Simd>(
    simd: S,
    row: &mut [f64],
    first: usize,
    pivots: &[Vec<f64>; PIVOTS],
    square: &[[f64; PIVOTS]; PIVOTS],
) -> Option<()> {
    // The contribution of each pivot's row depends on the previous ones, through the columns of the pivots
    // alone.
    let mut own_columns: [f64; PIVOTS] = *row.get(first..)?.first_chunk()?;
    let mut factors = [0.0; PIVOTS];
    for (number, kept) in square.iter().enumerate() {
        factors[number] = own_columns[number];
        let earlier_columns: [f64; PIVOTS] =
            from_fn(|place| if place == number { 0.0 } else { own_columns[place] });
        own_columns = from_fn(|place| earlier_columns[place] - factors[number] * kept[place]);
    }
    let [a, b, c, d] = factors.map(|factor| simd.splat_f64s(factor));
    let [of_a, of_b, of_c, of_d] = pivots.each_ref().map(|kept| S::as_simd_f64s(kept).0);
    let column_values = of_a.iter().zip(of_b).zip(of_c.iter().zip(of_d));
    for (value, ((of_a, of_b), (of_c, of_d))) in S::as_mut_simd_f64s(row).0.iter_mut().zip(column_values) {
        let after_a = simd.sub_f64s(*value, simd.mul_f64s(a, *of_a));
        let after_b = simd.sub_f64s(after_a, simd.mul_f64s(b, *of_b));
        let after_c = simd.sub_f64s(after_b, simd.mul_f64s(c, *of_c));
        *value = simd.sub_f64s(after_c, simd.mul_f64s(d, *of_d));
    }
    row.get_mut(first..first + PIVOTS)?.copy_from_slice(&own_columns);
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;
    use noise::Noise;
    use pulp::{Arch, WithSimd};

    struct Inverse<'a>(usize, &'a mut [f64]);

    impl WithSimd for Inverse<'_> {
        type Output = Option<f64>;

        fn with_simd<S: Simd>(self, simd: S) -> Option<f64> {
            Inverter::new(simd, self.0).invert(simd, self.1)
        }
    }

    /// Against nalgebra's Cholesky factor, for sizes that fill the last block and sizes that do not.
    #[test]
    fn inverse_and_determinant_are_those_of_a_cholesky_factor() {
        let mut noise = Noise::new(1);
        for size in 1..24 {
            let root = DMatrix::from_fn(size, size, |_, _| noise.normal());
            let matrix = &root * root.transpose() + DMatrix::identity(size, size);
            let factor = matrix.clone().cholesky().expect("positive definite");
            let mut square = matrix.as_slice().to_vec();
            let ln_determinant = Arch::new().dispatch(Inverse(size, &mut square)).expect("positive definite");
            let difference = DMatrix::from_row_slice(size, size, &square) - factor.inverse();
            assert!(difference.amax() < 1e-12, "{size}: {difference}");
            assert!((ln_determinant - factor.ln_determinant()).abs() < 1e-11, "{size}");
        }
    }

    #[test]
    fn what_is_not_positive_definite_has_no_inverse() {
        for pivot in [0.0, 0.5, -1.0, f64::NAN, f64::INFINITY] {
            let mut square = [2.0, 1.0, 1.0, pivot];
            assert!(Arch::new().dispatch(Inverse(2, &mut square)).is_none(), "{pivot}");
        }
    }
}
