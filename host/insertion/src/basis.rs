//! One recording's path as a linear function of its unknowns, at one candidate of modulus and gap.
//!
//! The effect of a difference of this insertion's modulus or surface is linear too: the derivative of the path under
//! the load that the path itself requires, times the difference. Products of small differences are neglected.

use super::candidates::{Candidate, Candidates, Parts, Responses};
use super::lattice::Smooth;
use super::layout::{ANGLE, BENDS, DRIFT, DRIFTS, ENTRY, GAP, GUIDE2, LOAD, Layout, MODULUS, OFFSET};
use super::motion::Motion;
use super::path::{Bin, TipPath};
use super::place::Place;
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use std::sync::Arc;

/// Measured quantity of the tip.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Measured {
    /// Position, m.
    Position,
    /// The slope of the needle there, rad.
    Direction,
}

impl Measured {
    /// Value of a bin in a plane.
    pub fn of(self, bin: &Bin, plane: usize) -> Option<f64> {
        match self {
            Self::Position => Some(bin.tip_m[plane]),
            Self::Direction => bin.direction_rad[plane],
        }
    }
}

/// One recording's path per unit of each unknown.
#[derive(Debug, Clone)]
pub(super) struct Basis {
    layout: Layout,
    nodes_m: Arc<Vec<f64>>,
    responses: [Arc<Smooth>; 2],
    guide2: Option<[Arc<Smooth>; 2]>,
    motion: Option<Arc<[Motion; 2]>>,
    parts: Parts,
    rear_share: [f64; 2],
    /// Effects on position and direction, per plane.
    own: [[Own; 2]; 2],
    /// The same of what 1 m of guide 2 does at once.
    own_at_once: [[Own; 2]; 2],
}

/// Effects of one recording's differences on its path under its load.
#[derive(Debug, Clone, Default)]
struct Own {
    modulus: Vec<f64>,
    entry: Vec<f64>,
    gap: Vec<f64>,
    rear: Vec<f64>,
}

impl Basis {
    /// Basis of recording `path` under a load (N, per plane in the needle's frame) about which differences are
    /// taken.
    pub fn new(
        candidates: &Candidates,
        responses: &Responses,
        candidate: Candidate,
        path: usize,
        load_n: [f64; 2],
    ) -> Self {
        let mut basis = Self::without_own(candidates, responses, candidate, path);
        basis.set_load(candidates.gap_m(candidate), load_n);
        basis
    }

    /// The same without what differs in this insertion.
    pub fn without_own(
        candidates: &Candidates,
        responses: &Responses,
        candidate: Candidate,
        path: usize,
    ) -> Self {
        Self {
            layout: candidates.layout.clone(),
            nodes_m: candidates.nodes_m(path),
            responses: responses.of_plan[candidates.plan(path)].clone(),
            guide2: responses.guide2_m.get(path).cloned().flatten(),
            motion: candidates.motion(path).cloned(),
            parts: Parts::of(&candidates.layout),
            rear_share: candidate.rear_share,
            own: Default::default(),
            own_at_once: Default::default(),
        }
    }

    /// Takes differences about a load.
    pub fn set_load(&mut self, gap_m: f64, load_n: [f64; 2]) {
        for measured in self.measured() {
            for plane in 0..self.layout.planes {
                let effects = self.differences(gap_m, plane, |of| self.loaded(measured, plane, load_n, of));
                let at_once = self.motion.is_some().then(|| {
                    let at_once_response = self.parts.at_once;
                    let response = &self.responses[plane];
                    self.differences(gap_m, plane, |of| {
                        self.slice(measured, of(response), at_once_response, self.parts.count).to_vec()
                    })
                });
                self.own[measured as usize][plane] = effects;
                self.own_at_once[measured as usize][plane] = at_once.unwrap_or_default();
            }
        }
    }

    /// Measured quantity under a load, or its dependence on the candidate.
    fn loaded(
        &self,
        measured: Measured,
        plane: usize,
        load_n: [f64; 2],
        of: fn(&Smooth) -> &Vec<f64>,
    ) -> Vec<f64> {
        let mut total = match &self.guide2 {
            Some(planes) => self.slice(measured, of(&planes[plane]), 0, 1).to_vec(),
            None => vec![0.0; 2 * self.nodes_m.len()],
        };
        // Loads of both planes, each with its sign.
        for (from, term) in self.load_parts(plane).into_iter().enumerate() {
            let Some((sign, response_part)) = term else { continue };
            let response = self.slice(measured, of(&self.responses[plane]), response_part, self.parts.count);
            total.iter_mut().zip(response).for_each(|(sum, value)| *sum += sign * load_n[from] * value);
        }
        total
    }

