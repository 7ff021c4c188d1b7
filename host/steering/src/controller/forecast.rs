//! Forecast before the first push.

use super::{Controller, MISS_THAT_STOPS_MM, Posterior, RADII_MM, SteerError};
use crate::envelope::Limit;
use crate::estimator::{AtTarget, gain};
use crate::history::Place;
use crate::planner::{self, Bounds, Plan, Weighted, Weights};
use crate::probability::probability_within;
use crate::results::{LimitRisk, Outcome, Probability};
use crate::tables::{self, Tables};
use crate::unknowns::TISSUE;
use nalgebra::{DMatrix, DVector};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use statrs::function::erf::erfc_inv;
use std::collections::BTreeMap;

/// Needles drawn from the prior, for each of which it is computed how near its limits let it come.
const SCENARIOS: usize = 64;
/// Their seed: the same statement leads to the same probability.
const SCENARIO_SEED: u64 = 26;
/// A plan that goes as near to the target as it can.
const NEAREST: Weights = Weights { caution: 0.0, effort: 1e-6 };

/// Share of the drawn needles that have to come within [`MISS_THAT_STOPS_MM`] of a target that is not refused.
const FEWEST: f64 = 0.05;
/// Distance from the target, mm, from which on a limit is stated to keep the needle from it: the smallest radius of which a
/// probability is stated.
const KEPT_OFF_MM: f64 = RADII_MM[0];

/// Corners of what can be reached, from the axis on: the points furthest in some directions.
fn reachable(laws: &[Weighted], bounds: &Bounds) -> Vec<[f64; 2]> {
    const CORNERS: u32 = 24;
    // Far beyond what any needle reaches, and near enough that no limit is worth exceeding for it.
    const FAR_M: f64 = 1.0;
    (0..CORNERS)
        .map(|corner| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(corner) / f64::from(CORNERS)).sin_cos();
            planner::plan(laws, [0.0; 2], [FAR_M * cos, FAR_M * sin], bounds, NEAREST).tip_m
        })
        .collect()
}

/// Remaining distance to the target within the limits, for one needle of the prior.
struct Left {
    /// Tip less target, m.
    miss_m: [f64; 2],
    /// Limit with the largest effect.
    limit: Option<Limit>,
}

impl Left {
    fn mm(&self) -> f64 {
        1e3 * self.miss_m[0].hypot(self.miss_m[1])
    }
}

