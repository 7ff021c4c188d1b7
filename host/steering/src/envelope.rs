//! Effect of guide moves on needle, guide and tissue at the stops to come, as fractions of their limits (theory, eq.
//! 79).
//!
//! By the one forward model every bending moment, the force of guide 2 and the compression of the tissue are linear in the moves,
//! and so they are constraints of the plan: each the
//! length of a vector of both planes, a second-order cone. A limit holds with a probability of 0.999 at each stop: up to the next
//! stop by the
//! posterior of everything unknown and the error of the model, later by the error of the model alone, since readings up to there
//! will tell the rest and the guide can still be moved.

mod limit;

pub(crate) use limit::Limit;

use crate::clamp::ClampShare;
use crate::estimator::Hypothesis;
use crate::history::History;
use crate::protocol::Statement;
use crate::tables::{self, Bent, Tables};
use crate::unknowns::CLAMP;
use mechanics::ModelError;
use mechanics::growth::TipState;
use mechanics::inner::{Influence, Inner};
use nalgebra::DMatrix;

/// Quantile of the standard normal distribution at 0.999, the probability with which a limit holds at a stop.
const QUANTILE: f64 = 3.09;
/// Standard deviation of the model's error, as a share of the value: what yielding, relaxation and layers leave between computed
/// and true bending of simulated needles of two codes
/// (quartiles of their ratio 0.97 and 1.07; manual, validation).
const MODEL_ERROR: f64 = 0.05;
/// Up to this share of a limit the posterior is not looked at: it would have to be wrong by more than the value itself.
const FAR_FROM_LIMIT: f64 = 0.3;
/// Increase of the tip's depth within which readings halve the target's standard deviation, m: so it is from 10 mm on
/// in simulated runs.
const KNOWN_AFTER_M: f64 = 0.020;
/// Share by which a solution may exceed a limit that it keeps.
pub(crate) const SOLVED: f64 = 5e-4;
/// Depths at which the needle may be bent most, and the tissue compressed most, beside guides and surface, m.
const BENT_AT_M: [f64; 4] = [0.010, 0.020, 0.035, 0.055];
const COMPRESSED_AT_M: [f64; 3] = [0.0, 0.010, 0.025];
/// Radius of the needle where none is stated, m: 18 gauge.
const RADIUS_M: f64 = 0.635e-3;

/// Limits of what is inside, SI; nothing where none is stated.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limits {
    moment_n_m: Option<f64>,
    force_n: Option<f64>,
    compression_m: Option<f64>,
}

impl Limits {
    /// Those of a plant; `force_share`: of its force limit, since measured force stops the run before that.
    pub fn new(stated: &Statement, bending_stiffness_n_m2: f64, force_share: f64) -> Self {
        let radius_m = stated.needle.outer_diameter_mm.map_or(RADIUS_M, |mm| 0.5e-3 * mm);
        Self {
            moment_n_m: stated.limits.needle_strain.map(|strain| strain * bending_stiffness_n_m2 / radius_m),
            force_n: stated.limits.guide_force_n.map(|n| force_share * n),
            compression_m: stated.limits.tissue_compression_mm.map(|mm| 1e-3 * mm),
        }
    }

    /// Whether nothing is limited.
    pub fn is_empty(&self) -> bool {
        self.moment_n_m.is_none() && self.force_n.is_none() && self.compression_m.is_none()
    }

    /// Limited quantities with the tip at a node, with their limits.
    fn asked(&self, history: &History, node: usize) -> Vec<(Limit, Inner, f64)> {
        let mut asked = Vec::new();
        if let Some(limit) = self.moment_n_m {
            for inner in [Inner::MomentAtGuide1, Inner::MomentAtGuide2, Inner::MomentAtSurface] {
                asked.push((Limit::Strain, inner, limit));
            }
            for at in near_nodes(&BENT_AT_M, node, &history.depths_m) {
                asked.push((Limit::Strain, Inner::MomentInTissue(at), limit));
            }
        }
        if let Some(limit) = self.force_n {
            asked.push((Limit::Force, Inner::Guide2Force, limit));
        }
        if let Some(limit) = self.compression_m {
            for at in near_nodes(&COMPRESSED_AT_M, node, &history.depths_m) {
                asked.push((Limit::Compression, Inner::Compression(at), limit));
            }
        }
        asked
    }
}

fn near_nodes(depths_m: &[f64], node: usize, history_depths_m: &[f64]) -> Vec<usize> {
    let mut nodes: Vec<usize> =
        depths_m.iter().map(|m| history_depths_m.partition_point(|at| *at < m - 1e-6)).collect();
    nodes.dedup();
    nodes.retain(|at| *at < node);
    nodes
}

