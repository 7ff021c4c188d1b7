//! What is stated before the first push.

use super::{
    Controller, FORECAST, LAST_AUTHORITY, MISS_THAT_STOPS_MM, Posterior, RADII_MM, SHARE_OF_FORCE,
    SHARE_OF_TRAVEL, SteerError,
};
use crate::estimator::AtTarget;
use crate::history::Place;
use crate::planner::{self, Bounds, Circle, Plan, Weighted, Weights, probability_within};
use crate::results::{Outcome, Probability};
use crate::tables;
use nalgebra::{DMatrix, DVector};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, StandardNormal};

/// Needles drawn from the prior, for each of which it is computed how near travel and force let it come.
const SCENARIOS: usize = 64;
/// Their seed: the same statement leads to the same probability.
const SCENARIO_SEED: u64 = 26;
/// A plan that goes as near to the target as it can.
const NEAREST: Weights = Weights { caution: 0.0, effort: 1e-6 };

/// Corners of what can be reached, from the axis on: the points furthest in some directions.
fn reachable(laws: &[Weighted], bounds: &Bounds) -> Vec<[f64; 2]> {
    const CORNERS: u32 = 24;
    const FAR_M: f64 = 10.0;
    (0..CORNERS)
        .map(|corner| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(corner) / f64::from(CORNERS)).sin_cos();
            planner::plan(laws, [0.0; 2], [FAR_M * cos, FAR_M * sin], bounds, NEAREST).tip_m
        })
        .collect()
}

