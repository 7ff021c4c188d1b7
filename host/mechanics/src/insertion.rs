//! An insertion: the needle grows into the tissue, and its tip leaves the cut path behind.
//!
//! Quasi-static (theory, eq. 37): at each depth the needle is in equilibrium with guide 2, the springs at rest on the
//! path cut so far, and the load that the bevel takes at the tip. The load turns with the needle about its axis.

use super::cache::Cache;
use super::growth::{DEFAULT_STEP_M, Guide2Grip, NodeLoads};
use super::{BeamProblem, ModelError, Profile, Series, check, yielding};
use std::borrow::Cow;

/// Motion of an insertion: how deep, how turned, and what guide 2 did.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Insertion {
    /// Depths at which the tip is measured, not negative.
    pub depth_m: Vec<f64>,
    /// Rotation of the needle about its axis, rad, against depth.
    pub rotation_rad: Profile,
    /// Vertical and horizontal displacement of guide 2 against depth, m; `None` where guide 2 does not touch the needle.
    pub guide2_m: Option<[Profile; 2]>,
    /// Speed of the insertion against depth, m/s.
    pub speed_m_per_s: Profile,
    /// Whether the slope of the needle at the tip is measured too; it takes twice the time.
    pub tip_direction: bool,
    /// Depths at which the solution has nodes besides those it needs, and to the largest of which it goes: insertions with the same ones
    /// share their solutions ([`Insertion::share_nodes`]).
    pub nodes_m: Vec<f64>,
    /// Number of the insertion among those of its session, 0 for the first.
    pub order: f64,
}

impl Insertion {
    /// Depths at which the needle is turned or guide 2 moved at rest, or the speed changes.
    pub fn jumps_m(&self) -> Vec<f64> {
        let guide_profiles = self.guide2_m.iter().flatten();
        let profiles = [&self.rotation_rad, &self.speed_m_per_s].into_iter().chain(guide_profiles);
        profiles.flat_map(Profile::jumps_m).collect()
    }

    /// The same with guide 2 as the needle follows it through its clearance ([`Profile::through_clearance`]).
    pub(super) fn through_clearance(&self, clearance_m: f64) -> Cow<'_, Self> {
        match &self.guide2_m {
            Some(planes) if clearance_m > 0.0 => {
                let guide2_m = Some(planes.each_ref().map(|plane| plane.through_clearance(clearance_m)));
                Cow::Owned(Self { guide2_m, ..self.clone() })
            }
            _ => Cow::Borrowed(self),
        }
    }

    /// Gives insertions the nodes of all of them, so that one solution ([`GrowingBeam`](super::growth::GrowingBeam)) serves them all.
    pub fn share_nodes<'a>(insertions: impl Iterator<Item = &'a mut Self>) {
        let profiles: Vec<&mut Self> = insertions.collect();
        let ends = profiles.iter().flat_map(|one| one.depth_m.iter().copied().reduce(f64::max));
        let mut nodes_m: Vec<f64> = profiles.iter().flat_map(|one| one.jumps_m()).chain(ends).collect();
        nodes_m.sort_by(f64::total_cmp);
        nodes_m.dedup();
        profiles.into_iter().for_each(|one| one.nodes_m.clone_from(&nodes_m));
    }
}

/// Law by which the tip cuts.
#[derive(Debug, Clone, PartialEq)]
pub enum Cutting {
    /// It takes a load: vertical and horizontal force against depth, N, before the needle is turned.
    Load([Profile; 2]),
    /// It cuts at an angle to the needle, in each plane, rad.
    Angle([f64; 2]),
}

/// Assumptions about the tip.
#[derive(Debug, Clone, PartialEq)]
pub struct TipLaw {
    /// Law of cutting.
    pub cutting: Cutting,
    /// Angle at which the bevel makes the path leave the needle, beside what the load does, vertical and horizontal before the needle is
    /// turned, rad: the path is that under the load plus that of a tip that cuts at this angle ([`Cutting::Angle`]) and takes no other
    /// load. The needle is linear, so that the path's slope beside the needle's is larger by this angle everywhere.
    pub cut_angle_rad: [f64; 2],
    /// Angle between the needle and the axis along which depth is measured, vertical and horizontal: a straight part of the path.
    pub entry_angle_rad: [f64; 2],
    /// Additional load along the bevel: along the given load where that has a horizontal part, else vertical, before
    /// the needle is turned.
    pub along_bevel: BevelLoad,
}

