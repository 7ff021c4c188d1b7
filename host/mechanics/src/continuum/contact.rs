//! A needle that touches the wall of an intact hole on one side only, without friction: unilateral contact (theory, eq. 22).
//!
//! The needle moves sideways as a whole by `u`. At a place (z, t) of the wall the pressure `p` is not negative, the wall's normal
//! displacement `w` is not less than `u cos t`, and one of the two is met exactly (Signorini's conditions); no shear acts on the wall, and
//! none on the bottom of the hole. The wall's displacement follows from the pressure harmonic by harmonic of the circumference, by the
//! finite elements of [`solve`](super::solve) for each; the conditions hold at the nodes along the wall and at evenly spaced angles, between which and
//! the harmonics the cosine transform is exact. The contact is found by the primal-dual active-set method (Hintermueller, Ito and
//! Kunisch, 2003): at every place either the pressure or the gap is set to zero, by the sign of what it would be, until no place changes.

use super::mesh::{Mesh, Resolution};
use super::operator::nodes;
use super::solve::{bulk_compliance, cell_matrix, wall_stiffness};
use super::sparse::Sparse;
use crate::ModelError;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use std::f64::consts::PI;
use std::fmt::Write;
use std::sync::LazyLock;

/// Ratios of depth to radius between which the table is made.
pub const RATIOS: [f64; 2] = [10.0, 600.0];
/// Poisson's ratios between which it is made.
pub const POISSON: [f64; 2] = [0.0, 0.5];
/// Nodes of the table in the logarithm of the ratio and in Poisson's ratio.
const NODES: [usize; 2] = [5, 4];
/// Harmonics of the table.
const HARMONICS: usize = 8;
/// Elements of the table.
const RESOLUTION: Resolution = Resolution { first: 0.5, growth: 1.5, reach: 200.0 };
/// Relative error of the share, at 95 %, see the tests: mesh and harmonics 1 %, and that a needle bends. If the tip
/// moves against the surface by 40 % of the surface's motion, as that of a long thin needle in stiff tissue does not,
/// the share is 15 % less.
pub(super) const RELATIVE_ERROR: f64 = 0.06;
/// Most rounds of the search for the contact.
const MAX_ROUNDS: usize = 60;

/// Why the contact has no solution.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ContactError {
    /// The body cannot be solved.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The search for the contact does not end.
    #[error("the contact of needle and hole is not found in {MAX_ROUNDS} rounds")]
    NotConverged,
}

/// Stiffness of a rigid needle that is held on one side only over that of a bonded one.
///
/// All lengths are in radii of the needle: `depth`, and those of `resolution`. `harmonics` of the circumference are taken.
///
/// # Errors
/// [`ContactError`].
pub fn one_sided_share(
    depth: f64,
    poisson: f64,
    resolution: Resolution,
    harmonics: usize,
) -> Result<f64, ContactError> {
    let mesh = Mesh::new(1.0, depth, resolution, false);
    let bonded = wall_stiffness(&mesh, poisson)?.matrix_m.sum();
    let compliances = wall_compliances(&mesh, poisson, harmonics)?;
    let rigid = DVector::from_element(compliances.first().map_or(0, DMatrix::nrows), 1.0);
    Ok(one_sided_work(&compliances, &rigid)? / bonded)
}

/// Compliances of the first so many harmonics.
fn wall_compliances(mesh: &Mesh, poisson: f64, harmonics: usize) -> Result<Vec<DMatrix<f64>>, ModelError> {
    (0..harmonics).into_par_iter().map(|harmonic| wall_compliance(mesh, harmonic, poisson)).collect()
}

