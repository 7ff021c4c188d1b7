//! Against the reference: modes, convergence, tip load of a path.

use super::*;
use crate::{Beam, Foundation, Needle, Rig};
use std::f64::consts::FRAC_1_SQRT_2;

/// Index, beta, gamma, q at 0.25, 0.5, 0.75, q'' at 0.
const MODES: [(usize, f64, f64, [f64; 3], f64); 11] = [
    (
        1,
        1.8751040687119611,
        1.3622205574851314,
        [0.09728580835371181, 0.33952311286532394, 0.6577473043008544],
        3.5160152685001513,
    ),
    (
        2,
        4.694091132974175,
        0.9818675391747299,
        [-0.41725909416732937, -0.7136658320566764, -0.13498361301278383],
        -22.03449156466677,
    ),
    (
        3,
        7.854757438237613,
        1.0007761053549773,
        [0.7244998634334694, 0.01968759482194273, -0.5814516282060165],
        61.697214413549105,
    ),
    (
        4,
        10.995540734875467,
        0.9999664478740695,
        [-0.6851592246418627, 0.707118644151964, -0.6214211203681896],
        -120.90191605230572,
    ),
    (
        5,
        14.13716839104647,
        1.0000014498934522,
        [0.2852002052620656, 0.0008514371083122935, -0.25599597614005115],
        199.85953011680346,
    ),
    (
        6,
        17.278759532088237,
        0.9999999373443755,
        [0.2639472416065267, -0.7071068033386577, 0.27724889596004226],
        -298.5555309677301,
    ),
    (
        7,
        20.42035225104125,
        1.000000002707595,
        [-0.6502484674220789, 3.679398685300058e-05, 0.6563144953191411],
        416.9907860566055,
    ),
    (
        8,
        23.561944901806445,
        0.9999999998829943,
        [0.651898677220457, 0.7071067812279154, 0.6546642877165265],
        -555.1652475557627,
    ),
    (
        12,
        36.12831551628262,
        0.9999999999999996,
        [-0.6533412393273565, 0.7071067811865477, -0.6532217255490202],
        -1305.2551820440676,
    ),
    (
        20,
        61.26105674500097,
        1.0,
        [-0.6532815940307583, FRAC_1_SQRT_2, -0.6532813708456183],
        -3752.917073514229,
    ),
    (
        50,
        155.50883635269477,
        1.0,
        [-0.2705980500730985, -FRAC_1_SQRT_2, -0.2705980500730985],
        -24182.9981837692,
    ),
];

#[test]
fn modes_match_the_reference_values() {
    for (index, beta, gamma, values, at_clamp) in MODES {
        let mode = CantileverMode::new(index);
        assert!((mode.beta() / beta - 1.0).abs() < 1e-15, "{index}: {}", mode.beta());
        assert!((mode.gamma() / gamma - 1.0).abs() < 1e-14, "{index}: {}", mode.gamma());
        for (x, value) in
            [0.0, 0.25, 0.5, 0.75, 1.0].into_iter().zip([0.0, values[0], values[1], values[2], 1.0])
        {
            assert!((mode.value(x) - value).abs() < 3e-13, "{index} at {x}: {}", mode.value(x));
        }
        assert!((mode.second_derivative(0.0) / at_clamp - 1.0).abs() < 1e-13, "{index}");
        let squared = integrate(0.0, 1.0, 1.0 / index as f64, |x| mode.value(x).powi(2));
        assert!((squared - 0.25).abs() < 1e-12, "{index}: {squared}");
    }
}

#[test]
fn overlaps_match_the_reference_values() {
    let rows = [
        [0.05209286017670886, 0.001655002466950252, -0.0026526842375040787, 0.002189121343288455],
        [0.001655002466950252, 0.0457029450044553, 0.011099424837633712, -0.009592149434752915],
        [-0.0026526842375040787, 0.011099424837633712, 0.03377441138958729, 0.017436844383213097],
        [0.002189121343288455, -0.009592149434752915, 0.017436844383213097, 0.033691066130003326],
    ];
    for (i, row) in rows.iter().enumerate() {
        for (j, expected) in row.iter().enumerate() {
            let (a, b) = (CantileverMode::new(i + 1), CantileverMode::new(j + 1));
            let overlap = integrate(0.07, 0.21, 0.02, |z| a.value(z / 0.21) * b.value(z / 0.21));
            assert!((overlap - expected).abs() < 1e-15, "{i} {j}: {overlap}");
        }
    }
}

type Row = (usize, f64, f64, f64);

