//! Against closed forms and invariants; against step-free reference solutions in [`reference`].

use super::*;
use crate::insertion::grid_m;
use crate::{
    Cutting, Experiment, Foundation, Insertion, Layer, Model, Needle, Profile, Rig, TipLaw, predict,
};

#[path = "growth_tests/reference.rs"]
mod reference;

/// Depths of the reference values.
const DEPTHS_M: [f64; 8] = [0.01, 0.03, 0.05, 0.07, 0.08, 0.1, 0.12, 0.14];

fn model(modulus_pa: f64, guide2_m: f64, entry_m: f64) -> Model {
    Model::uniform(Rig::two_guides(Needle::gauge_18(), guide2_m, entry_m), modulus_pa).expect("a model")
}

fn tip(model: &Model, insertion: Insertion) -> Vec<f64> {
    predict(model, &Experiment::Insertion(insertion)).expect("predicts").tip_m.y
}

fn ramp(slope: f64) -> Profile {
    Profile::new(vec![[0.0, 0.0], [1.0, slope]]).expect("a profile")
}

/// The agreement required of a step-based solution: one part in ten thousand of the largest value.
#[track_caller]
fn assert_within_spread(path: &[f64], expected: &[f64]) {
    let spread = 1e-4 * expected.iter().fold(0.0, |most: f64, u| most.max(u.abs()));
    for (u, expected) in path.iter().zip(expected) {
        assert!((u - expected).abs() < spread, "{u} is not {expected} within {spread:e}");
    }
}

/// Far from the surface the path of a constant load has constant curvature, and that of a cut angle a constant load.
#[test]
fn the_steady_state_matches_the_reference() {
    for (modulus_pa, curvature_per_n, load_per_rad) in [
        (5000.0, 3.7878107153928804, 8.866274123023146),
        (10360.0, 3.1571181177747656, 12.762508078765324),
        (16000.0, 2.8320490683797113, 15.860473316981668),
    ] {
        let problem = model(modulus_pa, 0.02, 0.042).problem(0.6).expect("a problem");
        let growth = GrowingBeam::new(&problem, grid_m(0.6, 1e-3, &[]), Guide2Grip::Free).expect("grows");
        let states = growth.under_load(|_| NodeLoads { load_n: [1.0; 2], guide2_m: [0.0; 2] });
        let [a, b, c] = [560, 580, 600].map(|node: usize| states[node].tip_m[0]);
        let curvature = (a - 2.0 * b + c) / (0.02 * 0.02);
        assert!((curvature / curvature_per_n - 1.0).abs() < 1e-3, "{curvature} is not {curvature_per_n}");
        let states = growth.at_cut_angle(|_| [1.0; 2], |_| 0.0);
        let load = states[600].load_n[0];
        assert!((load / load_per_rad - 1.0).abs() < 1e-3, "{load} is not {load_per_rad}");
    }
}

/// Without springs the tip of a beam under a load is that of a cantilever, on any path.
#[test]
fn without_tissue_it_is_a_cantilever() {
    let mut model = model(0.0, 0.02, 0.042);
    model.tip = TipLaw::load([0.1, -0.05]);
    let insertion = Insertion { depth_m: vec![0.0, 0.0315, 0.1], ..Insertion::default() };
    let tip_m = predict(&model, &Experiment::Insertion(insertion)).expect("predicts").tip_m;
    for (i, d) in [0.0, 0.0315, 0.1].into_iter().enumerate() {
        assert!((tip_m.y[i] / (0.1 * cantilever_m_per_n(d, &model.rig.needle)) - 1.0).abs() < 1e-6);
        assert!(
            (tip_m.x.as_ref().expect("two planes")[i] / (-0.05 * cantilever_m_per_n(d, &model.rig.needle))
                - 1.0)
                .abs()
                < 1e-6
        );
    }
}

fn cantilever_m_per_n(d: f64, needle: &Needle) -> f64 {
    (0.042 + d).powi(3) / (3.0 * needle.bending_stiffness_n_m2())
}

