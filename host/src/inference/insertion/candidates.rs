//! Paths per unit of every unknown at any modulus and gap.
//!
//! The insertion is solved on a lattice of the logarithms of modulus and gap, where it is asked for; between its points responses are
//! interpolated by cubics, which also give their derivatives. What is solved serves every fold of a session.

use super::layout::{Layout, WANDER};
use super::path::TipPath;
use crate::model::growth::{Acting, Growth, Guide2Grip, TipState};
use crate::model::insertion::grid_m;
use crate::model::{Insertion, Model, ModelError, Profile};
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Step of the insertion model here: one part in ten thousand of the path.
const STEP_M: f64 = 1e-3;
/// Distance of points of the lattice, of the logarithm. Cubics between them are off by less than a ten-thousandth of the path.
const LATTICE_LN: f64 = 0.25;
/// Candidates reach so many standard deviations of the prior to both sides.
const REACH: f64 = 3.5;

/// What is known of the tissue and the guide beforehand.
#[derive(Debug, Clone)]
pub struct Tissue {
    /// Rig, foundation and effects.
    pub model: Model,
    /// Standard deviation of the logarithm of a factor on the foundation's modulus.
    pub modulus_sd_ln: f64,
    /// Middle of the gap between guide 2 and the tissue, m.
    pub gap_m: f64,
    /// Standard deviation of its logarithm.
    pub gap_sd_ln: f64,
}

/// A possible modulus and gap: logarithms of their ratios to the middle of what is known beforehand.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Candidate {
    /// Of the modulus.
    pub modulus_ln: f64,
    /// Of the gap.
    pub gap_ln: f64,
}

/// The paths of all recordings per unit of each unknown, for every candidate.
#[derive(Debug)]
pub struct Candidates {
    /// The same unknowns for all.
    pub layout: Layout,
    tissue: Tissue,
    last_m: f64,
    plans: Vec<Plan>,
    /// Plan of each recording, and what guide 2 does in it.
    paths: Vec<(usize, Option<[Profile; 2]>)>,
    points: Mutex<HashMap<[i32; 2], Arc<Point>>>,
}

/// Recordings that are turned alike, and whose guide 2 moves at rest at the same depths.
#[derive(Debug, Clone, PartialEq)]
struct Plan {
    rotation_rad: Profile,
    jumps_m: Vec<f64>,
}

/// What is solved at a point of the lattice: the tip at every node, on arriving and on leaving.
#[derive(Debug)]
struct Point {
    /// Per plan: under 1 m of guide 2, then under every part of the load along the bevel, then across it where planes are coupled.
    responses: Vec<Vec<f64>>,
    /// Per recording and plane: under the motion of guide 2 as recorded; nothing where it does not move.
    guide2_m: Vec<Option<[Vec<f64>; 2]>>,
}

/// A function of modulus and gap at a candidate, with its derivatives with respect to their logarithms.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Smooth {
    pub value: Vec<f64>,
    pub by_modulus: Vec<f64>,
    pub by_gap: Vec<f64>,
}

/// All recordings' responses at one candidate.
#[derive(Debug, Clone)]
pub(super) struct Responses {
    pub of_plan: Vec<Arc<Smooth>>,
    pub guide2_m: Vec<Option<[Arc<Smooth>; 2]>>,
}

impl Candidates {
    /// For recordings of one rig, down to `last_m`. Nothing is solved yet.
    ///
    /// # Errors
    /// As [`Growth::new`], for the middle of what is known beforehand.
    pub fn new(tissue: &Tissue, paths: &[TipPath], last_m: f64) -> Result<Self, ModelError> {
        let layout = Layout::new(paths, last_m);
        let mut plans: Vec<Plan> = Vec::new();
        let of_path = paths.iter().map(|path| {
            let plan = Plan { rotation_rad: path.done.rotation_rad.clone(), jumps_m: jumps_m(&path.done) };
            let number = plans.iter().position(|known| *known == plan).unwrap_or_else(|| {
                plans.push(plan);
                plans.len() - 1
            });
            let moves = |planes: &&[Profile; 2]| planes.iter().any(|plane| plane.values().any(|m| m != 0.0));
            (number, path.done.guide2_m.as_ref().filter(moves).cloned())
        });
        let paths = of_path.collect();
        let last_m = layout.knots_m.last().copied().unwrap_or(last_m);
        let candidates =
            Self { layout, tissue: tissue.clone(), last_m, plans, paths, points: Mutex::default() };
        candidates.point([0, 0])?;
        Ok(candidates)
    }

