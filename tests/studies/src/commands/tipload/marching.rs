//! The tip's path by finite differences: a needle that grows node by node through tissue whose springs rest where the tip has cut.
//!
//! No part of this module calls the forward model. The bending energy is that of second differences, the tissue a row
//! of springs; each node of the cut path carries the spring of the half cell before it, at rest where the tip arrived,
//! and of the half cell after it, at rest where the tip was when it left. The equilibrium at every depth is solved
//! again with a pentadiagonal factorisation.

/// Distance of nodes, m.
pub const STEP_M: f64 = 0.5e-3;

/// Mounting of a needle outside the tissue.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Held {
    /// A clamp in guide 1, and guide 2 at this distance from it, m.
    TwoGuides(f64),
    /// One guide, in which a moment per slope (N m/rad) turns the needle back.
    OneGuide(f64),
}

/// A needle in its guides that is pushed into tissue. Lengths are multiples of [`STEP_M`].
#[derive(Debug, Clone, PartialEq)]
pub struct Needle {
    /// Bending stiffness, N m^2.
    pub bending_n_m2: f64,
    /// Mounting of the needle.
    pub held: Held,
    /// From the guide that moves to the tissue, m.
    pub gap_m: f64,
    /// Foundation modulus, Pa.
    pub modulus_pa: f64,
    /// Depth of the softer tissue, m, and its factor; 0 and 1 if it is uniform.
    pub softer: [f64; 2],
    /// Stiffness of the skin, at rest where it was cut, N/m.
    pub skin_n_per_m: f64,
}

/// In uniform tissue without a skin.
pub const PLAIN: Needle = Needle {
    bending_n_m2: 0.0157,
    held: Held::OneGuide(1.0),
    gap_m: 0.02,
    modulus_pa: 0.0,
    softer: [0.0, 1.0],
    skin_n_per_m: 0.0,
};

/// Loads at one node, on arriving there and on leaving: tip load, N, and displacement of guide 2, m.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct NodeLoads {
    /// Tip load, N.
    pub load_n: [f64; 2],
    /// Displacement of guide 2, m.
    pub guide2_m: [f64; 2],
}

/// Number of the node nearest to a length.
pub fn node_at(length_m: f64) -> usize {
    (length_m / STEP_M).round() as usize
}

/// The tip at a node of the path, on arriving and on leaving.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Tip {
    /// Position, m.
    pub at_m: [f64; 2],
    /// Slope of the needle, rad.
    pub slope_rad: [f64; 2],
}

impl Needle {
    /// The tip at every node of the path; `acting` for each of them.
    pub fn path(&self, acting: &[NodeLoads]) -> Vec<Tip> {
        let (guide2_m, rear_n_m) = match self.held {
            Held::TwoGuides(guide2_m) => (guide2_m, f64::INFINITY),
            Held::OneGuide(rear_n_m) => (0.0, rear_n_m),
        };
        let (guide, entry) = (node_at(guide2_m), node_at(guide2_m + self.gap_m));
        let [soft_m, times] = self.softer;
        let mut path: Vec<Tip> = Vec::with_capacity(acting.len());
        for (step, now) in acting.iter().enumerate() {
            let tip = entry + step;
            let solve = |side: usize, own_m: Option<f64>| {
                let mut beam = Beam::new(tip, self.bending_n_m2, rear_n_m);
                if guide > 0 {
                    beam.hold(0, 0.0);
                }
                for (node, Tip { at_m: [arrived_m, left_m], .. }) in path.iter().enumerate() {
                    // The half cell before the surface is empty.
                    if node > 0 {
                        beam.spring(
                            entry + node,
                            self.half_n_per_m(node as f64 - 0.25, soft_m, times),
                            *arrived_m,
                        );
                    }
                    beam.spring(entry + node, self.half_n_per_m(node as f64 + 0.25, soft_m, times), *left_m);
                }
                if let Some(Tip { at_m: [_, cut_m], .. }) = path.first() {
                    beam.spring(entry, self.skin_n_per_m, *cut_m);
                }
                // The newest spring is at rest where the tip arrives, and pulls back when it is moved from there.
                if let (Some(insertion_depth_m), true) = (own_m, step > 0) {
                    beam.spring(tip, self.half_n_per_m(step as f64 - 0.25, soft_m, times), insertion_depth_m);
                }
                beam.force_n[tip] += now.load_n[side];
                beam.hold(guide, now.guide2_m[side]);
                beam.tip()
            };
            let arriving = solve(0, None);
            let moved = now.load_n[0] != now.load_n[1] || now.guide2_m[0] != now.guide2_m[1];
            let leaving = if moved { solve(1, Some(arriving[0])) } else { arriving };
            let [tip_m, slope_rad] = [0, 1].map(|i| [arriving[i], leaving[i]]);
            path.push(Tip { at_m: tip_m, slope_rad });
        }
        path
    }

