//! Sessions in a block of tissue whose stiffness three-dimensional finite elements of another library have computed
//! (`tests/studies/finite_elements/blocks.py`): the body is a matrix, the needle a beam that bends with it.

use super::beam::{Bent, Holding, element_matrix};
use super::{BodyError, march, recorded};
use crate::chain::{STEP_M, node_at};
use crate::flaws::Flaws;
use crate::sensors::{self, LateralPart};
use crate::world::World;
use crate::{Background, Design, MM, Truth};
use formats::session::Session;
use mechanics::{Needle, Rig};
use nalgebra::{DMatrix, DVector};

/// Legendre polynomials of degree 0 to 5 over the needle's depth.
pub const DEGREES: usize = 6;
/// Unknowns above the body: deflection and slope at guide 2.
const ABOVE: usize = 2;
/// Nodes of the shape in the body.
const NODES: usize = 48;
/// Gauss points on (-1, 1) and weights: exact for products of second derivatives.
const GAUSS: [[f64; 2]; 4] = [
    [-0.861_136_311_594_052_6, 0.347_854_845_137_453_85],
    [-0.339_981_043_584_856_3, 0.652_145_154_862_546_1],
    [0.339_981_043_584_856_3, 0.652_145_154_862_546_1],
    [0.861_136_311_594_052_6, 0.347_854_845_137_453_85],
];

/// A block around a needle at one depth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlockStiffness {
    /// Depth of the needle.
    pub depth_mm: f64,
    /// Against Legendre polynomials over the depth, per unit of Young's modulus and of depth.
    pub matrix: [[f64; DEGREES]; DEGREES],
}

impl BlockStiffness {
    /// Session that a laboratory would record in a block: runs along y, each with the stiffness at the depth that is nearest to its own.
    ///
    /// # Errors
    /// [`BodyError::Singular`]; [`BodyError::NoDepth`] without a depth.
    pub fn session(
        at_depths: &[Self],
        youngs_kpa: f64,
        design: &Design,
        seed: u64,
    ) -> Result<Session, BodyError> {
        let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
        let truth = Truth { k_kpa: youngs_kpa, tip_load_n: 0.0, effects: Vec::new(), foreign: None };
        let (world, background) = (World::new(&truth, &rig), Background::default());
        let mut lateral = Vec::new();
        for (run, plan) in (0..).zip(&design.lateral) {
            let depth_m = STEP_M * node_at(MM * plan.depth_mm) as f64;
            let flaws = Flaws::new(&background, run);
            let distance_mm = |stiffness: &Self| (stiffness.depth_mm - plan.depth_mm).abs();
            let nearest = at_depths.iter().min_by(|a, b| distance_mm(a).total_cmp(&distance_mm(b)));
            let bent = nearest.ok_or(BodyError::NoDepth)?.bent(&super::holding(&world, 0), depth_m)?;
            let lateral_part = LateralPart {
                world: &world,
                flaws: &flaws,
                plan,
                noise: &design.noise,
                images: None,
                seed,
                run,
            };
            lateral.push(sensors::lateral_run(
                &lateral_part,
                &|plane: usize, commanded_m: &[f64], keep: &[usize]| {
                    march(&world, plane, &bent, depth_m, commanded_m, keep)
                },
            ));
        }
        Ok(recorded(rig, &design.noise, lateral))
    }

