//! The needle in an elastic body: one polynomial below the surface, exact beam-columns above it
//! (theory, eq. 16).
//!
//! Unknowns are the rotation in guide 1 where that gives, deflection and slope at the ends of the pieces above the body, and the
//! Legendre coefficients c of the deflection in the body; the deflection and slope where the body begins follow from c. Energy:
//! `EI/2 int u''^2 - P/2 int u'^2` of all pieces, `G/2 int u'^2` below the surface, the skin's and the clamp's springs, and
//! `E/2 c^T T c` of the body. Ten polynomials resolve needles up to six characteristic lengths deep (bending within 0.01 %).

use super::super::series::Equation;
use super::super::{BeamProblem, ModelError};
use super::legendre::{ENERGIES, Energies, InBody, evaluated, lengthened, powers};
use super::table::{MODES, Matrix};

/// Unknowns at most: a rotation, two nodes of two, and the coefficients.
const MAX_UNKNOWNS: usize = 5 + MODES;
/// Lengths below this are none.
const MIN_M: f64 = 1e-9;
/// A gap below this share of the depth is short.
const SHORT_GAP: f64 = 0.02;

/// A vector of unknowns.
pub(super) type Unknowns = [f64; MAX_UNKNOWNS];

/// A unit load.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Load {
    /// 1 N at guide 2.
    Guide2,
    /// 1 N at the tip.
    Tip,
    /// 1 N m at the tip.
    TipMoment,
}

/// Deflection and slope of a section as sums of unknowns: unknown and factor.
type Section = [Vec<(usize, f64)>; 2];

/// A piece of the needle above the body.
#[derive(Debug, Clone)]
struct Piece {
    start_m: f64,
    length_m: f64,
    equation: Equation,
    fundamental: [f64; 4],
    ends: [Section; 2],
}

/// The needle's equations.
#[derive(Debug, Clone)]
pub(crate) struct Ritz {
    pieces: Vec<Piece>,
    guide2: Section,
    stiffness: [Unknowns; MAX_UNKNOWNS],
    /// First coefficient, and number of unknowns.
    first: usize,
    count: usize,
    /// Start of the body, and the depth to which it holds the needle.
    body_m: f64,
    depth_m: f64,
    /// Deflection at the surface.
    surface: Section,
    tissue: Matrix,
}

/// The factored equations.
#[derive(Debug, Clone)]
pub(crate) struct Solved {
    factor: [Unknowns; MAX_UNKNOWNS],
}

/// The needle's shape under a load.
#[derive(Debug, Clone)]
pub(crate) struct Shape(Unknowns);

impl Ritz {
    /// The equations of a problem; `None` where no body holds the needle.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`], [`ModelError::Singular`] where an axial load buckles a piece.
    pub fn new(problem: &BeamProblem) -> Result<Option<Self>, ModelError> {
        let surface_m = super::surface_m(&problem.foundation);
        let depth_m = problem.depth_m - surface_m;
        if depth_m <= MIN_M {
            return Ok(None);
        }
        let tissue = Self::tissue(problem, [surface_m, depth_m])?;
        Self::with_tissue(problem, surface_m, tissue).map(Some)
    }

    /// The same where a short piece between the surface and the body belongs to the polynomial of the needle in the body: by itself it
    /// would be stiffer than the body by more than the digits of a number (12 EI/L^3).
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn joining_short_gap(problem: &BeamProblem) -> Result<Option<Self>, ModelError> {
        let gap_m = super::surface_m(&problem.foundation);
        let held_depth_m = problem.depth_m - gap_m;
        if gap_m <= 0.0 || gap_m >= SHORT_GAP * held_depth_m {
            return Self::new(problem);
        }
        let tissue = Self::tissue(problem, [gap_m, held_depth_m])?;
        Self::with_tissue(problem, 0.0, lengthened(&tissue, gap_m / problem.depth_m)).map(Some)
    }

    /// Stiffness of the body below a depth.
    fn tissue(problem: &BeamProblem, span_m: [f64; 2]) -> Result<Matrix, ModelError> {
        super::stiffness(&problem.foundation, problem.support, problem.give, problem.radius_m, span_m)
    }

    /// With the stiffness of the body against the polynomials from a depth below the surface on.
    fn with_tissue(problem: &BeamProblem, from_m: f64, tissue: Matrix) -> Result<Self, ModelError> {
        let mut ritz = Self {
            pieces: Vec::with_capacity(3),
            guide2: Section::default(),
            stiffness: [[0.0; MAX_UNKNOWNS]; MAX_UNKNOWNS],
            first: 0,
            count: 0,
            body_m: problem.entry_m + from_m,
            depth_m: problem.depth_m - from_m,
            surface: Section::default(),
            tissue,
        };
        ritz.place(problem)?;
        Ok(ritz)
    }

