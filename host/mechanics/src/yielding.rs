//! An insertion into tissue that yields: what the linear needle of [`GrowingBeam`](super::growth::GrowingBeam) cannot do
//! (theory, eq. 11).
//!
//! The reaction of the tissue per length is that of a soil that yields, `K s / sqrt(1 + (K s / p_y)^2)` with the stretch `s` from the cut
//! path and a yield load that grows with depth, `p_y = p_0 exp(depth / d)`: near the free surface tissue gives way upwards. It is elastic:
//! unloading goes back on the same curve. At every depth the needle is solved by finite elements ([`Elements`]) and Newton's method; the
//! path is linear between depths and its newest end implicit, as in the linear needle.

use super::elements::{Deformed, Elements, Guide2, Newest, Reaction, Springs, StressFreePath};
use super::growth::{Guide2Grip, NodeLoads, TipState};
use super::terms::ActingLaw;
use super::{BeamProblem, Foundation, ModelError, TissueLaw, check};

/// Step of the insertion.
pub(super) const STEP_M: f64 = 1e-3;
/// Length of an element: a step's, so that rounding makes no more of them.
const ELEMENT_M: f64 = STEP_M * (1.0 + 1e-9);

/// Share of the tangent without laws below which Newton's method does not take it: a step is at most twenty times too long, and halved until
/// the balance improves.
const MIN_TANGENT: f64 = 0.05;

impl TissueLaw {
    /// Reaction of tissue that yields, and stiffens, to a stretch where the reciprocal of its yield load is this.
    fn reaction_at(&self, modulus_pa: f64, inverse_m_per_n: f64, stretch_m: f64) -> Reaction {
        let more = (self.inverse_u0_per_m * stretch_m).powi(2);
        let force_n_per_m = modulus_pa * stretch_m * (1.0 + more);
        let tangent_pa = modulus_pa * (1.0 + 3.0 * more);
        if self.inverse_yield_m_per_n == 0.0 {
            return Reaction { force_n_per_m, tangent_pa };
        }
        let root = (1.0 + (inverse_m_per_n * force_n_per_m).powi(2)).sqrt();
        Reaction { force_n_per_m: force_n_per_m / root, tangent_pa: tangent_pa / root.powi(3) }
    }

    /// Whether the reaction is not in proportion to the stretch.
    pub(super) fn is_nonlinear(&self) -> bool {
        self.inverse_u0_per_m != 0.0 || self.inverse_yield_m_per_n != 0.0
    }
}

/// Tissue that yields, or stiffens, as springs.
pub(super) struct Yielding<'a> {
    pub law: TissueLaw,
    pub foundation: &'a Foundation,
    /// Laws of the grammar that act on the reaction.
    pub reaction: &'a [ActingLaw],
}

impl Springs for Yielding<'_> {
    /// Modulus, and reciprocal of the yield load.
    type Place = [f64; 2];

    fn place(&self, depth_m: f64) -> [f64; 2] {
        let inverse_m_per_n = self.law.inverse_yield_m_per_n * (-depth_m / self.law.yield_depth_m).exp();
        [self.foundation.modulus_pa(depth_m), inverse_m_per_n]
    }

    fn reaction(&self, [modulus_pa, inverse_m_per_n]: &[f64; 2], stretch_m: f64) -> Reaction {
        let plain = self.law.reaction_at(*modulus_pa, *inverse_m_per_n, stretch_m);
        if self.reaction.is_empty() {
            return plain;
        }
        let [law_value, slope_per_m] = ActingLaw::reaction(self.reaction, stretch_m);
        let tangent_pa = plain.tangent_pa * law_value + plain.force_n_per_m * slope_per_m;
        // Newton's method goes on where the reaction no longer grows.
        let tangent_pa = tangent_pa.max(MIN_TANGENT * plain.tangent_pa);
        Reaction { force_n_per_m: plain.force_n_per_m * law_value, tangent_pa }
    }
}

/// The tip's way, and the slope of the needle there on arriving and on leaving, per node.
pub(super) type YieldingPath = (Vec<TipState>, Vec<[f64; 2]>);

