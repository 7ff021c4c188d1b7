//! Motion programs: a list of steps that the device runs by itself, so that timing does not depend on the host or the link.
//!
//! A move's setpoint travels in a straight line, both axes arriving together ([`Profile`]); the step ends when both axes have
//! settled. Each later move starts from the previous target, not from the noisy position.

use super::PERIOD_US;
use super::axis::Setpoint;
use super::mutation::Mutation;
use super::profile::{ACCELERATION_UM_S2, Profile};
use protocol::{
    DURATION_LIMIT_MS, MAX_STEPS, Refusal, SPEED_LIMIT_UM_S, START_LIMIT_US, Step, TARE_LIMIT_MS,
};

/// Speed of a retreat, micrometres per second: 25 um in the duration of one mean of the force.
const RETREAT_SPEED_UM_S: f32 = 250.0;
/// Time that a move may take to settle, beyond 1.5 times the duration of its path, microseconds.
const SETTLE_LIMIT_US: u64 = 3_000_000;
/// Distance by which an axis overshoots a setpoint that stops abruptly, per unit of its speed, seconds: the lags of motor,
/// filter and loop.
const RUN_ON_S: f32 = 0.03;

/// Activity of the executor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// Idle.
    Idle,
    /// Waiting for the start time.
    Pending,
    /// Running a move or a ramp.
    Moving,
    /// Running a hold.
    Holding,
    /// Running a tare.
    Taring,
    /// Unloading the guide.
    Retreating,
}

/// Result of one period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ProgramProgress {
    /// This step ended.
    pub ended: Option<u8>,
    /// This step started.
    pub started: Option<u8>,
    /// The step that ended was a tare.
    pub tare_finished: bool,
    /// The last step ended.
    pub completed: bool,
    /// The step or the retreat has not settled in time.
    pub timed_out: bool,
    /// The retreat has arrived at its end.
    pub retreated: bool,
}

/// Whether a duration or a speed is positive and within its limit.
fn check_range(value: u32, limit: u32) -> Result<(), Refusal> {
    if (1..=limit).contains(&value) { Ok(()) } else { Err(Refusal::OutOfRange) }
}

/// A straight line between two positions.
#[derive(Debug, Clone, Copy)]
struct Path {
    from_um: [f32; 2],
    to_um: [f32; 2],
    length_um: f32,
}

impl Path {
    fn new(from_um: [f32; 2], to_um: [f32; 2]) -> Self {
        let ([from_x, from_y], [to_x, to_y]) = (from_um, to_um);
        Self { from_um, to_um, length_um: libm::hypotf(to_x - from_x, to_y - from_y) }
    }

    /// Setpoints at this covered fraction of the path and this speed, micrometres per second.
    fn at(&self, fraction: f32, speed_um_s: f32) -> [Setpoint; 2] {
        let mut setpoints = [Setpoint { position_um: 0.0, speed_um_s: 0.0 }; 2];
        for ((setpoint, from_um), to_um) in setpoints.iter_mut().zip(self.from_um).zip(self.to_um) {
            let direction = if self.length_um > 0.0 { (to_um - from_um) / self.length_um } else { 0.0 };
            *setpoint = Setpoint {
                position_um: from_um + fraction * (to_um - from_um),
                speed_um_s: speed_um_s * direction,
            };
        }
        setpoints
    }
}

#[derive(Debug, Clone, Copy)]
enum Activity {
    Idle,
    Pending {
        start_us: u64,
    },
    Running {
        index: u8,
        step: Step,
        since_us: u64,
    },
    /// Retreating along a path or, while there is none, waiting until the axes are at rest.
    Retreating {
        since_us: u64,
    },
}

/// Holds the loaded program and runs it.
#[derive(Debug)]
pub struct Executor {
    steps: [Step; MAX_STEPS],
    count: u8,
    travel_um: f32,
    activity: Activity,
    path: Option<Path>,
    setpoint: Option<[Setpoint; 2]>,
}

