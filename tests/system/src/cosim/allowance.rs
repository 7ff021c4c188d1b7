//! Device time for a host that sends one command after the other and allows how long the device runs meanwhile.
//!
//! Without it, the device runs on while bytes are on their way between its line and the host, and while the host waits for processor
//! time: on a fast simulation many times longer than a command takes.

use super::gate::Waiting;
use protocol::Message;

/// Time to which device time may advance. Periods count from the start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Allowance {
    until_step: u64,
    /// The command whose answer ends it.
    or_answer_to: Option<u16>,
}

impl Allowance {
    /// To this period; where a command is named, no further than its answer.
    pub(super) fn new(until_step: u64, or_answer_to: Option<u16>) -> Self {
        Self { until_step, or_answer_to }
    }

    /// Takes a message that the device has sent before this period.
    pub(super) fn receive(&mut self, step: u64, message: &Message) {
        if let Message::Ack { id } | Message::Refused { id, .. } = message
            && self.or_answer_to == Some(*id)
        {
            *self = Self::new(self.until_step.min(step), None);
        }
    }

    /// Whether device time has to wait in this period. It never stands still then: a command that came late is still answered.
    pub(super) fn waiting(&self, step: u64) -> Option<Waiting> {
        (step >= self.until_step).then_some(Waiting::Allowance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::Refusal;

    const WAITS: Option<Waiting> = Some(Waiting::Allowance);

    #[test]
    fn device_time_runs_as_far_as_it_is_allowed_and_crawls_beyond() {
        let allowance = Allowance::new(400, None);
        assert_eq!((allowance.waiting(0), allowance.waiting(399)), (None, None));
        assert_eq!((allowance.waiting(400), allowance.waiting(9_000)), (WAITS, WAITS));
    }

    #[test]
    fn an_answer_ends_what_was_allowed_for_it() {
        for answer in [Message::Ack { id: 7 }, Message::Refused { id: 7, refusal: Refusal::Busy }] {
            let mut allowance = Allowance::new(400, Some(7));
            allowance.receive(20, &Message::Ack { id: 6 });
            assert_eq!(allowance.waiting(21), None, "the answer to another command");
            allowance.receive(30, &answer);
            assert_eq!(allowance.waiting(30), WAITS);
        }
        let mut late = Allowance::new(400, Some(7));
        late.receive(500, &Message::Ack { id: 7 });
        assert_eq!(late.waiting(450), WAITS, "an answer allows nothing");
        let mut timed = Allowance::new(400, None);
        timed.receive(30, &Message::Ack { id: 7 });
        assert_eq!(timed.waiting(31), None, "a wait is not ended by an answer");
    }
}