/// A place along the way: a node, on arriving (0) or on leaving (1).
type At = (usize, usize);

/// A limited quantity at a stop.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Cone {
    /// Its limit.
    pub limit: Limit,
    /// Position of the limited quantity.
    at: At,
    /// Number of the quantity at that position.
    number: usize,
    /// Share of the limit, x and y, if the guide stays.
    pub stay: [f64; 2],
    /// Growth per move at each stop to come, 1/m.
    pub per_move: Vec<f64>,
    /// Largest share that is allowed.
    pub bound: f64,
    /// Fraction of the limit that a correction of the tip at the target by a metre takes, by moves that are still to
    /// be made, 1/m.
    pub per_correction: f64,
}

impl Cone {
    /// At a place (node, and 0 on arriving or 1 on leaving): shares if the guide stays, their growth per move, and the largest
    /// that is allowed.
    pub fn new(limit: Limit, at: At, stay: [f64; 2], per_move: Vec<f64>, bound: f64) -> Self {
        Self { limit, at, number: 0, stay, per_move, bound, per_correction: 0.0 }
    }

    /// Share of the limit after moves, as a vector.
    pub fn vector(&self, moves_m: &[[f64; 2]]) -> [f64; 2] {
        [0, 1].map(|plane: usize| {
            self.stay[plane]
                + self.per_move.iter().zip(moves_m).map(|(per_move, m)| per_move * m[plane]).sum::<f64>()
        })
    }

    /// Share of what is allowed.
    pub fn used(&self, moves_m: &[[f64; 2]]) -> f64 {
        let [x, y] = self.vector(moves_m);
        x.hypot(y) / self.bound
    }

    /// Share by which the limit is exceeded if beside the moves a tip is corrected by so much, m.
    pub fn excess(&self, moves_m: &[[f64; 2]], corrected_m: f64) -> f64 {
        let [x, y] = self.vector(moves_m);
        x.hypot(y) + self.per_correction * corrected_m - self.bound
    }

    /// Identity of the position and limit.
    pub fn group(&self) -> (usize, usize, Limit) {
        (self.at.0, self.at.1, self.limit)
    }
}

/// Largest share of a limit by its mean so that the limit holds with the probability, for a standard deviation of this share of
/// it beside that of the model, which
/// grows with the value: `m + z (sd^2 + (e m)^2)^(1/2) = 1`.
fn bound(sd: f64) -> f64 {
    let (z2, error) = (QUANTILE * QUANTILE, MODEL_ERROR * MODEL_ERROR);
    let a = 1.0 - z2 * error;
    let root = (1.0 - a * (1.0 - z2 * sd * sd)).max(0.0).sqrt();
    ((1.0 - root) / a).max(0.01)
}

/// Force that is measured at rest: mean and its variance, N.
pub(crate) type Measured = Option<([f64; 2], f64)>;

/// All limits at the stops to come.
pub(crate) struct Envelope {
    pub cones: Vec<Cone>,
    limits: Limits,
    now: At,
    measured: Measured,
}

fn value(influence: &Influence, states: &[TipState], guide_m: f64, location: At) -> f64 {
    let [by_guide, by_tip] = parts(influence, states, guide_m, location);
    by_guide + by_tip
}

/// A quantity at a place in two parts: what guide 2 does, and what tip load and cut path do.
pub(crate) fn parts(influence: &Influence, states: &[TipState], guide_m: f64, (node, side): At) -> [f64; 2] {
    let load_n = states.get(node).map_or(0.0, |state| state.load_n[side]);
    [influence.guide2 * guide_m, influence.load * load_n + influence.of_path(states)]
}

impl Envelope {
    /// For moves at these stops (nodes; the first is where the needle is), by a law's likeliest values.
    pub fn new(
        tables: &Tables,
        bent: &[Bent; 2],
        history: &History,
        stops: &[usize],
        limits: Limits,
        measured: Measured,
    ) -> Result<Self, ModelError> {
        let first = stops.first().copied().unwrap_or(1).max(1);
        let mut envelope = Self { cones: Vec::new(), limits, now: (first, 1), measured };
        if limits.is_empty() {
            return Ok(envelope);
        }
        let moved: Vec<Vec<TipState>> = stops.iter().map(|node| tables.moved_at(*node)).collect();
        let last = history.depths_m.len() - 1;
        for node in stops.iter().copied().chain([last]).filter(|node| *node >= 1) {
            let asked = limits.asked(history, node);
            let inner: Vec<Inner> = asked.iter().map(|(_, inner, _)| *inner).collect();
            let quantities = tables.held.at(node, &inner)?;
            for (number, ((limit, _, most), influence)) in asked.iter().zip(&quantities).enumerate() {
                for side in 0..2 {
                    if (node == first && side == 0) || (node == last && side == 1) {
                        continue;
                    }
                    let location = (node, side);
                    let mut stay = [0, 1].map(|plane: usize| {
                        value(influence, &bent[plane].states, bent[plane].guide_m[node][side], location)
                            / most
                    });
                    let per_move = moved.iter().zip(stops).map(|(states, from)| {
                        value(influence, states, tables::moved_from(*from, node)[side], location) / most
                    });
                    if *limit == Limit::Force {
                        let shift = envelope.force_shift(tables, bent)?;
                        (0..2).for_each(|plane| stay[plane] += shift[plane] / most);
                    }
                    let per_move = per_move.collect();
                    let cone = Cone::new(*limit, location, stay, per_move, bound(0.0));
                    envelope.cones.push(Cone { number, ..cone });
                }
            }
        }
        Ok(envelope)
    }

