//! Location of depths among the nodes at which responses are solved: the same for every candidate.

use super::layout::{DRIFTS, Layout};
use super::motion::Motion;
use super::path::Bin;

/// Location of a depth among the nodes: places of the tip on both sides of it, and their weights.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Place {
    at: [usize; 2],
    weights: [f64; 2],
    /// The depth itself.
    pub depth_m: f64,
    /// Readings of the parts of a slow drift there.
    pub drifts: [f64; DRIFTS],
    /// Distance of guide 2, in each plane, from its interpolation between the nodes, m.
    pub beside_m: [f64; 2],
}

impl Place {
    /// Location of a depth, on arriving or on leaving.
    pub fn new(
        layout: &Layout,
        nodes_m: &[f64],
        motion: Option<&[Motion; 2]>,
        (depth_m, leaving): (f64, bool),
    ) -> Self {
        let last = nodes_m.len().saturating_sub(1);
        let next = nodes_m.partition_point(|node_m| *node_m < depth_m - 1e-9).min(last);
        let is_outside = next == 0 || (next == last && depth_m > nodes_m[last]);
        let offset_m =
            motion.map_or([0.0; 2], |planes| planes.each_ref().map(|m| m.beside_m(depth_m, leaving)));
        let drifts = std::array::from_fn(|number| layout.drift(number, depth_m));
        if is_outside || (nodes_m[next] - depth_m).abs() <= 1e-9 {
            let column = 2 * next + usize::from(leaving);
            return Self { at: [column; 2], weights: [1.0, 0.0], depth_m, drifts, beside_m: offset_m };
        }
        let (lower_m, upper_m) = (nodes_m[next - 1], nodes_m[next]);
        let fraction = (depth_m - lower_m) / (upper_m - lower_m);
        let (columns, weights) = ([2 * next - 1, 2 * next], [1.0 - fraction, fraction]);
        Self { at: columns, weights, depth_m, drifts, beside_m: offset_m }
    }

    /// A value between those at the nodes, on arriving and on leaving each; 0 of nothing.
    pub fn of(&self, values: &[f64]) -> f64 {
        self.weights[0] * self.value_at(0, values) + self.weights[1] * self.value_at(1, values)
    }

    fn value_at(&self, i: usize, values: &[f64]) -> f64 {
        values.get(self.at[i]).copied().unwrap_or_default()
    }
}

/// Depths of bins, and whether each was taken on leaving.
pub(super) fn depths(bins: &[Bin]) -> impl Iterator<Item = (f64, bool)> {
    bins.iter().map(|bin| (bin.depth_m, bin.leaving))
}
