//! Against the reference (a Volterra equation solved by collocation), closed forms, and invariants.

use super::*;
use crate::model::insertion::grid_m;
use crate::model::{
    Cutting, Experiment, Foundation, Insertion, Layer, Model, Needle, Profile, Rig, TipLaw, predict,
};

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

/// The agreement asked of a step-based solution: one part in ten thousand of the largest value.
#[track_caller]
fn assert_within_spread(path: &[f64], expected: &[f64]) {
    let spread = 1e-4 * expected.iter().fold(0.0, |most: f64, u| most.max(u.abs()));
    for (u, expected) in path.iter().zip(expected) {
        assert!((u - expected).abs() < spread, "{u} is not {expected} within {spread:e}");
    }
}

/// K, entry, guide 2 with its slope where it holds the needle; tip under 0.2 N.
type Case = (f64, f64, Option<(f64, f64)>, [f64; 8]);

const CONSTANT_LOAD: [Case; 6] = [
    (
        10360.0,
        0.042,
        None,
        [
            0.0005817785988550155,
            0.001343305455307108,
            0.0023447275513247714,
            0.003568821172216439,
            0.004268464132831544,
            0.005851766867044365,
            0.007686640451185873,
            0.009775385898663063,
        ],
    ),
    (
        16000.0,
        0.07,
        None,
        [
            0.0020305469556577875,
            0.003182922032917296,
            0.0045127126786907905,
            0.006072067849450667,
            0.006940333909670709,
            0.008851159079261442,
            0.010990504070345068,
            0.013356284993726559,
        ],
    ),
    (
        5000.0,
        0.02,
        None,
        [
            0.00011414263345625203,
            0.0005125408328537784,
            0.0012983990432805243,
            0.0024381597770230723,
            0.0031188787949728153,
            0.004683113077751679,
            0.006520610360539221,
            0.008644613447069887,
        ],
    ),
    (
        10360.0,
        0.07,
        Some((0.06, 0.0)),
        [
            0.00010956798017770746,
            0.0005377566483325645,
            0.0012967586780219227,
            0.002302669955577643,
            0.002887467395058683,
            0.0042271172176169495,
            0.0058073237713090285,
            0.007638295678198378,
        ],
    ),
    (
        12610.0,
        0.09,
        Some((0.06, 0.0)),
        [
            0.0005597903261282235,
            0.0013233745934988614,
            0.0023026990803734176,
            0.00348925645003779,
            0.004166288672627135,
            0.005697196567407374,
            0.007469064193871589,
            0.00948298490369816,
        ],
    ),
    (
        10360.0,
        0.07,
        Some((0.06, 0.05)),
        [
            0.0008478084304912523,
            0.003156780077573823,
            0.005506780918799995,
            0.007268689423043582,
            0.00793691706122049,
            0.009009302712678578,
            0.009942150899032831,
            0.010936183940329358,
        ],
    ),
];

#[test]
fn constant_load_matches_the_reference() {
    for (modulus_pa, entry_m, guide2, expected) in CONSTANT_LOAD {
        let (guide2_m, held) = match guide2 {
            Some((guide2_m, slope)) => (guide2_m, Some([ramp(slope), Profile::default()])),
            None => (0.5 * entry_m, None),
        };
        let mut model = model(modulus_pa, guide2_m, entry_m);
        model.tip = TipLaw::load([0.2, 0.0]);
        let insertion = Insertion { depth_m: DEPTHS_M.to_vec(), guide2_m: held, ..Insertion::default() };
        assert_within_spread(&tip(&model, insertion), &expected);
    }
}

#[test]
fn a_turned_needle_matches_the_reference() {
    let mut model = model(10360.0, 0.02, 0.042);
    model.tip = TipLaw::load([0.2, 0.0]);
    let half_turn = vec![[0.07, 0.0], [0.07, std::f64::consts::PI]];
    let mut depth_m = DEPTHS_M.to_vec();
    depth_m.push(0.07 + 1e-9);
    let insertion = Insertion {
        depth_m,
        rotation_rad: Profile::new(half_turn).expect("a profile"),
        ..Insertion::default()
    };
    let expected = [
        0.0005817785988550155,
        0.001343305455307108,
        0.0023447275513247714,
        0.003568821172216439,
        0.002073532932077765,
        0.0019605723425240537,
        0.0015960409030416468,
        0.0009776376002235587,
        0.002038004820363318,
    ];
    assert_within_spread(&tip(&model, insertion), &expected);
}

/// K, entry, whether guide 2 (at 60 mm) holds, depth of a half turn; path and tip load for a cut angle of 0.02 rad.
type CutCase = (f64, f64, bool, Option<f64>, [f64; 8], [f64; 8]);

