//! The needle among springs as it grows: one element more per step, of which only the last rows of the factor change.

use super::memory::{STATES, Step};
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
    rows: usize,
    /// Elements that are not in the factor yet.
    added: Vec<Added>,
    /// The node whose unknowns these act on: the newest in the factor.
    node: usize,
    /// Force of guide 2, and rotation at guide 1, per deflection and slope of that node where only its load acts on the needle.
    guide2: [f64; 2],
    turned: [f64; 2],
    /// Elements of tissue.
    pub steps: Vec<Step>,
}

/// An element by what acts on its four unknowns.
struct Added {
    /// Stiffness between guide 2 and them, where its frame is rigid.
    coupling: [f64; 4],
    /// In the tissue, load on them per path at its start and end.
    path: Option<[[f64; 2]; 4]>,
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
            rows: 2,
            added: Vec::new(),
            node: 0,
            guide2: [0.0; 2],
            turned: [0.0; 2],
            steps: Vec::new(),
        };
        if problem.clamp_compliance_rad_per_n_m > 0.0 {
            beam.stiffness.add(1, 1, 1.0 / problem.clamp_compliance_rad_per_n_m);
        } else {
            beam.stiffness.add(1, 1, 1.0);
        }
        if beam.held != Some(0) {
            beam.stiffness.add(0, 0, 1.0);
        }
        if !beam.is_fixed(1) {
            beam.turned[1] = 1.0;
        }
        beam.hold_by_frame();
        beam.extend(problem.guide2_m, None);
        if let Some(row) = beam.held {
            beam.stiffness.add(row, row, beam.frame_n_per_m().unwrap_or(1.0));
        }
        beam
    }

    /// Stiffness of the frame that carries guide 2; `None` where it is rigid.
    fn frame_n_per_m(&self) -> Option<f64> {
        let compliance = self.problem.guide2_compliance_m_per_n;
        (compliance > 0.0).then(|| compliance.recip())
    }

    /// At the node that guide 2 holds by a frame, its force is that of the frame's spring.
    fn hold_by_frame(&mut self) {
        if let Some(frame_n_per_m) = self.frame_n_per_m().filter(|_| self.held == Some(2 * self.node)) {
            self.guide2[0] += frame_n_per_m;
        }
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
        let first_row = self.rows - 2;
        self.stiffness.grow(2);
        self.rows += 2;
        self.length_m += length_m;
        self.factored_rows = self.factored_rows.min(first_row);
        let mut local = bending_stiffness(self.problem.bending_stiffness_n_m2, length_m);
        let shear_n = if depth_m.is_some() { self.problem.shear_n } else { 0.0 };
        add_tension(&mut local, shear_n - self.problem.axial_load_n, length_m);
        let mut path_loads = None;
        if let Some(depth_m) = depth_m {
            let (mut springs, mut path) = self.springs(depth_m, length_m);
            // The shear layer rests on the cut path too, which is straight over an element.
            let shear_per_m = shear_n / length_m;
            for (row, sign) in [(0, 1.0), (2, -1.0)] {
                path[row][0] += sign * shear_per_m;
                path[row][1] -= sign * shear_per_m;
            }
            if self.is_at_surface() {
                // The spring at the surface rests where the tip entered.
                springs[0][0] += self.problem.skin_n_per_m;
                path[0][0] += self.problem.skin_n_per_m;
            }
            for (row, added) in local.iter_mut().zip(&springs) {
                row.iter_mut().zip(added).for_each(|(value, add)| *value += add);
            }
            path_loads = Some(path);
        }
        let mut coupling = [0.0; 4];
        for (i, values) in local.iter().enumerate() {
            for (j, value) in values.iter().enumerate().take(i + 1) {
                let (row, column) = (first_row + i, first_row + j);
                match (self.is_fixed(row), self.is_fixed(column)) {
                    (false, false) => self.stiffness.add(row, column, *value),
                    (false, true) if self.held == Some(column) => coupling[i] += value,
                    (true, false) if self.held == Some(row) => coupling[j] += value,
                    _ => {}
                }
            }
        }
        self.added.push(Added { coupling, path: path_loads });
    }

    /// Whether no element of tissue is there yet.
    fn is_at_surface(&self) -> bool {
        self.steps.is_empty() && self.added.iter().all(|added| added.path.is_none())
    }

    /// Springs of an element between `depth_m` and `depth_m + length_m`, and its load per path at both ends. Integrated between
    /// the faces of layers.
    fn springs(&self, depth_m: f64, length_m: f64) -> ([[f64; 4]; 4], [[f64; 2]; 4]) {
        let (mut springs, mut path) = ([[0.0; 4]; 4], [[0.0; 2]; 4]);
        let end_m = depth_m + length_m;
        let inner_faces = self.faces_m.iter().copied().filter(|face_m| *face_m > depth_m && *face_m < end_m);
        let mut start_m = depth_m;
        for face_m in inner_faces.chain([end_m]) {
            for (x, weight) in GAUSS {
                let quadrature_m = start_m + x * (face_m - start_m);
                let x = (quadrature_m - depth_m) / length_m;
                let shape = hermite(x, length_m);
                let measure = weight * (face_m - start_m) * self.problem.foundation.modulus_pa(quadrature_m);
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
        for Added { coupling, path } in std::mem::take(&mut self.added) {
            let per_next = self.factor.per_next(2 * self.node).ok_or(ModelError::Singular)?;
            // By reciprocity what guide 2 does to the tip is its reaction to the load there: of the frame's spring, or of what holds it.
            self.guide2 = handed_on(self.guide2, coupling.map(|value| -value), per_next);
            self.turned = handed_on(self.turned, [0.0; 4], per_next);
            self.node += 1;
            self.hold_by_frame();
            if let Some(path) = path {
                self.steps.push(Step {
                    nodes: [0; 2],
                    per_next,
                    start: end_states(0, path, per_next),
                    end: end_states(1, path, per_next),
                });
            }
        }
        let deflection = self.response([1.0, 0.0]);
        let slope = if slopes { self.response([0.0, 1.0]) } else { Response::none() };
        Ok(Row { deflection, slope, steps: self.steps.len() })
    }

    /// The functional that a unit load (N or N m) at the tip measures.
    fn response(&self, loads: [f64; 2]) -> Response {
        let tip = self.factor.solve_end(loads);
        let curvature = self.problem.bending_stiffness_n_m2 * (tip[1] - product(self.turned, tip));
        let mut path = [0.0; STATES];
        path[..2].copy_from_slice(&tip);
        Response { load: tip[0], guide2: product(self.guide2, tip), curvature, path, dense: Vec::new() }
    }
}

fn product(functional: [f64; 2], tip: [f64; 2]) -> f64 {
    functional[0] * tip[0] + functional[1] * tip[1]
}

/// Functional of a path's end value on all states.
fn end_states(end: usize, path: [[f64; 2]; 4], per_next: [[f64; 2]; 2]) -> [f64; STATES] {
    let mut states = [0.0; STATES];
    states[..2].copy_from_slice(&handed_on([0.0; 2], path.map(|row| row[end]), per_next));
    states
}

/// State at the next node, from the state at this one and the path's end values.
fn handed_on(at: [f64; 2], [first, second, third, fourth]: [f64; 4], per_next: [[f64; 2]; 2]) -> [f64; 2] {
    let preceding = [at[0] + first, at[1] + second];
    [combination(0, per_next, preceding) + third, combination(1, per_next, preceding) + fourth]
}

/// One component of the state at the next node.
fn combination(column: usize, per_next: [[f64; 2]; 2], preceding: [f64; 2]) -> f64 {
    per_next[0][column] * preceding[0] + per_next[1][column] * preceding[1]
}
