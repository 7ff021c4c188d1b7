//! A needle of two-node beam elements with shear, tied node by node to the path of its tip.
//!
//! Deflection and rotation are interpolated linearly and independently of each other (Timoshenko), with one integration point and
//! the residual bending flexibility
//! of MacNeal (*Finite Elements: Their Design and Performance*, Dekker, 1994, section 4), which makes an element exact for loads
//! at its ends.
//! The tissue acts at nodes alone: each node beyond the surface is tied to where the tip was when it passed there. Needle and
//! ties share no
//! line with [`Needle`](super::Needle), whose beam has cubic elements and whose springs lie between the nodes.

use super::sensor::Body;

/// Length of the elements in the tissue, m: one tie each.
const ELEMENT_M: f64 = 1e-3;
/// Shear stiffness of a solid steel wire of 1.27 mm, N: it hardly counts.
const SHEAR_N: f64 = 9e4;
/// Supports, N/m and N m.
const RIGID: f64 = 1e8;

/// Tissue of a tied needle.
#[derive(Debug, Clone, PartialEq)]
pub struct Ties {
    /// Modulus at the surface, Pa, and what it is multiplied by from depths on: m, factor.
    pub modulus_pa: f64,
    /// See `modulus_pa`.
    pub layers: Vec<[f64; 2]>,
    /// Tie at the surface beside that of the tissue, N/m.
    pub skin_n_per_m: f64,
    /// Load per length beyond which a tie gives way, N/m: at the surface, and per depth, N/m^2; infinite where none does.
    pub yield_n_per_m: [f64; 2],
    /// Share of a tie that relaxes and its time, s.
    pub relaxing: [f64; 2],
}

/// The needle.
#[derive(Debug, Clone)]
pub struct TiedNeedle {
    /// Bending stiffness, N m^2.
    pub stiffness_n_m2: f64,
    /// From guide 1 to guide 2, m.
    pub guide2_m: f64,
    /// From guide 2 to the surface, m.
    pub gap_m: f64,
    /// Rotation in guide 1 per moment, rad/(N m): 0 is a clamp.
    pub clamp_rad_per_n_m: f64,
    /// Radius of the needle, m.
    pub radius_m: f64,
    /// The tissue.
    pub ties: Ties,
    /// Rest position of each tie, x and y, m, and its plastic part.
    rests_m: Vec<[f64; 2]>,
    flowed_m: Vec<[f64; 2]>,
    tip_m: [f64; 2],
    force_n: [f64; 2],
    strain: f64,
    depth_m: f64,
}

/// Unknowns and right side of one node, and its coupling with the next: rows by deflection and rotation.
#[derive(Clone, Copy, Default)]
struct Node {
    own: [[f64; 2]; 2],
    next: [[f64; 2]; 2],
    right: [f64; 2],
}

impl TiedNeedle {
    /// At the surface.
    pub fn new(ties: Ties, gap_m: f64) -> Self {
        Self {
            stiffness_n_m2: 0.0157,
            guide2_m: 0.06,
            gap_m,
            clamp_rad_per_n_m: 0.0,
            radius_m: 0.635e-3,
            ties,
            rests_m: Vec::new(),
            flowed_m: Vec::new(),
            tip_m: [0.0; 2],
            force_n: [0.0; 2],
            strain: 0.0,
            depth_m: 0.0,
        }
    }

    fn tie_n_per_m(&self, tie: usize) -> f64 {
        let depth_m = ELEMENT_M * tie as f64;
        let factor: f64 = self
            .ties
            .layers
            .iter()
            .filter(|[from_m, _]| depth_m >= *from_m)
            .map(|[_, factor]| factor)
            .product();
        let upper_half_m = if tie == 0 { 0.0 } else { 0.5 * ELEMENT_M };
        let width_m = upper_half_m + (self.depth_m - depth_m).clamp(0.0, 0.5 * ELEMENT_M);
        self.ties.modulus_pa * factor * width_m + if tie == 0 { self.ties.skin_n_per_m } else { 0.0 }
    }

