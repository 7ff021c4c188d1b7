//! The body against closed forms, itself on a finer mesh and the project's other solver; sessions from it.

use super::wall::element;
use super::*;
use crate::{Imperfection, LateralPlan};
use nalgebra::{DMatrix, DVector};
use std::f64::consts::PI;

const RADIUS_M: f64 = 0.635e-3;

fn close(name: &str, value: f64, expected: f64, relative: f64) {
    assert!((value / expected - 1.0).abs() < relative, "{name}: {value} is not {expected}");
}

/// A bonded rigid disc on an incompressible half space: 16/3 G a sideways, 16/3 G a^3 against tilting, no coupling (Johnson, Contact
/// mechanics, 1985, section 3). The stress is singular at
/// its edge, which costs most of the error.
#[test]
fn a_disc_on_the_surface_meets_the_closed_form() {
    let mesh =
        Mesh::new(1.0, 0.0, &[], Fineness { first: 0.1, increase: 0.4, longest_m: 1.0, reach: 1500.0 });
    let wall = wall::solve(&mesh, 0.5, &|_| 1.0).expect("solves");
    assert_eq!(wall.stiffness.shape(), (2, 2));
    close("sideways", wall.stiffness[(0, 0)], 16.0 / 9.0, 1.2e-2);
    close("tilting", wall.stiffness[(1, 1)], 16.0 / 9.0, 1.2e-2);
    assert!(wall.stiffness[(0, 1)].abs() < 0.01, "{}", wall.stiffness);
}

/// A rigid cylinder bonded in a fixed tube, plane strain: `8 pi G (1 - nu)(3 - 4 nu) / ((3 - 4 nu)^2 ln(R/a) - (R^2 - a^2)/(R^2 + a^2))`
/// of force per length and displacement.
#[test]
fn elements_meet_the_cylinder_in_a_tube_and_do_not_lock() {
    let (inner, outer, cells) = (1.0f64, 8.0f64, 12);
    for poisson in [0.3, 0.49, 0.499999] {
        let lines: Vec<f64> =
            (0..=cells).map(|i| inner * (outer / inner).powf(f64::from(i) / f64::from(cells))).collect();
        // One row of elements of unit height; nothing moves along the cylinder and nothing depends on z.
        let columns = 2 * lines.len() - 1;
        let mut stiffness = DMatrix::zeros(2 * columns, 2 * columns);
        for (cell, ends) in lines.windows(2).enumerate() {
            let matrix = element([ends[0], ends[1]], [0.0, 1.0], poisson, &|_| 1.0);
            for (a, b) in (0..9).flat_map(|a| (0..9).map(move |b| (a, b))) {
                for (i, j) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                    let [row, column] = [(a, i), (b, j)].map(|(node, of)| 2 * (2 * cell + node / 3) + of);
                    stiffness[(row, column)] += matrix[(3 * a + i, 3 * b + j)];
                }
            }
        }
        let free = 2..2 * (columns - 1);
        let free_block = stiffness.view((free.start, free.start), (free.len(), free.len())).into_owned();
        let moved = DVector::from_vec(vec![1.0, -1.0]);
        let load = -(stiffness.view((free.start, 0), (free.len(), 2)) * &moved);
        let solution = free_block.cholesky().expect("positive").solve(&load);
        let reaction = stiffness.view((0, 0), (2, 2)) * &moved
            + stiffness.view((0, free.start), (2, free.len())) * solution;
        let force = PI * moved.dot(&reaction);
        let shear = 0.5 / (1.0 + poisson);
        let kappa = 3.0 - 4.0 * poisson;
        let squares = (outer * outer - inner * inner) / (outer * outer + inner * inner);
        let exact =
            8.0 * PI * shear * (1.0 - poisson) * kappa / (kappa * kappa * (outer / inner).ln() - squares);
        close(&format!("nu {poisson}"), force, exact, 2e-3);
    }
}

fn stiffness(depth_m: f64, poisson: f64, fineness: Fineness) -> f64 {
    let wall = wall::solve(&Mesh::new(RADIUS_M, depth_m, &[], fineness), poisson, &|_| 1.0).expect("solves");
    let holding = Holding {
        bending_n_m2: Needle::gauge_18().bending_stiffness_n_m2(),
        guide2_m: 0.06,
        entry_m: 0.07,
        clamp_rad_per_n_m: 0.0,
        skin_n_per_m: 0.0,
        axial_n: 0.0,
        youngs_pa: 20e3,
    };
    Bent::new(&holding, &wall).expect("solves").stiffness_n_per_m
}

#[test]
fn a_coarse_mesh_is_within_a_percent_of_the_project_s_other_solver() {
    use mechanics::continuum::{Contact, Continuum, Resolution};
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
    let continuum =
        Continuum::solve(&rig.needle, 0.02, 0.49, Contact::Bonded, Resolution::DEFAULT).expect("solves");
    let expected = continuum.lateral_stiffness_n_per_m(&rig, 20e3).expect("a stiffness");
    close("20 mm", stiffness(0.02, 0.49, Fineness::COARSE), expected, 1e-2);
}

