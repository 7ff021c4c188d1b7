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
//! | [`decimate`], [`stiffness`] | the lateral stiffness, estimated online |
//! | [`interlock`] | when to stop, and why: the table of hazards |
//! | [`limits`] | how much evidence a fault takes |
//! | [`pulse`] | a short pulse of one motor without a loop, and what ends it |
//! | [`retreat`] | motions that unload the guide while a fault is latched |
//! | [`retained`] | state that is retained over a restart |
//! | [`store`] | a calibration while it is received |
//! | [`telemetry`] | batches, answers and events, and what is dropped where the link is slow |
//! | [`indicator`] | the status light |
//! | [`ads131m02`], [`calibration`], [`slots`] | the force converter; the constants of a rig, and where they are kept |
//! | [`starts`] | the number of this start, kept without power |
//!
//! # Example
//!
//! The line of the emergency stop opens: in the same period both bridges are off and the fault is latched:
//!
//! ```
//! use control::{Controller, Drive, Inputs, PERIOD_US, Start, calibration::Calibration, hal::Readings};
//! use protocol::{Counters, Load, State};
//!
//! let mut controller = Controller::new(Calibration::default(), Start::ordinary(1));
//! let mut period = |number: u32, emergency_stop: bool| {
//!     let readings =
//!         Readings { potentiometer_codes: [2048; 2], force_codes: Ok([number as i32, 0]), emergency_stop };
//!     let now_us = u64::from(number * PERIOD_US);
//!     let (counters, load) = (Counters::default(), Load::default());
//!     controller.step(&Inputs { now_us, late_us: 0, readings, command: None, counters, load })
//! };
//! assert_eq!(period(1, false).state, State::Idle);
//! let stopped = period(2, true);
//! assert_eq!((stopped.state, stopped.drive), (State::Faulted, Drive::Release));
//! assert_eq!(period(3, false).state, State::Faulted);
//! ```

#![cfg_attr(target_os = "none", no_std)]
#![forbid(unsafe_code)]
#![deny(missing_docs)]
// No input from a host or a sensor can cause a panic.
#![cfg_attr(
    not(test),
    deny(clippy::indexing_slicing, clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::todo)
)]

pub mod ads131m02;
pub mod axis;
pub mod calibration;
pub mod commands;
pub mod decimate;
pub mod force;
pub mod hal;
pub mod indicator;
pub mod interlock;
pub mod limits;
pub mod motor;
pub mod mutation;
mod period;
pub mod profile;
mod program;
pub mod pulse;
mod report;
mod requests;
pub mod retained;
pub mod retreat;
pub mod slots;
mod start;
pub mod starts;
pub mod stiffness;
mod store;
pub mod tare;
pub mod telemetry;

use crate::calibration::Calibration;
use axis::Axis;
use commands::CommandSession;
use force::ForceChannel;
use indicator::Indicator;
use interlock::{Interlock, Limits, Observed, StopCauses};
use motor::{DriveWatch, DutyBudget};
use mutation::Mutation;
pub use period::{Drive, Inputs, OutboundMessage, OutboundMessages, Outputs};
use program::{Executor, Phase};
use protocol::{CalibrationSource, Event, EventKind, Fault, Outcome, RetreatOutcome, Sample};
use pulse::{NetDrive, Pulser};
use report::SAFETY_REPORTS;
use retained::ControllerState;
use retreat::{LoadMeter, LoadWatch};
pub use start::{DESCRIPTION, Origin, Start};
use stiffness::StiffnessFit;
use store::Incoming;

/// Control period, microseconds.
pub const PERIOD_US: u32 = 1_000;
/// Control period, seconds.
pub const PERIOD_S: f32 = PERIOD_US as f32 * 1e-6;
/// Periods between two unsolicited statuses.
pub const REPORT_PERIODS: u32 = 100_000 / PERIOD_US;
/// Step index outside a program.
pub const NO_STEP: u8 = u8::MAX;

