//! Paths and loads of the reference: step-free solutions of the Volterra equation by collocation.

use super::*;

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
        let (guide2_m, held_slopes) = match guide2 {
            Some((guide2_m, slope)) => (guide2_m, Some([ramp(slope), Profile::default()])),
            None => (0.5 * entry_m, None),
        };
        let mut model = model(modulus_pa, guide2_m, entry_m);
        model.tip = TipLaw::load([0.2, 0.0]);
        let insertion =
            Insertion { depth_m: DEPTHS_M.to_vec(), guide2_m: held_slopes, ..Insertion::default() };
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
        let growth = GrowingBeam::new(&problem, grid_m(0.14, DEFAULT_STEP_M, &[0.07]), grip).expect("grows");
        let states = growth.at_cut_angle(
            |node| [cut_angle(node, false, &growth, turn_m), cut_angle(node, true, &growth, turn_m)],
            |_| 0.0,
        );
        let path_value = |depth_m: f64| {
            let node = growth.depths_m().partition_point(|m| *m < depth_m - 1e-9);
            states[node].load_n[0]
        };
        assert_within_spread(&DEPTHS_M.map(path_value), &load_n);
    }
}

fn cut_angle(node: usize, after: bool, growth: &GrowingBeam, turn_m: Option<f64>) -> f64 {
    match turn_m {
        Some(m) if growth.depths_m()[node] > m || (after && growth.depths_m()[node] == m) => -0.02,
        _ => 0.02,
    }
}

#[test]
fn the_load_of_a_path_matches_the_reference() {
    let problem = model(10360.0, 0.02, 0.042).problem(0.05).expect("a problem");
    let growth =
        GrowingBeam::new(&problem, grid_m(0.05, DEFAULT_STEP_M, &[]), Guide2Grip::Free).expect("grows");
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
    let growth = GrowingBeam::new(&problem, grid_m(0.14, 1e-3, &[]), Guide2Grip::Free).expect("grows");
    let path_m: Vec<f64> = growth.depths_m()[..=50].iter().map(|d| 0.02 * d + 0.3 * d * d).collect();
    let load_n = growth.load_of_path_n(&path_m, &[0.0; 51]);
    let mean_n = load_n[30..=50].iter().sum::<f64>() / 21.0;
    assert!((mean_n / 0.1669126240215759 - 1.0).abs() < 1e-4, "{mean_n}");
    // The measured path, then the constant load: what the loads of the path make, and from there the mean.
    let states = growth.under_load(|node| NodeLoads {
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
