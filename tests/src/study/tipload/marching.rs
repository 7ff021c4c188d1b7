//! The tip's path by finite differences: a needle that grows node by node through tissue whose springs rest where the tip has cut.
//!
//! Nothing here calls the forward model. The bending energy is that of second differences, the tissue a row of springs; each node of
//! the cut path carries the spring of the half cell before it, at rest where the tip arrived, and of the half cell after it, at rest
//! where the tip was when it left. The equilibrium at every depth is solved anew with a pentadiagonal factorisation.

/// Distance of nodes, m.
pub const STEP_M: f64 = 0.5e-3;

/// A needle held by guide 1 and guide 2 and pushed into uniform tissue. Lengths are multiples of [`STEP_M`].
#[derive(Debug, Clone, PartialEq)]
pub struct Needle {
    /// Bending stiffness, N m^2.
    pub bending_n_m2: f64,
    /// From guide 1 to guide 2, m.
    pub guide2_m: f64,
    /// From guide 2 to the tissue, m.
    pub gap_m: f64,
    /// Foundation modulus, Pa.
    pub modulus_pa: f64,
}

/// What acts at one node, on arriving there and on leaving: tip load, N, and displacement of guide 2, m.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Acting {
    /// Tip load, N.
    pub load_n: [f64; 2],
    /// Displacement of guide 2, m.
    pub guide2_m: [f64; 2],
}

/// Number of the node nearest to a length.
pub fn node_at(length_m: f64) -> usize {
    (length_m / STEP_M).round() as usize
}

impl Needle {
    /// Tip position on arriving at every node of the path and on leaving it, m; `acting` for each of them.
    pub fn path_m(&self, acting: &[Acting]) -> Vec<[f64; 2]> {
        let (guide, entry) = (node_at(self.guide2_m), node_at(self.guide2_m + self.gap_m));
        let half_n_per_m = 0.5 * self.modulus_pa * STEP_M;
        let mut path_m: Vec<[f64; 2]> = Vec::with_capacity(acting.len());
        for (step, now) in acting.iter().enumerate() {
            let tip = entry + step;
            let solve = |side: usize, own_m: Option<f64>| {
                let mut beam = Beam::new(tip, self.bending_n_m2);
                for (node, [arrived_m, left_m]) in path_m.iter().enumerate() {
                    // The half cell before the surface is empty.
                    if node > 0 {
                        beam.spring(entry + node, half_n_per_m, *arrived_m);
                    }
                    beam.spring(entry + node, half_n_per_m, *left_m);
                }
                // The newest spring is at rest where the tip arrives, and pulls back when it is moved from there.
                if let (Some(own_m), true) = (own_m, step > 0) {
                    beam.spring(tip, half_n_per_m, own_m);
                }
                beam.force_n[tip] += now.load_n[side];
                beam.hold(guide, now.guide2_m[side]);
                beam.tip_m()
            };
            let arriving_m = solve(0, None);
            let moved = now.load_n[0] != now.load_n[1] || now.guide2_m[0] != now.guide2_m[1];
            let leaving_m = if moved { solve(1, Some(arriving_m)) } else { arriving_m };
            path_m.push([arriving_m, leaving_m]);
        }
        path_m
    }
}

/// Nodes 0 to `tip`; the needle is clamped in guide 1: `u_0 = 0`, and `u_{-1} = u_1`.
struct Beam {
    /// Diagonal and two bands above it.
    bands: Vec<[f64; 3]>,
    force_n: Vec<f64>,
}

impl Beam {
    fn new(tip: usize, bending_n_m2: f64) -> Self {
        let mut beam = Self { bands: vec![[0.0; 3]; tip + 1], force_n: vec![0.0; tip + 1] };
        let stiffness = bending_n_m2 / STEP_M.powi(3);
        // Curvature at the clamp is 2 u_1 / h^2, over half a cell.
        beam.bands[1][0] += 2.0 * stiffness;
        for middle in 1..tip {
            for (i, a) in [1.0, -2.0, 1.0].into_iter().enumerate() {
                for (j, b) in [1.0, -2.0, 1.0].into_iter().enumerate().skip(i) {
                    beam.bands[middle - 1 + i][j - i] += stiffness * a * b;
                }
            }
        }
        beam.hold(0, 0.0);
        beam
    }

    fn spring(&mut self, node: usize, stiffness_n_per_m: f64, rest_m: f64) {
        self.bands[node][0] += stiffness_n_per_m;
        self.force_n[node] += stiffness_n_per_m * rest_m;
    }

