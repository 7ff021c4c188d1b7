//! Course of the run so far, at the nodes of depth on which the needle is solved.

use crate::protocol::Answer;

/// Guide and bevel at a node, on arriving there and on leaving.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct AtNode {
    /// Reported displacement of guide 2, m: x and y.
    pub guide_m: [[f64; 2]; 2],
    /// On which side its play lies, x and y: the sign of the last motion, 0 before the first.
    pub play: [[f64; 2]; 2],
    /// Direction of the tip's load, rad.
    pub bevel_rad: [f64; 2],
}

/// Everything done from the surface to the deepest node reached. Nodes deeper than that are as that one was left.
#[derive(Debug, Clone)]
pub(crate) struct History {
    /// Depths of nodes, m; 0 first, the target last.
    pub depths_m: Vec<f64>,
    /// Per plane x, y at every node, on arriving and on leaving.
    pub nodes: Vec<AtNode>,
    /// The deepest node reached.
    pub reached: usize,
    /// Turning points of each axis of the guide, m: where the play was last on which side.
    axis: [Axis; 2],
    times: Vec<Moment>,
}

/// State of one axis.
#[derive(Debug, Clone, Copy, Default)]
struct Axis {
    at_m: f64,
    side: f64,
}

/// State at a time.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Moment {
    pub t_s: f64,
    pub depth_m: f64,
    pub guide_m: [f64; 2],
    pub bevel_rad: f64,
}

/// Location of a reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Place {
    /// At rest at a node, on arriving (0) or on leaving (1).
    Rest(usize, usize),
    /// Between a node and the next: share of the way.
    Between(usize, f64),
}

impl History {
    pub fn new(target_m: f64, step_m: f64, bevel_rad: f64) -> Self {
        let count = (target_m / step_m - 0.05).ceil().max(1.0) as usize;
        let mut depths_m: Vec<f64> = (0..count).map(|i| step_m * i as f64).collect();
        depths_m.push(target_m);
        let nodes = vec![AtNode { bevel_rad: [bevel_rad; 2], ..AtNode::default() }; depths_m.len()];
        let start = Moment { t_s: 0.0, depth_m: 0.0, guide_m: [0.0; 2], bevel_rad };
        Self { depths_m, nodes, reached: 0, axis: [Axis::default(); 2], times: vec![start] }
    }

    /// Takes in where the plant is.
    pub fn record(&mut self, answer: &Answer) {
        let depth_m = 1e-3 * answer.depth_mm;
        let guide_m = [1e-3 * answer.guide_x_mm, 1e-3 * answer.guide_y_mm];
        let bevel_rad = answer.bevel_deg.to_radians();
        while self.depths_m.get(self.reached + 1).is_some_and(|node_m| *node_m <= depth_m + 2e-5) {
            self.reached += 1;
        }
        for (axis, now_m) in self.axis.iter_mut().zip(guide_m) {
            if (now_m - axis.at_m).abs() > 2e-6 {
                axis.side = (now_m - axis.at_m).signum();
                axis.at_m = now_m;
            }
        }
        let resting = (self.depths_m[self.reached] - depth_m).abs() <= 2e-5;
        let rest_state = AtNode {
            guide_m: guide_m.map(|m| [m; 2]),
            play: [0, 1].map(|plane: usize| [self.axis[plane].side; 2]),
            bevel_rad: [bevel_rad; 2],
        };
        // On the way to the next node the guide is where it was left; at a node it may move again.
        let first_node = self.reached + usize::from(!resting);
        if let Some(node) = self.nodes.get_mut(self.reached).filter(|_| resting) {
            for (plane, now_m) in guide_m.into_iter().enumerate() {
                node.guide_m[plane][1] = now_m;
                node.play[plane][1] = self.axis[plane].side;
            }
            node.bevel_rad[1] = bevel_rad;
        }
        let deeper = first_node + usize::from(resting);
        self.nodes.iter_mut().skip(deeper).for_each(|node| *node = rest_state);
        self.times.push(Moment { t_s: answer.t_s, depth_m, guide_m, bevel_rad });
    }

    /// Puts the guide where a plan has it from each node on, m; its play lies where the move goes.
    pub fn plan(&mut self, moves: impl Iterator<Item = (usize, [f64; 2])>) {
        for (from, to_m) in moves {
            let Some(previous_node) = self.nodes.get(from).copied() else { continue };
            for (plane, now_m) in to_m.into_iter().enumerate() {
                let moved_m = now_m - previous_node.guide_m[plane][1];
                let side = if moved_m.abs() > 2e-6 { moved_m.signum() } else { previous_node.play[plane][1] };
                for (number, node) in self.nodes.iter_mut().enumerate().skip(from) {
                    let first = usize::from(number == from);
                    node.guide_m[plane][first..].fill(now_m);
                    node.play[plane][first..].fill(side);
                }
            }
        }
    }

    /// Turns the needle at a depth, to stay turned.
    pub fn plan_rotation(&mut self, depth_m: f64, bevel_rad: f64) {
        let first_node = self.depths_m.partition_point(|m| *m < depth_m - 1e-6);
        for (number, node) in self.nodes.iter_mut().enumerate().skip(first_node) {
            node.bevel_rad[usize::from(number == first_node)..].fill(bevel_rad);
        }
    }

    /// State at a time; steps are straight lines.
    pub fn at(&self, t_s: f64) -> Moment {
        let next = self.times.partition_point(|moment| moment.t_s < t_s);
        match (next.checked_sub(1).and_then(|i| self.times.get(i)), self.times.get(next)) {
            (Some(a), Some(b)) => {
                let fraction = (t_s - a.t_s) / (b.t_s - a.t_s);
                Moment {
                    t_s,
                    depth_m: interpolated(a.depth_m, b.depth_m, fraction),
                    guide_m: [0, 1].map(|i: usize| interpolated(a.guide_m[i], b.guide_m[i], fraction)),
                    bevel_rad: interpolated(a.bevel_rad, b.bevel_rad, fraction),
                }
            }
            (Some(last), None) => *last,
            (None, first) => first.copied().unwrap_or(self.times[0]),
        }
    }

    /// Location of a reading by its time; `None` while the guide moves or the needle turns.
    pub fn place(&self, t_s: f64) -> Option<Place> {
        let Moment { depth_m, guide_m, bevel_rad, .. } = self.at(t_s);
        let next = self.depths_m.partition_point(|node_m| *node_m <= depth_m + 2e-5);
        let node = next.saturating_sub(1);
        if (self.depths_m[node] - depth_m).abs() <= 2e-5 {
            let node_state = &self.nodes[node];
            return if is_at(node_state, 1, guide_m, bevel_rad)
                && node_state != &AtNode::default()
                && !is_at(node_state, 0, guide_m, bevel_rad)
            {
                Some(Place::Rest(node, 1))
            } else if is_at(node_state, 0, guide_m, bevel_rad) {
                Some(Place::Rest(node, 0))
            } else {
                None
            };
        }
        let (node_m, next_m) = (self.depths_m[node], *self.depths_m.get(next)?);
        Some(Place::Between(node, (depth_m - node_m) / (next_m - node_m)))
    }
}

fn is_at(at: &AtNode, side: usize, guide_m: [f64; 2], bevel_rad: f64) -> bool {
    (0..2).all(|plane| (at.guide_m[plane][side] - guide_m[plane]).abs() < 5e-6)
        && (at.bevel_rad[side] - bevel_rad).abs() < 1e-3
}

fn interpolated(a: f64, b: f64, fraction: f64) -> f64 {
    a + fraction * (b - a)
}
