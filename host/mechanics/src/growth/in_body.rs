//! The needle in an elastic body at every depth of an insertion: at each the operator of that depth acts on `u - u_t`.
//!
//! The effect of the cut path on the tip follows from the needle's shape under a unit load at the tip (reciprocity):
//! the body's line load on that shape is the weight of the path. The path is projected on the polynomials of the
//! deflection.

use super::memory::{Kind, STATES, Step, weights};
use super::{GrowingBeam, Guide2Grip, Response, Row};
use crate::body::{Load, MODES, Ritz, powers, surface_m};
use crate::elements::GAUSS;
use crate::{BeamProblem, Foundation, ModelError, Support};

/// Depths closer than this to where the body begins are not in it.
const MIN_M: f64 = 1e-9;

/// Responses of the tip at every depth.
pub(super) fn solved(
    problem: &BeamProblem,
    depths_m: Vec<f64>,
    grip: Guide2Grip,
    slopes: bool,
) -> Result<GrowingBeam, ModelError> {
    let from_m = surface_m(&problem.foundation);
    let bare = depths_m.partition_point(|depth_m| depth_m - from_m <= MIN_M);
    let free = BeamProblem { support: Support::Springs, foundation: Foundation::none(), ..problem.clone() };
    let GrowingBeam { mut rows, steps: of_bare, .. } =
        GrowingBeam::solved(&free, depths_m[..bare].to_vec(), grip, slopes)?;
    // The effect of a shear layer or a skin above the body is no moment of the path.
    let is_dense = problem.shear_n > 0.0 || (bare > 1 && problem.skin_n_per_m > 0.0);
    for (node, row) in rows.iter_mut().enumerate() {
        for response in [&mut row.deflection, &mut row.slope] {
            if is_dense {
                response.dense = weights(of_bare.get(..row.steps).unwrap_or_default(), &response.path);
                response.dense.resize(node, [0.0; 2]);
            }
            response.path = [0.0; STATES];
        }
        row.steps = node;
    }
    let moments = Moments::new(&depths_m, from_m);
    let mut problem_at_depth = problem.clone();
    for node in bare..depths_m.len() {
        problem_at_depth.depth_m = depths_m[node];
        let Some(ritz) = Ritz::new(&problem_at_depth)? else { return Err(ModelError::Singular) };
        let solved = ritz.factor()?;
        let pushed = ritz.shape(&solved, Load::Guide2);
        // Stiffness of needle and frame in series.
        let stiffness = (ritz.work(Load::Guide2, &pushed) + problem.guide2_compliance_m_per_n).recip();
        let response = |load: Load| {
            let mut shape = ritz.shape(&solved, load);
            let mut guide2 = 0.0;
            if grip == Guide2Grip::Holding {
                let moved = ritz.work(Load::Guide2, &shape);
                shape = shape.plus(&pushed.scaled(-moved * stiffness));
                guide2 = ritz.work(load, &pushed) * stiffness;
            }
            let path_effect = Path { ritz: &ritz, problem: &problem_at_depth, moments: &moments };
            let path = path_effect.states(&shape);
            let dense =
                if is_dense { path_effect.weights(&path, &shape, &depths_m[..=node]) } else { Vec::new() };
            let moment_work = ritz.work(Load::TipMoment, &shape) - ritz.at(&shape, 0.0)[1];
            let curvature = problem.bending_stiffness_n_m2 * moment_work;
            Response { load: ritz.work(Load::Tip, &shape), guide2, curvature, path, dense }
        };
        let slope = if slopes { response(Load::TipMoment) } else { Response::default() };
        rows.push(Row { deflection: response(Load::Tip), slope, steps: node });
    }
    let kind = if is_dense { Kind::Dense } else { Kind::Body };
    Ok(GrowingBeam { rows, steps: moments.steps(), kind, depths_m })
}

/// Integrals of the powers of the depth in the body over every element, times what the start and the end of the path have of it. They
/// are the same at every depth of the insertion.
struct Moments {
    /// The depths are in units of this one, the largest.
    unit_m: f64,
    of_elements: Vec<[[f64; 2]; MODES]>,
}

