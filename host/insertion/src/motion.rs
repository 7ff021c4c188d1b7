//! The motion of guide 2 on nodes that all recordings share.
//!
//! Guide 2 is moved at rest at other depths in every recording. A step between two nodes is shared out between them so that its
//! moment about them is kept; what the tip does at once, at the depth at which the step was taken, is added where it is read. Both
//! together are second order in the distance of the nodes, as the insertion itself, and recordings need one solution for all.

use mechanics::Profile;
use std::sync::Arc;

/// Motion of guide 2 in one plane of one recording.
#[derive(Debug, Clone)]
pub(super) struct Motion {
    nodes_m: Arc<Vec<f64>>,
    as_done: Profile,
    /// At every node, on arriving and on leaving, m.
    at_nodes_m: Vec<[f64; 2]>,
}

impl Motion {
    /// Motion of a profile on nodes, the first of which is at 0.
    pub fn new(as_done: &Profile, nodes_m: Arc<Vec<f64>>) -> Self {
        let mut jumps_m: Vec<f64> = as_done.jumps_m().collect();
        jumps_m.dedup();
        let last = nodes_m.len().saturating_sub(1);
        let mut guide_m = vec![0.0; nodes_m.len()];
        for at_m in &jumps_m {
            let next = nodes_m.partition_point(|node_m| node_m <= at_m);
            let previous_node = next.saturating_sub(1);
            let fraction = match nodes_m.get(next) {
                Some(next_m) => (at_m - nodes_m[previous_node]) / (next_m - nodes_m[previous_node]),
                None => 0.0,
            };
            guide_m[previous_node] += (1.0 - fraction) * jump_m(*at_m, as_done);
            guide_m[next.min(last)] += fraction * jump_m(*at_m, as_done);
        }
        let mut shared_m = 0.0;
        let at_nodes_m = nodes_m.iter().zip(&guide_m).map(|(node_m, share_m)| {
            let jumped_m: f64 =
                jumps_m.iter().filter(|at_m| *at_m < node_m).map(|at_m| jump_m(*at_m, as_done)).sum();
            let arriving_m = as_done.before(*node_m) - jumped_m + shared_m;
            shared_m += share_m;
            [arriving_m, arriving_m + share_m]
        });
        let at_nodes_m = at_nodes_m.collect();
        Self { as_done: as_done.clone(), at_nodes_m, nodes_m }
    }

    /// At a node, on arriving and on leaving, m.
    pub fn at_node_m(&self, node: usize) -> [f64; 2] {
        self.at_nodes_m.get(node).copied().unwrap_or_default()
    }

    /// Distance of guide 2, at a depth, from its interpolation between the nodes, m.
    pub fn beside_m(&self, depth_m: f64, leaving: bool) -> f64 {
        let next = self.nodes_m.partition_point(|node_m| *node_m < depth_m - 1e-9);
        let interpolated_m = match (next.checked_sub(1), self.nodes_m.get(next)) {
            (_, Some(node_m)) if (node_m - depth_m).abs() <= 1e-9 => {
                self.at_node_m(next)[usize::from(leaving)]
            }
            (Some(from), Some(node_m)) => {
                let fraction = (depth_m - self.nodes_m[from]) / (node_m - self.nodes_m[from]);
                let [start_m, end_m] = [self.at_node_m(from)[1], self.at_node_m(next)[0]];
                start_m + fraction * (end_m - start_m)
            }
            (Some(last), None) => self.at_node_m(last)[1],
            (None, _) => self.at_node_m(0)[0],
        };
        let real_m = if leaving { self.as_done.after(depth_m) } else { self.as_done.before(depth_m) };
        real_m - interpolated_m
    }
}

/// Jump of a profile at a depth.
fn jump_m(at_m: f64, as_done: &Profile) -> f64 {
    as_done.after(at_m) - as_done.before(at_m)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn motion(knots: &[[f64; 2]]) -> Motion {
        let nodes_m = Arc::new((0..=5).map(|i| 1e-3 * f64::from(i)).collect());
        Motion::new(&Profile::new(knots.to_vec()).expect("a profile"), nodes_m)
    }

    #[test]
    fn a_step_between_nodes_is_shared_by_its_moment() {
        let step = motion(&[[0.0, 0.0], [2.25e-3, 0.0], [2.25e-3, 1.0], [5e-3, 1.0]]);
        let node_values: Vec<_> = (0..6).map(|node| step.at_node_m(node)).collect();
        let expected = [[0.0, 0.0], [0.0, 0.0], [0.0, 0.75], [0.75, 1.0], [1.0, 1.0], [1.0, 1.0]];
        for (node_values, expected) in node_values.iter().flatten().zip(expected.iter().flatten()) {
            assert!((node_values - expected).abs() < 1e-12, "{node_values} is not {expected}");
        }
        for (depth_m, leaving, expected) in [
            (2.1e-3, false, -0.75),
            (2.25e-3, false, -0.75),
            (2.25e-3, true, 0.25),
            (2.9e-3, true, 0.25),
            (4e-3, true, 0.0),
        ] {
            let offset_m = step.beside_m(depth_m, leaving);
            assert!((offset_m - expected).abs() < 1e-12, "{offset_m} is not {expected} at {depth_m}");
        }
    }

    #[test]
    fn a_slow_motion_and_a_step_at_a_node_are_as_done() {
        let moved = motion(&[[1e-3, 0.0], [3e-3, 1.0], [3e-3, 3.0], [4e-3, 2.0]]);
        assert_eq!(moved.at_node_m(2), [0.5; 2]);
        assert_eq!(moved.at_node_m(3), [1.0, 3.0]);
        for depth_m in [0.5e-3, 2.2e-3, 3.6e-3, 4.7e-3] {
            assert!(moved.beside_m(depth_m, true).abs() < 1e-12, "{depth_m}");
        }
    }
}
