//! A lateral run marched through its samples: guide 2 moves, the tissue answers with memory.

use super::chain::{Chain, Factor, STEP_M, node_at};
use super::world::World;
use super::{Foreign, MM};

/// Damage takes up to this share of the modulus, most of it after deflections of this size.
const DAMAGE_SHARE: f64 = 0.55;
const DAMAGE_M: f64 = 0.4 * MM;
/// Less is no growth of the largest deflection.
const GROWTH_M: f64 = 1e-9;
/// Modulus against negative deflections, as a share of that against positive ones.
const OTHER_SIDE: f64 = 0.5;
/// Spring at a tip that is held, and moment of a sleeve per rotation of the needle.
const TIP_N_PER_M: f64 = 400.0;
const SLEEVE_N_M: f64 = 2.0;
/// Newton steps of nonlinear tissue end below this change.
const STILL_M: f64 = 1e-11;
const MAX_STEPS: usize = 50;

/// True motion in one plane.
#[derive(Debug, Clone)]
pub(super) struct Motion {
    /// Force of guide 2 on the needle at every sample.
    pub force_n: Vec<f64>,
    /// Deflection of every node at the requested samples.
    pub shape_m: Vec<Vec<f64>>,
}

/// Tissue along the needle.
struct Tissue<'a> {
    world: &'a World,
    /// Stiffness at every node.
    springs_n_per_m: Vec<f64>,
    /// Force of the relaxing branch, and deflection, after the last sample.
    relaxing_n: Vec<f64>,
    before_m: Vec<f64>,
    /// Largest deflection so far.
    largest_m: Vec<f64>,
    /// Whether the last sample made it larger anywhere.
    grows: bool,
    /// Fraction of the relaxing force that remains after one sample, and of a change of it that arrives
    /// at its end.
    decay: f64,
    arrival: f64,
}

impl Tissue<'_> {
    /// Lasting and relaxing stiffness of a node as it is now.
    fn branches(&self, node: usize) -> [f64; 2] {
        let mut springs = self.springs_n_per_m[node];
        if self.world.has(Foreign::Damage) {
            springs *= 1.0 - DAMAGE_SHARE * (1.0 - (-self.largest_m[node] / DAMAGE_M).exp());
        }
        [(1.0 - self.world.relaxing_fraction) * springs, self.world.relaxing_fraction * springs]
    }

    /// Relaxing force of a node if it is at this deflection at the end of the sample.
    fn relaxing_n(&self, node: usize, relaxing: f64, deflection_m: f64) -> f64 {
        let change_m = deflection_m - self.before_m[node];
        self.decay * self.relaxing_n[node] + relaxing * self.arrival * change_m
    }

    /// Reaction of a node at a deflection, and its derivative.
    fn reaction(&self, node: usize, deflection_m: f64) -> [f64; 2] {
        let [mut lasting, relaxing] = self.branches(node);
        if self.world.has(Foreign::OneSidedTissue) && deflection_m < 0.0 {
            lasting *= OTHER_SIDE;
        }
        let strain_2 = (self.world.inverse_u0_per_m * deflection_m).powi(2);
        [
            lasting * deflection_m * (1.0 + strain_2) + self.relaxing_n(node, relaxing, deflection_m),
            lasting * (1.0 + 3.0 * strain_2) + relaxing * self.arrival,
        ]
    }

    /// Takes note of a sample.
    fn pass(&mut self, deflection_m: &[f64]) {
        self.grows = false;
        for (node, now_m) in deflection_m.iter().enumerate() {
            let [_, relaxing] = self.branches(node);
            self.relaxing_n[node] = self.relaxing_n(node, relaxing, *now_m);
            self.before_m[node] = *now_m;
            if now_m.abs() > self.largest_m[node] + GROWTH_M {
                self.largest_m[node] = now_m.abs();
                self.grows = true;
            }
        }
    }

    fn is_linear(&self) -> bool {
        self.world.inverse_u0_per_m == 0.0 && !self.world.has(Foreign::OneSidedTissue)
    }

    /// Whether deflections change while guide 2 rests.
    fn creeps(&self) -> bool {
        self.world.relaxing_fraction != 0.0 || (self.grows && self.world.has(Foreign::Damage))
    }
}

/// Prestress of a bent needle that guide 2 holds at zero in tissue without stress: its force and the deflection at a place.
pub(super) fn prestress(world: &World, plane: usize) -> (f64, impl Fn(f64) -> f64) {
    let (bend_per_m, guide2_m) = (world.prebend_per_m[plane], world.guide2_m.unwrap_or(0.0));
    let force_n =
        if guide2_m > 0.0 { -3.0 * world.bending_n_m2 * bend_per_m / (2.0 * guide2_m) } else { 0.0 };
    let per_bending = force_n / world.bending_n_m2;
    let shape = move |z_m: f64| {
        // Beyond the guide the force has no moment: the curve goes on from its slope there.
        let clamped_m = z_m.min(guide2_m);
        let beyond_guide_m = z_m - clamped_m;
        let by_force = per_bending * (0.5 * guide2_m * clamped_m * clamped_m - clamped_m.powi(3) / 6.0);
        let slope = per_bending * (guide2_m * clamped_m - 0.5 * clamped_m * clamped_m);
        0.5 * bend_per_m * z_m * z_m + by_force + slope * beyond_guide_m
    };
    (force_n, shape)
}

