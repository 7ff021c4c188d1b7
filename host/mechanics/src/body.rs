//! The tissue as an elastic body: from the deflection of the needle below the surface to the force of the body on it
//! (theory, eq. 15 to 19).
//!
//! A half space with a free surface, to which the needle's wall and tip are bonded; the needle's sections stay plane and normal to
//! its axis. The deflection below the surface is a sum of Legendre polynomials with coefficients c; the energy of the body is
//! `E/2 c^T T c` with a matrix T that depends on depth over radius and on Poisson's ratio, interpolated in the tables of
//! [`continuum::operator`](crate::continuum::operator), which the axisymmetric finite-element solution made. Force and shape of
//! a needle agree with the direct solution to 0.02 % and 0.05 um per millimetre of displacement.
//!
//! Tissue whose modulus varies with depth is reduced to a few fields (see there): force within 1 to 2 % and shape within
//! 15 um per millimetre for moduli between a quarter and four times that at the surface, exact where they are all the same. Against a
//! solver of its own (`tests/worlds`) the force is within 0.5 % for two layers of 0.4 to 3 times and within 0.1 % for gradients of -0.006
//! to 0.06 per mm, at 20 to 50 mm.

mod block;
mod give;
mod legendre;
mod ritz;
mod stiffened;
mod table;
mod wall;

pub(crate) use block::{flexibility_per_m, nodes_with_walls};
pub(super) use legendre::powers;
pub(super) use ritz::{Load, Ritz, Shape};
pub(super) use stiffened::Stiffened;
pub(super) use table::MODES;
use table::Matrix;
pub use wall::{RESOLVED_LENGTHS, rigid_ratio, tabulated, unknown_walls};

use super::problem::Give;
use super::{Foundation, ModelError, Support, check, quadrature};
use table::Varied;

/// A needle's depth over its radius may be so much; shallower ones have the stiffness per depth of the least.
pub const DEPTH_RANGE: [f64; 2] = [1.0, 1000.0];
/// The same where the modulus varies.
const VARIED_RANGE: [f64; 2] = [4.0, 600.0];
/// Poisson's ratios of bodies whose modulus varies.
const VARIED_POISSON: [f64; 2] = [0.25, 0.5];
/// The modulus may vary by such a factor.
const MAX_CONTRAST: f64 = 12.0;
/// A modulus that changes in proportion to depth does so down to this depth below the surface, or so many depths of the tip where that
/// is deeper, and stays as it is below: no gradient extends without end. An absolute depth, since what lies below a shallow tip is what holds
/// a deeper one; what lies below 60 mm counts for 1 % of the force where the tip is at 50 mm.
const GROWTH_ENDS_M: f64 = 60e-3;
const GROWTH_ENDS: f64 = 1.2;
/// Parts over which such a modulus is taken as constant in every slice of depth.
const PARTS: usize = 8;

/// Stiffness of the body against the Legendre coefficients of the deflection of a needle that it holds over `depth_m`, N/m.
///
/// `from_m` is the depth below the surface where the body begins: above it nothing supports the needle.
///
/// # Errors
/// [`ModelError::OutOfRange`] where depth, Poisson's ratio or modulus are not those of the tables.
pub(super) fn stiffness(
    foundation: &Foundation,
    support: Support,
    give: Give,
    radius_m: f64,
    [from_m, depth_m]: [f64; 2],
) -> Result<Matrix, ModelError> {
    let Support::Body { poisson, block } = support else {
        return Err(ModelError::NotOnBody { what: "a row of springs" });
    };
    let ratio = depth_m / radius_m;
    check("depth over needle radius", ratio, "1000 or less on an elastic body", ratio <= DEPTH_RANGE[1])?;
    let uniform = table::uniform(ratio.max(DEPTH_RANGE[0]), poisson);
    let Some(varied) = varied(foundation, from_m, depth_m) else {
        let modulus_pa = foundation.modulus_pa(from_m);
        return with_walls_and_give(
            uniform.map(|row| row.map(|value| value * modulus_pa * depth_m)),
            modulus_pa,
            (poisson, radius_m),
            [from_m, depth_m],
            (block, give),
        );
    };
    let [least, most] = varied.iter().fold([f64::INFINITY, 0.0], |[low, high], m| [m.min(low), m.max(high)]);
    check(
        "modulus below over modulus above",
        most / least,
        "a factor of at most 12 on an elastic body",
        least > 0.0 && most <= MAX_CONTRAST * least,
    )?;
    check(
        "depth over needle radius",
        ratio,
        "600 or less where E varies with depth",
        ratio <= VARIED_RANGE[1],
    )?;
    check(
        "poisson",
        poisson,
        "0.25 to 0.5 where E varies with depth",
        (VARIED_POISSON[0]..=VARIED_POISSON[1]).contains(&poisson),
    )?;
    let reduced = Varied::at(ratio.max(VARIED_RANGE[0]), poisson);
    let (of_profile, of_one) = (reduced.stiffness(&varied)?, reduced.one());
    // The difference of the reduced body of one modulus from the uniform table is that of its coarser
    // table.
    let mean_pa = varied.iter().sum::<f64>() / varied.len() as f64;
    let mut matrix = of_profile;
    for (i, row) in matrix.iter_mut().enumerate() {
        for (j, value) in row.iter_mut().enumerate() {
            *value = depth_m * (*value + mean_pa * (uniform[i][j] - of_one[i][j]));
        }
    }
    // The effect of the walls comes through all of the block: by its mean modulus.
    let of_block_pa = block.map_or(mean_pa, |block| mean_of_block_pa(foundation, from_m, block.size_m[2]));
    with_walls_and_give(matrix, of_block_pa, (poisson, radius_m), [from_m, depth_m], (block, give))
}