impl Controller<'_> {
    /// Forecast before the first push: the probability of a hit, from the posterior that readings up to the last depth
    /// from which the guide still moves the tip will leave; and whether the target can be reached at all.
    pub(super) fn forecast(&mut self) -> Result<Option<Outcome>, SteerError> {
        let rest_nodes = self.rests.clone();
        let prior_posterior = self.update(&rest_nodes)?;
        let target_m = [1e-3 * self.options.target_mm[0], 1e-3 * self.options.target_mm[1]];
        let steered = self.options.steered && self.stated.limits.guide_travel_mm > 0.0 && !self.rotates();
        let laws = prior_posterior.weighted();
        let mut misses = Vec::new();
        if self.rotates() {
            let still = Plan::staying(&laws, [0.0; 2], rest_nodes.len());
            let (_, tip_m) = self.plan_rotations(0, &prior_posterior.at, 0.0)?;
            let distance_m = (tip_m[0] - target_m[0]).hypot(tip_m[1] - target_m[1]);
            // Uncertainty of what can be reached: that of the needle that is not moved.
            let [xx, _, yy] = still.covariance_m2;
            if distance_m > 1e-3 * MISS_THAT_STOPS_MM + 2.0 * (xx + yy).max(0.0).sqrt() {
                return Ok(Some(self.refused(&Plan { tip_m, ..still }, target_m)));
            }
            // The needle is turned towards the end, and how far it then misses is not calibrated: no probability is stated.
            return Ok(None);
        }
        let plan = if steered {
            let law = &self.laws[self.best()];
            let envelope = self.envelope(law, &*law.tables(&self.history)?, &law.values, &rest_nodes)?;
            let bounds = self.free_bounds(&envelope);
            self.reachable_m = reachable(&laws, &bounds);
            misses = self.left_by_limits(&prior_posterior, &rest_nodes, target_m)?;
            planner::plan(&laws, [0.0; 2], target_m, &bounds, NEAREST)
        } else {
            Plan::staying(&laws, [0.0; 2], rest_nodes.len())
        };
        let near_count = misses.iter().filter(|misses| misses.mm() <= MISS_THAT_STOPS_MM).count();
        if steered && (near_count as f64) < FEWEST * misses.len() as f64 {
            return Ok(Some(self.refused(&plan, target_m)));
        }
        self.limits_before = risks(&misses);
        self.within_before = if steered {
            let covariance_m2 = self.arriving(&prior_posterior, &rest_nodes)?;
            RADII_MM
                .into_iter()
                .map(|radius_mm| {
                    let probability = misses
                        .iter()
                        .map(|misses| probability_within(misses.miss_m, covariance_m2, 1e-3 * radius_mm))
                        .sum::<f64>()
                        / misses.len().max(1) as f64;
                    Probability { radius_mm, probability }
                })
                .collect()
        } else {
            self.within(plan.tip_m, plan.covariance_m2)
        };
        Ok(None)
    }

    /// Covariance of the tip on arriving, about where limits let it come: at each stop the readings change what is expected at the
    /// target, and the stops from there on correct that but for a share ([`uncorrected`]); what is learned after the last of them
    /// stays (theory, eq. 81).
    fn arriving(&self, before: &Posterior, rests: &[usize]) -> Result<[f64; 3], SteerError> {
        let paths = &self.expected;
        let noise_m = 1e-3 * self.stated.tip_noise_mm;
        let at_rest = (self.settling() - self.stated.tip_delay_s) * self.stated.tip_rate_hz;
        let Some((_, prior)) = before.at.first() else { return Ok([0.0; 3]) };
        let target_m = self.history.depths_m[self.history.depths_m.len() - 1];
        let efforts: Vec<f64> =
            rests.iter().map(|rest| self.effort(self.history.depths_m[*rest] / target_m)).collect();
        let left = uncorrected(&prior.gains, &efforts);
        let mut law = self.laws[0].clone();
        let (_, mut known_m2) = planner::outcome(&[Weighted { weight: 1.0, at: prior }], [0.0; 2], &[]);
        let (mut bins, mut corrected_m2) = (Vec::new(), [0.0; 3]);
        for (node, depth_m) in self.history.depths_m.iter().enumerate() {
            let location = Place::Rest(node, 0);
            let tip_m = [0, 1].map(|plane: usize| tables::at(&paths[plane], location));
            let stop = rests.iter().position(|rest| *rest == node);
            let count = if stop.is_some() { 1.6 * at_rest } else { 2.0 };
            bins.push(crate::readings::Bin::forecast(location, *depth_m, tip_m, noise_m, count.max(1.0)));
            let Some(left) = stop.and_then(|stop| left.get(stop)) else { continue };
            let posterior = law.update(&bins, &self.history, &[])?;
            let (_, now_m2) = planner::outcome(&[Weighted { weight: 1.0, at: &posterior }], [0.0; 2], &[]);
            for (to, (then, now)) in corrected_m2.iter_mut().zip(known_m2.iter().zip(now_m2)) {
                *to += left * left * (then - now);
            }
            known_m2 = now_m2;
        }
        corrected_m2.iter_mut().zip(known_m2).for_each(|(to, unknown)| *to += unknown);
        Ok(corrected_m2)
    }

    /// A target that cannot be reached, with what keeps the needle from it.
    fn refused(&self, plan: &Plan, target_m: [f64; 2]) -> Outcome {
        let [x_mm, y_mm] = plan.tip_m.map(|m| 1e3 * m);
        let distance_mm = 1e3 * (plan.tip_m[0] - target_m[0]).hypot(plan.tip_m[1] - target_m[1]);
        let limits: Vec<String> = plan.limited_by.iter().map(|(limit, _)| limit.to_string()).collect();
        let limited_by = (!limits.is_empty()).then(|| limits.join(" and "));
        let limit_text = limited_by.as_ref().map_or_else(String::new, |limits| format!(" within {limits}"));
        Outcome::Refused {
            nearest_mm: [x_mm, y_mm],
            distance_mm,
            limited_by,
            cause: format!(
                "the target cannot be reached{limit_text}: the nearest point that can be is {x_mm:.2}, {y_mm:.2} mm, \
                 {distance_mm:.1} mm from it"
            ),
        }
    }

    /// Misses that limits leave, were the needle known: one for each of some needles drawn from the prior.
    fn left_by_limits(
        &self,
        before: &Posterior,
        rests: &[usize],
        target_m: [f64; 2],
    ) -> Result<Vec<Left>, SteerError> {
        let mut rng = ChaCha8Rng::seed_from_u64(SCENARIO_SEED);
        let mut misses = Vec::with_capacity(SCENARIOS);
        let last = Place::Rest(self.history.depths_m.len() - 1, 0);
        for (number, (weight, at)) in before.at.iter().enumerate() {
            let law = self.laws.get(number).unwrap_or(&self.laws[self.best()]);
            let Some(cholesky) = at.covariance.clone().cholesky() else { continue };
            let count = (weight * SCENARIOS as f64).round() as usize;
            let draws: Vec<Vec<f64>> =
                (0..at.covariance.nrows()).map(|_| stratified(&mut rng, count)).collect();
            for drawn in 0..count {
                let draw = DVector::from_iterator(draws.len(), draws.iter().map(|draws| draws[drawn]));
                let deviation = cholesky.l() * draw;
                let values: Vec<f64> = law
                    .values
                    .iter()
                    .zip(deviation.iter())
                    .map(|(mean, deviation)| mean + deviation)
                    .collect();
                let tables = Tables::new(&law.unknowns, &values, &self.history.depths_m)?;
                let paths = tables::paths(&tables, &law.unknowns, &values, &self.history);
                let zeros = DVector::zeros(deviation.len());
                let needle = AtTarget {
                    tip_m: [0, 1].map(|plane: usize| tables::at(&paths[plane], last)),
                    rows: [zeros.clone(), zeros],
                    way_rows: Vec::new(),
                    gains: rests.iter().map(|rest| gain(&tables, *rest, &self.history)).collect(),
                    gain_rows: vec![[0.0; TISSUE]; rests.len()],
                    covariance: DMatrix::zeros(deviation.len(), deviation.len()),
                };
                let envelope = self.envelope(law, &tables, &values, rests)?;
                let bounds = self.free_bounds(&envelope);
                let certain = [Weighted { weight: 1.0, at: &needle }];
                let plan = planner::plan(&certain, [0.0; 2], target_m, &bounds, NEAREST);
                misses.push(Left {
                    miss_m: [0, 1].map(|plane: usize| plan.tip_m[plane] - target_m[plane]),
                    limit: plan.limited_by.first().map(|(limit, _)| *limit),
                });
            }
        }
        Ok(misses)
    }

    pub(super) fn within(&self, tip_m: [f64; 2], covariance_m2: [f64; 3]) -> Vec<Probability> {
        let miss_m = [0, 1].map(|plane: usize| tip_m[plane] - 1e-3 * self.options.target_mm[plane]);
        RADII_MM
            .into_iter()
            .map(|radius_mm| Probability {
                radius_mm,
                probability: probability_within(miss_m, covariance_m2, 1e-3 * radius_mm),
            })
            .collect()
    }
}

