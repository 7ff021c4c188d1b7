//! Integrals over the inserted part of the needle, carried along as it goes deeper.
//!
//! `int_0^d g(s) r(L - d + s) ds` over the tissue's depth `s`, for the functions `r` of which modes are made (1, cos, sin and two
//! exponentials of `l x`). When the needle goes deeper by `h`, every point of tissue moves by `h` towards the base: the
//! integral's functions turn into combinations of themselves, exactly, and only the new end is added. So the springs, the
//! dampers and the remembered cut path cost the same at every step, however long the insertion.

use super::modes::FreeMode;
use crate::quadrature::points;
use nalgebra::{DMatrix, DVector};

/// The functions `r`, from the base `x = 0` to the tip.
#[derive(Debug, Clone)]
pub struct ShapeFunctions {
    length_m: f64,
    wave_numbers_per_m: Vec<f64>,
}

impl ShapeFunctions {
    /// Those of the modes.
    pub fn of(modes: &[FreeMode], length_m: f64) -> Self {
        let wave_numbers_per_m = modes.iter().map(|mode| mode.wave_number_per_m).collect();
        Self { length_m, wave_numbers_per_m }
    }

    /// Number of functions.
    pub fn count(&self) -> usize {
        1 + 4 * self.wave_numbers_per_m.len()
    }

    /// Their values at a point of the needle.
    pub fn at(&self, x_m: f64) -> DVector<f64> {
        let mut values = DVector::from_element(self.count(), 1.0);
        for (i, &l) in self.wave_numbers_per_m.iter().enumerate() {
            let (sin, cos) = (l * x_m).sin_cos();
            let four = [cos, sin, (l * (x_m - self.length_m)).exp(), (-l * x_m).exp()];
            values.as_mut_slice()[1 + 4 * i..][..4].copy_from_slice(&four);
        }
        values
    }

    /// The factors of `1, phi_1, ..` in them: one row per generalised coordinate.
    pub fn factors(&self, modes: &[FreeMode]) -> DMatrix<f64> {
        let mut factors = DMatrix::zeros(1 + modes.len(), self.count());
        factors[(0, 0)] = 1.0;
        for (i, mode) in modes.iter().enumerate() {
            for (j, &factor) in mode.factors.iter().enumerate() {
                factors[(1 + i, 1 + 4 * i + j)] = factor;
            }
        }
        factors
    }

    /// The derivative of each, as a combination of all.
    pub fn derivative(&self) -> DMatrix<f64> {
        let mut matrix = DMatrix::zeros(self.count(), self.count());
        for (i, &l) in self.wave_numbers_per_m.iter().enumerate() {
            let first_column = 1 + 4 * i;
            matrix[(first_column, first_column + 1)] = -l;
            matrix[(first_column + 1, first_column)] = l;
            matrix[(first_column + 2, first_column + 2)] = l;
            matrix[(first_column + 3, first_column + 3)] = -l;
        }
        matrix
    }

    /// Effect of a step of `h` towards the base on the functions: `r(x - h)` in terms of `r(x)`.
    fn shift(&self, h_m: f64) -> Shift {
        Shift {
            turns: self
                .wave_numbers_per_m
                .iter()
                .map(|l| {
                    let (sin, cos) = (l * h_m).sin_cos();
                    [cos, sin, (-l * h_m).exp(), (l * h_m).exp()]
                })
                .collect(),
        }
    }
}

/// See [`ShapeFunctions::shift`].
struct Shift {
    turns: Vec<[f64; 4]>,
}

impl Shift {
    fn apply(&self, values: &mut [f64]) {
        for (four, [cos, sin, rise, fall]) in values[1..].chunks_exact_mut(4).zip(&self.turns) {
            let (c, s) = (four[0], four[1]);
            four[0] = cos * c + sin * s;
            four[1] = cos * s - sin * c;
            four[2] *= rise;
            four[3] *= fall;
        }
    }
}

/// `int g r r^T`: springs or dampers of the tissue, `g` their strength against depth.
#[derive(Debug, Clone)]
pub struct SupportMatrix {
    functions: ShapeFunctions,
    matrix: DMatrix<f64>,
}

impl SupportMatrix {
    /// Path before any insertion.
    pub fn new(functions: &ShapeFunctions) -> Self {
        let count = functions.count();
        Self { functions: functions.clone(), matrix: DMatrix::zeros(count, count) }
    }

    /// The needle goes from one depth to a greater one through tissue in `parts` (thickness, strength) from the first on.
    pub fn advance(&mut self, from_m: f64, to_m: f64, parts: impl Iterator<Item = (f64, f64)>) {
        let shift = self.functions.shift(to_m - from_m);
        let count = self.functions.count();
        for _ in 0..2 {
            for column in self.matrix.as_mut_slice().chunks_exact_mut(count) {
                shift.apply(column);
            }
            self.matrix.transpose_mut();
        }
        // Panels short enough for the highest mode.
        let panel_m = self.functions.wave_numbers_per_m.last().map_or(1.0, |l| 2.0 / l);
        let mut top_m = from_m;
        for (thickness_m, strength) in parts {
            let panels = (thickness_m / panel_m).ceil().max(1.0);
            let step_m = thickness_m / panels;
            for i in 0..panels as usize {
                let start_m = top_m + i as f64 * step_m;
                for (s_m, weight) in points(start_m, start_m + step_m) {
                    let values = self.functions.at(self.functions.length_m - to_m + s_m);
                    self.matrix.ger(weight * strength, &values, &values, 1.0);
                }
            }
            top_m += thickness_m;
        }
    }

    /// The integral.
    pub fn matrix(&self) -> &DMatrix<f64> {
        &self.matrix
    }
}

/// `int g y_1 r`: what the cut path `y_1` pulls with, by the trapezoidal rule.
#[derive(Debug, Clone)]
pub struct CutPathForce {
    functions: ShapeFunctions,
    tip: DVector<f64>,
    sum: DVector<f64>,
}

impl CutPathForce {
    /// Path before any cut.
    pub fn new(functions: &ShapeFunctions) -> Self {
        let tip = functions.at(functions.length_m);
        Self { functions: functions.clone(), sum: DVector::zeros(functions.count()), tip }
    }

    /// The needle goes deeper by `step_m` from where its tip was at `start_m` sideways; `strength` there. The new end of the
    /// path is excluded: it counts with [`CutPathForce::end`] times where the tip will be.
    pub fn advance(&mut self, step_m: f64, strength: f64, start_m: f64) {
        self.sum.axpy(0.5 * step_m * strength * start_m, &self.tip, 1.0);
        self.functions.shift(step_m).apply(self.sum.as_mut_slice());
    }

    /// The share of the new end of a step: times the tip's position it is added by [`CutPathForce::close`].
    pub fn end(&self, step_m: f64, strength: f64) -> DVector<f64> {
        &self.tip * (0.5 * step_m * strength)
    }

    /// Adds the new end.
    pub fn close(&mut self, end: &DVector<f64>, tip_m: f64) {
        self.sum.axpy(tip_m, end, 1.0);
    }

    /// The integral.
    pub fn sum(&self) -> &DVector<f64> {
        &self.sum
    }
}
