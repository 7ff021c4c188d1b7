//! Newton's method on the needle in elements.
//!
//! Everything that does not depend on the deflection is had once: the stiffness of needle, supports and tension, and at
//! each Gauss point the shape functions, the tissue and where its springs are at rest. While the tip is cutting, the
//! springs of the newest end are at rest on a line that ends in the tip: its deflection acts on them through one column
//! of the tangent, which the formula of Sherman and Morrison adds to the symmetric factor, so that convergence stays
//! quadratic.

use super::super::ModelError;
use super::super::banded::Banded;
use super::{
    Deformed, Elements, GAUSS, Guide2, Newest, Reaction, Springs, StressFreePath, add_tension,
    bending_stiffness, hermite,
};

const MAX_ITERATIONS: usize = 60;
/// A step of this share of the deflection is the last: Newton's method squares the error, and rounding is not far below.
const LAST_STEP: f64 = 1e-6;
/// Steps are not shortened below this share.
const MIN_SHARE: f64 = 1e-3;

/// An element in the tissue.
struct Embedded<P> {
    /// Its first unknown.
    at: usize,
    points: [Point<P>; 4],
}

/// A Gauss point in the tissue.
struct Point<P> {
    /// Shape functions.
    shape: [f64; 4],
    /// Length that it stands for, m.
    measure_m: f64,
    place: P,
    /// Rest position of its springs, less the effect of the tip's deflection, m.
    rest_m: f64,
    /// Share of the tip's deflection in that.
    by_tip: f64,
}

/// Everything about a solution that does not depend on the deflection.
struct Problem<'a, S: Springs> {
    springs: &'a S,
    embedded: Vec<Embedded<S::Place>>,
    /// Stiffness of everything but the tissue, as the tangent has it.
    linear: Banded,
    /// Matrix of every element by itself: differences of neighbours that are nearly the same lose fewer digits
    /// so.
    elements: Vec<[[f64; 4]; 4]>,
    /// And of what holds single unknowns.
    holders: Vec<(usize, f64)>,
    load: Vec<f64>,
}

/// Tangent stiffness, how the tip's deflection acts on the springs of the newest end besides, and load minus internal forces.
struct Balance {
    tangent: Banded,
    by_tip: Option<Vec<f64>>,
    rest: Vec<f64>,
}

impl Elements {
    /// Solves from a needle that is nearly this one, of any length, in a fraction of the iterations.
    ///
    /// # Errors
    /// As [`Elements::solve`].
    pub(in super::super) fn solve_from<P: Fn(f64) -> f64>(
        &self,
        springs: &impl Springs,
        path: &StressFreePath<P>,
        guide2: Guide2,
        tip_force_n: f64,
        near: Option<&Deformed>,
    ) -> Result<Deformed, ModelError> {
        let size = 2 * self.nodes_m.len();
        let held_unknown = match guide2 {
            Guide2::Held(_) => Some(2 * self.guide2),
            Guide2::Force(_) | Guide2::Sprung { .. } => None,
        };
        let rigid = self.clamp_compliance_rad_per_n_m == 0.0;
        let clamped = !self.only_guide;
        let fixed: Vec<usize> =
            [clamped.then_some(0), rigid.then_some(1), held_unknown].into_iter().flatten().collect();

        let mut unknowns = near.map_or_else(|| vec![0.0; size], |near| near.states_at(&self.nodes_m));
        fixed.iter().filter(|index| **index < 2).for_each(|index| unknowns[*index] = 0.0);
        if let (Guide2::Held(displacement_m), Some(index)) = (guide2, held_unknown) {
            unknowns[index] = displacement_m;
        }
        let problem = self.problem(springs, path, guide2, tip_force_n);
        let mut balance = problem.balance(&unknowns, &fixed);
        for _ in 0..MAX_ITERATIONS {
            let step = balance.step(&fixed).ok_or(ModelError::Singular)?;
            let residual_before = norm(&balance.rest, &fixed);
            let mut step_fraction = 1.0;
            loop {
                let trial: Vec<f64> =
                    unknowns.iter().zip(&step).map(|(u, s)| u + step_fraction * s).collect();
                let is_last = is_small(&step, &trial);
                let next = problem.balance(&trial, &fixed);
                // A full step is right where the springs are linear; beyond that, half of it until the balance improves.
                let improves = norm(&next.rest, &fixed) <= residual_before.max(f64::MIN_POSITIVE);
                if improves || step_fraction < MIN_SHARE || is_last {
                    (unknowns, balance) = (trial, next);
                    break;
                }
                step_fraction *= 0.5;
            }
            if is_small(&step, &unknowns) {
                let guide2_force_n = match guide2 {
                    Guide2::Force(force_n) => force_n,
                    Guide2::Held(_) => -balance.rest[2 * self.guide2],
                    Guide2::Sprung { at_m, compliance_m_per_n } => {
                        (at_m - unknowns[2 * self.guide2]) / compliance_m_per_n
                    }
                };
                let states = unknowns.chunks_exact(2).map(|state| [state[0], state[1]]).collect();
                return Ok(Deformed { nodes_m: self.nodes_m.clone(), states, guide2_force_n });
            }
        }
        Err(ModelError::NotConverged)
    }