impl Controller<'_> {
    /// What is stated before the first push: the probability of a hit, from the posterior that readings up to the last depth from which
    /// the guide still moves the tip will leave; and whether the target can be reached at all.
    pub(super) fn forecast(&mut self) -> Result<Option<Outcome>, SteerError> {
        let rests = self.rests.clone();
        let before = self.update(&rests)?;
        let target_m = [1e-3 * self.options.target_mm[0], 1e-3 * self.options.target_mm[1]];
        let travel_m = 1e-3 * SHARE_OF_TRAVEL * self.stated.limits.guide_travel_mm;
        let bounds = self.bounds(&rests, [0.0; 2])?;
        let steered = self.options.steered && (travel_m > 0.0 || self.rotates());
        let still = vec![[0.0; 2]; rests.len()];
        let laws = before.weighted();
        let plan = if self.rotates() {
            let (_, covariance_m2) = planner::outcome(&laws, [0.0; 2], &still);
            let (_, tip_m) = self.plan_rotations(0, &before.at, 0.0)?;
            Plan { guide_m: still.clone(), tip_m, covariance_m2 }
        } else if steered {
            planner::plan(&laws, [0.0; 2], target_m, &bounds, NEAREST)
        } else {
            let (tip_m, covariance_m2) = planner::outcome(&laws, [0.0; 2], &still);
            Plan { guide_m: still.clone(), tip_m, covariance_m2 }
        };
        if steered && !self.rotates() {
            self.reachable_m = reachable(&laws, &bounds);
        }
        let away_m = (plan.tip_m[0] - target_m[0]).hypot(plan.tip_m[1] - target_m[1]);
        // Uncertainty of what can be reached: that of the needle that is not moved.
        let (_, spread_m2) = planner::outcome(&laws, [0.0; 2], &still);
        let sd_m = (spread_m2[0] + spread_m2[2]).max(0.0).sqrt();
        if steered && away_m > 1e-3 * MISS_THAT_STOPS_MM + 2.0 * sd_m {
            return Ok(Some(Outcome::Refused {
                nearest_mm: plan.tip_m.map(|m| 1e3 * m),
                distance_mm: 1e3 * away_m,
            }));
        }
        if self.rotates() {
            // The needle is turned towards the end, and how far it then misses is not calibrated: no probability is stated.
            return Ok(None);
        }
        let last_m = LAST_AUTHORITY * self.history.depths_m[self.history.depths_m.len() - 1];
        let paths = self.expected.clone();
        let noise_m = 1e-3 * self.stated.tip_noise_mm;
        let count = (self.settling() - self.stated.tip_delay_s) * self.stated.tip_rate_hz;
        let mut bins = Vec::new();
        for (node, depth_m) in self.history.depths_m.iter().enumerate().filter(|(_, m)| **m <= last_m) {
            let place = Place::Rest(node, 0);
            let tip_m = [0, 1].map(|plane: usize| tables::at(&paths[plane], place));
            let count = if rests.contains(&node) { 1.6 * count } else { 2.0 };
            bins.push(crate::readings::Bin::forecast(place, *depth_m, tip_m, noise_m, count.max(1.0)));
        }
        let at = self.laws[0].clone().update(&bins, &self.history, &[])?;
        let after = Posterior { at: vec![(1.0, at)] };
        let (_, covariance_m2) = planner::outcome(&after.weighted(), [0.0; 2], &[]);
        self.within_before = if steered {
            let left_m = self.left_by_limits(&before, &rests, &bounds, target_m)?;
            let of = |radius_mm: f64| {
                let within = |miss_m: &[f64; 2]| {
                    let mixed = |[share, factor]: [f64; 2]| {
                        let covariance_m2 = covariance_m2.map(|m2| factor * m2);
                        share * probability_within(*miss_m, covariance_m2, 1e-3 * radius_mm)
                    };
                    FORECAST.into_iter().map(mixed).sum::<f64>()
                };
                let probability = left_m.iter().map(within).sum::<f64>() / left_m.len().max(1) as f64;
                Probability { radius_mm, probability }
            };
            RADII_MM.into_iter().map(of).collect()
        } else {
            self.within(plan.tip_m, plan.covariance_m2)
        };
        Ok(None)
    }

    /// Misses that travel and force leave, were the needle known: one for each of some needles drawn from the prior.
    fn left_by_limits(
        &self,
        before: &Posterior,
        rests: &[usize],
        bounds: &Bounds,
        target_m: [f64; 2],
    ) -> Result<Vec<[f64; 2]>, SteerError> {
        let mut rng = ChaCha8Rng::seed_from_u64(SCENARIO_SEED);
        let mut left_m = Vec::with_capacity(SCENARIOS);
        for (number, (weight, at)) in before.at.iter().enumerate() {
            let law = self.laws.get(number).unwrap_or(&self.laws[self.best()]);
            let Some(cholesky) = at.covariance.clone().cholesky() else { continue };
            for _ in 0..(weight * SCENARIOS as f64).round() as usize {
                let draw = DVector::from_fn(at.covariance.nrows(), |_, _| StandardNormal.sample(&mut rng));
                let off = cholesky.l() * draw;
                let values: Vec<f64> =
                    law.values.iter().zip(off.iter()).map(|(mean, off)| mean + off).collect();
                let raised = |gain: &f64, row: &[f64]| {
                    gain + row.iter().zip(off.iter()).map(|(a, b)| a * b).sum::<f64>()
                };
                let needle = AtTarget {
                    tip_m: [0, 1].map(|plane: usize| at.tip_m[plane] + at.rows[plane].dot(&off)),
                    rows: at.rows.clone(),
                    way_rows: Vec::new(),
                    gains: at.gains.iter().zip(&at.gain_rows).map(|(gain, row)| raised(gain, row)).collect(),
                    gain_rows: at.gain_rows.clone(),
                    covariance: DMatrix::zeros(off.len(), off.len()),
                };
                let mut bounds = bounds.clone();
                if let Some(limit_n) = self.stated.limits.guide_force_n {
                    let stiffness = self.stiffness_n_per_m(&law.unknowns.problem(&values)?, rests)?;
                    for (circle, stiffness) in bounds.circles.iter_mut().zip(stiffness) {
                        let radius_m = SHARE_OF_FORCE * limit_n / stiffness;
                        *circle = circle.map(|circle| Circle { radius_m, ..circle });
                    }
                }
                // Never so small that the position now is outside.
                for circle in bounds.circles.iter_mut().flatten() {
                    circle.radius_m = circle.radius_m.max(circle.centre_m[0].hypot(circle.centre_m[1]));
                }
                let certain = [Weighted { weight: 1.0, at: &needle }];
                let plan = planner::plan(&certain, [0.0; 2], target_m, &bounds, NEAREST);
                left_m.push([0, 1].map(|plane: usize| plan.tip_m[plane] - target_m[plane]));
            }
        }
        Ok(left_m)
    }

    pub(super) fn within(&self, tip_m: [f64; 2], covariance_m2: [f64; 3]) -> Vec<Probability> {
        let miss_m = [0, 1].map(|plane: usize| tip_m[plane] - 1e-3 * self.options.target_mm[plane]);
        let of = |radius_mm: f64| Probability {
            radius_mm,
            probability: probability_within(miss_m, covariance_m2, 1e-3 * radius_mm),
        };
        RADII_MM.into_iter().map(of).collect()
    }
}
