//! An insertion: the needle grows into the tissue, and its tip leaves the cut path behind.
//!
//! Quasi-static (`model.md`, section 4): at each depth the needle is in equilibrium with guide 2, the springs at rest on the
//! path cut so far, and the load that the bevel takes at the tip. The load turns with the needle about its axis.

use super::cache::Cache;
use super::growth::{Acting, DEFAULT_STEP_M, Growth, Guide2Grip, TipState};
use super::{BeamProblem, ModelError, Series, check};

/// A quantity against insertion depth: linear between knots, constant beyond them. Two knots at one depth are a jump.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Profile(Vec<[f64; 2]>);

impl Profile {
    /// From `[depth_m, value]` knots in order of depth; none is 0 everywhere.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] for depths that decrease or values that are not finite.
    pub fn new(knots: Vec<[f64; 2]>) -> Result<Self, ModelError> {
        let mut before_m = f64::NEG_INFINITY;
        for [depth_m, value] in &knots {
            check("depth_m", *depth_m, "depths that do not decrease", *depth_m >= before_m)?;
            check("value", *value, "a finite number", true)?;
            before_m = *depth_m;
        }
        Ok(Self(knots))
    }

    /// The same at every depth.
    pub fn constant(value: f64) -> Self {
        Self(vec![[0.0, value]])
    }

    /// Value on arriving at a depth.
    pub fn before(&self, depth_m: f64) -> f64 {
        self.between(self.0.partition_point(|[knot_m, _]| *knot_m < depth_m), depth_m)
    }

    /// Value on leaving a depth.
    pub fn after(&self, depth_m: f64) -> f64 {
        self.between(self.0.partition_point(|[knot_m, _]| *knot_m <= depth_m), depth_m)
    }

    /// Depths at which the value jumps.
    pub fn jumps_m(&self) -> impl Iterator<Item = f64> {
        self.0.windows(2).filter(|pair| pair[0][0] == pair[1][0]).map(|pair| pair[0][0])
    }

    /// Values at the knots.
    pub fn values(&self) -> impl Iterator<Item = f64> {
        self.0.iter().map(|[_, value]| *value)
    }

    /// Whether the value is the same at every depth.
    pub fn is_constant(&self) -> bool {
        self.0.windows(2).all(|pair| pair[0][1] == pair[1][1])
    }

    fn between(&self, next: usize, depth_m: f64) -> f64 {
        let previous = next.checked_sub(1).and_then(|previous| self.0.get(previous));
        match (previous, self.0.get(next)) {
            (Some([a_m, a]), Some([b_m, b])) => a + (b - a) * (depth_m - a_m) / (b_m - a_m),
            (Some([_, only]), None) | (None, Some([_, only])) => *only,
            (None, None) => 0.0,
        }
    }
}

/// What was done: how deep, how turned, and what guide 2 did.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Insertion {
    /// Depths at which the tip is looked at, not negative.
    pub depth_m: Vec<f64>,
    /// Rotation of the needle about its axis, rad, against depth.
    pub rotation_rad: Profile,
    /// Vertical and horizontal displacement of guide 2 against depth, m; nothing where guide 2 does not touch the needle.
    pub guide2_m: Option<[Profile; 2]>,
    /// Speed of the insertion against depth, m/s.
    pub speed_m_per_s: Profile,
}

/// How the tip cuts.
#[derive(Debug, Clone, PartialEq)]
pub enum Cutting {
    /// It takes a load: vertical and horizontal force against depth, N, before the needle is turned.
    Load([Profile; 2]),
    /// It cuts at an angle to the needle, in each plane, rad.
    Angle([f64; 2]),
}

/// What is believed of the tip.
#[derive(Debug, Clone, PartialEq)]
pub struct TipLaw {
    /// How it cuts.
    pub cutting: Cutting,
    /// Angle between the needle and the axis along which depth is measured, vertical and horizontal: a straight part of the path.
    pub entry_angle_rad: [f64; 2],
    /// What the load along the bevel is beside that: vertical before the needle is turned.
    pub along_bevel: BevelLoad,
}

/// A load along the bevel that varies with depth and speed, on top of the given one.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct BevelLoad {
    /// Growth with depth, N/m.
    pub slope_n_per_m: f64,
    /// Jumps: depth, m, and load from there on, N.
    pub steps: Vec<[f64; 2]>,
    /// Growth with speed, N s/m.
    pub rate_n_s_per_m: f64,
    /// How far the bevel is turned about the needle from what is stated, rad.
    pub roll_rad: f64,
}

impl Default for TipLaw {
    fn default() -> Self {
        let cutting = Cutting::Load([Profile::default(), Profile::default()]);
        Self { cutting, entry_angle_rad: [0.0; 2], along_bevel: BevelLoad::default() }
    }
}

impl TipLaw {
    /// A constant load, vertical and horizontal.
    pub fn load(force_n: [f64; 2]) -> Self {
        Self { cutting: Cutting::Load(force_n.map(Profile::constant)), ..Self::default() }
    }
}