    /// Effect of a recording's differences on a quantity that depends on the candidate.
    fn differences(
        &self,
        gap_m: f64,
        plane: usize,
        course: impl Fn(fn(&Smooth) -> &Vec<f64>) -> Vec<f64>,
    ) -> Own {
        let gap = course(|smooth| &smooth.by_gap);
        let slopes = self.slopes(&course(|smooth| &smooth.value));
        // If the tissue begins later the gap is longer and the needle less deep in it.
        let entry = gap.iter().zip(&slopes).map(|(gap, slope)| gap / gap_m - slope).collect();
        let modulus = course(|smooth| &smooth.by_modulus);
        let is_unknown = !self.responses[plane].by_rear.is_empty();
        let rear = if is_unknown { course(|smooth| &smooth.by_rear) } else { Vec::new() };
        Own { modulus, entry, gap, rear }
    }

    /// Measured quantities.
    pub fn measured(&self) -> impl Iterator<Item = Measured> + use<> {
        let direction = self.layout.direction.then_some(Measured::Direction);
        std::iter::once(Measured::Position).chain(direction)
    }

    /// A part among `count` of them, which are there for the position before they are for the direction.
    fn slice<'v>(&self, measured: Measured, values: &'v [f64], part: usize, count: usize) -> &'v [f64] {
        let length = 2 * self.nodes_m.len();
        let first = (measured as usize * count + part) * length;
        values.get(first..first + length).unwrap_or_default()
    }

    /// For each plane's load: its sign in this plane and its place among the responses; `None` where it does nothing here.
    fn load_parts(&self, plane: usize) -> [Option<(f64, usize)>; 2] {
        let Parts { along, across, .. } = self.parts;
        match (self.layout.coupled, plane) {
            (false, 0) => [Some((1.0, along)), None],
            (false, _) => [None, Some((1.0, along))],
            (true, 0) => [Some((1.0, along)), Some((-1.0, across))],
            (true, _) => [Some((1.0, across)), Some((1.0, along))],
        }
    }

    /// Slope of a path at every node, before it and after it.
    fn slopes(&self, path_m: &[f64]) -> Vec<f64> {
        let nodes_m = &self.nodes_m;
        let last = nodes_m.len().saturating_sub(2);
        (0..nodes_m.len())
            .flat_map(|i| {
                [
                    slope_between(i.saturating_sub(1), path_m, nodes_m),
                    slope_between(i.min(last), path_m, nodes_m),
                ]
            })
            .collect()
    }

    /// Places of depths, on arriving or on leaving.
    pub fn places(&self, depths: impl IntoIterator<Item = (f64, bool)>) -> Vec<Place> {
        let motion = self.motion.as_deref();
        depths.into_iter().map(|depth| Place::new(&self.layout, &self.nodes_m, motion, depth)).collect()
    }

    /// Rows of a plane at several places: per unit of each of its vector's unknowns, and what guide 2 adds.
    pub fn rows(&self, plane: usize, measured: Measured, places: &[Place]) -> (DMatrix<f64>, Vec<f64>) {
        let mut rows = DMatrix::zeros(places.len(), self.layout.unknowns());
        let (_, first_column) = self.layout.place(plane);
        let response_part =
            |number: usize| self.slice(measured, &self.responses[plane].value, number, self.parts.count);
        fill_column(first_column + GUIDE2, 1.0, response_part(self.parts.guide2), &mut rows, places);
        for (from, term) in self.load_parts(plane).into_iter().enumerate() {
            let Some((sign, first)) = term else { continue };
            let first_row = if self.layout.coupled { from * self.layout.of_plane() } else { 0 };
            for knot in 0..=self.layout.knots_m.len() {
                fill_column(first_row + LOAD + knot, sign, response_part(first + knot), &mut rows, places);
            }
        }
        let (own_effects, at_once) =
            (&self.own[measured as usize][plane], &self.own_at_once[measured as usize][plane]);
        let differing = |of: fn(&Own) -> &Vec<f64>| -> Vec<f64> {
            if of(own_effects).is_empty() {
                return vec![0.0; places.len()];
            }
            let at_nodes = places.iter().map(|place| place.of(of(own_effects)));
            if of(at_once).is_empty() {
                return at_nodes.collect();
            }
            let guide_offset = places.iter().map(|place| offset_of(place, plane) * place.of(of(at_once)));
            at_nodes.zip(guide_offset).map(|(at_nodes, guide_offset)| at_nodes + guide_offset).collect()
        };
        let rears = differing(|own_effects| &own_effects.rear);
        rows.column_mut(first_column + MODULUS)
            .copy_from_slice(&differing(|own_effects| &own_effects.modulus));
        rows.column_mut(first_column + ENTRY).copy_from_slice(&differing(|own_effects| &own_effects.entry));
        rows.column_mut(first_column + GAP).copy_from_slice(&differing(|own_effects| &own_effects.gap));
        if let Some(rear) = self.layout.rear() {
            rows.column_mut(first_column + rear).copy_from_slice(&rears);
        }
        for (i, place) in places.iter().enumerate() {
            match (measured, self.layout.tilt()) {
                (Measured::Position, _) => {
                    rows[(i, first_column + OFFSET)] = 1.0;
                    rows[(i, first_column + ANGLE)] = place.depth_m;
                    (0..DRIFTS).for_each(|k| rows[(i, first_column + DRIFT + k)] = place.drifts[k]);
                }
                (Measured::Direction, tilt) => {
                    rows[(i, first_column + ANGLE)] = 1.0;
                    let Some(tilt) = tilt else { continue };
                    rows[(i, first_column + tilt)] = 1.0;
                    (0..BENDS).for_each(|k| rows[(i, first_column + tilt + 1 + k)] = place.drifts[k]);
                }
            }
        }
        let mut guide_response = self.moved(plane, measured, places);
        // The rear's share counts from the middle of what is known beforehand, not from where responses are solved.
        let rear_share = self.rear_share[plane];
        guide_response.iter_mut().zip(&rears).for_each(|(sum, rear)| *sum -= rear_share * rear);
        (rows, guide_response)
    }

    /// Effect of the recorded motion of guide 2 at locations.
    fn moved(&self, plane: usize, measured: Measured, places: &[Place]) -> Vec<f64> {
        let Some(planes) = &self.guide2 else { return vec![0.0; places.len()] };
        let moved = self.slice(measured, &planes[plane].value, 0, 1);
        let at_once =
            self.slice(measured, &self.responses[plane].value, self.parts.at_once, self.parts.count);
        places.iter().map(|place| place.of(moved) + place.beside_m[plane] * place.of(at_once)).collect()
    }

    /// One row, and what guide 2 adds.
    pub fn row(&self, plane: usize, measured: Measured, depth_m: f64, leaving: bool) -> (DVector<f64>, f64) {
        let (rows, offset_row) = self.rows(plane, measured, &self.places([(depth_m, leaving)]));
        (rows.row(0).transpose(), offset_row.first().copied().unwrap_or_default())
    }

    /// The constant load of each plane that suits a recording best, with an offset and an angle of its own; 0 where that is no number.
    pub fn fitted_load_n(&self, path: &TipPath, places: &[Place]) -> [f64; 2] {
        let mut loads_n = [0.0; 2];
        for (plane, fitted_n) in loads_n.iter_mut().enumerate().take(self.layout.planes) {
            let moved = self.moved(plane, Measured::Position, places);
            let value_slice = &self.responses[plane].value;
            let along_slice = self.slice(Measured::Position, value_slice, self.parts.along, self.parts.count);
            let mut squares = Matrix3::zeros();
            let mut pull = Vector3::zeros();
            for ((bin, place), moved_m) in path.bins.iter().zip(places).zip(moved) {
                let row = Vector3::new(1.0, place.depth_m, place.of(along_slice));
                squares += row * row.transpose();
                pull += row * (bin.tip_m[plane] - moved_m);
            }
            let solved = squares.cholesky().map(|factor| factor.solve(&pull)[2]);
            *fitted_n = solved.filter(|load_n| load_n.is_finite()).unwrap_or_default();
        }
        loads_n
    }
}

/// The effect of guide 2 between the nodes depends on the candidate too.
fn offset_of(place: &Place, plane: usize) -> f64 {
    place.beside_m[plane]
}

/// Writes values at places into a column of the design.
fn fill_column(column: usize, scale: f64, values: &[f64], rows: &mut DMatrix<f64>, places: &[Place]) {
    let mut cells = rows.column_mut(column);
    cells.iter_mut().zip(places).for_each(|(cell, place)| *cell = scale * place.of(values));
}

/// Slope of a path between two nodes.
fn slope_between(i: usize, path_m: &[f64], nodes_m: &Arc<Vec<f64>>) -> f64 {
    (path_m[2 * i + 2] - path_m[2 * i + 1]) / (nodes_m[i + 1] - nodes_m[i])
}
