//! Finite elements against the exact beam, the reference values, and solutions known by other means.

use super::*;
use crate::quadrature::integrate;
use crate::{Beam, Layer, Needle, Rig};

const STRAIGHT: fn(f64) -> f64 = |_| 0.0;

fn problem(guide2_m: f64, entry_m: f64, depth_m: f64, foundation: Foundation) -> BeamProblem {
    BeamProblem::new(&Rig::two_guides(Needle::gauge_18(), guide2_m, entry_m), foundation, depth_m)
}

fn uniform(modulus_pa: f64) -> Foundation {
    Foundation::uniform(modulus_pa).expect("a modulus")
}

fn solve(problem: &BeamProblem, guide2: Guide2, tip_force_n: f64) -> Deformed {
    let elements = Elements::new(problem, DEFAULT_ELEMENT_M).expect("elements");
    elements.solve(&problem.foundation, STRAIGHT, guide2, tip_force_n).expect("solves")
}

#[track_caller]
fn assert_close(value: f64, expected: f64, relative: f64) {
    assert!((value / expected - 1.0).abs() < relative, "{value} is not {expected} within {relative:e}");
}

/// Guide 2, entry, depth, K; deflection at guide 2 and tip, slope of the tip under 1 N.
const CASES: [([f64; 4], [f64; 3]); 7] = [
    ([0.06, 0.07, 0.02, 16e3], [0.001203090475020565, 0.0016671029256442277, 0.013672356655056292]),
    ([0.06, 0.07, 0.04, 16e3], [0.0008093162262611191, 0.0006087037834378356, -0.007622448073546556]),
    ([0.03, 0.06, 0.03, 12610.0], [0.00027411317904617034, 0.00041975976742087497, -0.00043712715359810813]),
    ([0.09, 0.1, 0.02, 8e3], [0.003132770310649055, 0.003994186470980872, 0.026543113247328127]),
    ([0.06, 0.07, 0.14, 10360.0], [0.000862474875612655, -0.000195523847651607, -0.005116992533072608]),
    ([0.07, 0.07, 0.03, 50e3], [0.0005291390689030399, 0.0003907003024847601, -0.006142047478304122]),
    ([0.05, 0.09, 0.03, 5e3], [0.0010705680452382366, 0.001503640454865719, 9.230606182202059e-05]),
];

#[test]
fn uniform_tissue_matches_the_reference_to_one_in_a_million() {
    for ([guide2_m, entry_m, depth_m, modulus_pa], [at_guide2_m, at_tip_m, slope]) in CASES {
        let problem = problem(guide2_m, entry_m, depth_m, uniform(modulus_pa));
        let deformed = solve(&problem, Guide2::Force(1.0), 0.0);
        assert_close(deformed.deflection_m(guide2_m), at_guide2_m, 1e-6);
        assert_close(deformed.deflection_m(entry_m + depth_m), at_tip_m, 1e-6);
        assert_close(deformed.tip_slope(), slope, 1e-6);
        let held_solution = solve(&problem, Guide2::Held(1.2e-3), 0.0);
        assert_close(held_solution.guide2_force_n, 1.2e-3 / at_guide2_m, 1e-6);
    }
}

#[test]
fn layers_clamp_and_tip_loads_match_the_reference() {
    let layers = vec![Layer { bottom_m: 0.01, modulus_pa: 0.0 }, Layer { bottom_m: 0.015, modulus_pa: 30e3 }];
    let layered = problem(0.05, 0.06, 0.04, Foundation::layered(layers, 5e3).expect("layers"));
    let deformed = solve(&layered, Guide2::Force(1.0), 0.0);
    assert_close(deformed.deflection_m(0.05), 0.0009044218353108101, 1e-6);
    assert_close(deformed.deflection_m(0.075), 0.00122771876666249, 1e-6);

    let mut compliant = problem(0.06, 0.07, 0.03, uniform(16e3));
    compliant.clamp_compliance_rad_per_n_m = 0.35;
    let deformed = solve(&compliant, Guide2::Force(1.0), 0.0);
    assert_close(deformed.deflection_m(0.06), 0.0010152508803166775, 1e-6);
    assert_close(deformed.deflection_m(0.1), 0.0010759285585691131, 1e-6);

    let pinned = problem(0.032, 0.042, 0.05, uniform(10360.0));
    let deformed = solve(&pinned, Guide2::Held(0.0), 1.0);
    assert_close(deformed.guide2_force_n, -1.4593785631371614, 1e-6);
    assert_close(deformed.deflection_m(0.092), 0.003194465851785201, 1e-6);
    assert_close(deformed.tip_slope(), 0.07768110299828729, 1e-6);
}