/// Work of the lateral force of the wall on a needle that is deflected by so much at the nodes along the wall, from the compliances
/// of the harmonics: twice the energy.
fn one_sided_work(compliances: &[DMatrix<f64>], deflection: &DVector<f64>) -> Result<f64, ContactError> {
    let angles = compliances.len();
    let contact_count = deflection.len();
    let cosine =
        DMatrix::from_fn(angles, angles, |harmonic, k| (harmonic as f64 * middle_angle(k, angles)).cos());
    // Node forces per angle make amplitudes of the harmonics; these make displacements, which add up again.
    let size = contact_count * angles;
    let mut compliance = DMatrix::zeros(size, size);
    for (harmonic, of_harmonic) in compliances.iter().enumerate() {
        let scale = if harmonic == 0 { 1.0 } else { 2.0 } / angles as f64;
        for k in 0..angles {
            for l in 0..angles {
                let factor = scale * cosine[(harmonic, k)] * cosine[(harmonic, l)];
                let mut block = compliance
                    .view_mut((k * contact_count, l * contact_count), (contact_count, contact_count));
                block.zip_apply(of_harmonic, |sum, value| *sum += factor * value);
            }
        }
    }
    let imposed = DVector::from_fn(size, |place, _| {
        deflection[place % contact_count] * middle_angle(place / contact_count, angles).cos()
    });
    let force = contact(&compliance, &imposed)?;
    // The first harmonic of the forces per angle is lateral.
    Ok(PI * 2.0 / angles as f64 * force.dot(&imposed))
}

/// Angle in the middle of a part of a half circle.
fn middle_angle(k: usize, angles: usize) -> f64 {
    (k as f64 + 0.5) * PI / angles as f64
}

/// Forces `p >= 0` with `G p - g >= 0`, of which one is zero at every place.
fn contact(compliance: &DMatrix<f64>, imposed: &DVector<f64>) -> Result<DVector<f64>, ContactError> {
    let size = imposed.len();
    // A force that would close a gap of the size of the imposed motion.
    let scale = (0..size).map(|i| compliance[(i, i)]).fold(0.0, f64::max).recip();
    let mut closed: Vec<usize> = (0..size).filter(|i| imposed[*i] > 0.0).collect();
    for _ in 0..MAX_ROUNDS {
        let closed_compliance = DMatrix::from_fn(closed.len(), closed.len(), |i, j| {
            0.5 * (compliance[(closed[i], closed[j])] + compliance[(closed[j], closed[i])])
        });
        let right = DVector::from_iterator(closed.len(), closed.iter().map(|i| imposed[*i]));
        let contact_forces = closed_compliance.cholesky().ok_or(ModelError::Singular)?.solve(&right);
        let mut force = DVector::zeros(size);
        closed.iter().zip(contact_forces.iter()).for_each(|(i, value)| force[*i] = *value);
        let gap = compliance * &force - imposed;
        let next: Vec<usize> = (0..size).filter(|i| force[*i] - scale * gap[*i] > 1e-12 * scale).collect();
        if next == closed {
            return Ok(force);
        }
        closed = next;
    }
    Err(ContactError::NotConverged)
}

/// Normal displacement of the wall's nodes per node force (per angle and harmonic) of each, in a harmonic.
fn wall_compliance(mesh: &Mesh, harmonic: usize, poisson: f64) -> Result<DMatrix<f64>, ModelError> {
    let numbering = Numbering::new(mesh, harmonic);
    let (shear, bulk) = (0.5 / (1.0 + poisson), bulk_compliance(poisson));
    let mut system = Sparse::new(numbering.count);
    for axial in 0..mesh.depths_m.len() - 1 {
        for radial in (0..mesh.radii_m.len() - 1).filter(|radial| !mesh.is_needle(*radial, axial)) {
            let matrix = cell_matrix(mesh, radial, axial, harmonic, shear, bulk);
            let unknowns = numbering.of_cell(mesh, radial, axial);
            for (row, of_row) in unknowns.iter().zip(&matrix) {
                let Some((a, i)) = *row else { continue };
                for (column, value) in unknowns.iter().zip(of_row) {
                    if let Some((b, j)) = *column {
                        system.add(i, j, a * b * value);
                    }
                }
            }
        }
    }
    let wall = numbering.wall(mesh);
    let mut load = DMatrix::zeros(numbering.count, wall.len());
    wall.iter().enumerate().for_each(|(column, index)| load[(*index, column)] = 1.0);
    let solved = system.solve(&load)?;
    let compliance = DMatrix::from_fn(wall.len(), wall.len(), |i, j| solved[(wall[i], j)]);
    if compliance.iter().all(|value| value.is_finite()) { Ok(compliance) } else { Err(ModelError::Singular) }
}

