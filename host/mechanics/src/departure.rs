//! The difference between a needle in lateral runs and the exact linear one, where tissue stiffens, `K u (1 + (u/u0)^2)`, or yields
//! ([`yielding`](super::yielding)), or a law acts on its reaction or on the bending stiffness of the needle.
//!
//! Finite elements at a few displacements of guide 2, as a difference to the same elements without, interpolated between them. Beside
//! relaxation the difference is taken as instantaneous. An elastic body stiffens by a reaction of its own, `k u (u/u0)^2` at every point, with k
//! the mean line load of the body on a rigid needle per deflection.

use super::body::Stiffened;
use super::elements::{Deformed, Elements, Guide2, StressFreePath};
use super::lateral::{Motion, Samples};
use super::terms::ActingLaw;
use super::varied::cubic;
use super::yielding::Yielding;
use super::{BeamProblem, ModelError};

/// Displacements at which a needle is solved that does to one side what it does to the other.
const NODES: usize = 6;
/// Displacements to a side at which a needle is solved whose reaction may have a knee.
const SIDE_NODES: i32 = 8;
/// Elements for the difference; where a law acts on the reaction alone, which is smooth along the needle.
const ELEMENT_M: f64 = 2e-3;
const LONG_ELEMENT_M: f64 = 4e-3;
/// A needle that is moved by less departs as one that is moved by this.
const LEAST_M: f64 = 1e-5;
/// Stiffening below this share of the modulus is none.
const MIN_STIFFENING: f64 = 1e-9;

/// The way in which the difference is interpolated.
#[derive(Debug)]
enum Interpolation {
    /// By Lagrange's polynomial in the square of the displacement, of what is odd and smooth.
    Squares,
    /// By cubics between nodes of this spacing; to the other side the same where nothing tells the sides apart.
    Spacing {
        /// Between neighbours.
        spacing_m: f64,
        /// Whether all nodes are on one side.
        is_odd: bool,
    },
}

/// The difference at a few displacements.
#[derive(Debug)]
pub(super) struct Departure {
    interpolation: Interpolation,
    nodes_m: Vec<f64>,
    shapes: Vec<Deformed>,
    /// Without anything, at the first of the nodes.
    linear: Deformed,
}

impl Departure {
    /// The difference for a needle that is moved by up to `most_m` to either side; nothing if it is the linear one.
    ///
    /// # Errors
    /// As [`Elements::solve`], and where a body of tissue has a law that needs springs.
    pub fn new(problem: &BeamProblem, most_m: f64) -> Result<Option<Self>, ModelError> {
        let law = problem.law;
        let stiffest_pa = problem.foundation.parts(problem.depth_m).map(|(_, pa)| pa).fold(0.0, f64::max);
        let yielding = law.inverse_yield_m_per_n * stiffest_pa;
        let stretch = (law.inverse_u0_per_m * most_m).powi(2).max((yielding * most_m).powi(2));
        let has_laws = !problem.reaction.is_empty() || !problem.stiffness.is_empty();
        if stretch <= MIN_STIFFENING && !has_laws {
            return Ok(None);
        }
        let most_m = most_m.max(LEAST_M);
        let (interpolation, nodes_m) = nodes(problem, stretch > MIN_STIFFENING, most_m);
        if problem.support.is_body() {
            if law.inverse_yield_m_per_n > 0.0 {
                problem.support.needs_springs("tissue that yields")?;
            }
            if has_laws {
                problem
                    .support
                    .needs_springs("a law on the reaction of the tissue or the stiffness of the needle")?;
            }
            let body = Stiffened::new(problem)?;
            let shapes =
                nodes_m.iter().map(|node_m| body.held(*node_m, true)).collect::<Result<Vec<_>, _>>()?;
            return Ok(Some(Self { linear: body.held(nodes_m[0], false)?, interpolation, nodes_m, shapes }));
        }
        let is_long = problem.stiffness.is_empty() && stretch <= MIN_STIFFENING;
        let element_m = if is_long { LONG_ELEMENT_M } else { ELEMENT_M };
        let elements = Elements::new(problem, element_m)?;
        let foundation = &problem.foundation;
        let springs = Yielding { law, foundation, reaction: &problem.reaction };
        let path = StressFreePath { path_m: |_| 0.0, newest: None };
        let mut shapes: Vec<Deformed> = Vec::with_capacity(nodes_m.len());
        for node_m in &nodes_m {
            // Its neighbour is nearly the same, so that Newton's method starts there.
            let shape = elements.solve_from(&springs, &path, Guide2::Held(*node_m), 0.0, shapes.last())?;
            shapes.push(shape);
        }
        let plain = BeamProblem { stiffness: Vec::new(), ..problem.clone() };
        let linear =
            Elements::new(&plain, element_m)?.solve(foundation, |_| 0.0, Guide2::Held(nodes_m[0]), 0.0)?;
        Ok(Some(Self { interpolation, nodes_m, shapes, linear }))
    }

    /// Weight of every node in the deflection at each of these places, node by node.
    pub fn shape_at(&self, z_m: &[f64]) -> Vec<f64> {
        let linear: Vec<f64> =
            z_m.iter().map(|z_m| self.linear.deflection_m(*z_m) / self.nodes_m[0]).collect();
        self.shapes
            .iter()
            .zip(&self.nodes_m)
            .flat_map(|(shape, node_m)| {
                z_m.iter()
                    .zip(&linear)
                    .map(|(z_m, linear)| shape.deflection_m(*z_m) / node_m - linear)
                    .collect::<Vec<_>>()
            })
            .collect()
    }