/// Guide 2, entry, depth, K; then modes, relative error at guide 2 and at the tip, rms error over the largest deflection.
const CONVERGENCE: [([f64; 4], [Row; 4]); 5] = [
    (
        [0.06, 0.07, 0.02, 16e3],
        [
            (2, -0.025539849718378194, 0.015562553327663542, 0.011189697669508397),
            (8, -0.0002896396647754651, 0.00011490979902295528, 8.546048537231173e-05),
            (20, -1.758317871514148e-05, 1.7805512864121908e-06, 3.2201856121713764e-06),
            (40, -2.110753570594426e-06, -3.203052312272803e-07, 2.7165519309097686e-07),
        ],
    ),
    (
        [0.06, 0.07, 0.14, 10360.0],
        [
            (2, -0.5394774846747137, 1.4792503901971252, 0.2634976245277909),
            (4, -0.025786632201359794, 0.0478033268430198, 0.010897750821510859),
            (20, -0.0002939784384744515, -0.0002985966516090288, 7.318370479579873e-05),
            (40, -3.82750264277254e-05, -1.0299006719227677e-05, 6.5184436266248755e-06),
        ],
    ),
    (
        [0.06, 0.07, 0.04, 16e3],
        [
            (1, -0.5341746412943499, 0.57371210052813, 0.32296712518077425),
            (6, -0.0018745143975613665, 0.0007966080374386397, 0.0008075000022383917),
            (15, -9.930331597007847e-05, -1.460308035827751e-06, 2.7714467817659725e-05),
            (30, -1.3687768074310824e-05, -1.6477777833312501e-06, 2.7237639646043815e-06),
        ],
    ),
    (
        [0.03, 0.06, 0.03, 12610.0],
        [
            (1, -0.6650754101208713, 0.32124463080561005, 0.2963262165520415),
            (3, -0.010592933134706217, 0.008610052555621861, 0.004038634840638031),
            (10, -0.0006113624545519558, 6.904968243759413e-05, 0.000137882913925042),
            (40, -9.224314779454623e-06, 2.1113385617610447e-07, 1.0514417172710838e-06),
        ],
    ),
    (
        [0.09, 0.1, 0.02, 8000.0],
        [
            (1, -0.10464881893852851, 0.06766388387383349, 0.06873146711690686),
            (4, -0.0013246763423572228, -0.0005791029537989267, 0.0005046864209794182),
            (15, -3.421033959916109e-05, -4.971863487357453e-06, 8.094190689651824e-06),
            (30, -4.8330086005465844e-06, -1.1204038355971946e-06, 7.954862112062842e-07),
        ],
    ),
];

#[test]
fn convergence_is_that_of_the_reference() {
    for ([guide2_m, entry_m, depth_m, modulus_pa], rows) in CONVERGENCE {
        let rig = Rig::two_guides(Needle::gauge_18(), guide2_m, entry_m);
        let foundation = Foundation::uniform(modulus_pa).expect("a modulus");
        let exact = Beam::solve(&rig, &foundation, depth_m).expect("solves");
        let exact = exact.guide2_force();
        let length_m = entry_m + depth_m;
        let grid: Vec<f64> = (0..=100).map(|i| length_m * f64::from(i) / 100.0).collect();
        let largest = grid.iter().map(|z_m| exact.deflection_m(*z_m).abs()).fold(0.0, f64::max);
        let problem = BeamProblem::new(&rig, foundation, depth_m);
        for (modes, at_guide2, at_tip, rms) in rows {
            let ritz = RayleighRitz::solve(&problem, modes).expect("solves");
            let error = |z_m: f64| ritz.deflection_m(z_m) / exact.deflection_m(z_m) - 1.0;
            let squares = grid.iter().map(|z_m| (ritz.deflection_m(*z_m) - exact.deflection_m(*z_m)).powi(2));
            let found_rms = (squares.sum::<f64>() / grid.len() as f64).sqrt() / largest;
            assert!((error(guide2_m) - at_guide2).abs() < 1e-10, "{modes}: {}", error(guide2_m));
            assert!((error(length_m) - at_tip).abs() < 1e-9, "{modes}: {}", error(length_m));
            assert!((found_rms / rms - 1.0).abs() < 1e-5, "{modes}: {found_rms}");
        }
    }
}

#[test]
fn what_it_cannot_do_is_refused() {
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
    let mut problem = BeamProblem::new(&rig, Foundation::uniform(16e3).expect("a modulus"), 0.03);
    assert!(RayleighRitz::solve(&problem, 0).is_err());
    problem.clamp_compliance_rad_per_n_m = 0.1;
    assert!(RayleighRitz::solve(&problem, 4).is_err());
}

/// Depth; tip load of a given path with 2, 4, 8, 16 and 32 modes.
const TIP_LOADS: [(f64, [f64; 5]); 3] = [
    (
        0.01,
        [
            0.08491676930422111,
            0.08452619560163195,
            0.08446635515530782,
            0.08445919125545637,
            0.08445827635321808,
        ],
    ),
    (
        0.03,
        [
            0.15153816696778366,
            0.1499036468928402,
            0.14972997805739205,
            0.14970661554322445,
            0.14970366734572968,
        ],
    ),
    (
        0.05,
        [
            0.18623802831942463,
            0.18231218729427967,
            0.18190037281258264,
            0.18184558072280202,
            0.18183865880325004,
        ],
    ),
];

#[test]
fn the_tip_load_of_a_path_matches_the_reference() {
    let rig = Rig::two_guides(Needle::gauge_18(), 0.02, 0.042);
    for (depth_m, loads_n) in TIP_LOADS {
        let foundation = Foundation::uniform(10360.0).expect("a modulus");
        let problem = BeamProblem::new(&rig, foundation, depth_m);
        for (count, expected_n) in [2, 4, 8, 16, 32].into_iter().zip(loads_n) {
            let load_n = bordered_tip_load_n(&problem, count, |z_m| {
                0.02 * (z_m - 0.042) + 0.3 * (z_m - 0.042).powi(2)
            })
            .expect("solves");
            assert!((load_n / expected_n - 1.0).abs() < 1e-8, "{count} modes: {load_n} is not {expected_n}");
        }
    }
}