/// Marches a plane through these commanded displacements and keeps the shape at some samples.
pub(super) fn march(
    world: &World,
    plane: usize,
    depth_m: f64,
    commanded_m: &[f64],
    period_s: f64,
    keep: &[usize],
) -> Motion {
    let entry = node_at(world.entry_m);
    let mut chain = Chain::new(world, entry + node_at(depth_m), world.axial_n, world.frame_m_per_n);
    let last = chain.last();
    (entry + 1..=last).for_each(|node| chain.add_slope(node, world.shear_n));
    chain.band.add_spring(entry, world.skin_n_per_m);
    if world.has(Foreign::HeldTip) {
        chain.band.add_spring(last, TIP_N_PER_M);
    }
    if let Some((guide, _)) = chain.guide.filter(|_| world.has(Foreign::Sleeve)) {
        let across_m = 2.0 * STEP_M;
        chain.band.add_energy(SLEEVE_N_M / across_m.powi(2), &[(guide - 1, -1.0), (guide + 1, 1.0)]);
    }
    let mut tissue = tissue(world, plane, [entry, last], period_s);
    let (prestress_n, prestress_shape_m) = prestress(world, plane);
    let prestress_m: Vec<f64> = (0..=last).map(|node| prestress_shape_m(node as f64 * STEP_M)).collect();
    let mut deflection_m = vec![0.0; last + 1];
    let mut play_m: f64 = 0.0;
    let mut factor: Option<(Vec<f64>, Factor)> = None;
    let mut solved_m = None;
    let mut motion = Motion { force_n: Vec::new(), shape_m: Vec::new() };
    for (sample, at_m) in commanded_m.iter().enumerate() {
        play_m = play_m.clamp(at_m - world.play_m, at_m + world.play_m);
        let mut guided_m = play_m;
        let touches = guided_m.abs() > world.clearance_m || world.clearance_m <= 0.0;
        guided_m = if touches { guided_m - world.clearance_m * guided_m.signum() } else { 0.0 };
        // The frame gives way to the force that is there at rest, too.
        let guided_m = guided_m - if touches { world.frame_m_per_n * prestress_n } else { 0.0 };
        if solved_m != Some(guided_m) || tissue.creeps() {
            settle(&chain, &tissue, guided_m, &mut deflection_m, &mut factor);
            tissue.pass(&deflection_m);
            solved_m = Some(guided_m);
        }
        let pushed_n = match chain.guide {
            Some((node, stiffness)) if touches => stiffness * (guided_m - deflection_m[node]),
            _ => 0.0,
        };
        motion.force_n.push(prestress_n + pushed_n);
        for _ in keep.iter().filter(|kept| **kept == sample) {
            motion
                .shape_m
                .push(deflection_m.iter().zip(&prestress_m).map(|(now, rest)| now + rest).collect());
        }
    }
    motion
}

fn tissue<'a>(world: &'a World, plane: usize, [entry, last]: [usize; 2], period_s: f64) -> Tissue<'a> {
    let decay = (-period_s / world.tau_s).exp();
    Tissue {
        world,
        springs_n_per_m: (0..=last)
            .map(|node| {
                let depth_m = STEP_M * (node as f64 - entry as f64);
                let end_m = STEP_M * (last as f64 - entry as f64);
                // Above the surface there are no springs, wherever the surface really is.
                let (from_depth_m, to_depth_m) =
                    (depth_m - 0.5 * STEP_M, (depth_m + 0.5 * STEP_M).min(end_m));
                if to_depth_m > from_depth_m {
                    world.springs_n_per_m(plane, from_depth_m, to_depth_m)
                } else {
                    0.0
                }
            })
            .collect(),
        relaxing_n: vec![0.0; last + 1],
        before_m: vec![0.0; last + 1],
        largest_m: vec![0.0; last + 1],
        grows: false,
        decay,
        // Exact for a deflection that changes evenly between samples.
        arrival: world.tau_s / period_s * (1.0 - decay),
    }
}

/// Mean of a function of depth over the tissue that a run touches, each depth by the squared deflection there.
pub(super) fn touched(world: &World, plane: usize, depth_m: f64, of: &dyn Fn(f64) -> f64) -> f64 {
    let motion = march(world, plane, depth_m, &[MM], 1.0, &[0]);
    let entry = node_at(world.entry_m);
    let (mut weighted, mut total_weight) = (0.0, 0.0);
    for (node, deflection_m) in motion.shape_m.iter().flatten().enumerate().skip(entry) {
        weighted += deflection_m * deflection_m * of((node - entry) as f64 * STEP_M);
        total_weight += deflection_m * deflection_m;
    }
    weighted / total_weight
}

/// Newton's method from the last deflection.
fn settle(
    chain: &Chain,
    tissue: &Tissue,
    guided_m: f64,
    deflection_m: &mut [f64],
    factor: &mut Option<(Vec<f64>, Factor)>,
) {
    for _ in 0..MAX_STEPS {
        let mut unbalanced_n = chain.band.times(deflection_m);
        let mut tangent = vec![0.0; deflection_m.len()];
        for (node, now_m) in deflection_m.iter().enumerate() {
            let [reaction_n, slope] = tissue.reaction(node, *now_m);
            unbalanced_n[node] += reaction_n;
            tangent[node] = slope;
        }
        if let Some((node, stiffness)) = chain.guide {
            unbalanced_n[node] -= stiffness * guided_m;
        }
        // Linear tissue keeps its factors for the whole run.
        let (_, factor) = match factor.take().filter(|(of, _)| *of == tangent) {
            Some(same) => factor.insert(same),
            None => {
                let mut band = chain.band.clone();
                tangent.iter().enumerate().for_each(|(node, slope)| band.add_spring(node, *slope));
                factor.insert((tangent, band.factor()))
            }
        };
        let change_m = factor.solve(&unbalanced_n);
        deflection_m.iter_mut().zip(&change_m).for_each(|(now, change)| *now -= change);
        let largest_m = change_m.iter().fold(0.0, |most: f64, change| most.max(change.abs()));
        if tissue.is_linear() || largest_m < STILL_M {
            return;
        }
    }
}
