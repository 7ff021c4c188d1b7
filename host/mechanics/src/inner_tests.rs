use super::*;
use crate::growth::{GrowingBeam, Guide2Grip, NodeLoads};
use crate::{Foundation, Needle, Rig};
use nalgebra::{DMatrix, DVector};

const ALL: [Inner; 5] = [
    Inner::Guide2Force,
    Inner::MomentAtGuide1,
    Inner::MomentAtGuide2,
    Inner::MomentAtSurface,
    Inner::MomentInTissue(4),
];

fn problem(modulus_pa: f64, depth_m: f64) -> BeamProblem {
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.08);
    BeamProblem::new(&rig, Foundation::uniform(modulus_pa).expect("a tissue"), depth_m)
}

fn evenly(depth_m: f64, count: usize) -> Vec<f64> {
    (0..=count).map(|i| depth_m * i as f64 / count as f64).collect()
}

/// Clamped at guide 1, held at guide 2, free beyond: the force is `3 EI g/l^3`, the moment at guide 1 `3 EI g/l^2`; a load P at
/// the overhang makes
/// `P a` at guide 2 and half of it, with the other sign, at guide 1.
#[test]
fn in_air_all_are_those_of_the_closed_form() {
    let problem = problem(1e-6, 0.05);
    let held_needle = HeldNeedle::new(&problem, &evenly(0.05, 10)).expect("a needle");
    let quantities = held_needle.at(10, &ALL).expect("solved");
    let (ei, l, gap, depth) = (problem.bending_stiffness_n_m2, 0.06, 0.02, 0.05);
    let overhang = gap + depth;
    let expected: [[f64; 2]; 5] = [
        [3.0 * ei / (l * l * l), -(1.5 * overhang / l + 1.0)],
        [3.0 * ei / (l * l), -0.5 * overhang],
        [0.0, overhang],
        [0.0, depth],
        [0.0, depth - 4.0 * 0.005],
    ];
    for (quantities, [guide2, load]) in quantities.iter().zip(expected) {
        assert!(
            (quantities.guide2 - guide2).abs() < 1e-5 * guide2.abs().max(1.0),
            "{quantities:?}, expected {guide2}"
        );
        assert!(
            (quantities.load - load).abs() < 1e-5 * load.abs().max(0.01),
            "{quantities:?}, expected {load}"
        );
        assert!(quantities.path.iter().flatten().all(|weight| weight.abs() < 1e-6));
    }
}

/// A needle that is long in its tissue is a beam on an elastic foundation without end (Hetényi, Beams on Elastic Foundation,
/// 1946, section 11):
/// `w = e^(-bx) (A cos bx + B sin bx)` with `b = (k/4EI)^(1/4)`, joined to the gap and to the span between the guides.
#[test]
fn a_needle_deep_in_tissue_is_a_beam_on_an_endless_foundation() {
    let k = 4e4;
    let problem = problem(k, 0.3);
    let nodes = evenly(0.3, 120);
    let quantities = HeldNeedle::new(&problem, &nodes).expect("a needle").at(120, &ALL).expect("solved");
    let (ei, l, a) = (problem.bending_stiffness_n_m2, 0.06, 0.02);
    let b = (k / (4.0 * ei)).powf(0.25);
    // Per metre of guide 2. Unknown: slope and moment at guide 2, A, B. At the surface the deflection is A, the slope b (B - A),
    // the
    // moment m B, the shear v (A + B).
    let (m, v) = (-2.0 * ei * b * b, 2.0 * ei * b.powi(3));
    #[rustfmt::skip]
    let matrix = DMatrix::from_row_slice(4, 4, &[
        4.0 * ei / l, -1.0, 0.0, 0.0,
        a, a * a / (3.0 * ei), -1.0, a * a * m / (6.0 * ei),
        1.0, a / (2.0 * ei), b, a * m / (2.0 * ei) - b,
        0.0, -1.0, -a * v, m - a * v,
    ]);
    let right = DVector::from_column_slice(&[6.0 * ei / (l * l), -1.0, 0.0, 0.0]);
    let solved = matrix.lu().solve(&right).expect("solved");
    let (at_guide2, at_surface) = (solved[1], m * solved[3]);
    assert!((quantities[2].guide2 / at_guide2 - 1.0).abs() < 2e-3, "{} {at_guide2}", quantities[2].guide2);
    assert!((quantities[3].guide2 / at_surface - 1.0).abs() < 2e-3, "{} {at_surface}", quantities[3].guide2);
}

