//! What Young's modulus may be off by where the session does not state the walls of the tissue: it is that of a half space, and K/E
//! of a block differs from that by tens of per cent (theory, eq. 15).

use super::options::TissueModel;
use super::{FoundationResult, YoungsModulus};
use mechanics::body::unknown_walls;
use mechanics::{Block, Mounting, Needle};

/// A block of unknown size and mounting, for the deepest run.
pub(super) struct UnknownWalls {
    /// Factors on E of a half space: sides held, sides free.
    factors: [f64; 2],
    depth_m: f64,
}

impl UnknownWalls {
    /// For the deepest run; nothing where walls are stated, or no block of that depth can be solved.
    pub fn of(needle: &Needle, deepest_m: f64, tissue: TissueModel) -> Option<Self> {
        if tissue.has_walls || deepest_m <= 0.0 {
            return None;
        }
        let factors = unknown_walls(needle, deepest_m, tissue.poisson).ok()?;
        Some(Self { factors, depth_m: deepest_m })
    }

    fn widened(&self, [low_kpa, high_kpa]: [f64; 2]) -> [f64; 2] {
        let [held, free] = self.factors;
        [low_kpa * held.min(1.0), high_kpa * free.max(1.0)]
    }

    /// Intervals of E with what the walls may do, and the sentence that says so.
    pub fn widen(&self, youngs: &mut YoungsModulus, foundation: &mut FoundationResult) -> Option<String> {
        let body = foundation.body.as_mut();
        if let Some(body) = body {
            body.ci95_kpa = self.widened(body.ci95_kpa);
        }
        let of_half_space = youngs.ci95?;
        youngs.ci95 = Some(self.widened(of_half_space));
        let ([low, high], [held, free]) = (of_half_space, self.factors);
        let edge_mm = 1e3 * Block::around(self.depth_m, Mounting::Held).size_m[0];
        Some(format!(
            "the walls of the tissue are not stated: E is that of a half space ({low:.2} to {high:.2} kPa), and its interval is that of any block \
             of {edge_mm:.0} mm or more, with sides that are held (E times {held:.2}) or free (times {free:.2}); state body_mm, needle_at_mm, \
             sides and far_side in [tissue], or sides = \"far\" where no wall is near; K does not depend on them"
        ))
    }
}
