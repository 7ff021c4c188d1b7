//! Every answer against what the posterior of the readings before expects of it: force of guide 2, and the tip.
//!
//! A prediction is made at each stop, after the posterior and the move there, for the way to the next one. So each reading is compared with what was expected
//! before it came. By how much the expectation may be off is the posterior's, with the model's error beside it. The force is compared twice:
//! as it is, which finds what drifts, and as it changes from what was measured at the stop, which is known better and finds what jumps.

use super::decide::variance_of;
use super::{Controller, SteerError};
use crate::envelope::{Measured, parts};
use crate::estimator::STIFFNESS_ERROR;
use crate::history::Place;
use crate::protocol::Answer;
use crate::readings::ReadingStatus;
use crate::results::{ComparedChannel, Comparison, Event};
use crate::tables::{self, Tables};
use mechanics::ModelError;
use mechanics::inner::Inner;
use mechanics::unknowns::discrepancy::lateral as everyday;
use mechanics::unknowns::tip::ROUGHNESS;
use nalgebra::DVector;
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// By so many standard deviations an expectation may be off. It is made anew at each stop: 900 stops an hour, three channels and two axes are 5 400
/// expectations, of which a normal distribution has one beyond this in 900 hours, as seldom as a false alarm may be.
const SURE_SD: f64 = 5.2;
/// No sensor is better than this, N and mm.
const LEAST_NOISE_N: f64 = 1e-4;
const LEAST_NOISE_MM: f64 = 1e-3;
/// Quantities at a place: force in x and y, then the tip.
const QUANTITIES: usize = 4;
/// Difference of depth within which the needle is at a node, mm.
const AT_NODE_MM: f64 = 0.02;
/// Degrees of freedom from which on readings before the first push show their noise, and the probability with which it is below what is
/// stated of them.
const FEWEST_FREEDOM: f64 = 4.0;
const CERTAIN: f64 = 0.999;
/// Readings of the force at a stop from which on their mean is a reference.
const FEWEST_AT_REST: f64 = 3.0;

/// A quantity in both planes, and by how much it may be off.
#[derive(Debug, Clone, Copy, Default)]
struct Band {
    mean: [f64; 2],
    possible: [f64; 2],
}

/// Expected force (N) and tip (m) at a place.
#[derive(Debug, Clone, Copy, Default)]
struct Expectation {
    force: Band,
    /// The force by what was measured at the stop, where that is known.
    from_stop: Option<Band>,
    tip: Band,
}

/// What is expected on the way to the next stop.
#[derive(Debug, Clone)]
pub(super) struct Predicted {
    /// The node at which it was made.
    first: usize,
    /// Position of guide 2 (mm) and direction of the bevel as commanded then.
    commanded: [f64; 3],
    /// At each node from there on, on arriving and on leaving.
    nodes: Vec<[Expectation; 2]>,
}

impl Predicted {
    fn node(&self, node: usize) -> Option<&[Expectation; 2]> {
        self.nodes.get(node.checked_sub(self.first)?)
    }

    fn at(&self, place: Place) -> Option<Expectation> {
        match place {
            Place::Rest(node, side) => self.node(node).map(|sides| sides[side]),
            Place::Between(node, share) => {
                let (from, to) = (self.node(node)?[1], self.node(node + 1)?[0]);
                Some(Expectation {
                    force: between(from.force, to.force, share),
                    from_stop: from.from_stop.zip(to.from_stop).map(|(from, to)| between(from, to, share)),
                    tip: between(from.tip, to.tip, share),
                })
            }
        }
    }
}

fn between(from: Band, to: Band, share: f64) -> Band {
    let Band { mut mean, mut possible } = from;
    for plane in 0..2 {
        mean[plane] += share * (to.mean[plane] - from.mean[plane]);
        possible[plane] += share * (to.possible[plane] - from.possible[plane]);
    }
    Band { mean, possible }
}

