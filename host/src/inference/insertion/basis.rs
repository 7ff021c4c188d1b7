//! The path as a linear function of its unknowns, for each candidate of modulus and gap.
//!
//! Unknowns in one plane: offset of the tip sensor (m), angle of entry (rad), tip load at the surface (N), and the change of the
//! tip load over each stretch of depth (N): a random walk of the load. A needle that is turned carries its load with it, which
//! couples the two planes.

use super::path::{ROTATION_STILL_RAD, TipPath};
use crate::model::growth::{Acting, Growth, Guide2Grip};
use crate::model::insertion::grid_m;
use crate::model::{Insertion, Model, ModelError};
use nalgebra::{DMatrix, DVector};
use std::sync::Arc;

/// Stretch of depth over which the tip load changes linearly; the needle smooths what is shorter.
const STRETCH_M: f64 = 5e-3;
/// Step of the insertion model here: one part in ten thousand of the path.
const STEP_M: f64 = 1e-3;
/// Unknowns in one plane before the changes of the load.
pub(super) const LEADING: usize = 3;
/// How many standard deviations of a prior the candidates reach to both sides, and how far they may be apart (logarithm).
const GRID_REACH: f64 = 2.0;
const GRID_STEP_LN: f64 = 0.5;

/// What is known of the tissue and the guide beforehand.
#[derive(Debug, Clone)]
pub struct Tissue {
    /// Rig, foundation and effects.
    pub model: Model,
    /// Standard deviation of the logarithm of a factor on the foundation's modulus.
    pub modulus_sd_ln: f64,
    /// Middle of the gap between guide 2 and the tissue, m.
    pub gap_m: f64,
    /// Standard deviation of its logarithm.
    pub gap_sd_ln: f64,
}

/// One possible modulus and gap.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// Factor on the modulus of the tissue.
    pub modulus_factor: f64,
    /// Distance from guide 2 to the tissue, m.
    pub gap_m: f64,
    /// Logarithm of its prior weight.
    pub ln_prior: f64,
}

/// Which unknowns there are.
#[derive(Debug, Clone, PartialEq)]
pub struct Layout {
    /// Ends of the stretches of the load.
    pub knots_m: Vec<f64>,
    /// Measured planes.
    pub planes: usize,
    /// Whether a turned needle couples both planes: then the unknowns of both stand in one vector.
    pub coupled: bool,
}

impl Layout {
    /// For a set of recordings of the same rig, down to `last_m`.
    pub fn new(paths: &[TipPath], last_m: f64) -> Self {
        let count = (last_m / STRETCH_M).ceil().max(1.0) as usize;
        let planes = paths.iter().map(|path| path.planes).min().unwrap_or(1);
        let turn = |path: &TipPath| path.done.rotation_rad.before(0.0);
        let first = paths.first().map_or(0.0, turn);
        let turned =
            paths.iter().any(|path| path.is_turned() || (turn(path) - first).abs() > ROTATION_STILL_RAD);
        let knots_m = (0..=count).map(|i| STRETCH_M * i as f64).collect();
        Self { knots_m, planes, coupled: turned && planes == 2 }
    }

    /// Unknowns of one plane.
    pub(super) fn of_plane(&self) -> usize {
        LEADING + self.knots_m.len() - 1
    }

    /// Length of the vector of unknowns.
    pub fn unknowns(&self) -> usize {
        if self.coupled { 2 * self.of_plane() } else { self.of_plane() }
    }

    /// Right-hand sides: the planes side by side where they are apart.
    pub(super) fn sides(&self) -> usize {
        if self.coupled { 1 } else { self.planes }
    }

    /// The combination of unknowns that is the tip load at a depth, in the needle's own frame; one vector per plane.
    pub fn load_rows(&self, depth_m: f64) -> Vec<DVector<f64>> {
        let share = |i: usize| ramp(&self.knots_m, i, depth_m);
        let plane = |at: usize| {
            let mut row = DVector::zeros(self.unknowns());
            row[at + LEADING - 1] = 1.0;
            (1..self.knots_m.len()).for_each(|i| row[at + LEADING + i - 1] = share(i));
            row
        };
        if self.coupled { vec![plane(0), plane(self.of_plane())] } else { vec![plane(0)] }
    }
}

/// Share of the change over stretch `i` that has happened at a depth.
fn ramp(knots_m: &[f64], i: usize, depth_m: f64) -> f64 {
    ((depth_m - knots_m[i - 1]) / (knots_m[i] - knots_m[i - 1])).clamp(0.0, 1.0)
}

