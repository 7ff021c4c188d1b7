//! A plan without a plant: what is stated and planned before anything moves.

use super::{Controller, Options, Posterior, SteerError};
use crate::estimator::AtTarget;
use crate::planner;
use crate::plant::{Plant, PlantError};
use crate::protocol::{Answer, Command, End, Statement};
use crate::results::{Decision, Outcome, PathPlan, Spread};
use crate::unknowns::TISSUE;
use std::ops::Range;

/// There is no plant.
struct Absent;

impl Absent {
    fn refused<T>() -> Result<T, PlantError> {
        Err(PlantError::Reported("a plan is made without a plant, expected no step".to_owned()))
    }
}

impl Plant for Absent {
    fn start(&mut self) -> Result<Statement, PlantError> {
        Self::refused()
    }

    fn step(&mut self, _: &Command) -> Result<Answer, PlantError> {
        Self::refused()
    }

    fn end(&mut self) -> Result<End, PlantError> {
        Self::refused()
    }
}

/// Plans the path to a target from what is known of needle, rig and tissue beforehand, as [`steer`](super::steer) does before the first push.
/// A target that cannot be reached is no error: the plan then leads as near to it as it can.
///
/// # Errors
/// [`SteerError`] where the statement or the target is not valid.
pub fn plan_path(stated: &Statement, options: &Options) -> Result<PathPlan, SteerError> {
    stated.check()?;
    super::check_target(stated, options)?;
    let (mut plant, mut ignore) = (Absent, |_: &crate::Event| {});
    let mut controller = Controller::new(&mut plant, stated, options, &mut ignore)?;
    let refused = match controller.forecast()? {
        Some(Outcome::Refused { nearest_mm, distance_mm, limited_by, .. }) => {
            Some((nearest_mm, distance_mm, limited_by))
        }
        _ => None,
    };
    let (unsteered_tip_mm, spread_mm) = controller.unsteered()?;
    let first = controller.rests.first().copied().unwrap_or_default();
    let plan: Decision = controller.planned(first)?;
    Ok(PathPlan {
        target_mm: options.target_mm,
        is_reachable: refused.is_none(),
        nearest_mm: refused.as_ref().map(|(nearest_mm, ..)| *nearest_mm),
        beyond_reach_mm: refused.as_ref().map(|(_, distance_mm, _)| *distance_mm),
        limited_by: refused.and_then(|(.., limited_by)| limited_by),
        reachable_mm: controller.reachable_m.iter().map(|corner| corner.map(|m| 1e3 * m)).collect(),
        within: controller.within_before.clone(),
        limits: controller.limits_before.clone(),
        unsteered_tip_mm,
        spread_mm,
        plan,
    })
}

impl Posterior {
    /// Variance per axis of the tip at the target by some of the unknowns, mean of the laws, mm^2.
    fn variance_mm2(&self, unknowns: Range<usize>) -> f64 {
        let count = unknowns.len();
        let law_variance_m2 = |at: &AtTarget| {
            let covariance = at.covariance.view((unknowns.start, unknowns.start), (count, count));
            let rows = at.rows.iter().map(|row| row.rows(unknowns.start, count));
            rows.map(|row| 0.5 * row.dot(&(covariance * row))).sum::<f64>()
        };
        1e6 * self.at.iter().map(|(weight, at)| weight * law_variance_m2(at)).sum::<f64>()
    }
}

impl Controller<'_> {
    /// Tip at the target's depth if nothing is moved, and what it is uncertain by, mm: by all laws with their weights. The tip's part has what the laws
    /// differ by.
    fn unsteered(&mut self) -> Result<([f64; 2], Spread), SteerError> {
        let posterior = self.update(&[])?;
        let (tip_m, covariance_m2) = planner::outcome(&posterior.weighted(), [0.0; 2], &[]);
        let unknowns = &self.laws[self.best()].unknowns;
        let total_sd_mm = 1e3 * super::decide::sd_m(covariance_m2);
        let laws_mm2 = total_sd_mm * total_sd_mm - posterior.variance_mm2(0..unknowns.count());
        let tip_mm2 = posterior.variance_mm2(unknowns.beside()..unknowns.irregularity(0, 0));
        let sd_mm = |unknowns: Range<usize>| posterior.variance_mm2(unknowns).max(0.0).sqrt();
        let spread = Spread {
            all: total_sd_mm,
            slope: sd_mm(unknowns.slope()..unknowns.guide_offset()),
            tip: (tip_mm2 + laws_mm2).max(0.0).sqrt(),
            tissue: sd_mm(0..TISSUE),
            guide: sd_mm(unknowns.guide_offset()..unknowns.beside()),
            irregularity: sd_mm(unknowns.irregularity(0, 0)..unknowns.count()),
        };
        Ok((tip_m.map(|m| 1e3 * m), spread))
    }
}
