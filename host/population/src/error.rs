//! Errors of summaries and of requests to analyse them.

use std::path::PathBuf;

/// The names that sessions state, as what is expected of another one.
fn stated(known: &[String]) -> String {
    match known {
        [] => "a label or covariate, of which `[session]` in session.toml states none here".to_owned(),
        [one] => format!("{one}, the only one stated"),
        many => format!("one of {}", many.join(", ")),
    }
}

/// Why a population cannot be computed.
#[derive(Debug, thiserror::Error)]
pub enum PopulationError {
    /// A file of summaries cannot be read.
    #[error("{}: cannot read: {cause}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        cause: std::io::Error,
    },
    /// A line is no summary.
    #[error("{}:{line}:{column}: {what}, expected one document of `needle.summary/1` per line", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Column, from 1.
        column: usize,
        /// Problem.
        what: String,
    },
    /// Two summaries are of the same session.
    #[error("{}:{line}: session: \"{id}\" is there twice, expected each session once", path.display())]
    Twice {
        /// The file of the second.
        path: PathBuf,
        /// Its line, from 1.
        line: usize,
        /// The session.
        id: String,
    },
    /// A name is no label and no covariate of any session.
    #[error("{option}: \"{name}\" is stated by no session, expected {}", stated(known))]
    UnknownName {
        /// The option that has it.
        option: &'static str,
        /// The name.
        name: String,
        /// Names that there are.
        known: Vec<String>,
    },
    /// A covariate is not a number.
    #[error(
        "--covariate: \"{name}\" of session \"{session}\" is a text, expected numbers; --by groups by texts"
    )]
    NotANumber {
        /// The covariate.
        name: String,
        /// The session.
        session: String,
    },
    /// No summary remains to be analysed.
    #[error("{sessions} sessions, none with a modulus that can be used, expected at least 1: {reason}")]
    Empty {
        /// Number of summaries.
        sessions: usize,
        /// Why the first of them cannot be used.
        reason: String,
    },
    /// The parameters of the mean are not identifiable.
    #[error(
        "group {group}: {sessions} sessions do not determine a mean and {covariates} covariates, expected more sessions or fewer covariates"
    )]
    Undetermined {
        /// The group.
        group: String,
        /// Its sessions.
        sessions: usize,
        /// Number of covariates.
        covariates: usize,
    },
}
