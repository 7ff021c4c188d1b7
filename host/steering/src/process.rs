//! A plant that is a program: one JSON object a line over its standard input and output (`needle/1`).

use crate::line::{parse, to_line};
use crate::plant::{Plant, PlantError};
use crate::protocol::{Answer, Command, Done, End, Statement};
use crate::record::Record;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

/// Wall time in which the statement has to come.
const START_S: f64 = 10.0;
/// Wall time in which every other line has to come.
const ANSWER_S: f64 = 5.0;
/// Longer lines are no message of this protocol, bytes.
const MAX_LINE: usize = 1 << 20;

/// Flag of Windows for a process that a console's Ctrl-C does not end.
#[cfg(windows)]
const NEW_PROCESS_GROUP: u32 = 0x200;

/// Interval at which a wait checks whether the user interrupts.
const POLL: Duration = Duration::from_millis(50);
/// Time to wait for a program to end once its output has ended.
const EXIT: Duration = Duration::from_millis(500);

/// A running plant. It has a process group of its own: an interrupt at the terminal ends the run, and not the plant before the run.
#[derive(Debug)]
pub struct ProcessPlant {
    child: Child,
    /// Closed when nothing more is to be sent.
    input: Option<ChildStdin>,
    lines: Receiver<String>,
    line: u64,
    record: Record,
    /// Wall time for the statement, and for every other line, s.
    limits_s: [f64; 2],
    /// Set by the user's interrupt.
    interrupted: &'static AtomicBool,
}

impl ProcessPlant {
    /// Starts a program with its arguments; every line is recorded. The run ends soon after `interrupted` is set.
    ///
    /// # Errors
    /// [`PlantError::NotStarted`].
    pub fn start(
        program: &str,
        arguments: &[String],
        record: Record,
        interrupted: &'static AtomicBool,
    ) -> Result<Self, PlantError> {
        Self::with_limits(program, arguments, record, [START_S, ANSWER_S], interrupted)
    }

    fn with_limits(
        program: &str,
        arguments: &[String],
        record: Record,
        limits_s: [f64; 2],
        interrupted: &'static AtomicBool,
    ) -> Result<Self, PlantError> {
        let mut command = std::process::Command::new(program);
        command.args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped());
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        #[cfg(windows)]
        std::os::windows::process::CommandExt::creation_flags(&mut command, NEW_PROCESS_GROUP);
        let mut child = command.spawn().map_err(|error| not_started(&error, &record, program))?;
        let (input, output) = (child.stdin.take(), child.stdout.take());
        let output = output.ok_or_else(|| not_started(&"no standard output", &record, program))?;
        let (send, lines) = channel();
        std::thread::spawn(move || {
            let mut reader = BufReader::new(output);
            loop {
                let mut bytes = Vec::new();
                let read = std::io::Read::take(&mut reader, MAX_LINE as u64).read_until(b'\n', &mut bytes);
                if !matches!(read, Ok(1..)) {
                    return;
                }
                let line = String::from_utf8_lossy(&bytes).trim_end_matches(['\n', '\r']).to_owned();
                if send.send(line).is_err() {
                    return;
                }
            }
        });
        Ok(Self { child, input, lines, line: 0, record, limits_s, interrupted })
    }

    fn send(&mut self, message: &impl Serialize) -> Result<(), PlantError> {
        if self.interrupted.load(Ordering::Acquire) {
            return Err(self.record.failure(PlantError::Interrupted));
        }
        let line = to_line(message);
        self.record.sent(&line);
        let Some(input) = self.input.as_mut() else {
            return Err(self.record.failure(PlantError::Ended {
                expected: "that it reads commands".into(),
                how: "its input was closed after an error".into(),
            }));
        };
        // If the plant has ended, its last line has the reason: the answer's reading reports it.
        let _ = writeln!(input, "{line}").and_then(|()| input.flush());
        Ok(())
    }

    fn receive<T: DeserializeOwned>(
        &mut self,
        expected: &'static str,
        limit_s: f64,
    ) -> Result<T, PlantError> {
        let received = match self.wait(expected, limit_s) {
            Ok(line) => {
                self.line += 1;
                self.record.received(&line);
                parse(&line, self.line, expected)
            }
            Err(error) => Err(self.record.failure(error)),
        };
        if received.is_err() {
            // No further request is sent.
            self.input = None;
        }
        received
    }

    /// The next line.
    fn wait(&mut self, expected: &'static str, limit_s: f64) -> Result<String, PlantError> {
        let began = Instant::now();
        let limit = Duration::from_secs_f64(limit_s);
        loop {
            let remaining = limit.saturating_sub(began.elapsed());
            match self.lines.recv_timeout(remaining.min(POLL)) {
                Ok(line) => return Ok(line),
                Err(_) if self.interrupted.load(Ordering::Acquire) => return Err(PlantError::Interrupted),
                Err(RecvTimeoutError::Timeout) if remaining > POLL => {}
                Err(RecvTimeoutError::Timeout) => {
                    return Err(PlantError::Silent { expected: expected.into(), limit_s });
                }
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(PlantError::Ended { expected: expected.into(), how: self.end_of_program() });
                }
            }
        }
    }

    /// End of the program, and the remedy.
    fn end_of_program(&mut self) -> std::borrow::Cow<'static, str> {
        let began = Instant::now();
        let mut status = None;
        while status.is_none() && began.elapsed() < EXIT {
            status = self.child.try_wait().ok().flatten();
            std::thread::sleep(Duration::from_millis(5));
        }
        let program = match status {
            Some(status) => format!("the program has ended ({status})"),
            None => "the program has closed its output".to_owned(),
        };
        let remedy = if self.line == 0 {
            "its own messages are above. Run the command by itself: it has to print its statement, one line that begins with \
             {\"plant\": \"needle/1\", and then wait; paths in it count from the current folder"
        } else {
            "its own messages are above; a plant that cannot go on writes {\"error\": \"why\"}"
        };
        format!("{program}; {remedy}").into()
    }
}

fn not_started(error: &dyn std::fmt::Display, record: &Record, program: &str) -> PlantError {
    record.failure(PlantError::NotStarted(format!("{program}: {error}")))
}

impl Plant for ProcessPlant {
    fn start(&mut self) -> Result<Statement, PlantError> {
        self.receive("statement", self.limits_s[0])
    }

    fn step(&mut self, command: &Command) -> Result<Answer, PlantError> {
        self.send(command)?;
        self.receive("answer", self.limits_s[1])
    }

    fn end(&mut self) -> Result<End, PlantError> {
        self.send(&Done { done: true })?;
        let end = self.receive("last line", self.limits_s[1])?;
        self.input = None;
        Ok(end)
    }
}

impl Drop for ProcessPlant {
    fn drop(&mut self) {
        self.input = None;
        // A plant ends by itself after its last line, or when its input ends.
        for _ in 0..20 {
            if !matches!(self.child.try_wait(), Ok(None)) {
                return;
            }
            std::thread::sleep(Duration::from_millis(25));
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

// Its plants are scripts of a Unix shell.
#[cfg(all(test, unix))]
#[path = "process_tests.rs"]
mod tests;
