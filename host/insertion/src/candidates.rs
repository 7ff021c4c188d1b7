//! Paths per unit of every unknown at any modulus and gap, and at any compliance of a rear that is not known.
//!
//! The insertion is solved on a lattice of the logarithms of these, where it is needed; between its points responses
//! are interpolated, which also gives their derivatives. Solutions serve every fold of a session.

use super::lattice::{Mixture, Point, Smooth, about, cubic, parabola};
use super::layout::Layout;
use super::motion::Motion;
use super::path::TipPath;
use super::place::{Place, depths};
use super::rear::{REAR_SHARES, Rear};
use mechanics::growth::{GrowingBeam, Guide2Grip, NodeLoads};
use mechanics::insertion::{self, grid_m};
use mechanics::{Guides, Model, ModelError, Plane, Profile};
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Step of the insertion model here: one part in ten thousand of the path.
const STEP_M: f64 = 1e-3;
/// Distance of points of the lattice, of the logarithm. Cubics between them are off by less than a ten-thousandth of the path.
const LATTICE_LN: f64 = 0.25;
/// A coarse search uses every so-manieth point of it, in parabolas.
const COARSE: i32 = 2;
/// The same of the rear's share, in parabolas: paths are nearly linear in it.
const REAR_LATTICE: f64 = 0.1;
/// Candidates reach so many standard deviations of the prior to both sides.
const REACH: f64 = 3.5;

/// Prior of the tissue and the guide.
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
    /// The rear of a needle in one guide, where its compliance is not known in a plane or in both.
    pub rear: Option<Rear>,
}

/// A possible modulus and gap, as logarithms of their ratios to the middle of what is known beforehand, and the rear.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Candidate {
    /// Standard deviation of the modulus.
    pub modulus_ln: f64,
    /// Standard deviation of the gap.
    pub gap_ln: f64,
    /// Share of the rear ([`Rear`]) less its middle, vertical and horizontal: where responses are solved, with their
    /// derivative. Its value is an unknown of every insertion.
    pub rear_share: [f64; 2],
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
    paths: Vec<(usize, Option<Arc<[Motion; 2]>>)>,
    /// Needle of each plane: two where something sets them apart.
    needles: [usize; 2],
    points: Mutex<Solved>,
}

/// Resolution at which responses are interpolated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fineness {
    /// As for results.
    Fine,
    /// As for a scan.
    Coarse,
}

/// Number of the needle, and place on the lattice: modulus, gap, rear.
type LatticePoint = (usize, [i32; 3]);

/// Points that are solved.
type Solved = HashMap<LatticePoint, Arc<Point>>;

/// Recordings that are turned alike.
#[derive(Debug, Clone)]
struct Plan {
    rotation_rad: Profile,
    nodes_m: Arc<Vec<f64>>,
}

/// All recordings' responses at one candidate, per plane.
#[derive(Debug, Clone)]
pub(super) struct Responses {
    pub of_plan: Vec<[Arc<Smooth>; 2]>,
    pub guide2_m: Vec<Option<[Arc<Smooth>; 2]>>,
}

/// Numbers of the parts of a plan's responses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Parts {
    /// Under 1 m of guide 2.
    pub guide2: usize,
    /// Response to 1 m of guide 2 at rest, at once.
    pub at_once: usize,
    /// Under the load along the bevel, which its process noise follows.
    pub along: usize,
    /// Response of the other plane to the load, if they are coupled.
    pub across: usize,
    /// Number of responses.
    pub count: usize,
}

impl Parts {
    pub fn of(layout: &Layout) -> Self {
        let load = 1 + layout.knots_m.len();
        let turns = if layout.coupled { 2 } else { 1 };
        Self { guide2: 0, at_once: 1, along: 2, across: 2 + load, count: 2 + turns * load }
    }
}