    /// Equilibrium at a depth with the tip's load.
    fn settle(&mut self, depth_m: f64, time_s: f64, guide_m: [f64; 2], load_n: [f64; 2]) {
        self.depth_m = depth_m;
        let entry_m = self.guide2_m + self.gap_m;
        let mut nodes_m = vec![0.0];
        nodes_m.extend(evenly_spaced(0.0, self.guide2_m, 20));
        nodes_m.extend(evenly_spaced(self.guide2_m, self.gap_m, 10));
        let (guide2, entry) = (20, 30);
        let whole = (depth_m / ELEMENT_M + 1e-6).floor() as usize;
        nodes_m.extend(evenly_spaced(entry_m, ELEMENT_M * whole as f64, whole));
        if depth_m - ELEMENT_M * whole as f64 > 1e-6 {
            nodes_m.push(entry_m + depth_m);
        }
        let ties = self.rests_m.len().min(nodes_m.len() - entry);
        // A tie that yields moves its rest, and the needle is solved again.
        for _ in 0..4 {
            let shapes = [0, 1].map(|plane: usize| {
                let mut nodes = self.elements(&nodes_m);
                for tie in 0..ties {
                    let stiff = self.tie_n_per_m(tie);
                    let node = &mut nodes[entry + tie];
                    node.own[0][0] += stiff;
                    node.right[0] += stiff * (self.rests_m[tie][plane] + self.flowed_m[tie][plane]);
                }
                nodes[0].own[0][0] += RIGID;
                nodes[0].own[1][1] +=
                    if self.clamp_rad_per_n_m > 0.0 { 1.0 / self.clamp_rad_per_n_m } else { RIGID };
                nodes[guide2].own[0][0] += RIGID;
                nodes[guide2].right[0] += RIGID * guide_m[plane];
                if let Some(tip) = nodes.last_mut() {
                    tip.right[0] += load_n[plane];
                }
                solved(nodes)
            });
            for (plane, shape) in shapes.iter().enumerate() {
                self.tip_m[plane] = shape.last().map_or(0.0, |tip| tip[0]);
                self.force_n[plane] = RIGID * (guide_m[plane] - shape[guide2][0]);
            }
            self.strain = self.largest_strain(&nodes_m, &shapes);
            if !self.yielded(entry, ties, &shapes) {
                self.relax(entry, ties, &shapes, time_s);
                break;
            }
        }
    }

    fn elements(&self, nodes_m: &[f64]) -> Vec<Node> {
        let mut nodes = vec![Node::default(); nodes_m.len()];
        for (i, ends_m) in nodes_m.windows(2).enumerate() {
            let l = ends_m[1] - ends_m[0];
            let shear = self.shear(l) / l;
            let bend = self.stiffness_n_m2 / l;
            // Shear of the element: (u2 - u1) - l (r1 + r2)/2; bending: r2 - r1.
            let h = 0.5 * l;
            add_element(&mut nodes[i].own, [1.0, 1.0], shear, h, bend);
            add_element(&mut nodes[i + 1].own, [-1.0, -1.0], shear, h, bend);
            let (successor, next) = (&mut nodes[i].next, [1.0, -1.0]);
            successor[0][0] += next[0] * next[1] * shear;
            successor[0][1] += h * shear;
            successor[1][0] += next[1] * h * shear;
            successor[1][1] += h * h * shear - bend;
        }
        nodes
    }

    /// Shear stiffness with the residual bending flexibility, N.
    fn shear(&self, l: f64) -> f64 {
        (1.0 / SHEAR_N + l * l / (12.0 * self.stiffness_n_m2)).recip()
    }

