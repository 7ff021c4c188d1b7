//! The needle by Hermite finite elements, for what the exact solution cannot do: stiffness that varies with depth in any way,
//! springs that are not linear, springs at rest on a cut path.
//!
//! `EI u'''' + r(z, u - u_t) = F delta(z - c2)` with the supports of [`BeamProblem`]; weak form, cubic elements, four Gauss
//! points per element, Newton's method, banded Cholesky (half-bandwidth 3): the work grows linearly with the number of
//! elements (theory, eq. 6). Elements end at guide 2, at the surface and at the faces of layers.

mod newton;

use super::terms::ActingLaw;
use super::{BeamProblem, Foundation, ModelError, check};

/// Length of an element that brings the error below one part in a million for needles in tissue.
pub const DEFAULT_ELEMENT_M: f64 = 0.5e-3;
const MAX_ELEMENTS: f64 = 100_000.0;

/// Lateral reaction of the tissue on a point of the needle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reaction {
    /// Force per length that pushes the needle back, N/m.
    pub force_n_per_m: f64,
    /// Its derivative with respect to the stretch, N/m per m; not negative.
    pub tangent_pa: f64,
}

/// Response of the tissue.
pub trait Springs {
    /// Properties at one depth, independent of the needle's displacement.
    type Place;

    /// Properties at a depth below the surface.
    fn place(&self, depth_m: f64) -> Self::Place;

    /// Reaction there to a deflection from the place where the springs are at rest.
    fn reaction(&self, place: &Self::Place, stretch_m: f64) -> Reaction;
}

impl Springs for Foundation {
    type Place = f64;

    fn place(&self, depth_m: f64) -> f64 {
        self.modulus_pa(depth_m)
    }

    fn reaction(&self, modulus_pa: &f64, stretch_m: f64) -> Reaction {
        Reaction { force_n_per_m: modulus_pa * stretch_m, tangent_pa: *modulus_pa }
    }
}

impl<F: Fn(f64, f64) -> Reaction> Springs for F {
    type Place = f64;

    fn place(&self, depth_m: f64) -> f64 {
        depth_m
    }

    fn reaction(&self, depth_m: &f64, stretch_m: f64) -> Reaction {
        self(*depth_m, stretch_m)
    }
}

/// Rest positions of the springs.
#[derive(Debug, Clone, Copy)]
pub(super) struct StressFreePath<P> {
    /// At any place along the needle.
    pub path_m: P,
    /// From here on they are at rest on the straight line from this deflection to that of the tip, which is cutting them.
    pub newest: Option<Newest>,
}

/// The newest end of a cut path.
#[derive(Debug, Clone, Copy)]
pub(super) struct Newest {
    /// Position at which it begins.
    pub from_z_m: f64,
    /// Deflection there.
    pub from_m: f64,
}

/// Motion of guide 2.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Guide2 {
    /// Pushes with a force, N.
    Force(f64),
    /// Holds the needle at a displacement, m.
    Held(f64),
    /// Holds it by a spring that is at rest at a displacement.
    Sprung {
        /// Rest position of the spring, m.
        at_m: f64,
        /// Compliance of the spring, more than 0.
        compliance_m_per_n: f64,
    },
}

/// A needle cut into elements.
#[derive(Debug, Clone)]
pub struct Elements {
    bending_stiffness_n_m2: f64,
    entry_m: f64,
    only_guide: bool,
    clamp_compliance_rad_per_n_m: f64,
    axial_load_n: f64,
    shear_n: f64,
    skin_n_per_m: f64,
    guide2_turn_n_m_per_rad: f64,
    tip_support_n_per_m: f64,
    /// Stress-free curvature of the needle.
    curvature_per_m: f64,
    /// Laws that act on the bending stiffness along the needle.
    stiffness: Vec<ActingLaw>,
    nodes_m: Vec<f64>,
    guide2: usize,
}

/// The deformed needle.
#[derive(Debug, Clone, PartialEq)]
pub struct Deformed {
    nodes_m: Vec<f64>,
    /// Deflection and slope at every node.
    states: Vec<[f64; 2]>,
    /// Force of guide 2 on the needle, N.
    pub guide2_force_n: f64,
}

