//! A forward model in any language: a process that answers lines of JSON (`discrepancy.model/1`).
//!
//! | line to the process | its answer |
//! |---|---|
//! | `{"type": "start", "schema": "discrepancy.model/1"}` | `{"parameters": [..], "sites": [..], "channels": [{"name", "unit"}]}` |
//! | `{"type": "run", "run", "name", "time_s": [..], "columns": {name: [..]}}` | none |
//! | `{"type": "predict", "run", "parameters": {name: value}, "terms": [..]}` | `{"channels": {name: [value \| null]}}` or `{"error": text}` |
//!
//! Runs are numbered from 0. A term has `site`, `regressor` (`null` for a constant), `form`, `values`, and a table `x`, `y` of
//! the law, so that a model needs no formulas: it interpolates the table linearly, extrapolates along the last two nodes, and
//! adds the result at the site. Fields of parameters and sites are those of [`Parameter`] and [`Site`]. The process's standard
//! error is passed on.

use super::data::Run;
use super::form::{Form, Span};
use super::model::{ForwardModel, ModelFailure, Parameter, Site};
use super::term::{Term, Terms};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// Version of the protocol.
pub const SCHEMA: &str = "discrepancy.model/1";
/// Number of nodes of the table of a law: a feature of a hundredth of the range contains at least two.
const NODES: usize = 257;
/// Distance of the nodes on both sides of a jump from the jump, as a fraction of the range.
const JUMP: f64 = 1e-9;
/// Number of characters of an invalid answer that a message quotes.
const QUOTED: usize = 120;

/// A channel that the model predicts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Predicted {
    /// Name.
    pub name: String,
    /// Unit, for reports.
    #[serde(default)]
    pub unit: String,
}

/// A model's description of itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Declaration {
    /// Quantities that every fit estimates.
    pub parameters: Vec<Parameter>,
    /// Sites at which laws may be missing.
    pub sites: Vec<Site>,
    /// Channels that the model predicts.
    pub channels: Vec<Predicted>,
}

/// A law with its values and its table.
#[derive(Serialize)]
struct Table<'a> {
    site: &'a str,
    regressor: Option<&'a str>,
    form: &'static str,
    values: &'a [f64],
    x: Vec<f64>,
    y: Vec<f64>,
}

#[derive(Serialize)]
#[serde(tag = "type", rename_all = "snake_case")]
enum Request<'a> {
    Start { schema: &'static str },
    Run { run: usize, name: &'a str, time_s: &'a [f64], columns: BTreeMap<&'a str, &'a [f64]> },
    Predict { run: usize, parameters: BTreeMap<&'a str, f64>, terms: Vec<Table<'a>> },
}

#[derive(Deserialize)]
struct Answer {
    error: Option<String>,
    channels: Option<BTreeMap<String, Vec<Option<f64>>>>,
}

/// A law as a table.
fn table(term: &Term) -> Table<'_> {
    let Span { from, to, .. } = term.span;
    let length = to - from;
    let shape = term.values.get(term.form.amplitudes().len()).copied();
    let mut x: Vec<f64> = (0..NODES).map(|i| from + length * i as f64 / (NODES - 1) as f64).collect();
    // Jumps and kinks are at zero and at the level.
    let corners = [Some(0.0), shape.filter(|_| term.form != Form::Decay && term.form != Form::Sine)];
    for corner in corners.into_iter().flatten().filter(|corner| from < *corner && *corner < to) {
        x.extend([corner - JUMP * length, corner, corner + JUMP * length]);
    }
    x.sort_by(f64::total_cmp);
    x.dedup();
    if term.regressor.is_none() {
        x.truncate(2);
    }
    let mut y = vec![0.0; x.len()];
    for (x, y) in x.iter().zip(&mut y) {
        term.form.add(&term.values, &[*x], &term.span, std::slice::from_mut(y));
    }
    let (site, regressor) = (term.site.as_str(), term.regressor.as_deref());
    Table { site, regressor, form: term.form.name(), values: &term.values, x, y }
}

/// A process that is a forward model.
pub struct ProcessModel {
    declaration: Declaration,
    timeout: Duration,
    pipes: Mutex<Pipes>,
}

struct Pipes {
    child: Child,
    input: ChildStdin,
    answers: Receiver<std::io::Result<String>>,
    /// Names of the runs that were sent to the process.
    runs: Vec<String>,
}

impl Drop for Pipes {
    fn drop(&mut self) {
        // The process is killed, because it has nothing to save and might not read its input.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn no_input(error: &std::io::Error) -> ModelFailure {
    ModelFailure::Broken(format!("the model process takes no input: {error}"))
}

impl Pipes {
    fn send(&mut self, request: &Request<'_>) -> Result<(), ModelFailure> {
        let mut line = serde_json::to_string(request).map_err(|error| no_input(&error.into()))?;
        line.push('\n');
        self.input.write_all(line.as_bytes()).and_then(|()| self.input.flush()).map_err(|error| {
            match self.child.try_wait() {
                Ok(Some(status)) => {
                    ModelFailure::Broken(format!("the model process has ended with {status}"))
                }
                _ => no_input(&error),
            }
        })
    }

