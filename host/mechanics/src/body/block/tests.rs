//! Blocks against finite elements of another library, closed forms and the laws that hold for every body.

use super::super::table::uniform;
use super::*;

/// Radius of an 18 gauge needle.
const RADIUS_M: f64 = 0.635e-3;
/// A line per block as `tests/studies/finite_elements/blocks.py` makes it: edges, needle's place and depth in mm, Poisson's ratio, sides, far
/// side, and the stiffness against Legendre polynomials per unit of modulus and depth, entries on and below the diagonal.
const ELEMENTS: &str = include_str!("elements.csv");

fn block(size_mm: [f64; 3], at_mm: [f64; 2], sides: Mounting, far_side: Mounting) -> Block {
    Block { size_m: size_mm.map(metres), needle_at_m: at_mm.map(metres), sides, far_side }
}

fn metres(mm: f64) -> f64 {
    1e-3 * mm
}

fn added(block: &Block, poisson: f64, depth_m: f64) -> Matrix {
    flexibility_per_m(block, poisson, RADIUS_M, [0.0, depth_m]).expect("solves")
}

/// Largest difference of the stiffness of a rigid needle, and of one that turns, over one in `every` blocks of the table.
fn compared_with_elements(every: usize) -> [f64; 2] {
    let mut worst = [0.0f64; 2];
    for line in ELEMENTS.lines().filter(|line| !line.starts_with('#')).step_by(every) {
        let cells: Vec<&str> = line.split(',').collect();
        let mounting = |i: usize| if cells[i] == "held" { Mounting::Held } else { Mounting::Free };
        let block = block(
            std::array::from_fn(|i| number(i, &cells)),
            std::array::from_fn(|i| number(3 + i, &cells)),
            mounting(7),
            mounting(8),
        );
        let (depth_m, poisson) = (1e-3 * number(5, &cells), number(6, &cells));
        let added = added(&block, poisson, depth_m).map(|row| row.map(|value| value * depth_m));
        let with_block = with_walls(&uniform(depth_m / RADIUS_M, poisson), &added).expect("a body");
        for (i, worst) in worst.iter_mut().enumerate() {
            *worst = worst.max((with_block[i][i] / number(9 + i * (i + 3) / 2, &cells) - 1.0).abs());
        }
    }
    worst
}

fn number(i: usize, cells: &[&str]) -> f64 {
    cells[i].parse().expect("a number")
}

#[test]
fn some_blocks_agree_with_finite_elements() {
    let [rigid, turning] = compared_with_elements(4);
    assert!(rigid < 0.03 && turning < 0.03, "{rigid} {turning}");
}

#[test]
#[ignore = "a minute of solutions; cargo xtask test --all runs it"]
fn every_drawn_block_agrees_with_finite_elements() {
    let [rigid, turning] = compared_with_elements(1);
    assert!(rigid < 0.03 && turning < 0.03, "{rigid} {turning}");
}

/// In the middle of a long needle in a long box the strain is plane: a rod in a shell of twice the width moves by
/// `(3 - 4 nu) ln 2 / (8 pi G (1 - nu))` more per unit of line load, whatever the shape of the shell.
#[test]
fn a_box_of_twice_the_width_gives_as_a_coaxial_shell_does() {
    for poisson in [0.3, 0.5] {
        let shear = 0.5 / (1.0 + poisson);
        let expected =
            (3.0 - 4.0 * poisson) * 2f64.ln() / (8.0 * std::f64::consts::PI * shear * (1.0 - poisson));
        let middle_difference = middle_per_load(60.0, poisson) - middle_per_load(30.0, poisson);
        assert!(
            (middle_difference / expected - 1.0).abs() < 0.01,
            "{poisson}: {middle_difference} {expected}"
        );
    }
}

fn middle_per_load(edge_mm: f64, poisson: f64) -> f64 {
    let size_mm = [edge_mm, edge_mm, 300.0];
    let shell = block(size_mm, [0.5 * edge_mm; 2], Mounting::Held, Mounting::Held);
    let depth_m = 0.2;
    let added = added(&shell, poisson, depth_m);
    // A load of one per length is the depth times the first coefficient's.
    (0..MODES).map(|i| added[i][0] * legendre(i, 0.0)[0] * depth_m).sum::<f64>()
}

/// A free column on a plate is a cantilever: bending and shear below the needle.
#[test]
fn a_free_column_bends_and_shears() {
    let [edge_m, length_m, depth_m, poisson] = [0.03f64, 0.12, 0.01, 0.45];
    let column = block([30.0, 30.0, 120.0], [15.0; 2], Mounting::Free, Mounting::Held);
    let arm_m: f64 = length_m - 0.5 * depth_m;
    let bending = arm_m.powi(3) / (3.0 * edge_m.powi(4) / 12.0);
    let shearing = arm_m / (5.0 / 6.0 * 0.5 / (1.0 + poisson) * edge_m * edge_m);
    let flexibility = added(&column, poisson, depth_m)[0][0];
    assert!((flexibility / (bending + shearing) - 1.0).abs() < 0.06, "{flexibility} {bending} {shearing}");
}

/// Far walls change nothing, the flexibility is symmetric, and a block seen from the other plane is itself.
#[test]
fn far_walls_change_nothing_and_planes_are_alike() {
    let depth_m = 0.03;
    let distant = added(&Block::cube(2.0, Mounting::Held), 0.5, depth_m);
    let half_space_stiffness = uniform(depth_m / RADIUS_M, 0.5)[0][0] * depth_m;
    assert!((distant[0][0] * half_space_stiffness).abs() < 0.02, "{}", distant[0][0] * half_space_stiffness);
    let oblong = block([60.0, 90.0, 50.0], [20.0, 40.0], Mounting::Held, Mounting::Free);
    let y = added(&oblong, 0.49, depth_m);
    let turned_twice = added(&oblong.turned().turned(), 0.49, depth_m);
    assert_eq!(y, turned_twice);
    assert!((y[1][2] - y[2][1]).abs() < 1e-9 * y[0][0].abs());
    // The wall that is nearer stiffens more.
    let x = added(&oblong.turned(), 0.49, depth_m);
    assert!(x[0][0] < y[0][0], "{} {}", x[0][0], y[0][0]);
}

#[test]
fn what_is_no_block_or_no_needle_in_it_is_refused() {
    let cube = Block::cube(0.05, Mounting::Held);
    assert_eq!(refused_quantity(&cube, 0.046), "depth_mm");
    assert_eq!(refused_quantity(&Block { needle_at_m: [0.001, 0.02], ..cube }, 0.03), "needle_at_mm");
    assert_eq!(refused_quantity(&Block { size_m: [0.05, 0.05, 3.0], ..cube }, 0.03), "body_mm");
    assert_eq!(
        refused_quantity(&Block { sides: Mounting::Free, far_side: Mounting::Free, ..cube }, 0.03),
        "far_side"
    );
}

fn refused_quantity(block: &Block, depth_m: f64) -> &str {
    match flexibility_per_m(block, 0.5, RADIUS_M, [0.0, depth_m]) {
        Err(ModelError::OutOfRange { name, .. }) => name,
        other => panic!("{other:?}"),
    }
}