/// The controller with all of its state.
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
    pulser: Pulser,
    conversation: CommandSession,
    indicator: Indicator,
    incoming: Incoming,
    /// Time of the last accepted command of the connection that started the motion.
    last_command_us: u64,
    /// Token of the connection that started the motion.
    mover: u32,
    control_overruns: u32,
    report_due: u32,
    safety_due: u32,
    streaming: bool,
    source: CalibrationSource,
    /// The calibration was lost, and the host has not acknowledged that.
    calibration_lost: bool,
    load_meter: LoadMeter,
    load_watch: LoadWatch,
    /// Displacement of the latest retreat, micrometres.
    retreat_by_um: [i32; 2],
    /// A calibration was accepted: the device is about to restart.
    restarting: bool,
    /// Last reported safety state.
    reported: Option<ReportedSafety>,
    /// Latched fault and net drive of the pulses in the previous period.
    kept: (Option<Fault>, NetDrive),
}

/// Safety state that is reported at once when it changes: source of the calibration, tared or not, zero of the force.
type ReportedSafety = (CalibrationSource, bool, [i32; 2]);

/// Delay of a period's start beyond which the period counts as late, microseconds.
const LATE_US: u32 = PERIOD_US / 2;

impl Controller {
    /// A controller at rest.
    pub fn new(calibration: Calibration, start: Start) -> Self {
        let mut interlock = Interlock::new(Limits::of(&calibration));
        let Start { boot_id, restarted, origin, retained } = start;
        let ControllerState { fault, budgets, pulsed } =
            retained.filter(|_| !Mutation::ForgetAtRestart.is_out()).unwrap_or_default();
        // A fault latched before the restart comes first; the hello reports the restart itself.
        let lost = matches!(origin, Origin::Lost | Origin::Earlier);
        // The origin at this start decides whether the calibration is lost, not the retained fault.
        let fault = fault.filter(|fault| *fault != Fault::CalibrationLost);
        let restarted = restarted.then_some(Fault::Restarted);
        let lost_now = lost.then_some(Fault::CalibrationLost);
        if let Some(fault) = fault.or(restarted).or(lost_now) {
            interlock.latch(fault);
        }
        Self {
            axes: [Axis::new(), Axis::new()],
            watches: [const { DriveWatch::new() }; 2],
            budgets,
            force: ForceChannel::new(),
            stiffness: StiffnessFit::new(),
            interlock,
            executor: Executor::new(),
            pulser: Pulser::new(pulsed),
            conversation: CommandSession::new(boot_id),
            indicator: Indicator::new(),
            incoming: Incoming::new(),
            last_command_us: 0,
            mover: 0,
            control_overruns: 0,
            report_due: REPORT_PERIODS,
            safety_due: SAFETY_REPORTS,
            streaming: false,
            source: match origin {
                Origin::Stored | Origin::Earlier => CalibrationSource::Stored,
                Origin::Nominal | Origin::Lost => CalibrationSource::Nominal,
            },
            calibration_lost: lost,
            load_meter: LoadMeter::default(),
            load_watch: LoadWatch::new(),
            retreat_by_um: [0; 2],
            restarting: false,
            reported: None,
            kept: (None, pulsed),
            calibration,
        }
    }

    /// State that must outlive a restart.
    pub fn retained_state(&self) -> ControllerState {
        ControllerState {
            fault: self.interlock.latched(),
            budgets: self.budgets.clone(),
            pulsed: self.pulser.net(),
        }
    }

