//! A body with walls: the gel as a block, with its size, the place of the needle in it and how it is held.

use super::{ModelError, check};

/// Mounting of a wall of the block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mounting {
    /// The wall is free.
    Free,
    /// It is bonded to something rigid: a box, a plate.
    Held,
}

impl Mounting {
    /// Both of them.
    pub const ALL: [Self; 2] = [Self::Free, Self::Held];

    /// Its name in files and options.
    pub fn name(self) -> &'static str {
        match self {
            Self::Free => "free",
            Self::Held => "held",
        }
    }
}

/// A block of tissue with a free surface, which the needle enters at a right angle and parallel to its sides.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Block {
    /// Width along x, height along y and length along the needle.
    pub size_m: [f64; 3],
    /// Point at which the needle enters: from the corner of least x and y.
    pub needle_at_m: [f64; 2],
    /// The four sides.
    pub sides: Mounting,
    /// The wall opposite to the surface.
    pub far_side: Mounting,
}

impl Block {
    /// Smallest and largest edge, m. Below, walls are as near as the entry; above, they change nothing that can be measured.
    pub const EDGE_RANGE_M: [f64; 2] = [5e-3, 2.0];
    /// Share of the length down to which its response is computed.
    pub const DEEPEST: f64 = 0.9;
    /// The needle is at least this share of the shortest edge away from every side: what the tests against finite elements reach to.
    pub const NEAREST_SIDE: f64 = 0.1;

    /// Relative error of K/E in a block, 95 %: drawn blocks against three-dimensional finite elements (theory, eq. 15).
    pub const RELATIVE_ERROR: f64 = 0.025;

    /// A cube with the needle in the middle of its surface and a far side that is held.
    pub fn cube(edge_m: f64, sides: Mounting) -> Self {
        Self { size_m: [edge_m; 3], needle_at_m: [0.5 * edge_m; 2], sides, far_side: Mounting::Held }
    }

    /// Worst case of an unknown block: a box whose sides are little further from the needle than half its depth, or a
    /// column that stands free, twice as wide as the needle is deep and twice as long as that. Among 30 drawn blocks of
    /// 40 to 200 mm (theory, eq. 15) none holds a needle more, and two give more, both longer than twice their width.
    pub fn around(depth_m: f64, sides: Mounting) -> Self {
        let [least_m, most_m] = Self::EDGE_RANGE_M;
        let [width_m, length_m] = match sides {
            Mounting::Held => [1.2, 2.0],
            Mounting::Free => [2.0, 4.0],
        }
        .map(|depths: f64| (depths * depth_m).clamp(least_m, most_m));
        Self { size_m: [width_m, width_m, length_m], ..Self::cube(width_m, sides) }
    }

    /// Refuses what no block can be.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`].
    pub fn check(&self) -> Result<(), ModelError> {
        let [least_m, most_m] = Self::EDGE_RANGE_M;
        for edge_m in self.size_m {
            check("body_mm", 1e3 * edge_m, "edges of 5 to 2000 mm", (least_m..=most_m).contains(&edge_m))?;
        }
        let [width_m, height_m, length_m] = self.size_m;
        let nearest_side_m = (1.0 - 1e-9) * Self::NEAREST_SIDE * width_m.min(height_m).min(length_m);
        for (at_m, edge_m) in self.needle_at_m.into_iter().zip([width_m, height_m]) {
            check(
                "needle_at_mm",
                1e3 * at_m,
                "a place inside the block, a tenth of its shortest edge or more from every side",
                at_m >= nearest_side_m && edge_m - at_m >= nearest_side_m,
            )?;
        }
        let is_held = self.sides == Mounting::Held || self.far_side == Mounting::Held;
        check("far_side", f64::from(u8::from(is_held)), "held where the sides are free", is_held)
    }

    /// The block as the other plane sees it: x for y.
    #[must_use]
    pub fn turned(self) -> Self {
        let ([width_m, height_m, length_m], [x_m, y_m]) = (self.size_m, self.needle_at_m);
        Self { size_m: [height_m, width_m, length_m], needle_at_m: [y_m, x_m], ..self }
    }
}
