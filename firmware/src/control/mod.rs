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
//! | [`force`] | force from converter codes: calibration, tare, stale and saturated readings |
//! | [`interlock`] | when to stop, and why |
//! | [`indicator`] | the status light |

pub mod axis;
pub mod commands;
pub mod force;
pub mod indicator;
pub mod interlock;
pub mod profile;
mod program;

use crate::calibration::Calibration;
use crate::hal::Readings;
use axis::Axis;
use commands::{Admission, Conversation};
use force::ForceChannel;
use indicator::Indicator;
use interlock::Interlock;
use program::{Executor, Phase};
use protocol::{
    Command, Counters, Event, EventKind, Fault, Outcome, Refusal, Request, Sample, State, Status,
};

/// Control period, microseconds.
pub const PERIOD_US: u32 = 1_000;
/// Control period, seconds.
pub const PERIOD_S: f32 = PERIOD_US as f32 * 1e-6;
/// Step index outside a program.
pub const NO_STEP: u8 = u8::MAX;

/// What the controller has to say in one period; the link task turns each into a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Note {
    /// Send the hello.
    Hello,
    /// Switch telemetry on or off.
    Stream(bool),
    /// A command was carried out.
    Ack(u16),
    /// A command was refused.
    Refused(u16, Refusal),
    /// Something happened.
    Event(Event),
    /// The state was asked for.
    Status(Status),
}

/// Most notes of one period: an answer of two parts, and the events of a step's end, a program's end and a fault.
pub type Notes = heapless::Vec<Note, 8>;

/// Everything that goes into one control period.
#[derive(Debug, Clone)]
pub struct Inputs {
    /// Device time at which this period was due, microseconds since start.
    pub now_us: u64,
    /// What the sensors say.
    pub readings: Readings,
    /// A command that arrived.
    pub command: Option<Command>,
    /// Counters that other tasks keep; the controller adds its own before it reports them.
    pub counters: Counters,
}

/// What the bridges are to do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Drive {
    /// Off; the lead screws hold.
    Release,
    /// Duty of axis x and y, -1 to 1, against brake.
    Duty([f32; 2]),
}

/// Everything that comes out of one control period.
#[derive(Debug, Clone)]
pub struct Outputs {
    /// What the bridges are to do.
    pub drive: Drive,
    /// The status light.
    pub led: bool,
    /// State of this period.
    pub state: State,
    /// Program step of this period; [`NO_STEP`] outside a program.
    pub step: u8,
    /// The sample of this period.
    pub sample: Sample,
    /// Answers and events, in order.
    pub notes: Notes,
}

/// The whole control law.
#[derive(Debug)]
pub struct Controller {
    calibration: Calibration,
    axes: [Axis; 2],
    force: ForceChannel,
    interlock: Interlock,
    executor: Executor,
    conversation: Conversation,
    indicator: Indicator,
    streaming: bool,
}

impl Controller {
    /// A controller at rest, for the boot with this identity.
    pub fn new(calibration: Calibration, boot_id: u32) -> Self {
        Self {
            axes: [Axis::new(), Axis::new()],
            force: ForceChannel::new(),
            interlock: Interlock::new(),
            executor: Executor::new(),
            conversation: Conversation::new(boot_id),
            indicator: Indicator::new(),
            streaming: false,
            calibration,
        }
    }

    /// One control period.
    pub fn step(&mut self, inputs: &Inputs) -> Outputs {
        let mut notes = Notes::new();
        let position_um = self.calibration.position_um(inputs.readings.potentiometer_codes);
        let force_counts = self.force.update(&self.calibration, &inputs.readings.force_codes);
        for (axis, position) in self.axes.iter_mut().zip(position_um) {
            axis.measure(position);
        }

        let cause = self.interlock.check(&self.calibration, &inputs.readings, &self.force);
        if let Some(fault) = cause.filter(|_| self.interlock.latched().is_none()) {
            self.trip(fault, inputs.now_us, &mut notes);
        }
        let sample = Sample { position_counts: position_um.map(round), force_counts };
        if let Some(command) = &inputs.command {
            self.obey(command, inputs, sample, cause, &mut notes);
        }
        let drive = self.advance(inputs.now_us, force_counts, &mut notes);

        let state = self.state();
        Outputs {
            drive,
            led: self.indicator.step(state),
            state,
            step: self.executor.index().unwrap_or(NO_STEP),
            sample,
            notes,
        }
    }

