//! Rotations of the needle: at which depths and to which angles a few of them bring the tip to the target.
//!
//! Load and cut angle are fixed to the needle and turn with it. With `A_j` the effect at the target of what is fixed to
//! the needle from node `j` on, in the needle's frame, rotations at nodes `j` and `k` to the angles `a` and `b` change
//! the tip there by `(R(a) - R(now)) A_j + (R(b) - R(a)) A_k`. Pairs of nodes are enumerated with a grid of first
//! angles; the angles then follow in closed form, each for the other. The cost has, beside the squared miss, what the
//! load may do after the last rotation: a share of `A_k`.

use super::{Controller, SHARE_OF_SPEED, SteerError};
use crate::estimator::{AtTarget, Hypothesis};
use crate::protocol::Command;
use crate::results::PlannedRotation;

/// Most rotations that are planned ahead.
pub(super) const MAX_AHEAD: usize = 2;
/// Share of the effect after the last rotation that stays uncertain, whatever was identified: the load changes on the way.
const UNCERTAIN: f64 = 0.12;
/// With a second rotation to come, the target is kept so many standard deviations inside what that reaches; and so many of them an
/// early first rotation costs, since later more is identified.
const MARGIN: f64 = 2.0;
const EARLY: f64 = 0.1;
/// A rotation costs as much as this miss, m: needless ones are not made.
const ROTATION_M: f64 = 0.05e-3;
/// Rotations below this are not made, rad.
const SMALLEST_RAD: f64 = 0.02;
/// First angles of the grid, and rounds of the closed form.
const ANGLES: usize = 12;
const ROUNDS: usize = 2;

/// One law's response to rotations, SI.
pub(super) struct Response {
    /// Its probability.
    pub weight: f64,
    /// Tip at the target if nothing more is done.
    pub tip_m: [f64; 2],
    /// Effect at the target, in the needle's frame, of what is fixed to it from each candidate on.
    pub after_m: Vec<[f64; 2]>,
}

/// A rotation: number of the candidate, and angle, rad.
pub(super) type Turn = (usize, f64);

fn turned([along, across]: [f64; 2], (sin, cos): (f64, f64)) -> [f64; 2] {
    [cos * along - sin * across, sin * along + cos * across]
}

impl Response {
    /// Tip at the target after these rotations.
    fn tip(&self, now_rad: f64, turns: &[Turn]) -> [f64; 2] {
        let mut tip_m = self.tip_m;
        let mut start_rad = now_rad;
        for (candidate, to_rad) in turns {
            let moved_m = self.after_m.get(*candidate).copied().unwrap_or_default();
            let (end_offset, start_offset) =
                (turned(moved_m, to_rad.sin_cos()), turned(moved_m, start_rad.sin_cos()));
            tip_m = [tip_m[0] + end_offset[0] - start_offset[0], tip_m[1] + end_offset[1] - start_offset[1]];
            start_rad = *to_rad;
        }
        tip_m
    }
}

/// Expected tip at the target after these rotations.
pub(super) fn expected(responses: &[Response], now_rad: f64, turns: &[Turn]) -> [f64; 2] {
    let mut mean_m = [0.0; 2];
    for response in responses {
        let tip_m = response.tip(now_rad, turns);
        (0..2).for_each(|plane| mean_m[plane] += response.weight * tip_m[plane]);
    }
    mean_m
}

/// Aim of a rotation.
#[derive(Debug, Clone, Copy)]
pub(super) struct Aim {
    /// Direction of the load now, rad.
    pub now_rad: f64,
    /// Target, m.
    pub target_m: [f64; 2],
    /// Standard deviation of the tip at the target over the effect of what is fixed to the needle from now on.
    pub doubt: f64,
}

fn cost(responses: &[Response], turns: &[Turn], aim: Aim) -> f64 {
    let Aim { now_rad, target_m, doubt } = aim;
    responses
        .iter()
        .map(|response| {
            let last = turns.last().map_or(0, |(candidate, _)| *candidate);
            let miss_m = tip_after(last, &response.after_m);
            let mut sum = distance_m(response.tip(now_rad, turns), target_m).powi(2)
                + (doubt.max(UNCERTAIN) * miss_m[0].hypot(miss_m[1])).powi(2);
            if let [(first, end_rad), _] = turns {
                // One more rotation reaches about what lies in a circle through the tip without it.
                let moved_m = tip_after(*first, &response.after_m);
                let (tip_m, arm_m) = (response.tip(now_rad, &turns[..1]), turned(moved_m, end_rad.sin_cos()));
                let reach_m = moved_m[0].hypot(moved_m[1]);
                let target_offset_m = distance_m([tip_m[0] - arm_m[0], tip_m[1] - arm_m[1]], target_m);
                sum += (target_offset_m - (1.0 - MARGIN * doubt).max(0.0) * reach_m).max(0.0).powi(2);
                sum += (EARLY * doubt * reach_m).powi(2);
            }
            response.weight * sum
        })
        .sum::<f64>()
        + ROTATION_M * ROTATION_M * turns.len() as f64
}