/// Tip position at the depths of an insertion.
///
/// # Errors
/// As [`Growth::new`], and [`ModelError::OutOfRange`] for depths that are negative.
pub(super) fn tip_m(
    problems: &[BeamProblem; 2],
    law: &TipLaw,
    insertion: &Insertion,
    cache: &Cache,
) -> Result<Series, ModelError> {
    let mut last_m = DEFAULT_STEP_M;
    for depth_m in &insertion.depth_m {
        check("depth_m", *depth_m, "0 or more", *depth_m >= 0.0)?;
        last_m = depth_m.max(last_m);
    }
    let mut jumps_m: Vec<f64> = insertion.rotation_rad.jumps_m().collect();
    let mut grip = Guide2Grip::Free;
    if let Some(planes) = &insertion.guide2_m {
        jumps_m.extend(planes.iter().flat_map(Profile::jumps_m));
        grip = Guide2Grip::Holding;
    }
    if let Cutting::Load(planes) = &law.cutting {
        jumps_m.extend(planes.iter().flat_map(Profile::jumps_m));
    }
    jumps_m.extend(law.along_bevel.steps.iter().map(|[depth_m, _]| *depth_m));
    jumps_m.extend(insertion.speed_m_per_s.jumps_m());
    let grid_m = grid_m(last_m, DEFAULT_STEP_M, &jumps_m);
    let slopes = matches!(law.cutting, Cutting::Angle(_));
    let growths = [
        cache.growth(&problems[0], &grid_m, grip, slopes)?,
        cache.growth(&problems[1], &grid_m, grip, slopes)?,
    ];
    let plane = |plane: usize| -> Vec<f64> {
        let growth = &growths[plane];
        let states = states(growth, law, insertion, plane);
        let straight = law.entry_angle_rad[plane].tan();
        insertion
            .depth_m
            .iter()
            .map(|depth_m| tip_at(growth.depths_m(), &states, *depth_m) + straight * depth_m)
            .collect()
    };
    Ok(Series { y: plane(0), x: Some(plane(1)) })
}

/// Nodes closer than this make the beam singular in floating point; what differs by less happens at one depth.
const LEAST_STEP_M: f64 = 1e-6;

/// From 0 to `last_m` in steps of at most `step_m`, with nodes at `also_m` (where these lie inside).
pub fn grid_m(last_m: f64, step_m: f64, also_m: &[f64]) -> Vec<f64> {
    let inside = |m: &f64| *m > LEAST_STEP_M && *m < last_m - LEAST_STEP_M;
    let mut fixed_m: Vec<f64> = also_m.iter().copied().filter(inside).chain([last_m]).collect();
    fixed_m.sort_by(f64::total_cmp);
    fixed_m.dedup_by(|b, a| *b - *a < LEAST_STEP_M);
    let mut nodes_m = vec![0.0];
    let mut start_m = 0.0;
    for end_m in fixed_m {
        let count = ((end_m - start_m) / step_m - 1e-9).ceil().max(1.0);
        // The ends themselves to the last bit: what jumps there is looked for there.
        nodes_m.extend((1..count as usize).map(|i| start_m + (end_m - start_m) * i as f64 / count));
        nodes_m.push(end_m);
        start_m = end_m;
    }
    nodes_m
}

fn states(growth: &Growth, law: &TipLaw, insertion: &Insertion, plane: usize) -> Vec<TipState> {
    let depth_m = |node: usize| growth.depths_m()[node];
    let guide2 = |node: usize| match &insertion.guide2_m {
        Some(planes) => [planes[plane].before(depth_m(node)), planes[plane].after(depth_m(node))],
        None => [0.0; 2],
    };
    // Load and cutting angle are fixed to the needle: they turn with it.
    let turned = |[y, x]: [f64; 2], angle_rad: f64| {
        let (sin, cos) = angle_rad.sin_cos();
        [cos * y - sin * x, sin * y + cos * x][plane]
    };
    let rotation = &insertion.rotation_rad;
    let BevelLoad { slope_n_per_m, steps, rate_n_s_per_m, roll_rad } = &law.along_bevel;
    let speed = &insertion.speed_m_per_s;
    // On arriving at a depth a jump there is not yet felt, on leaving it is.
    let more_n = |z_m: f64, leaving: bool| {
        let stepped = steps.iter().filter(|[at_m, _]| *at_m < z_m || (leaving && *at_m == z_m));
        let speed_m_per_s = if leaving { speed.after(z_m) } else { speed.before(z_m) };
        slope_n_per_m * z_m + stepped.map(|[_, n]| n).sum::<f64>() + rate_n_s_per_m * speed_m_per_s
    };
    match &law.cutting {
        Cutting::Load([y, x]) => growth.under_load(|node| {
            let z_m = depth_m(node);
            let load_n = [
                turned([y.before(z_m) + more_n(z_m, false), x.before(z_m)], rotation.before(z_m) + roll_rad),
                turned([y.after(z_m) + more_n(z_m, true), x.after(z_m)], rotation.after(z_m) + roll_rad),
            ];
            Acting { load_n, guide2_m: guide2(node) }
        }),
        Cutting::Angle(angle_rad) => growth.at_cut_angle(
            |node| {
                let z_m = depth_m(node);
                [rotation.before(z_m), rotation.after(z_m)].map(|turn| turned(*angle_rad, turn + roll_rad))
            },
            |node| guide2(node)[0],
        ),
    }
}

/// Tip on arriving at a depth; linear between nodes.
fn tip_at(nodes_m: &[f64], states: &[TipState], depth_m: f64) -> f64 {
    let next = nodes_m.partition_point(|node_m| *node_m < depth_m);
    match (next.checked_sub(1).and_then(|i| Some((nodes_m.get(i)?, states.get(i)?))), states.get(next)) {
        (Some((from_m, from)), Some(to)) => {
            let share = (depth_m - from_m) / (nodes_m[next] - from_m);
            from.tip_m[1] + share * (to.tip_m[0] - from.tip_m[1])
        }
        (Some((_, only)), None) => only.tip_m[1],
        (None, Some(only)) => only.tip_m[0],
        (None, None) => f64::NAN,
    }
}
