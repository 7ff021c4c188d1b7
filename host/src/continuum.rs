//! Foundation modulus and Young's modulus from first principles: the needle in an elastic half space instead of on springs.
//!
//! The body is linear elastic, the needle a beam bonded to it (or touched on one side only, at half the stiffness), the surface
//! free. The relation is the foundation modulus K of the beam on springs that is as stiff at guide 2 as the needle in the body:
//! it depends on needle, depth, Poisson's ratio and guide positions, and on Young's modulus itself, through the needle's
//! flexibility (`model.md`, section 6).

mod mesh;
mod solve;

pub use mesh::Resolution;
pub use solve::WallStiffness;

use crate::model::{Beam, Foundation, ModelError, Needle, Rig, check};
use mesh::Mesh;
use nalgebra::{DMatrix, DVector};

/// How the tissue holds the needle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Contact {
    /// All around.
    Bonded,
    /// On the side it is pushed to only: half the stiffness.
    OneSided,
}

impl Contact {
    fn share(self) -> f64 {
        match self {
            Self::Bonded => 1.0,
            Self::OneSided => 0.5,
        }
    }
}

/// A needle in an elastic half space: solved once, for any Young's modulus.
#[derive(Debug, Clone)]
pub struct Continuum {
    wall: WallStiffness,
    depth_m: f64,
    contact: Contact,
}

impl Continuum {
    /// Solves the body around a needle inserted to `depth_m`.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] for a depth of fewer than ten needle radii or a Poisson's ratio outside 0 to 0.5,
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

    fn in_body(
        needle: &Needle,
        depth_m: f64,
        poisson: f64,
        contact: Contact,
        resolution: Resolution,
        full_space: bool,
    ) -> Result<Self, ModelError> {
        let radius_m = 0.5 * needle.outer_diameter_m;
        check("poisson", poisson, "0 to 0.5", (0.0..=0.5).contains(&poisson))?;
        check("depth_m", depth_m, "ten needle radii to 1 m", (10.0 * radius_m..=1.0).contains(&depth_m))?;
        let mesh = Mesh::new(radius_m, depth_m, resolution, full_space);
        Ok(Self { wall: solve::wall_stiffness(&mesh, poisson)?, depth_m, contact })
    }

    /// Ratio K/E of a rigid needle that moves sideways as a whole.
    pub fn rigid_ratio(&self) -> f64 {
        self.contact.share() * self.wall.matrix_m.sum() / self.depth_m
    }

    /// Lateral stiffness at guide 2 of the needle of `rig` in a body of this Young's modulus, N/m.
    ///
    /// # Errors
    /// [`ModelError::Singular`].
    pub fn lateral_stiffness_n_per_m(&self, rig: &Rig, youngs_pa: f64) -> Result<f64, ModelError> {
        check("youngs_modulus_pa", youngs_pa, "more than 0", youngs_pa > 0.0)?;
        let mut nodes_m = vec![0.0, rig.guide2_m];
        if rig.entry_m > rig.guide2_m {
            nodes_m.push(rig.entry_m);
        }
        let entry = nodes_m.len() - 1;
        nodes_m.extend(self.wall.depths_m.iter().skip(1).map(|depth_m| rig.entry_m + depth_m));
        let size = 2 * nodes_m.len();
        let mut stiffness = DMatrix::zeros(size, size);
        for (element, ends) in nodes_m.windows(2).enumerate() {
            let bending = crate::model::elements::bending_stiffness(
                rig.needle.bending_stiffness_n_m2(),
                ends[1] - ends[0],
            );
            for (i, row) in bending.iter().enumerate() {
                for (j, value) in row.iter().enumerate() {
                    stiffness[(2 * element + i, 2 * element + j)] += value;
                }
            }
        }
        let scale = self.contact.share() * youngs_pa;
        for i in 0..self.wall.depths_m.len() {
            for j in 0..self.wall.depths_m.len() {
                // Symmetric to rounding; the factorisation wants it to the bit.
                let value = 0.5 * (self.wall.matrix_m[(i, j)] + self.wall.matrix_m[(j, i)]);
                stiffness[(2 * (entry + i), 2 * (entry + j))] += scale * value;
            }
        }
        let free = stiffness.view((2, 2), (size - 2, size - 2)).into_owned();
        let mut load = DVector::zeros(size - 2);
        load[0] = 1.0;
        let solution = free.cholesky().ok_or(ModelError::Singular)?.solve(&load);
        Ok(1.0 / solution[0])
    }

    /// Foundation modulus that makes the beam on springs as stiff at guide 2 as the needle in the body.
    ///
    /// # Errors
    /// [`ModelError`] where either cannot be solved.
    pub fn foundation_modulus_pa(&self, rig: &Rig, youngs_pa: f64) -> Result<f64, ModelError> {
        let wanted = self.lateral_stiffness_n_per_m(rig, youngs_pa)?;
        // The stiffness rises with K; K/E lies far within these bounds.
        let (mut low, mut high) = ((1e-3 * youngs_pa).ln(), (1e2 * youngs_pa).ln());
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            let beam = Beam::solve(rig, &Foundation::uniform(middle.exp())?, self.depth_m)?;
            if beam.lateral_stiffness_n_per_m() < wanted { low = middle } else { high = middle }
        }
        Ok((0.5 * (low + high)).exp())
    }
}

#[cfg(test)]
#[path = "continuum/tests.rs"]
mod tests;