    /// Lays out the unknowns and adds every part's stiffness.
    fn place(&mut self, problem: &BeamProblem) -> Result<(), ModelError> {
        let clamp = problem.clamp_compliance_rad_per_n_m;
        let mut start = Section::default();
        if problem.only_guide {
            // Guide 2 moves the needle where it begins.
            start[0].push((0, 1.0));
            self.count = 1;
        }
        if clamp > 0.0 {
            start[1].push((self.count, 1.0));
            self.stiffness[self.count][self.count] += 1.0 / clamp;
            self.count += 1;
        }
        let first_guide = problem.only_guide.then(|| start.clone());
        let (free_axial_n, tissue_axial_n) = (problem.axial_load_n, problem.axial_load_n - problem.shear_n);
        let faces = [
            (problem.guide2_m, free_axial_n),
            (problem.entry_m, free_axial_n),
            (self.body_m, tissue_axial_n),
        ];
        let ends: Vec<f64> = faces
            .iter()
            .map(|(face_m, _)| *face_m)
            .filter(|m| *m > MIN_M && self.body_m - m > MIN_M)
            .collect();
        // Nodes above the body are those that do not lie where it begins, or on one another.
        let mut nodes_m: Vec<f64> = Vec::with_capacity(2);
        for end_m in ends {
            if nodes_m.last().is_none_or(|last_m| end_m - last_m > MIN_M) {
                nodes_m.push(end_m);
            }
        }
        self.first = self.count + 2 * nodes_m.len();
        let at_body: Section = {
            let first = self.first;
            [
                (0..MODES).map(|i| (first + i, end_sign(i))).collect(),
                (1..MODES).map(|i| (first + i, self.end_slope(i))).collect(),
            ]
        };
        (self.guide2, self.surface) = (
            section_at(problem.guide2_m, self.count, &at_body, &nodes_m),
            section_at(problem.entry_m, self.count, &at_body, &nodes_m),
        );
        if let Some(first_guide) = first_guide {
            self.guide2 = first_guide;
        }
        let mut start_m = 0.0;
        for (face_m, axial_n) in faces {
            if face_m - start_m <= MIN_M {
                continue;
            }
            let end = section_at(face_m, self.count, &at_body, &nodes_m);
            self.add_piece(
                start_m,
                face_m - start_m,
                axial_n,
                problem.bending_stiffness_n_m2,
                [start, end.clone()],
            )?;
            (start, start_m) = (end, face_m);
        }
        self.count = self.first + MODES;
        self.add_product(&self.surface[0].clone(), &self.surface[0].clone(), problem.skin_n_per_m);
        self.add_product(&self.guide2[1].clone(), &self.guide2[1].clone(), problem.guide2_turn_n_m_per_rad);
        let tip: Vec<(usize, f64)> = (0..MODES).map(|mode| (self.first + mode, 1.0)).collect();
        self.add_product(&tip, &tip, problem.tip_support_n_per_m);
        let bending = 8.0 * problem.bending_stiffness_n_m2 / self.depth_m.powi(3);
        let tension = -2.0 * tissue_axial_n / self.depth_m;
        let Energies { slopes, curvatures } = &*ENERGIES;
        for i in 0..MODES {
            for j in 0..MODES {
                self.stiffness[self.first + i][self.first + j] +=
                    bending * curvatures[i][j] + tension * slopes[i][j] + self.tissue[i][j];
            }
        }
        Ok(())
    }

    /// Slope of a polynomial at the surface.
    fn end_slope(&self, i: usize) -> f64 {
        -end_sign(i) * (i * (i + 1)) as f64 / self.depth_m
    }

    /// Adds a beam-column without tissue: its end forces by its ends' deflections and slopes, exactly.
    fn add_piece(
        &mut self,
        start_m: f64,
        length_m: f64,
        axial_n: f64,
        stiffness_n_m2: f64,
        ends: [Section; 2],
    ) -> Result<(), ModelError> {
        let axial = axial_n * length_m * length_m / stiffness_n_m2;
        let equation = Equation::new(0.0, axial, axial.abs());
        let piece = Piece { start_m, length_m, equation, fundamental: equation.fundamental(), ends };
        let unit = stiffness_n_m2 / length_m.powi(3);
        for column in 0..4 {
            let state = std::array::from_fn(|i| if i == column { 1.0 } else { 0.0 });
            let [second, third] = piece.start(state).ok_or(ModelError::Singular)?;
            let [_, _, g2, g3] = piece.fundamental;
            let shear = third + axial * state[1];
            let forces = [shear, -second, -shear, second * g3 + third * g2];
            for (row, force) in forces.into_iter().enumerate() {
                self.add_product(
                    end_vector(row, &piece.ends),
                    end_vector(column, &piece.ends),
                    unit * force * rotation_scale(row, length_m) * rotation_scale(column, length_m),
                );
            }
        }
        self.pieces.push(piece);
        Ok(())
    }