    fn problem<'a, S: Springs, P: Fn(f64) -> f64>(
        &self,
        springs: &'a S,
        path: &StressFreePath<P>,
        guide2: Guide2,
        tip_force_n: f64,
    ) -> Problem<'a, S> {
        let size = 2 * self.nodes_m.len();
        let mut load = vec![0.0; size];
        load[size - 2] = tip_force_n;
        // A curvature that is the same all along is a moment at either end.
        let moment_n_m = self.bending_stiffness_n_m2 * self.curvature_per_m;
        load[size - 1] += moment_n_m;
        load[1] -= moment_n_m;
        let mut linear = Banded::new(size);
        let mut holders = Vec::new();
        match guide2 {
            Guide2::Force(force_n) => load[2 * self.guide2] += force_n,
            Guide2::Held(_) => {}
            Guide2::Sprung { at_m, compliance_m_per_n } => {
                holders.push((2 * self.guide2, compliance_m_per_n.recip()));
                load[2 * self.guide2] += at_m / compliance_m_per_n;
            }
        }
        if self.clamp_compliance_rad_per_n_m > 0.0 {
            holders.push((1, 1.0 / self.clamp_compliance_rad_per_n_m));
        }
        if self.guide2_turn_n_m_per_rad > 0.0 {
            holders.push((2 * self.guide2 + 1, self.guide2_turn_n_m_per_rad));
        }
        let tip_z_m = self.nodes_m.last().copied().unwrap_or_default();
        if self.tip_support_n_per_m > 0.0 {
            holders.push((size - 2, self.tip_support_n_per_m));
            load[size - 2] += self.tip_support_n_per_m * (path.path_m)(tip_z_m);
        }
        holders.iter().for_each(|(index, stiffness)| linear.add(*index, *index, *stiffness));
        let mut embedded = Vec::new();
        let mut elements = Vec::with_capacity(self.nodes_m.len());
        for (element, ends) in self.nodes_m.windows(2).enumerate() {
            let (start_m, length_m) = (ends[0], ends[1] - ends[0]);
            let first_unknown = 2 * element;
            let is_in_tissue = start_m >= self.entry_m - 1e-12;
            let element_share = self.stiffness_share(start_m, length_m);
            let mut bending = bending_stiffness(self.bending_stiffness_n_m2 * element_share, length_m);
            let pull_n = if is_in_tissue { self.shear_n } else { 0.0 } - self.axial_load_n;
            add_tension(&mut bending, pull_n, length_m);
            if is_in_tissue && start_m <= self.entry_m + 1e-12 {
                bending[0][0] += self.skin_n_per_m;
                load[first_unknown] += self.skin_n_per_m * (path.path_m)(start_m);
            }
            for (i, row) in bending.iter().enumerate() {
                row.iter()
                    .enumerate()
                    .take(i + 1)
                    .for_each(|(j, value)| linear.add(first_unknown + i, first_unknown + j, *value));
            }
            elements.push(bending);
            if !is_in_tissue {
                continue;
            }
            let points = GAUSS.map(|(x, weight)| {
                let z_m = start_m + x * length_m;
                let (path_rest_m, by_tip) = match path.newest {
                    Some(Newest { from_z_m, from_m }) if z_m > from_z_m => {
                        let by_tip = (z_m - from_z_m) / (tip_z_m - from_z_m);
                        (from_m * (1.0 - by_tip), by_tip)
                    }
                    _ => ((path.path_m)(z_m), 0.0),
                };
                let spring_properties = springs.place(z_m - self.entry_m);
                Point {
                    shape: hermite(x, length_m),
                    measure_m: weight * length_m,
                    place: spring_properties,
                    rest_m: path_rest_m,
                    by_tip,
                }
            });
            embedded.push(Embedded { at: first_unknown, points });
        }
        Problem { springs, embedded, linear, elements, holders, load }
    }
}

