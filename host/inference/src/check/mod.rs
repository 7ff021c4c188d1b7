//! Whether a session is right, and what can be done with it: every fault of every file, what can be read but is suspect, and
//! which workflow can use which run. Nothing is fitted.

mod capabilities;
mod suspicions;

pub(crate) use suspicions::{MIN_MOTION_M, suspicions_of_identification};

use formats::session::{Place, Session, SessionError, Survey};
use serde::Serialize;
use std::fmt;
use std::path::Path;

/// Version of the result.
const SCHEMA: &str = "guide.check/2";

/// How much a finding matters.
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
    /// How much it matters.
    pub severity: Severity,
    /// The file.
    pub file: String,
    /// Line, from 1, where it is in one.
    pub line: Option<usize>,
    /// Column in characters, from 1.
    pub column: Option<usize>,
    /// What is there.
    pub what: String,
    /// What was expected.
    pub expected: Option<String>,
}

/// What a workflow could do with the session.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Capability {
    /// The sub-command of `guide`.
    pub command: &'static str,
    /// Whether it would give a result, once nothing is wrong.
    pub usable: bool,
    /// Runs that it would use.
    pub runs: Vec<String>,
    /// Runs that it would skip.
    pub skipped: Vec<Skipped>,
    /// More of it, for people.
    pub remarks: Vec<String>,
}

/// A run that a workflow cannot use.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Skipped {
    /// The run; none where there is no such run at all.
    pub id: Option<String>,
    /// Why.
    pub reason: String,
}

/// The result of a check.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Check {
    /// Version of this result.
    pub schema: &'static str,
    /// Its name, where it has one.
    pub session: Option<String>,
    /// Whether it can be read, and is either empty or of use to some command.
    pub usable: bool,
    /// Whether it has no runs at all.
    pub empty: bool,
    /// Errors first.
    pub findings: Vec<Finding>,
    /// What each command would be able to do, with what could be read.
    pub abilities: Vec<Capability>,
}

impl Check {
    /// Number of errors.
    pub fn errors(&self) -> usize {
        self.findings.iter().filter(|finding| finding.severity == Severity::Error).count()
    }
}

/// Checks the session in a folder. There is a result for any content.
pub fn check(dir: &Path) -> Check {
    let Survey { session, faults, unknown, misspelt, cut_rows, outside } = Session::survey(dir);
    let mut findings: Vec<Finding> = Vec::new();
    for fault in &faults {
        let finding = Finding::error(fault);
        // Two runs may share a file.
        if !findings.contains(&finding) {
            findings.push(finding);
        }
    }
    findings.extend(unknown.iter().map(|(place, name)| Finding::unknown(place, name)));
    findings.extend(misspelt.iter().map(|(place, name, meant)| Finding {
        expected: Some(format!("{meant}, if that is meant")),
        ..Finding::at(Severity::Warning, place, format!("header: \"{name}\" is not known, ignored"))
    }));
    findings.extend(cut_rows.iter().map(|place| Finding {
        expected: Some("a line that ends; `guide recover` finds the rest in the raw recording".to_owned()),
        ..Finding::at(
            Severity::Warning,
            place,
            "row: the last line is cut off, skipped: the recording ended in it".to_owned(),
        )
    }));
    findings.extend(outside.iter().map(|(place, name)| Finding {
        expected: Some("a file in it, so that the folder can be moved as a whole".to_owned()),
        ..Finding::at(Severity::Warning, place, format!("{name}: is outside the session's folder"))
    }));
    let mut abilities = Vec::new();
    let mut empty = false;
    if let Some(session) = &session {
        findings.extend(suspicions::of(session));
        abilities = capabilities::of(session);
        empty = faults.is_empty()
            && session.lateral.is_empty()
            && session.insertion.is_empty()
            && session.indentation.is_empty()
            && session.steering.is_empty();
    }
    let usable = faults.is_empty() && (empty || abilities.iter().any(|ability| ability.usable));
    let session = session.and_then(|session| session.name);
    Check { schema: SCHEMA, session, usable, empty, findings, abilities }
}

impl Finding {
    fn error(fault: &SessionError) -> Self {
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

    fn unknown(place: &Place, name: &str) -> Self {
        let what = format!("{name}: not part of the format, ignored");
        Self {
            expected: Some("a name that the format has (guide init shows them)".to_owned()),
            ..Self::at(Severity::Warning, place, what)
        }
    }

    fn at(severity: Severity, place: &Place, what: String) -> Self {
        let file = place.path.display().to_string();
        Self { severity, file, line: Some(place.line), column: Some(place.column), what, expected: None }
    }

    /// A warning of a whole file.
    fn warning(file: &Path, what: String, expected: Option<&str>) -> Self {
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

#[cfg(test)]
mod tests;