    /// Nodes at which a recording's responses are known.
    pub(super) fn nodes_m(&self, path: usize) -> Vec<f64> {
        self.paths
            .get(path)
            .and_then(|(plan, _)| self.plans.get(*plan))
            .map_or_else(Vec::new, |plan| grid_m(self.last_m, STEP_M, &plan.jumps_m))
    }

    /// Number of a recording's plan.
    pub(super) fn plan(&self, path: usize) -> usize {
        self.paths.get(path).map_or(0, |(plan, _)| *plan)
    }

    /// Gap of a candidate, m.
    pub(super) fn gap_m(&self, candidate: Candidate) -> f64 {
        self.tissue.gap_m * candidate.gap_ln.exp()
    }

    /// Standard deviations of the prior of a candidate's logarithms.
    pub(super) fn prior_sds(&self) -> [f64; 2] {
        [self.tissue.modulus_sd_ln, self.tissue.gap_sd_ln]
    }

    /// Logarithm of the prior density of a candidate, up to a constant; nothing out of range.
    pub(super) fn ln_prior(&self, candidate: Candidate) -> Option<f64> {
        let mut ln = 0.0;
        for (value, sd) in [candidate.modulus_ln, candidate.gap_ln].into_iter().zip(self.prior_sds()) {
            if value.abs() > REACH * sd + 1e-12 {
                return None;
            }
            ln -= if sd > 0.0 { 0.5 * (value / sd).powi(2) } else { 0.0 };
        }
        Some(ln)
    }

    /// The nearest candidate in range.
    pub(super) fn clamped(&self, candidate: Candidate) -> Candidate {
        let [modulus, gap] = self.prior_sds().map(|sd| REACH * sd);
        Candidate {
            modulus_ln: candidate.modulus_ln.clamp(-modulus, modulus),
            gap_ln: candidate.gap_ln.clamp(-gap, gap),
        }
    }

