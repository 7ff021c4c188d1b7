//! Running a motion program on the device and following it to its end.
//!
//! The device runs the program by itself; the host follows. Events can be lost, so that the end is recognised by the first of
//! three messages: the event, the state in a batch, or a status. The status is requested regularly, as a keepalive; its answer
//! arrives among the other messages.

use super::client::Client;
use super::error::LinkError;
use super::keepalive::Keepalive;
use super::program::Program;
use super::silence::Silence;
use super::telemetry::Telemetry;
use protocol::{Event, EventKind, Fault, Outcome, Request, SILENCE_LIMIT_MS, State, Status, TareProblem};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Time for which one poll for telemetry waits: short, so that an interrupt is handled soon.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Options of a run of a program.
#[derive(Debug, Clone, Copy)]
pub struct RunOptions<'a> {
    /// Device time at which to start, microseconds; `None`: at once.
    pub start_us: Option<u64>,
    /// Have every sample sent.
    pub stream: bool,
    /// Set by the user's interrupt.
    pub interrupted: &'a AtomicBool,
}

/// Loads a program, starts it and follows it. `observe` receives everything the device sends, in order, up to the program's end.
///
/// # Errors
/// Errors of the link, the device or `observe`. Unless the link itself is gone, the guide has been stopped.
pub fn run<E: From<LinkError>>(
    client: &mut Client,
    program: &Program,
    options: RunOptions,
    mut observe: impl FnMut(&Client, &Telemetry) -> Result<(), E>,
) -> Result<(), E> {
    let outcome = start(client, program, options)
        .map_err(E::from)
        .and_then(|accepted| follow(client, &accepted, options, &mut observe));
    let mut answers = true;
    if outcome.is_err() {
        // Without a link the stop cannot arrive; the device ends the program by itself and holds.
        answers = client.request(Request::Stop).is_ok();
        // Telemetry that arrived before the failure was noticed belongs to the run; the failure itself is reported
        // already.
        while let Some(telemetry) = client.waiting() {
            if observe(client, &telemetry).is_err() {
                break;
            }
        }
    }
    if options.stream && answers {
        let stopped = client.request(Request::Stream { enable: false });
        outcome.and_then(|()| stopped.map_err(E::from))
    } else {
        outcome
    }
}

/// Has a program accepted; the status directly after that.
fn start(client: &mut Client, program: &Program, options: RunOptions) -> Result<Status, LinkError> {
    let steps = program.device_steps();
    for (index, step) in (0u8..).zip(&steps) {
        client.request(Request::LoadStep { index, step: *step })?;
    }
    client.request(Request::Stream { enable: options.stream })?;
    let start_us = options.start_us.unwrap_or(0);
    client.request(Request::Run {
        steps: steps.len() as u8,
        crc: protocol::program_crc(&steps),
        start_us,
    })?;
    // The end of this one, should it be among them because the acceptance came late, is found by the status.
    client.forget_ends();
    client.status()
}

fn follow<E: From<LinkError>>(
    client: &mut Client,
    accepted: &Status,
    options: RunOptions,
    observe: &mut impl FnMut(&Client, &Telemetry) -> Result<(), E>,
) -> Result<(), E> {
    let mut end = EndWatch::new(accepted);
    let limit_ms = accepted.silence_limit_ms.max(SILENCE_LIMIT_MS[0]);
    let mut keepalive = Keepalive::new(Instant::now(), accepted.t_us, limit_ms);
    let mut silence = Silence::default();
    loop {
        if options.interrupted.load(Ordering::Acquire) {
            return Err(LinkError::Interrupted.into());
        }
        if keepalive.is_due(Instant::now()) {
            client.request_status()?;
            keepalive.sent(Instant::now());
        }
        if let Some(telemetry) = silence.next(client, POLL_INTERVAL)? {
            observe(client, &telemetry)?;
            keepalive.clock(telemetry.device_us().unwrap_or_default());
            end.observe(&telemetry);
        }
        match end.outcome {
            None => {}
            Some(Outcome::Completed) => return Ok(()),
            Some(Outcome::TareRejected) => {
                let (problem, zero_counts) =
                    end.tare.map_or((None, [0; 2]), |(problem, zero)| (Some(problem), zero));
                return Err(LinkError::TareRejected { problem, zero_n: client.force_n(zero_counts) }.into());
            }
            Some(Outcome::Stopped) => return Err(LinkError::ProgramEnded { fault: None }.into()),
            Some(Outcome::Faulted) => {
                let fault = match end.fault {
                    Some(fault) => Some(fault),
                    None => client.status()?.fault,
                };
                return Err(LinkError::ProgramEnded { fault }.into());
            }
        }
    }
}