    fn add_product(&mut self, rows: &[(usize, f64)], columns: &[(usize, f64)], value: f64) {
        for (row, a) in rows {
            for (column, b) in columns {
                self.stiffness[*row][*column] += value * a * b;
            }
        }
    }

    /// The needle's equations, factored.
    ///
    /// # Errors
    /// [`ModelError::Singular`] where they have no unique solution.
    pub fn factor(&self) -> Result<Solved, ModelError> {
        self.factor_with(&[[0.0; MODES]; MODES])
    }

    /// The same with stiffness added against the coefficients.
    pub fn factor_with(&self, added: &Matrix) -> Result<Solved, ModelError> {
        let mut factor = self.stiffness;
        for (row, more) in factor[self.first..].iter_mut().zip(added) {
            row[self.first..].iter_mut().zip(more).for_each(|(value, more)| *value += more);
        }
        for i in 0..self.count {
            for j in 0..=i {
                let (factored, current_rows) = factor.split_at_mut(i);
                let row = &mut current_rows[0];
                let other_row = if j < i { factored[j] } else { *row };
                let solved_sum: f64 = row[..j].iter().zip(&other_row[..j]).map(|(a, b)| a * b).sum();
                let value = row[j] - solved_sum;
                row[j] = if j < i {
                    value / other_row[j]
                } else if value > 0.0 && value.is_finite() {
                    value.sqrt()
                } else {
                    return Err(ModelError::Singular);
                };
            }
        }
        Ok(Solved { factor })
    }

    /// Work of a unit load per unknown.
    fn load(&self, load: Load) -> Unknowns {
        let mut loads = [0.0; MAX_UNKNOWNS];
        match load {
            Load::Guide2 => self.guide2[0].iter().for_each(|(unknown, factor)| loads[*unknown] = *factor),
            Load::Tip => loads[self.first..self.count].fill(1.0),
            Load::TipMoment => {
                for (i, value) in loads[self.first..self.count].iter_mut().enumerate() {
                    *value = (i * (i + 1)) as f64 / self.depth_m;
                }
            }
        }
        loads
    }

    /// The needle under a unit load.
    pub fn shape(&self, solved: &Solved, load: Load) -> Shape {
        self.solve(solved, self.load(load))
    }

    /// The needle under loads on its unknowns.
    pub fn solve(&self, Solved { factor }: &Solved, mut right: Unknowns) -> Shape {
        for i in 0..self.count {
            let solved_sum: f64 = factor[i][..i].iter().zip(&right[..i]).map(|(a, b)| a * b).sum();
            right[i] = (right[i] - solved_sum) / factor[i][i];
        }
        for i in (0..self.count).rev() {
            let solved_sum: f64 = (i + 1..self.count).map(|k| factor[k][i] * right[k]).sum();
            right[i] = (right[i] - solved_sum) / factor[i][i];
        }
        Shape(right)
    }

    /// Projection of a shape on a unit load: its deflection or slope there.
    pub fn work(&self, load: Load, shape: &Shape) -> f64 {
        self.load(load).iter().zip(&shape.0).map(|(a, b)| a * b).sum()
    }

    /// Deflection at the surface.
    pub fn surface_m(&self, shape: &Shape) -> f64 {
        self.surface[0].iter().map(|(unknown, factor)| factor * shape.0[*unknown]).sum()
    }

    /// Loads on the coefficients as loads on all unknowns.
    pub fn on_coefficients(&self, loads: &[f64; MODES]) -> Unknowns {
        let mut coefficients_all = [0.0; MAX_UNKNOWNS];
        coefficients_all[self.first..].iter_mut().zip(loads).for_each(|(to, load)| *to = *load);
        coefficients_all
    }

    /// Largest difference of two shapes' coefficients.
    pub fn distance(&self, a: &Shape, b: &Shape) -> f64 {
        let coefficient_pairs = a.0[self.first..self.count].iter().zip(&b.0[self.first..self.count]);
        coefficient_pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }

    /// Deflection and slope at a place on the needle.
    pub fn at(&self, shape: &Shape, z_m: f64) -> [f64; 2] {
        let in_body = z_m >= self.body_m;
        let free_piece = self.pieces(shape).take_while(|(start_m, ..)| *start_m <= z_m).last();
        match free_piece.filter(|_| !in_body) {
            Some((start_m, length_m, equation, start)) => {
                let mut series = Default::default();
                equation.expand(start, &mut series);
                evaluated(series.as_flattened(), (z_m - start_m) / length_m, length_m)
            }
            None => self.in_body(shape).at(z_m),
        }
    }

    /// The needle in the body, for many places.
    pub fn in_body(&self, shape: &Shape) -> InBody {
        InBody { powers: powers(&self.coefficients(shape)), body_m: self.body_m, depth_m: self.depth_m }
    }

    /// Coefficients of the deflection in the body.
    pub fn coefficients(&self, shape: &Shape) -> [f64; MODES] {
        std::array::from_fn(|i| shape.0[self.first + i])
    }

    /// Forces of the body against the coefficients: its stiffness times them.
    pub fn tissue_forces(&self, coefficients: &[f64; MODES]) -> [f64; MODES] {
        self.tissue.map(|row| row.iter().zip(coefficients).map(|(t, c)| t * c).sum())
    }

    /// Start of the body along the needle, and the depth to which it holds the needle.
    pub fn body_m(&self) -> [f64; 2] {
        [self.body_m, self.depth_m]
    }

    /// Pieces of the needle, from guide 1 on: start, length, and value and three derivatives in units of the piece at its start; the
    /// last one, in the body, as a polynomial instead.
    pub fn pieces(&self, shape: &Shape) -> impl Iterator<Item = (f64, f64, Equation, [f64; 4])> {
        self.pieces.iter().map(|piece| {
            let [[u0, v0], [u1, v1]] = [0, 1].map(|end| {
                let [deflection, slope] = &piece.ends[end];
                [section_value(deflection, &shape.0), section_value(slope, &shape.0) * piece.length_m]
            });
            let [second, third] = piece.start([u0, v0, u1, v1]).unwrap_or([f64::NAN; 2]);
            (piece.start_m, piece.length_m, piece.equation, [u0, v0, second, third])
        })
    }
}

/// Value that a section has in a shape.
fn section_value(section: &[(usize, f64)], shape_0: &[f64; MAX_UNKNOWNS]) -> f64 {
    section.iter().map(|(i, f)| f * shape_0[*i]).sum::<f64>()
}

/// Rotations of an element's ends are multiplied by its length.
fn rotation_scale(i: usize, length_m: f64) -> f64 {
    if i % 2 == 1 { length_m } else { 1.0 }
}

fn end_vector(i: usize, ends: &[[Vec<(usize, f64)>; 2]; 2]) -> &Vec<(usize, f64)> {
    &ends[i / 2][i % 2]
}

/// Deflection and slope at a place, as sums over the unknowns.
fn section_at(
    z_m: f64,
    count: usize,
    at_body: &[Vec<(usize, f64)>; 2],
    nodes_m: &[f64],
) -> [Vec<(usize, f64)>; 2] {
    match nodes_m.iter().position(|node_m| (node_m - z_m).abs() <= MIN_M) {
        Some(node) => [vec![(count + 2 * node, 1.0)], vec![(count + 2 * node + 1, 1.0)]],
        None => at_body.clone(),
    }
}

/// Value of a polynomial at the surface.
fn end_sign(i: usize) -> f64 {
    if i.is_multiple_of(2) { 1.0 } else { -1.0 }
}

impl Piece {
    /// Second and third derivative at the start, by deflection and slope at both ends, all in units of the piece's length; nothing
    /// where an axial load buckles it.
    fn start(&self, [u0, v0, u1, v1]: [f64; 4]) -> Option<[f64; 2]> {
        let [g0, g1, g2, _] = self.fundamental;
        let determinant = g1 * g1 - g0 * g2;
        let (a, b) = (u1 - u0 - v0, v1 - v0);
        (determinant > 0.0).then(|| [(g1 * a - g0 * b) / determinant, (g1 * b - g2 * a) / determinant])
    }
}

impl Shape {
    /// The shape under so many times the load.
    pub fn scaled(&self, factor: f64) -> Self {
        Self(self.0.map(|value| factor * value))
    }

    /// The sum of two shapes.
    pub fn plus(&self, other: &Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] + other.0[i]))
    }
}