    /// One control period.
    pub fn step(&mut self, inputs: &Inputs) -> Outputs {
        let mut notes = OutboundMessages::new();
        let late = inputs.late_us > LATE_US;
        self.control_overruns = self.control_overruns.saturating_add(late.into());
        let (sample, causes) = self.sense(inputs, late);
        if let Some(fault) = causes.first().filter(|_| self.interlock.latched().is_none()) {
            self.trip(fault, inputs.now_us, &mut notes);
        }
        self.follow_load(causes, inputs.now_us, &mut notes);
        let mut store = None;
        if let Some(command) = &inputs.command {
            store = self.handle_command(command, inputs, causes, &mut notes);
        }
        let drive = match self.pulse(&sample, inputs.now_us, &mut notes) {
            Some(drive) => drive,
            None => self.advance(inputs.now_us, &mut notes),
        };
        self.watch(drive);

        self.report_due -= 1;
        if self.report_due == 0 {
            self.report_due = REPORT_PERIODS;
            if self.streaming {
                push(&mut notes, OutboundMessage::Report(self.status(inputs)));
            }
            self.safety_due = self.safety_due.saturating_sub(1);
        }
        self.report_safety(inputs.now_us, &mut notes);
        let latched = self.interlock.latched();
        let keep =
            self.report_due == REPORT_PERIODS || (latched, self.pulser.net()) != self.kept || store.is_some();
        self.kept = (latched, self.pulser.net());
        let state = self.state();
        Outputs {
            drive,
            led: self.indicator.step(state),
            state,
            step: self.executor.index().unwrap_or(NO_STEP),
            sample,
            notes,
            keep,
            store,
        }
    }

    /// Processes the readings into the sample of this period and the causes to stop.
    fn sense(&mut self, inputs: &Inputs, late: bool) -> (Sample, StopCauses) {
        let rising = self.axes.each_ref().map(Axis::rising);
        let position_um = self.calibration.position_um(inputs.readings.potentiometer_codes, rising);
        let force_counts = self.force.update(&self.calibration, &inputs.readings.force_codes);
        let on_track = self.calibration.on_track(inputs.readings.potentiometer_codes);
        let mut expected_um = position_um;
        let axes = self.axes.iter_mut().zip(position_um).zip(on_track);
        for (((axis, position_um), on_track), expected_um) in axes.zip(&mut expected_um) {
            *expected_um = axis.measure(position_um, on_track);
        }
        let observed = Observed {
            readings: &inputs.readings,
            position_um,
            expected_um,
            duty: self.last_duty(),
            active: self.executor.phase() != Phase::Idle || self.pulser.is_active(),
            silent_us: inputs.now_us.saturating_sub(self.last_command_us),
            late,
            watches: &self.watches,
            budgets: &self.budgets,
            calibration_lost: self.calibration_lost,
        };
        let causes = self.interlock.check(&self.calibration, &self.force, &observed);
        let repeats_force = !self.force.is_fresh();
        let sample = Sample { position_counts: position_um.map(round), force_counts, repeats_force };
        if self.force.is_accepted() {
            self.stiffness.add(&sample);
        }
        (sample, causes)
    }

