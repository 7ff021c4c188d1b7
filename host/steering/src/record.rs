//! The record of a run, one JSON object a line in the order of what happened, and its replay.
//!
//! `{"command":..}` and `{"plant":..}` hold the lines of the protocol to the byte; `{"decision":..}` what was decided from them;
//! `{"malformed":".."}` a line of the plant that is no JSON, `{"failure":..}` why none came; `{"options":..}` stands first, `{"fault":..}` or `{"outcome":..}` last. A
//! controller that is given the same lines sends the same commands: [`ReplayPlant`] answers from a record and compares them.

use crate::controller::Options;
use crate::line::{parse, to_line};
use crate::plant::{Plant, PlantError};
use crate::protocol::{Answer, Command, Done, End, Statement};
use serde::Serialize;
use std::collections::VecDeque;
use std::io::Write;
use std::sync::{Arc, Mutex};

/// File in which a run is recorded.
#[derive(Clone, Default)]
pub struct Record {
    to: Option<Arc<Mutex<Writing>>>,
}

struct Writing {
    to: Box<dyn Write + Send>,
    failed: Option<String>,
}

impl std::fmt::Debug for Record {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Record").field("kept", &self.to.is_some()).finish()
    }
}

impl Record {
    /// Into a writer. Every line is flushed: what is lost of a run is at most its last line.
    pub fn new(to: impl Write + Send + 'static) -> Self {
        Self { to: Some(Arc::new(Mutex::new(Writing { to: Box::new(to), failed: None }))) }
    }

    fn line(&self, kind: &str, json: &str) {
        let Some(mut writing) = self.to.as_ref().and_then(|to| to.lock().ok()) else { return };
        let written = writeln!(writing.to, "{{\"{kind}\":{json}}}").and_then(|()| writing.to.flush());
        if let Err(error) = written {
            writing.failed.get_or_insert(error.to_string());
        }
    }

    /// A line sent to the plant.
    pub(crate) fn sent(&self, line: &str) {
        self.line("command", line);
    }

    /// A line received from it.
    pub(crate) fn received(&self, line: &str) {
        match serde_json::from_str::<serde::de::IgnoredAny>(line) {
            Ok(_) => self.line("plant", line),
            Err(_) => self.line("malformed", &to_line(&line)),
        }
    }

    /// Why a run cannot go on, where no line of the plant has it.
    pub fn failure(&self, error: PlantError) -> PlantError {
        self.note("failure", &error);
        error
    }

    /// Anything else: `options`, `decision`, `outcome`, `fault`.
    pub fn note(&self, kind: &'static str, what: &impl Serialize) {
        self.line(kind, &to_line(what));
    }

    /// Why it is not complete, where it is not.
    pub fn failed(&self) -> Option<String> {
        self.to.as_ref()?.lock().ok()?.failed.clone()
    }
}

/// A plant that answers from a record, and compares what it is commanded with what was commanded then.
#[derive(Debug)]
pub struct ReplayPlant {
    lines: VecDeque<(String, String)>,
    options: Options,
    decisions: Vec<String>,
    number: u64,
    step: usize,
}

impl ReplayPlant {
    /// From the text of a record.
    ///
    /// # Errors
    /// [`PlantError::Malformed`] where a line is none of a record.
    pub fn new(text: &str) -> Result<Self, PlantError> {
        let mut lines = VecDeque::new();
        let mut decisions = Vec::new();
        let mut options = None;
        // The last line may have been cut off.
        let whole = text.rfind('\n').map_or("", |end| &text[..end]);
        for (number, line) in (1..).zip(whole.lines()) {
            let members = line.strip_prefix("{\"").and_then(|rest| rest.strip_suffix('}'));
            let (kind, json) = members
                .and_then(|rest| rest.split_once("\":"))
                .ok_or_else(|| malformed("not {\"kind\":..}", number))?;
            match kind {
                "command" | "plant" | "malformed" | "failure" => {
                    lines.push_back((kind.to_owned(), json.to_owned()))
                }
                "decision" => decisions.push(json.to_owned()),
                "options" => {
                    options = Some(
                        serde_json::from_str(json).map_err(|error| malformed(&error.to_string(), number))?,
                    );
                }
                _ => {}
            }
        }
        let options = options.ok_or(PlantError::Malformed {
            line: 1,
            expected: "line of a record".into(),
            problem: "no options, expected them in the first line".to_owned(),
        })?;
        Ok(Self { lines, options, decisions, number: 0, step: 0 })
    }

