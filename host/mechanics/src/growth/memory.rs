//! Effect of the cut path on the tip, in as few numbers as it has.
//!
//! Among springs the unknowns of a node of the needle follow from those of the next one, `x_k = B_k x_{k+1}`, whatever acts on the tip.
//! So all weights of the path at a node n are those of two numbers, `w_j = q_j . B_j ... B_{n-1} x_n`, and their sum over the path is
//! `x_n . s_n` with the memory `s_{n+1} = B_n^T s_n + q_n c_n` (c: the path at both ends of an element). In a body the weights are
//! polynomials of the depth: their sum is that of the moments of the path, one for each power. Either way a step costs the same however
//! long the path is. A body with a shear layer has weights of its own for every element.

use super::TipState;
use crate::body::MODES;

/// Numbers that hold all that a path does: of a body the moments and the place where it entered; two of springs.
pub(super) const STATES: usize = MODES + 1;

/// An element of tissue, by what its path leaves in the memory.
#[derive(Debug, Clone)]
pub(super) struct Step {
    /// Nodes at which its path starts and ends.
    pub nodes: [usize; 2],
    /// Among springs, the needle's deflection and slope at its start per those at its end.
    pub per_next: [[f64; 2]; 2],
    /// Per metre of the path at its start and at its end.
    pub start: [f64; STATES],
    pub end: [f64; STATES],
}

/// Rule by which a memory is continued.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// Two numbers that follow the needle's unknowns.
    Springs,
    /// Moments, which stay.
    Body,
    /// Every element by itself.
    Dense,
}

/// Effect of the path that is cut so far.
pub(super) struct Memory {
    kind: Kind,
    /// Elements in it.
    pub count: usize,
    states: [f64; STATES],
    /// The path at the start and the end of every element, where each has weights of its own.
    cut: Vec<[f64; 2]>,
}

impl Memory {
    /// Memory of no path.
    pub fn new(kind: Kind) -> Self {
        Self { kind, count: 0, states: [0.0; STATES], cut: Vec::new() }
    }

    /// Takes in all elements whose ends are among these states.
    pub fn extend(&mut self, steps: &[Step], states: &[TipState]) {
        while let Some(step) = steps.get(self.count) {
            let [start_node, end_node] = step.nodes;
            let (Some(start_state), Some(end_state)) = (states.get(start_node), states.get(end_node)) else {
                break;
            };
            let ends = [start_state.tip_m[1], end_state.tip_m[0]];
            self.count += 1;
            if self.kind == Kind::Dense {
                self.cut.push(ends);
                continue;
            }
            self.states = self.before(step);
            let width = self.width();
            let more = step.start.iter().zip(&step.end).map(|(start, end)| start * ends[0] + end * ends[1]);
            self.states.iter_mut().zip(more).take(width).for_each(|(state, more)| *state += more);
        }
    }

    fn width(&self) -> usize {
        if self.kind == Kind::Springs { 2 } else { STATES }
    }

    /// The same at the end of a new element, before that has any path.
    fn before(&self, step: &Step) -> [f64; STATES] {
        let mut states = self.states;
        if self.kind == Kind::Springs {
            let ([a, b], [c, d]) = (step.per_next[0], step.per_next[1]);
            (states[0], states[1]) =
                (a * self.states[0] + c * self.states[1], b * self.states[0] + d * self.states[1]);
        }
        states
    }

    /// Value of a functional of the needle for the path in this memory.
    pub fn of(&self, path: &[f64; STATES], dense: &[[f64; 2]]) -> f64 {
        match self.kind {
            Kind::Dense => weighted(dense, &self.cut),
            _ => self.product(path, &self.states),
        }
    }

    /// The same at the end of a new element whose path starts at `start_m`, and per metre of its end.
    pub fn with(&self, step: &Step, path: &[f64; STATES], dense: &[[f64; 2]], start_m: f64) -> (f64, f64) {
        match self.kind {
            Kind::Dense => {
                let [start, end] = dense.get(self.count).copied().unwrap_or_default();
                (weighted(dense, &self.cut) + start * start_m, end)
            }
            _ => {
                let product_before =
                    self.product(path, &self.before(step)) + self.product(path, &step.start) * start_m;
                (product_before, self.product(path, &step.end))
            }
        }
    }

    fn product(&self, a: &[f64; STATES], b: &[f64; STATES]) -> f64 {
        a.iter().zip(b).take(self.width()).map(|(a, b)| a * b).sum()
    }
}

/// Weights of every element of a path among springs, from the numbers that stand for all of them.
pub(super) fn weights(steps: &[Step], path: &[f64; STATES]) -> Vec<[f64; 2]> {
    let mut position_state = [path[0], path[1]];
    let weight = |step: &Step| {
        let weights = [weighted_sum(&step.start, position_state), weighted_sum(&step.end, position_state)];
        position_state = step
            .per_next
            .map(|[deflection, slope]| deflection * position_state[0] + slope * position_state[1]);
        weights
    };
    let mut state_weights: Vec<[f64; 2]> = steps.iter().rev().map(weight).collect();
    state_weights.reverse();
    state_weights
}

fn weighted_sum(acts: &[f64; STATES], position_state: [f64; 2]) -> f64 {
    acts[0] * position_state[0] + acts[1] * position_state[1]
}

/// Sum of products of pairs, as many as both have.
fn weighted(path: &[[f64; 2]], cut: &[[f64; 2]]) -> f64 {
    path.iter().zip(cut).map(|(weights, at)| weights[0] * at[0] + weights[1] * at[1]).sum()
}
