//! A plan without a plant: what is stated and planned before anything moves.

use super::{Controller, Options, SteerError};
use crate::planner;
use crate::plant::{Plant, PlantError};
use crate::protocol::{Answer, Command, End, Statement};
use crate::results::{Decision, Outcome, PathPlan, Spread};
use crate::unknowns::{TISSUE, Unknowns};

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

impl Controller<'_> {
    /// Tip at the target's depth if nothing is moved, by the likeliest law, and what it is uncertain by, mm.
    fn unsteered(&mut self) -> Result<([f64; 2], Spread), SteerError> {
        let posterior = self.update(&[])?;
        let (tip_m, covariance_m2) = planner::outcome(&posterior.weighted(), [0.0; 2], &[]);
        let law = &self.laws[self.best()];
        let likeliest = posterior.at.iter().max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, at)| at);
        let sd_mm = |is_of: &dyn Fn(&Unknowns, usize) -> bool| {
            let Some(posterior) = likeliest else { return f64::NAN };
            let miss_variance = |row: &nalgebra::DVector<f64>| {
                let mut row_part = row.clone();
                row_part
                    .iter_mut()
                    .enumerate()
                    .filter(|(i, _)| !is_of(&law.unknowns, *i))
                    .for_each(|(_, x)| *x = 0.0);
                row_part.dot(&(&posterior.covariance * &row_part))
            };
            1e3 * (0.5 * (miss_variance(&posterior.rows[0]) + miss_variance(&posterior.rows[1])))
                .max(0.0)
                .sqrt()
        };
        let total_sd_mm = 1e3 * super::decide::sd_m(covariance_m2);
        let spread = Spread {
            all: total_sd_mm,
            slope: sd_mm(&|unknowns, i| (unknowns.slope()..unknowns.guide_offset()).contains(&i)),
            tip: sd_mm(&|unknowns, i| (unknowns.beside()..unknowns.irregularity(0, 0)).contains(&i)),
            tissue: sd_mm(&|_, i| i < TISSUE),
            guide: sd_mm(&|unknowns, i| (unknowns.guide_offset()..unknowns.beside()).contains(&i)),
            irregularity: sd_mm(&|unknowns, i| i >= unknowns.irregularity(0, 0)),
        };
        Ok((tip_m.map(|m| 1e3 * m), spread))
    }
}
