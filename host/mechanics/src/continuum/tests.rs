//! The continuum solution against line-of-point-forces solutions of a full and a half space, and against itself.

use super::*;

/// Elements of twice the length of the default ones, a tenth of the work: good to one per cent.
const DOUBLE: Resolution = Resolution { first: 1.25, growth: 2.25, reach: 200.0 };

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
        let full = solve(depth_m, poisson, DOUBLE, true).rigid_ratio().expect("a ratio");
        let half = solve(depth_m, poisson, DOUBLE, false).rigid_ratio().expect("a ratio");
        println!("{depth_m} {poisson}: {full:.4} {full_space:.4} {half:.4} {half_space:.4}");
        assert_close(full, full_space, 0.015);
        assert_close(half, half_space, 0.015);
    }
}

/// `K = (4 pi / 3) E / (ln(L/D) + 0.839)` for a long cylinder in an incompressible full space, from the drag of one.
#[test]
fn long_rigid_cylinders_agree_with_the_drag_in_a_viscous_fluid() {
    let ratio = solve(0.1, 0.5, DOUBLE, true).rigid_ratio().expect("a ratio");
    let expected = 4.0 / 3.0 * std::f64::consts::PI / ((0.1f64 / 1.27e-3).ln() + 0.839);
    assert_close(ratio, expected, 0.02);
}

#[test]
fn halving_the_mesh_changes_less_than_a_percent_and_nothing_locks() {
    assert_eq!(DOUBLE.halved(), Resolution::DEFAULT);
    let coarse = solve(0.03, 0.499, DOUBLE, false).rigid_ratio().expect("a ratio");
    let fine = solve(0.03, 0.499, Resolution::DEFAULT, false).rigid_ratio().expect("a ratio");
    // The error falls at least with the square of the length: the finer elements have at most a third of the difference.
    assert_close(coarse, fine, 0.006);
    let incompressible = solve(0.03, 0.5, DOUBLE, false).rigid_ratio().expect("a ratio");
    assert_close(coarse, incompressible, 0.002);
    let far_boundary = Resolution { reach: 600.0, ..DOUBLE };
    assert_close(coarse, solve(0.03, 0.499, far_boundary, false).rigid_ratio().expect("a ratio"), 0.005);
}

/// The mesh that results are computed on, against elements of half their length.
#[test]
#[ignore = "study in small: cargo xtask test --all runs it"]
fn halving_the_default_mesh_changes_less_than_half_a_percent() {
    assert_close(rigid_ratio(Resolution::DEFAULT), rigid_ratio(Resolution::DEFAULT.halved()), 0.005);
}

fn rigid_ratio(resolution: Resolution) -> f64 {
    solve(0.03, 0.499, resolution, false).rigid_ratio().expect("a ratio")
}

#[test]
fn the_stiffness_is_symmetric() {
    let body = solve(0.03, 0.5, DOUBLE, false);
    let matrix = &body.wall.matrix_m;
    assert!((matrix - matrix.transpose()).amax() < 1e-6 * matrix.amax());
}

#[test]
fn depths_and_poissons_ratios_outside_its_range_are_refused() {
    for (depth_m, poisson) in [(0.005, 0.5), (0.5, 0.5), (0.03, 0.51)] {
        let needle = Needle::gauge_18();
        let refused = Continuum::solve(&needle, depth_m, poisson, Contact::Bonded, Resolution::DEFAULT);
        assert!(matches!(refused, Err(ModelError::OutOfRange { .. })), "{depth_m} {poisson}");
    }
}

/// An only guide in front of a body that hardly gives: the needle between two clamps where its rear does not turn, and a cantilever where it
/// turns freely.
#[test]
fn one_guide_in_front_of_a_hard_body_is_a_beam_by_hand() {
    use crate::Guides;
    let body = solve(0.02, 0.5, DOUBLE, false);
    let needle = Needle::gauge_18();
    let gap_m = 0.03;
    for (rear, factor) in [(None, 12.0), (Some(1e-4), 3.0)] {
        let guides = Guides::One { rear_rotation_n_m_per_rad: [rear; 2] };
        let rig = Rig {
            needle: needle.clone(),
            guide2_m: 0.0,
            entry_m: gap_m,
            guides,
            tolerances: crate::Tolerances::default(),
        };
        let stiffness = body.lateral_stiffness_n_per_m(&rig, 1e12).expect("solves");
        assert_close(stiffness, factor * needle.bending_stiffness_n_m2() / gap_m.powi(3), 0.12);
    }
}

#[test]
fn numbers_in_planes_of_their_bytes_are_the_same_numbers() {
    let values = [0.0, -1.5, f32::MIN_POSITIVE, 3.25e-7, f32::MAX];
    let planes = super::operator::planes(&values);
    assert_eq!(planes.len(), 4 * values.len());
    assert_eq!(super::operator::from_planes(&planes), values.map(f64::from));
}
