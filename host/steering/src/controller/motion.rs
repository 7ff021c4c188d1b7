//! Steps of the plant: pushing, resting, moving the guide, with the supervisor's watch on tip and force.

use super::{
    Controller, DEPTH_ERROR_MM, GUIDE_SETTLING_S, SHARE_OF_FORCE, SHARE_OF_SPEED, SHARE_OF_TRAVEL,
    SHARE_THAT_STOPS, SILENCE_S, SteerError,
};
use crate::envelope::Measured;
use crate::estimator::Felt;
use crate::history::Place;
use crate::protocol::{Answer, Command};
use crate::readings::{ReadingStatus, Series};
use crate::results::Event;
use crate::tables;

impl Controller<'_> {
    /// Time between steps in which nothing is missed of the tip sensor, s.
    pub(super) fn period_s(&self) -> f64 {
        (1.0 / self.stated.tip_rate_hz).clamp(0.02, 1.0)
    }

    /// Time after which enough readings of a resting needle are there, s.
    pub(super) fn settling(&self) -> f64 {
        let reading_count = (self.stated.tip_noise_mm / 0.06).powi(2).ceil().clamp(6.0, 20.0);
        self.stated.tip_delay_s + (reading_count / self.stated.tip_rate_hz).clamp(0.2, 4.0)
    }

    /// One step.
    pub(super) fn step(&mut self, to: Command) -> Result<ReadingStatus, SteerError> {
        (self.on_event)(&Event::Command(&to));
        let answer = self.plant.step(&to)?;
        answer.check(&to)?;
        if (answer.depth_mm - to.depth_mm).abs() > DEPTH_ERROR_MM {
            let (commanded_mm, reported_mm) = (to.depth_mm, answer.depth_mm);
            return Err(SteerError::NeedleOffDepth { commanded_mm, reported_mm });
        }
        (self.on_event)(&Event::Answer(&answer));
        if to.depth_mm > self.last.depth_mm {
            self.pushed_blind_s += to.t_s - self.last.t_s;
        }
        if to != (Command { t_s: to.t_s, ..self.last }) {
            self.still_force.1 = 0.0;
        }
        self.last = to;
        self.history.record(&answer);
        let expected = &self.expected;
        let reading_status = self.readings.take(&answer, &self.history, |place: Place| {
            ([0, 1].map(|plane: usize| tables::at(&expected[plane], place)), 0.4e-3)
        });
        if reading_status == ReadingStatus::Good {
            self.pushed_blind_s = 0.0;
        }
        self.take_force(&answer);
        self.compare(&answer, reading_status);
        Ok(reading_status)
    }

    pub(super) fn take_force(&mut self, answer: &Answer) {
        let (Some(x), Some(y)) = (answer.force_x_n, answer.force_y_n) else { return };
        if answer.depth_mm <= 1e-6 {
            let (mean, count) = self.zero_force;
            let more = count + 1.0;
            let deviation_n = [x - mean[0], y - mean[1]];
            self.zero_force = ([0, 1].map(|i: usize| mean[i] + deviation_n[i] / more), more);
            self.zero_squares_n2 += count / more * deviation_n.iter().map(|n| n * n).sum::<f64>();
        }
        let force_n = [x - self.zero_force.0[0], y - self.zero_force.0[1]];
        self.peak_force_n = Some(self.peak_force_n.unwrap_or(0.0).max(force_n[0].hypot(force_n[1])));
        self.force_n = Some(force_n);
        let (mean_n, count) = self.still_force;
        let more = count + 1.0;
        let mean_n = [0, 1].map(|i: usize| (mean_n[i] * count + force_n[i]) / more);
        self.still_force = (mean_n, more);
    }

    /// Waits so long.
    pub(super) fn rest(&mut self, time_s: f64) -> Result<(), SteerError> {
        let steps = (time_s / self.period_s() - 1e-6).ceil().max(1.0) as usize;
        for _ in 0..steps {
            self.step(Command { t_s: self.last.t_s + self.period_s(), ..self.last })?;
        }
        Ok(())
    }

    /// Pushes to a node.
    pub(super) fn push_to(&mut self, node: usize) -> Result<(), SteerError> {
        let speed = self.options.push_speed_mm_s.min(0.95 * self.stated.limits.push_speed_mm_s);
        let target_mm = 1e3 * self.history.depths_m[node];
        let distance_mm = target_mm - self.last.depth_mm;
        let steps = (distance_mm / speed / self.period_s())
            .max(distance_mm / (0.99 * self.stated.depth_step_mm))
            .ceil()
            .max(1.0);
        let (start_mm, step_s) = (self.last.depth_mm, (distance_mm / speed / steps).max(1e-3));
        for step in 1..=steps as usize {
            let depth_mm =
                if step as f64 >= steps { target_mm } else { start_mm + distance_mm * step as f64 / steps };
            self.step(Command { t_s: self.last.t_s + step_s, depth_mm, ..self.last })?;
            self.watch_tip()?;
            self.watch_force()?;
        }
        Ok(())
    }

    /// Holds where the tip sensor is silent, and ends the run where it stays so.
    pub(super) fn watch_tip(&mut self) -> Result<(), SteerError> {
        let silence_s = self.pushed_blind_s;
        if silence_s < SILENCE_S {
            return Ok(());
        }
        let start_time_s = self.last.t_s;
        while self.last.t_s - start_time_s < SILENCE_S {
            self.rest(self.period_s())?;
            if self.readings.last_good_s > start_time_s {
                return Ok(());
            }
        }
        let Series { far, repeated, late, latest_s } = self.readings.in_series;
        if far >= 5 {
            return Err(SteerError::TipOutsideBand { count: far, depth_mm: self.last.depth_mm });
        }
        if late >= 5 {
            return Err(SteerError::TipLate {
                count: late,
                age_s: latest_s,
                stated_s: self.stated.tip_delay_s,
            });
        }
        if repeated >= 5 {
            return Err(SteerError::TipFrozen { count: repeated });
        }
        Err(SteerError::TipSilent { silence_s, waited_s: SILENCE_S })
    }

    /// Relieves the force at guide 2 where it comes near its limit.
    pub(super) fn watch_force(&mut self) -> Result<(), SteerError> {
        let (Some(limit_n), Some(force_n)) = (self.stated.limits.guide_force_n, self.force_n) else {
            return Ok(());
        };
        let noise_n = 2.0 * self.stated.force_noise_n.unwrap_or(0.0);
        let size_n = force_n[0].hypot(force_n[1]);
        if size_n + noise_n < SHARE_THAT_STOPS * limit_n || self.stated.limits.guide_travel_mm <= 0.0 {
            return Ok(());
        }
        let problem = self.laws[0].unknowns.problem(&self.laws[0].values)?;
        let depth_m = self.history.depths_m[self.history.reached].max(1e-3);
        let stiffness = mechanics::BeamProblem { depth_m, ..problem }.solve()?.lateral_stiffness_n_per_m();
        let retreat_mm = 1e3 * (size_n - SHARE_OF_FORCE * limit_n) / stiffness;
        let target = [0, 1].map(|plane: usize| {
            let now_mm = [self.last.guide_x_mm, self.last.guide_y_mm][plane];
            now_mm - retreat_mm * force_n[plane] / size_n
        });
        self.move_guide(target)
    }

    /// Moves the guide at rest and waits until the tip's reading shows it.
    pub(super) fn move_guide(&mut self, to_mm: [f64; 2]) -> Result<(), SteerError> {
        let travel_mm = SHARE_OF_TRAVEL * self.stated.limits.guide_travel_mm;
        let target_mm = to_mm.map(|mm| mm.clamp(-travel_mm, travel_mm));
        let start_mm = [self.last.guide_x_mm, self.last.guide_y_mm];
        let distance_mm = (target_mm[0] - start_mm[0]).abs().max((target_mm[1] - start_mm[1]).abs());
        let period_s = self.period_s();
        let time_s = distance_mm / (SHARE_OF_SPEED * self.stated.limits.guide_speed_mm_s);
        let steps = if self.stated.rig.guide_moves_in_one_step { 1.0 } else { (time_s / period_s).ceil() };
        let steps = steps.max(1.0);
        // A rig that makes each move to its end needs time to come to rest there.
        let settling_s = if self.stated.rig.guide_moves_in_one_step { GUIDE_SETTLING_S } else { 0.0 };
        let step_s = (time_s / steps).max(0.02) + settling_s;
        self.readings.skip_s = [self.last.t_s + 1e-6, f64::INFINITY];
        let (initial_force, at_stop) = (self.resting_force(), self.force_at_stop());
        for step in 1..=steps as usize {
            let fraction = step as f64 / steps;
            let (guide_x_mm, guide_y_mm) =
                (guide_at(0, start_mm, fraction, target_mm), guide_at(1, start_mm, fraction, target_mm));
            self.step(Command { t_s: self.last.t_s + step_s, guide_x_mm, guide_y_mm, ..self.last })?;
        }
        self.readings.skip_s[1] = self.last.t_s + 0.05;
        self.refresh()?;
        self.expect(at_stop);
        self.rest(0.6 * self.settling() + self.stated.tip_delay_s)?;
        self.feel([target_mm[0] - start_mm[0], target_mm[1] - start_mm[1]], initial_force);
        Ok(())
    }

    /// Takes in the stiffness that guide 2 has felt in a move: it tells clamp and tissue apart, of which the tip alone knows little.
    fn feel(&mut self, moved_mm: [f64; 2], before: Measured) {
        let (Some((force_before, before_n2)), Some((force_after, after_n2))) = (before, self.resting_force())
        else {
            return;
        };
        let node = self.history.reached;
        let Some(sides) = self.history.nodes.get(node).map(|at| at.play) else { return };
        let law = &self.laws[self.best()];
        // A guide that turns round goes through its play first.
        let force_change = [0, 1].map(|plane: usize| sides[plane][1] - sides[plane][0]);
        let moved_mm = [0, 1].map(|plane: usize| {
            let play_mm = 1e3 * law.unknowns.value(&law.values, law.unknowns.backlash() + plane);
            moved_mm[plane] - play_mm * force_change[plane]
        });
        let play_sd_mm =
            1e3 * law.unknowns.sd[law.unknowns.backlash()] * force_change[0].hypot(force_change[1]);
        let distance_mm = moved_mm[0].hypot(moved_mm[1]);
        let parallel_n: f64 =
            (0..2).map(|i| (force_after[i] - force_before[i]) * moved_mm[i]).sum::<f64>() / distance_mm;
        let noise_n = (before_n2 + after_n2).sqrt();
        let sd = (noise_n / parallel_n).hypot(play_sd_mm / distance_mm);
        let is_felt = parallel_n > 3.0 * noise_n && sd < 0.5 && node > 0;
        if is_felt {
            let felt = Felt { node, ln_n_per_m: (1e3 * parallel_n / distance_mm).ln(), sd };
            self.laws.iter_mut().for_each(|law| law.felt.push(felt));
        }
    }
}

fn guide_at(plane: usize, start_mm: [f64; 2], fraction: f64, target_mm: [f64; 2]) -> f64 {
    start_mm[plane] + fraction * (target_mm[plane] - start_mm[plane])
}
