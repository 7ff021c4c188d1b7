//! Decides which commands are carried out: each command once, and none that was sent before a restart.
//!
//! A hello begins a connection: the device answers with a token that every command of it carries, and ids only grow within it.
//! The host repeats a command when no answer came; the answers to the latest commands are kept with their requests, so that
//! a repeat gets the same answer and changes nothing. An old frame (recorded, delayed, or repeated by a faulty line) has a
//! forgotten token or a used id, and is not carried out, however often it arrives.
//!
//! The tokens of a few connections stay valid, and the least recently used one is forgotten, so that a stray hello does not end
//! the connection of the program that is at work.

use super::mutation::Mutation;
use heapless::HistoryBuf;
use protocol::{Command, Refusal, Request};

/// Number of answers that are remembered. A host has one command under way at a time; this leaves room for a late
/// repeat.
pub const MAX_STORED_ANSWERS: usize = 8;
/// Number of connections whose tokens are valid at the same time.
pub const CONNECTIONS: usize = 4;
/// Difference between the tokens of two connections: odd, so that all 2^32 tokens differ, and with many bits set.
const TOKEN_STEP: u32 = 0x9E37_79B9;
/// Size of the block of tokens of one start. The connections of the start take [`TOKENS`] - 1 different ones in turn.
pub const TOKENS: u32 = 1 << 12;

/// Identity of a start of a chip; the tokens of its connections are counted from it. Two starts of a chip have different tokens
/// while their counts differ by less than 2^20, because each start has a block of [`TOKENS`] numbers, and multiplication by an
/// odd number maps different numbers to different ones.
pub const fn first_token(chip: u32, start: u32) -> u32 {
    chip.wrapping_add(start.wrapping_mul(TOKENS).wrapping_mul(TOKEN_STEP))
}

type Answer = Result<(), Refusal>;

/// Decision about a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Admission {
    /// The command is new: carry it out.
    New,
    /// The command was carried out before, with this answer.
    Repeat(Answer),
    /// The command is refused.
    Refused(Refusal),
}

/// A command that was answered.
#[derive(Debug, Clone, Copy)]
struct Answered {
    id: u16,
    request: Request,
    answer: Answer,
}

#[derive(Debug)]
struct Connection {
    token: u32,
    /// Greatest id so far.
    last_id: Option<u16>,
    answered: HistoryBuf<Answered, MAX_STORED_ANSWERS>,
    /// Count of commands when it was last used.
    used: u32,
}

/// The connections of this boot.
#[derive(Debug)]
pub struct CommandSession {
    connections: heapless::Vec<Connection, CONNECTIONS>,
    boot_id: u32,
    /// Number of the latest connection, from 1 to [`TOKENS`] - 1; 0 before the first.
    latest: u32,
    commands: u32,
}

impl CommandSession {
    /// No connection yet.
    pub const fn new(boot_id: u32) -> Self {
        Self { connections: heapless::Vec::new(), boot_id, latest: 0, commands: 0 }
    }

    /// Begins a connection and returns its token.
    pub fn begin(&mut self) -> u32 {
        self.latest = self.latest % (TOKENS - 1) + 1;
        self.commands = self.commands.wrapping_add(1);
        let token = self.boot_id.wrapping_add(self.latest.wrapping_mul(TOKEN_STEP));
        let next_command = self.commands;
        let connection = Connection { token, last_id: None, answered: HistoryBuf::new(), used: next_command };
        if let Err(connection) = self.connections.push(connection) {
            let now = self.commands;
            let oldest = self.connections.iter_mut().max_by_key(|oldest| now.wrapping_sub(oldest.used));
            if let Some(oldest) = oldest {
                *oldest = connection;
            }
        }
        token
    }

    /// Decides on a command.
    pub fn admit(&mut self, command: &Command) -> Admission {
        // A hello begins a new connection, and a repeated stop is harmless: both are always carried out.
        if matches!(command.request, Request::Hello | Request::Stop) {
            return Admission::New;
        }
        self.commands = self.commands.wrapping_add(1);
        let next_command = self.commands;
        let Some(connection) = self.of(command.connection) else {
            return Admission::Refused(Refusal::OtherBoot);
        };
        connection.used = next_command;
        if connection.last_id.is_none_or(|last_id| command.id > last_id) {
            return Admission::New;
        }
        match connection.answered.oldest_ordered().find(|answered| answered.id == command.id) {
            Some(answered) if answered.request == command.request => Admission::Repeat(answered.answer),
            None if Mutation::OldFramesAct.is_out() => Admission::New,
            _ => Admission::Refused(Refusal::IdUsed),
        }
    }

