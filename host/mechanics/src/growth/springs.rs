//! The needle among springs as it grows: one element more per step, of which only the last rows of the factor change.

use super::{Guide2Grip, Response, Row};
use crate::banded::Banded;
use crate::elements::{GAUSS, add_tension, bending_stiffness, hermite};
use crate::{BeamProblem, ModelError};

/// The beam from guide 1 to the tip, element by element, with its factor kept up to date.
pub(super) struct SpringBeam<'p> {
    problem: &'p BeamProblem,
    /// Depths of the faces between layers.
    faces_m: Vec<f64>,
    pub length_m: f64,
    stiffness: Banded,
    factor: Banded,
    factored_rows: usize,
    /// Deflection at guide 2, where that holds the needle.
    held: Option<usize>,
    /// Stiffness between guide 2 and its neighbours, where its frame is rigid.
    coupling: Vec<(usize, f64)>,
    rows: usize,
    /// Per tissue element: load on its four unknowns per path at its start and end.
    path_loads: Vec<[[f64; 2]; 4]>,
    first_tissue_row: usize,
    shape: Vec<f64>,
}

impl<'p> SpringBeam<'p> {
    pub fn new(problem: &'p BeamProblem, grip: Guide2Grip) -> Self {
        let mut beam = Self {
            problem,
            faces_m: problem.foundation.faces_m().collect(),
            length_m: 0.0,
            stiffness: Banded::new(2),
            factor: Banded::new(0),
            factored_rows: 0,
            held: (grip == Guide2Grip::Holding).then_some(if problem.only_guide { 0 } else { 2 }),
            coupling: Vec::new(),
            rows: 2,
            path_loads: Vec::new(),
            first_tissue_row: 0,
            shape: Vec::new(),
        };
        if problem.clamp_compliance_rad_per_n_m > 0.0 {
            beam.stiffness.add(1, 1, 1.0 / problem.clamp_compliance_rad_per_n_m);
        } else {
            beam.stiffness.add(1, 1, 1.0);
        }
        if beam.held != Some(0) {
            beam.stiffness.add(0, 0, 1.0);
        }
        beam.extend(problem.guide2_m, None);
        if let Some(row) = beam.held {
            beam.stiffness.add(row, row, beam.frame_n_per_m().unwrap_or(1.0));
        }
        beam
    }

    /// Stiffness of the frame that carries guide 2; nothing where it is rigid.
    fn frame_n_per_m(&self) -> Option<f64> {
        let compliance = self.problem.guide2_compliance_m_per_n;
        (compliance > 0.0).then(|| compliance.recip())
    }

    fn is_fixed(&self, row: usize) -> bool {
        if self.held == Some(row) {
            return self.frame_n_per_m().is_none();
        }
        row == 0 || (row == 1 && self.problem.clamp_compliance_rad_per_n_m == 0.0)
    }

    /// Adds an element; inside the tissue it starts at a depth.
    pub fn extend(&mut self, length_m: f64, depth_m: Option<f64>) {
        if length_m <= 0.0 {
            return;
        }
        let at = self.rows - 2;
        self.stiffness.grow(2);
        self.rows += 2;
        self.length_m += length_m;
        self.factored_rows = self.factored_rows.min(at);
        let mut local = bending_stiffness(self.problem.bending_stiffness_n_m2, length_m);
        let shear_n = if depth_m.is_some() { self.problem.shear_n } else { 0.0 };
        add_tension(&mut local, shear_n - self.problem.axial_load_n, length_m);
        if let Some(depth_m) = depth_m {
            let (mut springs, mut path) = self.springs(depth_m, length_m);
            // The shear layer rests on the cut path too, which is straight over an element.
            let per_m = shear_n / length_m;
            for (row, sign) in [(0, 1.0), (2, -1.0)] {
                path[row][0] += sign * per_m;
                path[row][1] -= sign * per_m;
            }
            if self.path_loads.is_empty() {
                self.first_tissue_row = at;
                // The spring at the surface rests where the tip entered.
                springs[0][0] += self.problem.skin_n_per_m;
                path[0][0] += self.problem.skin_n_per_m;
            }
            for (row, added) in local.iter_mut().zip(&springs) {
                row.iter_mut().zip(added).for_each(|(value, add)| *value += add);
            }
            self.path_loads.push(path);
        }
        for (i, values) in local.iter().enumerate() {
            for (j, value) in values.iter().enumerate().take(i + 1) {
                let (row, column) = (at + i, at + j);
                match (self.is_fixed(row), self.is_fixed(column)) {
                    (false, false) => self.stiffness.add(row, column, *value),
                    (false, true) if self.held == Some(column) => self.coupling.push((row, *value)),
                    (true, false) if self.held == Some(row) => self.coupling.push((column, *value)),
                    _ => {}
                }
            }
        }
    }