    /// Stiffness of the half cell with its middle at this many steps.
    fn half_n_per_m(&self, steps: f64, soft_m: f64, times: f64) -> f64 {
        0.5 * STEP_M * self.modulus_pa / if steps * STEP_M < soft_m { times } else { 1.0 }
    }
}

/// Nodes 0 to `tip`; the moment at node 0 is in proportion to the slope there, in a clamp without limit.
struct Beam {
    /// Diagonal and two bands above it.
    bands: Vec<[f64; 3]>,
    force_n: Vec<f64>,
}

impl Beam {
    fn new(tip: usize, bending_n_m2: f64, rear_n_m: f64) -> Self {
        let mut beam = Self { bands: vec![[0.0; 3]; tip + 1], force_n: vec![0.0; tip + 1] };
        let stiffness = bending_n_m2 / STEP_M.powi(3);
        // Half a cell that bends, 2 EI/h per angle, behind the spring that turns.
        let half_cell_n_m = 2.0 * bending_n_m2 / STEP_M;
        let turning = 1.0 / (1.0 / half_cell_n_m + 1.0 / rear_n_m) / (STEP_M * STEP_M);
        beam.bands[0][0] += turning;
        beam.bands[0][1] -= turning;
        beam.bands[1][0] += turning;
        for middle in 1..tip {
            for (i, a) in [1.0, -2.0, 1.0].into_iter().enumerate() {
                for (j, b) in [1.0, -2.0, 1.0].into_iter().enumerate().skip(i) {
                    beam.bands[middle - 1 + i][j - i] += stiffness * a * b;
                }
            }
        }
        beam
    }

    fn spring(&mut self, node: usize, stiffness_n_per_m: f64, rest_m: f64) {
        self.bands[node][0] += stiffness_n_per_m;
        self.force_n[node] += stiffness_n_per_m * rest_m;
    }

    /// Keeps a node at a place.
    fn hold(&mut self, node: usize, at_m: f64) {
        for distance in 1..=2 {
            if let Some(previous_node) = node.checked_sub(distance) {
                self.force_n[previous_node] -= self.bands[previous_node][distance] * at_m;
                self.bands[previous_node][distance] = 0.0;
            }
            if node + distance < self.force_n.len() {
                self.force_n[node + distance] -= self.bands[node][distance] * at_m;
            }
        }
        self.bands[node] = [1.0, 0.0, 0.0];
        self.force_n[node] = at_m;
    }