impl Elements {
    /// Cuts the needle of a problem into elements no longer than `element_m`.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] for lengths or stiffness out of range, or more elements than make sense.
    pub fn new(problem: &BeamProblem, element_m: f64) -> Result<Self, ModelError> {
        problem.check()?;
        problem.support.needs_springs("a needle cut into elements")?;
        let length_m = problem.entry_m + problem.depth_m;
        let count = length_m / element_m;
        check("element_m", element_m, "a hundred-thousandth of the needle or more", count <= MAX_ELEMENTS)?;
        let mut nodes_m = vec![0.0];
        let mut faces_m = vec![problem.guide2_m, problem.entry_m];
        let tissue_faces = problem.foundation.faces_m().map(|face_m| problem.entry_m + face_m);
        faces_m.extend(tissue_faces.filter(|face_m| *face_m < length_m));
        faces_m.push(length_m);
        let mut guide2 = 0;
        let mut start_m = 0.0;
        for (index, end_m) in faces_m.into_iter().enumerate() {
            let count = ((end_m - start_m) / element_m).ceil();
            for i in 1..=count as usize {
                nodes_m.push(start_m + (end_m - start_m) * i as f64 / count);
            }
            if index == 0 {
                guide2 = nodes_m.len() - 1;
            }
            start_m = end_m;
        }
        Ok(Self {
            bending_stiffness_n_m2: problem.bending_stiffness_n_m2,
            entry_m: problem.entry_m,
            only_guide: problem.only_guide,
            clamp_compliance_rad_per_n_m: problem.clamp_compliance_rad_per_n_m,
            axial_load_n: problem.axial_load_n,
            shear_n: problem.shear_n,
            skin_n_per_m: problem.skin_n_per_m,
            guide2_turn_n_m_per_rad: problem.guide2_turn_n_m_per_rad,
            tip_support_n_per_m: problem.tip_support_n_per_m,
            curvature_per_m: 0.0,
            stiffness: problem.stiffness.clone(),
            nodes_m,
            guide2,
        })
    }

    /// The same needle, bent by itself: `EI (u'' - curvature)` in place of `EI u''`.
    pub fn bent(&self, curvature_per_m: f64) -> Self {
        Self { curvature_per_m, ..self.clone() }
    }

    /// Mean bending stiffness of the needle over an element, by how much it is larger than without laws.
    fn stiffness_share(&self, start_m: f64, length_m: f64) -> f64 {
        if self.stiffness.is_empty() {
            return 1.0;
        }
        let whole_m = self.nodes_m.last().copied().unwrap_or_default();
        GAUSS
            .into_iter()
            .map(|(x, weight)| {
                weight * ActingLaw::stiffness(&self.stiffness, start_m + x * length_m, whole_m)
            })
            .sum()
    }

    /// Solves for the equilibrium. `path_m`: deflection at which the springs at `z` are at rest; `tip_force_n`: lateral load at
    /// the tip.
    ///
    /// # Errors
    /// [`ModelError::NotConverged`], [`ModelError::Singular`].
    pub fn solve(
        &self,
        springs: &impl Springs,
        path_m: impl Fn(f64) -> f64,
        guide2: Guide2,
        tip_force_n: f64,
    ) -> Result<Deformed, ModelError> {
        self.solve_from(springs, &StressFreePath { path_m, newest: None }, guide2, tip_force_n, None)
    }
}

impl Deformed {
    /// From nodes in increasing order, deflection and slope at each, and the force of guide 2.
    pub(crate) fn new(nodes_m: Vec<f64>, states: Vec<[f64; 2]>, guide2_force_n: f64) -> Self {
        Self { nodes_m, states, guide2_force_n }
    }

    /// Deflection; beyond the ends the needle's tangent continues.
    pub fn deflection_m(&self, z_m: f64) -> f64 {
        let Some((x, length_m, state)) = self.element_at(z_m) else { return f64::NAN };
        let inside_x = x.clamp(0.0, 1.0);
        let tissue_x: f64 = hermite(inside_x, length_m).iter().zip(state).map(|(n, u)| n * u).sum();
        tissue_x + (x - inside_x) * length_m * if x > 1.0 { state[3] } else { state[1] }
    }

    /// Deflection and slope at places in increasing order; beyond the tip the needle's tangent continues.
    fn states_at(&self, places_m: &[f64]) -> Vec<f64> {
        let mut element = 0;
        let last = self.nodes_m.len().saturating_sub(2);
        let mut states = Vec::with_capacity(2 * places_m.len());
        for z_m in places_m {
            while element < last && self.nodes_m[element + 1] <= *z_m {
                element += 1;
            }
            states.extend(self.state_in(element, *z_m));
        }
        states
    }

