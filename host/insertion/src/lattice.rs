//! Interpolation between the points of a lattice at which insertions are solved, with derivatives.

use std::sync::Arc;

/// Solution at a point of the lattice: tip position at every node, on arriving and on leaving, and where it is measured
/// its direction behind that.
#[derive(Debug)]
pub(super) struct Point {
    /// Per plan, part by part ([`Parts`](super::candidates::Parts)).
    pub responses: Vec<Vec<f64>>,
    /// Per recording and plane: under the motion of guide 2 as it is at the nodes, and the bend of the needle; `None` where it does not
    /// move and is straight.
    pub guide2_m: Vec<Option<[Vec<f64>; 2]>>,
}

/// A function of the candidate, with its derivatives with respect to the logarithms.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Smooth {
    pub value: Vec<f64>,
    pub by_modulus: Vec<f64>,
    pub by_gap: Vec<f64>,
    pub by_rear: Vec<f64>,
}

/// Points of the lattice with their weights in the value and its derivatives by modulus, gap and rear.
pub(super) struct Mixture {
    pub points: Vec<(Arc<Point>, [f64; 4])>,
    /// Whether the derivative by the rear is one.
    pub is_unknown: bool,
}

impl Mixture {
    pub fn is_same(&self, other: &Self) -> bool {
        self.points.len() == other.points.len()
            && self.points.iter().zip(&other.points).all(|(a, b)| Arc::ptr_eq(&a.0, &b.0) && a.1 == b.1)
    }

    pub fn of<'p>(&'p self, of: &dyn Fn(&'p Point) -> Option<&'p Vec<f64>>) -> Smooth {
        let length = self.points.first().and_then(|(point, _)| of(point)).map_or(0, Vec::len);
        let by_rear = if self.is_unknown { zeros(length) } else { Vec::new() };
        let mut sum =
            Smooth { value: zeros(length), by_modulus: zeros(length), by_gap: zeros(length), by_rear };
        let points: Vec<_> =
            self.points.iter().filter_map(|(point, weights)| Some((of(point)?, weights))).collect();
        // Block by block, so that sums stay near.
        for start in (0..length).step_by(BLOCK) {
            let block = start..length.min(start + BLOCK);
            for (number, sums) in [&mut sum.value, &mut sum.by_modulus, &mut sum.by_gap, &mut sum.by_rear]
                .into_iter()
                .enumerate()
            {
                let Some(sums) = sums.get_mut(block.clone()) else { continue };
                for (values, weights) in &points {
                    let weight = weights[number];
                    if weight != 0.0 {
                        sums.iter_mut()
                            .zip(&values[block.clone()])
                            .for_each(|(sum, value)| *sum += weight * value);
                    }
                }
            }
        }
        sum
    }
}

fn zeros(length: usize) -> Vec<f64> {
    vec![0.0; length]
}

/// Values that are summed up at once.
const BLOCK: usize = 512;

/// Four neighbouring points of a lattice, with their weights in the value and the derivative at a place between the middle two.
pub(super) fn cubic(at_ln: f64, lattice_ln: f64) -> Vec<(i32, [f64; 2])> {
    let cell = (at_ln / lattice_ln).floor();
    lagrange(&[-1.0, 0.0, 1.0, 2.0], at_ln / lattice_ln - cell, lattice_ln)
        .map(|(node, weights)| (cell as i32 + node as i32, weights))
        .collect()
}

/// Three points of a lattice, `stride` apart, with their weights at a place nearest to the middle one.
pub(super) fn parabola(at_ln: f64, lattice_ln: f64, stride: i32) -> Vec<(i32, [f64; 2])> {
    let apart_ln = lattice_ln * f64::from(stride);
    let middle = (at_ln / apart_ln).round();
    about(middle as i32, at_ln / apart_ln - middle, apart_ln, stride)
}

/// The point `middle` and its neighbours, with their weights at a place `x` spacings away from it.
pub(super) fn about(middle: i32, x: f64, apart: f64, stride: i32) -> Vec<(i32, [f64; 2])> {
    lagrange(&[-1.0, 0.0, 1.0], x, apart)
        .map(|(node, weights)| (stride * (middle + node as i32), weights))
        .collect()
}

/// Weights of nodes in the value and the derivative at a place of the polynomial through them (Lagrange).
fn lagrange(nodes: &[f64], x: f64, unit: f64) -> impl Iterator<Item = (f64, [f64; 2])> {
    nodes.iter().enumerate().map(move |(i, node)| {
        let other_nodes = || nodes.iter().enumerate().filter(move |(j, _)| *j != i);
        let scale: f64 = other_nodes().map(|(_, other)| node - other).product();
        let value: f64 = other_nodes().map(|(_, other)| x - other).product();
        let slope: f64 = other_nodes()
            .map(|(left, _)| {
                other_nodes().filter(|(j, _)| *j != left).map(|(_, other)| x - other).product::<f64>()
            })
            .sum();
        (*node, [value / scale, slope / (scale * unit)])
    })
}
