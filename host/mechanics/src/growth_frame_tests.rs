//! A guide on a frame that gives, and a needle that is bent by itself: limits and reciprocity, among springs and in a body.

use super::*;
use crate::insertion::grid_m;
use crate::{Foundation, Needle, Rig, Support};

/// A problem on springs or a body, with guide 2 on a frame that gives.
fn framed(support: Support, compliance_m_per_n: f64) -> BeamProblem {
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
    let foundation = Foundation::uniform(10360.0).expect("a modulus");
    let problem = BeamProblem::new(&rig, foundation, 0.08);
    BeamProblem { support, guide2_compliance_m_per_n: compliance_m_per_n, ..problem }
}

const SUPPORTS: [Support; 2] = [Support::Springs, Support::Body { poisson: 0.5, block: None }];

/// Guide 2 moved at rest, then over a stretch, under a load that is turned.
fn moved_and_turned(node: usize) -> NodeLoads {
    let guide2_m = |node: f64| if node < 20.0 { 0.0 } else { 1e-3 - 2e-5 * (node - 20.0) };
    let node_number = node as f64;
    let load_n = [node > 50, node >= 50].map(|turned| if turned { -0.2 } else { 0.2 });
    NodeLoads { load_n, guide2_m: [guide2_m(node_number - 0.5), guide2_m(node_number)] }
}

/// A frame that hardly gives is a rigid one, and one that gives way entirely is no guide at all.
#[test]
fn frames_lie_between_a_rigid_guide_and_none() {
    for support in SUPPORTS {
        let (rigid, free) =
            (slopes(0.0, Guide2Grip::Holding, support), slopes(0.0, Guide2Grip::Free, support));
        assert!(is_close(&slopes(1e-9, Guide2Grip::Holding, support), &rigid, 1e-5), "{support:?}");
        assert!(is_close(&slopes(1e3, Guide2Grip::Holding, support), &free, 1e-5), "{support:?}");
        let half = slopes(0.5e-3, Guide2Grip::Holding, support);
        assert!(!is_close(&half, &rigid, 0.05) && !is_close(&half, &free, 0.05), "{support:?}");
    }
}

fn is_close(a: &[f64], b: &[f64], relative: f64) -> bool {
    let size = b.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
    a.iter().zip(b).all(|(a, b)| (a - b).abs() < relative * size)
}

fn slopes(compliance_m_per_n: f64, grip: Guide2Grip, support: Support) -> Vec<f64> {
    let problem = framed(support, compliance_m_per_n);
    let growth = GrowingBeam::new(&problem, grid_m(0.08, 1e-3, &[]), grip).expect("grows");
    let states = growth.under_load(moved_and_turned);
    let slopes = growth.tip_slopes(&states, |node| moved_and_turned(node).guide2_m);
    states.iter().zip(slopes).flat_map(|(s, [a, b])| [s.tip_m[0], s.tip_m[1], a, b]).collect::<Vec<_>>()
}

/// A curvature that is the same all along the needle does to it what a moment at the tip does.
#[test]
fn a_bend_is_a_moment_at_the_tip() {
    for support in SUPPORTS {
        let problem = framed(support, 0.2e-3);
        let growth = GrowingBeam::new(&problem, grid_m(0.08, 1e-3, &[]), Guide2Grip::Holding).expect("grows");
        let unit = problem.bending_stiffness_n_m2;
        // By reciprocity a moment at the tip deflects it as a load there turns it.
        for Row { deflection, slope, .. } in &growth.rows {
            assert!((deflection.curvature / (unit * slope.load) - 1.0).abs() < 1e-9, "{support:?}");
        }
    }
}

/// A bent needle that cuts at an angle leaves a path of that slope beside its own, on a frame that gives, before and after a turn.
#[test]
fn a_bent_needle_cuts_at_its_angle() {
    let problem = framed(Support::Springs, 0.3e-3);
    let nodes_m = grid_m(0.08, 0.25e-3, &[0.04]);
    let growth = GrowingBeam::new(&problem, nodes_m.clone(), Guide2Grip::Holding).expect("grows");
    let bent = |node: usize| {
        [nodes_m[node] > 0.04, nodes_m[node] >= 0.04].map(|turned| if turned { -0.4 } else { 0.4 })
    };
    let states = growth.bent_at_cut_angle(|_| [0.02; 2], |_| 0.5e-3, bent);
    let slopes = growth.bent_tip_slopes(&states, |_| [0.5e-3; 2], bent);
    for node in (1..nodes_m.len()).step_by(7) {
        let step_m = nodes_m[node] - nodes_m[node - 1];
        let path = (states[node].tip_m[0] - states[node - 1].tip_m[1]) / step_m;
        let needle = 0.5 * (slopes[node][0] + slopes[node - 1][1]);
        assert!((path - needle - 0.02).abs() < 1e-9, "{node}: {path} {needle}");
    }
    let straight = growth.at_cut_angle(|_| [0.02; 2], |_| 0.5e-3);
    let last = nodes_m.len() - 1;
    assert!((states[last].tip_m[0] - straight[last].tip_m[0]).abs() > 0.2e-3);
}

/// A shear layer in a body gives every element of the path a weight of its own; one of no stiffness does what moments of the path do.
#[test]
fn moments_of_the_path_are_sums_over_its_elements() {
    let body = Support::half_space(0.5);
    let plain = BeamProblem { skin_n_per_m: 400.0, ..framed(body, 0.2e-3) };
    let sheared = BeamProblem { shear_n: 1e-12, ..plain.clone() };
    let nodes_m = grid_m(0.08, 1e-3, &[]);
    let [moments, elements] = [plain, sheared].map(|problem| {
        let growth = GrowingBeam::new(&problem, nodes_m.clone(), Guide2Grip::Holding).expect("grows");
        let states = growth.under_load(growing_loads);
        (growth.tip_slopes(&states, |node| growing_loads(node).guide2_m), states)
    });
    for node in 1..nodes_m.len() {
        let [a, b] = [&moments, &elements].map(|(slopes, states)| (slopes[node][0], states[node].tip_m[0]));
        assert!(is_same(a.0, b.0) && is_same(a.1, b.1), "{node}: {a:?} {b:?}");
    }
}

fn is_same(a: f64, b: f64) -> bool {
    (a / b - 1.0).abs() < 1e-7
}

fn growing_loads(node: usize) -> NodeLoads {
    NodeLoads { load_n: [0.2; 2], guide2_m: [1e-4 * node as f64 / 80.0; 2] }
}