fn tip_after(candidate: usize, after_m: &[[f64; 2]]) -> [f64; 2] {
    after_m.get(candidate).copied().unwrap_or_default()
}

fn distance_m(m: [f64; 2], target_m: [f64; 2]) -> f64 {
    (m[0] - target_m[0]).hypot(m[1] - target_m[1])
}

/// Puts one of the rotations to the angle that is best for the others.
fn improve(responses: &[Response], now_rad: f64, turns: &mut [Turn], which: usize, target_m: [f64; 2]) {
    let (mut cosine, mut sine) = (0.0, 0.0);
    let Some(&(candidate, angle_rad)) = turns.get(which) else { return };
    let next = turns.get(which + 1).map(|(candidate, _)| *candidate);
    for response in responses {
        let moved_m = response.after_m.get(candidate).copied().unwrap_or_default();
        let next_m = next.and_then(|next| response.after_m.get(next).copied()).unwrap_or_default();
        // Part of the tip's position that turns with this angle, and the part without it.
        let arm_m = [moved_m[0] - next_m[0], moved_m[1] - next_m[1]];
        let tip_m = response.tip(now_rad, turns);
        let rotated_m = turned(arm_m, angle_rad.sin_cos());
        let [x, y] = [0, 1].map(|plane: usize| target_m[plane] - tip_m[plane] + rotated_m[plane]);
        cosine += response.weight * (x * arm_m[0] + y * arm_m[1]);
        sine += response.weight * (y * arm_m[0] - x * arm_m[1]);
    }
    if let Some(turn) = turns.get_mut(which).filter(|_| cosine.hypot(sine) > 0.0) {
        turn.1 = sine.atan2(cosine);
    }
}

/// The rotations, at most `left` of them, that cost least.
pub(super) fn plan(responses: &[Response], aim: Aim, left: usize) -> Vec<Turn> {
    let Aim { now_rad, target_m, .. } = aim;
    let candidates = responses.first().map_or(0, |response| response.after_m.len());
    let mut best: (f64, Vec<Turn>) = (cost(responses, &[], aim), Vec::new());
    let mut consider = |turns: &mut [Turn]| {
        for _ in 0..ROUNDS {
            (0..turns.len()).for_each(|which| improve(responses, now_rad, turns, which, target_m));
        }
        let plan_cost = cost(responses, turns, aim);
        if plan_cost < best.0 {
            best = (plan_cost, turns.to_vec());
        }
    };
    for first in 0..candidates {
        if left >= 1 {
            consider(&mut [(first, now_rad)]);
        }
        if left >= MAX_AHEAD {
            for second in first + 1..candidates {
                for angle in 0..ANGLES {
                    let angle_rad = now_rad + std::f64::consts::TAU * angle as f64 / ANGLES as f64;
                    consider(&mut [(first, angle_rad), (second, angle_rad)]);
                }
            }
        }
    }
    best.1
}

