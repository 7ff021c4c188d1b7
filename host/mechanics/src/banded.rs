//! Symmetric matrices of beam elements: three sub-diagonals, factored in place, or row by row while the beam grows.

/// A symmetric matrix with three sub-diagonals, and its Cholesky factor in the same place.
#[derive(Debug, Clone)]
pub(super) struct Banded(Vec<[f64; 4]>);

impl Banded {
    /// Zeros.
    pub(super) fn new(size: usize) -> Self {
        Self(vec![[0.0; 4]; size])
    }

    /// Adds to the entry at `row`, `column`; `column` is not above `row`.
    pub(super) fn add(&mut self, row: usize, column: usize, value: f64) {
        self.0[row][row - column] += value;
    }

    /// Makes an unknown keep its value.
    pub(super) fn fix(&mut self, index: usize) {
        self.0[index] = [1.0, 0.0, 0.0, 0.0];
        for below in 1..4 {
            if let Some(row) = self.0.get_mut(index + below) {
                row[below] = 0.0;
            }
        }
    }

    /// `A = L L^T`; `None` where the matrix is not positive definite.
    pub(super) fn factor(&mut self) -> Option<&Self> {
        (0..self.0.len()).try_for_each(|row| self.factor_row(row))?;
        Some(self)
    }

    /// Factors one row whose rows above are factored.
    fn factor_row(&mut self, row: usize) -> Option<()> {
        for back in (0..4.min(row + 1)).rev() {
            let column = row - back;
            let mut value = self.0[row][back];
            for k in column.saturating_sub(3).max(row.saturating_sub(3))..column {
                value -= self.0[row][row - k] * self.0[column][column - k];
            }
            self.0[row][back] = if back == 0 {
                if value <= 0.0 || !value.is_finite() {
                    return None;
                }
                value.sqrt()
            } else {
                value / self.0[column][0]
            };
        }
        Some(())
    }

    /// Factors the rows from `first` on of `matrix` into this one, which holds the factor of the rows above them.
    pub(super) fn factor_from(&mut self, matrix: &Self, first: usize) -> Option<()> {
        self.0.truncate(first);
        for row in first..matrix.0.len() {
            self.0.push(matrix.0[row]);
            self.factor_row(row)?;
        }
        Some(())
    }

    /// Rows of zeros at the end.
    pub(super) fn grow(&mut self, rows: usize) {
        self.0.resize(self.0.len() + rows, [0.0; 4]);
    }

    /// The last two unknowns under loads on them alone.
    pub(super) fn solve_end(&self, loads: [f64; 2]) -> [f64; 2] {
        let Some([deflection, slope]) = self.0.last_chunk() else { return [0.0; 2] };
        let forward = loads[0] / deflection[0];
        let last = (loads[1] - slope[1] * forward) / (slope[0] * slope[0]);
        [(forward - slope[1] * last) / deflection[0], last]
    }

    /// What the two unknowns from `row` on are per unit of the two after them, where no load acts on them or before: by this factor
    /// unknowns of a node follow from those of the next one. Nothing where there is no next one.
    pub(super) fn per_next(&self, row: usize) -> Option<[[f64; 2]; 2]> {
        let [deflection, slope, next, after] = self.0.get(row..row + 4)?.first_chunk()?;
        let of = |by_deflection: f64, by_slope: f64| {
            let second = -by_slope / slope[0];
            [(-by_deflection - slope[1] * second) / deflection[0], second]
        };
        let (of_next, of_after) = (of(next[2], next[1]), of(after[3], after[2]));
        Some([[of_next[0], of_after[0]], [of_next[1], of_after[1]]])
    }

    /// Solves with the factor, in place.
    pub(super) fn solve(&self, right: &mut [f64]) {
        for row in 0..right.len() {
            for back in 1..4.min(row + 1) {
                right[row] -= self.0[row][back] * right[row - back];
            }
            right[row] /= self.0[row][0];
        }
        self.substitute_back(right);
    }

    fn substitute_back(&self, right: &mut [f64]) {
        for row in (0..right.len()).rev() {
            let mut value = right[row];
            for below in 1..4.min(right.len() - row) {
                value -= self.0[row + below][below] * right[row + below];
            }
            right[row] = value / self.0[row][0];
        }
    }
}
