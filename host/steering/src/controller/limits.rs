//! Limited quantities at the stops to come, by the controller's posterior.

use super::decide::sd_m;
use super::{Controller, SHARE_OF_TRAVEL, SHARE_THAT_STOPS, SteerError};
use crate::envelope::{Envelope, Limits, Measured};
use crate::estimator::Hypothesis;
use crate::planner::{self, Bounds, Plan, Weighted, Weights};
use crate::tables;
use mechanics::ModelError;

/// Inputs of a plan.
pub(super) struct Request<'a> {
    /// Stops to come.
    pub stops: &'a [usize],
    /// Predictions of all laws.
    pub laws: &'a [Weighted<'a>],
    /// Position of the guide, m.
    pub now_m: [f64; 2],
    /// Target, m.
    pub target_m: [f64; 2],
    /// Largest move at the first stop, m.
    pub largest_move_m: Option<f64>,
    /// Weights of miss and effort.
    pub weights: Weights,
}

impl Controller<'_> {
    /// Travel that is used, m.
    pub(super) fn travel_m(&self) -> f64 {
        1e-3 * SHARE_OF_TRAVEL * self.stated.limits.guide_travel_mm
    }

    /// Limits at the stops to come, for a law's needle of these values.
    pub(super) fn envelope(
        &self,
        law: &Hypothesis,
        tables: &tables::Tables,
        values: &[f64],
        stops: &[usize],
    ) -> Result<Envelope, ModelError> {
        let stiffness = law.unknowns.problem.bending_stiffness_n_m2;
        let limits = Limits::new(self.stated, stiffness, SHARE_THAT_STOPS);
        let bent = tables::bent(tables, &law.unknowns, values, &self.history);
        Envelope::new(tables, &bent, &self.history, stops, limits, self.resting_force())
    }

    /// Within limits, wherever moves lead and nothing is kept in reserve.
    pub(super) fn free_bounds<'e>(&self, envelope: &'e Envelope) -> Bounds<'e> {
        Bounds { travel_m: self.travel_m(), largest_move_m: None, cones: &envelope.cones, deviation_m: 0.0 }
    }

    /// Mean of the forces at guide 2 since something last moved, N, and its variance.
    pub(super) fn resting_force(&self) -> Measured {
        let (mean_n, count) = self.still_force;
        let noise_n = self.stated.force_noise_n.unwrap_or(0.0);
        (count > 0.0).then(|| (mean_n, noise_n * noise_n / count))
    }

    /// The plan within all limits by the likeliest law, first by its values, then with what is uncertain of them up to
    /// the next stop. A plan is allowed by the limits, or is no worse than staying.
    pub(super) fn limited_plan(&self, request: &Request) -> Result<Plan, SteerError> {
        let Request { stops, laws, now_m, target_m, largest_move_m, weights } = *request;
        let law = &self.laws[self.best()];
        let tables = law.tables(&self.history)?;
        let mut envelope = self.envelope(law, &tables, &law.values, stops)?;
        let likeliest = laws.iter().max_by(|a, b| a.weight.total_cmp(&b.weight));
        let (_, covariance_m2) = planner::outcome(laws, now_m, &[]);
        if let Some(likeliest) = likeliest {
            envelope.reserve(&self.history, stops, &likeliest.at.gains, weights.effort);
        }
        // Points of a cubature of the plane lie so far out.
        let deviation_m = std::f64::consts::SQRT_2 * sd_m(covariance_m2);
        let plan = |envelope: &Envelope| {
            let cones = &envelope.cones;
            let bounds = Bounds { travel_m: self.travel_m(), largest_move_m, cones, deviation_m };
            planner::plan(laws, now_m, target_m, &bounds, weights)
        };
        let mut planned = plan(&envelope);
        if let Some(likeliest) = likeliest {
            let covariance = &likeliest.at.covariance;
            envelope.tighten(law, covariance, &self.history, stops, &planned.guide_m, now_m)?;
            if envelope.exceeded(now_m, &planned.guide_m) {
                planned = plan(&envelope);
            }
        }
        let target_m = planned.guide_m.first().copied().unwrap_or(now_m);
        if let (allowed_m, Some(limit)) = envelope.allowed(now_m, target_m) {
            if let Some(first) = planned.guide_m.first_mut() {
                *first = allowed_m;
            }
            (planned.tip_m, planned.covariance_m2) = planner::outcome(laws, now_m, &planned.guide_m);
            if !planned.limited_by.iter().any(|(one, _)| *one == limit) {
                planned.limited_by.push((limit, 0.0));
            }
        }
        Ok(planned)
    }
}