impl Controller<'_> {
    /// Whether the needle is steered by rotations.
    pub(super) fn rotates(&self) -> bool {
        self.options.steered && self.options.rotations > 0 && self.stated.rig.can_rotate
    }

    /// Responses of all laws to rotations at the nodes from this one on but the last.
    pub(super) fn responses(&self, node: usize, at: &[(f64, AtTarget)]) -> Result<Vec<Response>, SteerError> {
        let nodes: Vec<usize> = (node..self.history.depths_m.len() - 1).collect();
        let response_of = |law: &Hypothesis, weight: f64, at: &AtTarget| -> Result<Response, SteerError> {
            Ok(Response { weight, tip_m: at.tip_m, after_m: law.after(&self.history, &nodes)? })
        };
        if at.len() == self.laws.len() {
            self.laws.iter().zip(at).map(|(law, (weight, at))| response_of(law, *weight, at)).collect()
        } else {
            let most = at.iter().max_by(|a, b| a.0.total_cmp(&b.0));
            most.iter().map(|(_, at)| response_of(&self.laws[self.best()], 1.0, at)).collect()
        }
    }

    /// Rotations from this node on, as they are planned now, and the tip that is expected at the target.
    pub(super) fn plan_rotations(
        &self,
        node: usize,
        at: &[(f64, AtTarget)],
        sd_m: f64,
    ) -> Result<(Vec<PlannedRotation>, [f64; 2]), SteerError> {
        let responses = self.responses(node, at)?;
        let lever_m: f64 = responses
            .iter()
            .map(|one| one.after_m.first().map_or(0.0, |m| one.weight * m[0].hypot(m[1])))
            .sum();
        let now_rad = self.last.bevel_deg.to_radians();
        let target_m = [1e-3 * self.options.target_mm[0], 1e-3 * self.options.target_mm[1]];
        let turns_left = self.options.rotations.saturating_sub(self.rotations_made).min(MAX_AHEAD);
        let doubt = (sd_m / lever_m.max(1e-6)).min(0.5);
        let mut turns = plan(&responses, Aim { now_rad, target_m, doubt }, turns_left);
        turns.retain(|(_, to_rad)| {
            (to_rad - now_rad).sin().hypot(1.0 - (to_rad - now_rad).cos()) > SMALLEST_RAD
        });
        let tip_m = expected(&responses, now_rad, &turns);
        let mut start_deg = self.last.bevel_deg;
        let planned = turns.iter().filter_map(|(candidate, to_rad)| {
            let depth_m = self.history.depths_m.get(node + candidate)?;
            // The shorter way round.
            let rotation_deg = (to_rad.to_degrees() - start_deg + 180.0).rem_euclid(360.0) - 180.0;
            start_deg += rotation_deg;
            Some(PlannedRotation { depth_mm: 1e3 * depth_m, by_deg: rotation_deg, bevel_deg: start_deg })
        });
        Ok((planned.collect(), tip_m))
    }

    /// Turns the needle at rest.
    pub(super) fn turn(&mut self, to_deg: f64) -> Result<(), SteerError> {
        let start_deg = self.last.bevel_deg;
        let period_s = self.period_s();
        let time_s = (to_deg - start_deg).abs() / (SHARE_OF_SPEED * self.stated.limits.rotation_speed_deg_s);
        let steps = (time_s / period_s).ceil().max(1.0);
        let step_s = (time_s / steps).max(0.02);
        self.readings.skip_s = [self.last.t_s + 1e-6, f64::INFINITY];
        for step in 1..=steps as usize {
            let fraction = step as f64 / steps;
            let bevel_deg = start_deg + fraction * (to_deg - start_deg);
            self.step(Command { t_s: self.last.t_s + step_s, bevel_deg, ..self.last })?;
        }
        self.readings.skip_s[1] = self.last.t_s + 0.05;
        self.rotations_made += 1;
        self.refresh()?;
        self.rest(0.6 * self.settling() + self.stated.tip_delay_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A path whose curvature follows the load: the effect left at depth s of L falls as (1 - s/L)^2.
    fn response(tip_m: [f64; 2]) -> Response {
        let remaining_m = (0..40).map(|i| [8e-3 * (1.0 - f64::from(i) / 40.0).powi(2), 0.4e-3]).collect();
        Response { weight: 1.0, tip_m, after_m: remaining_m }
    }

    fn aim(now_rad: f64, target_m: [f64; 2]) -> Aim {
        Aim { now_rad, target_m, doubt: 0.05 }
    }

    #[test]
    fn two_rotations_reach_a_target_within_the_bend_that_is_left() {
        let responses = [response([8e-3, 0.4e-3])];
        for target_m in [[1e-3, 1e-3], [-2e-3, 3e-3], [4e-3, -4e-3]] {
            let turns = plan(&responses, aim(0.0, target_m), 2);
            let tip_m = expected(&responses, 0.0, &turns);
            let miss_m = (tip_m[0] - target_m[0]).hypot(tip_m[1] - target_m[1]);
            assert!(miss_m < 0.05e-3, "{target_m:?}: {turns:?} ends {} mm away", 1e3 * miss_m);
            assert!(turns.len() <= 2 && turns.windows(2).all(|pair| pair[0].0 < pair[1].0));
        }
    }

    #[test]
    fn no_rotation_is_planned_where_the_needle_goes_to_the_target_by_itself_and_little_is_left() {
        let mut only = response([2e-3, 1e-3]);
        only.after_m.iter_mut().for_each(|m| *m = [0.02e-3, 0.0]);
        assert!(plan(&[only], aim(0.3, [2e-3, 1e-3]), 2).is_empty());
    }

    #[test]
    fn a_single_rotation_is_the_best_of_a_fine_grid() {
        let responses = [response([8e-3, 0.4e-3])];
        let target_m = [3e-3, 5e-3];
        let best_plan = plan(&responses, aim(0.2, target_m), 1);
        for candidate in 0..40 {
            for angle in 0..360 {
                let turn = (candidate, f64::from(angle).to_radians());
                assert!(
                    cost_of(&best_plan, &responses, target_m)
                        <= cost_of(&[turn], &responses, target_m) + 1e-15
                );
            }
        }
    }

    fn cost_of(turns: &[Turn], responses: &[Response; 1], target_m: [f64; 2]) -> f64 {
        cost(responses, turns, aim(0.2, target_m))
    }
}
