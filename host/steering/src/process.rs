//! A plant that is a program: one JSON object a line over its standard input and output (`needle/1`).

use crate::plant::{Plant, PlantError};
use crate::protocol::{Answer, Command, Done, End, Statement};
use crate::record::Record;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

/// Wall time in which the statement has to come.
const START_S: f64 = 10.0;
/// Wall time in which every other line has to come.
const ANSWER_S: f64 = 5.0;
/// Longer lines are no message of this protocol, bytes.
const MAX_LINE: usize = 1 << 20;

/// A running plant.
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
}

impl ProcessPlant {
    /// Starts a program with its arguments; every line is recorded.
    ///
    /// # Errors
    /// [`PlantError::NotStarted`].
    pub fn start(program: &str, arguments: &[String], record: Record) -> Result<Self, PlantError> {
        Self::with_limits(program, arguments, record, [START_S, ANSWER_S])
    }

    fn with_limits(
        program: &str,
        arguments: &[String],
        record: Record,
        limits_s: [f64; 2],
    ) -> Result<Self, PlantError> {
        let spawned = std::process::Command::new(program)
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn();
        let failed = |error: &dyn std::fmt::Display| PlantError::NotStarted(format!("{program}: {error}"));
        let mut child = spawned.map_err(|error| failed(&error))?;
        let (input, output) = (child.stdin.take(), child.stdout.take());
        let output = output.ok_or_else(|| failed(&"no standard output"))?;
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
        Ok(Self { child, input, lines, line: 0, record, limits_s })
    }

    fn send(&mut self, message: &impl Serialize) -> Result<(), PlantError> {
        let line = to_line(message);
        self.record.sent(&line);
        let ended = PlantError::Ended("that it reads commands");
        let input = self.input.as_mut().ok_or_else(|| ended.clone())?;
        // Where the plant has ended, what it last wrote has the reason: the answer's reading reports it.
        let _ = writeln!(input, "{line}").and_then(|()| input.flush());
        Ok(())
    }

    fn receive<T: DeserializeOwned>(
        &mut self,
        expected: &'static str,
        limit_s: f64,
    ) -> Result<T, PlantError> {
        let received = match self.lines.recv_timeout(Duration::from_secs_f64(limit_s)) {
            Ok(line) => {
                self.line += 1;
                self.record.received(&line);
                parse(&line, self.line, expected)
            }
            Err(RecvTimeoutError::Timeout) => Err(PlantError::Silent { expected, limit_s }),
            Err(RecvTimeoutError::Disconnected) => Err(PlantError::Ended(expected)),
        };
        if received.is_err() {
            // Nothing more is sent.
            self.input = None;
        }
        received
    }
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

/// A message as one line.
pub(crate) fn to_line(message: &impl Serialize) -> String {
    serde_json::to_string(message).unwrap_or_default()
}

/// A line as a message, or as the plant's own error.
pub(crate) fn parse<T: DeserializeOwned>(
    line: &str,
    number: u64,
    expected: &'static str,
) -> Result<T, PlantError> {
    let malformed = |problem: String| PlantError::Malformed { line: number, expected, problem };
    let value: serde_json::Value =
        serde_json::from_str(line).map_err(|error| malformed(error.to_string()))?;
    if !value.is_object() {
        return Err(malformed("not a JSON object".to_owned()));
    }
    if let Some(text) = value.get("error") {
        return Err(PlantError::Reported(text.as_str().map_or_else(|| text.to_string(), str::to_owned)));
    }
    serde_json::from_value(value).map_err(|error| malformed(error.to_string()))
}

#[cfg(test)]
#[path = "process_tests.rs"]
mod tests;
