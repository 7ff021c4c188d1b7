//! The needle in a body against direct finite-element solutions, and the laws that hold for every body.

use super::*;
use crate::continuum::operator::direct;
use crate::growth::{GrowingBeam, Guide2Grip, NodeLoads};
use crate::{BeamProblem, Layer, Model, Needle, Rig};

/// Fineness of direct solutions that are compared to a per cent: they are off by less than a tenth of one.
const COARSE: f64 = 0.6;

fn rig() -> Rig {
    Rig::two_guides(Needle::gauge_18(), 0.06, 0.07)
}

fn problem(foundation: Foundation, poisson: f64, depth_m: f64) -> BeamProblem {
    BeamProblem { support: Support::half_space(poisson), ..BeamProblem::new(&rig(), foundation, depth_m) }
}

/// Stiffness per unit of depth by the tables.
fn tabulated(foundation: &Foundation, poisson: f64, depth_m: f64) -> Matrix {
    let support = Support::half_space(poisson);
    let stiffness_table =
        stiffness(foundation, support, Give::NONE, 0.635e-3, [0.0, depth_m]).expect("a stiffness");
    stiffness_table.map(|row| row.map(|value| value / depth_m))
}

/// Between the nodes of the table, in depth and in Poisson's ratio, on a finer mesh than the table's.
#[test]
fn the_table_is_the_direct_solution() {
    let (depth, poisson) = (12.0, 0.43);
    let expected = direct(depth, poisson, |_| 1.0, &[], 1.3).expect("solves");
    let tabulated_stiffness =
        tabulated(&Foundation::uniform(1.0).expect("a modulus"), poisson, depth * 0.635e-3);
    // Patterns that a needle takes: to a part in a thousand; the others are worth less the stiffer the needle is against them.
    for i in 0..3 {
        for j in 0..=i {
            let scale = (expected[(i, i)] * expected[(j, j)]).sqrt();
            assert!(
                (tabulated_stiffness[i][j] - expected[(i, j)]).abs() < 1e-3 * scale,
                "{i} {j}: {} {}",
                tabulated_stiffness[i][j],
                expected[(i, j)]
            );
        }
    }
}

/// A body of two layers, the boundary of which is at no face of a slice.
#[test]
fn layers_agree_with_the_direct_solution() {
    let depth = 20.0;
    for (boundary, ratio) in [(0.45, 3.0), (0.7, 0.4)] {
        let modulus = |z: f64| if z < boundary * depth { 1.0 } else { ratio };
        let expected = direct(depth, 0.5, modulus, &[boundary * depth], COARSE).expect("solves");
        let layer = Layer { bottom_m: boundary * depth * 0.635e-3, modulus_pa: 1.0 };
        let foundation = Foundation::layered(vec![layer], ratio).expect("layers");
        let tabulated_stiffness = tabulated(&foundation, 0.5, depth * 0.635e-3);
        for i in 0..2 {
            let relative_error = tabulated_stiffness[i][i] / expected[(i, i)] - 1.0;
            assert!((-0.01..0.03).contains(&relative_error), "{boundary} {ratio} {i}: {relative_error}");
        }
    }
}

/// Moduli that change in proportion to depth, to 60 mm or a tenth.
#[test]
fn gradients_agree_with_the_direct_solution() {
    let depth = 20.0;
    for at_tip in [1.8, 0.4] {
        let slope = (at_tip - 1.0) / depth;
        let ends = 60.0 / 0.635;
        let expected =
            direct(depth, 0.5, |z| (1.0 + slope * z.min(ends)).max(0.1), &[ends], COARSE).expect("solves");
        let foundation = Foundation::uniform(1.0).expect("a modulus").graded(slope / 0.635e-3);
        let tabulated_stiffness = tabulated(&foundation.expect("a gradient"), 0.5, depth * 0.635e-3);
        for i in 0..2 {
            let relative_error = tabulated_stiffness[i][i] / expected[(i, i)] - 1.0;
            assert!((-0.01..0.02).contains(&relative_error), "{at_tip} {i}: {relative_error}");
        }
    }
}

