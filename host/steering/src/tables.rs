//! The path of the tip under everything that acts on the needle, per unit, from the one forward model ([`GrowingBeam`]).

use crate::history::{History, Place};
use crate::unknowns::{CuttingLaw, KNOT_M, Unknowns};
use mechanics::ModelError;
use mechanics::growth::{GrowingBeam, Guide2Grip, NodeLoads, TipState};
use mechanics::inner::{HeldNeedle, Inner};
use std::sync::OnceLock;

/// A path: the tip at every node, on arriving and on leaving.
pub(crate) type Path = Vec<[f64; 2]>;

/// The needle at every node, of one tissue.
pub(crate) struct Tables {
    beam: GrowingBeam,
    /// The same needle at rest, for what is inside it.
    pub held: HeldNeedle,
    /// Force of guide 2 per displacement of it, by node, once it was asked for.
    stiffness_n_per_m: Vec<OnceLock<f64>>,
    law: CuttingLaw,
}

/// Loads in one plane, at a node on arriving and on leaving.
#[derive(Clone, Copy)]
pub(crate) struct Input<'a> {
    /// Displacement of guide 2, m.
    pub guide_m: &'a dyn Fn(usize) -> [f64; 2],
    /// Load (N) or angle (rad) of the tip, by the law.
    pub tip: &'a dyn Fn(usize) -> [f64; 2],
}

impl Tables {
    /// Solves the needle for a vector of unknowns.
    pub fn new(unknowns: &Unknowns, values: &[f64], depths_m: &[f64]) -> Result<Self, ModelError> {
        let problem = unknowns.problem(values)?;
        let grip = Guide2Grip::Holding;
        let beam = GrowingBeam::new(&problem, depths_m.to_vec(), grip)?;
        let stiffness_n_per_m = vec![OnceLock::new(); depths_m.len()];
        Ok(Self { beam, held: HeldNeedle::new(&problem, depths_m)?, stiffness_n_per_m, law: unknowns.law })
    }

    /// Force of guide 2 per displacement of it while the tip rests at a node, N/m; nothing where it cannot be computed.
    pub fn stiffness_n_per_m(&self, node: usize) -> Option<f64> {
        let stiffness = *self.stiffness_n_per_m.get(node)?.get_or_init(|| {
            let force_response = self.held.at(node, &[Inner::Guide2Force]);
            force_response
                .ok()
                .and_then(|force_response| Some(force_response.first()?.guide2))
                .unwrap_or(f64::NAN)
        });
        (stiffness > 0.0).then_some(stiffness)
    }

    /// Tip and its load under an input.
    pub fn states(&self, input: Input) -> Vec<TipState> {
        match self.law {
            CuttingLaw::Load => self
                .beam
                .under_load(|node| NodeLoads { load_n: (input.tip)(node), guide2_m: (input.guide_m)(node) }),
            CuttingLaw::Angle => self.beam.moved_at_cut_angle(input.tip, input.guide_m, |_| [0.0; 2]),
        }
    }

    /// Path under an input.
    pub fn path(&self, input: Input) -> Path {
        tips(&self.states(input))
    }

    /// The same for a guide that is moved by a metre at rest at a node and stays there.
    pub fn moved_at(&self, node: usize) -> Vec<TipState> {
        self.states(Input { guide_m: &|at| moved_from(node, at), tip: &|_| [0.0; 2] })
    }

    /// A tip that cuts at this angle beside its load, which guide 2 does not change.
    fn beside(&self, angle_rad: impl Fn(usize) -> [f64; 2]) -> Vec<TipState> {
        self.beam.at_cut_angle(angle_rad, |_| 0.0)
    }
}

/// A unit that acts from a node on: there on leaving, after it also on arriving.
pub(crate) fn moved_from(node: usize, at: usize) -> [f64; 2] {
    match at.cmp(&node) {
        std::cmp::Ordering::Less => [0.0; 2],
        std::cmp::Ordering::Equal => [0.0, 1.0],
        std::cmp::Ordering::Greater => [1.0; 2],
    }
}

fn tips(states: &[TipState]) -> Path {
    states.iter().map(|state| state.tip_m).collect()
}

/// A path at a place.
pub(crate) fn at(path: &Path, place: Place) -> f64 {
    match place {
        Place::Rest(node, side) => path[node][side],
        Place::Between(node, share) => {
            let next = (node + 1).min(path.len() - 1);
            path[node][1] + share * (path[next][0] - path[node][1])
        }
    }
}

