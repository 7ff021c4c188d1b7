//! The continuum solution against line-of-point-forces solutions of a full and a half space, and against itself.

use super::*;

fn solve(depth_m: f64, poisson: f64, resolution: Resolution, full_space: bool) -> Continuum {
    let needle = Needle::gauge_18();
    Continuum::in_body(&needle, depth_m, poisson, Contact::Bonded, resolution, full_space).expect("solves")
}

#[track_caller]
fn assert_close(value: f64, expected: f64, relative: f64) {
    assert!((value / expected - 1.0).abs() < relative, "{value} is not {expected} within {relative}");
}

/// Depth, Poisson's ratio, K/E of a rigid needle in a full space (Kelvin) and in a half space (Mindlin).
const RIGID: [(f64, f64, f64, f64); 4] = [
    (0.02, 0.45, 1.1649178064002168, 0.9347142758432666),
    (0.04, 0.5, 0.990017835911549, 0.8113110257454564),
    (0.1, 0.45, 0.778746055716579, 0.6678533244217549),
    (0.14, 0.5, 0.7573516250141903, 0.648005896055505),
];

#[test]
fn rigid_needles_agree_with_point_force_solutions() {
    for (depth_m, poisson, full_space, half_space) in RIGID {
        let full = solve(depth_m, poisson, Resolution::DEFAULT, true).rigid_ratio();
        let half = solve(depth_m, poisson, Resolution::DEFAULT, false).rigid_ratio();
        println!("{depth_m} {poisson}: {full:.4} {full_space:.4} {half:.4} {half_space:.4}");
        assert_close(full, full_space, 0.02);
        assert_close(half, half_space, 0.02);
    }
}

/// `K = (4 pi / 3) E / (ln(L/D) + 0.839)` for a long cylinder in an incompressible full space, from the drag of one.
#[test]
fn long_rigid_cylinders_agree_with_the_drag_in_a_viscous_fluid() {
    let ratio = solve(0.1, 0.5, Resolution::DEFAULT, true).rigid_ratio();
    let expected = 4.0 / 3.0 * std::f64::consts::PI / ((0.1f64 / 1.27e-3).ln() + 0.839);
    assert_close(ratio, expected, 0.02);
}

#[test]
fn halving_the_mesh_changes_less_than_a_percent_and_nothing_locks() {
    let coarse = solve(0.03, 0.499, Resolution::DEFAULT, false).rigid_ratio();
    let fine = solve(0.03, 0.499, Resolution::DEFAULT.halved(), false).rigid_ratio();
    assert_close(coarse, fine, 0.01);
    let incompressible = solve(0.03, 0.5, Resolution::DEFAULT, false).rigid_ratio();
    assert_close(coarse, incompressible, 0.01);
    let far = Resolution { reach: 600.0, ..Resolution::DEFAULT };
    assert_close(coarse, solve(0.03, 0.499, far, false).rigid_ratio(), 0.01);
}

/// Young's modulus, depth, K/E of the flexible needle from a line of point forces, coupled to the needle.
const FLEXIBLE: [(f64, f64, f64); 6] = [
    (5e3, 0.02, 0.9816625406503625),
    (5e3, 0.1, 0.6716680229927066),
    (16e3, 0.03, 0.8669260509154347),
    (16e3, 0.14, 0.7103631285917956),
    (30e3, 0.04, 0.7826187918283394),
    (30e3, 0.1, 0.7495653256035734),
];

/// The reference's ratio is that of the springs with the same stiffness at guide 2: force alone has the say.
#[test]
fn flexible_needles_agree_with_the_reference() {
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
    let force_only = Run { force_sd_n: 1e-4, displacement_sd_m: 1e-7, shape_sd_m: 1.0, ..Run::default() };
    for (youngs_pa, depth_m, expected) in FLEXIBLE {
        let body = solve(depth_m, 0.5, Resolution::DEFAULT, false);
        let modulus_pa = body.foundation_modulus_pa(&rig, youngs_pa, &force_only).expect("a modulus");
        println!("{youngs_pa} {depth_m}: {:.4} {expected:.4}", modulus_pa / youngs_pa);
        assert_close(modulus_pa / youngs_pa, expected, 0.02);
    }
}