/// Standard normal values, one from each of as many intervals of equal probability, in random order: few of them are spread as
/// many would be.
fn stratified(rng: &mut ChaCha8Rng, count: usize) -> Vec<f64> {
    let mut order: Vec<(f64, usize)> = (0..count).map(|i| (StandardNormal.sample(rng), i)).collect();
    order.sort_by(|a: &(f64, usize), b| a.0.total_cmp(&b.0));
    let twice_middle = order.iter().map(|(_, i)| (2 * i + 1) as f64 / count as f64);
    twice_middle.map(|share| -std::f64::consts::SQRT_2 * erfc_inv(share)).collect()
}

/// Share of a deviation of the tip at the target that is left when it is known from each stop on, and corrected there and at all
/// later stops by the first move of each plan: the plan's least squares without limits, for these gains and efforts.
fn uncorrected(gains: &[f64], efforts: &[f64]) -> Vec<f64> {
    let (mut later, mut share) = (0.0, 1.0);
    let mut left: Vec<f64> = gains
        .iter()
        .zip(efforts)
        .rev()
        .map(|(gain, effort)| {
            later += gain * gain;
            share *= 1.0 - gain * gain / (effort + later);
            share
        })
        .collect();
    left.reverse();
    left
}

/// Number of needles that each limit keeps from the target, the most frequent first.
fn risks(left: &[Left]) -> Vec<LimitRisk> {
    let mut counts: BTreeMap<Limit, usize> = BTreeMap::new();
    for limit in left.iter().filter(|left| left.mm() > KEPT_OFF_MM).filter_map(|left| left.limit) {
        *counts.entry(limit).or_default() += 1;
    }
    let mut risks: Vec<LimitRisk> = counts
        .into_iter()
        .map(|(limit, count)| LimitRisk {
            limit: limit.name(),
            words: limit.to_string(),
            probability: fraction_of(count, left),
        })
        .collect();
    risks.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    risks
}

fn fraction_of(count: usize, left: &[Left]) -> f64 {
    count as f64 / left.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_is_what_replans_leave_of_a_deviation() {
        // Followed stop by stop: each plan is the least squares of its own stops, and its first move is made.
        let (gains, efforts) = ([-1.8, -1.1, -0.4, -0.1], [0.2, 0.15, 0.1, 0.05]);
        let left = uncorrected(&gains, &efforts);
        for (start, left) in left.iter().enumerate() {
            let mut deviation = 1.0;
            for stop in start..gains.len() {
                let square = efforts[stop] + gains[stop..].iter().map(|gain| gain * gain).sum::<f64>();
                deviation += gains[stop] * (-gains[stop] * deviation / square);
            }
            assert!((left - deviation).abs() < 1e-12, "{start}: {left} {deviation}");
        }
        assert!(left.is_sorted(), "later stops correct less: {left:?}");
    }

    #[test]
    fn few_stratified_draws_have_the_moments_and_tails_of_many() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let draws = stratified(&mut rng, 58);
        let mean = draws.iter().sum::<f64>() / 58.0;
        let variance = draws.iter().map(|z| z * z).sum::<f64>() / 58.0;
        assert!(mean.abs() < 1e-9 && (variance - 1.0).abs() < 0.05, "{mean} {variance}");
        assert_eq!(draws.iter().filter(|z| **z > 1.645).count(), 3);
        assert_ne!(draws, stratified(&mut rng, 58));
    }
}