    /// The stiffness that each node adds.
    fn stiffness_n_per_m(&self) -> Vec<f64> {
        let linear = self.linear.guide2_force_n / self.nodes_m[0];
        let nodes = self.shapes.iter().zip(&self.nodes_m);
        nodes.map(|(shape, node_m)| shape.guide2_force_n / node_m - linear).collect()
    }

    /// By how much of its own displacement every node counts at a displacement.
    fn displacements_m(&self, displacement_m: f64) -> Samples {
        match self.interpolation {
            Interpolation::Squares => {
                let weight = |j: usize| {
                    let other_nodes = self.nodes_m.iter().enumerate().filter(|(i, _)| *i != j);
                    let other_factors = |(_, other): (usize, &f64)| {
                        (square(displacement_m) - square(*other)) / (square(self.nodes_m[j]) - square(*other))
                    };
                    other_nodes.map(other_factors).product::<f64>()
                };
                (0..self.nodes_m.len()).map(|j| displacement_m * weight(j)).collect()
            }
            Interpolation::Spacing { spacing_m, is_odd } => {
                let node_position = displacement_m / spacing_m;
                let first_node =
                    node_position.floor().clamp(f64::from(1 - SIDE_NODES), f64::from(SIDE_NODES - 2));
                let weights = cubic(node_position - first_node);
                // At no displacement the needle is straight whatever it departs by, so that there is no node.
                self.nodes_m
                    .iter()
                    .map(|node_m| {
                        let number = (node_m / spacing_m).round();
                        let mirrored =
                            if is_odd { lattice_weight(-number, first_node, weights) } else { 0.0 };
                        (lattice_weight(number, first_node, weights) - mirrored) * node_m
                    })
                    .collect()
            }
        }
    }

    /// Adds the difference to the motion of the linear needle; `linear` is that one's stiffness, and `per_metre` what its first coefficient
    /// is per displacement.
    pub fn add(
        &self,
        motion: &mut Motion,
        pressed_m: &[f64],
        [linear, per_metre]: [f64; 2],
        compliance_m_per_n: f64,
    ) {
        let more = self.stiffness_n_per_m();
        let (first, samples) = (motion.coefficients.len(), pressed_m.len());
        motion.coefficients.resize(first + self.nodes_m.len() * samples, 0.0);
        for (i, pressed) in pressed_m.iter().enumerate() {
            // The needle's own displacement where the frame gives: pressed = w + C (k w + extra(w)).
            let mut spring_m = pressed / (1.0 + compliance_m_per_n * linear);
            if compliance_m_per_n > 0.0 {
                for _ in 0..8 {
                    spring_m = (pressed - compliance_m_per_n * self.extra_n(spring_m, &more))
                        / (1.0 + compliance_m_per_n * linear);
                }
            }
            let needed_m = pressed / (1.0 + compliance_m_per_n * linear) - spring_m;
            motion.force_n[i] += self.extra_n(spring_m, &more) - linear * needed_m;
            // The linear part was moved too far by what the frame gives more.
            motion.coefficients[i] -= per_metre * needed_m;
            let of_nodes = motion.coefficients[first..].chunks_exact_mut(samples);
            for (values, weight) in of_nodes.zip(self.displacements_m(spring_m)) {
                values[i] = weight;
            }
        }
    }

    /// Force beyond the linear one at a displacement.
    fn extra_n(&self, m: f64, more: &[f64]) -> f64 {
        self.displacements_m(m).iter().zip(more).map(|(w, k)| w * k).sum::<f64>()
    }
}

/// Weight of a node of the lattice in the interpolation.
fn lattice_weight(number: f64, first_node: f64, weights: [f64; 4]) -> f64 {
    let index = number - first_node + 1.0;
    if (0.0..4.0).contains(&index) { weights[index as usize] } else { 0.0 }
}

fn square(m: f64) -> f64 {
    m * m
}

/// Displacements at which a needle is solved that goes this far.
fn nodes(problem: &BeamProblem, stiffens: bool, most_m: f64) -> (Interpolation, Vec<f64>) {
    if !problem.reaction.is_empty() {
        let spacing_m = most_m / f64::from(SIDE_NODES);
        let is_odd = problem.reaction.iter().all(ActingLaw::is_even);
        // Outwards on each side, so that every needle is solved from its neighbour.
        let sides: &[f64] = if is_odd { &[1.0] } else { &[1.0, -1.0] };
        let nodes_m = sides
            .iter()
            .copied()
            .flat_map(|side| (1..=SIDE_NODES).map(move |number| side * spacing_m * f64::from(number)))
            .collect();
        return (Interpolation::Spacing { spacing_m, is_odd }, nodes_m);
    }
    if !stiffens {
        return (Interpolation::Squares, vec![most_m]);
    }
    let nodes_m = (0..NODES).map(|j| most_m * (0.5 + 0.5 * chebyshev_angle(j).cos()).sqrt()).collect();
    (Interpolation::Squares, nodes_m)
}

/// Chebyshev's points in the square of the displacement.
fn chebyshev_angle(j: usize) -> f64 {
    (2.0 * j as f64 + 1.0) * std::f64::consts::PI / (2.0 * NODES as f64)
}

#[cfg(test)]
#[path = "departure_tests.rs"]
mod tests;
