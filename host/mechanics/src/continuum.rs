//! Foundation modulus and Young's modulus from first principles: the needle in an elastic half space instead of on springs.
//!
//! The body is linear elastic, the needle a beam bonded to it (or touched on one side only, [`contact`]), the surface
//! free.

pub mod contact;
mod fields;
mod mesh;
pub mod operator;
mod solve;
mod sparse;

pub use mesh::Resolution;
pub use solve::WallStiffness;

use crate::body::{flexibility_per_m, nodes_with_walls};
use crate::elements::Deformed;
use crate::{Block, ModelError, Needle, Rig, check};
use mesh::Mesh;
use nalgebra::{DMatrix, DVector};

/// Contact between tissue and needle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Contact {
    /// All around.
    Bonded,
    /// On the side it is pushed to only, without friction, in a hole of its own diameter.
    OneSided,
}

impl Contact {
    /// Stiffness over that of a bonded needle, by depth over radius and Poisson's ratio.
    fn share(self, ratio: f64, poisson: f64) -> f64 {
        match self {
            Self::Bonded => 1.0,
            Self::OneSided => contact::tabulated_share(ratio, poisson),
        }
    }

    /// Relative uncertainty of the contact's share, at 95 %: mesh, harmonics, and that the needle bends.
    pub fn relative_error(self) -> f64 {
        match self {
            Self::Bonded => 0.0,
            Self::OneSided => contact::RELATIVE_ERROR,
        }
    }
}

/// Depths over needle radius for which the relation is computed.
pub const RATIO_RANGE: [f64; 2] = [10.0, 600.0];
/// Young's moduli for which it is, Pa: between them the body is neither nothing beside the needle nor as good as rigid.
pub const YOUNGS_RANGE_PA: [f64; 2] = [100.0, 1e6];

/// Refuses Young's moduli for which the relation is not computed.
///
/// # Errors
/// [`ModelError::OutOfRange`].
pub fn check_youngs(youngs_pa: f64) -> Result<(), ModelError> {
    let [least, most] = YOUNGS_RANGE_PA;
    let is_in_range = (least..=most).contains(&youngs_pa);
    check("youngs_modulus_kpa", 1e-3 * youngs_pa, "0.1 to 1000, for which K/E is computed", is_in_range)
}

/// A needle in an elastic half space: solved once, for any Young's modulus.
#[derive(Debug, Clone)]
pub struct Continuum {
    wall: WallStiffness,
    depth_m: f64,
    radius_m: f64,
    poisson: f64,
    contact: Contact,
    /// Flexibility that walls add, per unit of Young's modulus.
    added: Option<[[f64; operator::MODES]; operator::MODES]>,
}

impl Continuum {
    /// Solves the body around a needle inserted to `depth_m`.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] for a depth outside [`RATIO_RANGE`] or a Poisson's ratio outside 0 to 0.5,
    /// [`ModelError::Singular`].
    pub fn solve(
        needle: &Needle,
        depth_m: f64,
        poisson: f64,
        contact: Contact,
        resolution: Resolution,
    ) -> Result<Self, ModelError> {
        Self::in_body(needle, depth_m, poisson, contact, resolution, false)
    }

    /// With the stiffness of the wall of a needle of a radius as `wall` has it.
    pub(crate) fn with_wall(
        needle: &Needle,
        depth_m: f64,
        poisson: f64,
        contact: Contact,
        wall: impl FnOnce(f64) -> Result<WallStiffness, ModelError>,
    ) -> Result<Self, ModelError> {
        let radius_m = 0.5 * needle.outer_diameter_m;
        check("poisson", poisson, "0 to 0.5", (0.0..=0.5).contains(&poisson))?;
        let [least, most] = RATIO_RANGE;
        let is_in_range = (least..=most).contains(&(depth_m / radius_m));
        check(
            "depth over needle radius",
            depth_m / radius_m,
            "10 to 600, for which K/E is computed",
            is_in_range,
        )?;
        Ok(Self { wall: wall(radius_m)?, depth_m, radius_m, poisson, contact, added: None })
    }

    fn in_body(
        needle: &Needle,
        depth_m: f64,
        poisson: f64,
        contact: Contact,
        resolution: Resolution,
        full_space: bool,
    ) -> Result<Self, ModelError> {
        Self::with_wall(needle, depth_m, poisson, contact, |radius_m| {
            solve::wall_stiffness(&Mesh::new(radius_m, depth_m, resolution, full_space), poisson)
        })
    }

    /// The same needle in a block instead of a half space.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] where the block is none or the tip too near its far side, [`ModelError::Singular`].
    pub fn in_block(self, block: Option<Block>) -> Result<Self, ModelError> {
        let added = block
            .map(|block| flexibility_per_m(&block, self.poisson, self.radius_m, [0.0, self.depth_m]))
            .transpose()?;
        Ok(Self { added, ..self })
    }