    /// Measured force less that of the model, now: what is measured counts, and the model only for what changes it.
    fn force_shift(&self, tables: &Tables, bent: &[Bent; 2]) -> Result<[f64; 2], ModelError> {
        let Some((measured_n, _)) = self.measured else { return Ok([0.0; 2]) };
        let (node, side) = self.now;
        let force = tables.held.at(node, &[Inner::Guide2Force])?;
        let plane_shift = |plane: usize| {
            force.iter().map(move |force| {
                value(force, &bent[plane].states, bent[plane].guide_m[node][side], self.now)
            })
        };
        Ok([0, 1].map(|plane| measured_n[plane] - plane_shift(plane).sum::<f64>()))
    }

    /// Fractions of the limits for corrections that are made when most of the deviation is known: moves from the stop
    /// on that is [`KNOWN_AFTER_M`] deeper, each in proportion to its gain at the target (the least squares of the plan
    /// itself).
    pub fn reserve(&mut self, history: &History, stops: &[usize], gains: &[f64], effort: f64) {
        let now_m = stops.first().map_or(0.0, |node| history.depths_m[*node]);
        let gains: Vec<f64> = stops
            .iter()
            .zip(gains)
            .map(|(node, gain)| if is_later(node, now_m, &history.depths_m) { *gain } else { 0.0 })
            .collect();
        let square = effort + gains.iter().map(|gain| gain * gain).sum::<f64>();
        for cone in &mut self.cones {
            let product: f64 = cone.per_move.iter().zip(&gains).map(|(per_move, gain)| per_move * gain).sum();
            cone.per_correction = product.abs() / square;
        }
    }

    /// Up to the next stop the limits hold by the posterior too, for these moves, m: smaller bounds where the values are
    /// uncertain.
    pub fn tighten(
        &mut self,
        law: &Hypothesis,
        covariance: &DMatrix<f64>,
        history: &History,
        stops: &[usize],
        guide_m: &[[f64; 2]],
        now_m: [f64; 2],
    ) -> Result<(), ModelError> {
        let next = stops.get(1).copied().unwrap_or(history.depths_m.len() - 1);
        let soon = [self.now, (next, 0)];
        let moves_m = moves(now_m, guide_m);
        if !self
            .cones
            .iter()
            .any(|cone| soon.contains(&cone.at) && cone.used(&moves_m) * cone.bound > FAR_FROM_LIMIT)
        {
            return Ok(());
        }
        let mut planned = history.clone();
        planned.plan(stops.iter().copied().zip(guide_m.iter().copied()));
        for at in soon {
            let asked = self.limits.asked(history, at.0);
            let inner: Vec<Inner> = asked.iter().map(|(_, inner, _)| *inner).collect();
            let subtracted = self.measured.is_some();
            let mut rows = law.derivatives(
                history,
                |tables: &Tables, values: &[f64]| -> Result<Vec<f64>, ModelError> {
                    let bent = tables::bent(tables, &law.unknowns, values, &planned);
                    let bent_before = tables::bent(tables, &law.unknowns, values, history);
                    let quantities = tables.held.at(at.0, &inner)?;
                    let force = tables.held.at(self.now.0, &[Inner::Guide2Force])?;
                    let mut fractions = Vec::with_capacity(2 * quantities.len());
                    for plane in 0..2 {
                        let (then, now) = (&bent[plane], &bent_before[plane]);
                        let now_n = force.first().map_or(0.0, |force| {
                            value(force, &now.states, now.guide_m[self.now.0][self.now.1], self.now)
                        });
                        for ((limit, _, most), influence) in asked.iter().zip(&quantities) {
                            let own_value = value(influence, &then.states, then.guide_m[at.0][at.1], at);
                            let less = if *limit == Limit::Force && subtracted { now_n } else { 0.0 };
                            fractions.push((own_value - less) / most);
                        }
                    }
                    Ok(fractions)
                },
            )?;
            self.saturate(law, covariance, (at, &inner), &moves_m, &mut rows);
            let variance = |number: usize| {
                let plane_row = |plane: usize| {
                    let row = rows.column(plane * asked.len() + number);
                    row.dot(&(covariance * row))
                };
                plane_row(0).max(plane_row(1)).max(0.0)
            };
            for cone in self.cones.iter_mut().filter(|cone| cone.at == at) {
                let most = asked.get(cone.number).map_or(f64::INFINITY, |(_, _, most)| *most);
                let noise = match (cone.limit, self.measured) {
                    (Limit::Force, Some((_, variance_n2))) => variance_n2 / (most * most),
                    _ => 0.0,
                };
                cone.bound = bound((variance(cone.number) + noise).sqrt());
            }
        }
        Ok(())
    }