    fn state_in(&self, element: usize, z_m: f64) -> [f64; 2] {
        let Some((x, length_m, state)) = self.element(element, z_m) else { return [0.0; 2] };
        if x > 1.0 {
            return [state[2] + (x - 1.0) * length_m * state[3], state[3]];
        }
        let (x2, l) = (x * x, length_m);
        let slopes = [6.0 * (x2 - x) / l, 1.0 - 4.0 * x + 3.0 * x2, 6.0 * (x - x2) / l, 3.0 * x2 - 2.0 * x];
        [shape_work(hermite(x, length_m), state), shape_work(slopes, state)]
    }

    /// Curvature `u''` on the needle, 1/m; linear within an element.
    pub fn curvature_per_m(&self, z_m: f64) -> f64 {
        let Some((x, l, [u, slope, next_u, next_slope])) = self.element_at(z_m) else { return f64::NAN };
        (6.0 * (2.0 * x - 1.0) * (u - next_u) / l + (6.0 * x - 4.0) * slope + (6.0 * x - 2.0) * next_slope)
            / l
    }

    /// The element at `z_m` (the nearest beyond the ends): position from its start over its length, its length, deflection and
    /// slope at both of its ends.
    fn element_at(&self, z_m: f64) -> Option<(f64, f64, [f64; 4])> {
        let next_node = self.nodes_m.partition_point(|node_m| *node_m <= z_m);
        self.element(next_node.saturating_sub(1).min(self.nodes_m.len().checked_sub(2)?), z_m)
    }

    /// The same for an element of which the number is known.
    fn element(&self, element: usize, z_m: f64) -> Option<(f64, f64, [f64; 4])> {
        let (start_m, end_m) = (self.nodes_m.get(element)?, self.nodes_m.get(element + 1)?);
        let ([u, slope], [next_u, next_slope]) = (self.states.get(element)?, self.states.get(element + 1)?);
        let length_m = end_m - start_m;
        Some(((z_m - start_m) / length_m, length_m, [*u, *slope, *next_u, *next_slope]))
    }

    /// Slope at the tip.
    pub fn tip_slope(&self) -> f64 {
        self.states.last().map_or(f64::NAN, |state| state[1])
    }
}

/// Work of shape functions on an element's state.
fn shape_work(shape: [f64; 4], state: [f64; 4]) -> f64 {
    shape.iter().zip(state).map(|(n, u)| n * u).sum::<f64>()
}

/// Points on (0, 1) and weights of the four-point Gauss rule.
pub(super) const GAUSS: [(f64, f64); 4] = [
    (0.069_431_844_202_973_71, 0.173_927_422_568_726_93),
    (0.330_009_478_207_571_87, 0.326_072_577_431_273_07),
    (0.669_990_521_792_428_1, 0.326_072_577_431_273_07),
    (0.930_568_155_797_026_3, 0.173_927_422_568_726_93),
];

/// Shape functions of deflection and slope at both ends of an element.
pub(super) fn hermite(x: f64, length_m: f64) -> [f64; 4] {
    let (x2, x3) = (x * x, x * x * x);
    [1.0 - 3.0 * x2 + 2.0 * x3, length_m * (x - 2.0 * x2 + x3), 3.0 * x2 - 2.0 * x3, length_m * (x3 - x2)]
}

/// Stiffness of a beam element against deflection and slope at both ends.
pub(crate) fn bending_stiffness(stiffness_n_m2: f64, l: f64) -> [[f64; 4]; 4] {
    let b = stiffness_n_m2 / (l * l * l);
    [
        [12.0 * b, 6.0 * l * b, -12.0 * b, 6.0 * l * b],
        [6.0 * l * b, 4.0 * l * l * b, -6.0 * l * b, 2.0 * l * l * b],
        [-12.0 * b, -6.0 * l * b, 12.0 * b, -6.0 * l * b],
        [6.0 * l * b, 2.0 * l * l * b, -6.0 * l * b, 4.0 * l * l * b],
    ]
}

/// Adds the stiffness of a string under tension, `T int u'^2`, to that of a beam element.
pub(super) fn add_tension(stiffness: &mut [[f64; 4]; 4], tension_n: f64, l: f64) {
    if tension_n == 0.0 {
        return;
    }
    let t = tension_n / (30.0 * l);
    let string = [
        [36.0, 3.0 * l, -36.0, 3.0 * l],
        [3.0 * l, 4.0 * l * l, -3.0 * l, -l * l],
        [-36.0, -3.0 * l, 36.0, -3.0 * l],
        [3.0 * l, -l * l, -3.0 * l, 4.0 * l * l],
    ];
    for (row, added) in stiffness.iter_mut().zip(string) {
        row.iter_mut().zip(added).for_each(|(value, add)| *value += t * add);
    }
}

#[cfg(test)]
#[path = "elements_tests.rs"]
mod tests;
