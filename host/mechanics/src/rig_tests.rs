//! Rigs with one guide: against statics by hand, and the three solvers against each other.

use crate::effects::effect;
use crate::elements::{Elements, Guide2};
use crate::growth::{GrowingBeam, Guide2Grip, TipState};
use crate::insertion::grid_m;
use crate::{
    BeamProblem, DriveSample, Experiment, Foundation, Guides, Insertion, Lateral, Model, ModelError, Needle,
    Plane, Profile, Rig, ShapePoint, TipLaw, predict,
};

const GAP_M: f64 = 0.028;

fn rig(stiffness_n_m_per_rad: [Option<f64>; 2]) -> Rig {
    let guides = Guides::One { rear_rotation_n_m_per_rad: stiffness_n_m_per_rad };
    Rig {
        needle: Needle::gauge_18(),
        guide2_m: 0.0,
        entry_m: GAP_M,
        guides,
        tolerances: crate::Tolerances::default(),
    }
}

fn model(stiffness_n_m_per_rad: [Option<f64>; 2]) -> Model {
    Model::uniform(rig(stiffness_n_m_per_rad), 30e3).expect("a model")
}

#[track_caller]
fn assert_close(value: f64, expected: f64, relative: f64) {
    assert!((value - expected).abs() <= relative * expected.abs(), "{value} is not {expected}");
}

/// A needle on one spring: its end gives by `F/k_s`, it bends by `F a^3/(3 EI)` and turns in its guide by `F a/k_r`.
#[test]
fn a_needle_on_one_spring_is_three_springs_in_series() {
    for stiffness in [Some(0.3), Some(3.0), None] {
        let mut problem = BeamProblem::new(&rig([stiffness; 2]), Foundation::none(), 0.02);
        problem.skin_n_per_m = 400.0;
        let ei = problem.bending_stiffness_n_m2;
        let rear_compliance = stiffness.map_or(0.0, |k| GAP_M * GAP_M / k);
        let expected_n_per_m = 1.0 / (1.0 / 400.0 + GAP_M.powi(3) / (3.0 * ei) + rear_compliance);
        let beam = problem.solve().expect("solves");
        assert_close(beam.lateral_stiffness_n_per_m(), expected_n_per_m, 1e-9);
        assert_close(beam.deflection_m(1e-3, 0.0), 1e-3, 1e-12);
        assert_close(beam.deflection_m(1e-3, GAP_M), 1e-3 * expected_n_per_m / 400.0, 1e-9);
        // The slope in the guide is that of the moment F a on its spring.
        let slope = beam.guide2_force().slope(0.0) * beam.force_n(1e-3);
        let expected = stiffness.map_or(0.0, |k| -1e-3 * expected_n_per_m * GAP_M / k);
        assert!((slope - expected).abs() < 1e-9 * expected.abs().max(1e-3), "{slope} {expected}");
    }
}

/// In tissue: the exact beam, the elements, and the needle that grows, held and under a load on the tip.
#[test]
fn three_solvers_agree_on_one_guide() {
    for stiffness in [[Some(0.2), Some(5.0)], [None, Some(1.0)]] {
        for (number, plane) in [Plane::Y, Plane::X].into_iter().enumerate() {
            let problem = model(stiffness).problem_in(plane, 0.06).expect("a problem");
            assert_close(
                1.0 + problem.clamp_compliance_rad_per_n_m,
                1.0 + stiffness[number].map_or(0.0, |k: f64| 1.0 / k),
                1e-15,
            );
            let tip_m = GAP_M + 0.06;
            let beam = problem.solve().expect("solves");
            let elements = Elements::new(&problem, 0.5e-3).expect("cut");
            let springs = &problem.foundation;
            let held_solution = elements.solve(springs, |_| 0.0, Guide2::Held(1e-3), 0.0).expect("solves");
            assert_close(held_solution.guide2_force_n, beam.force_n(1e-3), 1e-5);
            assert_close(held_solution.deflection_m(tip_m), beam.deflection_m(1e-3, tip_m), 1e-4);
            let pushed = elements.solve(springs, |_| 0.0, Guide2::Force(0.3), 0.0).expect("solves");
            assert_close(pushed.deflection_m(0.0), 0.3 * beam.guide2_force().deflection_m(0.0), 1e-5);

            let nodes_m = grid_m(0.06, 0.5e-3, &[]);
            let growth = GrowingBeam::new(&problem, nodes_m.clone(), Guide2Grip::Holding).expect("grows");
            let at_zero = vec![TipState::default(); nodes_m.len()];
            let load_n = growth.load_of_path_n(&vec![0.0; nodes_m.len()], &vec![1e-3; nodes_m.len()]);
            // The load that keeps the tip at 0 while guide 2 is at 1 mm, from the beam's two unit loads.
            let (by_guide, by_tip) = (beam.guide2_force(), beam.tip_force());
            let tip_per_n = by_tip.deflection_m(tip_m)
                - by_tip.deflection_m(0.0) * by_guide.deflection_m(tip_m) / by_guide.deflection_m(0.0);
            let last = load_n.len() - 1;
            assert_close(load_n[last], -beam.deflection_m(1e-3, tip_m) / tip_per_n, 2e-3);
            let slopes = growth.tip_slopes(&at_zero, |_| [1e-3; 2]);
            assert_close(slopes[last][0], by_guide.slope(tip_m) * beam.force_n(1e-3), 1e-3);
        }
    }
}