impl<S: Springs> Problem<'_, S> {
    /// Balance at a deflection; what is fixed takes no step.
    fn balance(&self, unknowns: &[f64], fixed: &[usize]) -> Balance {
        let size = unknowns.len();
        let mut tangent = self.linear.clone();
        let mut residual = self.load.clone();
        self.holders.iter().for_each(|(index, stiffness)| residual[*index] -= stiffness * unknowns[*index]);
        for (element, stiffness) in self.elements.iter().enumerate() {
            let Some((local, residual_tail)) = of_element(unknowns, &mut residual, 2 * element) else {
                continue;
            };
            for (residual_tail, row) in residual_tail.iter_mut().zip(stiffness) {
                *residual_tail -= row.iter().zip(local).map(|(k, u)| k * u).sum::<f64>();
            }
        }
        let tip_m = unknowns[size - 2];
        let mut by_tip: Option<Vec<f64>> = None;
        for Embedded { at, points } in &self.embedded {
            let Some((local, residual_tail)) = of_element(unknowns, &mut residual, *at) else { continue };
            let Some(block) = tangent.block_mut(*at) else { continue };
            for Point { shape, measure_m, place, rest_m, by_tip: share } in points {
                let deflection_m: f64 = shape.iter().zip(local).map(|(n, u)| n * u).sum();
                let stretch_m = deflection_m - rest_m - share * tip_m;
                let Reaction { force_n_per_m, tangent_pa } = self.springs.reaction(place, stretch_m);
                let stiffness = measure_m * tangent_pa;
                for i in 0..4 {
                    for j in 0..=i {
                        block[i][i - j] += stiffness * shape[i] * shape[j];
                    }
                    residual_tail[i] -= measure_m * force_n_per_m * shape[i];
                }
                if *share > 0.0 {
                    let column = by_tip.get_or_insert_with(|| vec![0.0; size]);
                    let column = column.iter_mut().skip(*at).zip(shape);
                    column.for_each(|(column, n)| *column += share * stiffness * n);
                }
            }
        }
        fixed.iter().for_each(|index| tangent.fix(*index));
        Balance { tangent, by_tip, rest: residual }
    }
}

impl Balance {
    /// Newton's step; `None` where the tangent is singular.
    fn step(&mut self, fixed: &[usize]) -> Option<Vec<f64>> {
        let is_fixed = |index: usize| fixed.contains(&index);
        let free = |(index, value): (usize, &f64)| if is_fixed(index) { 0.0 } else { *value };
        let free_residual = self.rest.iter().enumerate().map(free);
        let factor = self.tangent.factor()?;
        let Some(tip_direction) = self.by_tip.take() else {
            let mut step: Vec<[f64; 1]> = free_residual.map(|free_residual| [free_residual]).collect();
            factor.solve(&mut step);
            return Some(step.into_flattened());
        };
        let free_direction = tip_direction.iter().enumerate().map(free);
        let mut combined_right: Vec<[f64; 2]> = free_residual
            .zip(free_direction)
            .map(|(free_residual, free_direction)| [free_residual, free_direction])
            .collect();
        factor.solve(&mut combined_right);
        let [of_rest, of_tip] = combined_right[combined_right.len() - 2];
        let tip_step = of_rest / (1.0 - of_tip);
        Some(
            combined_right
                .into_iter()
                .map(|[step, free_direction]| step + tip_step * free_direction)
                .collect(),
        )
    }
}

/// The four unknowns of an element, and what is left of the balance at them.
fn of_element<'a>(
    unknowns: &'a [f64],
    rest: &'a mut [f64],
    at: usize,
) -> Option<(&'a [f64; 4], &'a mut [f64; 4])> {
    Some((unknowns.get(at..)?.first_chunk()?, rest.get_mut(at..)?.first_chunk_mut()?))
}

fn norm(rest: &[f64], fixed: &[usize]) -> f64 {
    let squares: f64 = rest.iter().map(|r| r * r).sum();
    let of_fixed: f64 = fixed.iter().map(|index| rest[*index] * rest[*index]).sum();
    (squares - of_fixed).max(0.0).sqrt()
}

/// Whether a step is small enough to be the last.
fn is_small(step: &[f64], unknowns: &[f64]) -> bool {
    largest(step) <= LAST_STEP * largest(unknowns)
}

/// Largest deflection, without the slopes.
fn largest(values: &[f64]) -> f64 {
    values.iter().step_by(2).map(|v| v.abs()).fold(0.0, f64::max)
}