/// Weights of the knots at a depth: linear between them.
pub(crate) fn hats(depth_m: f64, knots: usize) -> [(usize, f64); 2] {
    let x = (depth_m / KNOT_M).clamp(0.0, (knots - 1) as f64);
    let first_knot = (x.floor() as usize).min(knots.saturating_sub(2));
    [(first_knot, 1.0 - (x - first_knot as f64)), ((first_knot + 1).min(knots - 1), x - first_knot as f64)]
}

/// Sum of what acts at the knots at a depth.
fn at_knots(unknowns: &Unknowns, values: &[f64], start: impl Fn(usize) -> usize, depth_m: f64) -> f64 {
    let hats = hats(depth_m, unknowns.knots);
    hats.iter().map(|(knot, weight)| weight * unknowns.value(values, start(*knot))).sum()
}

/// One plane by a vector of unknowns: the needle bent by guide 2 and tip.
pub(crate) struct Bent {
    /// True displacement of guide 2 at every node, on arriving and on leaving, m.
    pub guide_m: Vec<[f64; 2]>,
    /// Tip and its load.
    pub states: Vec<TipState>,
}

/// Deflection of the needle in both planes by a vector of unknowns.
pub(crate) fn bent(tables: &Tables, unknowns: &Unknowns, values: &[f64], history: &History) -> [Bent; 2] {
    // Load or angle in the needle's frame, per node.
    let knot_values: Vec<[f64; 2]> = history
        .depths_m
        .iter()
        .map(|m| [0, 1].map(|direction| at_knots(unknowns, values, |knot| unknowns.tip(direction, knot), *m)))
        .collect();
    let lateral_cut = [0, 1].map(|direction| unknowns.value(values, unknowns.beside() + direction));
    [0, 1].map(|plane| {
        let offset_m = unknowns.value(values, unknowns.guide_offset() + plane);
        let play_m = unknowns.value(values, unknowns.backlash() + plane);
        let guide_m: Vec<[f64; 2]> = history
            .nodes
            .iter()
            .map(|at| [0, 1].map(|side| at.guide_m[plane][side] + offset_m - play_m * at.play[plane][side]))
            .collect();
        let tip =
            |node: usize| history.nodes[node].bevel_rad.map(|turn| turned(knot_values[node], turn, plane));
        let mut states = tables.states(Input { guide_m: &|node| guide_m[node], tip: &tip });
        if unknowns.law == CuttingLaw::Load {
            for (to, more) in states.iter_mut().zip(tables.beside(|node: usize| {
                history.nodes[node].bevel_rad.map(|turn| turned(lateral_cut, turn, plane))
            })) {
                for side in 0..2 {
                    to.tip_m[side] += more.tip_m[side];
                    to.load_n[side] += more.load_n[side];
                }
            }
        }
        Bent { guide_m, states }
    })
}

/// Everything acting of a vector of unknowns: what the two planes' paths are.
pub(crate) fn paths(tables: &Tables, unknowns: &Unknowns, values: &[f64], history: &History) -> [Path; 2] {
    let bent = bent(tables, unknowns, values, history);
    [0, 1].map(|plane| {
        let mut path = tips(&bent[plane].states);
        let slope = unknowns.value(values, unknowns.slope() + plane);
        let at_surface_m = unknowns.value(values, unknowns.offset() + plane);
        for (to, depth_m) in path.iter_mut().zip(&history.depths_m) {
            let irregular = at_knots(unknowns, values, |knot| unknowns.irregularity(plane, knot), *depth_m);
            let straight = at_surface_m + slope * depth_m + irregular;
            *to = to.map(|m| m + straight);
        }
        path
    })
}

/// Effect at the target of what is fixed to the needle (load or angle) from a node on, along and across the bevel, m.
pub(crate) fn after(
    tables: &Tables,
    unknowns: &Unknowns,
    values: &[f64],
    history: &History,
    node: usize,
) -> [f64; 2] {
    let last = Place::Rest(history.depths_m.len() - 1, 0);
    [0, 1].map(|direction| {
        let own = |at_node: usize| {
            let depth_m = history.depths_m[at_node];
            let knots = hats(depth_m, unknowns.knots);
            moved_weight(
                at_node,
                knots
                    .iter()
                    .map(|(knot, weight)| weight * unknowns.value(values, unknowns.tip(direction, *knot)))
                    .sum(),
                node,
            )
        };
        let path = tables.path(Input { guide_m: &|_| [0.0; 2], tip: &own });
        let lateral_cut = match unknowns.law {
            CuttingLaw::Load => {
                let angle = unknowns.value(values, unknowns.beside() + direction);
                at(&tips(&tables.beside(|at_node| moved_weight(at_node, angle, node))), last)
            }
            CuttingLaw::Angle => 0.0,
        };
        at(&path, last) + lateral_cut
    })
}

