//! A body that gives as a whole, or is held by walls far away: the flexibility of one mode beside that of the half space (theory, eq. 15).

use super::table::{MODES, Matrix};
use crate::problem::Give;
use crate::{ModelError, check};

/// A needle that walls hold is stiffer than in a half space by no more than the reciprocal: nearer walls are no correction.
const LEAST_SHARE: f64 = 0.2;

/// Stiffness of a body whose tissue moves by `give` under the forces of a needle from `from_m` to `from_m + depth_m` below the surface:
/// `(S^-1 + a v v^T)^-1`, where v is the motion in the coefficients of the Legendre polynomials.
///
/// # Errors
/// [`ModelError::OutOfRange`] where walls would hold the needle more than walls can.
pub(super) fn with_give(
    stiffness: Matrix,
    give: Give,
    modulus_pa: f64,
    [from_m, depth_m]: [f64; 2],
) -> Result<Matrix, ModelError> {
    if give.per_m == 0.0 || modulus_pa <= 0.0 {
        return Ok(stiffness);
    }
    let mut motion = [0.0; MODES];
    // A line over (-1, 1): its mean, and half its rise.
    let (top, tip) = (turn_factor(from_m, give.turn_per_m), turn_factor(from_m + depth_m, give.turn_per_m));
    (motion[0], motion[1]) = (0.5 * (top + tip), 0.5 * (tip - top));
    let forces: [f64; MODES] =
        std::array::from_fn(|i| stiffness[i].iter().zip(&motion).map(|(s, v)| s * v).sum());
    let give_per_n = give.per_m / modulus_pa;
    let reduction = 1.0 + give_per_n * forces.iter().zip(&motion).map(|(f, v)| f * v).sum::<f64>();
    check(
        "give_per_m",
        give.per_m,
        "walls that hold the needle to five times its stiffness at most",
        reduction > LEAST_SHARE,
    )?;
    Ok(std::array::from_fn(|i| {
        std::array::from_fn(|j| stiffness[i][j] - give_per_n * forces[i] * forces[j] / reduction)
    }))
}

/// Displacement at a depth per displacement of the surface, as the body turns about its foot.
fn turn_factor(depth_m: f64, turn_per_m: f64) -> f64 {
    1.0 - turn_per_m * depth_m
}

#[cfg(test)]
mod tests {
    use super::super::table::uniform;
    use super::*;
    use crate::body::flexibility_per_m;
    use crate::{Block, Mounting};

    const RADIUS_M: f64 = 0.635e-3;

    /// Share of a rigid needle's stiffness in a block that a give of one size for all depths has.
    #[test]
    fn one_give_is_a_box_at_several_depths() {
        for (edge_m, tolerance) in [(0.06, 0.1), (0.1, 0.03)] {
            let block = Block::cube(edge_m, Mounting::Held);
            let give = Give { per_m: flexibility_at(0.03, block), turn_per_m: 0.0 };
            for depth_m in [0.02, 0.03, 0.04] {
                let half_space = uniform(depth_m / RADIUS_M, 0.5).map(|row| row.map(|value| value * depth_m));
                let with_box = with_give(half_space, give, 1.0, [0.0, depth_m]).expect("a body");
                let added = flexibility_per_m(&block, 0.5, RADIUS_M, [0.0, depth_m]).expect("solves");
                let walls = super::super::block::with_walls(&half_space, &added).expect("a body");
                let ratio = with_box[0][0] / walls[0][0];
                assert!((ratio - 1.0).abs() < tolerance, "{edge_m} {depth_m}: {ratio}");
                assert!(with_box[0][0] > 1.1 * half_space[0][0]);
            }
        }
    }

    fn flexibility_at(depth_m: f64, block: Block) -> f64 {
        flexibility_per_m(&block, 0.5, RADIUS_M, [0.0, depth_m]).expect("solves")[0][0]
    }

    #[test]
    fn a_column_turns_about_its_foot_and_walls_do_not_hold_without_end() {
        let half_space = uniform(0.03 / RADIUS_M, 0.5).map(|row| row.map(|value| 16e3 * 0.03 * value));
        assert_eq!(body_with(0.0, 5.0, &half_space), Ok(half_space));
        // Springs in series: of the needle in the half space, and of the tissue around it.
        let column = body_with(40.0, 0.0, &half_space).expect("a body");
        let series = 1.0 / (1.0 / half_space[0][0] + 40.0 / 16e3);
        assert!(
            column[0][0] < half_space[0][0] && (column[0][0] / series - 1.0).abs() < 0.05,
            "{}",
            column[0][0]
        );
        // A body that turns about the tip moves half as far on average.
        let turning = body_with(40.0, 1.0 / 0.03, &half_space).expect("a body");
        assert!(turning[0][0] > column[0][0] && turning[0][0] < half_space[0][0]);
        assert!(matches!(
            body_with(-60.0, 0.0, &half_space),
            Err(ModelError::OutOfRange { name: "give_per_m", .. })
        ));
    }

    fn body_with(per_m: f64, turn_per_m: f64, half_space: &Matrix) -> Result<Matrix, ModelError> {
        with_give(*half_space, Give { per_m, turn_per_m }, 16e3, [0.0, 0.03])
    }
}
