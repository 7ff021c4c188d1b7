//! Check of a session without a fit: all errors in its files, suspicious content, and the runs that each workflow can use.

mod capabilities;

pub use suspicions::{Finding, Severity};

use formats::session::{Session, Survey};
use serde::Serialize;
use std::path::Path;
use suspicions;

/// Version of the result.
const SCHEMA: &str = "guide.check/2";

/// Ability of a workflow with the session.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Capability {
    /// The sub-command of `guide`.
    pub command: &'static str,
    /// Whether it would give a result once all errors are corrected.
    pub usable: bool,
    /// Runs that it would use.
    pub runs: Vec<String>,
    /// Runs that it would skip.
    pub skipped: Vec<Skipped>,
    /// Remarks for people.
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
    /// Runs that each command can use, from the content that could be read.
    pub abilities: Vec<Capability>,
}

impl Check {
    /// Number of errors.
    pub fn errors(&self) -> usize {
        self.findings.iter().filter(|finding| finding.severity == Severity::Error).count()
    }
}

/// Checks the session in a folder. It returns a result whatever the folder contains.
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

#[cfg(test)]
mod tests;