    /// Stiffness against the nodes' deflections per unit of Young's modulus, with the contact and the walls.
    fn stiffness_m(&self) -> Result<DMatrix<f64>, ModelError> {
        let matrix_m = &self.wall.matrix_m * self.share();
        // Symmetric to rounding; a factorisation needs it to the bit.
        let matrix_m = 0.5 * (&matrix_m + matrix_m.transpose());
        let Some(added) = &self.added else { return Ok(matrix_m) };
        let depths_m = &self.wall.depths_m;
        let patterns = DMatrix::from_fn(depths_m.len(), operator::MODES, |node, i| {
            operator::legendre(i, self.normalized_depth(&depths_m[node]))[0]
        });
        nodes_with_walls(matrix_m, &patterns, added)
    }

    /// Depth from -1 at the surface to 1 at the tip.
    fn normalized_depth(&self, depth_m: &f64) -> f64 {
        2.0 * depth_m / self.depth_m - 1.0
    }

    /// Ratio K/E of a rigid needle that moves sideways as a whole.
    ///
    /// # Errors
    /// [`ModelError::Singular`] where the walls leave no body.
    pub fn rigid_ratio(&self) -> Result<f64, ModelError> {
        Ok(self.stiffness_m()?.sum() / self.depth_m)
    }

    fn share(&self) -> f64 {
        self.contact.share(self.depth_m / self.radius_m, self.poisson)
    }

    /// Inserted length.
    pub fn depth_m(&self) -> f64 {
        self.depth_m
    }

    /// The same body with another contact.
    pub fn with_contact(&self, contact: Contact) -> Self {
        Self { contact, ..self.clone() }
    }

    /// Lateral stiffness at guide 2 of the needle of `rig` in a body of this Young's modulus, N/m.
    ///
    /// # Errors
    /// As [`Self::response`].
    pub fn lateral_stiffness_n_per_m(&self, rig: &Rig, youngs_pa: f64) -> Result<f64, ModelError> {
        Ok(1.0 / self.response(rig, youngs_pa)?.deflection_m(rig.guide2_m))
    }

    /// The needle of `rig` in a body of this Young's modulus under 1 N at guide 2.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`], [`ModelError::Singular`].
    pub fn response(&self, rig: &Rig, youngs_pa: f64) -> Result<Deformed, ModelError> {
        check("youngs_modulus_pa", youngs_pa, "more than 0", youngs_pa > 0.0)?;
        // An only guide is where the needle begins.
        let guide2 = usize::from(!rig.has_one_guide());
        let mut nodes_m = if rig.has_one_guide() { vec![0.0] } else { vec![0.0, rig.guide2_m] };
        if rig.entry_m > rig.guide2_m {
            nodes_m.push(rig.entry_m);
        }
        let entry = nodes_m.len() - 1;
        nodes_m.extend(self.wall.depths_m.iter().skip(1).map(|depth_m| rig.entry_m + depth_m));
        let size = 2 * nodes_m.len();
        let mut stiffness = DMatrix::zeros(size, size);
        for (element, ends) in nodes_m.windows(2).enumerate() {
            let bending =
                crate::elements::bending_stiffness(rig.needle.bending_stiffness_n_m2(), ends[1] - ends[0]);
            for (i, row) in bending.iter().enumerate() {
                for (j, value) in row.iter().enumerate() {
                    stiffness[(2 * element + i, 2 * element + j)] += value;
                }
            }
        }
        let body_m = self.stiffness_m()?;
        for i in 0..self.wall.depths_m.len() {
            for j in 0..self.wall.depths_m.len() {
                stiffness[(2 * (entry + i), 2 * (entry + j))] += youngs_pa * body_m[(i, j)];
            }
        }
        let compliance = rig.rear_compliance_rad_per_n_m(0);
        if compliance > 0.0 {
            stiffness[(1, 1)] += 1.0 / compliance;
        }
        let free: Vec<usize> = (0..size)
            .filter(|row| match row {
                0 => guide2 == 0,
                1 => guide2 == 0 && compliance > 0.0,
                _ => true,
            })
            .collect();
        let matrix = DMatrix::from_fn(free.len(), free.len(), |i, j| stiffness[(free[i], free[j])]);
        let load = DVector::from_iterator(
            free.len(),
            free.iter().map(|row| if *row == 2 * guide2 { 1.0 } else { 0.0 }),
        );
        let solution = matrix.cholesky().ok_or(ModelError::Singular)?.solve(&load);
        let mut states = vec![[0.0; 2]; nodes_m.len()];
        for (row, value) in free.iter().zip(solution.iter()) {
            states[row / 2][row % 2] = *value;
        }
        Ok(Deformed::new(nodes_m, states, 1.0))
    }
}

#[cfg(test)]
#[path = "continuum/tests.rs"]
mod tests;