    /// Advances the program by one period, then the position loops.
    fn advance(&mut self, now_us: u64, notes: &mut OutboundMessages) -> Drive {
        if self.interlock.latched().is_some() && self.executor.phase() != Phase::Retreating {
            return Drive::Release;
        }
        if self.executor.awaits_rest_us(now_us).is_some() {
            return Drive::Release;
        }
        let was_taring = self.executor.phase() == Phase::Taring;
        let settled = self.axes.iter().all(Axis::is_settled);
        let progress = self.executor.advance(now_us, settled, self.axes.each_ref().map(Axis::position_um));
        if progress.retreated || (progress.timed_out && self.executor.phase() == Phase::Retreating) {
            let outcome = if progress.retreated { RetreatOutcome::Moved } else { RetreatOutcome::Stopped };
            self.end_retreat(outcome, now_us, notes);
            return Drive::Release;
        }
        if progress.tare_finished
            && let Some(index) = progress.ended
            && !self.finish_tare(now_us, index, notes)
        {
            return Drive::Release;
        }
        if let Some(index) = progress.ended {
            push(notes, OutboundMessage::Event(event(now_us, EventKind::StepEnded { index })));
        }
        if let Some(index) = progress.started {
            push(notes, OutboundMessage::Event(event(now_us, EventKind::StepStarted { index })));
        }
        if progress.completed {
            let kind = EventKind::ProgramEnded { outcome: Outcome::Completed };
            push(notes, OutboundMessage::Event(event(now_us, kind)));
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

    /// Applies the tare that has ended. Returns false for a rejected tare, which ends the program.
    fn finish_tare(&mut self, now_us: u64, index: u8, notes: &mut OutboundMessages) -> bool {
        let periods_per_s = f64::from(1_000_000 / PERIOD_US);
        match self.force.finish_tare(self.calibration.force_range_mn(), periods_per_s) {
            Ok(tare) => {
                self.stiffness = StiffnessFit::new();
                push(notes, OutboundMessage::Event(event(now_us, EventKind::Tared(tare))));
                true
            }
            Err((tare, problem)) => {
                push(notes, OutboundMessage::Event(event(now_us, EventKind::TareRejected { tare, problem })));
                push(notes, OutboundMessage::Event(event(now_us, EventKind::StepEnded { index })));
                let kind = EventKind::ProgramEnded { outcome: Outcome::TareRejected };
                push(notes, OutboundMessage::Event(event(now_us, kind)));
                self.executor.abort();
                self.axes.iter_mut().for_each(Axis::rest);
                false
            }
        }
    }

    /// Updates the motors' watches and budgets with this period's drive.
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
        // In a pulse the wiring may be wrong, so that motion and direction are not judged; the motor's heat counts in a pulse too.
        let judged = if self.pulser.is_active() { [0.0; 2] } else { duty };
        let drives = duty.into_iter().zip(judged).zip(positions_um).zip([setpoint_x, setpoint_y]);
        let keepers = self.watches.iter_mut().zip(&mut self.budgets);
        for ((watch, budget), (((duty, judged), position_um), setpoint)) in keepers.zip(drives) {
            watch.step(judged, position_um, setpoint);
            budget.step(duty != 0.0);
        }
        for ((axis, watch), duty) in self.axes.iter_mut().zip(&self.watches).zip(duty) {
            if duty != 0.0 {
                axis.drives();
            }
            if watch.is_proven() {
                axis.prove();
            }
        }
    }

    /// Latches a fault, ends the program and reports it.
    fn trip(&mut self, fault: Fault, now_us: u64, notes: &mut OutboundMessages) {
        self.interlock.latch(fault);
        self.load_watch = LoadWatch::new();
        push(notes, OutboundMessage::Event(event(now_us, EventKind::Faulted { fault })));
        self.end_program(Outcome::Faulted, now_us, notes);
    }

    fn end_program(&mut self, outcome: Outcome, now_us: u64, notes: &mut OutboundMessages) {
        if self.executor.phase() == Phase::Retreating {
            return self.end_retreat(RetreatOutcome::Stopped, now_us, notes);
        }
        if let Some(report) = self.pulser.abort() {
            push(notes, OutboundMessage::Event(event(now_us, EventKind::PulseEnded(report))));
        }
        if self.executor.abort() {
            push(notes, OutboundMessage::Event(event(now_us, EventKind::ProgramEnded { outcome })));
        }
        self.axes.iter_mut().for_each(Axis::rest);
    }
}

fn event(t_us: u64, kind: EventKind) -> Event {
    Event { t_us, kind }
}

/// Adds a message. `OutboundMessages` has room for the largest number of messages of one period, so that none is lost here;
/// builds with debug assertions check that.
fn push(notes: &mut OutboundMessages, note: OutboundMessage) {
    let pushed = notes.push(note);
    debug_assert!(pushed.is_ok(), "more notes in one period than there is room for");
}

/// Rounds to the nearest integer, halves away from zero, saturating; `f32::round` is not in `core`.
pub(crate) fn round(value: f32) -> i32 {
    (if value < 0.0 { value - 0.5 } else { value + 0.5 }) as i32
}

#[cfg(test)]
mod tests;
