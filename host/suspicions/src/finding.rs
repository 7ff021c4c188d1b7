//! Findings of a check, with their places.

use formats::session::{Place, SessionError};
use serde::Serialize;
use std::fmt;
use std::path::Path;

/// Severity of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// The session cannot be read.
    Error,
    /// It can, but this may be a mistake.
    Warning,
}

/// An error or a suspicion.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Severity of the finding.
    pub severity: Severity,
    /// The file.
    pub file: String,
    /// Line, from 1, where it is in one.
    pub line: Option<usize>,
    /// Column in characters, from 1.
    pub column: Option<usize>,
    /// Content that was found.
    pub what: String,
    /// Expected content.
    pub expected: Option<String>,
}

impl Finding {
    /// Finding for an error that makes a session unreadable.
    pub fn error(fault: &SessionError) -> Self {
        match fault {
            SessionError::Field { place, field, problem, expected } => Self {
                expected: Some(expected.clone()),
                ..Self::at(Severity::Error, place, format!("{field}: {problem}"))
            },
            SessionError::Io { path, action, cause } => Self {
                severity: Severity::Error,
                file: path.display().to_string(),
                line: None,
                column: None,
                what: format!("cannot {action}: {cause}"),
                expected: Some("a file that can be read".to_owned()),
            },
            other => Self {
                severity: Severity::Error,
                file: String::new(),
                line: None,
                column: None,
                what: other.to_string(),
                expected: None,
            },
        }
    }

    /// A name that the format does not have.
    pub fn unknown(place: &Place, name: &str) -> Self {
        let message = format!("{name}: not part of the format, ignored");
        Self {
            expected: Some("a name that the format has (guide init shows them)".to_owned()),
            ..Self::at(Severity::Warning, place, message)
        }
    }

    /// Something at a place in a file.
    pub fn at(severity: Severity, place: &Place, what: String) -> Self {
        let file = place.path.display().to_string();
        Self { severity, file, line: Some(place.line), column: Some(place.column), what, expected: None }
    }

    /// A warning of a whole file.
    pub(crate) fn warning(file: &Path, what: String, expected: Option<&str>) -> Self {
        Self {
            severity: Severity::Warning,
            file: file.display().to_string(),
            line: None,
            column: None,
            what,
            expected: expected.map(str::to_owned),
        }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.file)?;
        if let (Some(line), Some(column)) = (self.line, self.column) {
            write!(f, ":{line}:{column}")?;
        }
        if !self.file.is_empty() {
            f.write_str(": ")?;
        }
        f.write_str(&self.what)?;
        self.expected.as_ref().map_or(Ok(()), |expected| write!(f, ", expected {expected}"))
    }
}