/// The tip's way under given loads, and the slope of the needle there, at every depth of `nodes_m`, on arriving and on leaving; the
/// needle has a stress-free curvature (per node, on arriving and on leaving).
///
/// # Errors
/// [`ModelError::OutOfRange`] for problems out of range and a shear layer, which is not combined with yielding; as
/// [`Elements::solve`].
pub(super) fn under_load(
    problem: &BeamProblem,
    nodes_m: &[f64],
    grip: Guide2Grip,
    acting: impl Fn(usize) -> NodeLoads,
    curvature_per_m: impl Fn(usize) -> [f64; 2],
) -> Result<YieldingPath, ModelError> {
    check("shear_n", problem.shear_n, "0, where the tissue yields", problem.shear_n == 0.0)?;
    let (law, foundation) = (problem.law, &problem.foundation);
    // An insertion is the first loading of fresh tissue: what stiffens is not part of it, as for the linear needle.
    let law = TissueLaw { inverse_u0_per_m: 0.0, ..law };
    let springs = Yielding { law, foundation, reaction: &[] };
    let mut states: Vec<TipState> = Vec::with_capacity(nodes_m.len());
    let mut slopes = Vec::with_capacity(nodes_m.len());
    // The needle at the depth before.
    let mut previous: Option<Deformed> = None;
    for (node, depth_m) in nodes_m.iter().enumerate() {
        let (NodeLoads { load_n, guide2_m }, bent) = (acting(node), curvature_per_m(node));
        let is_still = states.iter().all(|state| state.tip_m == [0.0; 2]);
        if is_still && [load_n, guide2_m, bent] == [[0.0; 2]; 3] {
            states.push(TipState { tip_m: [0.0; 2], load_n });
            slopes.push([0.0; 2]);
            continue;
        }
        let beam = BeamProblem { depth_m: *depth_m, ..problem.clone() };
        let elements = Elements::new(&beam, ELEMENT_M)?;
        let elements = bent.map(|curvature_per_m| elements.bent(curvature_per_m));
        let tip_z_m = problem.entry_m + depth_m;
        // Once the tip has arrived its way is cut; until then its newest end is where the tip is.
        let last = node.checked_sub(1).map(|last| (problem.entry_m + nodes_m[last], states[last].tip_m[1]));
        let (from_z_m, old_tip_m) = last.unwrap_or((problem.entry_m, 0.0));
        let solve = |arrived_m: Option<f64>, side: usize, near: Option<&Deformed>| {
            let cut_m =
                |z_m: f64| path_m(nodes_m, &states, arrived_m.unwrap_or(old_tip_m), z_m - problem.entry_m);
            let newest =
                (arrived_m.is_none() && from_z_m < tip_z_m).then_some(Newest { from_z_m, from_m: old_tip_m });
            let guide2 = match grip {
                Guide2Grip::Holding if problem.guide2_compliance_m_per_n == 0.0 => {
                    Guide2::Held(guide2_m[side])
                }
                Guide2Grip::Holding => {
                    let compliance_m_per_n = problem.guide2_compliance_m_per_n;
                    Guide2::Sprung { at_m: guide2_m[side], compliance_m_per_n }
                }
                Guide2Grip::Free => Guide2::Force(0.0),
            };
            let path = StressFreePath { path_m: cut_m, newest };
            let needle = elements[side].solve_from(&springs, &path, guide2, load_n[side], near)?;
            Ok::<_, ModelError>(((needle.deflection_m(tip_z_m), needle.tip_slope()), needle))
        };
        let (arrived, mut needle) = solve(None, 0, previous.as_ref())?;
        let at_rest = [load_n, guide2_m, bent].into_iter().all(|[arriving, leaving]| arriving == leaving);
        let leaving = if at_rest {
            arrived
        } else {
            let left;
            (left, needle) = solve(Some(arrived.0), 1, Some(&needle))?;
            left
        };
        states.push(TipState { tip_m: [arrived.0, leaving.0], load_n });
        slopes.push([arrived.1, leaving.1]);
        previous = Some(needle);
    }
    Ok((states, slopes))
}

/// The cut path at a depth: linear from where the tip left a node to where it arrived at the next.
fn path_m(nodes_m: &[f64], before: &[TipState], newest_m: f64, depth_m: f64) -> f64 {
    let next = nodes_m.partition_point(|node_m| *node_m <= depth_m).min(before.len());
    let Some(previous_node) = next.checked_sub(1) else { return newest_m };
    let (from_m, departed_m) = (nodes_m[previous_node], before[previous_node].tip_m[1]);
    let arrived_m = before.get(next).map_or(newest_m, |state| state.tip_m[0]);
    match nodes_m.get(next) {
        Some(to_m) => departed_m + (arrived_m - departed_m) * (depth_m - from_m) / (to_m - from_m),
        None => arrived_m,
    }
}

#[cfg(test)]
mod tests {
    use super::super::insertion::grid_m;
    use super::super::{Beam, Foundation, Needle, Rig};
    use super::*;
    use crate::growth::GrowingBeam;

    fn problem(inverse_yield_m_per_n: f64, depth_m: f64) -> BeamProblem {
        let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
        let mut problem = BeamProblem::new(&rig, Foundation::uniform(60e3).expect("a modulus"), depth_m);
        (problem.law.inverse_yield_m_per_n, problem.law.yield_depth_m) = (inverse_yield_m_per_n, 0.01);
        problem
    }

    fn acting(node: usize) -> NodeLoads {
        let moved = if node > 30 { 1e-3 } else { 0.0 };
        let earlier_m = if node > 31 { 1e-3 } else { 0.0 };
        NodeLoads { load_n: [0.2; 2], guide2_m: [earlier_m, moved] }
    }