/// Unknowns of a harmonic: sign and index, nothing where a displacement is zero.
struct Numbering {
    displacements: Vec<[Option<(f64, usize)>; 3]>,
    pressures: Vec<Option<(f64, usize)>>,
    count: usize,
}

impl Numbering {
    fn new(mesh: &Mesh, harmonic: usize) -> Self {
        let (columns, rows) = (2 * mesh.radii_m.len() - 1, 2 * mesh.depths_m.len() - 1);
        let mut count = 0;
        let mut next = || {
            count += 1;
            Some((1.0, count - 1))
        };
        let mut displacements = Vec::with_capacity(columns * rows);
        for row in 0..rows {
            for column in 0..columns {
                let is_far = column == columns - 1 || row == rows - 1;
                let in_needle = column < 2 && row < 2 * mesh.needle.1;
                displacements.push(match (column, harmonic) {
                    _ if is_far || in_needle => [None; 3],
                    // On the axis a displacement along it is the same at all angles, one across it has one direction.
                    (0, 0) => [None, None, next()],
                    (0, 1) => {
                        let across_unknown = next();
                        [across_unknown, across_unknown.map(|(sign, index)| (-sign, index)), None]
                    }
                    (0, _) => [None; 3],
                    (_, 0) => [next(), None, next()],
                    _ => [next(), next(), next()],
                });
            }
        }
        let corners = mesh.radii_m.len();
        let pressures = (0..corners * mesh.depths_m.len()).map(|corner| {
            let (column, row) = (corner % corners, corner / corners);
            // No cell has the corners inside the needle.
            let in_needle = column == 0 && row < mesh.needle.1;
            if in_needle || (column == 0 && harmonic > 0) { None } else { next() }
        });
        let pressures = pressures.collect();
        Self { displacements, pressures, count }
    }

    /// The 27 displacements of a cell, node by node, and its 4 pressures.
    fn of_cell(&self, mesh: &Mesh, radial: usize, axial: usize) -> [Option<(f64, usize)>; 31] {
        mesh.gather(radial, axial, &self.displacements, &self.pressures, None)
    }

    /// Normal displacements along the wall, from the surface to the bottom of the hole.
    fn wall(&self, mesh: &Mesh) -> Vec<usize> {
        let columns = 2 * mesh.radii_m.len() - 1;
        let rows = 0..=2 * mesh.needle.1;
        rows.filter_map(|row| self.displacements[row * columns + 2][0].map(|(_, index)| index)).collect()
    }
}

/// The table of [`one_sided_share`] as CSV; `progress` is called with every ratio and Poisson's ratio.
///
/// # Errors
/// [`ContactError`].
pub fn table(progress: impl Fn(f64, f64) + Sync) -> Result<String, ContactError> {
    let mut text = String::from(
        "# Lateral stiffness of a rigid needle that touches the wall of an intact hole on one side only, without friction, over that of a\n\
         # bonded one: `cargo xtask study operator`. depth/radius, Poisson's ratio, share.\n",
    );
    let of_ratio = nodes(RATIOS.map(f64::ln), NODES[0]).into_iter().map(f64::exp);
    for ratio in of_ratio {
        for poisson in nodes(POISSON, NODES[1]) {
            progress(ratio, poisson);
            let held_share = one_sided_share(ratio, poisson, RESOLUTION, HARMONICS)?;
            let _ = writeln!(text, "{ratio:.9},{poisson:.9},{held_share:.6}");
        }
    }
    Ok(text)
}

/// The committed table's shares, Poisson's ratio by Poisson's ratio within ratio by ratio.
static SHARES: LazyLock<Vec<f64>> = LazyLock::new(|| {
    let lines = include_str!("contact.csv").lines().filter(|line| !line.starts_with('#'));
    lines.filter_map(|line| line.split(',').nth(2)?.parse().ok()).collect()
});