    /// From moments at the ends of elements: constant shear, so that they are linear within.
    fn largest_strain(&self, nodes_m: &[f64], shapes: &[Vec<[f64; 2]>; 2]) -> f64 {
        let mut largest = 0.0_f64;
        for (i, ends_m) in nodes_m.windows(2).enumerate() {
            let l = ends_m[1] - ends_m[0];
            let moments = [0, 1].map(|plane: usize| {
                let ([u1, r1], [u2, r2]) = (shapes[plane][i], shapes[plane][i + 1]);
                let middle = self.stiffness_n_m2 * (r2 - r1) / l;
                let shear_n = self.shear(l) * ((u2 - u1) / l - 0.5 * (r1 + r2));
                // M' = -V of the element by its own signs.
                [middle + 0.5 * l * shear_n, middle - 0.5 * l * shear_n]
            });
            let [vertical, horizontal] = moments;
            for (vertical, horizontal) in vertical.into_iter().zip(horizontal) {
                let moment: f64 = vertical.hypot(horizontal);
                largest = largest.max(self.radius_m * moment / self.stiffness_n_m2);
            }
        }
        largest
    }

    fn yielded(&mut self, entry: usize, ties: usize, shapes: &[Vec<[f64; 2]>; 2]) -> bool {
        let [surface, per_depth] = self.ties.yield_n_per_m;
        if surface.is_infinite() {
            return false;
        }
        let mut has_yielded = false;
        for tie in 1..ties {
            let stretch = [0, 1].map(|plane: usize| {
                shapes[plane][entry + tie][0] - self.rests_m[tie][plane] - self.flowed_m[tie][plane]
            });
            let modulus = self.tie_n_per_m(tie) / ELEMENT_M;
            let load = modulus * stretch[0].hypot(stretch[1]);
            let most = surface + per_depth * ELEMENT_M * tie as f64;
            if load > 1.01 * most {
                has_yielded = true;
                let excess = 1.0 - most / load;
                (0..2).for_each(|plane| self.rests_m[tie][plane] += excess * stretch[plane]);
            }
        }
        has_yielded
    }

    fn relax(&mut self, entry: usize, ties: usize, shapes: &[Vec<[f64; 2]>; 2], time_s: f64) {
        let [relaxing_fraction, relaxation_s] = self.ties.relaxing;
        if relaxing_fraction <= 0.0 {
            return;
        }
        let step = 1.0 - (-time_s / relaxation_s).exp();
        for tie in 0..ties {
            for (plane, shape) in shapes.iter().enumerate() {
                let stretch = shape[entry + tie][0] - self.rests_m[tie][plane];
                let flowed = &mut self.flowed_m[tie][plane];
                *flowed += step * (relaxing_fraction * stretch - *flowed);
            }
        }
    }
}

fn add_element(to: &mut [[f64; 2]; 2], signs: [f64; 2], shear: f64, h: f64, bend: f64) {
    let [a, b] = signs;
    to[0][0] += a * b * shear;
    to[0][1] += a * h * shear;
    to[1][0] += b * h * shear;
    to[1][1] += h * h * shear + a * b * bend;
}

fn evenly_spaced(from_m: f64, length_m: f64, count: usize) -> impl Iterator<Item = f64> {
    (1..=count).map(move |i| from_m + length_m * i as f64 / count as f64)
}

impl Body for TiedNeedle {
    fn advance(&mut self, depth_m: f64, time_s: f64, guide_m: [f64; 2], load_n: [f64; 2], _bevel_rad: f64) {
        let (start_m, push_m) = (self.depth_m, depth_m - self.depth_m);
        if push_m <= 1e-9 {
            return self.settle(self.depth_m, time_s, guide_m, load_n);
        }
        loop {
            let next_m = ELEMENT_M * self.rests_m.len() as f64;
            let step_end_m = next_m.clamp(self.depth_m, depth_m);
            self.settle(step_end_m, time_s * (step_end_m - self.depth_m) / push_m, guide_m, load_n);
            if next_m <= depth_m + 1e-9 {
                self.rests_m.push(self.tip_m);
                self.flowed_m.push([0.0; 2]);
            }
            if step_end_m >= depth_m || self.depth_m - start_m >= push_m {
                return;
            }
        }
    }

    fn tip_m(&self) -> [f64; 2] {
        self.tip_m
    }

    fn force_n(&self) -> [f64; 2] {
        self.force_n
    }

    fn strain(&self) -> f64 {
        self.strain
    }
}