/// Halving the step divides the error by four, with a jump and a layer off the grid too.
#[test]
fn the_step_is_of_second_order() {
    let layers = vec![Layer { bottom_m: 0.0317, modulus_pa: 6e3 }];
    let foundation = Foundation::layered(layers, 25e3).expect("layers");
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
    let problem = BeamProblem::new(&rig, foundation, 0.1);
    let [coarse, middle, fine] = [4e-3, 2e-3, 1e-3].map(|step_m| {
        let growth =
            GrowingBeam::new(&problem, grid_m(0.1, step_m, &[0.04321]), Guide2Grip::Holding).expect("grows");
        let nodes_m = growth.depths_m().to_vec();
        let states = growth.under_load(|node| {
            let load_n =
                [turned_curvature(nodes_m[node] > 0.04321), turned_curvature(nodes_m[node] >= 0.04321)];
            NodeLoads { load_n, guide2_m: [1e-3 * nodes_m[node] / 0.1; 2] }
        });
        states.last().expect("nodes").tip_m[0]
    });
    let ratio = (coarse - middle) / (middle - fine);
    assert!((3.0..5.5).contains(&ratio), "{ratio}");
}

fn turned_curvature(turned: bool) -> f64 {
    if turned { -0.2 } else { 0.2 }
}

/// Any rotation of load and guide together rotates the path.
#[test]
fn both_planes_turn_together() {
    let mut model = model(12e3, 0.06, 0.075);
    let rotation = Profile::new(vec![[0.0, 0.3], [0.03, 0.3], [0.03, 2.0], [0.06, 2.5]]).expect("a profile");
    let mut path = |load_n: [f64; 2], guide_m: [f64; 2]| {
        model.tip = TipLaw::load(load_n);
        let insertion = Insertion {
            depth_m: vec![0.02, 0.05, 0.09],
            rotation_rad: rotation.clone(),
            guide2_m: Some(guide_m.map(|m| Profile::new(vec![[0.0, 0.0], [0.04, m]]).expect("a profile"))),
            ..Insertion::default()
        };
        predict(&model, &Experiment::Insertion(insertion)).expect("predicts").tip_m
    };
    let plain = path([0.2, 0.05], [1e-3, -2e-3]);
    let rotated = path([-0.05, 0.2], [2e-3, 1e-3]);
    for i in 0..3 {
        let (y, x) = (plain.y[i], plain.x.as_ref().expect("two planes")[i]);
        assert!(
            (rotated.y[i] + x).abs() < 1e-15
                && (rotated.x.as_ref().expect("two planes")[i] - y).abs() < 1e-15
        );
    }
}

#[test]
fn impossible_insertions_are_refused() {
    let rig = Rig::two_guides(Needle::gauge_18(), 0.07, 0.07);
    let touching = Model::uniform(rig, 1e4).expect("a model");
    let with_guide2 =
        Insertion { depth_m: vec![0.01], guide2_m: Some(Default::default()), ..Insertion::default() };
    assert!(predict(&touching, &Experiment::Insertion(with_guide2)).is_err());
    let negative = Insertion { depth_m: vec![-0.01], ..Insertion::default() };
    assert!(predict(&model(1e4, 0.06, 0.07), &Experiment::Insertion(negative)).is_err());
    assert!(Profile::new(vec![[0.1, 0.0], [0.0, 0.0]]).is_err());
    assert!(Profile::new(vec![[0.0, f64::NAN]]).is_err());
}

/// A quantity that jumps at a depth is evaluated at a node that is that depth to the last bit.
#[test]
fn grids_hold_their_fixed_depths() {
    for depth_m in [0.03, 0.041, 0.043_21, 0.07] {
        let nodes_m = grid_m(0.1, 1e-3, &[depth_m]);
        assert!(nodes_m.contains(&depth_m) && nodes_m.contains(&0.1));
        assert!(nodes_m.windows(2).all(|pair| pair[1] > pair[0] && pair[1] - pair[0] < 1.0001e-3));
    }
}

/// Jumps a micrometre or a nanometre apart, as recorded depths at rest have them, are solved; the tip is where it is when they are
/// one jump.
#[test]
fn steps_of_micrometres_are_no_singular_equations() {
    let mut model = model(10360.0, 0.06, 0.07);
    model.tip = TipLaw::load([0.2, 0.0]);
    let at_once = insertion_by([0.0; 3], &model);
    for offsets_m in [
        [0.0, 1e-9, 2e-9],
        [0.0, 1e-7, 1e-6],
        [0.0, 1e-6, 5e-6],
        [0.0, 1e-5, 3.9e-5],
        [0.0, 0.0, 4.1e-5],
        [0.0, 4.1e-5, 4.1e-5],
    ] {
        // Moving one jump of 0.5 mm by 0.04 mm moves the tip by 1.6 micrometres.
        for (tip_m, expected_m) in insertion_by(offsets_m, &model).iter().zip(&at_once) {
            assert!((tip_m - expected_m).abs() < 5e-6, "{tip_m} is not {expected_m} with {offsets_m:?}");
        }
    }
}