/// Recognises the end of a program that has been accepted.
struct EndWatch {
    /// Device time at which the program had been accepted: states from then on are its own.
    accepted_us: u64,
    was_active: bool,
    fault: Option<Fault>,
    /// Why a tare was rejected, and the zero that it found.
    tare: Option<(TareProblem, [i32; 2])>,
    outcome: Option<Outcome>,
}

impl EndWatch {
    fn new(accepted: &Status) -> Self {
        Self { accepted_us: accepted.t_us, was_active: false, fault: None, tare: None, outcome: None }
    }

    fn observe(&mut self, telemetry: &Telemetry) {
        match telemetry {
            Telemetry::Event(Event { kind, .. }) => match kind {
                EventKind::ProgramEnded { outcome } => self.outcome = Some(*outcome),
                EventKind::Faulted { fault } => self.fault = Some(*fault),
                EventKind::StepStarted { .. } => self.was_active = true,
                EventKind::TareRejected { tare, problem } => self.tare = Some((*problem, tare.zero_counts)),
                EventKind::StepEnded { .. }
                | EventKind::Tared(_)
                | EventKind::RetreatEnded { .. }
                | EventKind::PulseEnded(_) => {}
            },
            Telemetry::Status(status) if status.t_us >= self.accepted_us => {
                self.observe_state(status.state, status.fault);
            }
            Telemetry::Status(_) => {}
            // Batches of the time before the start may still be on their way: only a change to rest is an end.
            Telemetry::Samples(batch) => match batch.state {
                State::Idle if self.was_active => self.end(Outcome::Completed),
                State::Faulted | State::Retreating if self.was_active => self.end(Outcome::Faulted),
                State::Idle | State::Faulted | State::Retreating => {}
                State::Pending | State::Moving | State::Holding | State::Taring => self.was_active = true,
            },
        }
    }

    /// Rest after the acceptance of the program is an end.
    fn observe_state(&mut self, state: State, fault: Option<Fault>) {
        match state {
            State::Idle => self.end(Outcome::Completed),
            State::Faulted | State::Retreating => {
                self.fault = fault;
                self.end(Outcome::Faulted);
            }
            State::Pending | State::Moving | State::Holding | State::Taring => self.was_active = true,
        }
    }

    fn end(&mut self, outcome: Outcome) {
        self.outcome.get_or_insert(outcome);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::telemetry::Batch;
    use fake_device as fake;

    fn status(t_us: u64, state: State, fault: Option<Fault>) -> Status {
        Status { t_us, state, fault, ..fake::status() }
    }

    fn batch(state: State) -> Telemetry {
        Telemetry::Samples(Batch { state, step: None, lost_before: 0, points: Vec::new() })
    }

    #[test]
    fn rest_from_before_the_start_is_no_end() {
        let mut end = EndWatch::new(&status(5, State::Pending, None));
        end.observe(&batch(State::Idle));
        end.observe(&Telemetry::Status(Box::new(status(4, State::Idle, None))));
        assert_eq!(end.outcome, None);
        end.observe(&batch(State::Pending));
        end.observe(&batch(State::Moving));
        assert_eq!(end.outcome, None);
        end.observe(&batch(State::Idle));
        assert_eq!(end.outcome, Some(Outcome::Completed));
    }

    #[test]
    fn an_end_whose_event_was_lost_is_found_by_the_status() {
        let mut end = EndWatch::new(&status(5, State::Pending, None));
        end.observe(&Telemetry::Status(Box::new(status(5, State::Holding, None))));
        assert_eq!(end.outcome, None);
        end.observe(&Telemetry::Status(Box::new(status(6, State::Faulted, Some(Fault::ForceRange)))));
        assert_eq!((end.outcome, end.fault), (Some(Outcome::Faulted), Some(Fault::ForceRange)));
    }
}
