//! Loads inside a needle that guide 2 holds at rest in the tissue: force of guide 2, bending moments, compression of the tissue.
//!
//! At one depth each of them is linear in tip load, displacement of guide 2 and cut path, `q = a F + b g + sum_j w_j u_t(z_j)`.
//! All weights of one quantity follow from
//! one solution: `K U = f` and `q = r^T U` give `q = (K^-1 r)^T f`. Between guides and surface one cubic element is exact; in the
//! tissue there is one from
//! node to node, as in [`GrowingBeam`](crate::growth::GrowingBeam), whose [`TipState`]s are the path.
//!
//! A moment is that of the ends of an element, which are in balance with its springs, and not `EI u''` of its shape: that jumps
//! from element to element, and where
//! needle and tissue meet it is wrong by most.

use crate::banded::Banded;
use crate::elements::{GAUSS, add_tension, bending_stiffness, hermite};
use crate::growth::TipState;
use crate::{BeamProblem, ModelError, check};

/// Stiffness of what does not give, N/m and N m: one part in a million of the force at guide 2 for an 18 gauge needle.
const RIGID: f64 = 1e9;
/// Nodes before the tissue: guide 1, guide 2, surface.
const BEFORE: usize = 3;

/// Requested quantity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Inner {
    /// Force of guide 2 on the needle, N.
    Guide2Force,
    /// Bending moment where guide 1 clamps the needle, N m.
    MomentAtGuide1,
    /// Bending moment at guide 2, N m.
    MomentAtGuide2,
    /// Bending moment at the surface, N m.
    MomentAtSurface,
    /// Bending moment in the tissue, at this node of depth (1 or more), N m.
    MomentInTissue(usize),
    /// Deflection of the needle from the cut path, at this node of depth, m: by so much the tissue is compressed there.
    Compression(usize),
}

/// A quantity per unit of what acts on the needle.
#[derive(Debug, Clone, PartialEq)]
pub struct Influence {
    /// Per newton at the tip.
    pub load: f64,
    /// Per metre of guide 2.
    pub guide2: f64,
    /// Per metre of the cut path at the start and the end of every element of tissue.
    pub path: Vec<[f64; 2]>,
}

impl Influence {
    /// Contribution of the path of a tip with these states.
    pub fn of_path(&self, states: &[TipState]) -> f64 {
        let ends = self.path.iter().zip(states.iter().zip(states.iter().skip(1)));
        ends.map(|([start, end], (from, to))| start * from.tip_m[1] + end * to.tip_m[0]).sum()
    }
}

/// An element by what acts on its four unknowns.
struct Element {
    stiffness: [[f64; 4]; 4],
    /// Load on them per path at its start and end.
    path: [[f64; 2]; 4],
}

/// A needle among springs that is held by guide 2, at any of some depths.
pub struct HeldNeedle {
    elements: Vec<Element>,
    guide2_n_per_m: f64,
    clamp_n_m: f64,
}

