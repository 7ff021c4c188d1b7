//! Forecast before the first push.

use super::{Controller, FORECAST, LAST_AUTHORITY, MISS_THAT_STOPS_MM, Posterior, RADII_MM, SteerError};
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
        let last_m = LAST_AUTHORITY * self.history.depths_m[self.history.depths_m.len() - 1];
        let paths = self.expected.clone();
        let noise_m = 1e-3 * self.stated.tip_noise_mm;
        let count = (self.settling() - self.stated.tip_delay_s) * self.stated.tip_rate_hz;
        let mut bins = Vec::new();
        for (node, depth_m) in self.history.depths_m.iter().enumerate().filter(|(_, m)| **m <= last_m) {
            let location = Place::Rest(node, 0);
            let tip_m = [0, 1].map(|plane: usize| tables::at(&paths[plane], location));
            let count = if rest_nodes.contains(&node) { 1.6 * count } else { 2.0 };
            bins.push(crate::readings::Bin::forecast(location, *depth_m, tip_m, noise_m, count.max(1.0)));
        }
        let updated_law = self.laws[0].clone().update(&bins, &self.history, &[])?;
        let updated = Posterior { at: vec![(1.0, updated_law)] };
        let (_, covariance_m2) = planner::outcome(&updated.weighted(), [0.0; 2], &[]);
        self.within_before = if steered {
            RADII_MM
                .into_iter()
                .map(|radius_mm| {
                    let probability = misses
                        .iter()
                        .map(|misses| {
                            FORECAST
                                .into_iter()
                                .map(|[share, factor]| {
                                    let covariance_m2 = covariance_m2.map(|m2| factor * m2);
                                    share * probability_within(misses.miss_m, covariance_m2, 1e-3 * radius_mm)
                                })
                                .sum::<f64>()
                        })
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
            for _ in 0..(weight * SCENARIOS as f64).round() as usize {
                let draw = DVector::from_fn(at.covariance.nrows(), |_, _| StandardNormal.sample(&mut rng));
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

/// Number of needles that each limit keeps from the target, the most frequent first.
fn risks(left: &[Left]) -> Vec<LimitRisk> {
    let mut counts: BTreeMap<Limit, usize> = BTreeMap::new();
    for limit in left.iter().filter(|left| left.mm() > KEPT_OFF_MM).filter_map(|left| left.limit) {
        *counts.entry(limit).or_default() += 1;
    }
    let fraction_of = |count: usize| count as f64 / left.len().max(1) as f64;
    let mut risks: Vec<LimitRisk> = counts
        .into_iter()
        .map(|(limit, count)| LimitRisk {
            limit: limit.name(),
            words: limit.to_string(),
            probability: fraction_of(count),
        })
        .collect();
    risks.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    risks
}