/// A load along the bevel that varies with depth and speed, on top of the given one.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct BevelLoad {
    /// GrowingBeam with depth, N/m.
    pub slope_n_per_m: f64,
    /// Jumps: depth, m, and load from there on, N.
    pub steps: Vec<[f64; 2]>,
    /// GrowingBeam with speed, N s/m.
    pub rate_n_s_per_m: f64,
    /// Rotation of the bevel about the needle from its stated angle, rad.
    pub roll_rad: f64,
    /// Loads that terms add, N against depth.
    pub laws: Vec<Profile>,
}

impl Default for TipLaw {
    fn default() -> Self {
        let cutting = Cutting::Load([Profile::default(), Profile::default()]);
        Self {
            cutting,
            cut_angle_rad: [0.0; 2],
            entry_angle_rad: [0.0; 2],
            along_bevel: BevelLoad::default(),
        }
    }
}

impl TipLaw {
    /// A constant load, vertical and horizontal.
    pub fn load(force_n: [f64; 2]) -> Self {
        Self { cutting: Cutting::Load(force_n.map(Profile::constant)), ..Self::default() }
    }
}

/// The tip in both planes at the depths of an insertion.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tip {
    /// Its position.
    pub position_m: Series,
    /// Slope of the needle there; `None` where that is not requested.
    pub direction_rad: Series,
}

/// The tip at the depths of an insertion, of a needle with a stress-free curvature, vertical and horizontal before it is turned.
///
/// # Errors
/// As [`GrowingBeam::new`], and [`ModelError::OutOfRange`] for depths that are negative.
pub(super) fn tip(
    problems: &[BeamProblem; 2],
    law: &TipLaw,
    curvature_per_m: [f64; 2],
    insertion: &Insertion,
    cache: &Cache,
) -> Result<Tip, ModelError> {
    let mut last_m = DEFAULT_STEP_M;
    for depth_m in &insertion.depth_m {
        check("depth_m", *depth_m, "0 or more", *depth_m >= 0.0)?;
        last_m = depth_m.max(last_m);
    }
    let mut jumps_m = insertion.jumps_m();
    let grip = if insertion.guide2_m.is_some() { Guide2Grip::Holding } else { Guide2Grip::Free };
    if let Cutting::Load(planes) = &law.cutting {
        jumps_m.extend(planes.iter().flat_map(Profile::jumps_m));
    }
    jumps_m.extend(law.along_bevel.steps.iter().map(|[depth_m, _]| *depth_m));
    let drawn = Drawn { law, curvature_per_m, insertion, grip, jumps_m, last_m };
    let [[y_m, y_rad], [x_m, x_rad]] =
        [drawn.plane(0, &problems[0], cache)?, drawn.plane(1, &problems[1], cache)?];
    Ok(Tip {
        position_m: Series { y: y_m, x: Some(x_m) },
        direction_rad: Series { y: y_rad, x: Some(x_rad) },
    })
}

/// An insertion, and what is on its way.
struct Drawn<'a> {
    law: &'a TipLaw,
    /// Stress-free curvature of the needle before it is turned.
    curvature_per_m: [f64; 2],
    insertion: &'a Insertion,
    grip: Guide2Grip,
    /// Depths at which anything jumps.
    jumps_m: Vec<f64>,
    last_m: f64,
}