/// The mesh that sessions are made with, against one of half its lengths and one of four times its reach.
#[test]
fn the_fine_mesh_is_within_a_thousandth_of_finer_and_larger_ones() {
    let fine = stiffness(0.02, 0.5, Fineness::FINE);
    close("halved", fine, stiffness(0.02, 0.5, Fineness::FINE.halved()), 1e-3);
    let extended = Fineness { reach: 4.0 * Fineness::FINE.reach, ..Fineness::FINE };
    close("further", fine, stiffness(0.02, 0.5, extended), 1e-3);
}

fn body(effects: Vec<(&'static str, Vec<f64>)>) -> Body {
    Body { youngs_kpa: 20.0, poisson: 0.49, effects }
}

/// One run of one hold, without noise.
fn one_run() -> Design {
    let mut design = Design::four_runs();
    design.noise = design.noise.none();
    design.lateral = vec![LateralPlan { levels_mm: vec![0.0, 1.2], ..design.lateral[0].clone() }];
    design
}

#[test]
fn effects_do_to_a_body_what_they_do() {
    let bodies = Bodies::new(Fineness::COARSE);
    let plain = end_force_n(vec![], &bodies);
    assert!((0.5..3.0).contains(&plain), "{plain}");
    // A layer without contrast, and a boundary below the needle, are no layer; stiffer depths make it stiffer.
    close("even", end_force_n(vec![("tissue.layers", vec![1.0, 9.0])], &bodies), plain, 1e-12);
    let stiffer = end_force_n(vec![("tissue.layers", vec![2.5, 8.0])], &bodies);
    assert!(stiffer > 1.02 * plain && stiffer < 2.5 * plain, "{stiffer} {plain}");
    assert!(end_force_n(vec![("tissue.gradient", vec![0.03])], &bodies) > 1.02 * plain);
    assert!(end_force_n(vec![("tissue.entry_gap", vec![4.0])], &bodies) < 0.95 * plain);
    assert!(end_force_n(vec![("tissue.skin", vec![0.3])], &bodies) > 1.02 * plain);
    assert!(end_force_n(vec![("rig.clamp_compliance", vec![0.4])], &bodies) < 0.98 * plain);
    let framed = end_force_n(vec![("rig.frame_compliance", vec![0.1])], &bodies);
    close("frame", framed, plain / (1.0 + 0.1 * plain / 1.2), 1e-9);
    let loose = end_force_n(vec![("rig.backlash", vec![0.12])], &bodies);
    close("backlash", loose, 0.9 * plain, 1e-9);
    // In next to nothing it is the bare needle.
    let air = Body { youngs_kpa: 1e-6, ..body(vec![]) };
    let session = bodies.session(&air, &Background::default(), &one_run(), 1).expect("a session");
    let air = *session.lateral[0].force.force_y_n.last().expect("samples");
    let bare = 3.0 * Needle::gauge_18().bending_stiffness_n_m2() / 0.06f64.powi(3) * 1.2e-3;
    close("air", air, bare, 1e-4);
}

fn end_force_n(effects: Vec<(&'static str, Vec<f64>)>, bodies: &Bodies) -> f64 {
    let session = bodies.session(&body(effects), &Background::default(), &one_run(), 1).expect("a session");
    let force_n = &session.lateral[0].force.force_y_n;
    force_n[force_n.len() - 1]
}

#[test]
fn backgrounds_act_on_bodies_and_nothing_else_is_accepted() {
    let bodies = Bodies::new(Fineness::COARSE);
    let plain = one_session(&Background::default(), &bodies);
    assert_eq!(plain, one_session(&Background::default(), &bodies));
    for (kind, size) in [
        (Imperfection::ModulusOverDepth, 0.05),
        (Imperfection::ModulusPerRun, 0.02),
        (Imperfection::Entry, 0.3),
        (Imperfection::ForceZero, 0.02),
    ] {
        let change = (last_force_n(&one_session(&Background::of(kind, size, 2), &bodies))
            / last_force_n(&plain)
            - 1.0)
            .abs();
        assert!(change > 1e-4 && change < 0.06, "{} {change}", kind.name());
    }
    let no_background = Background::default();
    assert_eq!(
        refused(vec![("tissue.shear", vec![1.0])], &bodies, &no_background).unwrap_err(),
        BodyError::Effect("tissue.shear")
    );
    let insertions = Design { insertion: Design::insertions().insertion, ..one_run() };
    assert_eq!(
        bodies.session(&body(vec![]), &no_background, &insertions, 1).unwrap_err(),
        BodyError::Insertion
    );
}

fn refused(
    effects: Vec<(&'static str, Vec<f64>)>,
    bodies: &Bodies,
    no_background: &Background,
) -> Result<Session, BodyError> {
    bodies.session(&body(effects), no_background, &one_run(), 1)
}

fn last_force_n(session: &Session) -> f64 {
    session.lateral[0].force.force_y_n.last().copied().expect("samples")
}

fn one_session(background: &Background, bodies: &Bodies) -> Session {
    bodies.session(&body(vec![]), background, &one_run(), 1).expect("a session")
}