    /// Keeps a node at a place.
    fn hold(&mut self, node: usize, at_m: f64) {
        for distance in 1..=2 {
            if let Some(before) = node.checked_sub(distance) {
                self.force_n[before] -= self.bands[before][distance] * at_m;
                self.bands[before][distance] = 0.0;
            }
            if node + distance < self.force_n.len() {
                self.force_n[node + distance] -= self.bands[node][distance] * at_m;
            }
        }
        self.bands[node] = [1.0, 0.0, 0.0];
        self.force_n[node] = at_m;
    }

    /// Deflection of the last node: forward elimination is enough.
    fn tip_m(mut self) -> f64 {
        let count = self.force_n.len();
        for node in 0..count {
            let [diagonal, next, second] = self.bands[node];
            for (distance, band) in [(1, next), (2, second)] {
                if node + distance < count {
                    let factor = band / diagonal;
                    self.bands[node + distance][0] -= factor * band;
                    if distance == 1 && node + 2 < count {
                        self.bands[node + 1][1] -= factor * second;
                    }
                    self.force_n[node + distance] -= factor * self.force_n[node];
                }
            }
        }
        self.force_n[count - 1] / self.bands[count - 1][0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A cantilever without tissue around it: guide 2 holds the needle, the tip load bends what is beyond and before it.
    #[test]
    fn a_needle_in_air_bends_like_two_spans() {
        let needle = Needle { bending_n_m2: 0.0157, guide2_m: 0.06, gap_m: 0.02, modulus_pa: 0.0 };
        let acting = vec![Acting { load_n: [0.2; 2], ..Acting::default() }; 81];
        let path_m = needle.path_m(&acting);
        for step in [0, 40, 80] {
            let overhang_m = 0.02 + STEP_M * step as f64;
            // Overhang as a cantilever, plus the rotation of the clamped and simply held span before it: M l / (4 EI).
            let exact = 0.2 * overhang_m.powi(2) * (overhang_m / 3.0 + 0.06 / 4.0) / 0.0157;
            assert!((path_m[step][0] / exact - 1.0).abs() < 2e-3, "{} is not {exact}", path_m[step][0]);
        }
    }

    /// A needle that lies on its path without load or guide motion stays where it is; guide motion at rest shows at once.
    #[test]
    fn nothing_moves_without_a_cause() {
        let needle = Needle { bending_n_m2: 0.0157, guide2_m: 0.06, gap_m: 0.02, modulus_pa: 15e3 };
        let mut acting = vec![Acting::default(); 101];
        acting[60].guide2_m = [0.0, 1e-3];
        acting[61..].iter_mut().for_each(|now| now.guide2_m = [1e-3; 2]);
        let path_m = needle.path_m(&acting);
        assert!(path_m[..=60].iter().all(|[arriving_m, _]| arriving_m.abs() < 1e-15));
        assert!(path_m[60][1].abs() > 1e-5 && path_m[61..].iter().all(|[tip_m, _]| tip_m.abs() > 1e-5));
    }

    /// Against the project's own forward model: constant load, a half turn, guide 2 moved at rest.
    #[test]
    fn the_forward_model_agrees() {
        use host::model::{Experiment, Insertion, Model, Profile, Rig, TipLaw, predict};
        let rig = Rig::two_guides(host::model::Needle::gauge_18(), 0.06, 0.085);
        let needle = Needle {
            bending_n_m2: rig.needle.bending_stiffness_n_m2(),
            guide2_m: 0.06,
            gap_m: 0.025,
            modulus_pa: 12e3,
        };
        let side = |step: usize, at: usize, before: f64, after: f64| {
            [if step > at { after } else { before }, if step >= at { after } else { before }]
        };
        let acting: Vec<Acting> = (0..=200)
            .map(|step| Acting { load_n: side(step, 80, 0.2, -0.2), guide2_m: side(step, 120, 0.0, 1e-3) })
            .collect();
        let path_m = needle.path_m(&acting);
        let mut model = Model::uniform(rig, 12e3).expect("a model");
        model.tip = TipLaw::load([0.2, 0.0]);
        let jump = |at: f64, to: f64| Profile::new(vec![[at, 0.0], [at, to]]).expect("a profile");
        let done = Insertion {
            depth_m: vec![0.02, 0.05, 0.09],
            rotation_rad: jump(0.04, std::f64::consts::PI),
            guide2_m: Some([jump(0.06, 1e-3), Profile::default()]),
            ..Insertion::default()
        };
        let model_m = predict(&model, &Experiment::Insertion(done)).expect("predicts").tip_m.y;
        for (depth_mm, expected_m) in [20, 50, 90].into_iter().zip(model_m) {
            let found_m = path_m[2 * depth_mm][0];
            assert!((found_m - expected_m).abs() < 8e-6, "{found_m} is not {expected_m} at {depth_mm} mm");
        }
    }
}