impl Candidates {
    /// For recordings of one rig, down to `last_m`. Candidates without a solution yet.
    ///
    /// # Errors
    /// As [`GrowingBeam::new`], for the middle of what is known beforehand.
    pub fn new(tissue: &Tissue, paths: &[TipPath], last_m: f64) -> Result<Self, ModelError> {
        let layout = Layout::new(paths, last_m, tissue.rear.is_some());
        let last_m = layout.knots_m.last().copied().unwrap_or(last_m);
        let mut plans: Vec<Plan> = Vec::new();
        let clearance_m = tissue.model.clearance_m();
        let is_bent = tissue.model.curvature_per_m() != [0.0; 2];
        let of_path = paths.iter().map(|path| {
            let rotation_rad = &path.done.rotation_rad;
            let same_rotation = plans.iter().position(|known| known.rotation_rad == *rotation_rad);
            let number = same_rotation.unwrap_or_else(|| {
                let mut jumps_m: Vec<f64> = rotation_rad.jumps_m().collect();
                jumps_m.dedup();
                let nodes_m = Arc::new(grid_m(last_m, STEP_M, &jumps_m));
                plans.push(Plan { rotation_rad: rotation_rad.clone(), nodes_m });
                plans.len() - 1
            });
            let still = [Profile::default(), Profile::default()];
            let moved = path
                .done
                .guide2_m
                .as_ref()
                .filter(|planes| planes.iter().any(|plane| plane.values().any(|m| m != 0.0)))
                .or(is_bent.then_some(&still));
            let nodes_m = &plans[number].nodes_m;
            (
                number,
                moved.map(|planes| {
                    let followed = planes.each_ref().map(|plane| plane.through_clearance(clearance_m));
                    Arc::new(followed.map(|plane| Motion::new(&plane, nodes_m.clone())))
                }),
            )
        });
        let paths = of_path.collect();
        let [y, x] = [Plane::Y, Plane::X].map(|plane| tissue.model.problem_in(plane, last_m));
        let unknown = tissue.rear.map_or([false; 2], |rear| rear.unknown);
        let needles = if unknown[0] == unknown[1] && y? == x? { [0; 2] } else { [0, 1] };
        let tissue = tissue.clone();
        let candidates = Self { layout, tissue, last_m, plans, paths, needles, points: Mutex::default() };
        candidates.point((0, [0; 3]))?;
        Ok(candidates)
    }

    /// Nodes at which a recording's responses are known.
    pub(super) fn nodes_m(&self, path: usize) -> Arc<Vec<f64>> {
        self.plans.get(self.plan(path)).map_or_else(Arc::default, |plan| plan.nodes_m.clone())
    }

    /// Number of a recording's plan.
    pub(super) fn plan(&self, path: usize) -> usize {
        self.paths.get(path).map_or(0, |(plan, _)| *plan)
    }

    /// Motion of guide 2 in a recording, per plane.
    pub(super) fn motion(&self, path: usize) -> Option<&Arc<[Motion; 2]>> {
        self.paths.get(path).and_then(|(_, motion)| motion.as_ref())
    }

    /// Places of the bins of a recording.
    pub(super) fn places(&self, number: usize, path: &TipPath) -> Vec<Place> {
        let nodes_m = self.nodes_m(number);
        let motion = self.motion(number).map(Arc::as_ref);
        depths(&path.bins).map(|depth| Place::new(&self.layout, &nodes_m, motion, depth)).collect()
    }

    /// Gap of a candidate, m.
    pub(super) fn gap_m(&self, candidate: Candidate) -> f64 {
        self.tissue.gap_m * candidate.gap_ln.exp()
    }

    /// Standard deviations of the prior of a candidate's logarithms of modulus and gap.
    pub(super) fn prior_sds(&self) -> [f64; 2] {
        [self.tissue.modulus_sd_ln, self.tissue.gap_sd_ln]
    }

    /// The rear, where its compliance is not known.
    pub(super) fn rear(&self) -> Option<&Rear> {
        self.tissue.rear.as_ref()
    }

