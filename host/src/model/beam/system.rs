//! The beam's linear system: banded, with two right-hand sides, solved with partial pivoting.

/// Sub- and super-diagonals of the beam system; pivoting fills as many more super-diagonals as there are sub-diagonals.
const LOWER: usize = 5;
const UPPER: usize = 2;
const WIDTH: usize = 2 * LOWER + UPPER + 1;
/// Columns from a pivot on that its row can reach.
const REACH: usize = LOWER + UPPER + 1;

/// A banded linear system with two right-hand sides.
pub(super) struct Banded {
    /// Row i, column j at `rows[i][j + LOWER - i]`.
    rows: Vec<[f64; WIDTH]>,
    /// Right-hand sides, row by row.
    pub(super) right: Vec<[f64; 2]>,
}

impl Banded {
    /// Zeros.
    pub(super) fn new(size: usize) -> Self {
        Self { rows: vec![[0.0; WIDTH]; size], right: vec![[0.0; 2]; size] }
    }

    /// Sets an entry within the band.
    pub(super) fn set(&mut self, row: usize, column: usize, value: f64) {
        self.rows[row][column + LOWER - row] = value;
    }

    /// Gaussian elimination with partial pivoting; nothing where a pivot vanishes.
    pub(super) fn solve(mut self) -> Option<Vec<[f64; 2]>> {
        let size = self.rows.len();
        for k in 0..size {
            let below = (k + LOWER).min(size - 1);
            let right_end = (k + LOWER + UPPER).min(size - 1);
            let at = |row: usize| self.rows[row][k + LOWER - row].abs();
            let pivot = (k..=below).max_by(|a, b| at(*a).total_cmp(&at(*b)))?;
            if at(pivot) == 0.0 || !at(pivot).is_finite() {
                return None;
            }
            if pivot != k {
                for j in k..=right_end {
                    let (mine, other) = (self.rows[k][j + LOWER - k], self.rows[pivot][j + LOWER - pivot]);
                    self.rows[k][j + LOWER - k] = other;
                    self.rows[pivot][j + LOWER - pivot] = mine;
                }
                self.right.swap(k, pivot);
            }
            let (done, rest) = self.rows.split_at_mut(k + 1);
            let from: [f64; REACH] = std::array::from_fn(|j| done[k][LOWER + j]);
            let right = self.right[k];
            for (step, row) in rest.iter_mut().take(below - k).enumerate() {
                // Beyond the last column there are zeros.
                let first = LOWER - 1 - step;
                let factor = row[first] / from[0];
                if factor == 0.0 {
                    continue;
                }
                row[first..first + REACH].iter_mut().zip(&from).for_each(|(to, from)| *to -= factor * from);
                self.right[k + 1 + step].iter_mut().zip(right).for_each(|(to, from)| *to -= factor * from);
            }
        }
        for k in (0..size).rev() {
            let right_end = (k + LOWER + UPPER).min(size - 1);
            for load in 0..2 {
                let known: f64 =
                    (k + 1..=right_end).map(|j| self.rows[k][j + LOWER - k] * self.right[j][load]).sum();
                self.right[k][load] = (self.right[k][load] - known) / self.rows[k][LOWER];
            }
        }
        Some(self.right)
    }
}
