//! Frames over a serial port, with ids, tokens and repeats as the caller sets them: what the host's client never does.

use crate::pty::{self, wait};
use anyhow::{Context, Result};
use protocol::{Command, EnvelopeReceiver, MAX_FRAME_TO_DEVICE, Message, Received, encode_command};
use rustix::event::{PollFlags, Timespec};
use rustix::io::Errno;
use std::collections::VecDeque;
use std::os::fd::{AsFd, OwnedFd};
use std::path::Path;
use std::time::{Duration, Instant};

/// How long one wait for bytes takes at most.
const POLL_INTERVAL: Timespec = Timespec { tv_sec: 0, tv_nsec: 2_000_000 };

/// An open serial port.
#[derive(Debug)]
pub struct Line {
    port: OwnedFd,
    receiver: EnvelopeReceiver,
    waiting: VecDeque<Message>,
}

impl Line {
    /// Opens it.
    ///
    /// # Errors
    /// Where that is not possible.
    pub fn open(path: &Path) -> Result<Self> {
        Ok(Self { port: pty::open(path)?, receiver: EnvelopeReceiver::new(), waiting: VecDeque::new() })
    }

    /// Sends a command as it is.
    ///
    /// # Errors
    /// Where the port fails.
    pub fn send(&mut self, command: &Command) -> Result<()> {
        let mut buffer = [0; MAX_FRAME_TO_DEVICE];
        let mut left = encode_command(command, &mut buffer)?;
        while !left.is_empty() {
            match rustix::io::write(&self.port, left) {
                Ok(written) => left = left.get(written..).unwrap_or_default(),
                Err(Errno::AGAIN | Errno::INTR) => {
                    wait(self.port.as_fd(), PollFlags::OUT, &POLL_INTERVAL);
                }
                Err(error) => return Err(error).context("cannot write to the serial port"),
            }
        }
        Ok(())
    }

    /// The next message; none where none comes in time.
    ///
    /// # Errors
    /// Where the port fails.
    pub fn receive(&mut self, timeout: Duration) -> Result<Option<Message>> {
        let began = Instant::now();
        loop {
            if let Some(message) = self.waiting.pop_front() {
                return Ok(Some(message));
            }
            if began.elapsed() > timeout {
                return Ok(None);
            }
            wait(self.port.as_fd(), PollFlags::IN, &POLL_INTERVAL);
            let mut buffer = [0; 1024];
            match rustix::io::read(&self.port, &mut buffer) {
                Ok(length) => {
                    for received in self.receiver.feed(buffer.get(..length).unwrap_or_default()) {
                        if let Received::Frame(envelope) = received {
                            self.waiting.push_back(envelope.message);
                        }
                    }
                }
                Err(Errno::AGAIN | Errno::INTR) => {}
                Err(error) => return Err(error).context("cannot read from the serial port"),
            }
        }
    }
}
