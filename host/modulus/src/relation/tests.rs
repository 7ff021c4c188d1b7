//! The relation against line-of-point-forces solutions, and against itself.

use super::*;
use mechanics::continuum::{Contact, Resolution};
use mechanics::{ModelError, Needle};

/// Elements of twice the length of the default ones, a tenth of the work: good to one per cent.
const DOUBLE: Resolution = Resolution { first: 1.25, growth: 2.25, ..Resolution::DEFAULT };

fn solve(depth_m: f64, poisson: f64) -> Continuum {
    Continuum::solve(&Needle::gauge_18(), depth_m, poisson, Contact::Bonded, DOUBLE).expect("solves")
}

#[track_caller]
fn assert_close(value: f64, expected: f64, relative: f64) {
    assert!((value / expected - 1.0).abs() < relative, "{value} is not {expected} within {relative}");
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

/// The reference's ratio is that of the springs with the same stiffness at guide 2: force alone decides.
#[test]
fn flexible_needles_agree_with_the_reference() {
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
    let force_only = Run { force_sd_n: 1e-4, displacement_sd_m: 1e-7, shape_sd_m: 1.0, ..Run::default() };
    for (youngs_pa, depth_m, expected) in FLEXIBLE {
        let body = solve(depth_m, 0.5);
        let modulus_pa = foundation_modulus_pa(&body, &rig, youngs_pa, &force_only).expect("a modulus");
        println!("{youngs_pa} {depth_m}: {:.4} {expected:.4}", modulus_pa / youngs_pa);
        assert_close(modulus_pa / youngs_pa, expected, 0.02);
    }
}

#[test]
fn one_sided_contact_is_softer() {
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
    let body = solve(0.03, 0.5);
    let (bonded, touched) =
        (foundation_pa(&body, &rig), foundation_pa(&body.with_contact(Contact::OneSided), &rig));
    assert!((0.62..0.72).contains(&(touched / bonded)), "{touched} {bonded}");
}

fn foundation_pa(body: &Continuum, rig: &Rig) -> f64 {
    foundation_modulus_pa(body, rig, 16e3, &Run::default()).expect("a modulus")
}

/// Beyond its range K/E would be that of the needle alone.
#[test]
fn youngs_moduli_outside_its_range_are_refused() {
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
    let body = solve(0.01, 0.5);
    for youngs_pa in [1e-6, 99.0, 1.1e6] {
        match foundation_modulus_pa(&body, &rig, youngs_pa, &Run::default()) {
            Err(FitError::Model(ModelError::OutOfRange { name, expected, .. })) => {
                assert_eq!((name, &expected[..11]), ("youngs_modulus_kpa", "0.1 to 1000"));
            }
            other => panic!("{other:?}"),
        }
    }
}

/// A lateral test in the continuum, on a finer mesh, further and at other points than the relation is made for, gives back Young's
/// modulus: at the ends of the table's range and within.
fn gives_back(relation_of: Resolution, finer: Resolution) {
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
        let body = solved(finer, &needle, depth_m, poisson).expect("solves");
        let relation = solved(relation_of, &needle, depth_m, poisson).expect("solves");
        for run in [
            Run { force_sd_n: 0.1, ..made_for },
            Run { force_sd_n: 0.02, displacement_sd_m: 10e-6, shape_sd_m: 25e-6, ..made_for },
        ] {
            let test = Run { spacing_m: 0.8e-3, displacement_m: 1.5e-3, ..run };
            let modulus_pa = foundation_modulus_pa(&body, &rig, youngs_pa, &test).expect("a modulus");
            let recovered_pa = youngs_modulus_pa(&relation, &rig, modulus_pa, &run).expect("a modulus");
            println!("{outer_mm} {depth_m}: {poisson} {recovered_pa:.0} of {youngs_pa:.0} Pa");
            assert_close(recovered_pa, youngs_pa, 0.05);
        }
    }
}

fn solved(
    resolution: Resolution,
    needle: &Needle,
    depth_m: f64,
    poisson: f64,
) -> Result<Continuum, ModelError> {
    Continuum::solve(needle, depth_m, poisson, Contact::Bonded, resolution)
}

#[test]
fn a_test_in_the_continuum_gives_its_modulus_back() {
    gives_back(DOUBLE, Resolution { first: 1.0, growth: 2.0, ..Resolution::DEFAULT });
}

#[test]
#[ignore = "study in small: cargo xtask test --all runs it"]
fn a_test_in_the_continuum_gives_its_modulus_back_on_the_mesh_of_the_table() {
    gives_back(Resolution::DEFAULT, Resolution { first: 0.4, growth: 1.4, ..Resolution::DEFAULT });
}