    /// Of derivatives of the quantities at a place, x before y, those with respect to the clamp of guide 1 as what it can change them by at most.
    fn saturate(
        &self,
        law: &Hypothesis,
        covariance: &DMatrix<f64>,
        (at, inner): (At, &[Inner]),
        moves_m: &[[f64; 2]],
        rows: &mut DMatrix<f64>,
    ) {
        let mut quantities = vec![[0.0; 2]; inner.len()];
        for cone in self.cones.iter().filter(|cone| cone.at == at) {
            if let Some(quantity) = quantities.get_mut(cone.number) {
                *quantity = cone.vector(moves_m);
            }
        }
        let sd_ln = law.unknowns.sd[CLAMP];
        let clamp = inner.iter().position(|inner| *inner == Inner::MomentAtGuide1).and_then(|guide1| {
            let per_unknown = [0, 1].map(|plane| rows[(CLAMP, plane * inner.len() + guide1)]);
            ClampShare::new(quantities[guide1], per_unknown, sd_ln)
        });
        let Some(clamp) = clamp else { return };
        let by_ln = QUANTILE * sd_ln * covariance[(CLAMP, CLAMP)].max(0.0).sqrt();
        for (number, [x, y]) in quantities.into_iter().enumerate() {
            let places = [(CLAMP, number), (CLAMP, inner.len() + number)];
            let growth = x * rows[places[0]] + y * rows[places[1]];
            let saturation = clamp.saturation(growth > 0.0, by_ln);
            places.into_iter().for_each(|place| rows[place] *= saturation);
        }
    }

    /// Whether a plan exceeds any of the limits.
    pub fn exceeded(&self, now_m: [f64; 2], guide_m: &[[f64; 2]]) -> bool {
        let moves_m = moves(now_m, guide_m);
        self.cones.iter().any(|cone| cone.used(&moves_m) > 1.0 + SOLVED)
    }

    /// Farthest allowed position of the guide now on the way to a planned position, m: as far as no limit that it would
    /// exceed is exceeded there, or further than before.
    pub fn allowed(&self, now_m: [f64; 2], to_m: [f64; 2]) -> ([f64; 2], Option<Limit>) {
        const STEPS: i32 = 20;
        let present_cones: Vec<&Cone> = self.cones.iter().filter(|cone| cone.at == self.now).collect();
        let Some(limit) = exceeded_limit(1.0, to_m, now_m, &present_cones) else { return (to_m, None) };
        let fractions = (0..STEPS).rev().map(|step| f64::from(step) / f64::from(STEPS));
        let fraction = fractions
            .into_iter()
            .find(|fractions| exceeded_limit(*fractions, to_m, now_m, &present_cones).is_none())
            .unwrap_or(0.0);
        ([0, 1].map(|plane: usize| now_m[plane] + fraction * (to_m[plane] - now_m[plane])), Some(limit))
    }
}

fn exceeded_limit(share: f64, to_m: [f64; 2], now_m: [f64; 2], present_cones: &[&Cone]) -> Option<Limit> {
    let moves_m = [[0, 1].map(|plane: usize| share * (to_m[plane] - now_m[plane]))];
    let exceeded_cone = present_cones.iter().find(|cone| {
        let used_fraction = cone.used(&moves_m);
        used_fraction > 1.0 + SOLVED && used_fraction > cone.used(&[])
    });
    exceeded_cone.map(|cone| cone.limit)
}

fn is_later(node: &usize, now_m: f64, depths_m: &[f64]) -> bool {
    depths_m[*node] >= now_m + KNOWN_AFTER_M - 1e-6
}

/// Moves between positions, m.
pub(crate) fn moves(now_m: [f64; 2], guide_m: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let previous_positions = std::iter::once(&now_m).chain(guide_m);
    guide_m.iter().zip(previous_positions).map(|(to, from)| [to[0] - from[0], to[1] - from[1]]).collect()
}
