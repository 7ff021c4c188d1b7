//! The engine of the page `guide.html`: the product's own crates behind one function that takes a request and returns an answer, both
//! JSON. Results are the documents that the program prints with `--json`, by the same functions.
//!
//! It runs in two ways: compiled to WebAssembly (`wasm32-wasip1`) in a worker of the browser, where the page is its file system; and
//! natively in tests. It reads sessions with the readers of the program, keeps costly results between requests, and writes no files.
//!
//! # Example
//!
//! ```
//! let mut engine = web::Engine::default();
//! let answer = engine.answer(r#"{"do": "check", "dir": "no-such-session"}"#, |_| {});
//! assert!(answer.contains("no-such-session/session.toml"));
//! ```
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod answer;
mod blocks;
mod drawing;
mod live;
mod plan;
mod play;
mod populations;
mod request;
mod results;
mod series;
mod tables;

pub use answer::AnswerError;
pub use request::Request;

use inference::diagnose::Workbench;
use std::path::PathBuf;

/// Answers requests, and keeps costly results between them.
#[derive(Debug, Default)]
pub struct Engine {
    /// The session on which effects are tried, with the model of its tissue: springs or body.
    bench: Option<(PathBuf, String, Workbench)>,
    /// The device that is followed.
    follower: live::Follower,
}

impl Engine {
    /// The answer to a request: `{"ok": ...}`, or `{"error": "..."}` with one line. `on_progress` receives a line for each step of a
    /// slow computation.
    pub fn answer(&mut self, request: &str, on_progress: impl FnMut(&str)) -> String {
        let outcome = Request::parse(request)
            .map_err(AnswerError::from)
            .and_then(|request| self.carry_out(&request, on_progress));
        match outcome {
            // The document is JSON already.
            Ok(document) => format!("{{\"ok\":{document}}}"),
            Err(error) => {
                let line = error.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
                format!("{{\"error\":{}}}", serde_json::Value::from(line))
            }
        }
    }

    fn carry_out(&mut self, request: &Request, on_progress: impl FnMut(&str)) -> Result<String, AnswerError> {
        match request {
            Request::Effects {} => results::effects(),
            Request::Check { dir } => results::check(dir),
            Request::Session { dir } => series::session(dir),
            Request::Identify { dir, relation, foundation } => {
                results::identification(dir, relation.as_deref(), foundation.as_deref())
            }
            Request::Diagnose { dir } => results::diagnosis(dir, on_progress),
            Request::Investigation { dir } => results::investigation(dir),
            Request::Predict { dir, until_mm, model } => {
                results::prediction(dir, *until_mm, model.as_deref())
            }
            Request::Try { dir, foundation, effects } => {
                results::trial(&mut self.bench, dir, foundation, effects)
            }
            Request::Plan(input) => plan::plan(input),
            Request::Blocks(input) => blocks::blocks(input),
            Request::Summarize { dir } => populations::summarize(dir),
            Request::Population { files, by } => populations::population(files, by),
            Request::Follow { file, fresh } => {
                if *fresh {
                    self.follower = live::Follower::default();
                }
                self.follower.take(file)
            }
            Request::Ask { id, connection } => live::ask(*id, *connection),
            Request::Play(input) => play::play(input),
            Request::Table(input) => tables::table(input),
        }
    }
}
