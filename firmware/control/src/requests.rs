//! Commands: their effects, and the states in which they are accepted.

use super::commands::Admission;
use super::interlock::{Limits, StopCauses};
use super::motor::DriveWatch;
use super::mutation::Mutation;
use super::program::Phase;
use super::pulse::Pulse;
use super::{Axis, Controller, Inputs, OutboundMessage, OutboundMessages, push};
use protocol::{
    CalibrationRecord, CalibrationSource, Command, Fault, Outcome, Refusal, Request, SILENCE_LIMIT_MS,
};

impl Controller {
    /// Answers a command, and returns the calibration that is to be stored, if the command requests that.
    pub(super) fn handle_command(
        &mut self,
        command: &Command,
        inputs: &Inputs,
        causes: StopCauses,
        notes: &mut OutboundMessages,
    ) -> Option<CalibrationRecord> {
        let mut store = None;
        let answer = match self.conversation.admit(command) {
            Admission::Repeat(answer) => answer,
            Admission::Refused(refusal) => Err(refusal),
            Admission::New => {
                let answer = match command.request {
                    Request::StoreCalibration { length, crc } => self
                        .may_store()
                        .and_then(|()| self.incoming.finish(length, crc))
                        .map(|record| store = Some(record)),
                    request => self.execute(&request, inputs.now_us, causes, notes),
                };
                self.conversation.remember(command, answer);
                if answer.is_ok() {
                    self.heard(command, inputs.now_us);
                }
                answer
            }
        };
        self.restarting |= store.is_some();
        // A query is answered again each time it arrives, because the earlier answer may have been lost.
        match command.request {
            Request::Hello => {
                push(notes, OutboundMessage::Hello);
                push(notes, OutboundMessage::Connected(self.conversation.begin()));
            }
            Request::Status if answer.is_ok() => push(notes, OutboundMessage::Status(self.status(inputs))),
            Request::Calibration if answer.is_ok() => push(notes, OutboundMessage::Calibration),
            Request::Safety if answer.is_ok() => {
                push(notes, OutboundMessage::Safety(self.safety(inputs.now_us)))
            }
            Request::Describe if answer.is_ok() => push(notes, OutboundMessage::Description),
            _ => {}
        }
        push(
            notes,
            match answer {
                Ok(()) => OutboundMessage::Ack(command.id),
                Err(refusal) => OutboundMessage::Refused(command.id, refusal),
            },
        );
        store
    }

    /// Notes a keepalive: a new accepted command of the connection that started the motion. Refused commands, and those of other
    /// connections, do not show that the program which started it still runs. Nor does a frame that arrives again, because the line
    /// may have repeated it. A repeated hello cannot be distinguished from a new one, so that no hello is a keepalive.
    fn heard(&mut self, command: &Command, now_us: u64) {
        if matches!(command.request, Request::Run { .. } | Request::Retreat { .. } | Request::Pulse { .. }) {
            self.mover = command.connection;
        }
        if command.connection == self.mover && command.request != Request::Hello {
            self.last_command_us = now_us;
        }
    }

    fn execute(
        &mut self,
        request: &Request,
        now_us: u64,
        causes: StopCauses,
        notes: &mut OutboundMessages,
    ) -> Result<(), Refusal> {
        match *request {
            Request::Hello | Request::Status | Request::Calibration | Request::Safety | Request::Describe => {
                Ok(())
            }
            Request::Stream { enable } => {
                self.streaming = enable;
                self.reported = None;
                push(notes, OutboundMessage::Stream(enable));
                Ok(())
            }
            Request::LoadStep { index, step } => {
                self.while_idle()?;
                self.executor.load(index, step, self.calibration.travel_um() as i32)
            }
            Request::Run { steps, crc, start_us } => {
                self.may_move()?;
                let position_um = self.axes.each_ref().map(Axis::position_um);
                self.executor.run(steps, crc, start_us, now_us, position_um)
            }
            Request::Stop => {
                self.end_program(Outcome::Stopped, now_us, notes);
                Ok(())
            }
            Request::ClearFault if causes.first().is_some() => Err(Refusal::CauseRemains),
            // A motor that still coasts, or that a shorted bridge drives, prevents clearing too.
            Request::ClearFault
                if self.interlock.latched().is_some()
                    && !self.is_still()
                    && !Mutation::ClearInMotion.is_out() =>
            {
                Err(Refusal::CauseRemains)
            }
            Request::ClearFault => {
                self.end_program(Outcome::Stopped, now_us, notes);
                self.interlock.clear();
                Ok(())
            }
            Request::Limits { force_mn, silence_ms } => self.set_limits(Limits { force_mn, silence_ms }),
            Request::LoadCalibration { piece, bytes } => {
                self.while_idle()?;
                self.incoming.take(piece, bytes)
            }
            Request::Retreat { x_um, y_um } => self.begin_retreat([x_um, y_um], now_us, causes),
            Request::Pulse { axis, duty_permille, duration_ms } => {
                self.may_move()?;
                let pulse = Pulse { axis, duty_permille, periods: duration_ms };
                let position_um = self.axes.each_ref().map(Axis::position_um);
                let proven = self.watches.each_ref().map(DriveWatch::is_proven);
                self.pulser.begin(pulse, position_um, self.calibration.travel_um() as f32, proven)
            }
            Request::AcknowledgeCalibration => {
                if self.source == CalibrationSource::Nominal {
                    self.source = CalibrationSource::NominalAcknowledged;
                }
                self.calibration_lost = false;
                if self.interlock.latched() == Some(Fault::CalibrationLost) {
                    self.interlock.clear();
                }
                Ok(())
            }
            // `handle_command` carries it out, because it returns the record.
            Request::StoreCalibration { .. } => Ok(()),
        }
    }

    /// Whether both axes are at rest.
    pub(super) fn is_still(&self) -> bool {
        self.axes.iter().all(Axis::is_still)
    }

    pub(super) fn while_idle(&self) -> Result<(), Refusal> {
        let idle = self.executor.phase() == Phase::Idle && !self.pulser.is_active();
        if idle { Ok(()) } else { Err(Refusal::Busy) }
    }

    /// Whether a program or a pulse may start.
    fn may_move(&self) -> Result<(), Refusal> {
        if let Some(fault) = self.interlock.latched() {
            return Err(Refusal::Faulted { fault });
        }
        self.while_idle()?;
        if self.restarting {
            return Err(Refusal::Busy);
        }
        if self.source == CalibrationSource::Nominal {
            return Err(Refusal::CalibrationNotAcknowledged);
        }
        Ok(())
    }

    /// Whether a calibration may be stored. While a fault is latched that is allowed only if a calibration can cause the fault, as
    /// storing another one is then the recovery.
    fn may_store(&self) -> Result<(), Refusal> {
        self.while_idle()?;
        match self
            .interlock
            .latched()
            .filter(|fault| !fault.may_come_of_calibration() && !Mutation::ForgetAtRestart.is_out())
        {
            Some(fault) => Err(Refusal::Faulted { fault }),
            None => Ok(()),
        }
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
}