    /// Remembers the answer to a new command, for a repeat of it.
    pub fn remember(&mut self, command: &Command, answer: Answer) {
        if matches!(command.request, Request::Hello | Request::Stop) {
            return;
        }
        if let Some(connection) = self.of(command.connection) {
            connection.last_id = Some(command.id);
            connection.answered.write(Answered { id: command.id, request: command.request, answer });
        }
    }

    fn of(&mut self, token: u32) -> Option<&mut Connection> {
        self.connections.iter_mut().find(|connection| connection.token == token)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn command(id: u16, connection: u32, request: Request) -> Command {
        Command { id, connection, request }
    }

    #[test]
    fn a_repeat_gets_the_first_answer_and_another_request_of_its_id_none() {
        let mut conversation = CommandSession::new(7);
        let token = conversation.begin();
        let clear = command(3, token, Request::ClearFault);
        assert_eq!(conversation.admit(&clear), Admission::New);
        conversation.remember(&clear, Err(Refusal::CauseRemains));
        assert_eq!(conversation.admit(&clear), Admission::Repeat(Err(Refusal::CauseRemains)));
        let other_request = command(3, token, Request::Stream { enable: true });
        assert_eq!(conversation.admit(&other_request), Admission::Refused(Refusal::IdUsed));
    }

    #[test]
    fn an_old_frame_is_never_carried_out_however_old() {
        let mut conversation = CommandSession::new(7);
        let token = conversation.begin();
        let old = command(0, token, Request::ClearFault);
        for id in 0..=u16::MAX {
            let new = command(id, token, Request::ClearFault);
            assert_eq!(conversation.admit(&new), Admission::New, "{id}");
            conversation.remember(&new, Ok(()));
        }
        assert_eq!(conversation.admit(&old), Admission::Refused(Refusal::IdUsed));
        // If its hello is repeated too, the old token stays valid, and the new connection has another one.
        let again = conversation.begin();
        assert_eq!(conversation.admit(&old), Admission::Refused(Refusal::IdUsed));
        assert_eq!(conversation.admit(&command(0, again, Request::ClearFault)), Admission::New);
    }

    #[test]
    fn no_token_comes_again_at_another_start_of_the_chip() {
        let mut tokens = std::collections::BTreeSet::new();
        for start in (0..100).chain([70_000, (1 << 20) - 1]) {
            let mut conversation = CommandSession::new(first_token(0xDEAD_BEEF, start));
            let mut of_start = std::collections::BTreeSet::new();
            for _ in 0..2 * TOKENS {
                of_start.insert(conversation.begin());
            }
            assert_eq!(of_start.len() as u32, TOKENS - 1);
            assert!(tokens.is_disjoint(&of_start), "start {start}");
            tokens.extend(of_start);
        }
    }

    #[test]
    fn stray_hellos_do_not_end_the_connection_at_work() {
        let mut conversation = CommandSession::new(7);
        let token = conversation.begin();
        for id in 0..100 {
            let strays: std::vec::Vec<u32> = (0..2).map(|_| conversation.begin()).collect();
            assert!(!strays.contains(&token));
            let at_work = command(id, token, Request::Status);
            assert_eq!(conversation.admit(&at_work), Admission::New);
            conversation.remember(&at_work, Ok(()));
        }
        for _ in 0..CONNECTIONS {
            conversation.begin();
        }
        let forgotten = conversation.admit(&command(500, token, Request::Status));
        assert_eq!(forgotten, Admission::Refused(Refusal::OtherBoot));
    }

    #[test]
    fn a_command_of_no_connection_is_refused_but_stop_is_not() {
        let mut conversation = CommandSession::new(7);
        assert_eq!(
            conversation.admit(&command(1, 7, Request::ClearFault)),
            Admission::Refused(Refusal::OtherBoot)
        );
        assert_eq!(conversation.admit(&command(2, 6, Request::Stop)), Admission::New);
    }
}