impl Controller<'_> {
    /// Mean of the forces at rest, where there are enough for a reference.
    pub(super) fn force_at_stop(&self) -> Measured {
        self.resting_force().filter(|_| self.still_force.1 >= FEWEST_AT_REST)
    }

    /// Expects what readings will be up to the next stop, by the likeliest law; `at_stop` is the force that was measured here before the move.
    /// Where the model has none, nothing is compared.
    pub(super) fn expect(&mut self, at_stop: Measured) {
        self.predicted = self.predicted(at_stop).ok().flatten();
    }

    fn commanded(&self) -> [f64; 3] {
        [self.last.guide_x_mm, self.last.guide_y_mm, self.last.bevel_deg]
    }

    fn predicted(&self, at_stop: Measured) -> Result<Option<Predicted>, SteerError> {
        let Some(covariance) = &self.covariance else { return Ok(None) };
        let (law, history) = (&self.laws[self.best()], &self.history);
        let first = history.reached;
        // Where the force was relieved on the way, the path from here on is none from node to node.
        if (1e3 * history.depths_m[first] - self.last.depth_mm).abs() > AT_NODE_MM {
            return Ok(None);
        }
        let last = history.depths_m.len() - 1;
        let next = self.rests.iter().copied().find(|rest| *rest > first).unwrap_or(last);
        let nodes: Vec<usize> = (first..=next).collect();
        // Force less that in air, which is in the zero, in two parts; tip without what carries the whole needle.
        let quantities = |tables: &Tables, values: &[f64]| -> Result<Vec<[f64; 2]>, ModelError> {
            let bent = tables::bent(tables, &law.unknowns, values, history);
            let air = tables.held.at(0, &[Inner::Guide2Force])?;
            let mut all = Vec::with_capacity(2 * QUANTITIES * nodes.len());
            for node in &nodes {
                let force = tables.held.at(*node, &[Inner::Guide2Force])?;
                for side in 0..2 {
                    for plane in &bent {
                        let of_air_n = air.first().map_or(0.0, |air| air.guide2 * plane.guide_m[0][0]);
                        let [by_guide_n, by_path_n] = match force.first() {
                            Some(force) if *node > 0 => {
                                parts(force, &plane.states, plane.guide_m[*node][side], (*node, side))
                            }
                            _ => [of_air_n, 0.0],
                        };
                        all.push([by_guide_n - of_air_n, by_path_n]);
                    }
                    for plane in &bent {
                        all.push([plane.states.get(*node).map_or(f64::NAN, |state| state.tip_m[side]), 0.0]);
                    }
                }
            }
            Ok(all)
        };
        let tables = law.tables(history)?;
        let means = quantities(&tables, &law.values)?;
        let rows = law.derivatives(history, |tables, values| {
            Ok(quantities(tables, values)?.into_iter().map(|[one, other]| one + other).collect())
        })?;
        let paths = tables::paths(&tables, &law.unknowns, &law.values, history);
        let usual_n = [everyday::FORCE_OF_HOLD, everyday::FORCE_ON_THE_WAY, everyday::FORCE_DRIFT];
        let usual_n2: f64 = usual_n.iter().map(|usual| usual.typical_sd().powi(2)).sum();
        let (_, zero_count) = self.zero_force;
        let zero_n2 = self.force_noise_n().map_or(f64::INFINITY, |noise_n| noise_n * noise_n) / zero_count;
        // A force less another one: mean, and by how much it may be off.
        let force = |[one, other]: [[f64; 2]; 2], row: &DVector<f64>, measured_n2: f64| {
            let parts_n = [one[0] - other[0], one[1] - other[1]];
            let error_n = STIFFNESS_ERROR * parts_n[0].hypot(parts_n[1]);
            let variance_n2 =
                variance_of(row, covariance).max(0.0) + error_n * error_n + usual_n2 + measured_n2;
            (parts_n[0] + parts_n[1], SURE_SD * variance_n2.sqrt())
        };
        let expected_at = |number: usize, node: usize, side: usize| {
            let start = QUANTITIES * (2 * number + side);
            let mut expectation =
                Expectation { from_stop: at_stop.map(|_| Band::default()), ..Default::default() };
            for plane in 0..2 {
                let row = rows.column(start + plane).clone_owned();
                let Band { mean, possible } = &mut expectation.force;
                (mean[plane], possible[plane]) = force([means[start + plane], [0.0; 2]], &row, zero_n2);
                if let (Some(Band { mean, possible }), Some((stop_n, stop_n2))) =
                    (&mut expectation.from_stop, at_stop)
                {
                    let row = row - rows.column(plane);
                    (mean[plane], possible[plane]) =
                        force([means[start + plane], means[plane]], &row, stop_n2);
                    mean[plane] += stop_n[plane];
                }
                let mut row = rows.column(start + 2 + plane).clone_owned();
                law.unknowns.carry(history.depths_m[node], plane, row.as_mut_slice());
                expectation.tip.mean[plane] = paths[plane][node][side];
                expectation.tip.possible[plane] =
                    SURE_SD * (variance_of(&row, covariance).max(0.0) + ROUGHNESS.sd().powi(2)).sqrt();
            }
            expectation
        };
        let nodes = nodes
            .iter()
            .enumerate()
            .map(|(number, node)| [0, 1].map(|side: usize| expected_at(number, *node, side)))
            .collect();
        Ok(Some(Predicted { first, commanded: self.commanded(), nodes }))
    }

    /// Noise of the force: as stated, and no less than the readings before the first push have; where none is stated, the largest that these leave possible.
    fn force_noise_n(&self) -> Option<f64> {
        let (_, count) = self.zero_force;
        let freedom = 2.0 * (count - 1.0);
        let is_learned = freedom >= FEWEST_FREEDOM;
        let noise_n = match self.stated.force_noise_n {
            Some(noise_n) if is_learned => noise_n.max((self.zero_squares_n2 / freedom).sqrt()),
            Some(noise_n) => noise_n,
            None if is_learned => {
                let least = ChiSquared::new(freedom).ok()?.inverse_cdf(1.0 - CERTAIN);
                (self.zero_squares_n2 / least).sqrt()
            }
            None => return None,
        };
        Some(noise_n.max(LEAST_NOISE_N))
    }

    /// Compares an answer. While guide 2 moves or the needle turns there is no expectation.
    pub(super) fn compare(&mut self, answer: &Answer, reading_status: ReadingStatus) {
        let Some(predicted) = self.predicted.as_ref().filter(|one| one.commanded == self.commanded()) else {
            return;
        };
        let mut comparisons = Vec::with_capacity(3);
        let expected_at = |time_s: f64| predicted.at(self.history.place(time_s)?);
        let compared =
            |t_s: f64, channel: ComparedChannel, difference: [f64; 2], possible: [f64; 2], noise: f64| {
                Comparison {
                    t_s,
                    depth_mm: 1e3 * self.history.at(t_s).depth_m,
                    guide_mm: [answer.guide_x_mm, answer.guide_y_mm],
                    channel,
                    difference,
                    possible,
                    noise,
                }
            };
        if let (Some(force_n), Some(noise), true) =
            (self.force_n, self.force_noise_n(), answer.force_x_n.is_some() && answer.depth_mm > 1e-6)
            && let Some(Expectation { force, from_stop, .. }) = expected_at(answer.t_s)
        {
            let bands = [(ComparedChannel::Force, Some(force)), (ComparedChannel::ForceFromStop, from_stop)];
            for (channel, band) in bands {
                let Some(Band { mean, possible }) = band else { continue };
                let difference = [0, 1].map(|plane: usize| force_n[plane] - mean[plane]);
                comparisons.push(compared(answer.t_s, channel, difference, possible, noise));
            }
        }
        let tip_s = answer.tip_t_s.unwrap_or(answer.t_s - self.stated.tip_delay_s);
        let [skip_from_s, skip_until_s] = self.readings.skip_s;
        let is_compared = matches!(reading_status, ReadingStatus::Good | ReadingStatus::Far)
            && !(tip_s > skip_from_s && tip_s < skip_until_s);
        if let Some(Expectation { tip: Band { mean, possible }, .. }) =
            expected_at(tip_s).filter(|_| is_compared)
        {
            let tip_mm = [answer.tip_x_mm, answer.tip_y_mm];
            let difference = [0, 1].map(|plane: usize| tip_mm[plane] - 1e3 * mean[plane]);
            let noise = self.stated.tip_noise_mm.max(LEAST_NOISE_MM);
            let possible = possible.map(|possible_m| 1e3 * possible_m);
            comparisons.push(compared(tip_s, ComparedChannel::Tip, difference, possible, noise));
        }
        for comparison in &comparisons {
            (self.on_event)(&Event::Compared(comparison));
        }
    }
}
