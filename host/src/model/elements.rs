//! The needle by Hermite finite elements, for what the exact solution cannot do: stiffness that varies with depth in any way,
//! springs that are not linear, springs at rest on a cut path.
//!
//! `EI u'''' + r(z, u - u_t) = F delta(z - c2)` with the supports of [`BeamProblem`]; weak form, cubic elements, four Gauss
//! points per element, Newton's method, banded Cholesky (half-bandwidth 3): the work grows linearly with the number of
//! elements (`model.md`, section 2). Elements end at guide 2, at the surface and at the faces of layers.

use super::banded::Banded;
use super::{BeamProblem, Foundation, ModelError, check};

/// Length of an element that brings the error below one part in a million for needles in tissue.
pub const DEFAULT_ELEMENT_M: f64 = 0.5e-3;
const MOST_ELEMENTS: f64 = 100_000.0;
const MOST_ITERATIONS: usize = 60;
/// A step of this share of the deflection is the last: Newton's method squares the error, and rounding is not far below.
const LAST_STEP: f64 = 1e-6;

/// Lateral reaction of the tissue on a point of the needle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reaction {
    /// Force per length that pushes the needle back, N/m.
    pub force_n_per_m: f64,
    /// Its derivative with respect to the stretch, N/m per m; not negative.
    pub tangent_pa: f64,
}

/// What the tissue does.
pub trait Springs {
    /// Reaction at a depth below the surface to a deflection from the place where the springs are at rest.
    fn reaction(&self, depth_m: f64, stretch_m: f64) -> Reaction;
}

impl Springs for Foundation {
    fn reaction(&self, depth_m: f64, stretch_m: f64) -> Reaction {
        let modulus_pa = self.modulus_pa(depth_m);
        Reaction { force_n_per_m: modulus_pa * stretch_m, tangent_pa: modulus_pa }
    }
}

impl<F: Fn(f64, f64) -> Reaction> Springs for F {
    fn reaction(&self, depth_m: f64, stretch_m: f64) -> Reaction {
        self(depth_m, stretch_m)
    }
}

