//! The controller: everything the device decides, once per control period, without any hardware.
//!
//! [`Controller::step`] takes all inputs of one period (readings, at most one command) and returns all outputs (what the
//! bridges do, one sample, answers and events). The same call runs on the microcontroller, in the unit tests and against the
//! simulated rig. It does a bounded amount of work, allocates nothing and cannot fail: what goes wrong becomes a latched
//! fault with the bridges off, which holds the guide (a lead screw is not driven back by its load).
//!
//! | part | decides |
//! |---|---|
//! | [`commands`] | which commands are carried out, and that none is carried out twice |
//! | [`program`] | which step of the motion program runs, and when it is over |
//! | [`axis`] | the duty that brings one actuator to its setpoint |
//! | [`motor`] | how long a motor may be driven, and whether it moves when it is |
//! | [`force`], [`tare`] | force from converter codes: calibration, zero, stale and saturated readings |
//! | [`decimate`], [`stiffness`] | the lateral stiffness as the readings come |
//! | [`interlock`] | when to stop, and why: the table of hazards |
//! | [`store`] | a calibration on its way to the device |
//! | [`telemetry`] | batches and notes, and what is dropped where the link is slow |
//! | [`indicator`] | the status light |

// Nothing that a host or a sensor says can make it panic.
#![cfg_attr(
    not(test),
    deny(clippy::indexing_slicing, clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::todo)
)]

pub mod axis;
pub mod commands;
pub mod decimate;
pub mod force;
pub mod indicator;
pub mod interlock;
pub mod motor;
mod period;
pub mod profile;
mod program;
pub mod stiffness;
mod store;
pub mod tare;
pub mod telemetry;

use crate::calibration::Calibration;
use axis::Axis;
use commands::{Admission, Conversation};
use force::ForceChannel;
use indicator::Indicator;
use interlock::{Interlock, Limits, Observed};
use motor::{DriveWatch, DutyBudget};
pub use period::{Drive, Inputs, Note, Notes, Outputs};
use program::{Executor, Phase};
use protocol::{
    CalibrationRecord, Command, Counters, Event, EventKind, Fault, Outcome, Refusal, Request,
    SILENCE_LIMIT_MS, Sample, State, Status,
};
use stiffness::StiffnessFit;
use store::Incoming;

/// Control period, microseconds.
pub const PERIOD_US: u32 = 1_000;
/// Control period, seconds.
pub const PERIOD_S: f32 = PERIOD_US as f32 * 1e-6;
/// Periods between two unasked statuses.
pub const REPORT_PERIODS: u32 = 100_000 / PERIOD_US;
/// Step index outside a program.
pub const NO_STEP: u8 = u8::MAX;

/// The whole control law.
#[derive(Debug)]
pub struct Controller {
    calibration: Calibration,
    axes: [Axis; 2],
    watches: [DriveWatch; 2],
    budgets: [DutyBudget; 2],
    force: ForceChannel,
    stiffness: StiffnessFit,
    interlock: Interlock,
    executor: Executor,
    conversation: Conversation,
    indicator: Indicator,
    incoming: Incoming,
    heard_us: u64,
    control_overruns: u32,
    report_due: u32,
    streaming: bool,
}

/// A period that begins later than this is a late one, microseconds.
const LATE_US: u32 = PERIOD_US / 2;

impl Controller {
    /// A controller at rest, for the boot with this identity. `restarted`: the program before did not end as it should, which
    /// someone has to acknowledge before anything moves.
    pub fn new(calibration: Calibration, boot_id: u32, restarted: bool) -> Self {
        let mut interlock = Interlock::new(Limits::of(&calibration));
        if restarted {
            interlock.latch(Fault::Restarted);
        }
        Self {
            axes: [Axis::new(), Axis::new()],
            watches: [const { DriveWatch::new() }; 2],
            budgets: [const { DutyBudget::new() }; 2],
            force: ForceChannel::new(),
            stiffness: StiffnessFit::new(),
            interlock,
            executor: Executor::new(),
            conversation: Conversation::new(boot_id),
            indicator: Indicator::new(),
            incoming: Incoming::new(),
            heard_us: 0,
            control_overruns: 0,
            report_due: REPORT_PERIODS,
            streaming: false,
            calibration,
        }
    }

    /// One control period.
    pub fn step(&mut self, inputs: &Inputs) -> Outputs {
        let mut notes = Notes::new();
        let late = inputs.late_us > LATE_US;
        self.control_overruns = self.control_overruns.saturating_add(late.into());
        if inputs.command.is_some() {
            self.heard_us = inputs.now_us;
        }
        let (sample, cause) = self.sense(inputs, late);
        if let Some(fault) = cause.filter(|_| self.interlock.latched().is_none()) {
            self.trip(fault, inputs.now_us, &mut notes);
        }
        let mut store = None;
        if let Some(command) = &inputs.command {
            store = self.obey(command, inputs, sample, cause, &mut notes);
        }
        let drive = self.advance(inputs.now_us, &mut notes);
        self.watch(drive);

        self.report_due -= 1;
        if self.report_due == 0 {
            self.report_due = REPORT_PERIODS;
            if self.streaming {
                push(&mut notes, Note::Report(self.status(inputs, sample)));
            }
        }
        let state = self.state();
        Outputs {
            drive,
            led: self.indicator.step(state),
            state,
            step: self.executor.index().unwrap_or(NO_STEP),
            sample,
            notes,
            store,
        }
    }