    /// The needle in it, with guide 2 displaced by one metre: cubic above the surface, one polynomial below it.
    fn bent(&self, holding: &Holding, depth_m: f64) -> Result<Bent, BodyError> {
        let size = ABOVE + DEGREES;
        let mut stiffness = DMatrix::zeros(size, size);
        let first = element_matrix(holding.bending_n_m2, holding.axial_n, holding.guide2_m);
        // The clamp holds deflection and slope at the first node.
        for i in 0..2 {
            for j in 0..2 {
                stiffness[(i, j)] += first[2 + i][2 + j];
            }
        }
        let at_surface = polynomials(-1.0);
        let (slope_factor, half_m) = (2.0 / depth_m, 0.5 * depth_m);
        let tied = DMatrix::from_fn(4, size, |row, column| match (row, column) {
            (0 | 1, _) => f64::from(u8::from(row == column)),
            (2, degree) if degree >= ABOVE => at_surface[degree - ABOVE][0],
            (3, degree) if degree >= ABOVE => slope_factor * at_surface[degree - ABOVE][1],
            _ => 0.0,
        });
        let second =
            element_matrix(holding.bending_n_m2, holding.axial_n, holding.entry_m - holding.guide2_m);
        stiffness += tied.tr_mul(&(DMatrix::from_fn(4, 4, |i, j| second[i][j]) * &tied));
        for [x, weight] in GAUSS {
            let values = polynomials(x);
            for i in 0..DEGREES {
                for j in 0..DEGREES {
                    let curved = values[i][2] * values[j][2] * slope_factor.powi(4);
                    stiffness[(ABOVE + i, ABOVE + j)] += holding.bending_n_m2 * weight * half_m * curved;
                }
            }
        }
        for i in 0..DEGREES {
            for j in 0..DEGREES {
                stiffness[(ABOVE + i, ABOVE + j)] += holding.youngs_pa * depth_m * self.matrix[i][j];
            }
        }
        let load = DVector::from_fn(size, |row, _| f64::from(u8::from(row == 0)));
        let solution = stiffness.cholesky().ok_or(BodyError::Singular)?.solve(&load);
        let stiffness_n_per_m = 1.0 / solution[0];
        let scaled = solution * stiffness_n_per_m;
        let mut nodes_m = vec![0.0, holding.guide2_m];
        let mut states = vec![[0.0, 0.0], [scaled[0], scaled[1]]];
        for node in 0..=NODES {
            let x = -1.0 + 2.0 * node as f64 / NODES as f64;
            nodes_m.push(holding.entry_m + half_m * (1.0 + x));
            states.push([sum(0, x, &scaled), slope_factor * sum(1, x, &scaled)]);
        }
        Ok(Bent { stiffness_n_per_m, nodes_m, states })
    }
}

fn sum(derivative: usize, x: f64, scaled: &DVector<f64>) -> f64 {
    polynomials(x).iter().enumerate().map(|(i, of)| scaled[ABOVE + i] * of[derivative]).sum()
}

/// Legendre polynomials with two derivatives.
fn polynomials(x: f64) -> [[f64; 3]; DEGREES] {
    let mut values_and_slopes = [[0.0; 3]; DEGREES];
    (values_and_slopes[0], values_and_slopes[1]) = ([1.0, 0.0, 0.0], [x, 1.0, 0.0]);
    for n in 1..DEGREES - 1 {
        let degree = n as f64;
        let factor = 2.0 * degree + 1.0;
        values_and_slopes[n + 1] = [
            (factor * x * values_and_slopes[n][0] - degree * values_and_slopes[n - 1][0]) / (degree + 1.0),
            values_and_slopes[n - 1][1] + factor * values_and_slopes[n][0],
            values_and_slopes[n - 1][2] + factor * values_and_slopes[n][1],
        ];
    }
    values_and_slopes
}

#[cfg(test)]
mod tests {
    use super::super::mesh::Mesh;
    use super::super::{Fineness, wall};
    use super::*;

    /// The body of revolution as such a matrix bends the needle as it does itself.
    #[test]
    fn six_polynomials_are_the_body() {
        let depth_m = 0.03;
        let mesh = Mesh::new(0.635e-3, depth_m, &[0.0], Fineness::COARSE);
        let body = wall::solve(&mesh, 0.49, &|_| 1.0).expect("a body");
        let patterns = DMatrix::from_fn(2 * body.depths_m.len(), DEGREES, |row, degree| {
            let values = polynomials(2.0 * body.depths_m[row / 2] / depth_m - 1.0)[degree];
            if row % 2 == 0 { values[0] } else { 2.0 / depth_m * values[1] }
        });
        let projected = patterns.tr_mul(&(&body.stiffness * &patterns)) / depth_m;
        let matrix = std::array::from_fn(|i| std::array::from_fn(|j| projected[(i, j)]));
        let block = BlockStiffness { depth_mm: 1e3 * depth_m, matrix };
        let holding = Holding {
            bending_n_m2: Needle::gauge_18().bending_stiffness_n_m2(),
            guide2_m: 0.06,
            entry_m: 0.07,
            clamp_rad_per_n_m: 0.0,
            skin_n_per_m: 0.0,
            axial_n: 0.0,
            youngs_pa: 20e3,
        };
        let (whole, few) =
            (Bent::new(&holding, &body).expect("bends"), block.bent(&holding, depth_m).expect("bends"));
        assert!((few.stiffness_n_per_m / whole.stiffness_n_per_m - 1.0).abs() < 1e-3);
        for z_m in [0.06, 0.07, 0.078, 0.09, 0.1] {
            assert!((few.at(z_m) - whole.at(z_m)).abs() < 1e-3, "{z_m}: {} {}", few.at(z_m), whole.at(z_m));
        }
    }
}