/// Deflection and rotation of every node: block elimination.
fn solved(mut nodes: Vec<Node>) -> Vec<[f64; 2]> {
    for i in 0..nodes.len().saturating_sub(1) {
        let Node { own, next, right } = nodes[i];
        let inverse = inverted(own);
        // Schur complement of the next node: own - next' inverse next.
        let factor = times(inverse, next);
        let following = &mut nodes[i + 1];
        let [a, b] = applied(inverse, right);
        let [upper_block, lower_block] = next;
        let rows =
            following.own.iter_mut().zip(&mut following.right).zip(upper_block.into_iter().zip(lower_block));
        for ((own, right), (upper_block, lower_block)) in rows {
            for (own, (first, second)) in own.iter_mut().zip(factor[0].into_iter().zip(factor[1])) {
                *own -= upper_block * first + lower_block * second;
            }
            *right -= upper_block * a + lower_block * b;
        }
    }
    let mut shape = vec![[0.0; 2]; nodes.len()];
    let mut solution = [0.0; 2];
    for (i, node) in nodes.iter().enumerate().rev() {
        let pulled = applied(node.next, solution);
        solution = applied(inverted(node.own), [node.right[0] - pulled[0], node.right[1] - pulled[1]]);
        shape[i] = solution;
    }
    shape
}

fn inverted([[a, b], [c, d]]: [[f64; 2]; 2]) -> [[f64; 2]; 2] {
    let determinant = a * d - b * c;
    [[d / determinant, -b / determinant], [-c / determinant, a / determinant]]
}

fn times(a: [[f64; 2]; 2], b: [[f64; 2]; 2]) -> [[f64; 2]; 2] {
    [0, 1].map(|row: usize| [0, 1].map(|column: usize| a[row][0] * b[0][column] + a[row][1] * b[1][column]))
}

fn applied(a: [[f64; 2]; 2], b: [f64; 2]) -> [f64; 2] {
    [0, 1].map(|row: usize| a[row][0] * b[0] + a[row][1] * b[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A tip load on a needle in air: two spans of a beam, in closed form (Roark, table 8.1): over-hanging end of length `a`
    /// beyond a span `l` that is
    /// clamped at its far end.
    #[test]
    fn tip_force_and_strain_are_those_of_the_closed_form_in_air() {
        let ties = Ties {
            modulus_pa: 1e-9,
            layers: Vec::new(),
            skin_n_per_m: 0.0,
            yield_n_per_m: [f64::INFINITY, 0.0],
            relaxing: [0.0, 1.0],
        };
        let mut needle = TiedNeedle::new(ties, 0.02);
        let (load_n, guide_m) = (0.3, 1.5e-3);
        needle.advance(0.0, 1.0, [guide_m, 0.0], [0.0, load_n], 0.0);
        let (ei, l, a) = (needle.stiffness_n_m2, needle.guide2_m, needle.gap_m);
        // Plane x: the guide's displacement alone. Clamped-pinned: F = 3 EI g / l^3, the rest is straight.
        let force_n = 3.0 * ei * guide_m / l.powi(3);
        assert!((needle.force_n()[0] / force_n - 1.0).abs() < 1e-3);
        assert!((needle.tip_m()[0] / (guide_m * (1.0 + 1.5 * a / l)) - 1.0).abs() < 1e-3);
        // Plane y: the load alone. Moment P a at guide 2, half of it with the other sign at guide 1.
        let tip_m = load_n * a * a * (3.0 * l + 4.0 * a) / (12.0 * ei);
        assert!((needle.tip_m()[1] / tip_m - 1.0).abs() < 1e-3, "{} {tip_m}", needle.tip_m()[1]);
        // Guide 1 has the larger moment: 3 EI g / l^2, with half of P a across.
        let at_1 = (3.0 * ei * guide_m / (l * l)).hypot(0.5 * load_n * a);
        let strain = needle.radius_m * at_1.max(load_n * a) / ei;
        assert!((needle.strain() / strain - 1.0).abs() < 1e-3, "{} {strain}", needle.strain());
    }
}
