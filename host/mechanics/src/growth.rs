//! The needle at every depth of an insertion, per unit of what acts on it.
//!
//! The tissue springs act on `u - u_t`, where the cut path `u_t(z)` is the place of the tip when it passed `z`
//! (theory, eq. 37). At one depth the needle is linear in its tip load, the displacement of guide 2 and the cut path, so that its tip
//! is at `u = a F + b g + sum_j w_j u_t(z_j)`. By reciprocity all `w` come from the shape under one unit load at the tip: `a` is
//! its deflection there, `w_j` the springs' share of it. The beam grows by one element per step, and of its Cholesky factor only
//! the last rows change; the sum over the path is carried from node to node (`memory`): a step costs the same at every depth. The path
//! is linear between nodes and its newest end implicit: second order in the step.

mod in_body;
mod memory;
mod springs;

use super::{BeamProblem, ModelError, check};
use memory::{Kind, Memory, STATES, Step};
use springs::SpringBeam;

/// Step that keeps the path within one part in ten thousand for needles in tissue.
pub const DEFAULT_STEP_M: f64 = 0.5e-3;
const MAX_STEPS: f64 = 20_000.0;
/// Steps shorter than this add no element of their own: the stiffness of one grows with the inverse cube of its length, and beside
/// that of the tissue vanishes in rounding (an element of a fiftieth of a millimetre costs one part in ten thousand of the path). The
/// needle is then taken where the step before began.
const MIN_ELEMENT_M: f64 = 0.04e-3;

/// Motion of guide 2 while the needle is inserted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Guide2Grip {
    /// It does not touch the needle.
    Free,
    /// It holds the needle at a displacement, less what its frame gives ([`BeamProblem::guide2_compliance_m_per_n`]).
    Holding,
}

/// Responses of the tip at every node of an insertion.
#[derive(Debug, Clone)]
pub struct GrowingBeam {
    depths_m: Vec<f64>,
    /// Per node; nodes with no element between them share theirs.
    rows: Vec<Row>,
    steps: Vec<Step>,
    kind: Kind,
}

/// Influences on the tip at one depth.
#[derive(Debug, Clone)]
struct Row {
    deflection: Response,
    /// Slope of the needle at the tip.
    slope: Response,
    /// Elements of tissue up to here.
    steps: usize,
}

/// One linear functional of what acts on the needle.
#[derive(Debug, Clone, Default)]
struct Response {
    /// Per newton at the tip.
    load: f64,
    /// Per metre of guide 2.
    guide2: f64,
    /// Per 1/m of stress-free curvature.
    curvature: f64,
    /// Per state of the path's memory.
    path: [f64; STATES],
    /// Per metre of the cut path at the start and the end of every element, where these have weights of their own.
    dense: Vec<[f64; 2]>,
}

/// Loads at a node, in one plane: on arriving at its depth and on leaving it. They differ where the needle is turned or
/// guide 2 moved at rest.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct NodeLoads {
    /// Tip load, N.
    pub load_n: [f64; 2],
    /// Displacement of guide 2, m.
    pub guide2_m: [f64; 2],
}

/// Tip at a node, on arriving and on leaving.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TipState {
    /// Tip position, m.
    pub tip_m: [f64; 2],
    /// Tip load, N.
    pub load_n: [f64; 2],
}

