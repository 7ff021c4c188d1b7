//! A single short pulse of one motor, which tests the wiring before any loop is closed.
//!
//! With swapped leads or a reversed potentiometer the position loop drives away from its target. A pulse needs no loop: one
//! motor gets a low duty for at most [`PULSE_LIMIT_MS`], and the response of both potentiometers and both force channels is
//! reported. Its bounds hold for any wiring error:
//!
//! | bound | ends the drive | holds if |
//! |---|---|---|
//! | [`REACHED_UM`] of the driven axis, either way | after 2 periods | its potentiometer works |
//! | [`OTHER_UM`] of the other axis | after 2 periods | motors or potentiometers are swapped |
//! | change of the force on either channel by [`PULSE_FORCE_MN`] | after 2 periods; less than 1 N on up to 8 N/mm | the converter works |
//! | duty [`PULSE_DUTY_LIMIT_PERMILLE`] for [`PULSE_LIMIT_MS`] | after that time; at most 0.29 mm of motion | the dead band is at least 0.12 and the no-load speed at most 22 mm/s |
//!
//! "After 2 periods" means at the second reading beyond the bound, as in [`super::interlock`], whose causes end a pulse too.
//! After the drive the bridges are off. Pulses do not add up: until an axis has moved in its driven direction, a pulse is refused
//! if the total drive in its direction could exceed that in the other direction by more than [`NET_LIMIT_PERIODS`]. The totals
//! survive restarts.

use super::axis::Axis;
use super::limits::{LatestTwo, WINDOW_READINGS};
use super::mutation::Mutation;
use super::{Controller, Drive, OutboundMessage, OutboundMessages, event, push};
use protocol::{
    EventKind, PULSE_BOUND_UM, PULSE_DUTY_LIMIT_PERMILLE, PULSE_FORCE_MN, PULSE_LIMIT_MS, PulseOutcome,
    PulseReport, Refusal, Sample,
};

/// Motion of the driven axis at which the drive ends, micrometres. The axis then coasts by the same distance at most.
pub const REACHED_UM: i32 = 100;
/// Motion of the other axis at which the drive ends, micrometres: many times the noise of one reading.
pub const OTHER_UM: i32 = 100;
/// Largest difference between the drives in the two directions, periods: the longest pulse.
pub const NET_LIMIT_PERIODS: i16 = PULSE_LIMIT_MS as i16;
/// Number of readings that are averaged before the pulse and at the end of the rest after it.
const AVERAGED: u16 = 20;
/// Rest after the drive until the last average is complete, periods. The motor has stopped after 60 periods.
const REST_PERIODS: u16 = 100;

/// A requested pulse.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pulse {
    /// 0: x, 1: y.
    pub axis: u8,
    /// Duty in thousandths.
    pub duty_permille: i16,
    /// Periods of drive.
    pub periods: u8,
}

/// Sums of readings.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    position: [i32; 2],
    force: [i64; 2],
    count: u16,
}

impl Sums {
    fn add(&mut self, sample: &Sample) {
        for (sum, value) in self.position.iter_mut().zip(sample.position_counts) {
            *sum = sum.saturating_add(value);
        }
        for (sum, value) in self.force.iter_mut().zip(sample.force_counts) {
            *sum = sum.saturating_add(value.into());
        }
        self.count = self.count.saturating_add(1);
    }

    fn means(&self) -> Sample {
        let count = self.count.max(1);
        Sample {
            position_counts: self.position.map(|sum| sum / i32::from(count)),
            force_counts: self.force.map(|sum| (sum / i64::from(count)) as i32),
            repeats_force: false,
        }
    }
}

#[derive(Debug, Clone, Copy)]
enum Phase {
    Before,
    Driving,
    Resting(PulseOutcome),
}

#[derive(Debug, Clone, Copy)]
struct Running {
    pulse: Pulse,
    phase: Phase,
    /// Periods in the phase.
    periods: u16,
    before: Sums,
    /// Means before the drive.
    from: Sample,
    /// Largest change of each channel since then.
    most: Sample,
    after: Sums,
    beyond: [LatestTwo; 3],
    driven_periods: u8,
}

/// Runs pulses, one at a time.
#[derive(Debug)]
pub struct Pulser {
    running: Option<Running>,
    net: NetDrive,
}

/// Periods in which x and y were driven up, less those in which they were driven down, since power-on. A running pulse counts
/// with its full duration, so that a restart during a pulse loses nothing; a finished one counts with its actual duration.
pub type NetDrive = [i16; 2];