impl HeldNeedle {
    /// The needle of `problem` with nodes at `depths_m` (0 first, increasing).
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] for a problem out of range, or one with a single guide.
    pub fn new(problem: &BeamProblem, depths_m: &[f64]) -> Result<Self, ModelError> {
        problem.check()?;
        problem.support.needs_springs("loads inside a held needle")?;
        check("guide2_m", problem.guide2_m, "two guides", !problem.only_guide)?;
        let gap_m = problem.entry_m - problem.guide2_m;
        check("entry_m", problem.entry_m, "beyond guide2_m, where guide 2 holds the needle", gap_m > 1e-6)?;
        let mut elements = vec![
            element_of(problem.guide2_m, -problem.axial_load_n, problem.bending_stiffness_n_m2),
            element_of(gap_m, -problem.axial_load_n, problem.bending_stiffness_n_m2),
        ];
        for ends_m in depths_m.windows(2) {
            let length_m = ends_m[1] - ends_m[0];
            let mut element =
                element_of(length_m, problem.shear_n - problem.axial_load_n, problem.bending_stiffness_n_m2);
            element.add_springs(problem, [ends_m[0], ends_m[1]]);
            if elements.len() == 2 {
                element.stiffness[0][0] += problem.skin_n_per_m;
                element.path[0][0] += problem.skin_n_per_m;
            }
            elements.push(element);
        }
        Ok(Self {
            elements,
            guide2_n_per_m: support_stiffness(problem.guide2_compliance_m_per_n),
            clamp_n_m: support_stiffness(problem.clamp_compliance_rad_per_n_m),
        })
    }

    /// Quantities with the tip at a node of depth, 1 or more; those that are asked for beyond the tip are 0.
    ///
    /// # Errors
    /// [`ModelError::Singular`].
    pub fn at(&self, node: usize, asked: &[Inner]) -> Result<Vec<Influence>, ModelError> {
        let elements = self.elements.get(..2 + node).ok_or(ModelError::Singular)?;
        let size = 2 * (elements.len() + 1);
        let mut stiffness = Banded::new(size);
        for (i, element) in elements.iter().enumerate() {
            for (row, values) in element.stiffness.iter().enumerate() {
                for (column, value) in values.iter().enumerate().take(row + 1) {
                    stiffness.add(2 * i + row, 2 * i + column, *value);
                }
            }
        }
        stiffness.add(0, 0, RIGID);
        stiffness.add(1, 1, self.clamp_n_m);
        stiffness.add(2, 2, self.guide2_n_per_m);
        let factor = stiffness.factor().ok_or(ModelError::Singular)?;
        asked.iter().map(|inner| Ok(self.influence(elements, factor, *inner))).collect()
    }

    fn influence(&self, elements: &[Element], factor: &Banded, inner: Inner) -> Influence {
        let mut influence =
            Influence { load: 0.0, guide2: 0.0, path: vec![[0.0; 2]; elements.len() - (BEFORE - 1)] };
        let mut reads = vec![[0.0; 1]; 2 * (elements.len() + 1)];
        // The moment at the start (1) or the end (3) of an element.
        let moment = |reads: &mut Vec<[f64; 1]>, influence: &mut Influence, number: usize, row: usize| {
            let Some(element) = elements.get(number) else { return };
            let sign = if row == 1 { -1.0 } else { 1.0 };
            for (column, value) in element.stiffness[row].iter().enumerate() {
                reads[2 * number + column][0] += sign * value;
            }
            if let Some(path) = number.checked_sub(BEFORE - 1).and_then(|at| influence.path.get_mut(at)) {
                (0..2).for_each(|end| path[end] -= sign * element.path[row][end]);
            }
        };
        match inner {
            Inner::Guide2Force => {
                reads[2][0] = -self.guide2_n_per_m;
                influence.guide2 = self.guide2_n_per_m;
            }
            Inner::MomentAtGuide1 => moment(&mut reads, &mut influence, 0, 1),
            Inner::MomentAtGuide2 => moment(&mut reads, &mut influence, 0, 3),
            Inner::MomentAtSurface => moment(&mut reads, &mut influence, 1, 3),
            Inner::MomentInTissue(node) => moment(&mut reads, &mut influence, node + 1, 3),
            Inner::Compression(node) => {
                if let (Some(read), Some(path)) =
                    (reads.get_mut(2 * (BEFORE - 1 + node)), influence.path.get_mut(node))
                {
                    read[0] = 1.0;
                    path[0] = -1.0;
                }
            }
        }
        factor.solve(&mut reads);
        influence.guide2 += self.guide2_n_per_m * first_at(2, &reads);
        influence.load = first_at(reads.len() - 2, &reads);
        for (i, (weights, element)) in
            influence.path.iter_mut().zip(elements.iter().skip(BEFORE - 1)).enumerate()
        {
            for (row, by_end) in element.path.iter().enumerate() {
                let moved = first_at(2 * (i + BEFORE - 1) + row, &reads);
                (0..2).for_each(|end| weights[end] += moved * by_end[end]);
            }
        }
        influence
    }
}

fn first_at(row: usize, reads: &[[f64; 1]]) -> f64 {
    reads.get(row).map_or(0.0, |value| value[0])
}

/// Stiffness of a support of this compliance, which is a large number where the support is rigid.
fn support_stiffness(compliance: f64) -> f64 {
    if compliance > 0.0 { compliance.recip() } else { RIGID }
}

/// Element of the needle under tension, without a path.
fn element_of(length_m: f64, tension_n: f64, bending_stiffness_n_m2: f64) -> Element {
    let mut stiffness = bending_stiffness(bending_stiffness_n_m2, length_m);
    add_tension(&mut stiffness, tension_n, length_m);
    Element { stiffness, path: [[0.0; 2]; 4] }
}

impl Element {
    /// Springs between two depths, integrated between the faces of layers; they rest on a line from end to end, as the shear
    /// layer does.
    fn add_springs(&mut self, problem: &BeamProblem, [start_m, end_m]: [f64; 2]) {
        let length_m = end_m - start_m;
        let inner_faces = problem.foundation.faces_m().filter(|face_m| *face_m > start_m && *face_m < end_m);
        let mut part_start_m = start_m;
        for to_m in inner_faces.chain([end_m]) {
            for (x, weight) in GAUSS {
                let quadrature_m = part_start_m + x * (to_m - part_start_m);
                let x = (quadrature_m - start_m) / length_m;
                let shape = hermite(x, length_m);
                let measure = weight * (to_m - part_start_m) * problem.foundation.modulus_pa(quadrature_m);
                for (i, own) in shape.iter().enumerate() {
                    for (to, other) in self.stiffness[i].iter_mut().zip(shape) {
                        *to += measure * own * other;
                    }
                    self.path[i][0] += measure * own * (1.0 - x);
                    self.path[i][1] += measure * own * x;
                }
            }
            part_start_m = to_m;
        }
        let shear_n_per_m = problem.shear_n / length_m;
        for (row, sign) in [(0, 1.0), (2, -1.0)] {
            self.path[row][0] += sign * shear_n_per_m;
            self.path[row][1] -= sign * shear_n_per_m;
        }
    }
}

#[cfg(test)]
#[path = "inner_tests.rs"]
mod tests;