impl Drawn<'_> {
    /// Position of the tip and slope of the needle there in one plane, at every requested depth.
    fn plane(&self, plane: usize, problem: &BeamProblem, cache: &Cache) -> Result<[Vec<f64>; 2], ModelError> {
        let Self { law, insertion, grip, last_m, .. } = *self;
        let yields = problem.law.inverse_yield_m_per_n != 0.0;
        let grid_m = if yields {
            // Every node is an iteration of its own: nothing would be shared.
            grid_m(last_m, yielding::STEP_M, &self.jumps_m)
        } else {
            let last_m = insertion.nodes_m.iter().copied().fold(last_m, f64::max);
            grid_m(last_m, DEFAULT_STEP_M, &[self.jumps_m.as_slice(), &insertion.nodes_m].concat())
        };
        let angled = law.cut_angle_rad != [0.0; 2];
        let slopes = insertion.tip_direction || angled || matches!(law.cutting, Cutting::Angle(_));
        let guide2 = |node: usize| guide2(&grid_m, insertion, plane, node);
        let bent = |node: usize| self.bent(&grid_m, plane, node);
        let (mut tips_m, mut directions) = if yields {
            let Cutting::Load(load) = &law.cutting else {
                return check("cutting", f64::NAN, "a load on the tip, where the tissue yields", false)
                    .map(|()| Default::default());
            };
            let loads = loads(&grid_m, load, law, insertion, plane);
            let acting = |node: usize| NodeLoads { load_n: loads(node), guide2_m: guide2(node) };
            let nodes = || 0..grid_m.len();
            let (acting, bent) = (nodes().map(acting).collect(), nodes().map(bent).collect());
            let path = cache.yielding(problem, &grid_m, grip, acting, bent)?;
            let (states, directions) = path.as_ref();
            (states.iter().map(|state| state.tip_m).collect::<Vec<_>>(), directions.clone())
        } else {
            let growth = cache.growth(problem, &grid_m, grip, slopes)?;
            let states = match &law.cutting {
                Cutting::Load(load) => {
                    let loads = loads(&grid_m, load, law, insertion, plane);
                    let acting = |node: usize| NodeLoads { load_n: loads(node), guide2_m: guide2(node) };
                    growth.bent_under_load(acting, bent)
                }
                Cutting::Angle(angle_rad) => {
                    let angles = angles(&grid_m, *angle_rad, law, insertion, plane);
                    growth.bent_at_cut_angle(angles, |node| guide2(node)[0], bent)
                }
            };
            let directions = if insertion.tip_direction {
                growth.bent_tip_slopes(&states, guide2, bent)
            } else {
                Vec::new()
            };
            (states.iter().map(|state| state.tip_m).collect(), directions)
        };
        if angled {
            let growth = cache.growth(problem, &grid_m, grip, true)?;
            let angle_rad = angles(&grid_m, law.cut_angle_rad, law, insertion, plane);
            let states = growth.at_cut_angle(angle_rad, |_| 0.0);
            let add = |to: &mut Vec<[f64; 2]>, more: Vec<[f64; 2]>| {
                to.iter_mut().zip(more).for_each(|(to, more)| *to = [to[0] + more[0], to[1] + more[1]]);
            };
            add(&mut directions, growth.tip_slopes(&states, |_| [0.0; 2]));
            add(&mut tips_m, states.iter().map(|state| state.tip_m).collect());
        }
        let straight = law.entry_angle_rad[plane].tan();
        let depths_m = insertion.depth_m.iter();
        let position_m = depths_m.clone().map(|m| at_depth(&grid_m, &tips_m, *m) + straight * m).collect();
        let direction_at_m = if insertion.tip_direction { insertion.depth_m.as_slice() } else { &[] };
        let direction_rad =
            direction_at_m.iter().map(|m| at_depth(&grid_m, &directions, *m) + straight).collect();
        Ok([position_m, direction_rad])
    }

    /// Stress-free curvature of the needle in a plane at a node, on arriving and on leaving: it turns with the needle.
    fn bent(&self, nodes_m: &[f64], plane: usize, node: usize) -> [f64; 2] {
        bent(self.curvature_per_m, &self.insertion.rotation_rad, nodes_m[node], plane)
    }
}

/// Stress-free curvature in a plane of a needle that turns, at a depth, on arriving and on leaving.
pub fn bent(curvature_per_m: [f64; 2], rotation: &Profile, depth_m: f64, plane: usize) -> [f64; 2] {
    if curvature_per_m == [0.0; 2] {
        return [0.0; 2];
    }
    [rotation.before(depth_m), rotation.after(depth_m)].map(|turn| turned(curvature_per_m, turn, plane))
}

/// Displacement of guide 2 at a node, on arriving and on leaving.
fn guide2(nodes_m: &[f64], insertion: &Insertion, plane: usize, node: usize) -> [f64; 2] {
    match &insertion.guide2_m {
        Some(planes) => [planes[plane].before(nodes_m[node]), planes[plane].after(nodes_m[node])],
        None => [0.0; 2],
    }
}

