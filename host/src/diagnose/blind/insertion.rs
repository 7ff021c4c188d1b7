//! The path of the tip: a needle that grows through tissue whose springs rest where the tip has cut.

use super::chain::{Chain, STEP_M, node_at};
use super::world::World;

/// Cut tissue: where the tip was on arriving at and on leaving a depth, which differ where its load jumps.
struct Cut {
    tip_m: [f64; 2],
    /// Springs of the half cells before and after it.
    springs_n_per_m: [f64; 2],
}

/// Tip positions in a plane at every step of an insertion, on arriving and on leaving, under a load that is given likewise. Steps
/// count from the stated surface; where the real one lies above it the tip has been in the tissue for some steps before.
pub(super) fn tip_path(
    world: &World,
    plane: usize,
    depth_m: f64,
    load_n: impl Fn(usize) -> [f64; 2],
) -> Vec<[f64; 2]> {
    let surface_m = world.tissue.surface_m;
    let early = (-surface_m / STEP_M).max(0.0).ceil() as usize;
    let entry = node_at(world.entry_m) - early;
    let shear = world.shear_n / STEP_M;
    let mut chain = Chain::new(world, entry, world.axial_n, 0.0);
    let mut cuts: Vec<Cut> = Vec::new();
    // Forces of the tissue that is cut already and of a guide beside the line of the clamp, on a needle at zero.
    let mut past_n = vec![0.0; entry];
    if let Some((force_n, (_, stiffness))) =
        chain.guide.and_then(|guide| Some((past_n.get_mut(guide.0)?, guide)))
    {
        *force_n = stiffness * world.guide_offset_m[plane];
    }
    for step in 0..=node_at(depth_m) + early {
        let tip = entry + step;
        let at_m = (step as f64 - early as f64) * STEP_M;
        let half = |from_m: f64| world.springs_n_per_m(plane, from_m, from_m + 0.5 * STEP_M);
        let skin = if step == early { world.skin_n_per_m } else { 0.0 };
        let above = skin + if step == 0 { 0.0 } else { half(at_m - 0.5 * STEP_M) };
        past_n.push(0.0);
        // What the newest piece of path does to the needle, per metre of it.
        let mut newest = vec![0.0; tip + 1];
        newest[tip] = above;
        if let Some(cut) = cuts.last() {
            chain.grow();
            chain.add_slope(tip, world.shear_n);
            chain.band.add_spring(tip - 1, cut.springs_n_per_m[1]);
            past_n[tip - 1] += cut.springs_n_per_m[1] * cut.tip_m[1] + shear * cut.tip_m[1];
            past_n[tip] -= shear * cut.tip_m[1];
            newest[tip] += shear;
            newest[tip - 1] -= shear;
        }
        chain.band.add_spring(tip, above);
        let factor = chain.band.factor();
        // In air nothing loads the bevel.
        let is_cutting = at_m >= surface_m || surface_m <= 0.0;
        let [arriving_n, leaving_n] = if is_cutting { load_n(step.saturating_sub(early)) } else { [0.0; 2] };
        // The newest path is where the tip is: the tip follows from both, without a step of lag.
        let mut force_n = past_n.clone();
        force_n[tip] += arriving_n;
        let arriving_m = factor.solve(&force_n)[tip] / (1.0 - factor.solve(&newest)[tip]);
        past_n.iter_mut().zip(&newest).for_each(|(force, newest)| *force += newest * arriving_m);
        let mut leaving_m = arriving_m;
        if leaving_n != arriving_n {
            let mut force_n = past_n.clone();
            force_n[tip] += leaving_n;
            leaving_m = factor.solve(&force_n)[tip];
        }
        cuts.push(Cut { tip_m: [arriving_m, leaving_m], springs_n_per_m: [above, half(at_m)] });
    }
    cuts.into_iter().skip(early).map(|cut| cut.tip_m).collect()
}

/// Load on the tip in both planes at a step, on arriving and on leaving.
pub(super) fn load_n(world: &World, speed_m_per_s: f64, turn: Option<usize>, step: usize) -> [[f64; 2]; 2] {
    let jump = node_at(world.load_step_m);
    let even_n = world.tip_load_n
        + world.load_slope_n_per_m * step as f64 * STEP_M
        + world.rate_n_s_per_m * speed_m_per_s;
    let load = |leaving: bool| {
        let is_past = |at: usize| step > at || (leaving && step == at);
        let sign = if turn.is_some_and(is_past) { -1.0 } else { 1.0 };
        sign * (even_n + if is_past(jump) { world.load_step_n } else { 0.0 })
    };
    let (sin, cos) = world.bevel_roll_rad.sin_cos();
    [cos, sin].map(|part| [false, true].map(|leaving| part * load(leaving)))
}