impl Moments {
    fn new(nodes_m: &[f64], from_m: f64) -> Self {
        let unit_m = (nodes_m.last().copied().unwrap_or_default() - from_m).max(MIN_M);
        let of_element = |ends: &[f64]| {
            let (start_m, end_m) = (ends[0], ends[1]);
            let mut moments = [[0.0; 2]; MODES];
            let tissue_start_m = start_m.max(from_m);
            if tissue_start_m < end_m {
                for (x, share) in GAUSS {
                    let s_m = tissue_start_m + x * (end_m - tissue_start_m);
                    let segment_position = (s_m - start_m) / (end_m - start_m);
                    let mut power = share * (end_m - tissue_start_m);
                    for moment in &mut moments {
                        moment[0] += power * (1.0 - segment_position);
                        moment[1] += power * segment_position;
                        power *= (s_m - from_m) / unit_m;
                    }
                }
            }
            moments
        };
        Self { unit_m, of_elements: nodes_m.windows(2).map(of_element).collect() }
    }

    /// Contribution of every element to the memory of the path: its moments, and, of the first one, the place where the
    /// tip entered.
    fn steps(&self) -> Vec<Step> {
        self.of_elements
            .iter()
            .enumerate()
            .map(|(element, moments)| {
                let (mut start, mut end) = ([0.0; STATES], [0.0; STATES]);
                for ((start, end), moment) in start.iter_mut().zip(&mut end).zip(moments) {
                    (*start, *end) = (moment[0], moment[1]);
                }
                if element == 0 {
                    start[MODES] = 1.0;
                }
                Step { nodes: [element, element + 1], per_next: [[0.0; 2]; 2], start, end }
            })
            .collect()
    }
}

/// Effect of the cut path on the needle at one depth.
struct Path<'a> {
    ritz: &'a Ritz,
    problem: &'a BeamProblem,
    moments: &'a Moments,
}

impl Path<'_> {
    /// Functionals of the needle for every moment of the path, and for the point where the tip
    /// entered.
    fn states(&self, shape: &super::super::body::Shape) -> [f64; STATES] {
        let Self { ritz, problem, moments } = *self;
        let [_, depth_m] = ritz.body_m();
        let mut line_load = ritz.tissue_forces(&ritz.coefficients(shape));
        // From forces against the coefficients to the line load that does the same work.
        for (degree, force) in line_load.iter_mut().enumerate() {
            *force *= (2 * degree + 1) as f64 / depth_m;
        }
        // In powers of the depth over the unit of the moments.
        let line_load = powers(&line_load);
        let mut unit = 1.0;
        let mut states = [0.0; STATES];
        for (state, term) in states.iter_mut().zip(&line_load) {
            *state = term * unit;
            unit *= moments.unit_m / depth_m;
        }
        states[MODES] = problem.skin_n_per_m * ritz.surface_m(shape);
        states
    }

    /// Weights of the path at the start and the end of every element.
    fn weights(
        &self,
        states: &[f64; STATES],
        shape: &super::super::body::Shape,
        nodes_m: &[f64],
    ) -> Vec<[f64; 2]> {
        let Self { ritz, problem, moments } = *self;
        let mut node_weights: Vec<[f64; 2]> = Vec::with_capacity(nodes_m.len().saturating_sub(1));
        for of_element in moments.of_elements.iter().take(nodes_m.len().saturating_sub(1)) {
            let mut weight = [0.0; 2];
            for (term, [start, end]) in states.iter().zip(of_element) {
                weight[0] += term * start;
                weight[1] += term * end;
            }
            node_weights.push(weight);
        }
        if problem.shear_n > 0.0 {
            let ([body_m, _], in_body) = (ritz.body_m(), ritz.in_body(shape));
            let deflections_m: Vec<f64> = nodes_m
                .iter()
                .map(|s_m| {
                    let z_m = problem.entry_m + s_m;
                    if z_m >= body_m { in_body.at(z_m)[0] } else { ritz.at(shape, z_m)[0] }
                })
                .collect();
            for ((weight, ends), deflection_m) in
                node_weights.iter_mut().zip(nodes_m.windows(2)).zip(deflections_m.windows(2))
            {
                let pull_n = problem.shear_n * (deflection_m[0] - deflection_m[1]) / (ends[1] - ends[0]);
                weight[0] += pull_n;
                weight[1] -= pull_n;
            }
        }
        if let Some(first) = node_weights.first_mut() {
            first[0] += states[MODES];
        }
        node_weights
    }
}