    /// Tissue that yields at a load that is never reached is the linear one; also where the needle is bent, and turned, and guide 2
    /// stands on a frame that gives.
    #[test]
    fn tissue_far_from_yielding_is_linear() {
        for (compliance_m_per_n, curvature_per_m) in [(0.0, 0.0), (0.4e-3, 0.0), (0.4e-3, 0.3)] {
            let problem =
                BeamProblem { guide2_compliance_m_per_n: compliance_m_per_n, ..problem(1e-9, 0.06) };
            let bent = |node: usize| {
                [node > 40, node > 39].map(|turned| if turned { -curvature_per_m } else { curvature_per_m })
            };
            let nodes_m = grid_m(0.06, STEP_M, &[]);
            let growth = GrowingBeam::new(&problem, nodes_m.clone(), Guide2Grip::Holding).expect("grows");
            let linear = growth.bent_under_load(acting, bent);
            let expected = growth.bent_tip_slopes(&linear, |node| acting(node).guide2_m, bent);
            let (states, slopes) =
                under_load(&problem, &nodes_m, Guide2Grip::Holding, acting, bent).expect("solves");
            for (i, (a, b)) in states.iter().zip(&linear).enumerate() {
                for side in 0..2 {
                    assert!((a.tip_m[side] - b.tip_m[side]).abs() < 2e-8, "{i}: {a:?} {b:?}");
                    assert!((slopes[i][side] - expected[i][side]).abs() < 2e-6, "{i}");
                }
            }
        }
    }

    /// Statics: in every state of the tissue its reactions hold the needle in balance, and none exceeds the yield load.
    #[test]
    fn reactions_balance_and_stay_below_the_yield_load() {
        let law =
            TissueLaw { inverse_yield_m_per_n: 1.0 / 60.0, yield_depth_m: 0.01, ..TissueLaw::default() };
        let foundation = Foundation::uniform(60e3).expect("a modulus");
        let springs = Yielding { law, foundation: &foundation, reaction: &[] };
        let reaction = |depth_m: f64, stretch_m: f64| springs.reaction(&springs.place(depth_m), stretch_m);
        for (depth_m, most_n_per_m) in [(0.0, 60.0), (0.02, 60.0 * 2f64.exp())] {
            let Reaction { force_n_per_m, tangent_pa } = reaction(depth_m, 0.1);
            assert!(force_n_per_m < most_n_per_m && force_n_per_m > 0.99 * most_n_per_m);
            assert!(tangent_pa > 0.0);
            let small = reaction(depth_m, 1e-6);
            assert!((small.force_n_per_m / 0.06 - 1.0).abs() < 1e-4);
            // The tangent is the derivative.
            let [a, b] = [0.999e-3, 1.001e-3].map(|m| reaction(depth_m, m).force_n_per_m);
            let tangent = reaction(depth_m, 1e-3).tangent_pa;
            assert!(((b - a) / 2e-6 / tangent - 1.0).abs() < 1e-5);
        }
        let (hard, soft) = (solved(&problem(0.0, 0.03)), solved(&problem(1.0 / 60.0, 0.03)));
        let linear = Beam::solve(
            &Rig::two_guides(Needle::gauge_18(), 0.06, 0.07),
            &Foundation::uniform(60e3).expect("a modulus"),
            0.03,
        );
        assert!((hard.guide2_force_n / linear.expect("solves").force_n(2e-3) - 1.0).abs() < 1e-4);
        assert!(soft.guide2_force_n < 0.95 * hard.guide2_force_n && soft.guide2_force_n > 0.0);
    }

    /// The needle gives further into tissue that yields, and less force holds it.
    fn solved(problem: &BeamProblem) -> Deformed {
        let springs =
            Yielding { law: problem.law, foundation: &problem.foundation, reaction: &problem.reaction };
        let held_guide = Guide2::Held(2e-3);
        Elements::new(problem, 0.5e-3)
            .expect("cut")
            .solve(&springs, |_| 0.0, held_guide, 0.0)
            .expect("solves")
    }

    /// Half the step makes a difference of a few parts in a thousand, after a jump of 3 mm in tissue that yields at 50 N/m.
    #[test]
    fn a_yielding_path_does_not_depend_on_the_step() {
        let problem = problem(1.0 / 50.0, 0.05);
        let tip_m = |step_m: f64| {
            let nodes_m = grid_m(0.05, step_m, &[0.03]);
            let acting = |node: usize| {
                let depth_m: f64 = nodes_m[node];
                NodeLoads { load_n: [0.2; 2], guide2_m: [guide2_m(depth_m), guide2_m(depth_m + 1e-9)] }
            };
            let (states, _) =
                under_load(&problem, &nodes_m, Guide2Grip::Holding, acting, |_| [0.0; 2]).expect("solves");
            states.last().map_or(f64::NAN, |state| state.tip_m[1])
        };
        let (coarse, fine) = (tip_m(1e-3), tip_m(0.5e-3));
        assert!((coarse - fine).abs() < 5e-3 * fine.abs(), "{coarse} {fine}");
    }

    fn guide2_m(m: f64) -> f64 {
        if m > 0.03 { 3e-3 } else { 0.0 }
    }
}
