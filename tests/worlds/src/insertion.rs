//! The path of the tip: a needle that grows through tissue whose springs rest where the tip has cut.

use super::chain::{Chain, STEP_M, node_at};
use super::world::World;
use super::{GuideStep, InsertionPlan, MM};

/// Cut tissue: where the tip was on arriving at and on leaving a depth, which differ where its load jumps.
struct Cut {
    tip_m: [f64; 2],
    /// Springs of the half cells before and after it.
    springs_n_per_m: [f64; 2],
}

/// Loads on the needle in a plane at a step, on arriving and on leaving.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Acting {
    /// Load on the tip.
    pub load_n: [f64; 2],
    /// Position to which guide 2 takes the needle.
    pub guide2_m: [f64; 2],
    /// Curvature of the needle by itself.
    pub bend_per_m: [f64; 2],
}

/// Tip positions in a plane at every step of an insertion, on arriving and on leaving, under what acts likewise. Steps count from the
/// stated surface; where the real one lies above it the tip has been in the tissue for some steps before.
pub(super) fn tip_path(
    world: &World,
    plane: usize,
    depth_m: f64,
    acting: impl Fn(usize) -> Acting,
) -> Vec<[f64; 2]> {
    let surface_m = world.tissue.surface_m;
    let early = (-surface_m / STEP_M).max(0.0).ceil() as usize;
    let entry = node_at(world.entry_m) - early;
    let shear = world.shear_n / STEP_M;
    let mut chain = Chain::new(world, entry, world.axial_n, world.frame_m_per_n);
    let mut cuts: Vec<Cut> = Vec::new();
    // Forces of the tissue that is cut already, on a needle at zero.
    let mut past_forces_n = vec![0.0; entry];
    for step in 0..=node_at(depth_m) + early {
        let tip = entry + step;
        let depth_m = (step as f64 - early as f64) * STEP_M;
        let skin = if step == early { world.skin_n_per_m } else { 0.0 };
        let integral_above =
            skin + if step == 0 { 0.0 } else { half_n_per_m(depth_m - 0.5 * STEP_M, plane, world) };
        past_forces_n.push(0.0);
        // Effect of the newest piece of path on the needle, per metre of it.
        let mut newest = vec![0.0; tip + 1];
        newest[tip] = integral_above;
        if let Some(cut) = cuts.last() {
            chain.grow();
            chain.add_slope(tip, world.shear_n);
            chain.band.add_spring(tip - 1, cut.springs_n_per_m[1]);
            past_forces_n[tip - 1] += cut.springs_n_per_m[1] * cut.tip_m[1] + shear * cut.tip_m[1];
            past_forces_n[tip] -= shear * cut.tip_m[1];
            newest[tip] += shear;
            newest[tip - 1] -= shear;
        }
        chain.band.add_spring(tip, integral_above);
        let factor = chain.band.factor();
        // In air nothing loads the bevel.
        let is_cutting = depth_m >= surface_m || surface_m <= 0.0;
        let Acting { load_n, guide2_m, bend_per_m } = acting(step.saturating_sub(early));
        let load_n = if is_cutting { load_n } else { [0.0; 2] };
        // Forces of the tip, the guide (which may be beside the line of the clamp) and the needle itself, beside the
        // past ones.
        let forces_n = |past_forces_n: &[f64], side: usize| {
            let mut force_n = past_forces_n.to_vec();
            force_n[tip] += load_n[side];
            if let Some((node, stiffness)) = chain.guide {
                force_n[node] += stiffness * (world.guide_offset_m[plane] + guide2_m[side]);
            }
            chain.bend_n(bend_per_m[side]).into_iter().for_each(|(node, bend_n)| force_n[node] += bend_n);
            force_n
        };
        // The newest path is where the tip is: the tip follows from both, without a step of lag.
        let arriving_m = factor.solve(&forces_n(&past_forces_n, 0))[tip] / (1.0 - factor.solve(&newest)[tip]);
        past_forces_n.iter_mut().zip(&newest).for_each(|(force, newest)| *force += newest * arriving_m);
        let changes = [load_n, guide2_m, bend_per_m].into_iter().any(|[before, after]| before != after);
        let leaving_m = if changes { factor.solve(&forces_n(&past_forces_n, 1))[tip] } else { arriving_m };
        cuts.push(Cut {
            tip_m: [arriving_m, leaving_m],
            springs_n_per_m: [integral_above, half_n_per_m(depth_m, plane, world)],
        });
    }
    cuts.into_iter().skip(early).map(|cut| cut.tip_m).collect()
}

fn half_n_per_m(from_m: f64, plane: usize, world: &World) -> f64 {
    world.springs_n_per_m(plane, from_m, from_m + 0.5 * STEP_M)
}

/// Commanded position of guide 2 at a step, on arriving and on leaving.
pub(super) fn commanded_m(steps: &[GuideStep], step: usize) -> [[f64; 2]; 2] {
    [false, true].map(|leaving| {
        let last_step = steps.iter().rfind(|one| is_past(node_at(MM * one.depth_mm), step, leaving));
        last_step.map_or([0.0; 2], |one| one.to_mm.map(|mm| MM * mm))
    })
}

/// Position to which it takes the needle: to within its clearance of every place to which it has been
/// commanded so far.
fn taken_m(world: &World, steps: &[GuideStep], step: usize, leaving: bool) -> [f64; 2] {
    let mut needle_m = [0.0_f64; 2];
    for one in steps.iter().filter(|one| is_past(node_at(MM * one.depth_mm), step, leaving)) {
        for (at_m, to_mm) in needle_m.iter_mut().zip(one.to_mm) {
            let play_m = MM * to_mm - *at_m;
            *at_m += (play_m.abs() - world.clearance_m - world.play_m).max(0.0).copysign(play_m);
        }
    }
    needle_m
}

/// Whether what happens at rest at `at` has happened at a step.
fn is_past(at: usize, step: usize, leaving: bool) -> bool {
    step > at || (leaving && step == at)
}

/// Loads in both planes at a step of an insertion, on arriving and on leaving.
pub(super) fn acting(world: &World, plan: &InsertionPlan, step: usize) -> [Acting; 2] {
    let speed_m_per_s = MM * plan.speed_mm_per_s;
    let turn = plan.turn_at_mm.map(|turn_mm| node_at(MM * turn_mm));
    let jump = node_at(world.load_step_m);
    let even_n = world.tip_load_n
        + world.load_slope_n_per_m * step as f64 * STEP_M
        + world.rate_n_s_per_m * speed_m_per_s;
    let guide2_m = [false, true].map(|leaving| taken_m(world, &plan.guide2_steps, step, leaving));
    let (sin, cos) = world.bevel_roll_rad.sin_cos();
    [(cos, 0), (sin, 1)].map(|(part, plane)| Acting {
        load_n: [false, true]
            .map(|leaving| part * load_n(leaving, even_n, jump, step, world.load_step_n, turn)),
        bend_per_m: [false, true].map(|leaving| load_sign(leaving, turn, step) * world.prebend_per_m[plane]),
        guide2_m: guide2_m.map(|planes| planes[plane]),
    })
}

fn load_n(
    leaving: bool,
    even_n: f64,
    jump: usize,
    step: usize,
    load_step_n: f64,
    turn: Option<usize>,
) -> f64 {
    load_sign(leaving, turn, step) * (even_n + if is_past(jump, step, leaving) { load_step_n } else { 0.0 })
}

fn load_sign(leaving: bool, turn: Option<usize>, step: usize) -> f64 {
    if turn.is_some_and(|at| is_past(at, step, leaving)) { -1.0 } else { 1.0 }
}
