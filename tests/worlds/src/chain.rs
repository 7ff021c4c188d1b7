//! The needle as a chain of nodes at even distances: its energy in second differences, and the banded system that minimises it.
//!
//! Boundary conditions come with the energy: the clamp is a spring on the first difference, a free end needs nothing, and a guide
//! is a very stiff spring, which gives its force as that of the spring.

use super::world::World;

/// Distance between nodes.
pub(super) const STEP_M: f64 = 0.5e-3;
/// Compliance of what is rigid: a ten-millionth of the needle's, and still far from what rounding resolves.
const RIGID_M_PER_N: f64 = 1e-10;

/// Node nearest to a length.
pub(super) fn node_at(length_m: f64) -> usize {
    (length_m / STEP_M).round().max(0.0) as usize
}

/// A symmetric matrix with two side diagonals; row 0 is the clamped node, which stays at zero.
#[derive(Debug, Clone)]
pub(super) struct Band {
    diagonal: Vec<f64>,
    /// Between a node and the next, and the one after it.
    next: Vec<f64>,
    second: Vec<f64>,
}

/// `L D L^T` of a band.
#[derive(Debug, Clone)]
pub(super) struct Factor {
    diagonal: Vec<f64>,
    next: Vec<f64>,
    second: Vec<f64>,
}

impl Band {
    fn clamped() -> Self {
        Self { diagonal: vec![1.0], next: vec![0.0], second: vec![0.0] }
    }

    fn push_node(&mut self) {
        self.diagonal.push(0.0);
        self.next.push(0.0);
        self.second.push(0.0);
    }

    /// Adds the energy `k/2 (sum of parts)^2`, a part being a weight times the deflection of a node; nodes in rising order, no
    /// more than two apart.
    pub fn add_energy(&mut self, stiffness: f64, parts: &[(usize, f64)]) {
        for (at, (node, weight)) in parts.iter().enumerate() {
            for (other, other_weight) in &parts[at..] {
                let value = stiffness * weight * other_weight;
                match (*node, other - node) {
                    (0, _) => {}
                    (node, 0) => self.diagonal[node] += value,
                    (node, 1) => self.next[node] += value,
                    (node, _) => self.second[node] += value,
                }
            }
        }
    }

    /// Adds a spring to the ground.
    pub fn add_spring(&mut self, node: usize, stiffness: f64) {
        self.add_energy(stiffness, &[(node, 1.0)]);
    }

    /// Its product with deflections.
    pub fn times(&self, deflection: &[f64]) -> Vec<f64> {
        let mut product: Vec<f64> = self.diagonal.iter().zip(deflection).map(|(a, u)| a * u).collect();
        for (distance, side) in [(1, &self.next), (2, &self.second)] {
            for node in distance..product.len() {
                product[node] += side[node - distance] * deflection[node - distance];
                product[node - distance] += side[node - distance] * deflection[node];
            }
        }
        product
    }

    /// Its factors.
    pub fn factor(&self) -> Factor {
        let count = self.diagonal.len();
        let mut factor =
            Factor { diagonal: vec![0.0; count], next: vec![0.0; count], second: vec![0.0; count] };
        for node in 0..count {
            let (mut diagonal, mut next) = (self.diagonal[node], self.next[node]);
            if node >= 1 {
                let coupling = factor.diagonal[node - 1] * factor.next[node - 1];
                diagonal -= coupling * factor.next[node - 1];
                next -= coupling * factor.second[node - 1];
            }
            if node >= 2 {
                diagonal -= factor.diagonal[node - 2] * factor.second[node - 2] * factor.second[node - 2];
            }
            factor.diagonal[node] = diagonal;
            factor.next[node] = next / diagonal;
            factor.second[node] = self.second[node] / diagonal;
        }
        factor
    }
}