    /// Runs the program for one period and the axes after it.
    fn advance(&mut self, now_us: u64, force_counts: [i32; 2], notes: &mut Notes) -> Drive {
        if self.interlock.latched().is_some() {
            return Drive::Release;
        }
        let settled = self.axes.iter().all(Axis::is_settled);
        let progress = self.executor.advance(now_us, settled, self.axes.each_ref().map(Axis::position_um));
        if progress.tare_finished {
            let (zero_counts, sd_counts) = self.force.finish_tare();
            push(
                notes,
                Note::Event(event(
                    now_us,
                    EventKind::Tared(protocol::Tare {
                        zero_counts,
                        sd_counts,
                        drift_counts_per_s: [0; 2],
                        periods: 0,
                        readings: 0,
                        unique_codes: [0; 2],
                    }),
                )),
            );
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
            self.force.tare_with(force_counts);
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

    /// Latches a fault, ends the program and says so.
    fn trip(&mut self, fault: Fault, now_us: u64, notes: &mut Notes) {
        self.interlock.latch(fault);
        push(notes, Note::Event(event(now_us, EventKind::Faulted { fault })));
        self.end_program(Outcome::Faulted, now_us, notes);
    }

    fn end_program(&mut self, outcome: Outcome, now_us: u64, notes: &mut Notes) {
        if self.executor.abort() {
            self.force.abandon_tare();
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
    ) {
        let answer = match self.conversation.admit(command) {
            Admission::Repeat(answer) => answer,
            Admission::OtherBoot => Err(Refusal::OtherBoot),
            Admission::New => {
                let answer = self.execute(&command.request, inputs.now_us, cause, notes);
                self.conversation.remember(command.id, answer);
                answer
            }
        };
        // Questions are answered afresh each time they arrive: the earlier answer may be what was lost.
        match command.request {
            Request::Hello => push(notes, Note::Hello),
            Request::Status if answer.is_ok() => push(notes, Note::Status(self.status(inputs, sample))),
            _ => {}
        }
        push(
            notes,
            match answer {
                Ok(()) => Note::Ack(command.id),
                Err(refusal) => Note::Refused(command.id, refusal),
            },
        );
    }

    fn execute(
        &mut self,
        request: &Request,
        now_us: u64,
        cause: Option<Fault>,
        notes: &mut Notes,
    ) -> Result<(), Refusal> {
        match *request {
            Request::Hello | Request::Status => Ok(()),
            Request::Stream { enable } => {
                self.streaming = enable;
                push(notes, Note::Stream(enable));
                Ok(())
            }
            Request::LoadStep { index, step } => {
                self.executor.load(index, step, self.calibration.travel_um as i32)
            }
            Request::Run { steps, crc, start_us } => match self.interlock.latched() {
                Some(fault) => Err(Refusal::Faulted { fault }),
                None => self.executor.run(steps, crc, start_us, now_us),
            },
            Request::Stop => {
                self.end_program(Outcome::Stopped, now_us, notes);
                Ok(())
            }
            Request::Limits { .. }
            | Request::LoadCalibration { .. }
            | Request::StoreCalibration { .. }
            | Request::Calibration => Err(Refusal::Busy),
            Request::ClearFault if cause.is_some() => Err(Refusal::CauseRemains),
            Request::ClearFault => {
                self.interlock.clear();
                Ok(())
            }
        }
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
        Status {
            t_us: inputs.now_us,
            state: self.state(),
            step: self.executor.index().unwrap_or(NO_STEP),
            fault: self.interlock.latched(),
            position_counts: sample.position_counts,
            force_counts: sample.force_counts,
            streaming: self.streaming,
            counters: Counters { force_readings_bad: self.force.bad_readings(), ..inputs.counters },
            load: Default::default(),
            motor_budget_permille: [0; 2],
            force_limit_mn: 0,
            silence_limit_ms: 0,
            stiffness: [None; 2],
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