    /// Logarithm of the prior density of a candidate's modulus and gap, up to a constant; nothing out of range.
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
        let rear = self.tissue.rear;
        Candidate {
            modulus_ln: candidate.modulus_ln.clamp(-modulus, modulus),
            gap_ln: candidate.gap_ln.clamp(-gap, gap),
            rear_share: candidate.rear_share.map(|share| rear.map_or(0.0, |rear| rear.clamped(share))),
        }
    }

    /// Responses of all recordings at a candidate.
    ///
    /// # Errors
    /// As [`GrowingBeam::new`].
    pub(super) fn responses(
        &self,
        candidate: Candidate,
        fineness: Fineness,
    ) -> Result<Responses, ModelError> {
        let planes = if self.layout.planes == 2 { 2 } else { 1 };
        let mixed: Vec<Mixture> =
            (0..planes).map(|plane| self.mixture(candidate, plane, fineness)).collect::<Result<_, _>>()?;
        let is_uniform = mixed.len() < 2 || mixed[0].is_same(&mixed[1]);
        let pair = |of: &dyn Fn(&Point, usize) -> Option<&Vec<f64>>, shared: bool| {
            let first = Arc::new(mixed[0].of(&|point| of(point, 0)));
            let second = match mixed.get(1).filter(|_| !(is_uniform && shared)) {
                Some(mixture) => Arc::new(mixture.of(&|point| of(point, 1))),
                None => first.clone(),
            };
            [first, second]
        };
        let of_plan =
            (0..self.plans.len()).map(|plan| pair(&|point, _| point.responses.get(plan), true)).collect();
        let guide2_m = (0..self.paths.len()).map(|path| {
            self.paths[path].1.as_ref()?;
            Some(pair(&|point, plane| Some(&point.guide2_m.get(path)?.as_ref()?[plane]), false))
        });
        Ok(Responses { guide2_m: guide2_m.collect(), of_plan })
    }

    /// The points about a candidate in a plane, with their weights.
    fn mixture(&self, candidate: Candidate, plane: usize, fineness: Fineness) -> Result<Mixture, ModelError> {
        let unknown = self.tissue.rear.filter(|rear| rear.unknown[plane]);
        let is_unknown = unknown.is_some();
        let rear = match unknown {
            // Points on either side are solved too.
            Some(rear) => {
                let [least, most] = [REAR_SHARES[0] + REAR_LATTICE, REAR_SHARES[1] - REAR_LATTICE];
                let rear_value = rear.middle + candidate.rear_share[plane];
                let middle = (rear_value.clamp(least, most) / REAR_LATTICE).round();
                about(middle as i32, rear_value / REAR_LATTICE - middle, REAR_LATTICE, 1)
            }
            None => vec![(0, [1.0, 0.0])],
        };
        let gaps = interpolation(candidate.gap_ln, fineness);
        let mut points = Vec::with_capacity(48);
        for (k, [i, di]) in interpolation(candidate.modulus_ln, fineness) {
            for (g, [j, dj]) in &gaps {
                for (r, [l, dl]) in &rear {
                    // At a point itself its neighbours weigh nothing, but their share in the derivatives counts.
                    let weights = [i * j * l, di * j * l, i * dj * l, i * j * dl];
                    if weights != [0.0; 4] {
                        points.push((self.point((self.needles[plane], [k, *g, *r]))?, weights));
                    }
                }
            }
        }
        Ok(Mixture { points, is_unknown })
    }

    fn point(&self, at: LatticePoint) -> Result<Arc<Point>, ModelError> {
        if let Some(point) = self.locked_points().get(&at) {
            return Ok(point.clone());
        }
        // Solved outside of the lock: what is solved does not depend on who did it.
        let point = Arc::new(self.solve(at)?);
        self.locked_points().insert(at, point.clone());
        Ok(point)
    }

    /// Points that are solved, also after a panic of another thread.
    fn locked_points(&self) -> MutexGuard<'_, Solved> {
        self.points.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn solve(&self, (needle, [modulus, gap, rear]): LatticePoint) -> Result<Point, ModelError> {
        let [modulus_ln, gap_ln] = [modulus, gap].map(|i| LATTICE_LN * f64::from(i));
        let plane = needle;
        let mut model = self.tissue.model.clone();
        model.rig.entry_m = model.rig.guide2_m + self.tissue.gap_m * gap_ln.exp();
        model.foundation = model.foundation.scaled(modulus_ln.exp())?;
        if let (Some(known_rear), Guides::One { rear_rotation_n_m_per_rad }) =
            (self.tissue.rear.filter(|rear| rear.unknown[plane]), &mut model.rig.guides)
        {
            let rear_fraction = REAR_LATTICE * f64::from(rear);
            rear_rotation_n_m_per_rad[plane] = match rear_fraction {
                0.0 => None,
                rear_fraction => Some(known_rear.needle_n_m_per_rad * (1.0 / rear_fraction - 1.0)),
            };
        }
        let curvature_per_m = model.curvature_per_m();
        let problem = model.problem_in([Plane::Y, Plane::X][plane], self.last_m)?;
        let directed = self.layout.direction;
        let solve = if directed { GrowingBeam::new } else { GrowingBeam::without_slopes };
        let grow = |plan: &Plan| solve(&problem, plan.nodes_m.to_vec(), Guide2Grip::Holding);
        // Plans without a turn at rest have the same nodes.
        let mut growths: Vec<(&Plan, Arc<GrowingBeam>)> = Vec::with_capacity(self.plans.len());
        for plan in &self.plans {
            let same_nodes = growths.iter().find(|(known, _)| known.nodes_m == plan.nodes_m);
            let growth = match same_nodes {
                Some((_, growth)) => growth.clone(),
                None => Arc::new(grow(plan)?),
            };
            growths.push((plan, growth));
        }
        let responses = growths.iter().map(|(plan, growth)| self.plan_responses(growth, plan)).collect();
        let guide2_m = self.paths.iter().map(|(plan, motion)| {
            let (of_plan, growth) = growths.get(*plan)?;
            let planes = motion.as_ref()?.each_ref();
            Some([0, 1].map(|plane| {
                let guide2_m = |node: usize| planes[plane].at_node_m(node);
                // The effect of the needle's own bend is known as well as that of guide 2.
                let bent = |node: usize| {
                    insertion::bent(curvature_per_m, &of_plan.rotation_rad, of_plan.nodes_m[node], plane)
                };
                let states = growth.bent_under_load(
                    |node: usize| NodeLoads { load_n: [0.0; 2], guide2_m: guide2_m(node) },
                    bent,
                );
                let mut tip_states: Vec<f64> = states.iter().flat_map(|state| state.tip_m).collect();
                if directed {
                    tip_states.extend(growth.bent_tip_slopes(&states, guide2_m, bent).concat());
                }
                tip_states
            }))
        });
        Ok(Point { guide2_m: guide2_m.collect(), responses })
    }

    /// Part by part, positions of all before directions of all.
    fn plan_responses(&self, growth: &GrowingBeam, plan: &Plan) -> Vec<f64> {
        let nodes_m = growth.depths_m();
        let directed = self.layout.direction;
        let mut plan_rows = held_rows([1.0; 2], directed, growth);
        // Springs rest where the tip arrived: what guide 2 does at rest is the difference that it makes there.
        for (plan_rows, values) in plan_rows.iter_mut().zip(held_rows([0.0, 1.0], directed, growth)) {
            plan_rows.extend(values.chunks_exact(2).flat_map(|side| [side[1] - side[0]; 2]));
        }
        let turns: &[fn(f64) -> f64] = if self.layout.coupled { &[f64::cos, f64::sin] } else { &[f64::cos] };
        for turn in turns {
            // The load itself, then its process noise at every knot.
            for part in 0..=self.layout.knots_m.len() {
                let load = |node: usize| {
                    let depth_m = nodes_m[node];
                    let rotation = [plan.rotation_rad.before(depth_m), plan.rotation_rad.after(depth_m)];
                    let load_n = rotation.map(|rad| self.amount(depth_m, part) * turn(rad));
                    NodeLoads { load_n, guide2_m: [0.0; 2] }
                };
                plan_rows
                    .iter_mut()
                    .zip(under(growth, &load, directed))
                    .for_each(|(plan_rows, values)| plan_rows.extend(values));
            }
        }
        plan_rows.concat()
    }

    /// Load of one part at a depth: the constant, or the hat function of a knot.
    fn amount(&self, depth_m: f64, part: usize) -> f64 {
        match part.checked_sub(1) {
            None => 1.0,
            Some(knot) => self.layout.hat(knot, depth_m),
        }
    }
}

/// Response to guide 2 alone.
fn held_rows(guide2_m: [f64; 2], directed: bool, growth: &GrowingBeam) -> [Vec<f64>; 2] {
    under(growth, &|_| NodeLoads { load_n: [0.0; 2], guide2_m }, directed)
}

/// Nodes of the lattice around a logarithm, with their weights.
fn interpolation(ln: f64, fineness: Fineness) -> Vec<(i32, [f64; 2])> {
    match fineness {
        Fineness::Fine => cubic(ln, LATTICE_LN),
        Fineness::Coarse => parabola(ln, LATTICE_LN, COARSE),
    }
}

/// Tip under what acts, node by node on arriving and on leaving, and its direction where that is requested.
fn under(growth: &GrowingBeam, acting: &dyn Fn(usize) -> NodeLoads, directed: bool) -> [Vec<f64>; 2] {
    let states = growth.under_load(acting);
    let slopes = if directed { growth.tip_slopes(&states, |node| acting(node).guide2_m) } else { Vec::new() };
    [states.iter().flat_map(|state| state.tip_m).collect(), slopes.concat()]
}
