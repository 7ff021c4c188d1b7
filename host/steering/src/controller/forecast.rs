//! What is stated before the first push.

use super::{
    Controller, FORECAST, LAST_AUTHORITY, MISS_THAT_STOPS_MM, Posterior, RADII_MM, SHARE_OF_TRAVEL,
    SteerError,
};
use crate::history::Place;
use crate::planner::{self, Plan, Weights, probability_within};
use crate::results::{Outcome, Probability};
use crate::tables;

impl Controller<'_> {
    /// What is stated before the first push: the probability of a hit, from the posterior that readings up to the last depth from which
    /// the guide still moves the tip will leave; and whether the target can be reached at all.
    pub(super) fn forecast(&mut self) -> Result<Option<Outcome>, SteerError> {
        let rests = self.rests.clone();
        let before = self.update(&rests)?;
        let target_m = [1e-3 * self.options.target_mm[0], 1e-3 * self.options.target_mm[1]];
        let travel_m = 1e-3 * SHARE_OF_TRAVEL * self.stated.limits.guide_travel_mm;
        let bounds_m = self.bounds_m(&rests, [0.0; 2], travel_m)?;
        let steered = self.options.steered && (travel_m > 0.0 || self.rotates());
        let nearest = Weights { caution: 0.0, effort: 1e-6 };
        let still = vec![[0.0; 2]; rests.len()];
        let laws = before.weighted();
        let plan = if self.rotates() {
            let (_, covariance_m2) = planner::outcome(&laws, [0.0; 2], &still);
            let (_, tip_m) = self.plan_rotations(0, &before.at, 0.0)?;
            Plan { guide_m: still.clone(), tip_m, covariance_m2 }
        } else if steered {
            planner::plan(&laws, [0.0; 2], target_m, &bounds_m, nearest)
        } else {
            let (tip_m, covariance_m2) = planner::outcome(&laws, [0.0; 2], &still);
            Plan { guide_m: still.clone(), tip_m, covariance_m2 }
        };
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
            let [often, seldom] =
                FORECAST.map(|[_, factor]| self.within(plan.tip_m, covariance_m2.map(|m2| factor * m2)));
            let mixed = |(often, seldom): (Probability, Probability)| Probability {
                probability: FORECAST[0][0] * often.probability + FORECAST[1][0] * seldom.probability,
                ..often
            };
            often.into_iter().zip(seldom).map(mixed).collect()
        } else {
            self.within(plan.tip_m, plan.covariance_m2)
        };
        Ok(None)
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
