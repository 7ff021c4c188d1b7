//! A rest's decision: estimate, plan, move, or stop.

use super::limits::Request;
use super::{Controller, MISS_THAT_STOPS_MM, Posterior, SMALLEST_MOVE_MM, SteerError};

use crate::history::Place;
use crate::planner::{Plan, Weights};
use crate::results::{Decision, Event, Outcome, PathPoint, PlannedRotation};
use crate::tables;
use crate::unknowns::{CuttingLaw, LAYERS};

/// Standard deviation per axis, of a covariance.
pub(super) fn sd_m(covariance_m2: [f64; 3]) -> f64 {
    (0.5 * (covariance_m2[0] + covariance_m2[2])).max(0.0).sqrt()
}

impl Controller<'_> {
    /// Estimates, plans and moves at a rest.
    pub(super) fn decide(&mut self, node: usize) -> Result<Option<Outcome>, SteerError> {
        let began = std::time::Instant::now();
        let decision = self.planned(node)?;
        self.replans_s.push(began.elapsed().as_secs_f64());
        (self.on_event)(&Event::Decision(&decision));
        let stopped = self.is_worse_than_none(&decision);
        let turn = decision.turn();
        let [start_mm, end_mm] = [decision.guide_from_mm, decision.guide_to_mm];
        self.decisions.push(decision);
        if stopped.is_some() {
            return Ok(stopped);
        }
        if let Some(turn) = turn {
            let at_stop = self.force_at_stop();
            self.turn(turn.bevel_deg)?;
            self.expect(at_stop);
            return Ok(None);
        }
        if (end_mm[0] - start_mm[0]).hypot(end_mm[1] - start_mm[1]) > SMALLEST_MOVE_MM {
            self.move_guide(end_mm)?;
        } else {
            self.expect(self.force_at_stop());
        }
        Ok(None)
    }

    /// Squared miss per squared move, at a share of the target's depth.
    pub(super) fn effort(&self, depth_share: f64) -> f64 {
        (1.2 - depth_share) * self.options.effort
    }

    /// Estimates and plans at a rest: what is to be done there and after it.
    pub(super) fn planned(&mut self, node: usize) -> Result<Decision, SteerError> {
        let rest_nodes: Vec<usize> = self.rests.iter().copied().filter(|rest| *rest >= node).collect();
        let posterior = self.update(&rest_nodes)?;
        let laws = posterior.weighted();
        let now_m = [1e-3 * self.last.guide_x_mm, 1e-3 * self.last.guide_y_mm];
        let target_m = [1e-3 * self.options.target_mm[0], 1e-3 * self.options.target_mm[1]];
        let depth_share = self.history.depths_m[node] / (1e-3 * self.options.target_mm[2]);
        let weights = Weights { caution: self.options.caution, effort: self.effort(depth_share) };
        let steered = self.options.steered && self.stated.limits.guide_travel_mm > 0.0 && !self.rotates();
        let mut plan = if steered {
            let largest_move_m = Some(1e-3 * self.options.largest_move_mm);
            let request =
                Request { stops: &rest_nodes, laws: &laws, now_m, target_m, largest_move_m, weights };
            self.limited_plan(&request)?
        } else {
            Plan::staying(&laws, now_m, rest_nodes.len())
        };
        let target_m = plan.guide_m.first().copied().unwrap_or(now_m);
        let mut rotations = Vec::new();
        if self.rotates() {
            (rotations, plan.tip_m) = self.plan_rotations(node, &posterior.at, sd_m(plan.covariance_m2))?;
        }
        let known_rests = rest_nodes;
        self.stop_at(&rotations);
        let rest_nodes: Vec<usize> = self.rests.iter().copied().filter(|rest| *rest >= node).collect();
        plan.guide_m.resize(rest_nodes.len(), target_m);
        let mut decision = self.decision(node, &rest_nodes, &plan, target_m, &posterior)?;
        decision.path = self.way(&known_rests, &rest_nodes, &plan, &rotations, &posterior)?;
        decision.rotations = rotations;
        Ok(decision)
    }

    /// The tip's way to the target by a plan, by the likeliest law: at the rests of which the posterior has the uncertainty, `known_rests`, among
    /// those of the plan.
    fn way(
        &self,
        known_rests: &[usize],
        rests: &[usize],
        plan: &Plan,
        rotations: &[PlannedRotation],
        posterior: &Posterior,
    ) -> Result<Vec<PathPoint>, SteerError> {
        let law = &self.laws[self.best()];
        let mut history = self.history.clone();
        history.plan(rests.iter().copied().zip(plan.guide_m.iter().copied()));
        for rotation in rotations {
            history.plan_rotation(1e-3 * rotation.depth_mm, rotation.bevel_deg.to_radians());
        }
        let paths = law.paths(&history)?;
        let likeliest = posterior.at.iter().max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, at)| at);
        let point = |node: usize, sd_mm: f64| PathPoint {
            depth_mm: 1e3 * history.depths_m[node],
            tip_mm: [0, 1].map(|plane: usize| 1e3 * tables::at(&paths[plane], Place::Rest(node, 1))),
            sd_mm,
        };
        let last = history.depths_m.len() - 1;
        // A stop that is new in this plan has no row yet.
        let on_way = rests
            .iter()
            .map(|rest| point(*rest, sd_mm_at(*rest, likeliest, known_rests)))
            .filter(|point| point.sd_mm.is_finite());
        Ok(on_way.chain([point(last, 1e3 * sd_m(plan.covariance_m2))]).collect())
    }

    /// The needle stops also where it is to be turned.
    fn stop_at(&mut self, rotations: &[PlannedRotation]) {
        for rotation in rotations {
            let depth_m = 1e-3 * rotation.depth_mm;
            let node = self.history.depths_m.partition_point(|m| *m < depth_m - 1e-6);
            let stop_index = self.rests.partition_point(|rest| *rest < node);
            // The stop of an earlier plan stays: a reading more.
            if self.rests.get(stop_index) != Some(&node) && node > self.history.reached {
                self.rests.insert(stop_index, node);
            }
        }
    }

    /// Stops where the plan, too, ends further from the target than no steering would have: the model is not that of this needle.
    pub(super) fn is_worse_than_none(&self, decision: &Decision) -> Option<Outcome> {
        let target_mm = self.options.target_mm;
        let planned_mm = miss_along_mm(0, target_mm, decision.expected_tip_mm).hypot(miss_along_mm(
            1,
            target_mm,
            decision.expected_tip_mm,
        ));
        let sd_mm = (decision.covariance_mm2[0] + decision.covariance_mm2[2]).max(0.0).sqrt();
        let worse = planned_mm - 2.0 * sd_mm > decision.unsteered_miss_mm.max(MISS_THAT_STOPS_MM);
        (worse && self.options.steered).then(|| {
            let likely = if decision.cut_angle_probability > 0.5 {
                "; the tip cuts at an angle to the needle (tip.cut_angle)"
            } else {
                ""
            };
            Outcome::Stopped {
                name: "worse_than_no_steering",
                cause: format!(
                    "at {:.0} mm the best plan ends {planned_mm:.2} mm from the target, without steering it would be {:.2} mm{likely}",
                    decision.depth_mm, decision.unsteered_miss_mm
                ),
            }
        })
    }

    pub(super) fn decision(
        &self,
        node: usize,
        rests: &[usize],
        plan: &Plan,
        to_m: [f64; 2],
        posterior: &Posterior,
    ) -> Result<Decision, SteerError> {
        let law = &self.laws[self.best()];
        let covariance = posterior.at.iter().max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, at)| &at.covariance);
        let problem = law.unknowns.problem(&law.values)?;
        let middles_m = [0.005, 0.0175, 0.035, 0.0575, 0.085];
        let depth_m = self.history.depths_m[node];
        let load_n = tables::hats(depth_m, law.unknowns.knots)
            .iter()
            .map(|(knot, weight)| weight * law.unknowns.value(&law.values, law.unknowns.tip(0, *knot)))
            .sum();
        let cut_angle_probability = if posterior.at.len() == self.laws.len() {
            self.laws
                .iter()
                .zip(&posterior.at)
                .map(|(law, (weight, _))| if law.law() == CuttingLaw::Angle { *weight } else { 0.0 })
                .sum()
        } else {
            f64::from(u8::from(law.law() == CuttingLaw::Angle))
        };
        Ok(Decision {
            t_s: self.last.t_s,
            depth_mm: 1e3 * depth_m,
            guide_from_mm: [self.last.guide_x_mm, self.last.guide_y_mm],
            guide_to_mm: to_mm(to_m),
            bevel_deg: self.last.bevel_deg,
            plan_depth_mm: rests.iter().map(|rest| 1e3 * self.history.depths_m[*rest]).collect(),
            plan_guide_mm: plan.guide_m.iter().copied().map(to_mm).collect(),
            expected_tip_mm: to_mm(plan.tip_m),
            covariance_mm2: plan.covariance_m2.map(|m2| 1e6 * m2),
            within: self.within(plan.tip_m, plan.covariance_m2),
            path: Vec::new(),
            unsteered_miss_mm: self.unsteered_miss_mm()?,
            modulus_kpa: middles_m.iter().map(|m| 1e-3 * problem.foundation.modulus_pa(*m)).collect(),
            modulus_sd_ln: (0..LAYERS)
                .map(|layer| law.unknowns.sd[layer] * sd_of(layer, covariance))
                .collect(),
            tip_load_n: load_n,
            cut_angle_probability,
            misfit: law.misfit,
            limited_by: plan.limited_by.first().map(|(limit, _)| limit.name()),
            limits: self.limits_in_words(plan),
            rotations: Vec::new(),
        })
    }

    /// Limits that keep the needle from its target, in words.
    fn limits_in_words(&self, plan: &Plan) -> Option<String> {
        let limits: Vec<String> = plan.limited_by.iter().map(|(limit, _)| limit.to_string()).collect();
        let (miss_mm, verb) = (
            self.difference_mm(0, plan.tip_m).hypot(self.difference_mm(1, plan.tip_m)),
            if limits.len() == 1 { "keeps" } else { "keep" },
        );
        (!limits.is_empty()).then(|| {
            format!(
                "{} {verb} guide 2 from moving further: the tip is expected {miss_mm:.2} mm from the target",
                limits.join(" and ")
            )
        })
    }

    fn difference_mm(&self, i: usize, tip_m: [f64; 2]) -> f64 {
        1e3 * tip_m[i] - self.options.target_mm[i]
    }

    /// Miss had the guide never been moved and the needle never been turned, by the likeliest law.
    pub(super) fn unsteered_miss_mm(&self) -> Result<f64, SteerError> {
        let law = &self.laws[self.best()];
        let mut still = self.history.clone();
        for node in &mut still.nodes {
            (node.guide_m, node.play) = Default::default();
            node.bevel_rad = [self.stated.bevel_deg.to_radians(); 2];
        }
        let paths = law.paths(&still)?;
        let last = Place::Rest(still.depths_m.len() - 1, 0);
        Ok(self.unsteered_miss_along_mm(0, &paths, last).hypot(self.unsteered_miss_along_mm(1, &paths, last)))
    }

    fn unsteered_miss_along_mm(&self, plane: usize, paths: &[Vec<[f64; 2]>; 2], last: Place) -> f64 {
        1e3 * tables::at(&paths[plane], last) - self.options.target_mm[plane]
    }
}

