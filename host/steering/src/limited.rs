//! Limits of needle, guide and tissue, and the quantities that they bound.

use crate::history::History;
use crate::protocol::Statement;
use mechanics::inner::Inner;
use std::fmt;

/// Depths at which the needle may be bent most, and the tissue compressed most, beside guides and surface, m.
const BENT_AT_M: [f64; 4] = [0.010, 0.020, 0.035, 0.055];
const COMPRESSED_AT_M: [f64; 3] = [0.0, 0.010, 0.025];
/// Radius of the needle where none is stated, m: 18 gauge.
const RADIUS_M: f64 = 0.635e-3;

/// Limit of a plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Limit {
    /// Bending strain of the needle.
    Strain,
    /// Lateral force of guide 2.
    Force,
    /// Compression of the tissue by the needle.
    Compression,
    /// Travel of guide 2.
    Travel,
    /// The largest move at one stop.
    LargestMove,
}

impl Limit {
    /// Its name in results.
    pub fn name(self) -> &'static str {
        match self {
            Self::Strain => "strain",
            Self::Force => "force",
            Self::Compression => "compression",
            Self::Travel => "travel",
            Self::LargestMove => "largest_move",
        }
    }
}

impl fmt::Display for Limit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Strain => "the limit of the needle's strain",
            Self::Force => "the force limit of guide 2",
            Self::Compression => "the limit of the tissue's compression",
            Self::Travel => "the travel of guide 2",
            Self::LargestMove => "the largest move at one stop",
        })
    }
}

/// Limits of what is inside, SI; nothing where none is stated.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limits {
    moment_n_m: Option<f64>,
    force_n: Option<f64>,
    compression_m: Option<f64>,
}

impl Limits {
    /// Those of a plant; `force_share`: of its force limit, since measured force stops the run before that.
    pub fn new(stated: &Statement, bending_stiffness_n_m2: f64, force_share: f64) -> Self {
        let radius_m = stated.needle.outer_diameter_mm.map_or(RADIUS_M, |mm| 0.5e-3 * mm);
        Self {
            moment_n_m: stated.limits.needle_strain.map(|strain| strain * bending_stiffness_n_m2 / radius_m),
            force_n: stated.limits.guide_force_n.map(|n| force_share * n),
            compression_m: stated.limits.tissue_compression_mm.map(|mm| 1e-3 * mm),
        }
    }

    /// Whether nothing is limited.
    pub fn is_empty(&self) -> bool {
        self.moment_n_m.is_none() && self.force_n.is_none() && self.compression_m.is_none()
    }

    /// Limited quantities with the tip at a node, with their limits.
    pub fn asked(&self, history: &History, node: usize) -> Vec<(Limit, Inner, f64)> {
        let mut asked = Vec::new();
        if let Some(limit) = self.moment_n_m {
            for inner in [Inner::MomentAtGuide1, Inner::MomentAtGuide2, Inner::MomentAtSurface] {
                asked.push((Limit::Strain, inner, limit));
            }
            for at in near_nodes(&BENT_AT_M, node, &history.depths_m) {
                asked.push((Limit::Strain, Inner::MomentInTissue(at), limit));
            }
        }
        if let Some(limit) = self.force_n {
            asked.push((Limit::Force, Inner::Guide2Force, limit));
        }
        if let Some(limit) = self.compression_m {
            for at in near_nodes(&COMPRESSED_AT_M, node, &history.depths_m) {
                asked.push((Limit::Compression, Inner::Compression(at), limit));
            }
        }
        asked
    }
}

fn near_nodes(depths_m: &[f64], node: usize, history_depths_m: &[f64]) -> Vec<usize> {
    let mut nodes: Vec<usize> =
        depths_m.iter().map(|m| history_depths_m.partition_point(|at| *at < m - 1e-6)).collect();
    nodes.dedup();
    nodes.retain(|at| *at < node);
    nodes
}
