//! The needle as cubic beam elements of its own, from the clamp through guide 2 into the body, where it is tied to the wall.

use super::BodyError;
use super::wall::Wall;
use nalgebra::{DMatrix, DVector};

/// Mounting of the needle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Holding {
    pub bending_n_m2: f64,
    pub guide2_m: f64,
    /// Position of the surface.
    pub entry_m: f64,
    /// Compliance of the clamp at 0, rad/(N m).
    pub clamp_rad_per_n_m: f64,
    pub skin_n_per_m: f64,
    pub axial_n: f64,
    pub youngs_pa: f64,
}

/// The needle with guide 2 displaced by one metre.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Bent {
    /// Force of guide 2.
    pub stiffness_n_per_m: f64,
    /// Positions of the nodes, and deflection and slope there.
    pub nodes_m: Vec<f64>,
    pub states: Vec<[f64; 2]>,
}

impl Bent {
    /// Solves the needle in a body.
    ///
    /// # Errors
    /// [`BodyError::Singular`].
    pub fn new(holding: &Holding, wall: &Wall) -> Result<Self, BodyError> {
        let entry = 2;
        let mut nodes_m = vec![0.0, holding.guide2_m];
        nodes_m.extend(wall.depths_m.iter().map(|depth_m| holding.entry_m + depth_m));
        let size = 2 * nodes_m.len();
        let mut stiffness = DMatrix::zeros(size, size);
        for (element, ends) in nodes_m.windows(2).enumerate() {
            let matrix = element_matrix(holding.bending_n_m2, holding.axial_n, ends[1] - ends[0]);
            for (i, row) in matrix.iter().enumerate() {
                for (j, value) in row.iter().enumerate() {
                    stiffness[(2 * element + i, 2 * element + j)] += value;
                }
            }
        }
        let mut tissue = stiffness.view_mut((2 * entry, 2 * entry), wall.stiffness.shape());
        tissue += &wall.stiffness * holding.youngs_pa;
        stiffness[(2 * entry, 2 * entry)] += holding.skin_n_per_m;
        // The clamp: no deflection, and no slope or a spring against it.
        let first = if holding.clamp_rad_per_n_m > 0.0 { 1 } else { 2 };
        if first == 1 {
            stiffness[(1, 1)] += 1.0 / holding.clamp_rad_per_n_m;
        }
        let free = stiffness.view((first, first), (size - first, size - first)).into_owned();
        let mut load = DVector::zeros(size - first);
        load[2 - first] = 1.0;
        let solution = free.cholesky().ok_or(BodyError::Singular)?.solve(&load);
        let stiffness_n_per_m = 1.0 / solution[2 - first];
        let mut flat = vec![0.0; first];
        flat.extend(solution.iter().map(|value| value * stiffness_n_per_m));
        let states = flat.chunks_exact(2).map(|state| [state[0], state[1]]).collect();
        Ok(Self { stiffness_n_per_m, nodes_m, states })
    }

    /// Deflection at a position along the needle per displacement of guide 2.
    pub fn at(&self, z_m: f64) -> f64 {
        let right = self.nodes_m.partition_point(|node_m| *node_m < z_m).clamp(1, self.nodes_m.len() - 1);
        let (left_m, right_m) = (self.nodes_m[right - 1], self.nodes_m[right]);
        let length_m = right_m - left_m;
        if length_m <= 0.0 {
            return self.states[right][0];
        }
        let s = (z_m - left_m) / length_m;
        let ([u0, slope0], [u1, slope1]) = (self.states[right - 1], self.states[right]);
        let (s2, s3) = (s * s, s * s * s);
        (1.0 - 3.0 * s2 + 2.0 * s3) * u0
            + (s - 2.0 * s2 + s3) * length_m * slope0
            + (3.0 * s2 - 2.0 * s3) * u1
            + (s3 - s2) * length_m * slope1
    }
}

/// Bending of a cubic element, less the work of an axial load.
pub(super) fn element_matrix(bending_n_m2: f64, axial_n: f64, length_m: f64) -> [[f64; 4]; 4] {
    let l = length_m;
    let bending = bending_n_m2 / l.powi(3);
    let axial = axial_n / (30.0 * l);
    let bent = [
        [12.0, 6.0 * l, -12.0, 6.0 * l],
        [6.0 * l, 4.0 * l * l, -6.0 * l, 2.0 * l * l],
        [-12.0, -6.0 * l, 12.0, -6.0 * l],
        [6.0 * l, 2.0 * l * l, -6.0 * l, 4.0 * l * l],
    ];
    let integrals = [
        [36.0, 3.0 * l, -36.0, 3.0 * l],
        [3.0 * l, 4.0 * l * l, -3.0 * l, -l * l],
        [-36.0, -3.0 * l, 36.0, -3.0 * l],
        [3.0 * l, -l * l, -3.0 * l, 4.0 * l * l],
    ];
    std::array::from_fn(|i| std::array::from_fn(|j| bending * bent[i][j] - axial * integrals[i][j]))
}