fn sd_of(place: usize, covariance: Option<&nalgebra::DMatrix<f64>>) -> f64 {
    covariance.map_or(f64::NAN, |c| c[(place, place)].max(0.0).sqrt())
}

fn to_mm(m: [f64; 2]) -> [f64; 2] {
    m.map(|m| 1e3 * m)
}

fn miss_along_mm(i: usize, target_mm: [f64; 3], expected_tip_mm: [f64; 2]) -> f64 {
    expected_tip_mm[i] - target_mm[i]
}

fn sd_mm_at(rest: usize, likeliest: Option<&crate::estimator::AtTarget>, known_rests: &[usize]) -> f64 {
    let number = known_rests.iter().position(|one| *one == rest);
    let rows = likeliest.zip(number).and_then(|(at, number)| Some((at, at.way_rows.get(number)?)));
    rows.map_or(f64::NAN, |(at, rows)| {
        1e3 * (0.5 * (variance_of(&rows[0], &at.covariance) + variance_of(&rows[1], &at.covariance)))
            .max(0.0)
            .sqrt()
    })
}

/// Variance of a quantity with these derivatives.
pub(super) fn variance_of(row: &nalgebra::DVector<f64>, covariance: &nalgebra::DMatrix<f64>) -> f64 {
    row.dot(&(covariance * row))
}