impl Executor {
    /// No program.
    pub fn new() -> Self {
        Self {
            steps: [Step::Hold { duration_ms: 0 }; MAX_STEPS],
            count: 0,
            travel_um: 0.0,
            activity: Activity::Idle,
            path: None,
            setpoint: None,
        }
    }

    /// Stores one step.
    ///
    /// # Errors
    /// [`Refusal::Busy`] while a program waits or runs; [`Refusal::OutOfTravel`], [`Refusal::OutOfRange`] for a step that could
    /// not be run.
    pub fn load(&mut self, index: u8, step: Step, travel_um: i32) -> Result<(), Refusal> {
        if !matches!(self.activity, Activity::Idle) {
            return Err(Refusal::Busy);
        }
        self.travel_um = travel_um as f32;
        let travel = -travel_um..=travel_um;
        let reachable = |x_um, y_um| match travel.contains(&x_um) && travel.contains(&y_um) {
            true => Ok(()),
            false => Err(Refusal::OutOfTravel),
        };
        match step {
            Step::Move { x_um, y_um, speed_um_s } => {
                reachable(x_um, y_um)?;
                check_range(speed_um_s, SPEED_LIMIT_UM_S)?;
            }
            Step::Hold { duration_ms } => check_range(duration_ms, DURATION_LIMIT_MS)?,
            Step::Tare { duration_ms } => check_range(duration_ms, TARE_LIMIT_MS)?,
            Step::Ramp { x_um, y_um, duration_ms } => {
                reachable(x_um, y_um)?;
                check_range(duration_ms, DURATION_LIMIT_MS)?;
            }
        }
        *self.steps.get_mut(usize::from(index)).ok_or(Refusal::OutOfRange)? = step;
        Ok(())
    }

    /// Starts the first `count` loaded steps at `start_us` (0: now), from this position.
    ///
    /// # Errors
    /// [`Refusal::Busy`], [`Refusal::OutOfRange`] (no steps or too many, a ramp that is too fast, a start too far ahead),
    /// [`Refusal::ProgramMismatch`], [`Refusal::TooLate`].
    pub fn run(
        &mut self,
        count: u8,
        crc: u32,
        start_us: u64,
        now_us: u64,
        position_um: [f32; 2],
    ) -> Result<(), Refusal> {
        if !matches!(self.activity, Activity::Idle) {
            return Err(Refusal::Busy);
        }
        let steps = self.steps.get(..usize::from(count)).filter(|steps| !steps.is_empty());
        let steps = steps.ok_or(Refusal::OutOfRange)?;
        if protocol::program_crc(steps) != crc {
            return Err(Refusal::ProgramMismatch);
        }
        if start_us != 0 && start_us <= now_us {
            return Err(Refusal::TooLate);
        }
        if start_us > now_us.saturating_add(START_LIMIT_US) && !Mutation::AnyStart.is_out() {
            return Err(Refusal::OutOfRange);
        }
        let [mut from_x, mut from_y] = position_um;
        for step in steps {
            let (Step::Move { x_um, y_um, .. } | Step::Ramp { x_um, y_um, .. }) = *step else { continue };
            let (to_x, to_y) = (x_um as f32, y_um as f32);
            if let Step::Ramp { duration_ms, .. } = *step {
                // Squares are compared to save the roots, as all steps are checked in one period.
                let (dx, dy, reach_um) =
                    (to_x - from_x, to_y - from_y, SPEED_LIMIT_UM_S as f32 * duration_ms as f32 * 1e-3);
                if dx * dx + dy * dy > reach_um * reach_um {
                    return Err(Refusal::OutOfRange);
                }
            }
            (from_x, from_y) = (to_x, to_y);
        }
        self.count = count;
        self.activity = Activity::Pending { start_us };
        Ok(())
    }

    /// Begins a retreat, which waits until the axes are at rest; until it ends no other motion may start.
    pub fn await_rest(&mut self, now_us: u64) {
        self.activity = Activity::Retreating { since_us: now_us };
    }