    /// The options that the run had.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// The decisions of the run, as recorded.
    pub fn decisions(&self) -> &[String] {
        &self.decisions
    }

    fn sent(&mut self, message: &impl Serialize) -> Result<(), PlantError> {
        if self.lines.front().is_none_or(|(kind, _)| kind == "failure") {
            return Err(self.end("that the run goes on"));
        }
        self.step += 1;
        let line = to_line(message);
        match self.lines.pop_front() {
            Some((kind, recorded)) if kind == "command" && recorded == line => Ok(()),
            Some((kind, recorded)) if kind == "command" => {
                Err(self.differs(format!("{line} instead of {recorded}")))
            }
            _ => Err(self.differs(format!("{line}, where the recording has no command"))),
        }
    }

    fn differs(&self, difference: String) -> PlantError {
        PlantError::Differs { step: self.step, difference }
    }

    fn received<T: serde::de::DeserializeOwned>(&mut self, expected: &'static str) -> Result<T, PlantError> {
        self.number += 1;
        match self.lines.pop_front() {
            Some((kind, line)) if kind == "plant" => parse(&line, self.number, expected),
            Some((kind, line)) if kind == "malformed" => {
                let line: String = serde_json::from_str(&line).unwrap_or_default();
                parse(&line, self.number, expected)
            }
            Some((kind, line)) => {
                self.lines.push_front((kind, line));
                Err(self.end(expected))
            }
            None => Err(self.end(expected)),
        }
    }

    /// Why the recorded run did not go on.
    fn end(&mut self, expected: &'static str) -> PlantError {
        let failure = self.lines.pop_front().filter(|(kind, _)| kind == "failure");
        failure
            .and_then(|(_, error)| serde_json::from_str(&error).ok())
            .unwrap_or(PlantError::Ended { expected: expected.into(), how: "the record ends here".into() })
    }
}

fn malformed(problem: &str, number: u64) -> PlantError {
    PlantError::Malformed { line: number, expected: "line of a record".into(), problem: problem.to_owned() }
}

impl Plant for ReplayPlant {
    fn start(&mut self) -> Result<Statement, PlantError> {
        self.received("statement")
    }

    fn step(&mut self, command: &Command) -> Result<Answer, PlantError> {
        self.sent(command)?;
        self.received("answer")
    }

    fn end(&mut self) -> Result<End, PlantError> {
        self.sent(&Done { done: true })?;
        self.received("last line")
    }
}

/// A plant of which every line is recorded as that of a program would be.
#[derive(Debug)]
pub struct Recorded<P> {
    /// The plant.
    pub plant: P,
    /// File in which it is recorded.
    pub record: Record,
}

impl<P: Plant> Plant for Recorded<P> {
    fn start(&mut self) -> Result<Statement, PlantError> {
        let stated = self.plant.start().map_err(|error| self.record.failure(error))?;
        self.reparsed(&stated, "statement")
    }

    fn step(&mut self, command: &Command) -> Result<Answer, PlantError> {
        self.record.sent(&to_line(command));
        let answer = self.plant.step(command).map_err(|error| self.record.failure(error))?;
        self.reparsed(&answer, "answer")
    }

    fn end(&mut self) -> Result<End, PlantError> {
        self.record.sent(&to_line(&Done { done: true }));
        let end = self.plant.end().map_err(|error| self.record.failure(error))?;
        self.reparsed(&end, "last line")
    }
}

impl<P> Recorded<P> {
    /// The plant is steered by exactly the values that a replay reads, to the last bit.
    fn reparsed<T: Serialize + serde::de::DeserializeOwned>(
        &self,
        message: &T,
        expected: &'static str,
    ) -> Result<T, PlantError> {
        let line = to_line(message);
        self.record.received(&line);
        parse(&line, 0, expected)
    }
}