/// From 0 to `last_m` in steps of at most `step_m`, with nodes at `also_m` (where these lie inside).
pub fn grid_m(last_m: f64, step_m: f64, also_m: &[f64]) -> Vec<f64> {
    let mut fixed_m: Vec<f64> =
        also_m.iter().copied().filter(|m| *m > 0.0 && *m < last_m).chain([last_m]).collect();
    fixed_m.sort_by(f64::total_cmp);
    fixed_m.dedup();
    let mut nodes_m = vec![0.0];
    let mut start_m = 0.0;
    for end_m in fixed_m {
        let count = ((end_m - start_m) / step_m - 1e-9).ceil().max(1.0);
        // The ends themselves to the last bit: what jumps there is evaluated there.
        nodes_m.extend((1..count as usize).map(|i| start_m + (end_m - start_m) * i as f64 / count));
        nodes_m.push(end_m);
        start_m = end_m;
    }
    nodes_m
}

/// A vector that is fixed to the needle turns with it: its part in a plane.
fn turned([y, x]: [f64; 2], angle_rad: f64, plane: usize) -> f64 {
    let (sin, cos) = angle_rad.sin_cos();
    [cos * y - sin * x, sin * y + cos * x][plane]
}

/// The tip load in a plane at every node, on arriving and on leaving.
fn loads<'a>(
    nodes_m: &'a [f64],
    [y, x]: &'a [Profile; 2],
    law: &'a TipLaw,
    insertion: &'a Insertion,
    plane: usize,
) -> impl Fn(usize) -> [f64; 2] + 'a {
    let rotation = &insertion.rotation_rad;
    let BevelLoad { slope_n_per_m, steps, rate_n_s_per_m, roll_rad, laws } = &law.along_bevel;
    let speed = &insertion.speed_m_per_s;
    // On arriving at a depth a jump there is not yet felt, on leaving it is.
    let more_n = move |z_m: f64, leaving: bool| {
        let stepped = steps.iter().filter(|[at_m, _]| *at_m < z_m || (leaving && *at_m == z_m));
        let speed_m_per_s = if leaving { speed.after(z_m) } else { speed.before(z_m) };
        let by_laws_n: f64 = laws.iter().map(|law| law.before(z_m)).sum();
        slope_n_per_m * z_m
            + stepped.map(|[_, n]| n).sum::<f64>()
            + rate_n_s_per_m * speed_m_per_s
            + by_laws_n
    };
    move |node| {
        let z_m = nodes_m[node];
        let arriving = load_along_bevel(y.before(z_m), x.before(z_m), more_n(z_m, false));
        let leaving = load_along_bevel(y.after(z_m), x.after(z_m), more_n(z_m, true));
        [
            turned(arriving, rotation.before(z_m) + roll_rad, plane),
            turned(leaving, rotation.after(z_m) + roll_rad, plane),
        ]
    }
}

/// Load with an addition along its own direction.
fn load_along_bevel(y_n: f64, x_n: f64, more_n: f64) -> [f64; 2] {
    // The bevel is vertical unless the load states that it is not.
    let [along_y, along_x] =
        if x_n == 0.0 { [1.0, 0.0] } else { [y_n / y_n.hypot(x_n), x_n / y_n.hypot(x_n)] };
    [y_n + more_n * along_y, x_n + more_n * along_x]
}

/// The angle at which the tip cuts in a plane at every node, on arriving and on leaving.
fn angles<'a>(
    nodes_m: &'a [f64],
    angle_rad: [f64; 2],
    law: &'a TipLaw,
    insertion: &'a Insertion,
    plane: usize,
) -> impl Fn(usize) -> [f64; 2] + 'a {
    let (rotation, roll_rad) = (&insertion.rotation_rad, law.along_bevel.roll_rad);
    move |node| {
        let z_m = nodes_m[node];
        [rotation.before(z_m), rotation.after(z_m)].map(|turn| turned(angle_rad, turn + roll_rad, plane))
    }
}

/// A quantity on arriving at a depth, from those at the nodes on arriving and on leaving; linear between nodes.
fn at_depth(nodes_m: &[f64], values: &[[f64; 2]], depth_m: f64) -> f64 {
    let next = nodes_m.partition_point(|node_m| *node_m < depth_m);
    match (next.checked_sub(1).and_then(|i| Some((nodes_m.get(i)?, values.get(i)?))), values.get(next)) {
        (Some((from_m, [_, from])), Some([to, _])) => {
            let fraction = (depth_m - from_m) / (nodes_m[next] - from_m);
            from + fraction * (to - from)
        }
        (Some((_, [_, left])), None) => *left,
        (None, Some([arriving, _])) => *arriving,
        (None, None) => f64::NAN,
    }
}