/// Tilting the needle in its guide tilts the path as a whole: the slope of the rear is the angle of entry. A stiffer rear lets guide 2
/// move the tip further.
#[test]
fn one_guide_goes_through_the_forward_model() {
    let depth_m = vec![0.02, 0.04, 0.06];
    let moved = Profile::new(vec![[0.0, 0.0], [0.01, 2e-3]]).expect("a profile");
    let insertion = Insertion {
        depth_m: depth_m.clone(),
        guide2_m: Some([moved.clone(), moved]),
        tip_direction: true,
        ..Insertion::default()
    };
    let channels = predicted(&model([Some(5.0), Some(0.2)]), &insertion);
    let (tip_x, direction_x) =
        (channels.tip_m.x.clone().expect("x"), channels.tip_direction_rad.x.expect("x"));
    // A rear that gives lets the tissue turn the needle back.
    assert!(tip_x[2] != channels.tip_m.y[2] && direction_x[0] < channels.tip_direction_rad.y[0]);
    let mut tilted = model([Some(5.0), Some(0.2)]);
    tilted.tip = TipLaw { entry_angle_rad: [0.02, 0.0], ..TipLaw::default() };
    let tilted = predicted(&tilted, &insertion);
    for (i, depth_m) in depth_m.iter().enumerate() {
        assert_close(tilted.tip_m.y[i] - channels.tip_m.y[i], 0.02f64.tan() * depth_m, 1e-9);
        assert_close(tilted.tip_direction_rad.y[i] - channels.tip_direction_rad.y[i], 0.02f64.tan(), 1e-9);
    }
    // A compliance on top of the rig's is one in its place.
    let mut softer = model([Some(5.0), None]);
    softer.effects.push((effect("rig.rear_rotation").expect("an effect"), vec![0.3, 5.0]));
    let softer = predicted(&softer, &insertion);
    let horizontal = predicted(&model([Some(2.0), Some(0.2)]), &insertion);
    for i in 0..3 {
        assert_close(softer.tip_m.y[i], horizontal.tip_m.y[i], 1e-9);
        assert_close(
            softer.tip_m.x.as_ref().expect("x")[i],
            horizontal.tip_m.x.as_ref().expect("x")[i],
            1e-9,
        );
    }
    // Lateral runs: both planes by their own stiffness.
    let drive = vec![DriveSample { time_s: 0.0, y_m: 1e-3, x_m: 1e-3 }];
    let shape = vec![ShapePoint::new(0.0, GAP_M + 0.02)];
    let pushed =
        Experiment::Lateral(Lateral { depth_m: 0.04, drive, shape, reversal_m: [0.0; 2], order: 0.0 });
    let channels = predict(&model([Some(5.0), Some(0.2)]), &pushed).expect("predicts");
    let beam =
        model([Some(5.0), None]).problem_in(Plane::Y, 0.04).expect("a problem").solve().expect("solves");
    assert_close(channels.force_n.y[0], beam.force_n(1e-3), 1e-9);
    assert!(channels.force_n.x.expect("x")[0] < 0.99 * channels.force_n.y[0]);
}

fn predicted(model: &Model, insertion: &Insertion) -> crate::Channels {
    predict(model, &Experiment::Insertion(insertion.clone())).expect("predicts")
}

#[test]
fn rejects_a_needle_that_nothing_holds() {
    let mut wrong = rig([None; 2]);
    wrong.guide2_m = 0.06;
    assert!(matches!(wrong.validate(), Err(ModelError::OutOfRange { name: "guide2_m", .. })));
    assert!(rig([Some(0.0), None]).validate().is_err());
    rig([Some(0.1), None]).validate().expect("valid");
    let problem = model([Some(1.0); 2]).problem(0.06).expect("a problem");
    let free = GrowingBeam::new(&problem, vec![0.0, 0.01], Guide2Grip::Free);
    assert!(matches!(free, Err(ModelError::OutOfRange { name: "guide2_m", .. })));
    // Without tissue the guide takes no force to move.
    let nowhere = BeamProblem { foundation: Foundation::none(), ..problem };
    assert_eq!(nowhere.solve().map(|_| ()), Err(ModelError::Singular));
}