const CUT_ANGLE: [CutCase; 3] = [
    (
        10360.0,
        0.042,
        false,
        None,
        [
            0.00023451272978672422,
            0.00089771483527811,
            0.0018127120869136717,
            0.0029917588300376104,
            0.003686651626919672,
            0.005298750827079473,
            0.007217801828421019,
            0.009451063135096995,
        ],
        [
            0.08616497740492407,
            0.1548319028665932,
            0.18913436126504904,
            0.2133036186933528,
            0.2225300398206269,
            0.2357886357021492,
            0.2435819482336152,
            0.247967881926333,
        ],
    ),
    (
        12610.0,
        0.09,
        true,
        None,
        [
            0.00023780882892859525,
            0.0009178469948554472,
            0.0018570003801425252,
            0.0030698865659326753,
            0.003786723951362803,
            0.005454472185121644,
            0.007445481908053148,
            0.009766915387028513,
        ],
        [
            0.09137814063061009,
            0.16345688651464876,
            0.20356662538138504,
            0.23317724926816397,
            0.24432656283282833,
            0.25985050442686897,
            0.26860832483751856,
            0.27346338097977047,
        ],
    ),
    (
        10360.0,
        0.042,
        false,
        Some(0.07),
        [
            0.00023451272978548913,
            0.0008977148352761572,
            0.0018127120869110907,
            0.0029917588300341696,
            0.003244663338519468,
            0.003679811315770594,
            0.003956923580809028,
            0.004020431976422429,
        ],
        [
            0.08616497740451015,
            0.15483190286635287,
            0.18913436126492014,
            0.2133036186932644,
            0.1276193680578728,
            -0.0004915100740167074,
            -0.08603391913342372,
            -0.14266594571714836,
        ],
    ),
];

#[test]
fn a_cut_angle_matches_the_reference() {
    for (modulus_pa, entry_m, held, turn_m, tip_m, load_n) in CUT_ANGLE {
        let mut model = model(modulus_pa, if held { 0.06 } else { 0.02 }, entry_m);
        model.tip.cutting = Cutting::Angle([0.02, 0.0]);
        let knots = turn_m.map(|m| vec![[m, 0.0], [m, std::f64::consts::PI]]).unwrap_or_default();
        let insertion = Insertion {
            depth_m: DEPTHS_M.to_vec(),
            rotation_rad: Profile::new(knots).expect("a profile"),
            guide2_m: held.then(Default::default),
            ..Insertion::default()
        };
        assert_within_spread(&tip(&model, insertion), &tip_m);

        let problem = model.problem(0.14).expect("a problem");
        let grip = if held { Guide2Grip::Holding } else { Guide2Grip::Free };
        let growth = Growth::new(&problem, grid_m(0.14, DEFAULT_STEP_M, &[0.07]), grip).expect("grows");
        let sign = |node: usize, after: bool| match turn_m {
            Some(m) if growth.depths_m()[node] > m || (after && growth.depths_m()[node] == m) => -0.02,
            _ => 0.02,
        };
        let states = growth.at_cut_angle(|node| [sign(node, false), sign(node, true)], |_| 0.0);
        let at = |depth_m: f64| {
            let node = growth.depths_m().partition_point(|m| *m < depth_m - 1e-9);
            states[node].load_n[0]
        };
        assert_within_spread(&DEPTHS_M.map(at), &load_n);
    }
}

#[test]
fn the_load_of_a_path_matches_the_reference() {
    let problem = model(10360.0, 0.02, 0.042).problem(0.05).expect("a problem");
    let growth = Growth::new(&problem, grid_m(0.05, DEFAULT_STEP_M, &[]), Guide2Grip::Free).expect("grows");
    let path_m: Vec<f64> = growth.depths_m().iter().map(|d| 0.02 * d + 0.3 * d * d).collect();
    let load_n = growth.load_of_path_n(&path_m, &vec![0.0; path_m.len()]);
    for (depth_m, expected_n) in
        [(0.01, 0.08445814653208568), (0.03, 0.14970324809431185), (0.05, 0.1818376742830118)]
    {
        let node = growth.depths_m().partition_point(|m| *m < depth_m - 1e-9);
        assert!((load_n[node] / expected_n - 1.0).abs() < 5e-5, "{} is not {expected_n}", load_n[node]);
    }
}