    /// Springs of an element between `depth_m` and `depth_m + length_m`, and its load per path at both ends. Integrated between
    /// the faces of layers.
    fn springs(&self, depth_m: f64, length_m: f64) -> ([[f64; 4]; 4], [[f64; 2]; 4]) {
        let (mut springs, mut path) = ([[0.0; 4]; 4], [[0.0; 2]; 4]);
        let end_m = depth_m + length_m;
        let inside = self.faces_m.iter().copied().filter(|face_m| *face_m > depth_m && *face_m < end_m);
        let mut start_m = depth_m;
        for face_m in inside.chain([end_m]) {
            for (x, weight) in GAUSS {
                let at_m = start_m + x * (face_m - start_m);
                let x = (at_m - depth_m) / length_m;
                let shape = hermite(x, length_m);
                let measure = weight * (face_m - start_m) * self.problem.foundation.modulus_pa(at_m);
                for i in 0..4 {
                    for j in 0..4 {
                        springs[i][j] += measure * shape[i] * shape[j];
                    }
                    path[i][0] += measure * shape[i] * (1.0 - x);
                    path[i][1] += measure * shape[i] * x;
                }
            }
            start_m = face_m;
        }
        (springs, path)
    }

    /// Responses of the tip as far as the beam has grown.
    pub fn row(&mut self, slopes: bool) -> Result<Row, ModelError> {
        self.factor.factor_from(&self.stiffness, self.factored_rows).ok_or(ModelError::Singular)?;
        // The last node's rows change with the next element.
        self.factored_rows = self.rows - 2;
        let deflection = self.response([1.0, 0.0]);
        let slope = if slopes { self.response([0.0, 1.0]) } else { Response::none() };
        Ok(Row { deflection, slope })
    }

    /// The functional that a unit load (N or N m) at the tip measures.
    fn response(&mut self, loads: [f64; 2]) -> Response {
        let mut shape = std::mem::take(&mut self.shape);
        self.factor.solve_end(loads, &mut shape);
        let path = self.path_loads.iter().zip(shape[self.first_tissue_row..].windows(4).step_by(2));
        let path = path
            .map(|(load, local)| {
                let at = |end: usize| load.iter().zip(local).map(|(row, value)| row[end] * value).sum();
                [at(0), at(1)]
            })
            .collect();
        // By reciprocity what guide 2 does to the tip is its reaction to the load there: of the frame's spring, or of what holds it.
        let guide2 = match (self.frame_n_per_m(), self.held) {
            (Some(frame_n_per_m), Some(row)) => frame_n_per_m * shape[row],
            _ => -self.coupling.iter().map(|(row, value)| value * shape[*row]).sum::<f64>(),
        };
        let turned = shape[self.rows - 1] - if self.is_fixed(1) { 0.0 } else { shape[1] };
        let curvature = self.problem.bending_stiffness_n_m2 * turned;
        let response = Response { load: shape[self.rows - 2], guide2, curvature, path };
        self.shape = shape;
        response
    }
}