fn insertion_by(offsets_m: [f64; 3], model: &Model) -> Vec<f64> {
    let mut knots = vec![[0.0, 0.0]];
    let mut guide_m = 0.0;
    for offset_m in offsets_m {
        let guide_depth_m = 0.05 + offset_m;
        knots.push([guide_depth_m, guide_m]);
        guide_m += 0.5e-3;
        knots.push([guide_depth_m, guide_m]);
    }
    let guide2_m = Some([Profile::new(knots).expect("a profile"), Profile::default()]);
    let insertion = Insertion { depth_m: DEPTHS_M.to_vec(), guide2_m, ..Insertion::default() };
    tip(model, insertion)
}

/// The slope that is reported is the difference of the needle's deflection from that of a rigid extension of the tip: by reciprocity a
/// moment at the tip does to the tip's position what a force there does to its slope.
#[test]
fn slopes_are_those_of_the_needle() {
    let model = model(10360.0, 0.06, 0.07);
    let problem = model.problem(0.08).expect("a problem");
    let nodes_m = grid_m(0.08, 0.25e-3, &[]);
    let growth = GrowingBeam::new(&problem, nodes_m.clone(), Guide2Grip::Holding).expect("grows");
    // Straight tissue that was never cut: the path is 0 but for the newest node, and the needle that of the beam on its foundation.
    let states: Vec<TipState> = nodes_m.iter().map(|_| TipState::default()).collect();
    let last = nodes_m.len() - 1;
    let guide_m = 1e-3;
    let slopes = growth.tip_slopes(&states, |_| [guide_m; 2]);
    let beam = problem.solve().expect("solves");
    let expected = beam.guide2_force().slope(0.07 + 0.08) * beam.force_n(guide_m);
    // In `states` the tip stays at 0, so that the last spring rests there too: the same as a foundation at rest at 0.
    assert!(
        (slopes[last][0] - expected).abs() < 1e-4 * expected.abs().max(1e-4),
        "{} {expected}",
        slopes[last][0]
    );
    // Half the displacement on leaving, half the slope.
    let halved = growth.tip_slopes(&states, |_| [guide_m, 0.5 * guide_m]);
    assert!((halved[last][1] - 0.5 * slopes[last][1]).abs() < 1e-12);
    let without_slopes = GrowingBeam::without_slopes(&problem, nodes_m, Guide2Grip::Holding).expect("grows");
    assert!(without_slopes.tip_slopes(&states, |_| [guide_m; 2])[last][0].is_nan());
}

/// A needle that cuts straight ahead of itself measures the slope of its own path, and an angle of entry is part of both.
#[test]
fn the_direction_of_a_needle_that_cuts_straight_is_the_slope_of_its_path() {
    let mut model = model(10360.0, 0.06, 0.07);
    let angle_rad = 0.03;
    model.tip = TipLaw {
        cutting: Cutting::Angle([angle_rad, 0.0]),
        entry_angle_rad: [0.01, -0.02],
        ..TipLaw::default()
    };
    let h_m = 0.5e-3;
    let insertion = Insertion {
        depth_m: vec![0.06 - h_m, 0.06, 0.06 + h_m],
        guide2_m: Some(Default::default()),
        tip_direction: true,
        ..Insertion::default()
    };
    let channels = predict(&model, &Experiment::Insertion(insertion.clone())).expect("predicts");
    let (tip_x, direction_x) =
        (channels.tip_m.x.expect("two planes"), channels.tip_direction_rad.x.expect("two planes"));
    let y = path_slope(&channels.tip_m.y, h_m) - mean_direction(&channels.tip_direction_rad.y);
    assert!((y - angle_rad).abs() < 1e-6, "{y}");
    assert!((path_slope(&tip_x, h_m) - mean_direction(&direction_x)).abs() < 1e-12);
    assert!((direction_x[0] - (-0.02f64).tan()).abs() < 1e-12);
    // Not requested, not computed.
    let insertion = Insertion { tip_direction: false, ..insertion };
    let channels = predict(&model, &Experiment::Insertion(insertion)).expect("predicts");
    assert!(channels.tip_direction_rad.y.is_empty());
}

fn mean_direction(rad: &[f64]) -> f64 {
    0.25 * rad[0] + 0.5 * rad[1] + 0.25 * rad[2]
}

fn path_slope(m: &[f64], h_m: f64) -> f64 {
    (m[2] - m[0]) / (2.0 * h_m)
}