    /// Time for which a retreat has waited for the axes to come to rest, microseconds.
    pub fn awaits_rest_us(&self, now_us: u64) -> Option<u64> {
        match self.activity {
            Activity::Retreating { since_us } if self.path.is_none() => Some(now_us.saturating_sub(since_us)),
            _ => None,
        }
    }

    /// Starts the motion of a retreat, in a straight line between two positions.
    pub fn retreat(&mut self, from_um: [f32; 2], to_um: [f32; 2], now_us: u64) {
        let path = Path::new(from_um, to_um);
        self.path = Some(path);
        self.setpoint = Some(path.at(0.0, 0.0));
        self.activity = Activity::Retreating { since_us: now_us };
    }

    /// Ends a waiting or running program. Returns whether there was one.
    pub fn abort(&mut self) -> bool {
        let active = !matches!(self.activity, Activity::Idle);
        self.activity = Activity::Idle;
        self.path = None;
        self.setpoint = None;
        active
    }

    /// Index of the step that runs.
    pub fn index(&self) -> Option<u8> {
        match self.activity {
            Activity::Running { index, .. } => Some(index),
            _ => None,
        }
    }

    /// Activity of the executor.
    pub fn phase(&self) -> Phase {
        match self.activity {
            Activity::Idle => Phase::Idle,
            Activity::Pending { .. } => Phase::Pending,
            Activity::Retreating { .. } => Phase::Retreating,
            Activity::Running { step: Step::Move { .. } | Step::Ramp { .. }, .. } => Phase::Moving,
            Activity::Running { step: Step::Hold { .. }, .. } => Phase::Holding,
            Activity::Running { step: Step::Tare { .. }, .. } => Phase::Taring,
        }
    }

    /// Target positions of the axes; `None` while no axis has to be driven.
    pub fn setpoint(&self) -> Option<[Setpoint; 2]> {
        self.setpoint
    }

    /// Advances by one period. `settled`: both axes rest at their setpoints.
    pub fn advance(&mut self, now_us: u64, settled: bool, position_um: [f32; 2]) -> ProgramProgress {
        let mut progress = ProgramProgress::default();
        match self.activity {
            Activity::Idle => {}
            Activity::Pending { start_us } if now_us >= start_us => {
                self.begin(0, now_us, position_um);
                progress.started = Some(0);
            }
            Activity::Pending { .. } => {}
            Activity::Running { index, step, since_us } => {
                let elapsed_us = now_us.saturating_sub(since_us);
                let is_done = match step {
                    Step::Move { speed_um_s, .. } => {
                        self.follow(elapsed_us, speed_um_s as f32, settled, &mut progress)
                    }
                    Step::Ramp { duration_ms, .. } => {
                        let last = index + 1 == self.count && !Mutation::RampEndsAtOnce.is_out();
                        self.ramp(elapsed_us, duration_ms, last, settled, &mut progress)
                    }
                    Step::Hold { duration_ms } | Step::Tare { duration_ms } => {
                        elapsed_us >= u64::from(duration_ms) * 1_000
                    }
                };
                if is_done {
                    self.finish(index, step, now_us, position_um, &mut progress);
                }
            }
            Activity::Retreating { since_us } => {
                let elapsed_us = now_us.saturating_sub(since_us);
                progress.retreated = self.follow(elapsed_us, RETREAT_SPEED_UM_S, settled, &mut progress);
            }
        }
        progress
    }

