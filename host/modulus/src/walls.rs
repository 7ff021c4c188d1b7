//! Walls of the tissue in Young's modulus: the block that a session states, and what E may be off by where it states none, because K/E of a
//! block differs from that of a half space by tens of per cent (theory, eq. 15).

mod cubes;

pub use cubes::Cubes;

use formats::session::Walls;
use mechanics::body::unknown_walls;
use mechanics::{Block, ModelError, Mounting, Needle};
use serde::Serialize;
use std::fmt::{self, Display};

/// Statement about the walls, as documents have it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WallsResult {
    /// `block`, `far` where no wall is near, `in_model` where they are not stated and their effect is in the model, or `not_stated`.
    pub stated: &'static str,
    /// The block; nothing for a half space.
    pub block: Option<BlockResult>,
    /// Possible error of E; `None` if walls are stated, or no block of this depth is modelled.
    pub not_stated: Option<UnknownWalls>,
}

impl WallsResult {
    /// For runs down to this depth.
    pub fn new(walls: Option<Walls>, needle: &Needle, deepest_m: f64, poisson: f64) -> Self {
        let (stated, block) = match walls {
            Some(Walls::Block(block)) => ("block", Some(block)),
            Some(Walls::Far) => ("far", None),
            None => (NOT_STATED, None),
        };
        Self {
            stated,
            block: block.map(BlockResult::from),
            not_stated: if walls.is_none() { tabulated_walls(deepest_m, poisson, needle) } else { None },
        }
    }

    /// The same beside a model: where that has the effect of walls it is in E, as far as one mode is the walls. It is
    /// no more than a start: the interval stays as wide as where nothing is known.
    #[must_use]
    pub fn beside<'a>(self, mut effects: impl Iterator<Item = &'a str>) -> Self {
        if !self.is_stated() && effects.any(|id| id == FINITE_BODY) {
            return Self { stated: IN_MODEL, ..self };
        }
        self
    }

    /// Whether the block, or that no wall is near, is stated.
    pub fn is_stated(&self) -> bool {
        self.stated != NOT_STATED && self.stated != IN_MODEL
    }

    /// An interval of E with what the walls may do, or with the error of the block that they are.
    pub fn widened(&self, value: f64, ends: [f64; 2]) -> [f64; 2] {
        if let Some(unknown) = self.not_stated {
            return unknown.widened(ends);
        }
        if self.block.is_none() {
            return ends;
        }
        ends.map(|end| {
            let ln = (end / value).ln();
            value * ln.hypot(Block::RELATIVE_ERROR).copysign(ln).exp()
        })
    }

    /// Remark before every E, for people; `None` if no wall is near.
    pub fn line(&self) -> Option<String> {
        match &self.block {
            Some(block) => Some(block.to_string()),
            None if self.stated == IN_MODEL => {
                Some(format!("not stated; their effect, {FINITE_BODY}, is in the model"))
            }
            None => (!self.is_stated()).then(|| {
                "not stated: E is that of a half space, and may be wrong by half or more".to_owned()
            }),
        }
    }

    /// The sentence that says so, of the interval of a half space; nothing where walls are stated.
    pub fn note(&self, of_half_space_kpa: Option<[f64; 2]>) -> Option<String> {
        if self.is_stated() {
            return None;
        }
        let interval = of_half_space_kpa
            .map_or(String::new(), |[low_kpa, high_kpa]| format!(" ({low_kpa:.2} to {high_kpa:.2} kPa)"));
        let range = match self.not_stated {
            Some(UnknownWalls { edge_mm, held_edge_mm, held, free }) => format!(
                ", and its interval allows for tissue in a box of {held_edge_mm:.0} mm or more (E times {:.2}) and for a free-standing block \
                 {edge_mm:.0} mm wide or more, up to twice as long as wide (times {:.1})",
                held.recip(),
                free.recip()
            ),
            None => ", and may be wrong by half or more".to_owned(),
        };
        let basis = if self.stated == IN_MODEL {
            format!(
                "their effect is in the model ({FINITE_BODY}) as one motion of everything around the needle; E is that with this effect"
            )
        } else {
            "E is that of a half space".to_owned()
        };
        Some(format!(
            "the walls of the tissue are not stated: {basis}{interval}{range}; {STATE_THEM}; K does not depend on them"
        ))
    }
}

/// Walls that are not stated, where a table has this depth and this Poisson's ratio.
fn tabulated_walls(deepest_m: f64, poisson: f64, needle: &Needle) -> Option<UnknownWalls> {
    UnknownWalls::new(needle, deepest_m, poisson).ok()
}

/// The effect of walls that are not stated.
pub const FINITE_BODY: &str = "tissue.finite_body";
/// Name of walls that are in the model by their effect.
const IN_MODEL: &str = "in_model";
/// Name of walls that nothing is stated of.
const NOT_STATED: &str = "not_stated";
/// Advice on the statement that is needed.
pub const STATE_THEM: &str =
    "state body_mm, needle_at_mm, sides and far_side in [tissue], or sides = \"far\" where no wall is near";