/// Stiffness matrix of tissue that ends at walls and gives way.
fn with_walls_and_give(
    matrix: Matrix,
    modulus_pa: f64,
    (poisson, radius_m): (f64, f64),
    [from_m, depth_m]: [f64; 2],
    (block, give): (Option<crate::Block>, Give),
) -> Result<Matrix, ModelError> {
    let in_block = match block {
        None => matrix,
        Some(block) => {
            let added = block::flexibility_per_m(&block, poisson, radius_m, [from_m, depth_m])?;
            block::with_walls(&matrix, &added.map(|row| row.map(|value| value / modulus_pa)))?
        }
    };
    give::with_give(in_block, give, modulus_pa, [from_m, depth_m])
}

/// Mean modulus in every slice of depth; `None` where it is the same in all of them.
fn varied(foundation: &Foundation, from_m: f64, depth_m: f64) -> Option<[f64; table::SLICES]> {
    if foundation.gradient_per_m() == 0.0 && foundation.faces_m().all(|face_m| face_m <= from_m) {
        return None;
    }
    let growth_ends_m = GROWTH_ENDS_M.max(from_m + GROWTH_ENDS * depth_m);
    let growth = |at_m: f64| foundation.growth(at_m.min(growth_ends_m));
    let without_gradient = foundation.ungraded();
    let middles = || (0..PARTS).map(|part| (part as f64 + 0.5) / PARTS as f64);
    let mut top_m = from_m;
    let ends_m = table::SLICE_ENDS.map(|end| from_m + end * depth_m);
    let mut means = [0.0; table::SLICES];
    for (mean, end_m) in means.iter_mut().zip(ends_m) {
        let mut slice_start_m = top_m;
        for (thickness_m, modulus_pa) in without_gradient.parts_between(top_m, end_m) {
            let grown = middles().map(|share| growth(slice_start_m + share * thickness_m)).sum::<f64>()
                / PARTS as f64;
            *mean += thickness_m * modulus_pa * grown / (end_m - top_m);
            slice_start_m += thickness_m;
        }
        top_m = end_m;
    }
    // Far below, strains fall off with the square of the distance, and energies with its fourth power over a growing area.
    let begin_m = top_m - from_m;
    let mut far_part = 0.0;
    let mut start_m = begin_m;
    let faces_m = foundation.faces_m().map(|face_m| face_m - from_m).filter(|face_m| *face_m > begin_m);
    for face_m in faces_m.chain([f64::INFINITY]) {
        let middle_m = if face_m.is_finite() { 0.5 * (start_m + face_m) } else { 2.0 * start_m };
        // Weights of places are even in the reciprocal of the distance.
        let (near_ratio, face_ratio) = (begin_m / start_m, begin_m / face_m);
        let depth_at = |share: f64| from_m + begin_m / (face_ratio + share * (near_ratio - face_ratio));
        let grown = middles().map(|share| growth(depth_at(share))).sum::<f64>() / PARTS as f64;
        far_part += grown * foundation.layer_pa(from_m + middle_m) * (near_ratio - face_ratio);
        start_m = face_m;
    }
    if let Some(last) = means.last_mut() {
        *last = far_part;
    }
    Some(means)
}

/// Mean modulus from where the body begins to a block's far side.
fn mean_of_block_pa(foundation: &Foundation, from_m: f64, length_m: f64) -> f64 {
    let weighted_pa =
        quadrature::points(from_m, length_m).map(|(at_m, weight)| weight * foundation.modulus_pa(at_m));
    weighted_pa.sum::<f64>() / (length_m - from_m)
}

/// Depth of a body's free surface: the depth of the gap above which nothing supports the needle.
pub(super) fn surface_m(foundation: &Foundation) -> f64 {
    foundation.gap_m()
}

#[cfg(test)]
mod tests;