    /// Takes the readings: the sample of this period, and the cause to stop, if there is one.
    fn sense(&mut self, inputs: &Inputs, late: bool) -> (Sample, Option<Fault>) {
        let rising = self.axes.each_ref().map(Axis::rising);
        let position_um = self.calibration.position_um(inputs.readings.potentiometer_codes, rising);
        let force_counts = self.force.update(&self.calibration, &inputs.readings.force_codes);
        let mut expected_um = position_um;
        for ((axis, position_um), expected_um) in self.axes.iter_mut().zip(position_um).zip(&mut expected_um)
        {
            *expected_um = axis.measure(position_um);
        }
        let observed = Observed {
            readings: &inputs.readings,
            position_um,
            expected_um,
            duty: self.axes.each_ref().map(Axis::last_duty),
            active: self.executor.phase() != Phase::Idle,
            silent_us: inputs.now_us.saturating_sub(self.heard_us),
            late,
            watches: &self.watches,
            budgets: &self.budgets,
        };
        let cause = self.interlock.check(&self.calibration, &self.force, &observed);
        let sample = Sample { position_counts: position_um.map(round), force_counts };
        if self.force.stale_periods() == 0 {
            self.stiffness.add(&sample);
        }
        (sample, cause)
    }

    /// Runs the program for one period and the axes after it.
    fn advance(&mut self, now_us: u64, notes: &mut Notes) -> Drive {
        if self.interlock.latched().is_some() {
            return Drive::Release;
        }
        let was_taring = self.executor.phase() == Phase::Taring;
        let settled = self.axes.iter().all(Axis::is_settled);
        let progress = self.executor.advance(now_us, settled, self.axes.each_ref().map(Axis::position_um));
        if progress.tare_finished {
            let tare = self.force.finish_tare(f64::from(1_000_000 / PERIOD_US));
            self.stiffness = StiffnessFit::new();
            push(notes, Note::Event(event(now_us, EventKind::Tared(tare))));
        }
        if let Some(index) = progress.ended {
            push(notes, Note::Event(event(now_us, EventKind::StepEnded { index })));
        }
        if let Some(index) = progress.started {
            push(notes, Note::Event(event(now_us, EventKind::StepStarted { index })));
        }
        if progress.completed {
            let kind = EventKind::ProgramEnded { outcome: Outcome::Completed };
            push(notes, Note::Event(event(now_us, kind)));
        }
        if progress.timed_out {
            self.trip(Fault::MoveTimeout, now_us, notes);
            return Drive::Release;
        }
        if self.executor.phase() == Phase::Taring {
            if !was_taring || progress.started.is_some() {
                self.force.begin_tare();
            }
            self.force.tare_on();
        }
        match self.executor.setpoint() {
            Some(setpoint) => {
                let [x, y] = &mut self.axes;
                let [sx, sy] = setpoint;
                Drive::Duty([x.duty(sx), y.duty(sy)])
            }
            None => {
                self.axes.iter_mut().for_each(Axis::rest);
                Drive::Release
            }
        }
    }

    /// Tells the motors' keepers what was done.
    fn watch(&mut self, drive: Drive) {
        let duty = match drive {
            Drive::Release => [0.0; 2],
            Drive::Duty(duty) => duty,
        };
        let [setpoint_x, setpoint_y] = match self.executor.setpoint() {
            Some([x, y]) => [Some(x), Some(y)],
            None => [None; 2],
        };
        let positions_um = self.axes.each_ref().map(Axis::position_um);
        let drives = duty.into_iter().zip(positions_um).zip([setpoint_x, setpoint_y]);
        let keepers = self.watches.iter_mut().zip(&mut self.budgets);
        for ((watch, budget), ((duty, position_um), setpoint)) in keepers.zip(drives) {
            watch.step(duty, position_um, setpoint);
            budget.step(duty != 0.0);
        }
    }

    /// Latches a fault, ends the program and says so.
    fn trip(&mut self, fault: Fault, now_us: u64, notes: &mut Notes) {
        self.interlock.latch(fault);
        push(notes, Note::Event(event(now_us, EventKind::Faulted { fault })));
        self.end_program(Outcome::Faulted, now_us, notes);
    }

    fn end_program(&mut self, outcome: Outcome, now_us: u64, notes: &mut Notes) {
        if self.executor.abort() {
            push(notes, Note::Event(event(now_us, EventKind::ProgramEnded { outcome })));
        }
        self.axes.iter_mut().for_each(Axis::rest);
    }