/// The same beam in finite differences, with the springs at rest on a path, by a dense matrix: nothing of it is shared with the
/// elements.
#[test]
fn with_a_path_all_are_those_of_a_beam_in_finite_differences() {
    let (k, depth_m) = (2.5e4, 0.05);
    let problem = BeamProblem { skin_n_per_m: 200.0, ..problem(k, depth_m) };
    let nodes = evenly(depth_m, 20);
    let held_needle = HeldNeedle::new(&problem, &nodes).expect("a needle");
    let beam = GrowingBeam::new(&problem, nodes.clone(), Guide2Grip::Holding).expect("a beam");
    let load_n = 0.25;
    let states = beam.under_load(|node| NodeLoads { load_n: [load_n; 2], guide2_m: guide_m(node) });
    let quantities: Vec<f64> = held_needle
        .at(20, &ALL)
        .expect("solved")
        .iter()
        .map(|inner| inner.load * load_n + inner.guide2 * 2e-3 + inner.of_path(&states))
        .collect();
    // Nodes every half millimetre.
    let h = 0.5e-3;
    let (guide2, entry, tip) = (120, 160, 260);
    let size = tip + 1;
    let (mut matrix, mut right) = (DMatrix::<f64>::zeros(size, size), DVector::<f64>::zeros(size));
    let s = problem.bending_stiffness_n_m2 / (h * h * h);
    for m in 1..tip {
        for (i, x) in [1.0, -2.0, 1.0].into_iter().enumerate() {
            for (j, y) in [1.0, -2.0, 1.0].into_iter().enumerate() {
                matrix[(m - 1 + i, m - 1 + j)] += s * x * y;
            }
        }
    }
    // Clamped: its image before guide 1 is the node after it.
    matrix[(1, 1)] += 2.0 * s;
    for z in entry..=tip {
        let mut stiff = k * h * if z == entry || z == tip { 0.5 } else { 1.0 };
        if z == entry {
            stiff += 200.0;
        }
        matrix[(z, z)] += stiff;
        right[z] += stiff * path_m(z, entry, h, &states);
    }
    right[tip] += load_n;
    let holding = 1e9;
    matrix[(0, 0)] += holding;
    matrix[(guide2, guide2)] += holding;
    right[guide2] += holding * 2e-3;
    let u = matrix.lu().solve(&right).expect("solved");
    let expected: [f64; 5] = [
        holding * (2e-3 - u[guide2]),
        problem.bending_stiffness_n_m2 * 2.0 * u[1] / (h * h),
        moment(guide2, &u, h, problem.bending_stiffness_n_m2),
        moment(entry, &u, h, problem.bending_stiffness_n_m2),
        moment(entry + 20, &u, h, problem.bending_stiffness_n_m2),
    ];
    for (quantities, expected) in quantities.iter().zip(expected) {
        // A moment that is nearly zero is one part in a hundred of the largest.
        assert!((quantities - expected).abs() < 0.01 * expected.abs().max(0.01), "{quantities} {expected}");
    }
    assert!(
        (u[tip] / states[20].tip_m[1] - 1.0).abs() < 5e-3,
        "the same needle: {} {:?}",
        u[tip],
        states[20]
    );
}

fn moment(z: usize, u: &DVector<f64>, h: f64, bending_stiffness_n_m2: f64) -> f64 {
    bending_stiffness_n_m2 * (u[z - 1] - 2.0 * u[z] + u[z + 1]) / (h * h)
}

fn path_m(z: usize, entry: usize, h: f64, states: &[TipState]) -> f64 {
    let node_position = (z - entry) as f64 * h / 2.5e-3;
    let first_node = (node_position.floor() as usize).min(19);
    let fraction = node_position - first_node as f64;
    states[first_node].tip_m[1] * (1.0 - fraction) + states[first_node + 1].tip_m[0] * fraction
}

fn guide_m(node: usize) -> [f64; 2] {
    if node < 8 {
        [0.0; 2]
    } else if node == 8 {
        [0.0, 2e-3]
    } else {
        [2e-3; 2]
    }
}

#[test]
fn the_tissue_is_compressed_by_what_the_needle_leaves_its_path() {
    let nodes = evenly(0.05, 20);
    let held_needle = HeldNeedle::new(&problem(2.5e4, 0.05), &nodes).expect("a needle");
    let [surface, deeper] =
        [0, 6].map(|node| held_needle.at(20, &[Inner::Compression(node)]).expect("solved").remove(0));
    // A path that is where the needle is pushed to: nothing is compressed.
    let straight: Vec<TipState> = nodes
        .iter()
        .map(|m| TipState { tip_m: [1e-3 * (1.0 + 1.5 * (0.02 + m) / 0.06); 2], load_n: [0.0; 2] })
        .collect();
    for inner in [&surface, &deeper] {
        let compression_m = inner.guide2 * 1e-3 + inner.of_path(&straight);
        assert!(compression_m.abs() < 1e-8, "{compression_m}");
    }
    assert!(surface.guide2 > deeper.guide2 && deeper.guide2 > 0.0);
}