    fn receive<T: for<'a> Deserialize<'a>>(&mut self, timeout: Duration) -> Result<T, ModelFailure> {
        let line = match self.answers.recv_timeout(timeout) {
            Ok(Ok(line)) => line,
            Ok(Err(error)) => {
                return Err(ModelFailure::Broken(format!("the model's answer cannot be read: {error}")));
            }
            Err(RecvTimeoutError::Timeout) => {
                return Err(ModelFailure::Slow { limit_s: timeout.as_secs_f64() });
            }
            Err(RecvTimeoutError::Disconnected) => {
                let ended =
                    self.child.wait().map_or_else(|error| error.to_string(), |status| status.to_string());
                return Err(ModelFailure::Broken(format!("the model process has ended with {ended}")));
            }
        };
        serde_json::from_str(&line).map_err(|error| {
            let quoted: String = line.chars().take(QUOTED).collect();
            let expected = format!("a line of {SCHEMA}, with null for a missing number");
            ModelFailure::Broken(format!("the model answered {quoted:?}: {error}; expected {expected}"))
        })
    }
}

impl ProcessModel {
    /// Starts a program with its arguments and reads its declaration. No answer may take longer than the time-out.
    ///
    /// # Errors
    /// [`ModelFailure::Broken`] where it cannot be started or does not speak the protocol, [`ModelFailure::Slow`].
    pub fn start(program: &str, arguments: &[String], timeout: Duration) -> Result<Self, ModelFailure> {
        let mut command = Command::new(program);
        command.args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::inherit());
        let mut child = command
            .spawn()
            .map_err(|error| ModelFailure::Broken(format!("cannot start {program:?}: {error}")))?;
        let (Some(input), Some(output)) = (child.stdin.take(), child.stdout.take()) else {
            return Err(ModelFailure::Broken(format!("{program:?} has no standard input or output")));
        };
        let (answered, answers) = channel();
        std::thread::spawn(move || {
            for line in BufReader::new(output).lines() {
                if answered.send(line).is_err() {
                    break;
                }
            }
        });
        let mut pipes = Pipes { child, input, answers, runs: Vec::new() };
        pipes.send(&Request::Start { schema: SCHEMA })?;
        let declaration: Declaration = pipes.receive(timeout)?;
        if let Some(Site { name, .. }) = declaration
            .sites
            .iter()
            .find(|site| site.regressors.iter().any(|one| one.history) && site.adds_to.is_none())
        {
            let text = format!(
                "site {name:?}: a law with a history has no table; expected history only where adds_to is"
            );
            return Err(ModelFailure::Broken(text));
        }
        Ok(Self { declaration, timeout, pipes: Mutex::new(pipes) })
    }

    /// Sets another time-out for predictions, for a program that starts slowly and answers fast.
    pub fn with_timeout(self, timeout: Duration) -> Self {
        Self { timeout, ..self }
    }

    /// The model's description of itself.
    pub fn declaration(&self) -> &Declaration {
        &self.declaration
    }
}

impl ForwardModel for ProcessModel {
    fn parameters(&self) -> &[Parameter] {
        &self.declaration.parameters
    }

    fn sites(&self) -> &[Site] {
        &self.declaration.sites
    }

    fn predict(
        &self,
        run: &Run,
        parameters: &[f64],
        terms: &Terms<'_>,
    ) -> Result<Vec<Vec<f64>>, ModelFailure> {
        let mut pipes = self.pipes.lock().unwrap_or_else(PoisonError::into_inner);
        let number = match pipes.runs.iter().position(|name| *name == run.name) {
            Some(number) => number,
            None => {
                let number = pipes.runs.len();
                let columns =
                    run.columns.iter().map(|one| (one.name.as_str(), one.values.as_slice())).collect();
                pipes.send(&Request::Run { run: number, name: &run.name, time_s: &run.time_s, columns })?;
                pipes.runs.push(run.name.clone());
                number
            }
        };
        let named = self.declaration.parameters.iter().zip(parameters);
        let parameters = named.map(|(parameter, value)| (parameter.name.as_str(), *value)).collect();
        let terms = terms.list().iter().map(table).collect();
        pipes.send(&Request::Predict { run: number, parameters, terms })?;
        let Answer { error, channels } = pipes.receive(self.timeout)?;
        if let Some(error) = error {
            return Err(ModelFailure::Failed(error));
        }
        let channels = channels.unwrap_or_default();
        run.channels
            .iter()
            .map(|channel| {
                let values = channels.get(&channel.name).ok_or_else(|| {
                    let names: Vec<&str> = channels.keys().map(String::as_str).collect();
                    let (expected, answered) = (&channel.name, names.join(", "));
                    ModelFailure::Broken(format!(
                        "the model answered channels {answered:?}; expected {expected:?} among them"
                    ))
                })?;
                Ok(values.iter().map(|value| value.unwrap_or(f64::NAN)).collect())
            })
            .collect()
    }

    fn is_parallel(&self) -> bool {
        false
    }
}
