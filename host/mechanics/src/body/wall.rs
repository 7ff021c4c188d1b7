//! A needle in a body as [`Continuum`] has it, from the forward model's table in place of finite elements: at once, where these take seconds.

use super::block::{flexibility_per_m, with_walls};
use super::table::{self, MODES};
use crate::continuum::operator::legendre;
use crate::continuum::{Contact, Continuum, WallStiffness};
use crate::{Block, ModelError, Mounting, Needle, check};
use nalgebra::DMatrix;
use std::f64::consts::PI;

/// Depths over the characteristic length `(EI/K)^(1/4)` of a needle up to which the table's polynomials resolve how it bends.
pub const RESOLVED_LENGTHS: f64 = 4.0;
/// Pieces between nodes along the needle: their quadrature is exact for products of the table's polynomials, and beams between them bend by less
/// than 0.01 % differently from one that the body holds all along.
const PIECES: usize = 32;

/// As [`Continuum::solve`], to 0.5 % for needles down to [`RESOLVED_LENGTHS`].
///
/// # Errors
/// As [`Continuum::solve`].
pub fn tabulated(
    needle: &Needle,
    depth_m: f64,
    poisson: f64,
    contact: Contact,
) -> Result<Continuum, ModelError> {
    Continuum::with_wall(needle, depth_m, poisson, contact, |radius_m| Ok(wall(radius_m, depth_m, poisson)))
}

/// Ratio K/E of a rigid needle that moves sideways as a whole, in a block or, without one, in a half space; at once.
///
/// # Errors
/// [`ModelError::OutOfRange`] for a Poisson's ratio outside 0 to 0.5, a depth of more than 1000 radii, or one that the block does not
/// have; [`ModelError::Singular`].
pub fn rigid_ratio(
    needle: &Needle,
    depth_m: f64,
    poisson: f64,
    block: Option<&Block>,
) -> Result<f64, ModelError> {
    let ratio = depth_m / (0.5 * needle.outer_diameter_m);
    let [least, most] = super::DEPTH_RANGE;
    check("poisson", poisson, "0 to 0.5", (0.0..=0.5).contains(&poisson))?;
    check(
        "depth over needle radius",
        ratio,
        "1000 or less on an elastic body",
        ratio > 0.0 && ratio <= most,
    )?;
    let half_space = table::uniform(ratio.max(least), poisson);
    let Some(block) = block else { return Ok(half_space[0][0]) };
    let added = flexibility_per_m(block, poisson, 0.5 * needle.outer_diameter_m, [0.0, depth_m])?;
    let with_block = with_walls(&half_space, &added.map(|row| row.map(|value| value * depth_m)))?;
    Ok(with_block[0][0])
}

/// Largest error of a half space's Young's modulus if walls are not stated: factors on it if the block is one of
/// [`Block::around`] the depth whose sides are held, and if they are free.
///
/// # Errors
/// As [`rigid_ratio`].
pub fn unknown_walls(needle: &Needle, depth_m: f64, poisson: f64) -> Result<[f64; 2], ModelError> {
    let half_space = rigid_ratio(needle, depth_m, poisson, None)?;
    let factor = |sides: Mounting| {
        let block = Block::around(depth_m, sides);
        Ok(half_space / rigid_ratio(needle, depth_m, poisson, Some(&block))?)
    };
    Ok([factor(Mounting::Held)?, factor(Mounting::Free)?])
}

/// Stiffness against deflections at nodes: the body resists what the table's polynomials have of them.
fn wall(radius_m: f64, depth_m: f64, poisson: f64) -> WallStiffness {
    let body = table::uniform(depth_m / radius_m, poisson);
    let body = DMatrix::from_fn(MODES, MODES, |i, j| body[i][j]);
    let angle_cosines: Vec<f64> = (0..=PIECES).map(|node| node_angle(node).cos()).collect();
    let weight = |node: usize| {
        let of_term = |k: usize| {
            let last = if 2 * k == PIECES { 1.0 } else { 2.0 };
            last / (4.0 * (k * k) as f64 - 1.0) * (2.0 * k as f64 * node_angle(node)).cos()
        };
        let end = if node == 0 || node == PIECES { 1.0 } else { 2.0 };
        end / PIECES as f64 * (1.0 - (1..=PIECES / 2).map(of_term).sum::<f64>())
    };
    let coefficients = DMatrix::from_fn(MODES, angle_cosines.len(), |degree, node| {
        (degree as f64 + 0.5) * weight(node) * legendre(degree, angle_cosines[node])[0]
    });
    WallStiffness {
        depths_m: angle_cosines.iter().map(|x| 0.5 * depth_m * (1.0 + x)).collect(),
        matrix_m: coefficients.tr_mul(&(body * &coefficients)) * depth_m,
    }
}

/// Clenshaw and Curtis: nodes at both ends, closer there, where the body's force changes most.
fn node_angle(node: usize) -> f64 {
    PI * (PIECES - node) as f64 / PIECES as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rig;
    use crate::continuum::Resolution;

    /// Elements a half longer than the default ones, which change results by a thousandth.
    const ELEMENTS: Resolution = Resolution { first: 0.7, growth: 1.7, ..Resolution::DEFAULT };

    /// The finite elements share neither table nor polynomials with it; they are good to half a percent.
    #[test]
    fn it_is_the_needle_among_finite_elements() {
        let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
        for (depth_m, poisson, moduli_kpa) in
            [(0.01, 0.5, [1.0, 15.0, 500.0]), (0.03, 0.45, [1.0, 15.0, 200.0]), (0.08, 0.5, [0.5, 5.0, 30.0])]
        {
            let elements =
                Continuum::solve(&rig.needle, depth_m, poisson, Contact::OneSided, ELEMENTS).expect("solves");
            let tabulated_stiffness =
                tabulated(&rig.needle, depth_m, poisson, Contact::OneSided).expect("in the table");
            let rigid = tabulated_stiffness.rigid_ratio().expect("a ratio")
                / elements.rigid_ratio().expect("a ratio");
            assert!((rigid - 1.0).abs() < 5e-3, "{depth_m} {poisson}: {rigid}");
            for youngs_kpa in moduli_kpa {
                let [a, b] = [&tabulated_stiffness, &elements]
                    .map(|body| body.response(&rig, 1e3 * youngs_kpa).expect("solves"));
                for z_m in [0.06, 0.07, 0.07 + 0.4 * depth_m, 0.07 + 0.9 * depth_m] {
                    let [a, b] = [&a, &b].map(|shape| shape.deflection_m(z_m) / a.deflection_m(rig.guide2_m));
                    assert!((a - b).abs() < 5e-3 * b.abs().max(0.5), "{depth_m} {youngs_kpa} {z_m}: {a} {b}");
                }
            }
        }
    }

    #[test]
    fn what_no_table_has_is_refused() {
        assert!(matches!(tabulated_at(1e-3, 0.5), Err(ModelError::OutOfRange { .. })));
        assert!(matches!(tabulated_at(0.03, 0.6), Err(ModelError::OutOfRange { .. })));
    }

    fn tabulated_at(depth_m: f64, poisson: f64) -> Result<Continuum, ModelError> {
        tabulated(&Needle::gauge_18(), depth_m, poisson, Contact::Bonded)
    }
}