impl GrowingBeam {
    /// Solves the needle of `problem` at every depth of `depths_m` (0 first, increasing).
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] for a problem or depths out of range, [`ModelError::Singular`].
    pub fn new(problem: &BeamProblem, depths_m: Vec<f64>, grip: Guide2Grip) -> Result<Self, ModelError> {
        Self::solved(problem, depths_m, grip, true)
    }

    /// The same without slopes: for a tip that takes a load, in half of the time.
    ///
    /// # Errors
    /// As [`GrowingBeam::new`].
    pub fn without_slopes(
        problem: &BeamProblem,
        depths_m: Vec<f64>,
        grip: Guide2Grip,
    ) -> Result<Self, ModelError> {
        Self::solved(problem, depths_m, grip, false)
    }

    fn solved(
        problem: &BeamProblem,
        depths_m: Vec<f64>,
        grip: Guide2Grip,
        slopes: bool,
    ) -> Result<Self, ModelError> {
        problem.check()?;
        if grip == Guide2Grip::Holding {
            let gap_m = problem.entry_m - problem.guide2_m;
            check(
                "entry_m",
                problem.entry_m,
                "beyond guide2_m, where guide 2 holds the needle",
                gap_m > 1e-6,
            )?;
        }
        check("depth_m", depths_m.len() as f64, "up to 20000 steps", depths_m.len() as f64 <= MAX_STEPS)?;
        let first_m = depths_m.first().copied().unwrap_or(f64::NAN);
        check("depth_m", first_m, "0 first", first_m == 0.0)?;
        for pair in depths_m.windows(2) {
            check("depth_m", pair[1], "increasing depths", pair[1] > pair[0])?;
        }
        if problem.only_guide {
            let holds = grip == Guide2Grip::Holding;
            check("guide2_m", problem.guide2_m, "the only guide, holding the needle", holds)?;
        }
        if problem.support.is_body() {
            return in_body::solved(&problem.inserted(), depths_m, grip, slopes);
        }
        let mut beam = SpringBeam::new(problem, grip);
        let mut rows = Vec::with_capacity(depths_m.len());
        beam.extend(problem.entry_m - beam.length_m, None);
        let mut newest = beam.row(slopes)?;
        let mut nodes = Vec::with_capacity(depths_m.len());
        let mut reached_m = 0.0;
        for (node, depth_m) in depths_m.iter().enumerate() {
            if depth_m - reached_m >= MIN_ELEMENT_M {
                beam.extend(depth_m - reached_m, Some(reached_m));
                newest = beam.row(slopes)?;
                nodes.push([node - 1, node]);
                reached_m = *depth_m;
            }
            rows.push(newest.clone());
        }
        let mut steps = beam.steps;
        steps.iter_mut().zip(nodes).for_each(|(step, nodes)| step.nodes = nodes);
        Ok(Self { depths_m, rows, steps, kind: Kind::Springs })
    }

    /// Depths of the nodes.
    pub fn depths_m(&self) -> &[f64] {
        &self.depths_m
    }

    /// The tip's way under given loads, one entry per node.
    pub fn under_load(&self, acting: impl Fn(usize) -> NodeLoads) -> Vec<TipState> {
        self.bent_under_load(acting, |_| [0.0; 2])
    }

    /// The same of a needle that is bent by itself: `curvature_per_m` is its stress-free curvature in this plane, per node, on arriving
    /// and on leaving (the needle may be turned at rest).
    ///
    /// The energy `EI/2 int (u'' - kappa)^2` of a curvature that is the same all along the needle is that of moments `EI kappa` at the
    /// tip and `-EI kappa` where the needle is clamped. By reciprocity they move the tip by `EI kappa (u'(L) - u'(0))` of its shape
    /// under a unit load. The tissue remembers the path that is cut meanwhile.
    pub fn bent_under_load(
        &self,
        acting: impl Fn(usize) -> NodeLoads,
        curvature_per_m: impl Fn(usize) -> [f64; 2],
    ) -> Vec<TipState> {
        let mut states: Vec<TipState> = Vec::with_capacity(self.rows.len());
        let mut cut = Memory::new(self.kind);
        for (node, row) in self.rows.iter().enumerate() {
            let (NodeLoads { load_n, guide2_m }, bent) = (acting(node), curvature_per_m(node));
            let response = &row.deflection;
            let (path_m, newest) = self.known(row, response, &states, &cut);
            let deflection_m = path_m + response.load * load_n[0] + response.guide2 * guide2_m[0];
            let arriving_m = (deflection_m + response.curvature * bent[0]) / (1.0 - newest);
            let moved_m =
                response.load * (load_n[1] - load_n[0]) + response.guide2 * (guide2_m[1] - guide2_m[0]);
            let jump_m = moved_m + response.curvature * (bent[1] - bent[0]);
            states.push(TipState { tip_m: [arriving_m, arriving_m + jump_m], load_n });
            cut.extend(&self.steps, &states);
        }
        states
    }

    /// The tip's way when it cuts at an angle to the needle: the slope of the path is that of the needle at its tip plus
    /// `angle_rad` (per node, on arriving and on leaving). The path starts at 0, and the tip load is what balances the springs.
    pub fn at_cut_angle(
        &self,
        angle_rad: impl Fn(usize) -> [f64; 2],
        guide2_m: impl Fn(usize) -> f64,
    ) -> Vec<TipState> {
        self.bent_at_cut_angle(angle_rad, guide2_m, |_| [0.0; 2])
    }

    /// The same of a needle of a stress-free curvature in this plane (per node, on arriving and on leaving), as in
    /// [`GrowingBeam::bent_under_load`]. A needle that is turned at rest springs over under the load that it has.
    pub fn bent_at_cut_angle(
        &self,
        angle_rad: impl Fn(usize) -> [f64; 2],
        guide2_m: impl Fn(usize) -> f64,
        curvature_per_m: impl Fn(usize) -> [f64; 2],
    ) -> Vec<TipState> {
        self.moved_at_cut_angle(angle_rad, |node| [guide2_m(node); 2], curvature_per_m)
    }

    /// The same where guide 2 is also moved at rest (per node, on arriving and on leaving): the tip then moves under the load that it
    /// has, and goes on from there along the needle's new direction.
    pub fn moved_at_cut_angle(
        &self,
        angle_rad: impl Fn(usize) -> [f64; 2],
        guide2_m: impl Fn(usize) -> [f64; 2],
        curvature_per_m: impl Fn(usize) -> [f64; 2],
    ) -> Vec<TipState> {
        let mut states: Vec<TipState> = Vec::with_capacity(self.rows.len());
        let mut cut = Memory::new(self.kind);
        let mut slope_before = 0.0;
        for (node, row) in self.rows.iter().enumerate() {
            let (angle, [arriving_m, leaving_m], bent) =
                (angle_rad(node), guide2_m(node), curvature_per_m(node));
            let (deflection, slope) = (&row.deflection, &row.slope);
            let (path_m, newest) = self.known(row, deflection, &states, &cut);
            let (known_slope, newest_slope) = self.known(row, slope, &states, &cut);
            let (past_deflection_m, known_slope) = (
                path_m + deflection.guide2 * arriving_m + deflection.curvature * bent[0],
                known_slope + slope.guide2 * arriving_m + slope.curvature * bent[0],
            );
            let mut state =
                match (states.last(), node.checked_sub(1).and_then(|before| self.depths_m.get(before))) {
                    (Some(before), Some(before_m)) => {
                        // u = known + a F + w u, and by the trapezoidal rule u = before + (slope before + slope now) h / 2
                        // with the slope now = known slope + c F + v u + angle: two equations for u and F.
                        let half_m = 0.5 * (self.depths_m[node] - before_m);
                        let right = before.tip_m[1] + half_m * (slope_before + known_slope + angle[0]);
                        let (a, c) = (deflection.load, half_m * slope.load);
                        let (tip_factor, own_slope) = (1.0 - newest, 1.0 - half_m * newest_slope);
                        let load_n = (right * tip_factor - past_deflection_m * own_slope)
                            / (a * own_slope - c * tip_factor);
                        let tip_m = (past_deflection_m + a * load_n) / tip_factor;
                        TipState { tip_m: [tip_m; 2], load_n: [load_n; 2] }
                    }
                    // The path starts at 0, by a load that outweighs guide 2.
                    _ => TipState { tip_m: [0.0; 2], load_n: [-past_deflection_m / deflection.load; 2] },
                };
            let (sprung, moved_m) = (bent[1] - bent[0], leaving_m - arriving_m);
            slope_before = known_slope
                + slope.load * state.load_n[1]
                + newest_slope * state.tip_m[0]
                + slope.curvature * sprung
                + slope.guide2 * moved_m
                + angle[1];
            state.tip_m[1] += deflection.curvature * sprung + deflection.guide2 * moved_m;
            states.push(state);
            cut.extend(&self.steps, &states);
        }
        states
    }

    /// The tip load that each point of a given path requires, N: the bordered system of Paper A, equation (20), solved
    /// exactly. `path_m` and `guide2_m` have one entry per node.
    pub fn load_of_path_n(&self, path_m: &[f64], guide2_m: &[f64]) -> Vec<f64> {
        let states: Vec<_> = path_m.iter().map(|u| TipState { tip_m: [*u; 2], load_n: [0.0; 2] }).collect();
        let mut cut = Memory::new(self.kind);
        let nodes = self.rows.iter().zip(path_m.iter().zip(guide2_m)).enumerate();
        nodes
            .map(|(node, (row, (tip_m, held_m)))| {
                let response = &row.deflection;
                cut.extend(&self.steps, &states[..node]);
                let (path_m, newest) = self.known(row, response, &states[..node], &cut);
                (tip_m * (1.0 - newest) - path_m - response.guide2 * held_m) / response.load
            })
            .collect()
    }

    /// Slope of the needle at its tip at every node, on arriving and on leaving, where the tip went like this while guide 2 was
    /// displaced by `guide2_m` (per node, on arriving and on leaving). NaN where this was solved without slopes.
    pub fn tip_slopes(&self, states: &[TipState], guide2_m: impl Fn(usize) -> [f64; 2]) -> Vec<[f64; 2]> {
        self.bent_tip_slopes(states, guide2_m, |_| [0.0; 2])
    }

    /// The same of a needle of a stress-free curvature in this plane, as in [`GrowingBeam::bent_under_load`].
    pub fn bent_tip_slopes(
        &self,
        states: &[TipState],
        guide2_m: impl Fn(usize) -> [f64; 2],
        curvature_per_m: impl Fn(usize) -> [f64; 2],
    ) -> Vec<[f64; 2]> {
        let mut cut = Memory::new(self.kind);
        let nodes = self.rows.iter().zip(states).enumerate();
        nodes
            .map(|(node, (row, state))| {
                let slope = &row.slope;
                cut.extend(&self.steps, &states[..node]);
                let (past_slope, newest) = self.known(row, slope, &states[..node], &cut);
                // The springs at the tip rest where it arrived.
                let resting = past_slope + newest * state.tip_m[0];
                let (guide_m, bent) = (guide2_m(node), curvature_per_m(node));
                [0, 1].map(|side| {
                    let straight = resting + slope.load * state.load_n[side] + slope.guide2 * guide_m[side];
                    straight + slope.curvature * bent[side]
                })
            })
            .collect()
    }

    /// Contribution of the path up to the node before the newest, and the factor of the newest node; `cut` is the path
    /// up to there.
    fn known(&self, row: &Row, response: &Response, before: &[TipState], cut: &Memory) -> (f64, f64) {
        let Response { path, dense, .. } = response;
        // The last element may end at the newest node.
        match self.steps.get(cut.count).filter(|_| cut.count < row.steps) {
            Some(step) => {
                let start_m = before.get(step.nodes[0]).map_or(0.0, |state| state.tip_m[1]);
                cut.with(step, path, dense, start_m)
            }
            None => (cut.of(path, dense), 0.0),
        }
    }
}

impl Response {
    /// State without a solution.
    fn none() -> Self {
        Self {
            load: f64::NAN,
            guide2: f64::NAN,
            curvature: f64::NAN,
            path: [f64::NAN; STATES],
            dense: Vec::new(),
        }
    }
}

#[cfg(test)]
#[path = "growth_frame_tests.rs"]
mod frame_tests;
#[cfg(test)]
#[path = "growth_tests.rs"]
mod tests;