/// K/E in a block over that of a half space, where the block is not known.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct UnknownWalls {
    /// Width of the block whose sides are free; it is twice as long.
    pub edge_mm: f64,
    /// Width of the box that holds it.
    pub held_edge_mm: f64,
    /// With sides that are held.
    pub held: f64,
    /// With sides that are free.
    pub free: f64,
}

impl UnknownWalls {
    /// For a needle at this depth.
    ///
    /// # Errors
    /// As [`unknown_walls`].
    pub fn new(needle: &Needle, depth_m: f64, poisson: f64) -> Result<Self, ModelError> {
        let [held_factor, free] = unknown_walls(needle, depth_m, poisson)?.map(f64::recip);
        Ok(Self {
            edge_mm: block_width_mm(Mounting::Free, depth_m),
            held_edge_mm: block_width_mm(Mounting::Held, depth_m),
            held: held_factor,
            free,
        })
    }

    fn widened(&self, [low, high]: [f64; 2]) -> [f64; 2] {
        [low / self.held.max(1.0), high / self.free.min(1.0)]
    }
}

fn block_width_mm(sides: Mounting, depth_m: f64) -> f64 {
    let [width_m, ..] = Block::around(depth_m, sides).size_m;
    1e3 * width_m
}

/// A block of tissue, as documents have it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct BlockResult {
    /// Width along x, height along y and length along the needle.
    pub body_mm: [f64; 3],
    /// Point at which the needle enters, from the corner of least x and y.
    pub needle_at_mm: [f64; 2],
    /// Mounting of the four sides: `free` or `held`.
    pub sides: &'static str,
    /// Mounting of the wall opposite to the surface.
    pub far_side: &'static str,
}

impl From<Block> for BlockResult {
    fn from(block: Block) -> Self {
        Self {
            body_mm: block.size_m.map(rounded_mm),
            needle_at_mm: block.needle_at_m.map(rounded_mm),
            sides: block.sides.name(),
            far_side: block.far_side.name(),
        }
    }
}

/// Millimetres that were read as metres are decimal numbers again.
fn rounded_mm(m: f64) -> f64 {
    (1e12 * m).round() / 1e9
}

impl Display for BlockResult {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ([x, y, z], [at_x, at_y]) = (self.body_mm, self.needle_at_mm);
        let (sides, far_side) = (self.sides, self.far_side);
        write!(
            f,
            "a block of {x:.0} x {y:.0} x {z:.0} mm, needle at {at_x:.0}, {at_y:.0} mm, sides {sides}, far side {far_side}"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn walls(stated: Option<Walls>, deepest_m: f64) -> WallsResult {
        WallsResult::new(stated, &Needle::gauge_18(), deepest_m, 0.5)
    }

    #[test]
    fn what_is_not_stated_widens_both_ways_and_is_said() {
        let unknown = walls(None, 0.03);
        let [low, high] = unknown.widened(10.5, [10.0, 11.0]);
        assert!(low < 6.0 && high > 100.0, "{low} {high}");
        let note = unknown.note(Some([10.0, 11.0])).expect("a note");
        assert!(note.contains("10.00 to 11.00 kPa") && note.contains("body_mm"), "{note}");
        // Deeper than any block that is modelled: no number, but not silent.
        let shallow = walls(None, 5.0);
        assert!(
            shallow.not_stated.is_none()
                && shallow.note(None).is_some_and(|note| note.contains("wrong by half"))
        );
    }

    #[test]
    fn what_is_stated_is_said_and_has_the_error_of_its_block() {
        let block = Block::cube(0.06, Mounting::Held);
        let no_wall = walls(Some(Walls::Far), 0.03);
        assert_eq!((no_wall.stated, no_wall.note(None), no_wall.line()), ("far", None, None));
        assert_eq!(no_wall.widened(1.5, [1.0, 2.0]), [1.0, 2.0]);
        let stated = walls(Some(Walls::Block(block)), 0.03);
        assert_eq!((stated.stated, stated.note(None)), ("block", None));
        // An interval that is almost exact has the error of the block.
        let [low, high] = stated.widened(10.0, [10.0 - 1e-9, 10.0 + 1e-9]);
        assert!(((high / low).ln() / (2.0 * Block::RELATIVE_ERROR) - 1.0).abs() < 1e-6, "{low} {high}");
        // Walls whose effect is in the model are said to be so, and widen as much; beside one that is stated the effect is of no meaning.
        let unstated = walls(None, 0.03).beside(["tissue.gradient", FINITE_BODY].into_iter());
        assert_eq!(unstated.stated, "in_model");
        assert!(
            unstated.note(None).is_some_and(|note| note.contains("in the model") && note.contains("body_mm"))
        );
        assert!(unstated.line().is_some_and(|line| line.contains(FINITE_BODY)));
        assert_eq!(unstated.widened(10.0, [9.0, 11.0]), walls(None, 0.03).widened(10.0, [9.0, 11.0]));
        assert_eq!(walls(Some(Walls::Far), 0.03).beside([FINITE_BODY].into_iter()).stated, "far");
        let text = BlockResult::from(block).to_string();
        assert_eq!(text, "a block of 60 x 60 x 60 mm, needle at 30, 30 mm, sides held, far side held");
    }
}