#[test]
fn the_stiffness_is_symmetric_and_one_sided_contact_is_softer() {
    let body = solve(0.03, 0.5, Resolution::DEFAULT, false);
    let matrix = &body.wall.matrix_m;
    let largest = matrix.amax();
    assert!((matrix - matrix.transpose()).amax() < 1e-6 * largest);
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
    let one_sided = Continuum { contact: Contact::OneSided, ..body.clone() };
    let (bonded, touched) = (
        body.foundation_modulus_pa(&rig, 16e3, &Run::default()).expect("a modulus"),
        one_sided.foundation_modulus_pa(&rig, 16e3, &Run::default()).expect("a modulus"),
    );
    assert!((0.62..0.72).contains(&(touched / bonded)), "{touched} {bonded}");
}

/// Beyond its range K/E would be that of the needle alone, or of elements as long as it is deep.
#[test]
fn the_relation_is_refused_where_it_is_not_computed() {
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
    let body = solve(0.01, 0.5, Resolution::DEFAULT, false);
    for youngs_pa in [1e-6, 99.0, 1.1e6] {
        match body.foundation_modulus_pa(&rig, youngs_pa, &Run::default()) {
            Err(FitError::Model(ModelError::OutOfRange { name, expected, .. })) => {
                assert_eq!((name, &expected[..11]), ("youngs_modulus_kpa", "0.1 to 1000"));
            }
            other => panic!("{other:?}"),
        }
    }
    for (depth_m, poisson) in [(0.005, 0.5), (0.5, 0.5), (0.03, 0.51)] {
        let needle = Needle::gauge_18();
        let refused = Continuum::solve(&needle, depth_m, poisson, Contact::Bonded, Resolution::DEFAULT);
        assert!(matches!(refused, Err(ModelError::OutOfRange { .. })), "{depth_m} {poisson}");
    }
}

/// A lateral test in the continuum, on a finer mesh, further and at other points than the relation is made for, gives back Young's
/// modulus: at the ends of the table's range and within.
#[test]
fn a_test_in_the_continuum_gives_its_modulus_back() {
    let made_for = Run::default();
    for (outer_mm, inner_mm, depth_m, poisson, youngs_pa) in [
        (0.51, 0.26, 0.01, 0.45, 5e3),
        (1.47, 1.07, 0.01, 0.5, 50e3),
        (1.27, 1.0, 0.04, 0.45, 16e3),
        (0.51, 0.26, 0.14, 0.5, 50e3),
    ] {
        let needle = Needle {
            outer_diameter_m: 1e-3 * outer_mm,
            inner_diameter_m: 1e-3 * inner_mm,
            ..Needle::gauge_18()
        };
        let rig = Rig::two_guides(needle.clone(), 0.06, 0.07);
        let solve = |resolution| Continuum::solve(&needle, depth_m, poisson, Contact::Bonded, resolution);
        let finer = Resolution { first: 0.4, growth: 1.4, ..Resolution::DEFAULT };
        let body = solve(finer).expect("solves");
        let relation = solve(Resolution::DEFAULT).expect("solves");
        for run in [
            Run { force_sd_n: 0.1, ..made_for },
            Run { force_sd_n: 0.02, displacement_sd_m: 10e-6, shape_sd_m: 25e-6, ..made_for },
        ] {
            let test = Run { spacing_m: 0.8e-3, displacement_m: 1.5e-3, ..run };
            let modulus_pa = body.foundation_modulus_pa(&rig, youngs_pa, &test).expect("a modulus");
            let found_pa = relation.youngs_modulus_pa(&rig, modulus_pa, &run).expect("a modulus");
            println!("{outer_mm} {depth_m}: {poisson} {found_pa:.0} of {youngs_pa:.0} Pa");
            assert_close(found_pa, youngs_pa, 0.05);
        }
    }
}

/// An only guide in front of a body that hardly gives: the needle between two clamps where its rear does not turn, and a cantilever where it
/// turns freely.
#[test]
fn one_guide_in_front_of_a_hard_body_is_a_beam_by_hand() {
    use crate::model::Guides;
    let body = solve(0.02, 0.5, Resolution::DEFAULT, false);
    let needle = Needle::gauge_18();
    let gap_m = 0.03;
    for (rear, factor) in [(None, 12.0), (Some(1e-4), 3.0)] {
        let guides = Guides::One { rear_rotation_n_m_per_rad: [rear; 2] };
        let rig = Rig { needle: needle.clone(), guide2_m: 0.0, entry_m: gap_m, guides };
        let stiffness = body.lateral_stiffness_n_per_m(&rig, 1e12).expect("solves");
        assert_close(stiffness, factor * needle.bending_stiffness_n_m2() / gap_m.powi(3), 0.12);
    }
}