impl Factor {
    /// Deflections under forces on the nodes.
    pub fn solve(&self, force: &[f64]) -> Vec<f64> {
        let mut solution = force.to_vec();
        let count = solution.len();
        for node in 0..count {
            if node >= 1 {
                solution[node] -= self.next[node - 1] * solution[node - 1];
            }
            if node >= 2 {
                solution[node] -= self.second[node - 2] * solution[node - 2];
            }
        }
        for node in (0..count).rev() {
            solution[node] /= self.diagonal[node];
            if node + 1 < count {
                solution[node] -= self.next[node] * solution[node + 1];
            }
            if node + 2 < count {
                solution[node] -= self.second[node] * solution[node + 2];
            }
        }
        solution
    }
}

/// Needle with clamp and guide 2, without tissue.
#[derive(Debug, Clone)]
pub(super) struct Chain {
    /// Its system.
    pub band: Band,
    /// Node and stiffness of guide 2.
    pub guide: Option<(usize, f64)>,
    bending_n_m2: f64,
    clamp_rad_per_n_m: f64,
    axial_n: f64,
}

impl Chain {
    /// A needle to this node, with an axial load and with guide 2 on a frame of this compliance.
    pub fn new(world: &World, last: usize, axial_n: f64, frame_m_per_n: f64) -> Self {
        let stiffness = 1.0 / (frame_m_per_n + RIGID_M_PER_N);
        let mut chain = Self {
            band: Band::clamped(),
            guide: world.guide2_m.map(|guide2_m| (node_at(guide2_m), stiffness)),
            bending_n_m2: world.bending_n_m2,
            clamp_rad_per_n_m: world.clamp_rad_per_n_m,
            axial_n,
        };
        (0..last).for_each(|_| chain.grow());
        if let Some((node, stiffness)) = chain.guide {
            chain.band.add_spring(node, stiffness);
        }
        chain
    }

    /// Node of the tip.
    pub fn last(&self) -> usize {
        self.band.diagonal.len() - 1
    }

    /// One node more. A chain must reach beyond its guide from the start.
    pub fn grow(&mut self) {
        self.band.push_node();
        let last = self.last();
        if last == 1 {
            // Half a cell of bending at the clamp, in series with the clamp's own compliance.
            let bending = STEP_M / (2.0 * self.bending_n_m2);
            self.band.add_spring(1, 1.0 / ((bending + self.clamp_rad_per_n_m) * STEP_M * STEP_M));
        } else {
            let stiffness = self.bending_n_m2 / STEP_M.powi(3);
            self.band.add_energy(stiffness, &[(last - 2, 1.0), (last - 1, -2.0), (last, 1.0)]);
        }
        self.add_slope(last, -self.axial_n);
    }

    /// Forces on nodes that bend the needle as one of this curvature is bent by itself: every cell turns about its middle, which leaves
    /// a pair at the tip and what the half cell at the clamp and the clamp itself do not take.
    pub fn bend_n(&self, bend_per_m: f64) -> [(usize, f64); 3] {
        let (last, pair_n) = (self.last(), self.bending_n_m2 * bend_per_m / STEP_M);
        let half_cell = STEP_M / (2.0 * self.bending_n_m2);
        let at_clamp_n = 0.5 * bend_per_m / (half_cell + self.clamp_rad_per_n_m);
        [(1, at_clamp_n - pair_n), (last - 1, -pair_n), (last, pair_n)]
    }

    /// Adds the energy `G/2 u'^2` between a node and the one before it.
    pub fn add_slope(&mut self, node: usize, shear_n: f64) {
        self.band.add_energy(shear_n / STEP_M, &[(node - 1, -1.0), (node, 1.0)]);
    }
}

/// A value between samples at increasing places, linear; the outermost pair goes on in a line beyond the end if `goes_on`,
/// else its last value stays.
pub(super) fn between(places: &[f64], values: &[f64], place: f64, goes_on: bool) -> f64 {
    let (Some(first), Some(last)) = (places.first(), places.last()) else { return 0.0 };
    if places.len() < 2 {
        return values[0];
    }
    let clamped = if goes_on { place } else { place.clamp(*first, *last) };
    let right = places.partition_point(|at| *at < clamped).clamp(1, places.len() - 1);
    let fraction = (clamped - places[right - 1]) / (places[right] - places[right - 1]);
    values[right - 1] + fraction * (values[right] - values[right - 1])
}