    fn obey(
        &mut self,
        command: &Command,
        inputs: &Inputs,
        sample: Sample,
        cause: Option<Fault>,
        notes: &mut Notes,
    ) -> Option<CalibrationRecord> {
        let mut store = None;
        let answer = match self.conversation.admit(command) {
            Admission::Repeat(answer) => answer,
            Admission::OtherBoot => Err(Refusal::OtherBoot),
            Admission::New => {
                let answer = match command.request {
                    Request::StoreCalibration { length, crc } => self
                        .while_idle()
                        .and_then(|()| self.incoming.finish(length, crc))
                        .map(|record| store = Some(record)),
                    request => self.execute(&request, inputs.now_us, cause, notes),
                };
                self.conversation.remember(command.id, answer);
                answer
            }
        };
        // Questions are answered afresh each time they arrive: the earlier answer may be what was lost.
        match command.request {
            Request::Hello => push(notes, Note::Hello),
            Request::Status if answer.is_ok() => push(notes, Note::Status(self.status(inputs, sample))),
            Request::Calibration if answer.is_ok() => push(notes, Note::Calibration),
            _ => {}
        }
        push(
            notes,
            match answer {
                Ok(()) => Note::Ack(command.id),
                Err(refusal) => Note::Refused(command.id, refusal),
            },
        );
        store
    }

    fn execute(
        &mut self,
        request: &Request,
        now_us: u64,
        cause: Option<Fault>,
        notes: &mut Notes,
    ) -> Result<(), Refusal> {
        match *request {
            Request::Hello | Request::Status | Request::Calibration => Ok(()),
            Request::Stream { enable } => {
                self.streaming = enable;
                push(notes, Note::Stream(enable));
                Ok(())
            }
            Request::LoadStep { index, step } => {
                self.executor.load(index, step, self.calibration.travel_um() as i32)
            }
            Request::Run { steps, crc, start_us } => match self.interlock.latched() {
                Some(fault) => Err(Refusal::Faulted { fault }),
                None => {
                    let position_um = self.axes.each_ref().map(Axis::position_um);
                    self.executor.run(steps, crc, start_us, now_us, position_um)
                }
            },
            Request::Stop => {
                self.end_program(Outcome::Stopped, now_us, notes);
                Ok(())
            }
            Request::ClearFault if cause.is_some() => Err(Refusal::CauseRemains),
            Request::ClearFault => {
                self.interlock.clear();
                Ok(())
            }
            Request::Limits { force_mn, silence_ms } => self.set_limits(Limits { force_mn, silence_ms }),
            Request::LoadCalibration { piece, bytes } => {
                self.while_idle()?;
                self.incoming.take(piece, bytes)
            }
            // Carried out where the record can be handed out.
            Request::StoreCalibration { .. } => Ok(()),
        }
    }

    fn while_idle(&self) -> Result<(), Refusal> {
        if self.executor.phase() == Phase::Idle { Ok(()) } else { Err(Refusal::Busy) }
    }

    fn set_limits(&mut self, limits: Limits) -> Result<(), Refusal> {
        self.while_idle()?;
        let [least, most] = SILENCE_LIMIT_MS;
        let force = 1..=self.calibration.force_range_mn();
        if !force.contains(&limits.force_mn) || !(least..=most).contains(&limits.silence_ms) {
            return Err(Refusal::OutOfRange);
        }
        self.interlock.set_limits(limits);
        Ok(())
    }

    fn state(&self) -> State {
        if self.interlock.latched().is_some() {
            return State::Faulted;
        }
        match self.executor.phase() {
            Phase::Idle => State::Idle,
            Phase::Pending => State::Pending,
            Phase::Moving => State::Moving,
            Phase::Holding => State::Holding,
            Phase::Taring => State::Taring,
        }
    }

    fn status(&self, inputs: &Inputs, sample: Sample) -> Status {
        let Limits { force_mn, silence_ms } = self.interlock.limits();
        let Counters {
            force_readings_bad, force_corrupt, force_missing, force_resets, force_saturated, ..
        } = *self.force.counters();
        Status {
            t_us: inputs.now_us,
            state: self.state(),
            step: self.executor.index().unwrap_or(NO_STEP),
            fault: self.interlock.latched(),
            position_counts: sample.position_counts,
            force_counts: sample.force_counts,
            streaming: self.streaming,
            counters: Counters {
                force_readings_bad,
                force_corrupt,
                force_missing,
                force_resets,
                force_saturated,
                control_overruns: self.control_overruns,
                faults: self.interlock.faults(),
                ..inputs.counters
            },
            load: inputs.load,
            motor_budget_permille: self.budgets.each_ref().map(|budget| (budget.used() * 1e3) as u16),
            force_limit_mn: force_mn,
            silence_limit_ms: silence_ms,
            stiffness: self.stiffness.result(),
        }
    }
}

fn event(t_us: u64, kind: EventKind) -> Event {
    Event { t_us, kind }
}

/// `Notes` holds the most that one period can say, so nothing is ever refused here; the longest period is covered by a test.
fn push(notes: &mut Notes, note: Note) {
    let pushed = notes.push(note);
    debug_assert!(pushed.is_ok(), "more notes in one period than there is room for");
}

/// Rounds to the nearest integer, halves away from zero, saturating; `f32::round` is not in `core`.
pub(crate) fn round(value: f32) -> i32 {
    (if value < 0.0 { value - 0.5 } else { value + 0.5 }) as i32
}

#[cfg(test)]
mod tests;
