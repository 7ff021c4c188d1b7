//! Where the guide may be: travel, force and strain.

use super::{Controller, SHARE_OF_FORCE, SHARE_OF_TRAVEL, SteerError};
use crate::planner::{Bounds, Circle};
use crate::statics::AtRest;

impl Controller<'_> {
    /// Where the guide may be at the rests to come: within its travel, and where the needle's resistance against motion away from
    /// where it does not load the guide stays below the force limit.
    pub(super) fn bounds(&self, rests: &[usize], now_m: [f64; 2]) -> Result<Bounds, SteerError> {
        let travel_m = 1e-3 * SHARE_OF_TRAVEL * self.stated.limits.guide_travel_mm;
        let free = Bounds { travel_m, largest_move_m: None, circles: vec![None; rests.len()] };
        let Some(limit_n) = self.stated.limits.guide_force_n else { return Ok(free) };
        let law = &self.laws[self.best()];
        let problem = law.unknowns.problem(&law.values)?;
        let force_n = match self.force_n {
            Some(force_n) => force_n,
            None => {
                AtRest::new(&law.unknowns, &law.values, &self.history, &self.expected, 1e-3)?
                    .at(now_m)?
                    .force_n
            }
        };
        let mut circles = Vec::with_capacity(rests.len());
        let mut free_m = None;
        for stiffness in self.stiffness_n_per_m(&problem, rests)? {
            let centre_m =
                *free_m.get_or_insert([0, 1].map(|plane: usize| now_m[plane] - force_n[plane] / stiffness));
            // What is now beyond it is not moved further.
            let now_away_m = (now_m[0] - centre_m[0]).hypot(now_m[1] - centre_m[1]);
            let radius_m = (SHARE_OF_FORCE * limit_n / stiffness).max(now_away_m);
            circles.push(Some(Circle { centre_m, radius_m }));
        }
        Ok(Bounds { circles, ..free })
    }

    /// Force at guide 2 per displacement of it, at each rest.
    pub(super) fn stiffness_n_per_m(
        &self,
        problem: &mechanics::BeamProblem,
        rests: &[usize],
    ) -> Result<Vec<f64>, SteerError> {
        let of = |rest: &usize| {
            let here = mechanics::BeamProblem { depth_m: self.history.depths_m[*rest], ..problem.clone() };
            Ok(here.solve()?.lateral_stiffness_n_per_m())
        };
        rests.iter().map(of).collect()
    }

    /// A move that keeps force and strain within limits, where the requested one does not, and what limits it.
    pub(super) fn within_limits(
        &self,
        now_m: [f64; 2],
        to_m: [f64; 2],
    ) -> Result<Option<([f64; 2], &'static str)>, SteerError> {
        let limits = &self.stated.limits;
        if limits.guide_force_n.is_none() && limits.needle_strain.is_none() {
            return Ok(None);
        }
        let law = &self.laws[self.best()];
        let radius_m = 0.5e-3 * self.stated.needle.outer_diameter_mm.unwrap_or(1.27);
        let at_rest = AtRest::new(&law.unknowns, &law.values, &self.history, &self.expected, radius_m)?;
        let now = at_rest.at(now_m)?;
        let step_m = [to_m[0] - now_m[0], to_m[1] - now_m[1]];
        let limit_at = |moved_m: [f64; 2]| -> Result<Option<&'static str>, SteerError> {
            let then = at_rest.at(moved_m)?;
            // What is measured counts, and the model only for what the move changes.
            let force_n = match self.force_n {
                Some(measured) => [0, 1].map(|i: usize| measured[i] + then.force_n[i] - now.force_n[i]),
                None => then.force_n,
            };
            let size = |force: [f64; 2]| force[0].hypot(force[1]);
            let less = self.force_n.map_or(size(now.force_n), size);
            let too_much = limits
                .guide_force_n
                .is_some_and(|limit| size(force_n) > SHARE_OF_FORCE * limit && size(force_n) > less);
            let too_bent = limits
                .needle_strain
                .is_some_and(|limit| then.strain > SHARE_OF_FORCE * limit && then.strain > now.strain);
            Ok(if too_much {
                Some("force")
            } else if too_bent {
                Some("strain")
            } else {
                None
            })
        };
        let Some(limit) = limit_at(to_m)? else { return Ok(None) };
        // The nearest allowed position: the limit is a circle, so that beside it there may be some where straight on there is none.
        let mut nearest = (step_m[0].hypot(step_m[1]), now_m);
        for angle_deg in [0.0, 20.0, -20.0, 40.0, -40.0, 60.0, -60.0, 80.0, -80.0_f64] {
            let (sin, cos) = angle_deg.to_radians().sin_cos();
            for share in [0.9, 0.75, 0.6, 0.45, 0.3, 0.15] {
                let [x_m, y_m] = step_m.map(|m| share * m);
                let moved_m = [now_m[0] + cos * x_m - sin * y_m, now_m[1] + sin * x_m + cos * y_m];
                let away_m = (to_m[0] - moved_m[0]).hypot(to_m[1] - moved_m[1]);
                if away_m < nearest.0 && limit_at(moved_m)?.is_none() {
                    nearest = (away_m, moved_m);
                }
            }
        }
        Ok(Some((nearest.1, limit)))
    }
}