/// What guide 2 does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Guide2 {
    /// Pushes with a force, N.
    Force(f64),
    /// Holds the needle at a displacement, m.
    Held(f64),
    /// Holds it by a spring that is at rest at a displacement.
    Sprung {
        /// Where the spring is at rest, m.
        at_m: f64,
        /// Of the spring, more than 0.
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
    /// Stress-free curvature of the needle.
    curvature_per_m: f64,
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
        check("element_m", element_m, "a hundred-thousandth of the needle or more", count <= MOST_ELEMENTS)?;
        let mut nodes_m = vec![0.0];
        let mut faces_m = vec![problem.guide2_m, problem.entry_m];
        let inside = problem.foundation.faces_m().map(|face_m| problem.entry_m + face_m);
        faces_m.extend(inside.filter(|face_m| *face_m < length_m));
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
            curvature_per_m: 0.0,
            nodes_m,
            guide2,
        })
    }

    /// The same needle, bent by itself: `EI (u'' - curvature)` in place of `EI u''`.
    pub fn bent(&self, curvature_per_m: f64) -> Self {
        Self { curvature_per_m, ..self.clone() }
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
        self.solve_from(springs, path_m, guide2, tip_force_n, None)
    }

    /// The same from a needle that is nearly this one, of any length, in a fraction of the iterations.
    ///
    /// # Errors
    /// As [`Elements::solve`].
    pub(super) fn solve_from(
        &self,
        springs: &impl Springs,
        path_m: impl Fn(f64) -> f64,
        guide2: Guide2,
        tip_force_n: f64,
        near: Option<&Deformed>,
    ) -> Result<Deformed, ModelError> {
        let size = 2 * self.nodes_m.len();
        let held = match guide2 {
            Guide2::Held(_) => Some(2 * self.guide2),
            Guide2::Force(_) | Guide2::Sprung { .. } => None,
        };
        let rigid = self.clamp_compliance_rad_per_n_m == 0.0;
        let clamped = !self.only_guide;
        let fixed = |index: usize| (clamped && index == 0) || (rigid && index == 1) || Some(index) == held;

        let mut unknowns: Vec<f64> = match near {
            Some(near) => self.nodes_m.iter().flat_map(|z_m| near.state(*z_m)).collect(),
            None => vec![0.0; size],
        };
        (0..2).filter(|index| fixed(*index)).for_each(|index| unknowns[index] = 0.0);
        if let (Guide2::Held(displacement_m), Some(index)) = (guide2, held) {
            unknowns[index] = displacement_m;
        }
        let mut load = vec![0.0; size];
        load[size - 2] = tip_force_n;
        // A curvature that is the same all along is a moment at either end.
        let moment_n_m = self.bending_stiffness_n_m2 * self.curvature_per_m;
        load[size - 1] += moment_n_m;
        load[1] -= moment_n_m;
        let mut frame_n_per_m = 0.0;
        match guide2 {
            Guide2::Force(force_n) => load[2 * self.guide2] += force_n,
            Guide2::Held(_) => {}
            Guide2::Sprung { at_m, compliance_m_per_n } => {
                frame_n_per_m = compliance_m_per_n.recip();
                load[2 * self.guide2] += frame_n_per_m * at_m;
            }
        }
        let balance = |unknowns: &[f64]| {
            let (mut tangent, mut rest) = self.balance(springs, &path_m, unknowns, &load);
            tangent.add(2 * self.guide2, 2 * self.guide2, frame_n_per_m);
            rest[2 * self.guide2] -= frame_n_per_m * unknowns[2 * self.guide2];
            (tangent, rest)
        };
        let (mut tangent, mut rest) = balance(&unknowns);
        for _ in 0..MOST_ITERATIONS {
            let mut step: Vec<f64> =
                rest.iter().enumerate().map(|(i, r)| if fixed(i) { 0.0 } else { *r }).collect();
            (0..size).filter(|i| fixed(*i)).for_each(|i| tangent.fix(i));
            tangent.factor().ok_or(ModelError::Singular)?.solve(&mut step);
            let before = norm(&rest, fixed);
            let mut share = 1.0;
            loop {
                let tried: Vec<f64> = unknowns.iter().zip(&step).map(|(u, s)| u + share * s).collect();
                let (next, next_rest) = balance(&tried);
                // A full step is right where the springs are linear; beyond that, half of it until the balance improves.
                if norm(&next_rest, fixed) <= before.max(f64::MIN_POSITIVE)
                    || share < 1e-3
                    || is_small(&step, &tried)
                {
                    (unknowns, tangent, rest) = (tried, next, next_rest);
                    break;
                }
                share *= 0.5;
            }
            if is_small(&step, &unknowns) {
                let guide2_force_n = match guide2 {
                    Guide2::Force(force_n) => force_n,
                    Guide2::Held(_) => -rest[2 * self.guide2],
                    Guide2::Sprung { at_m, .. } => frame_n_per_m * (at_m - unknowns[2 * self.guide2]),
                };
                let states = unknowns.chunks_exact(2).map(|state| [state[0], state[1]]).collect();
                return Ok(Deformed { nodes_m: self.nodes_m.clone(), states, guide2_force_n });
            }
        }
        Err(ModelError::NotConverged)
    }

    /// Tangent stiffness, and load minus internal forces.
    fn balance(
        &self,
        springs: &impl Springs,
        path_m: &impl Fn(f64) -> f64,
        unknowns: &[f64],
        load: &[f64],
    ) -> (Banded, Vec<f64>) {
        let mut tangent = Banded::new(unknowns.len());
        let mut rest = load.to_vec();
        if self.clamp_compliance_rad_per_n_m > 0.0 {
            let stiffness = 1.0 / self.clamp_compliance_rad_per_n_m;
            tangent.add(1, 1, stiffness);
            rest[1] -= stiffness * unknowns[1];
        }
        for (element, ends) in self.nodes_m.windows(2).enumerate() {
            let (start_m, length_m) = (ends[0], ends[1] - ends[0]);
            let at = 2 * element;
            let local = &unknowns[at..at + 4];
            let inside = start_m >= self.entry_m - 1e-12;
            let mut bending = bending_stiffness(self.bending_stiffness_n_m2, length_m);
            let pull_n = if inside { self.shear_n } else { 0.0 } - self.axial_load_n;
            add_tension(&mut bending, pull_n, length_m);
            if inside && start_m <= self.entry_m + 1e-12 {
                bending[0][0] += self.skin_n_per_m;
                rest[at] += self.skin_n_per_m * path_m(start_m);
            }
            for i in 0..4 {
                for (j, value) in bending[i].iter().enumerate().take(i + 1) {
                    tangent.add(at + i, at + j, *value);
                }
                rest[at + i] -= bending[i].iter().zip(local).map(|(k, u)| k * u).sum::<f64>();
            }
            if !inside {
                continue;
            }
            for (x, weight) in GAUSS {
                let shape = hermite(x, length_m);
                let z_m = start_m + x * length_m;
                let deflection_m: f64 = shape.iter().zip(local).map(|(n, u)| n * u).sum();
                let Reaction { force_n_per_m, tangent_pa } =
                    springs.reaction(z_m - self.entry_m, deflection_m - path_m(z_m));
                let measure_m = weight * length_m;
                for i in 0..4 {
                    for j in 0..=i {
                        tangent.add(at + i, at + j, measure_m * tangent_pa * shape[i] * shape[j]);
                    }
                    rest[at + i] -= measure_m * force_n_per_m * shape[i];
                }
            }
        }
        (tangent, rest)
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
        let inside: f64 = hermite(inside_x, length_m).iter().zip(state).map(|(n, u)| n * u).sum();
        inside + (x - inside_x) * length_m * if x > 1.0 { state[3] } else { state[1] }
    }

    /// Deflection and slope; beyond the tip the needle's tangent continues.
    fn state(&self, z_m: f64) -> [f64; 2] {
        let Some((x, length_m, state)) = self.element_at(z_m) else { return [0.0; 2] };
        if x > 1.0 {
            return [state[2] + (x - 1.0) * length_m * state[3], state[3]];
        }
        let along = |shape: [f64; 4]| shape.iter().zip(state).map(|(n, u)| n * u).sum::<f64>();
        let (x2, l) = (x * x, length_m);
        let slopes = [6.0 * (x2 - x) / l, 1.0 - 4.0 * x + 3.0 * x2, 6.0 * (x - x2) / l, 3.0 * x2 - 2.0 * x];
        [along(hermite(x, length_m)), along(slopes)]
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
        let after = self.nodes_m.partition_point(|node_m| *node_m <= z_m);
        let element = after.saturating_sub(1).min(self.nodes_m.len().checked_sub(2)?);
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

fn norm(rest: &[f64], fixed: impl Fn(usize) -> bool) -> f64 {
    rest.iter().enumerate().filter(|(i, _)| !fixed(*i)).map(|(_, r)| r * r).sum::<f64>().sqrt()
}

/// Whether a step is small enough to be the last.
fn is_small(step: &[f64], unknowns: &[f64]) -> bool {
    let largest = |values: &[f64]| values.iter().step_by(2).map(|v| v.abs()).fold(0.0, f64::max);
    largest(step) <= LAST_STEP * largest(unknowns)
}

#[cfg(test)]
#[path = "elements_tests.rs"]
mod tests;