/// [`one_sided_share`] interpolated in the committed table; the ends of its range stand for what lies beyond them.
pub(super) fn tabulated_share(ratio: f64, poisson: f64) -> f64 {
    let ln_ratio = ratio.clamp(RATIOS[0], RATIOS[1]).ln();
    let of_ratio = super::operator::weights(RATIOS.map(f64::ln), NODES[0], ln_ratio);
    let of_poisson = super::operator::weights(POISSON, NODES[1], poisson.clamp(POISSON[0], POISSON[1]));
    let weights = of_ratio.iter().flat_map(|a| of_poisson.iter().map(move |b| a * b));
    weights.zip(SHARES.iter()).map(|(weight, share)| weight * share).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Complementarity of forces and gaps, on a chain of springs that is pushed in places and pulled in others.
    #[test]
    fn forces_push_where_there_is_contact_and_nowhere_else() {
        let compliance = DMatrix::from_fn(6, 6, |i, j| 0.6f64.powi((i as i32 - j as i32).abs()));
        let imposed = DVector::from_vec(vec![1.0, 0.4, -0.3, 0.1, -1.0, 0.7]);
        let force = contact(&compliance, &imposed).expect("solves");
        let gap = &compliance * &force - &imposed;
        for place in 0..6 {
            assert!(force[place] >= 0.0 && gap[place] >= -1e-12, "{place}: {} {}", force[place], gap[place]);
            assert!(force[place] * gap[place].abs() < 1e-12, "{place}");
        }
        assert!(force[0] > 0.0 && force[4] == 0.0 && force[5] > 0.0);
    }

    /// Shares of an independent solution of the same problem, to three digits.
    #[test]
    fn the_table_holds_the_shares_of_another_solution() {
        for (depth_mm, poisson, expected) in [(20.0, 0.5, 0.655), (40.0, 0.49, 0.688), (20.0, 0.3, 0.676)] {
            let table_share = tabulated_share(depth_mm / 0.635, poisson);
            assert!(
                (table_share / expected - 1.0).abs() < 0.005,
                "{depth_mm} {poisson}: {table_share} {expected}"
            );
        }
    }

    /// Between the nodes of the table, on other elements and with other harmonics.
    #[test]
    fn the_table_is_the_direct_solution() {
        let coarse = Resolution { first: 0.7, growth: 1.6, reach: 200.0 };
        let direct_share = one_sided_share(14.0, 0.4, coarse, 6).expect("solves");
        let tabulated = tabulated_share(14.0, 0.4);
        assert!((direct_share / tabulated - 1.0).abs() < 0.01, "{direct_share} {tabulated}");
    }

    /// A needle that bends is held by nearly the same share; one that turns, touching on one side above and on the other below, by less.
    #[test]
    fn bent_needles_are_held_by_the_share_of_a_rigid_one() {
        let mesh = Mesh::new(1.0, 20.0, Resolution { first: 1.0, growth: 2.0, reach: 100.0 }, false);
        let bonded = wall_stiffness(&mesh, 0.5).expect("solves");
        let compliances = wall_compliances(&mesh, 0.5, 5).expect("solves");
        let rigid = work_ratio(&|_| 1.0, &compliances, &bonded.depths_m, &bonded.matrix_m);
        for shape in [&(|x: f64| 1.0 - 0.7 * x) as &dyn Fn(f64) -> f64, &|x: f64| (-2.0 * x).exp()] {
            let ratio = work_ratio(shape, &compliances, &bonded.depths_m, &bonded.matrix_m) / rigid;
            println!("{ratio:.4}");
            assert!((ratio - 1.0).abs() < RELATIVE_ERROR, "{ratio}");
        }
        let rotating_share =
            work_ratio(&|x| 1.0 - 1.4 * x, &compliances, &bonded.depths_m, &bonded.matrix_m) / rigid;
        assert!((0.8..0.95).contains(&rotating_share), "{rotating_share}");
    }

    fn work_ratio(
        shape: &dyn Fn(f64) -> f64,
        compliances: &[DMatrix<f64>],
        depths_m: &[f64],
        matrix_m: &DMatrix<f64>,
    ) -> f64 {
        let tapered = depths_m.iter().map(|depth| shape(depth / 20.0));
        let deflection = DVector::from_iterator(depths_m.len(), tapered);
        let work = (deflection.transpose() * matrix_m * &deflection)[0];
        one_sided_work(compliances, &deflection).expect("solves") / work
    }
}