/// Result of a period of a pulse.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PulseProgress {
    /// Bridges off.
    Off,
    /// Duties of both axes.
    Drive([f32; 2]),
    /// The pulse has ended.
    Ended(PulseReport),
}

impl Pulser {
    /// No pulse under way, after these net drives.
    pub const fn new(net: NetDrive) -> Self {
        Self { running: None, net }
    }

    /// State that is retained over a restart.
    pub const fn net(&self) -> NetDrive {
        self.net
    }

    /// Whether a pulse is under way.
    pub fn is_active(&self) -> bool {
        self.running.is_some()
    }

    /// Begins a pulse. `position_um` and `travel_um` rely on the calibration, which may be wrong; `proven` axes have moved in
    /// their driven direction.
    ///
    /// # Errors
    /// [`Refusal::Busy`], [`Refusal::OutOfRange`] for a pulse beyond the limits, [`Refusal::OutOfTravel`] for one that may leave the
    /// travel, or whose direction has no drive left.
    pub fn begin(
        &mut self,
        pulse: Pulse,
        position_um: [f32; 2],
        travel_um: f32,
        proven: [bool; 2],
    ) -> Result<(), Refusal> {
        if self.running.is_some() {
            return Err(Refusal::Busy);
        }
        let axis = usize::from(pulse.axis);
        let (Some(position_um), Some(proven)) = (position_um.get(axis), proven.get(axis)) else {
            return Err(Refusal::OutOfRange);
        };
        let bounded = pulse.duty_permille.unsigned_abs() <= PULSE_DUTY_LIMIT_PERMILLE
            && pulse.periods <= PULSE_LIMIT_MS
            || Mutation::AnyPulse.is_out();
        if pulse.duty_permille == 0 || pulse.periods == 0 || !bounded {
            return Err(Refusal::OutOfRange);
        }
        let sign = pulse.duty_permille.signum();
        let Some(net) = self.net.get_mut(axis) else { return Err(Refusal::OutOfRange) };
        let net_after = net.saturating_add(sign.saturating_mul(pulse.periods.into()));
        let used_up = !proven && net_after.saturating_mul(sign) > NET_LIMIT_PERIODS;
        let ends_um = position_um + f32::from(sign) * PULSE_BOUND_UM as f32;
        let leaves = ends_um * f32::from(sign) > travel_um;
        if (used_up || leaves) && !Mutation::AnyPulse.is_out() {
            return Err(Refusal::OutOfTravel);
        }
        *net = net_after;
        self.running = Some(Running {
            pulse,
            phase: Phase::Before,
            periods: 0,
            before: Sums::default(),
            from: Sample::default(),
            most: Sample::default(),
            after: Sums::default(),
            beyond: [LatestTwo::default(); 3],
            driven_periods: 0,
        });
        Ok(())
    }

    /// Duties of the period before.
    pub fn last_duty(&self) -> [f32; 2] {
        match &self.running {
            Some(running) if matches!(running.phase, Phase::Driving) => running.duty(),
            _ => [0.0; 2],
        }
    }

    /// Advances the pulse by a period with this sample; `None` where no pulse is under way.
    pub fn step(&mut self, sample: &Sample) -> Option<PulseProgress> {
        let running = self.running.as_mut()?;
        let progress = running.step(sample);
        if let PulseProgress::Ended(report) = progress {
            self.account(&report);
        }
        Some(progress)
    }

    /// Ends the pulse at once, after a stop or a fault.
    pub fn abort(&mut self) -> Option<PulseReport> {
        let report = self.running.as_ref()?.report(PulseOutcome::Stopped);
        self.account(&report);
        Some(report)
    }

    /// Subtracts the unused duration of the pulse that has ended from the net drive.
    fn account(&mut self, report: &PulseReport) {
        let unused_periods = self.running.take().map_or(0, |running| {
            let Pulse { duty_permille, periods, .. } = running.pulse;
            duty_permille.signum().saturating_mul(periods.saturating_sub(report.driven_ms).into())
        });
        if let Some(net) = self.net.get_mut(usize::from(report.axis)) {
            *net = net.saturating_sub(unused_periods);
        }
    }
}

impl Controller {
    /// Advances the pulse by a period; `None` where no pulse is under way.
    pub(super) fn pulse(
        &mut self,
        sample: &Sample,
        now_us: u64,
        notes: &mut OutboundMessages,
    ) -> Option<Drive> {
        Some(match self.pulser.step(sample)? {
            PulseProgress::Off => Drive::Release,
            PulseProgress::Drive(duty) => Drive::Duty(duty),
            PulseProgress::Ended(report) => {
                push(notes, OutboundMessage::Event(event(now_us, EventKind::PulseEnded(report))));
                Drive::Release
            }
        })
    }