    /// Responses of all recordings at a candidate.
    ///
    /// # Errors
    /// As [`Growth::new`].
    pub(super) fn responses(&self, candidate: Candidate) -> Result<Responses, ModelError> {
        let [modulus, gap] = [candidate.modulus_ln, candidate.gap_ln].map(Cubic::new);
        let mut points = Vec::with_capacity(16);
        for (i, k) in modulus.weights.iter().zip(modulus.first..) {
            for (j, g) in gap.weights.iter().zip(gap.first..) {
                // At a point itself its neighbours weigh nothing, but their share in the derivatives counts.
                points.push((self.point([k, g])?, [i[0] * j[0], i[1] * j[0], i[0] * j[1]]));
            }
        }
        let mixed = |of: &dyn Fn(&Point) -> Option<&Vec<f64>>| {
            let length = points.first().and_then(|(point, _)| of(point)).map_or(0, Vec::len);
            let mut sum =
                Smooth { value: vec![0.0; length], by_modulus: vec![0.0; length], by_gap: vec![0.0; length] };
            for (point, [value, by_modulus, by_gap]) in &points {
                let Some(values) = of(point) else { continue };
                for (sums, weight) in
                    [(&mut sum.value, value), (&mut sum.by_modulus, by_modulus), (&mut sum.by_gap, by_gap)]
                {
                    sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += weight * value);
                }
            }
            Arc::new(sum)
        };
        let of_plan = (0..self.plans.len()).map(|plan| mixed(&|point| point.responses.get(plan))).collect();
        let guide2_m = (0..self.paths.len()).map(|path| {
            self.paths[path].1.as_ref()?;
            let plane = |plane: usize| mixed(&|point| Some(&point.guide2_m.get(path)?.as_ref()?[plane]));
            Some([plane(0), plane(1)])
        });
        Ok(Responses { guide2_m: guide2_m.collect(), of_plan })
    }

    fn point(&self, at: [i32; 2]) -> Result<Arc<Point>, ModelError> {
        let known = || self.points.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(point) = known().get(&at) {
            return Ok(point.clone());
        }
        // Solved outside of the lock: what is solved does not depend on who did it.
        let point = Arc::new(self.solve(at.map(|i| LATTICE_LN * f64::from(i)))?);
        known().insert(at, point.clone());
        Ok(point)
    }

    fn solve(&self, [modulus_ln, gap_ln]: [f64; 2]) -> Result<Point, ModelError> {
        let mut model = self.tissue.model.clone();
        model.rig.entry_m = model.rig.guide2_m + self.tissue.gap_m * gap_ln.exp();
        model.foundation = model.foundation.scaled(modulus_ln.exp())?;
        let problem = model.problem(self.last_m)?;
        let grow = |plan: &Plan| {
            Growth::without_slopes(&problem, grid_m(self.last_m, STEP_M, &plan.jumps_m), Guide2Grip::Holding)
        };
        // Plans that differ in the rotation only have the same needle.
        let mut growths: Vec<(&Plan, Arc<Growth>)> = Vec::with_capacity(self.plans.len());
        for plan in &self.plans {
            let known = growths.iter().find(|(known, _)| known.jumps_m == plan.jumps_m);
            let growth = match known {
                Some((_, growth)) => growth.clone(),
                None => Arc::new(grow(plan)?),
            };
            growths.push((plan, growth));
        }
        let responses = growths.iter().map(|(plan, growth)| self.plan_responses(growth, plan)).collect();
        let guide2_m = self.paths.iter().map(|(plan, guide2_m)| {
            let (_, growth) = growths.get(*plan)?;
            Some(guide2_m.as_ref()?.each_ref().map(|profile| {
                let nodes_m = growth.depths_m();
                let states = growth.under_load(|node| Acting {
                    load_n: [0.0; 2],
                    guide2_m: [profile.before(nodes_m[node]), profile.after(nodes_m[node])],
                });
                flat(&states).collect()
            }))
        });
        Ok(Point { guide2_m: guide2_m.collect(), responses })
    }

    fn plan_responses(&self, growth: &Growth, plan: &Plan) -> Vec<f64> {
        let nodes_m = growth.depths_m();
        let under = |acting: &dyn Fn(usize) -> Acting| growth.under_load(acting);
        let mut all: Vec<f64> = flat(&under(&|_| Acting { load_n: [0.0; 2], guide2_m: [1.0; 2] })).collect();
        let turns: &[fn(f64) -> f64] = if self.layout.coupled { &[f64::cos, f64::sin] } else { &[f64::cos] };
        for turn in turns {
            // The load itself, then its wander at every knot.
            for part in 0..=self.layout.knots_m.len() {
                let amount = |depth_m: f64| match part.checked_sub(1) {
                    None => 1.0,
                    Some(knot) => self.layout.hat(knot, depth_m),
                };
                let load = |node: usize| {
                    let depth_m = nodes_m[node];
                    let rotation = [plan.rotation_rad.before(depth_m), plan.rotation_rad.after(depth_m)];
                    let load_n = rotation.map(|rad| amount(depth_m) * turn(rad));
                    Acting { load_n, guide2_m: [0.0; 2] }
                };
                all.extend(flat(&under(&load)));
            }
        }
        all
    }

    /// Place of a part's responses among those of a plan: the displacement of guide 2, the load (`across`: what it does to the other
    /// plane) and its wander.
    pub(super) fn load_part(&self, across: bool) -> usize {
        1 + if across { self.layout.of_plane() - WANDER + 1 } else { 0 }
    }
}

fn jumps_m(done: &Insertion) -> Vec<f64> {
    let guide2 = done.guide2_m.iter().flatten();
    let mut all_m: Vec<f64> =
        std::iter::once(&done.rotation_rad).chain(guide2).flat_map(|profile| profile.jumps_m()).collect();
    all_m.sort_by(f64::total_cmp);
    all_m.dedup();
    all_m
}

/// Tip on arriving and on leaving, node by node.
fn flat(states: &[TipState]) -> impl Iterator<Item = f64> {
    states.iter().flat_map(|state| state.tip_m)
}

/// Weights of four neighbouring points of the lattice in the value and the derivative at a place between the middle two.
struct Cubic {
    first: i32,
    weights: [[f64; 2]; 4],
}

impl Cubic {
    fn new(at_ln: f64) -> Self {
        let place = at_ln / LATTICE_LN;
        let cell = place.floor();
        let x = place - cell;
        let nodes = [-1.0, 0.0, 1.0, 2.0];
        let weights = std::array::from_fn(|i| {
            let others = || (0..4).filter(move |j| *j != i);
            let scale: f64 = others().map(|j| nodes[i] - nodes[j]).product();
            let value: f64 = others().map(|j| x - nodes[j]).product();
            let slope: f64 = others()
                .map(|left| others().filter(|j| *j != left).map(|j| x - nodes[j]).product::<f64>())
                .sum();
            [value / scale, slope / (scale * LATTICE_LN)]
        });
        Self { first: cell as i32 - 1, weights }
    }
}