    /// Deflection of the last node, and the slope there: forward elimination, and the last nodes backward.
    fn tip(mut self) -> [f64; 2] {
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
        let last_m = self.force_n[count - 1] / self.bands[count - 1][0];
        let [diagonal, next, _] = self.bands[count - 2];
        let previous_m = (self.force_n[count - 2] - next * last_m) / diagonal;
        let [diagonal, next, second] = self.bands[count - 3];
        let earlier_m = (self.force_n[count - 3] - next * previous_m - second * last_m) / diagonal;
        [last_m, (1.5 * last_m - 2.0 * previous_m + 0.5 * earlier_m) / STEP_M]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path_m(needle: &Needle, acting: &[NodeLoads]) -> Vec<[f64; 2]> {
        needle.path(acting).iter().map(|tip| tip.at_m).collect()
    }

    /// A cantilever without tissue around it: guide 2 holds the needle, the tip load bends what is beyond and before it.
    #[test]
    fn a_needle_in_air_bends_like_two_spans() {
        let needle = Needle {
            bending_n_m2: 0.0157,
            held: Held::TwoGuides(0.06),
            gap_m: 0.02,
            modulus_pa: 0.0,
            ..PLAIN
        };
        let acting = vec![NodeLoads { load_n: [0.2; 2], ..NodeLoads::default() }; 81];
        let path_m = path_m(&needle, &acting);
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
        let needle = Needle {
            bending_n_m2: 0.0157,
            held: Held::TwoGuides(0.06),
            gap_m: 0.02,
            modulus_pa: 15e3,
            ..PLAIN
        };
        let mut acting = vec![NodeLoads::default(); 101];
        acting[60].guide2_m = [0.0, 1e-3];
        acting[61..].iter_mut().for_each(|now| now.guide2_m = [1e-3; 2]);
        let path_m = path_m(&needle, &acting);
        assert!(path_m[..=60].iter().all(|[arriving_m, _]| arriving_m.abs() < 1e-15));
        assert!(path_m[60][1].abs() > 1e-5 && path_m[61..].iter().all(|[tip_m, _]| tip_m.abs() > 1e-5));
    }

    /// Against the project's own forward model: constant load, a half turn, guide 2 moved at rest.
    #[test]
    fn the_forward_model_agrees() {
        use mechanics::{Experiment, Insertion, Model, Profile, Rig, TipLaw, predict};
        let rig = Rig::two_guides(mechanics::Needle::gauge_18(), 0.06, 0.085);
        let needle = Needle {
            bending_n_m2: rig.needle.bending_stiffness_n_m2(),
            held: Held::TwoGuides(0.06),
            gap_m: 0.025,
            modulus_pa: 12e3,
            ..PLAIN
        };
        let acting: Vec<NodeLoads> = (0..=200)
            .map(|step| NodeLoads {
                load_n: sides_of_step(step, 80, 0.2, -0.2),
                guide2_m: sides_of_step(step, 120, 0.0, 1e-3),
            })
            .collect();
        let path_m = path_m(&needle, &acting);
        let mut model = Model::uniform(rig, 12e3).expect("a model");
        model.tip = TipLaw::load([0.2, 0.0]);
        let insertion = Insertion {
            depth_m: vec![0.02, 0.05, 0.09],
            rotation_rad: jump_profile(0.04, std::f64::consts::PI),
            guide2_m: Some([jump_profile(0.06, 1e-3), Profile::default()]),
            ..Insertion::default()
        };
        let model_m = predict(&model, &Experiment::Insertion(insertion)).expect("predicts").tip_m.y;
        for (depth_mm, expected_m) in [20, 50, 90].into_iter().zip(model_m) {
            let marched_m = path_m[2 * depth_mm][0];
            assert!(
                (marched_m - expected_m).abs() < 8e-6,
                "{marched_m} is not {expected_m} at {depth_mm} mm"
            );
        }
    }

    fn jump_profile(at: f64, to: f64) -> mechanics::Profile {
        mechanics::Profile::new(vec![[at, 0.0], [at, to]]).expect("a profile")
    }

    fn sides_of_step(step: usize, at: usize, before: f64, after: f64) -> [f64; 2] {
        [if step > at { after } else { before }, if step >= at { after } else { before }]
    }

    /// The same with one guide, soft in rotation: position and slope of the tip.
    #[test]
    fn the_forward_model_agrees_about_one_guide() {
        use mechanics::{Experiment, Guides, Insertion, Model, Profile, Rig, TipLaw, predict};
        let needle = mechanics::Needle::gauge_18();
        let bending_n_m2 = needle.bending_stiffness_n_m2();
        let guides = Guides::One { rear_rotation_n_m_per_rad: [Some(0.8); 2] };
        let rig = Rig {
            needle,
            guide2_m: 0.0,
            entry_m: 0.028,
            guides,
            tolerances: mechanics::Tolerances::default(),
        };
        let needle =
            Needle { bending_n_m2, held: Held::OneGuide(0.8), gap_m: 0.028, modulus_pa: 12e3, ..PLAIN };
        let acting: Vec<NodeLoads> = (0..=200)
            .map(|step| NodeLoads {
                load_n: [0.2; 2],
                guide2_m: [if step > 60 { 2e-3 } else { 0.0 }, if step >= 60 { 2e-3 } else { 0.0 }],
            })
            .collect();
        let path = needle.path(&acting);
        let mut model = Model::uniform(rig, 12e3).expect("a model");
        model.tip = TipLaw::load([0.2, 0.0]);
        let jump = Profile::new(vec![[0.03, 0.0], [0.03, 2e-3]]).expect("a profile");
        let insertion = Insertion {
            depth_m: vec![0.02, 0.05, 0.09],
            guide2_m: Some([jump, Profile::default()]),
            tip_direction: true,
            ..Insertion::default()
        };
        let channels = predict(&model, &Experiment::Insertion(insertion)).expect("predicts");
        let position_and_direction = channels.tip_m.y.iter().zip(&channels.tip_direction_rad.y);
        for (depth_mm, (expected_m, expected_rad)) in [20, 50, 90].into_iter().zip(position_and_direction) {
            let Tip { at_m, slope_rad } = path[2 * depth_mm];
            assert!((at_m[0] - expected_m).abs() < 8e-6, "{at_m:?} is not {expected_m} at {depth_mm} mm");
            assert!((slope_rad[0] - expected_rad).abs() < 3e-4, "{slope_rad:?} is not {expected_rad}");
        }
    }

    /// The same through a soft layer under a skin: the two methods share neither elements nor rows.
    #[test]
    fn the_forward_model_agrees_about_layers_and_a_skin() {
        use mechanics::effects::effect;
        use mechanics::{Experiment, Insertion, Model, Profile, Rig, TipLaw, predict};
        let rig = Rig::two_guides(mechanics::Needle::gauge_18(), 0.06, 0.08);
        let needle = Needle {
            bending_n_m2: rig.needle.bending_stiffness_n_m2(),
            held: Held::TwoGuides(0.06),
            modulus_pa: 24e3,
            softer: [0.015, 3.0],
            skin_n_per_m: 1500.0,
            ..PLAIN
        };
        let acting: Vec<NodeLoads> = (0..=140)
            .map(|step| NodeLoads {
                load_n: [0.2; 2],
                guide2_m: [if step > 60 { 2e-3 } else { 0.0 }, if step >= 60 { 2e-3 } else { 0.0 }],
            })
            .collect();
        let marched = path_m(&needle, &acting);
        let mut model = Model::uniform(rig, 8e3).expect("a model");
        for (id, values) in [("tissue.layers", vec![3.0, 15.0]), ("tissue.skin", vec![1.5])] {
            model.effects.push((effect(id).expect("an effect"), values));
        }
        model.tip = TipLaw::load([0.2, 0.0]);
        let depth_m: Vec<f64> = (0..=70).map(|mm| 1e-3 * f64::from(mm)).collect();
        let moved = Profile::new(vec![[0.0, 0.0], [0.03, 0.0], [0.03, 2e-3]]).expect("a profile");
        let guide2_m = Some([moved, Profile::default()]);
        let insertion = Insertion { depth_m, guide2_m, ..Insertion::default() };
        let predicted = predict(&model, &Experiment::Insertion(insertion)).expect("predicts");
        let most_m = predicted.tip_m.y.iter().fold(0.0, |most: f64, tip_m| most.max(tip_m.abs()));
        for (mm, tip_m) in predicted.tip_m.y.iter().enumerate() {
            let difference_m = (tip_m - marched[2 * mm][0]).abs();
            assert!(difference_m < 5e-3 * most_m, "{mm} mm: {tip_m} and {}", marched[2 * mm][0]);
        }
    }
}