    /// Duty of both axes in the period before.
    pub(super) fn last_duty(&self) -> [f32; 2] {
        if self.pulser.is_active() {
            self.pulser.last_duty()
        } else {
            self.axes.each_ref().map(Axis::last_duty)
        }
    }
}

impl Running {
    fn duty(&self) -> [f32; 2] {
        let duty = f32::from(self.pulse.duty_permille) * 1e-3;
        if self.pulse.axis == 0 { [duty, 0.0] } else { [0.0, duty] }
    }

    fn step(&mut self, sample: &Sample) -> PulseProgress {
        match self.phase {
            Phase::Before => {
                self.before.add(sample);
                if self.before.count < AVERAGED {
                    return PulseProgress::Off;
                }
                self.from = self.before.means();
                self.phase = Phase::Driving;
                self.driven_periods = 1;
                PulseProgress::Drive(self.duty())
            }
            Phase::Driving => {
                self.follow(sample);
                let outcome = self
                    .bound(sample)
                    .or((self.driven_periods >= self.pulse.periods).then_some(PulseOutcome::Completed));
                match outcome {
                    Some(outcome) => {
                        self.phase = Phase::Resting(outcome);
                        PulseProgress::Off
                    }
                    None => {
                        self.driven_periods = self.driven_periods.saturating_add(1);
                        PulseProgress::Drive(self.duty())
                    }
                }
            }
            Phase::Resting(outcome) => {
                self.follow(sample);
                self.periods = self.periods.saturating_add(1);
                if self.periods > REST_PERIODS - AVERAGED {
                    self.after.add(sample);
                }
                if self.periods < REST_PERIODS {
                    PulseProgress::Off
                } else {
                    PulseProgress::Ended(self.report(outcome))
                }
            }
        }
    }

    /// Keeps the largest change of each channel.
    fn follow(&mut self, sample: &Sample) {
        let readings = sample.position_counts.iter().chain(&sample.force_counts);
        let start_counts = self.from.position_counts.iter().chain(&self.from.force_counts);
        let most = self.most.position_counts.iter_mut().chain(&mut self.most.force_counts);
        for ((most, reading), start_counts) in most.zip(readings).zip(start_counts) {
            let moved = reading.saturating_sub(*start_counts);
            if moved.unsigned_abs() > most.unsigned_abs() {
                *most = moved;
            }
        }
    }

    /// The reason to end the drive, if this sample is the second one beyond a bound.
    fn bound(&mut self, sample: &Sample) -> Option<PulseOutcome> {
        let moved = |axis: usize| {
            let position_count = sample.position_counts.get(axis).copied().unwrap_or(0);
            position_count
                .saturating_sub(self.from.position_counts.get(axis).copied().unwrap_or(0))
                .unsigned_abs()
        };
        let axis = usize::from(self.pulse.axis);
        let force = sample.force_counts.iter().zip(self.from.force_counts).any(|(force, from)| {
            let limit = crate::calibration::counts_of_mn(PULSE_FORCE_MN);
            force.saturating_sub(from).unsigned_abs() > limit.unsigned_abs()
        });
        let exceeded = [
            (force, PulseOutcome::Force),
            (moved(1 - axis.min(1)) > OTHER_UM.unsigned_abs(), PulseOutcome::OtherAxis),
            (moved(axis) > REACHED_UM.unsigned_abs(), PulseOutcome::Reached),
        ];
        let mut first = None;
        for (evidence, (beyond, outcome)) in self.beyond.iter_mut().zip(exceeded) {
            if evidence.note(beyond, WINDOW_READINGS) && first.is_none() {
                first = Some(outcome);
            }
        }
        first.filter(|_| !Mutation::AnyPulse.is_out())
    }

    fn report(&self, outcome: PulseOutcome) -> PulseReport {
        let final_means = if self.after.count > 0 { self.after.means() } else { self.from };
        let difference = |final_means: [i32; 2], from: [i32; 2]| {
            let ([x, y], [from_x, from_y]) = (final_means, from);
            [x.saturating_sub(from_x), y.saturating_sub(from_y)]
        };
        PulseReport {
            axis: self.pulse.axis,
            outcome,
            driven_ms: self.driven_periods,
            moved_counts: difference(final_means.position_counts, self.from.position_counts),
            most_moved_counts: self.most.position_counts,
            force_counts: difference(final_means.force_counts, self.from.force_counts),
            most_force_counts: self.most.force_counts,
        }
    }
}

#[cfg(test)]
mod tests;