/// The paths of all recordings per unit of each unknown, for every candidate.
#[derive(Debug, Clone)]
pub struct Candidates {
    /// Modulus and gap of each.
    pub list: Vec<Candidate>,
    /// Distance of neighbours: logarithms of modulus and gap; 0 where there is one only.
    pub steps_ln: [f64; 2],
    /// The same unknowns for all.
    pub layout: Layout,
    /// Per candidate, per recording.
    pub(super) bases: Vec<Vec<Basis>>,
}

impl Candidates {
    /// Solves the insertion of every candidate for every recording.
    ///
    /// # Errors
    /// As [`Growth::new`].
    pub fn new(tissue: &Tissue, paths: &[TipPath], last_m: f64) -> Result<Self, ModelError> {
        let layout = Layout::new(paths, last_m);
        let sides = |sd_ln: f64| {
            if sd_ln > 0.0 { (GRID_REACH * sd_ln / GRID_STEP_LN).ceil().max(2.0) as i32 } else { 0 }
        };
        // Standard deviations from the middle.
        let grid = |sd_ln: f64| {
            let sides = sides(sd_ln);
            (-sides..=sides).map(move |i| GRID_REACH * f64::from(i) / f64::from(sides.max(1)))
        };
        let mut list = Vec::new();
        for k in grid(tissue.modulus_sd_ln) {
            for g in grid(tissue.gap_sd_ln) {
                list.push(Candidate {
                    modulus_factor: (k * tissue.modulus_sd_ln).exp(),
                    gap_m: tissue.gap_m * (g * tissue.gap_sd_ln).exp(),
                    ln_prior: -0.5 * (k * k + g * g),
                });
            }
        }
        let bases: Result<_, _> =
            list.iter().map(|candidate| bases(&tissue.model, candidate, &layout, paths)).collect();
        let step_ln = |sd_ln: f64| GRID_REACH * sd_ln / f64::from(sides(sd_ln).max(1));
        let steps_ln = [tissue.modulus_sd_ln, tissue.gap_sd_ln].map(step_ln);
        Ok(Self { bases: bases?, list, steps_ln, layout })
    }
}

/// One candidate's responses for every recording; those in which nothing jumps share them.
fn bases(
    model: &Model,
    candidate: &Candidate,
    layout: &Layout,
    paths: &[TipPath],
) -> Result<Vec<Basis>, ModelError> {
    let last_m = layout.knots_m.last().copied().unwrap_or(STRETCH_M);
    let mut model = model.clone();
    model.rig.entry_m = model.rig.guide2_m + candidate.gap_m;
    model.foundation = model.foundation.scaled(candidate.modulus_factor)?;
    let problem = model.problem(last_m)?;
    let mut shared: Option<(Arc<Growth>, Arc<Blocks>)> = None;
    let mut bases = Vec::with_capacity(paths.len());
    for path in paths {
        let (growth, blocks) = if path.is_turned() || has_jumps(&path.done) || layout.coupled {
            let growth =
                Growth::new(&problem, grid_m(last_m, STEP_M, &jumps_m(&path.done)), Guide2Grip::Holding)?;
            let blocks = Arc::new(blocks(&growth, layout, Some(&path.done)));
            (Arc::new(growth), blocks)
        } else {
            match &shared {
                Some(shared) => shared.clone(),
                None => {
                    let growth = Growth::new(&problem, grid_m(last_m, STEP_M, &[]), Guide2Grip::Holding)?;
                    let blocks = Arc::new(blocks(&growth, layout, None));
                    shared.insert((Arc::new(growth), blocks)).clone()
                }
            }
        };
        bases.push(Basis::new(&growth, blocks, &path.done));
    }
    Ok(bases)
}

fn has_jumps(done: &Insertion) -> bool {
    !jumps_m(done).is_empty()
}

fn jumps_m(done: &Insertion) -> Vec<f64> {
    let guide2 = done.guide2_m.iter().flatten();
    std::iter::once(&done.rotation_rad).chain(guide2).flat_map(|profile| profile.jumps_m()).collect()
}

/// Rows of the design at the nodes, on arriving and on leaving: one block for both planes, or one per plane where they are coupled.
type Blocks = Vec<[DMatrix<f64>; 2]>;