/// Published procedure: tip load of the measured path averaged from 30 to 50 mm, then carried on.
#[test]
fn the_published_prediction_matches_the_reference() {
    let problem = model(10360.0, 0.02, 0.042).problem(0.14).expect("a problem");
    let growth = Growth::new(&problem, grid_m(0.14, 1e-3, &[]), Guide2Grip::Free).expect("grows");
    let path_m: Vec<f64> = growth.depths_m()[..=50].iter().map(|d| 0.02 * d + 0.3 * d * d).collect();
    let load_n = growth.load_of_path_n(&path_m, &[0.0; 51]);
    let mean_n = load_n[30..=50].iter().sum::<f64>() / 21.0;
    assert!((mean_n / 0.1669126240215759 - 1.0).abs() < 1e-4, "{mean_n}");
    // The measured path, then the constant load: what the loads of the path make, and from there the mean.
    let states = growth.under_load(|node| Acting {
        load_n: [load_n.get(node).copied().unwrap_or(mean_n); 2],
        guide2_m: [0.0; 2],
    });
    let expected = [
        0.002145626854963653,
        0.0031929791638106845,
        0.004443240009901648,
        0.005903467309970165,
        0.007575581147801912,
    ];
    let path = [60, 80, 100, 120, 140].map(|node: usize| states[node].tip_m[0]);
    assert_within_spread(&path, &expected);
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
        let growth = Growth::new(&problem, grid_m(0.6, 1e-3, &[]), Guide2Grip::Free).expect("grows");
        let states = growth.under_load(|_| Acting { load_n: [1.0; 2], guide2_m: [0.0; 2] });
        let [a, b, c] = [560, 580, 600].map(|node: usize| states[node].tip_m[0]);
        let curvature = (a - 2.0 * b + c) / (0.02 * 0.02);
        assert!((curvature / curvature_per_n - 1.0).abs() < 1e-3, "{curvature} is not {curvature_per_n}");
        let states = growth.at_cut_angle(|_| [1.0; 2], |_| 0.0);
        let load = states[600].load_n[0];
        assert!((load / load_per_rad - 1.0).abs() < 1e-3, "{load} is not {load_per_rad}");
    }
}

/// Without springs the tip of a beam under a load is that of a cantilever, whatever path it left.
#[test]
fn without_tissue_it_is_a_cantilever() {
    let mut model = model(0.0, 0.02, 0.042);
    model.tip = TipLaw::load([0.1, -0.05]);
    let insertion = Insertion { depth_m: vec![0.0, 0.0315, 0.1], ..Insertion::default() };
    let tip_m = predict(&model, &Experiment::Insertion(insertion)).expect("predicts").tip_m;
    let per_n = |d: f64| (0.042 + d).powi(3) / (3.0 * model.rig.needle.bending_stiffness_n_m2());
    for (i, d) in [0.0, 0.0315, 0.1].into_iter().enumerate() {
        assert!((tip_m.y[i] / (0.1 * per_n(d)) - 1.0).abs() < 1e-6);
        assert!((tip_m.x.as_ref().expect("two planes")[i] / (-0.05 * per_n(d)) - 1.0).abs() < 1e-6);
    }
}

/// Halving the step divides the error by four, with a jump and a layer off the grid too.
#[test]
fn the_step_is_of_second_order() {
    let layers = vec![Layer { bottom_m: 0.0317, modulus_pa: 6e3 }];
    let foundation = Foundation::layered(layers, 25e3).expect("layers");
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
    let problem = BeamProblem::new(&rig, foundation, 0.1);
    let end = |step_m: f64| {
        let growth =
            Growth::new(&problem, grid_m(0.1, step_m, &[0.04321]), Guide2Grip::Holding).expect("grows");
        let nodes_m = growth.depths_m().to_vec();
        let states = growth.under_load(|node| {
            let sign = |turned: bool| if turned { -0.2 } else { 0.2 };
            let load_n = [sign(nodes_m[node] > 0.04321), sign(nodes_m[node] >= 0.04321)];
            Acting { load_n, guide2_m: [1e-3 * nodes_m[node] / 0.1; 2] }
        });
        states.last().expect("nodes").tip_m[0]
    };
    let [coarse, middle, fine] = [4e-3, 2e-3, 1e-3].map(end);
    let ratio = (coarse - middle) / (middle - fine);
    assert!((3.0..5.5).contains(&ratio), "{ratio}");
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
    let turned = path([-0.05, 0.2], [2e-3, 1e-3]);
    for i in 0..3 {
        let (y, x) = (plain.y[i], plain.x.as_ref().expect("two planes")[i]);
        assert!(
            (turned.y[i] + x).abs() < 1e-15 && (turned.x.as_ref().expect("two planes")[i] - y).abs() < 1e-15
        );
    }
}