    /// Moves the setpoint along the path at constant speed; true when the step is done. In the last step, and in a step at whose
    /// end an axis would coast beyond its travel, the setpoint decelerates and the axes settle before the step is done.
    fn ramp(
        &mut self,
        elapsed_us: u64,
        duration_ms: u32,
        last: bool,
        settled: bool,
        progress: &mut ProgramProgress,
    ) -> bool {
        let Some(path) = self.path else { return true };
        let duration_us = u64::from(duration_ms) * 1_000;
        let (elapsed_s, duration_s) = (elapsed_us as f32 * 1e-6, duration_us as f32 * 1e-6);
        let speed_um_s = path.length_um / duration_s;
        let leaves_travel = !Mutation::RampEndsAtOnce.is_out()
            && path.at(1.0, speed_um_s).into_iter().any(|end| {
                end.position_um * end.speed_um_s > 0.0
                    && end.position_um.abs() + RUN_ON_S * end.speed_um_s.abs() > self.travel_um
            });
        // The deceleration is centred on the end of the step's time.
        let early_s = if last || leaves_travel { 0.5 * speed_um_s / ACCELERATION_UM_S2 } else { 0.0 };
        let (path_fraction, speed_um_s, remaining_s) = if early_s > 0.0 && early_s >= duration_s {
            // The deceleration would begin before the step: the setpoint follows the profile of a move.
            let profile = Profile::new(path.length_um, speed_um_s);
            let (profile_fraction, speed_um_s) = profile.at(elapsed_s);
            (profile_fraction, speed_um_s, profile.duration_s() - elapsed_s)
        } else {
            let remaining_s = duration_s + early_s - elapsed_s;
            if remaining_s <= 0.0 {
                (1.0, 0.0, remaining_s)
            } else if remaining_s < 2.0 * early_s {
                let path_fraction =
                    1.0 - 0.5 * ACCELERATION_UM_S2 * remaining_s * remaining_s / path.length_um;
                (path_fraction, ACCELERATION_UM_S2 * remaining_s, remaining_s)
            } else {
                (elapsed_us as f32 / duration_us as f32, speed_um_s, remaining_s)
            }
        };
        self.setpoint = Some(path.at(path_fraction, speed_um_s));
        let arrived = remaining_s <= 0.0;
        let settles = last || leaves_travel;
        progress.timed_out = settles && -remaining_s > SETTLE_LIMIT_US as f32 * 1e-6;
        arrived && (!settles || (settled && elapsed_us >= 2 * u64::from(PERIOD_US)))
    }

    /// Moves the setpoint along the path; true when the axes have settled at its end.
    fn follow(
        &mut self,
        elapsed_us: u64,
        speed_um_s: f32,
        settled: bool,
        progress: &mut ProgramProgress,
    ) -> bool {
        let Some(path) = self.path else { return true };
        let profile = Profile::new(path.length_um, speed_um_s);
        let (path_fraction, speed_um_s) = profile.at(elapsed_us as f32 * 1e-6);
        let duration_us = profile.duration_s() * 1e6;
        self.setpoint = Some(path.at(path_fraction, speed_um_s));
        let arrived = elapsed_us as f32 >= duration_us;
        progress.timed_out = elapsed_us > (1.5 * duration_us) as u64 + SETTLE_LIMIT_US;
        // `settled` is that of the period before, so that a path of no length must not count as settled at once.
        arrived && settled && elapsed_us >= 2 * u64::from(PERIOD_US)
    }

    fn finish(
        &mut self,
        index: u8,
        step: Step,
        now_us: u64,
        position_um: [f32; 2],
        progress: &mut ProgramProgress,
    ) {
        progress.ended = Some(index);
        progress.tare_finished = matches!(step, Step::Tare { .. });
        let next = index + 1;
        if next < self.count {
            self.begin(next, now_us, position_um);
            progress.started = Some(next);
        } else {
            self.abort();
            progress.completed = true;
        }
    }

    fn begin(&mut self, index: u8, now_us: u64, position_um: [f32; 2]) {
        let step = self.steps.get(usize::from(index)).copied().unwrap_or(Step::Hold { duration_ms: 0 });
        if let Step::Move { x_um, y_um, .. } | Step::Ramp { x_um, y_um, .. } = step {
            let start_um = self.setpoint.map_or(position_um, |axes| axes.map(|axis| axis.position_um));
            let path = Path::new(start_um, [x_um as f32, y_um as f32]);
            self.path = Some(path);
            // The first setpoint is the start position at zero speed; the path begins with the next period.
            self.setpoint = Some(path.at(0.0, 0.0));
        }
        self.activity = Activity::Running { index, step, since_us: now_us };
    }
}

#[cfg(test)]
#[path = "program_tests.rs"]
mod tests;