fn moved_weight(at: usize, value: f64, node: usize) -> [f64; 2] {
    moved_from(node, at).map(|share| share * value)
}

/// Component in plane x (0) or y (1) of a vector that is fixed to the needle (along and across the
/// bevel), turned by an angle.
pub(crate) fn turned([along, across]: [f64; 2], angle_rad: f64, plane: usize) -> f64 {
    let (sin, cos) = angle_rad.sin_cos();
    [cos * along - sin * across, sin * along + cos * across][plane]
}

/// Derivatives of the paths with respect to what they are linear in, at places: per place and plane the unknowns that count.
pub(crate) struct Columns {
    /// Per unit of constant guide displacement.
    guide: Path,
    /// Per unit of play, x and y.
    play: [Path; 2],
    /// Per knot, of load or angle times cosine and sine of the bevel's direction.
    tip: Vec<[Path; 2]>,
    /// Per cut angle beside a load, cosine and sine.
    beside: [Path; 2],
}

impl Columns {
    pub fn new(tables: &Tables, unknowns: &Unknowns, history: &History) -> Self {
        let play = [0, 1].map(|plane| {
            let guide_m = |node: usize| history.nodes[node].play[plane].map(|side| -side);
            tables.path(Input { guide_m: &guide_m, tip: &no_motion })
        });
        let tip = (0..unknowns.knots)
            .map(|knot| {
                [0, 1].map(|part| {
                    let hat = |node: usize| {
                        let weights = hats(history.depths_m[node], unknowns.knots);
                        let weight: f64 =
                            weights.iter().filter(|(at, _)| *at == knot).map(|(_, weight)| weight).sum();
                        tip_part(node, part, &history.nodes).map(|part| weight * part)
                    };
                    tables.path(Input { guide_m: &no_motion, tip: &hat })
                })
            })
            .collect();
        let lateral_responses = match unknowns.law {
            CuttingLaw::Load => {
                [0, 1].map(|part| tips(&tables.beside(|node| tip_part(node, part, &history.nodes))))
            }
            CuttingLaw::Angle => [0, 1].map(|_| vec![[0.0; 2]; history.depths_m.len()]),
        };
        Self {
            guide: tables.path(Input { guide_m: &unit_motion, tip: &no_motion }),
            play,
            tip,
            beside: lateral_responses,
        }
    }

    /// Derivatives of the tip in a plane at a place and depth with respect to the unknowns (counted in standard deviations), into
    /// `row`; those of the tissue are left as they are.
    pub fn fill(&self, unknowns: &Unknowns, place: Place, depth_m: f64, plane: usize, row: &mut [f64]) {
        unknowns.carry(depth_m, plane, row);
        let mut set = |place: usize, value: f64| row[place] = unknowns.sd[place] * value;
        set(unknowns.guide_offset() + plane, at(&self.guide, place));
        set(unknowns.backlash() + plane, at(&self.play[plane], place));
        for (knot, parts) in self.tip.iter().enumerate() {
            let values = rotated([0, 1].map(|part: usize| at(&parts[part], place)), plane);
            (0..2).for_each(|direction| set(unknowns.tip(direction, knot), values[direction]));
        }
        let values = rotated([0, 1].map(|part: usize| at(&self.beside[part], place)), plane);
        (0..2).for_each(|direction| set(unknowns.beside() + direction, values[direction]));
    }
}

fn rotated([cos, sin]: [f64; 2], plane: usize) -> [f64; 2] {
    if plane == 0 { [cos, -sin] } else { [sin, cos] }
}

fn unit_motion(_: usize) -> [f64; 2] {
    [1.0; 2]
}

fn no_motion(_: usize) -> [f64; 2] {
    [0.0; 2]
}

fn tip_part(node: usize, part: usize, nodes: &[crate::history::AtNode]) -> [f64; 2] {
    nodes[node].bevel_rad.map(|turn| if part == 0 { turn.cos() } else { turn.sin() })
}
