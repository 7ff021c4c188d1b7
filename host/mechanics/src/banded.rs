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

    /// Four rows from `row` on; the entry of the first row on the diagonal is the first of them.
    pub(super) fn block_mut(&mut self, row: usize) -> Option<&mut [[f64; 4]; 4]> {
        self.0.get_mut(row..)?.first_chunk_mut()
    }

    /// `A = L L^T`; `None` where the matrix is not positive definite.
    pub(super) fn factor(&mut self) -> Option<&Self> {
        let mut preceding_rows = ABOVE;
        for row in &mut self.0 {
            *row = factored(*row, &preceding_rows)?;
            preceding_rows = [*row, preceding_rows[0], preceding_rows[1]];
        }
        Some(self)
    }

    /// Factors the rows from `first` on of `matrix` into this one, which holds the factor of the rows above them.
    pub(super) fn factor_from(&mut self, matrix: &Self, first: usize) -> Option<()> {
        self.0.truncate(first);
        let mut preceding_rows = ABOVE;
        self.0.iter().rev().zip(&mut preceding_rows).for_each(|(row, preceding_rows)| *preceding_rows = *row);
        for row in matrix.0.iter().skip(first) {
            let row = factored(*row, &preceding_rows)?;
            self.0.push(row);
            preceding_rows = [row, preceding_rows[0], preceding_rows[1]];
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

    /// Ratio of the two unknowns from `row` on to the two after them, if no load acts on them or before: by this factor
    /// unknowns of a node follow from those of the next one. `None` if there is no next one.
    pub(super) fn per_next(&self, row: usize) -> Option<[[f64; 2]; 2]> {
        let [deflection, slope, next, next_but_one] = self.0.get(row..row + 4)?.first_chunk()?;
        let (of_next, of_after) = (
            eliminated(next[2], next[1], slope, deflection),
            eliminated(next_but_one[3], next_but_one[2], slope, deflection),
        );
        Some([[of_next[0], of_after[0]], [of_next[1], of_after[1]]])
    }

    /// Solves with the factor, in place, for several right-hand sides at once: the row before is waited for once for all of them.
    pub(super) fn solve<const SIDES: usize>(&self, right: &mut [[f64; SIDES]]) {
        let mut preceding_values = [[0.0; SIDES]; 3];
        for ([diagonal, factors @ ..], right) in self.0.iter().zip(right.iter_mut()) {
            *right = substituted(*right, *factors, &preceding_values, *diagonal);
            preceding_values = [*right, preceding_values[0], preceding_values[1]];
        }
        let mut following_values = [[0.0; SIDES]; 3];
        // The factors of an unknown stand in the rows after it.
        let mut factors = [[0.0; 4]; 3];
        for (row, right) in self.0.iter().zip(right).rev() {
            let column = [factors[0][1], factors[1][2], factors[2][3]];
            *right = substituted(*right, column, &following_values, row[0]);
            following_values = [*right, following_values[0], following_values[1]];
            factors = [*row, factors[0], factors[1]];
        }
    }
}

/// Factors of the two unknowns of a node, as the node's equations give them from one of the following unknowns.
fn eliminated(by_deflection: f64, by_slope: f64, slope: &[f64; 4], deflection: &[f64; 4]) -> [f64; 2] {
    let second = -by_slope / slope[0];
    [(-by_deflection - slope[1] * second) / deflection[0], second]
}

/// Entries above the first row, the nearest first: rows that have no part in those below.
const ABOVE: [[f64; 4]; 3] = [[1.0, 0.0, 0.0, 0.0]; 3];

/// A row of the factor from that of the matrix and the three rows of the factor above it, the nearest first.
fn factored([square, a1, a2, a3]: [f64; 4], [first, second, third]: &[[f64; 4]; 3]) -> Option<[f64; 4]> {
    let l3 = a3 / third[0];
    let l2 = (a2 - l3 * second[1]) / second[0];
    let l1 = (a1 - l3 * first[2] - l2 * first[1]) / first[0];
    let square = square - l3 * l3 - l2 * l2 - l1 * l1;
    (square > 0.0 && square.is_finite()).then(|| [square.sqrt(), l1, l2, l3])
}

/// Right-hand sides of a row less what its three neighbours, the nearest first, take of them, over the diagonal.
fn substituted<const SIDES: usize>(
    mut right: [f64; SIDES],
    factors: [f64; 3],
    neighbours: &[[f64; SIDES]; 3],
    diagonal: f64,
) -> [f64; SIDES] {
    for (factor, neighbour) in factors.iter().zip(neighbours) {
        right.iter_mut().zip(neighbour).for_each(|(right, neighbour)| *right -= factor * neighbour);
    }
    right.map(|right| right / diagonal)
}