/// Depth and lateral stiffness in N/m of the needle of the examples at E 20 kPa, Poisson's ratio one half: a dense Python prototype of
/// the finite elements and the beam, without table and interpolation.
const STIFFNESS: [(f64, f64); 1] = [(0.02, 930.9846)];

#[test]
fn lateral_stiffness_agrees_with_a_solution_without_tables() {
    for (depth_m, expected) in STIFFNESS {
        let beam = Model::body(rig(), 20e3, 0.5).expect("a model").beam(depth_m).expect("solves");
        let beam_stiffness = beam.lateral_stiffness_n_per_m();
        assert!((beam_stiffness / expected - 1.0).abs() < 5e-4, "{depth_m}: {beam_stiffness} {expected}");
    }
}

#[test]
fn deflection_and_slope_are_continuous_and_forces_reciprocal() {
    let model = Model::body(rig(), 30e3, 0.45).expect("a model");
    let mut problem = model.problem(0.05).expect("a problem");
    (problem.axial_load_n, problem.skin_n_per_m, problem.shear_n) = (0.8, 300.0, 1.5);
    problem.clamp_compliance_rad_per_n_m = 0.05;
    let beam = problem.solve().expect("solves");
    let unit = beam.guide2_force();
    for z_m in [0.06, 0.07] {
        assert!((unit.slope(z_m - 1e-9) / unit.slope(z_m + 1e-9) - 1.0).abs() < 1e-6);
        assert!((unit.deflection_m(z_m - 1e-12) / unit.deflection_m(z_m) - 1.0).abs() < 1e-9);
    }
    let tip_deflection_m = unit.deflection_m(beam.length_m());
    assert!((beam.tip_force().deflection_m(0.06) / tip_deflection_m - 1.0).abs() < 1e-9);
}

/// A body without stiffness is none, for any table: the cantilever with a load at guide 2.
#[test]
fn a_soft_body_leaves_the_cantilever() {
    let problem = problem(Foundation::uniform(1e-6).expect("a modulus"), 0.5, 0.03);
    let stiffness = problem.solve().expect("solves").lateral_stiffness_n_per_m();
    let expected = 3.0 * problem.bending_stiffness_n_m2 / 0.06f64.powi(3);
    assert!((stiffness / expected - 1.0).abs() < 1e-6, "{stiffness} {expected}");
}

/// A cantilever whose tip a spring holds, and one that guide 2 does not let turn: `u_a = F a^3/3EI` less what spring and moment take off, both
/// by the deflection and the rotation that they meet. Of springs and of a body, neither of which has any stiffness.
#[test]
fn a_held_tip_and_a_guide_that_resists_turning_are_springs() {
    let soft = Foundation::uniform(1e-6).expect("a modulus");
    let body = problem(soft, 0.5, 0.03);
    let springs = BeamProblem { support: Support::Springs, ..body.clone() };
    let (a_m, length_m, stiffness) = (0.06_f64, body.entry_m + body.depth_m, body.bending_stiffness_n_m2);
    let (spring, turn) = (200.0, 0.8);
    let free_m = a_m.powi(3) / (3.0 * stiffness);
    let across_m = a_m * a_m * (3.0 * length_m - a_m) / (6.0 * stiffness);
    let tip_m = length_m.powi(3) / (3.0 * stiffness);
    let held_m = free_m - across_m * across_m / (1.0 / spring + tip_m);
    let slope = a_m * a_m / (2.0 * stiffness);
    let stiff_m = free_m - slope * slope / (1.0 / turn + a_m / stiffness);
    for of in [body, springs] {
        let held = BeamProblem { tip_support_n_per_m: spring, ..of.clone() };
        let stiff = BeamProblem { guide2_turn_n_m_per_rad: turn, ..of };
        for (problem, expected_m) in [(held, held_m), (stiff, stiff_m)] {
            let compliance = 1.0 / problem.solve().expect("solves").lateral_stiffness_n_per_m();
            assert!((compliance / expected_m - 1.0).abs() < 1e-5, "{compliance} {expected_m}");
        }
    }
}