#[test]
fn halving_the_elements_divides_the_error_by_sixteen() {
    let problem = problem(0.064, 0.064, 0.064, uniform(100e3));
    let exact = problem.solve().expect("solves").guide2_force().deflection_m(0.064);
    let ratio = error(8e-3, &problem, exact) / error(4e-3, &problem, exact);
    assert!((12.0..20.0).contains(&ratio), "{ratio}");
}

fn error(element_m: f64, problem: &BeamProblem, exact: f64) -> f64 {
    let elements = Elements::new(problem, element_m).expect("elements");
    let deformed = elements.solve(&problem.foundation, STRAIGHT, Guide2::Force(1.0), 0.0).expect("solves");
    (deformed.deflection_m(0.064) / exact - 1.0).abs()
}

#[test]
fn graded_stiffness_is_the_limit_of_many_layers() {
    let problem = problem(0.06, 0.07, 0.04, uniform(8e3));
    let elements = Elements::new(&problem, DEFAULT_ELEMENT_M).expect("elements");
    let deformed = elements.solve(&graded_springs, STRAIGHT, Guide2::Force(1.0), 0.0).expect("solves");
    let layers = (0..399)
        .map(|i| Layer { bottom_m: 1e-4 * f64::from(i + 1), modulus_pa: layer_modulus_pa(f64::from(i)) });
    let layers = Foundation::layered(layers.collect(), layer_modulus_pa(399.0)).expect("layers");
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
    let beam = Beam::solve(&rig, &layers, 0.04).expect("solves");
    for z_m in [0.06, 0.08, 0.11] {
        assert_close(deformed.deflection_m(z_m), beam.guide2_force().deflection_m(z_m), 2e-6);
    }
}

fn layer_modulus_pa(i: f64) -> f64 {
    8e3 * (1.0 + 50.0 * 1e-3 * 0.1 * (i + 0.5))
}

fn graded_springs(depth_m: f64, stretch_m: f64) -> Reaction {
    let modulus_pa = 8e3 * (1.0 + 50.0 * depth_m);
    Reaction { force_n_per_m: modulus_pa * stretch_m, tangent_pa: modulus_pa }
}

/// A rigid translation along with its path stretches no spring; no force acts on a needle on its path.
#[test]
fn springs_at_rest_on_a_path_do_not_push() {
    let problem = problem(0.06, 0.07, 0.04, uniform(16e3));
    let elements = Elements::new(&problem, DEFAULT_ELEMENT_M).expect("elements");
    let unit = problem.solve().expect("solves");
    // Without tissue a force bends the needle to this shape; tissue cut along it adds nothing.
    let free = BeamProblem { foundation: uniform(0.0), ..problem.clone() }.solve().expect("solves");
    let path = |z_m: f64| free.guide2_force().deflection_m(z_m);
    let deformed = elements.solve(&problem.foundation, path, Guide2::Force(1.0), 0.0).expect("solves");
    assert_close(deformed.deflection_m(0.11), path(0.11), 1e-6);
    assert!(deformed.deflection_m(0.11) > 2.0 * unit.guide2_force().deflection_m(0.11));
}

/// Stiffening springs `K u (1 + (u/u0)^2)`: the work of guide 2 is the energy of needle and springs, at any load.
#[test]
fn stiffening_springs_conserve_energy() {
    let (modulus_pa, u0_m) = (16e3, 0.5e-3);
    let problem = problem(0.06, 0.07, 0.04, uniform(modulus_pa));
    let elements = Elements::new(&problem, DEFAULT_ELEMENT_M).expect("elements");
    let solved_at = |displacement_m: f64| {
        elements
            .solve(
                &|depth_m, u| stiffening_springs(depth_m, u, modulus_pa, u0_m),
                STRAIGHT,
                Guide2::Held(displacement_m),
                0.0,
            )
            .expect("solves")
    };
    let work = integrate(0.0, 2e-3, 0.5e-3, |u_m| solved_at(u_m).guide2_force_n);
    let deformed = solved_at(2e-3);
    let springs = integrate(0.07, 0.11, 1e-3, |z_m| {
        let u = deformed.deflection_m(z_m);
        modulus_pa * u * u * (0.5 + 0.25 * (u / u0_m).powi(2))
    });
    let density = |z_m: f64| 0.5 * problem.bending_stiffness_n_m2 * deformed.curvature_per_m(z_m).powi(2);
    let edges = [0.0, 0.06, 0.07, 0.11];
    let bending: f64 =
        edges.windows(2).map(|edge| integrate(edge[0], edge[1], DEFAULT_ELEMENT_M, density)).sum();
    assert_close(springs + bending, work, 1e-5);
    // Much harder than linear at this load.
    assert!(deformed.guide2_force_n > 1.2 * solve(&problem, Guide2::Held(2e-3), 0.0).guide2_force_n);
}