fn blocks(growth: &Growth, layout: &Layout, done: Option<&Insertion>) -> Blocks {
    let nodes_m = growth.depths_m();
    let (nodes, of_plane) = (nodes_m.len(), layout.of_plane());
    // Tip under each part of the load, times a function of the rotation.
    let under = |part: usize, turn: &dyn Fn(f64) -> f64| -> Vec<[f64; 2]> {
        let states = growth.under_load(|node| {
            let depth_m = nodes_m[node];
            let amount = if part == 0 { 1.0 } else { ramp(&layout.knots_m, part, depth_m) };
            let [before, after] = match done {
                Some(done) => [done.rotation_rad.before(depth_m), done.rotation_rad.after(depth_m)],
                None => [0.0; 2],
            };
            Acting { load_n: [amount * turn(before), amount * turn(after)], guide2_m: [0.0; 2] }
        });
        states.iter().map(|state| state.tip_m).collect()
    };
    let parts = of_plane - LEADING + 1;
    let along: Vec<_> = (0..parts).map(|part| under(part, &f64::cos)).collect();
    let fill = |block: &mut [DMatrix<f64>; 2], at: usize, sign: f64, responses: &[Vec<[f64; 2]>]| {
        for (part, response) in responses.iter().enumerate() {
            for (node, tip_m) in response.iter().enumerate() {
                for side in 0..2 {
                    block[side][(node, at + LEADING - 1 + part)] = sign * tip_m[side];
                }
            }
        }
    };
    let straight = |block: &mut [DMatrix<f64>; 2], at: usize| {
        for (node, depth_m) in nodes_m.iter().enumerate() {
            for side in block.iter_mut() {
                side[(node, at)] = 1.0;
                side[(node, at + 1)] = *depth_m;
            }
        }
    };
    let empty = || [DMatrix::zeros(nodes, layout.unknowns()), DMatrix::zeros(nodes, layout.unknowns())];
    let mut y = empty();
    straight(&mut y, 0);
    fill(&mut y, 0, 1.0, &along);
    if !layout.coupled {
        return vec![y];
    }
    let across: Vec<_> = (0..parts).map(|part| under(part, &f64::sin)).collect();
    let mut x = empty();
    straight(&mut x, of_plane);
    fill(&mut y, of_plane, -1.0, &across);
    fill(&mut x, 0, 1.0, &across);
    fill(&mut x, of_plane, 1.0, &along);
    vec![y, x]
}

/// One recording's path per unit of each unknown, under one candidate.
#[derive(Debug, Clone)]
pub(super) struct Basis {
    nodes_m: Vec<f64>,
    blocks: Arc<Blocks>,
    /// What guide 2 does to the tip, per plane, on arriving and on leaving.
    guide2_m: [Vec<[f64; 2]>; 2],
}

impl Basis {
    fn new(growth: &Growth, blocks: Arc<Blocks>, done: &Insertion) -> Self {
        let nodes_m = growth.depths_m().to_vec();
        let by_guide2 = |plane: usize| -> Vec<[f64; 2]> {
            let Some(profile) = done.guide2_m.as_ref().map(|planes| &planes[plane]) else {
                return vec![[0.0; 2]; nodes_m.len()];
            };
            let states = growth.under_load(|node| Acting {
                load_n: [0.0; 2],
                guide2_m: [profile.before(nodes_m[node]), profile.after(nodes_m[node])],
            });
            states.iter().map(|state| state.tip_m).collect()
        };
        Self { guide2_m: [by_guide2(0), by_guide2(1)], blocks, nodes_m }
    }

    /// Blocks of rows: 1, or one per plane.
    pub fn blocks(&self) -> usize {
        self.blocks.len()
    }

    /// The combination of unknowns that is the tip position at a depth.
    pub fn row(&self, block: usize, depth_m: f64, leaving: bool) -> DVector<f64> {
        let (from, to, share) = self.place(depth_m);
        let [arriving, left] = &self.blocks[block];
        match share {
            None => {
                if leaving {
                    left.row(from).transpose()
                } else {
                    arriving.row(from).transpose()
                }
            }
            Some(share) => left.row(from).transpose() * (1.0 - share) + arriving.row(to).transpose() * share,
        }
    }

    /// What guide 2 adds to the tip position at a depth.
    pub fn guide2_m(&self, plane: usize, depth_m: f64, leaving: bool) -> f64 {
        let (from, to, share) = self.place(depth_m);
        let values = &self.guide2_m[plane];
        match share {
            None => values[from][usize::from(leaving)],
            Some(share) => values[from][1] * (1.0 - share) + values[to][0] * share,
        }
    }

    /// Nodes on both sides of a depth and the share of the way between them; no share at a node itself and beyond the ends.
    fn place(&self, depth_m: f64) -> (usize, usize, Option<f64>) {
        let last = self.nodes_m.len() - 1;
        let next = self.nodes_m.partition_point(|node_m| *node_m < depth_m - 1e-9).min(last);
        if (self.nodes_m[next] - depth_m).abs() <= 1e-9
            || next == 0
            || (next == last && depth_m > self.nodes_m[last])
        {
            return (next, next, None);
        }
        let (from_m, to_m) = (self.nodes_m[next - 1], self.nodes_m[next]);
        (next - 1, next, Some((depth_m - from_m) / (to_m - from_m)))
    }
}
