//! The path of the tip under everything that acts on the needle, per unit, from the one forward model ([`GrowingBeam`]).

use crate::history::{History, Place};
use crate::unknowns::{CuttingLaw, KNOT_M, Unknowns};
use mechanics::ModelError;
use mechanics::growth::{GrowingBeam, Guide2Grip, NodeLoads, TipState};

/// A path: the tip at every node, on arriving and on leaving.
pub(crate) type Path = Vec<[f64; 2]>;

/// The needle at every node, of one tissue.
pub(crate) struct Tables {
    beam: GrowingBeam,
    law: CuttingLaw,
}

/// What acts in one plane, at a node on arriving and on leaving.
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
        Ok(Self { beam, law: unknowns.law })
    }

    /// Path under an input.
    pub fn path(&self, input: Input) -> Path {
        let states = match self.law {
            CuttingLaw::Load => self
                .beam
                .under_load(|node| NodeLoads { load_n: (input.tip)(node), guide2_m: (input.guide_m)(node) }),
            CuttingLaw::Angle => self.beam.moved_at_cut_angle(input.tip, input.guide_m, |_| [0.0; 2]),
        };
        tips(&states)
    }

    /// Path of a tip that cuts at this angle beside its load, which guide 2 does not change.
    pub fn beside(&self, angle_rad: impl Fn(usize) -> [f64; 2]) -> Path {
        tips(&self.beam.at_cut_angle(angle_rad, |_| 0.0))
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
    let from = (x.floor() as usize).min(knots.saturating_sub(2));
    [(from, 1.0 - (x - from as f64)), ((from + 1).min(knots - 1), x - from as f64)]
}

/// Everything acting of a vector of unknowns: what the two planes' paths are.
pub(crate) fn paths(tables: &Tables, unknowns: &Unknowns, values: &[f64], history: &History) -> [Path; 2] {
    let knots = unknowns.knots;
    let body = |start: &dyn Fn(usize) -> usize, depth_m: f64| {
        hats(depth_m, knots)
            .iter()
            .map(|(knot, weight)| weight * unknowns.value(values, start(*knot)))
            .sum::<f64>()
    };
    // Load or angle in the needle's frame, per node.
    let own: Vec<[f64; 2]> = history
        .depths_m
        .iter()
        .map(|m| [0, 1].map(|direction| body(&|knot| unknowns.tip(direction, knot), *m)))
        .collect();
    let beside = [0, 1].map(|direction| unknowns.value(values, unknowns.beside() + direction));
    [0, 1].map(|plane| {
        let offset_m = unknowns.value(values, unknowns.guide_offset() + plane);
        let play_m = unknowns.value(values, unknowns.backlash() + plane);
        let guide_m = |node: usize| {
            let at = &history.nodes[node];
            [0, 1].map(|side| at.guide_m[plane][side] + offset_m - play_m * at.play[plane][side])
        };
        let tip = |node: usize| history.nodes[node].bevel_rad.map(|turn| turned(own[node], turn, plane));
        let mut path = tables.path(Input { guide_m: &guide_m, tip: &tip });
        if unknowns.law == CuttingLaw::Load {
            let angle = |node: usize| history.nodes[node].bevel_rad.map(|turn| turned(beside, turn, plane));
            let more = tables.beside(angle);
            path.iter_mut().zip(more).for_each(|(to, more)| *to = [to[0] + more[0], to[1] + more[1]]);
        }
        let slope = unknowns.value(values, unknowns.slope() + plane);
        let at_surface_m = unknowns.value(values, unknowns.offset() + plane);
        for (to, depth_m) in path.iter_mut().zip(&history.depths_m) {
            let irregular = body(&|knot| unknowns.irregularity(plane, knot), *depth_m);
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
    // On arriving at the node nothing acts yet.
    let from = |at: usize, value: f64| match at.cmp(&node) {
        std::cmp::Ordering::Less => [0.0; 2],
        std::cmp::Ordering::Equal => [0.0, value],
        std::cmp::Ordering::Greater => [value; 2],
    };
    [0, 1].map(|direction| {
        let own = |at_node: usize| {
            let depth_m = history.depths_m[at_node];
            let knots = hats(depth_m, unknowns.knots);
            let value = |(knot, weight): &(usize, f64)| {
                weight * unknowns.value(values, unknowns.tip(direction, *knot))
            };
            from(at_node, knots.iter().map(value).sum())
        };
        let path = tables.path(Input { guide_m: &|_| [0.0; 2], tip: &own });
        let beside = match unknowns.law {
            CuttingLaw::Load => {
                let angle = unknowns.value(values, unknowns.beside() + direction);
                at(&tables.beside(|at_node| from(at_node, angle)), last)
            }
            CuttingLaw::Angle => 0.0,
        };
        at(&path, last) + beside
    })
}

/// What is fixed to the needle (along and across the bevel) in plane x (0) or y (1), turned by an angle.
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
        let none = |_: usize| [0.0; 2];
        let play = [0, 1].map(|plane| {
            let guide_m = |node: usize| history.nodes[node].play[plane].map(|side| -side);
            tables.path(Input { guide_m: &guide_m, tip: &none })
        });
        let parts = |node: usize, part: usize| {
            history.nodes[node].bevel_rad.map(|turn| if part == 0 { turn.cos() } else { turn.sin() })
        };
        let tip = (0..unknowns.knots)
            .map(|knot| {
                [0, 1].map(|part| {
                    let hat = |node: usize| {
                        let weights = hats(history.depths_m[node], unknowns.knots);
                        let weight: f64 =
                            weights.iter().filter(|(at, _)| *at == knot).map(|(_, weight)| weight).sum();
                        parts(node, part).map(|part| weight * part)
                    };
                    tables.path(Input { guide_m: &none, tip: &hat })
                })
            })
            .collect();
        let beside = match unknowns.law {
            CuttingLaw::Load => [0, 1].map(|part| tables.beside(|node| parts(node, part))),
            CuttingLaw::Angle => [0, 1].map(|_| vec![[0.0; 2]; history.depths_m.len()]),
        };
        let unit = |_: usize| [1.0; 2];
        Self { guide: tables.path(Input { guide_m: &unit, tip: &none }), play, tip, beside }
    }

    /// Derivatives of the tip in a plane at a place and depth with respect to the unknowns (counted in standard deviations), into
    /// `row`; those of the tissue are left as they are.
    pub fn fill(&self, unknowns: &Unknowns, place: Place, depth_m: f64, plane: usize, row: &mut [f64]) {
        let mut set = |place: usize, value: f64| row[place] = unknowns.sd[place] * value;
        set(unknowns.slope() + plane, depth_m);
        set(unknowns.offset() + plane, 1.0);
        set(unknowns.guide_offset() + plane, at(&self.guide, place));
        set(unknowns.backlash() + plane, at(&self.play[plane], place));
        let turned = |[cos, sin]: [f64; 2]| if plane == 0 { [cos, -sin] } else { [sin, cos] };
        for (knot, parts) in self.tip.iter().enumerate() {
            let values = turned([0, 1].map(|part: usize| at(&parts[part], place)));
            (0..2).for_each(|direction| set(unknowns.tip(direction, knot), values[direction]));
        }
        let values = turned([0, 1].map(|part: usize| at(&self.beside[part], place)));
        (0..2).for_each(|direction| set(unknowns.beside() + direction, values[direction]));
        for (knot, weight) in hats(depth_m, unknowns.knots) {
            if weight > 0.0 {
                set(unknowns.irregularity(plane, knot), weight);
            }
        }
    }
}