#[test]
fn impossible_insertions_are_refused() {
    let rig = Rig::two_guides(Needle::gauge_18(), 0.07, 0.07);
    let touching = Model::uniform(rig, 1e4).expect("a model");
    let held = Insertion { depth_m: vec![0.01], guide2_m: Some(Default::default()), ..Insertion::default() };
    assert!(predict(&touching, &Experiment::Insertion(held)).is_err());
    let negative = Insertion { depth_m: vec![-0.01], ..Insertion::default() };
    assert!(predict(&model(1e4, 0.06, 0.07), &Experiment::Insertion(negative)).is_err());
    assert!(Profile::new(vec![[0.1, 0.0], [0.0, 0.0]]).is_err());
    assert!(Profile::new(vec![[0.0, f64::NAN]]).is_err());
}

/// What jumps at a depth is looked for at a node that is that depth to the last bit.
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
    let through = |offsets_m: [f64; 3]| {
        let mut knots = vec![[0.0, 0.0]];
        let mut held_m = 0.0;
        for offset_m in offsets_m {
            let at_m = 0.05 + offset_m;
            knots.push([at_m, held_m]);
            held_m += 0.5e-3;
            knots.push([at_m, held_m]);
        }
        let guide2_m = Some([Profile::new(knots).expect("a profile"), Profile::default()]);
        let insertion = Insertion { depth_m: DEPTHS_M.to_vec(), guide2_m, ..Insertion::default() };
        tip(&model, insertion)
    };
    let at_once = through([0.0; 3]);
    for offsets_m in [
        [0.0, 1e-9, 2e-9],
        [0.0, 1e-7, 1e-6],
        [0.0, 1e-6, 5e-6],
        [0.0, 1e-5, 3.9e-5],
        [0.0, 0.0, 4.1e-5],
        [0.0, 4.1e-5, 4.1e-5],
    ] {
        // Moving one jump of 0.5 mm by 0.04 mm moves the tip by 1.6 micrometres.
        for (tip_m, expected_m) in through(offsets_m).iter().zip(&at_once) {
            assert!((tip_m - expected_m).abs() < 5e-6, "{tip_m} is not {expected_m} with {offsets_m:?}");
        }
    }
}

/// The slope that is reported is the difference of the needle's deflection from that of a rigid extension of the tip: by reciprocity a
/// moment at the tip does to the tip's position what a force there does to its slope.
#[test]
fn slopes_are_those_of_the_needle() {
    let model = model(10360.0, 0.06, 0.07);
    let problem = model.problem(0.08).expect("a problem");
    let nodes_m = grid_m(0.08, 0.25e-3, &[]);
    let growth = Growth::new(&problem, nodes_m.clone(), Guide2Grip::Holding).expect("grows");
    // Straight tissue that was never cut: the path is 0 but for the newest node, and the needle that of the beam on its foundation.
    let states: Vec<TipState> = nodes_m.iter().map(|_| TipState::default()).collect();
    let last = nodes_m.len() - 1;
    let held_m = 1e-3;
    let slopes = growth.tip_slopes(&states, |_| [held_m; 2]);
    let beam = problem.solve().expect("solves");
    let expected = beam.guide2_force().slope(0.07 + 0.08) * beam.force_n(held_m);
    // `states` say that the tip stays at 0, so that the last spring rests there too: the same as a foundation at rest at 0.
    assert!(
        (slopes[last][0] - expected).abs() < 1e-4 * expected.abs().max(1e-4),
        "{} {expected}",
        slopes[last][0]
    );
    // Half the displacement on leaving, half the slope.
    let halved = growth.tip_slopes(&states, |_| [held_m, 0.5 * held_m]);
    assert!((halved[last][1] - 0.5 * slopes[last][1]).abs() < 1e-12);
    let without = Growth::without_slopes(&problem, nodes_m, Guide2Grip::Holding).expect("grows");
    assert!(without.tip_slopes(&states, |_| [held_m; 2])[last][0].is_nan());
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
    let path_slope = |m: &[f64]| (m[2] - m[0]) / (2.0 * h_m);
    let direction = |rad: &[f64]| 0.25 * rad[0] + 0.5 * rad[1] + 0.25 * rad[2];
    let (tip_x, direction_x) =
        (channels.tip_m.x.expect("two planes"), channels.tip_direction_rad.x.expect("two planes"));
    let y = path_slope(&channels.tip_m.y) - direction(&channels.tip_direction_rad.y);
    assert!((y - angle_rad).abs() < 1e-6, "{y}");
    assert!((path_slope(&tip_x) - direction(&direction_x)).abs() < 1e-12);
    assert!((direction_x[0] - (-0.02f64).tan()).abs() < 1e-12);
    // Not asked for, not computed.
    let insertion = Insertion { tip_direction: false, ..insertion };
    let channels = predict(&model, &Experiment::Insertion(insertion)).expect("predicts");
    assert!(channels.tip_direction_rad.y.is_empty());
}
