//! Commands as functions: document, figures and notes of `guide ARGUMENTS --json`, for a program that calls them.

use super::output::{Memory, Output};
use super::{Cli, run};
use clap::FromArgMatches;
use device::link::LinkError;
use device::link::program::ProgramError;
use formats::session::{Session, SessionError};
use population::PopulationError;
use serde::Serialize;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// Output of a command.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Called {
    /// The JSON document, byte for byte as the command prints it.
    pub document: String,
    /// Its remarks.
    pub notes: Vec<String>,
    /// Names and SVG texts of its figures, drawn without `--plots` too.
    pub figures: Vec<(String, String)>,
}

/// Kind of a failure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// An option or its value.
    Usage,
    /// A file of a session, of records, or of a model.
    File,
    /// The device or the link to it.
    Device,
    /// The data do not allow the analysis.
    Analysis,
}

/// The place in a file that a failure names; lines and columns count from 1.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct FailedAt {
    /// The file or folder.
    pub path: Option<PathBuf>,
    /// Line.
    pub line: Option<usize>,
    /// Column, in characters.
    pub column: Option<usize>,
    /// Field or column of a table.
    pub field: Option<String>,
}

/// Why a command has failed.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
pub struct CallError {
    /// One line: what was wrong, where, what is valid.
    pub message: String,
    /// Kind of the failure.
    pub kind: Kind,
    /// Place of the failure.
    pub place: FailedAt,
    /// Output before the failure: `guide check` prints its findings and then fails where there are errors.
    pub called: Box<Called>,
}

/// Document of a failure.
#[derive(Serialize)]
pub(super) struct Failure<'a> {
    schema: &'static str,
    error: &'a str,
    kind: Kind,
    #[serde(flatten)]
    place: &'a FailedAt,
}

impl CallError {
    /// The document that `--json` prints.
    pub(super) fn document(&self) -> Failure<'_> {
        Failure { schema: "guide.failure/1", error: &self.message, kind: self.kind, place: &self.place }
    }
}

/// Runs a command. `arguments` are those of the command line without the program's name, `--json` is implied; `on_step` gets the name
/// of every step of a long computation, and may unwind to end it.
///
/// # Errors
/// As the command; wrong use too.
pub fn call(
    arguments: impl IntoIterator<Item = OsString>,
    on_step: impl Fn(&str) + 'static,
) -> Result<Called, CallError> {
    let arguments: Vec<OsString> = std::iter::once(OsString::from("guide")).chain(arguments).collect();
    if let Err(error) = super::own_effects::define(&arguments) {
        return Err(failure(&error, Called::default()));
    }
    let parsed = super::command().try_get_matches_from(arguments).and_then(|matches| {
        // Help and version are texts, which `Error` carries.
        Cli::from_arg_matches(&matches)
    });
    let cli = parsed.map_err(|error| wrong_use(&error))?;
    let mut output = Output::to_memory(Box::new(on_step));
    let outcome = run(&cli.command, &mut output);
    let Memory { document, notes, figures, .. } = output.into_memory().unwrap_or_else(Memory::empty);
    // A document is made of text.
    let document = String::from_utf8_lossy(&document).into_owned();
    let called = Called { document, notes: notes.into_inner(), figures: figures.into_inner() };
    match outcome {
        Ok(()) => Ok(called),
        Err(error) => Err(failure(&error, called)),
    }
}

/// Reads a session, as every command does first, and drops it.
///
/// # Errors
/// Where it cannot be read; with the place.
pub fn readable(dir: &Path) -> Result<(), CallError> {
    let read = Session::read(dir);
    read.map(drop).map_err(|error| failure(&error.into(), Called::default()))
}

pub(super) fn wrong_use(error: &clap::Error) -> CallError {
    let text = error.to_string();
    let text = text.split("\n\n").next().unwrap_or_default().trim();
    let message = one_line(text.strip_prefix("error: ").unwrap_or(text));
    CallError { message, kind: Kind::Usage, place: FailedAt::default(), called: Box::default() }
}