/// Above its gap there is no body: as one whose surface lies deeper.
#[test]
fn a_gap_lowers_the_surface() {
    let gap = Foundation::uniform(20e3).expect("a modulus").with_gap(5e-3).expect("a gap");
    let with_gap = problem(gap, 0.5, 0.04).solve().expect("solves");
    let lower = Rig::two_guides(Needle::gauge_18(), 0.06, 0.075);
    let deeper = Model::body(lower, 20e3, 0.5).expect("a model").beam(0.035).expect("solves");
    let [a, b] = [&with_gap, &deeper].map(|beam| beam.lateral_stiffness_n_per_m());
    assert!((a / b - 1.0).abs() < 1e-9, "{a} {b}");
}

/// The force falls with the gap without a jump, and as it does beyond short gaps: the slope of a line through them.
#[test]
fn the_smallest_gaps_change_the_force_in_proportion() {
    for depth_m in [0.02, 0.05] {
        let (without_gap, short_m) = (stiffness_with_gap(0.0, depth_m), 0.019 * depth_m);
        let slope_per_m = (without_gap - stiffness_with_gap(short_m, depth_m)) / short_m;
        assert!(slope_per_m > 0.0);
        for gap_m in [1e-9, 1e-7, 3e-6, 1e-5, 1e-4] {
            let fallen = without_gap - stiffness_with_gap(gap_m, depth_m);
            assert!(
                (fallen - slope_per_m * gap_m).abs() < 0.05 * slope_per_m * gap_m + 1e-9 * without_gap,
                "{gap_m}: {fallen}"
            );
        }
        // A piece of its own instead of a part of the polynomial makes no difference.
        let neighbouring =
            [0.0199, 0.0201].map(|share| stiffness_with_gap(share * depth_m / (1.0 + share), depth_m));
        let fallen = neighbouring[0] - neighbouring[1];
        assert!((fallen / (slope_per_m * 0.0002 * depth_m) - 1.0).abs() < 0.3, "{neighbouring:?}");
    }
}

fn stiffness_with_gap(gap_m: f64, depth_m: f64) -> f64 {
    let gap = Foundation::uniform(20e3).expect("a modulus").with_gap(gap_m).expect("a gap");
    problem(gap, 0.495, depth_m).solve().expect("solves").lateral_stiffness_n_per_m()
}

/// The tip of a needle that lies on its own path has no reason to move, and halving the steps changes little.
#[test]
fn insertions_converge_with_the_step() {
    let problem = problem(Foundation::uniform(20e3).expect("a modulus"), 0.5, 0.08);
    let [coarse, fine] = [tip_with_steps(80, &problem), tip_with_steps(160, &problem)];
    assert!((coarse / fine - 1.0).abs() < 1e-3, "{coarse} {fine}");
}

fn tip_with_steps(steps: usize, problem: &BeamProblem) -> f64 {
    let depths = (0..=steps).map(|i| 0.08 * i as f64 / steps as f64).collect();
    let growth = GrowingBeam::new(problem, depths, Guide2Grip::Holding).expect("grows");
    let loaded = growth.under_load(|_| NodeLoads { load_n: [0.2; 2], guide2_m: [0.0; 2] });
    let still = growth.under_load(|_| NodeLoads::default());
    assert!(still.iter().all(|state| state.tip_m == [0.0; 2]));
    loaded[steps].tip_m[0]
}

/// Values beyond the tables are refused, with the reason.
#[test]
fn what_is_not_tabulated_is_refused() {
    assert_eq!(refused_quantity(two_layers(20e3), 0.5, 0.03), "modulus below over modulus above");
    assert_eq!(refused_quantity(two_layers(2e3), 0.1, 0.03), "poisson");
    assert_eq!(refused_quantity(two_layers(2e3), 0.5, 0.45), "depth over needle radius");
    assert_eq!(refused_quantity(Foundation::uniform(1e3).expect("a modulus"), 0.6, 0.03), "poisson");
}

fn refused_quantity(foundation: Foundation, poisson: f64, depth_m: f64) -> &'static str {
    match problem(foundation, poisson, depth_m).solve() {
        Err(ModelError::OutOfRange { name, .. }) => name,
        other => panic!("{other:?}"),
    }
}

fn two_layers(below_pa: f64) -> Foundation {
    let layer = Layer { bottom_m: 0.01, modulus_pa: 1e3 };
    Foundation::layered(vec![layer], below_pa).expect("layers")
}
