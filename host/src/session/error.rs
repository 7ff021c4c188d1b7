//! What can be wrong with a session, and where.

use std::fmt;
use std::path::{Path, PathBuf};

/// Why a session could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// A file or folder could not be opened, read or written.
    #[error("{}: cannot {action}: {cause}", path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// What was tried.
        action: &'static str,
        /// What the operating system said.
        cause: std::io::Error,
    },
    /// Something in a file is not what the format asks for.
    #[error("{place}: {field}: {problem}, expected {expected}")]
    Field {
        /// Where.
        place: Place,
        /// Name of the field or column, with its table.
        field: String,
        /// What is there.
        problem: Problem,
        /// What should be there.
        expected: String,
    },
    /// A run cannot join a session recorded with other hardware.
    #[error("{}: {field}: the session has {there}, the new run {new}, expected the same needle and rig", path.display())]
    OtherRig {
        /// The session file.
        path: PathBuf,
        /// Name of the differing quantity.
        field: &'static str,
        /// Value in the session.
        there: f64,
        /// Value of the new run.
        new: f64,
    },
    /// A run's id is taken, or cannot be part of a file name.
    #[error("{}: id: \"{id}\" {problem}, expected {expected}", path.display())]
    Id {
        /// The session file.
        path: PathBuf,
        /// The id asked for.
        id: String,
        /// What is wrong with it.
        problem: &'static str,
        /// What is accepted.
        expected: &'static str,
    },
    /// A value to be written is NaN or infinite.
    #[error("{}: {field}: a value to be written is not a finite number, expected one", path.display())]
    NotFinite {
        /// The file.
        path: PathBuf,
        /// Name of the column or field.
        field: &'static str,
    },
}

/// A place in a file; lines and columns count from 1.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place {
    /// File.
    pub path: PathBuf,
    /// Line.
    pub line: usize,
    /// Column, in characters.
    pub column: usize,
}

impl Place {
    /// The place `offset` bytes into `text`, the content of the file at `path`.
    pub(crate) fn at(path: &Path, text: &str, offset: usize) -> Self {
        let before = text.get(..offset).unwrap_or(text);
        let line_start = before.rfind('\n').map_or(0, |newline| newline + 1);
        Self {
            path: path.to_owned(),
            line: before.matches('\n').count() + 1,
            column: before[line_start..].chars().count() + 1,
        }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}:{}", self.path.display(), self.line, self.column)
    }
}

/// What is there instead of the expected.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Problem {
    /// Nothing.
    #[error("missing")]
    Missing,
    /// An empty cell or string.
    #[error("empty")]
    Empty,
    /// A header without rows.
    #[error("no rows")]
    NoRows,
    /// Text that is not a number.
    #[error("\"{0}\" is not a number")]
    NotANumber(String),
    /// NaN or infinity.
    #[error("not a finite number")]
    NotFinite,
    /// A number that cannot be right in this unit.
    #[error("{0} is out of range")]
    OutOfRange(f64),
    /// A value that does not exceed the one before it.
    #[error("{0} does not exceed the value before it")]
    NotIncreasing(f64),
    /// Another kind of value.
    #[error("this is a {0}")]
    WrongType(&'static str),
    /// A name used twice.
    #[error("\"{0}\" is there twice")]
    Duplicate(String),
    /// A name that means nothing here.
    #[error("\"{0}\" is not known")]
    Unknown(String),
    /// A list of another length.
    #[error("a list of {0}")]
    Count(usize),
    /// Not TOML, not CSV or not UTF-8.
    #[error("{0}")]
    Syntax(String),
}

/// Reads a whole text file, without a byte order mark.
pub(crate) fn read_text(path: &Path) -> Result<String, SessionError> {
    let bytes = std::fs::read(path).map_err(|cause| SessionError::Io {
        path: path.to_owned(),
        action: "read",
        cause,
    })?;
    let mut text = String::from_utf8(bytes).map_err(|error| {
        let good = error.utf8_error().valid_up_to();
        let valid = String::from_utf8_lossy(error.as_bytes().get(..good).unwrap_or_default()).into_owned();
        SessionError::Field {
            place: Place::at(path, &valid, good),
            field: "text".to_owned(),
            problem: Problem::Syntax("a byte that is not UTF-8".to_owned()),
            expected: "UTF-8 text".to_owned(),
        }
    })?;
    if text.starts_with('\u{feff}') {
        text.drain(..'\u{feff}'.len_utf8());
    }
    Ok(text)
}
