//! Which commands are carried out: each once, and none meant for the device as it was before a restart.
//!
//! The host repeats a command when no answer came. The answers to the latest commands are remembered by id, so a repeat gets
//! the same answer and changes nothing. A hello begins a new conversation (another host program, with ids of its own) and
//! forgets them.

use heapless::HistoryBuf;
use protocol::{Command, Refusal, Request};

/// How many answers are remembered. A host has one command under way at a time; this leaves room for a late repeat.
const REMEMBERED: usize = 8;

type Answer = Result<(), Refusal>;

/// What to do with a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Admission {
    /// Carry it out.
    New,
    /// It was carried out before, with this answer.
    Repeat(Answer),
    /// It was meant for an earlier boot.
    OtherBoot,
}

/// The commands of one host program.
#[derive(Debug)]
pub struct Conversation {
    boot_id: u32,
    answered: HistoryBuf<(u16, Answer), REMEMBERED>,
}

impl Conversation {
    /// No command seen yet.
    pub fn new(boot_id: u32) -> Self {
        Self { boot_id, answered: HistoryBuf::new() }
    }

    /// Decides on a command.
    pub fn admit(&mut self, command: &Command) -> Admission {
        match command.request {
            Request::Hello => {
                self.answered = HistoryBuf::new();
                return Admission::New;
            }
            // Stopping twice is harmless, and not stopping is not: it is always carried out.
            Request::Stop => return Admission::New,
            _ => {}
        }
        if command.boot_id != self.boot_id {
            return Admission::OtherBoot;
        }
        match self.answered.oldest_ordered().find(|(id, _)| *id == command.id) {
            Some(&(_, answer)) => Admission::Repeat(answer),
            None => Admission::New,
        }
    }

    /// Remembers an answer for a repeat.
    pub fn remember(&mut self, id: u16, answer: Answer) {
        self.answered.write((id, answer));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn command(id: u16, boot_id: u32, request: Request) -> Command {
        Command { id, boot_id, request }
    }

    #[test]
    fn a_repeat_gets_the_first_answer() {
        let mut conversation = Conversation::new(7);
        let run = command(3, 7, Request::ClearFault);
        assert_eq!(conversation.admit(&run), Admission::New);
        conversation.remember(3, Err(Refusal::CauseRemains));
        assert_eq!(conversation.admit(&run), Admission::Repeat(Err(Refusal::CauseRemains)));
    }

    #[test]
    fn a_hello_forgets_the_ids_of_the_program_before() {
        let mut conversation = Conversation::new(7);
        conversation.remember(3, Ok(()));
        assert_eq!(conversation.admit(&command(9, 0, Request::Hello)), Admission::New);
        assert_eq!(conversation.admit(&command(3, 7, Request::ClearFault)), Admission::New);
    }

    #[test]
    fn a_command_for_an_earlier_boot_is_refused_but_stop_is_not() {
        let mut conversation = Conversation::new(7);
        assert_eq!(conversation.admit(&command(1, 6, Request::ClearFault)), Admission::OtherBoot);
        assert_eq!(conversation.admit(&command(2, 6, Request::Stop)), Admission::New);
    }
}