pub(super) fn failure(error: &anyhow::Error, called: Called) -> CallError {
    let kinds = || {
        error.chain().find_map(|cause| {
            if let Some(error) = cause.downcast_ref::<SessionError>() {
                Some((Kind::File, of_session(error)))
            } else if let Some(error) = cause.downcast_ref::<PopulationError>() {
                Some((kind_of_population(error), of_population(error)))
            } else if cause.is::<LinkError>() || cause.is::<ProgramError>() {
                Some((Kind::Device, FailedAt::default()))
            } else {
                None
            }
        })
    };
    let (kind, location) = kinds().unwrap_or((Kind::Analysis, FailedAt::default()));
    CallError { message: one_line(&format!("{error:#}")), kind, place: location, called: Box::new(called) }
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn at(path: &Path, field: Option<&str>) -> FailedAt {
    FailedAt { path: Some(path.to_owned()), field: field.map(str::to_owned), ..FailedAt::default() }
}

fn of_session(error: &SessionError) -> FailedAt {
    match error {
        SessionError::Io { path, .. } | SessionError::Locked { path, .. } => at(path, None),
        SessionError::Field { place, field, .. } => FailedAt {
            path: Some(place.path.clone()),
            line: Some(place.line),
            column: Some(place.column),
            field: Some(field.clone()),
        },
        SessionError::OtherRig { path, field, .. }
        | SessionError::OtherTissue { path, field, .. }
        | SessionError::OutOfRange { path, field, .. }
        | SessionError::NotFinite { path, field } => at(path, Some(field)),
        SessionError::Id { path, .. } => at(path, Some("id")),
    }
}

fn kind_of_population(error: &PopulationError) -> Kind {
    match error {
        PopulationError::Io { .. } | PopulationError::Line { .. } | PopulationError::Twice { .. } => {
            Kind::File
        }
        PopulationError::UnknownName { .. } => Kind::Usage,
        _ => Kind::Analysis,
    }
}

fn of_population(error: &PopulationError) -> FailedAt {
    match error {
        PopulationError::Io { path, .. } => at(path, None),
        PopulationError::Line { path, line, column, .. } => {
            FailedAt { path: Some(path.clone()), line: Some(*line), column: Some(*column), field: None }
        }
        PopulationError::Twice { path, line, .. } => FailedAt {
            path: Some(path.clone()),
            line: Some(*line),
            column: None,
            field: Some("session".to_owned()),
        },
        _ => FailedAt::default(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn guide(arguments: &[&str]) -> Result<Called, CallError> {
        call(arguments.iter().map(OsString::from), |_| {})
    }

    #[test]
    fn a_called_command_returns_its_document() {
        let called = guide(&["effects", "tissue.layers"]).expect("the catalogue");
        let document: serde_json::Value = serde_json::from_str(&called.document).expect("JSON");
        assert_eq!(document["schema"], "guide.effects/1");
        assert!(called.document.ends_with("}\n"), "as printed");
    }

    #[test]
    fn a_failure_names_file_line_and_column() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("session.toml");
        std::fs::write(&path, "[session]\nformat = 1\n[needle]\nouter_diameter_mm = \"thick\"\n")
            .expect("a file");
        let dir = folder.path().to_str().expect("plain");
        let error = guide(&["identify", dir]).expect_err("a field of the wrong type");
        assert_eq!(error.kind, Kind::File);
        assert_eq!(error.place.path.as_deref(), Some(path.as_path()), "{error}");
        assert_eq!(error.place.line, Some(4), "{error}");
        // `check` reports the same as a finding, and fails after it.
        let error = guide(&["check", dir]).expect_err("an error");
        assert!(error.called.document.contains("\"line\": 4"), "{}", error.called.document);
    }

    #[test]
    fn wrong_use_is_an_error_and_does_not_end_the_program() {
        let error = guide(&["identify", "x", "--relation", "none"]).expect_err("no such relation");
        assert_eq!(error.kind, Kind::Usage);
        assert!(error.message.contains("none") && !error.message.contains('\n'), "{error}");
    }
}
