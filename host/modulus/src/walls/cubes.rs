//! K/E over the size of a block: what a lab has to know before it pours a gel.

use mechanics::body::rigid_ratio;
use mechanics::{Block, ModelError, Mounting, Needle};
use serde::Serialize;

/// Edges of the cubes; those that the needle would reach through are left out.
const EDGES_MM: [f64; 13] =
    [30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 100.0, 120.0, 150.0, 180.0, 220.0, 260.0, 300.0];

/// K/E of a needle that does not bend, in the middle of cubes with a held far side.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Cubes {
    /// Insertion depth.
    pub depth_mm: f64,
    /// Poisson's ratio.
    pub poisson: f64,
    /// K/E in a half space.
    pub half_space: f64,
    /// Edges of the cubes.
    pub edge_mm: Vec<f64>,
    /// K/E in each with sides that are held.
    pub held: Vec<f64>,
    /// The same with free sides.
    pub free: Vec<f64>,
}

impl Cubes {
    /// Cubes for a needle at a depth.
    ///
    /// # Errors
    /// As [`rigid_ratio`].
    pub fn new(needle: &Needle, depth_m: f64, poisson: f64) -> Result<Self, ModelError> {
        let edge_mm: Vec<f64> =
            EDGES_MM.into_iter().filter(|edge_mm| 1e-3 * edge_mm * Block::DEEPEST >= depth_m).collect();
        let ratios = |sides: Mounting| -> Result<Vec<f64>, ModelError> {
            edge_mm
                .iter()
                .map(|edge_mm| {
                    rigid_ratio(needle, depth_m, poisson, Some(&Block::cube(1e-3 * edge_mm, sides)))
                })
                .collect()
        };
        Ok(Self {
            depth_mm: 1e3 * depth_m,
            poisson,
            half_space: rigid_ratio(needle, depth_m, poisson, None)?,
            held: ratios(Mounting::Held)?,
            free: ratios(Mounting::Free)?,
            edge_mm,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn held_cubes_soften_with_size_towards_the_half_space_and_free_ones_give_more_than_it() {
        let cubes = Cubes::new(&Needle::gauge_18(), 0.03, 0.5).expect("cubes");
        assert_eq!(cubes.edge_mm.first(), Some(&40.0), "30 mm are no place for a needle of 30 mm");
        assert!(cubes.held.windows(2).all(|pair| pair[0] > pair[1]), "{cubes:?}");
        assert!(cubes.held.iter().all(|ratio| *ratio > cubes.half_space));
        assert!(cubes.free.iter().all(|ratio| *ratio < cubes.half_space));
        // The manual's table.
        assert!((cubes.held[2] - 1.24).abs() < 0.01 && (cubes.free[2] - 0.42).abs() < 0.01, "{cubes:?}");
        let deep = Cubes::new(&Needle::gauge_18(), 0.29, 0.5).expect("a half space");
        assert!(deep.edge_mm.is_empty());
    }
}
