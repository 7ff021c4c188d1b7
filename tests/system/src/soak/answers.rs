//! Which answer a command gets in which state.

use protocol::{Fault, Refusal, Request, State};

/// What became of a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answer {
    /// Carried out.
    Accepted,
    /// Not carried out, for this reason.
    Refused(Refusal),
    /// Lost on a bad line.
    Unanswered,
}

/// A program waits or runs.
pub fn is_active(state: State) -> bool {
    !matches!(state, State::Idle | State::Faulted)
}

/// The answer in a state. `sound`: the answer of an idle device without a fault.
pub fn expected(request: &Request, state: State, fault: Option<Fault>, sound: Result<(), Refusal>) -> Answer {
    let of_content = sound.map_or_else(Answer::Refused, |()| Answer::Accepted);
    match request {
        Request::Hello
        | Request::Status
        | Request::Calibration
        | Request::Safety
        | Request::Describe
        | Request::AcknowledgeCalibration
        | Request::Stream { .. }
        | Request::Stop => Answer::Accepted,
        Request::ClearFault => of_content,
        Request::Run { .. } | Request::Pulse { .. } if let Some(fault) = fault => {
            Answer::Refused(Refusal::Faulted { fault })
        }
        Request::StoreCalibration { .. }
            if let Some(fault) = fault.filter(|fault| !fault.may_come_of_calibration()) =>
        {
            Answer::Refused(Refusal::Faulted { fault })
        }
        Request::Run { .. }
        | Request::LoadStep { .. }
        | Request::Limits { .. }
        | Request::LoadCalibration { .. }
        | Request::Retreat { .. }
        | Request::Pulse { .. }
        | Request::StoreCalibration { .. } => {
            if is_active(state) {
                Answer::Refused(Refusal::Busy)
            } else {
                of_content
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_state_comes_before_the_content() {
        let (run, load) = (
            Request::Run { steps: 1, crc: 0, start_us: 0 },
            Request::LoadStep { index: 0, step: protocol::Step::Hold { duration_ms: 1 } },
        );
        let wrong = Err(Refusal::ProgramMismatch);
        let stop = Fault::EmergencyStop;
        let faulted = Answer::Refused(Refusal::Faulted { fault: stop });
        assert_eq!(expected(&run, State::Faulted, Some(stop), wrong), faulted);
        assert_eq!(expected(&run, State::Moving, None, wrong), Answer::Refused(Refusal::Busy));
        assert_eq!(expected(&run, State::Idle, None, wrong), Answer::Refused(Refusal::ProgramMismatch));
        assert_eq!(expected(&load, State::Faulted, Some(stop), Ok(())), Answer::Accepted);
        assert_eq!(expected(&Request::Stop, State::Pending, None, wrong), Answer::Accepted);
    }
}