fn stiffening_springs(_: f64, u: f64, modulus_pa: f64, u0_m: f64) -> Reaction {
    Reaction {
        force_n_per_m: modulus_pa * u * (1.0 + (u / u0_m).powi(2)),
        tangent_pa: modulus_pa * (1.0 + 3.0 * (u / u0_m).powi(2)),
    }
}

#[test]
fn springs_that_let_go_are_an_error_or_an_answer_but_no_panic() {
    let problem = problem(0.06, 0.07, 0.04, uniform(16e3));
    let elements = Elements::new(&problem, DEFAULT_ELEMENT_M).expect("elements");
    assert!(elements.solve(&springs_without_a_force, STRAIGHT, Guide2::Force(1.0), 0.0).is_err());
    assert!(Elements::new(&problem, 0.0).is_err());
}

fn springs_without_a_force(_: f64, _: f64) -> Reaction {
    Reaction { force_n_per_m: f64::NAN, tangent_pa: f64::NAN }
}

/// Slices of the exact beam against elements that integrate the growing modulus.
#[test]
fn a_modulus_that_grows_with_depth_is_solved_alike() {
    let layers = vec![Layer { bottom_m: 0.012, modulus_pa: 8e3 }];
    let foundation = Foundation::layered(layers, 14e3).expect("layers").graded(25.0).expect("a gradient");
    assert!((foundation.modulus_pa(0.02) / (14e3 * 1.5) - 1.0).abs() < 1e-12);
    let graded = problem(0.06, 0.07, 0.04, foundation);
    let beam = graded.solve().expect("solves");
    let deformed = solve(&graded, Guide2::Force(1.0), 0.0);
    for z_m in [0.06, 0.075, 0.09, 0.11] {
        assert_close(deformed.deflection_m(z_m), beam.guide2_force().deflection_m(z_m), 2e-5);
    }
}

/// Axial load, shear layer, skin, gap and soft clamp together: the exact beam and the elements agree.
#[test]
fn every_linear_term_agrees_with_the_exact_beam() {
    let foundation = Foundation::layered(vec![Layer { bottom_m: 0.012, modulus_pa: 12e3 }], 30e3)
        .and_then(|layers| layers.with_gap(3e-3))
        .expect("layers");
    let mut problem = problem(0.06, 0.07, 0.04, foundation);
    problem.clamp_compliance_rad_per_n_m = 0.2;
    (problem.axial_load_n, problem.shear_n, problem.skin_n_per_m) = (1.5, 0.8, 400.0);
    (problem.guide2_turn_n_m_per_rad, problem.tip_support_n_per_m) = (0.7, 300.0);
    let beam = problem.solve().expect("solves");
    let elements = Elements::new(&problem, DEFAULT_ELEMENT_M).expect("elements");
    let bent = elements.solve(&problem.foundation, |_| 0.0, Guide2::Held(1e-3), 0.0).expect("solves");
    assert!((bent.guide2_force_n / beam.force_n(1e-3) - 1.0).abs() < 1e-6);
    for z_m in [0.03, 0.065, 0.075, 0.09, 0.11] {
        assert!((bent.deflection_m(z_m) - beam.deflection_m(1e-3, z_m)).abs() < 1e-9, "{z_m}");
    }
    let tip = elements.solve(&problem.foundation, |_| 0.0, Guide2::Force(0.0), 0.1).expect("solves");
    assert!((tip.deflection_m(0.11) - 0.1 * beam.tip_force().deflection_m(0.11)).abs() < 1e-9);
}
