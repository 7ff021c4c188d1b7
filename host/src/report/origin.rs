//! Origin of a report: program, command, date, and the files behind it with their checksums.

use super::page::{Block, Outcome, Section, number, words};
use formats::files::with_slashes;
use formats::session::{Session, SessionError};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::SystemTime;
use time::format_description::well_known::Iso8601;
use time::{Date, OffsetDateTime};

/// Origin of a report. No value here is read from a clock unless the user requests it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Origin {
    /// The command that made it.
    pub command: String,
    /// Day and, where known, time.
    pub date: String,
    /// Files behind it.
    pub files: Vec<FileSum>,
}

/// A file and its checksum.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileSum {
    /// Its name; within the session's folder where it is there.
    pub name: String,
    /// Its length.
    pub bytes: usize,
    /// SHA-256 in hexadecimal, as `sha256sum` prints it.
    pub sha256: String,
}

/// The day that a report is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Day {
    /// Time of the newest file behind it.
    #[default]
    NewestFile,
    /// A day that is given.
    Given(Date),
    /// The day on which it is made: the only choice that depends on the clock.
    Today,
}

impl std::str::FromStr for Day {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "today" => Ok(Self::Today),
            _ => Date::parse(text, &Iso8601::DATE)
                .map(Self::Given)
                .map_err(|_| "expected YYYY-MM-DD, or today"),
        }
    }
}

impl Origin {
    /// Reads the files of a session, and `more` of other places.
    ///
    /// # Errors
    /// [`SessionError::Io`] where one of them cannot be read any more.
    pub fn of(session: &Session, more: &[PathBuf], command: String, day: Day) -> Result<Self, SessionError> {
        let mut paths = Self::paths(session);
        for path in more {
            if !paths.contains(path) {
                paths.push(path.clone());
            }
        }
        let mut newest = SystemTime::UNIX_EPOCH;
        let mut files = Vec::new();
        for path in &paths {
            let (sum, modified) = FileSum::of(path, &session.dir)?;
            newest = newest.max(modified);
            files.push(sum);
        }
        let date = match day {
            Day::NewestFile => format!("{} (newest file)", moment(newest)),
            Day::Given(date) => day_of(date),
            Day::Today => day_of(OffsetDateTime::now_utc().date()),
        };
        Ok(Self { command, date, files })
    }

    /// The files that a session is read from, each once.
    pub(super) fn paths(session: &Session) -> Vec<PathBuf> {
        let lateral = session.lateral.iter().flat_map(|run| [&run.force_path, &run.shape_path]);
        let insertion = session.insertion.iter().map(|run| &run.path);
        let steering = session.steering.iter().map(|run| &run.path);
        let indentation = session.indentation.iter().map(|run| &run.path);
        let of_runs = lateral.chain(insertion).chain(steering).chain(indentation);
        let mut paths = vec![session.dir.join("session.toml")];
        for path in of_runs {
            // Runs may share a file.
            if !paths.contains(path) {
                paths.push(path.clone());
            }
        }
        paths
    }

    /// The program with its source state.
    pub(super) fn program() -> String {
        match env!("GUIDE_GIT") {
            "unknown" => format!("guide {}", env!("CARGO_PKG_VERSION")),
            commit => format!("guide {} ({commit})", env!("CARGO_PKG_VERSION")),
        }
    }

    /// The section.
    pub(super) fn section(&self) -> Section {
        let rows = vec![
            vec!["program".to_owned(), Self::program()],
            vec!["command".to_owned(), self.command.clone()],
            vec!["date".to_owned(), self.date.clone()],
        ];
        let files = self
            .files
            .iter()
            .map(|file| vec![file.name.clone(), file.bytes.to_string(), file.sha256.clone()]);
        let blocks = vec![
            Block::table("What made this report", [words("item"), words("value")], rows),
            Block::table(
                "Files that it was made from",
                [words("file"), number("bytes"), words("SHA-256")],
                files.collect(),
            ),
        ];
        Section { id: "provenance", title: "Provenance", content: Outcome::Found(blocks) }
    }
}

impl FileSum {
    fn of(path: &Path, dir: &Path) -> Result<(Self, SystemTime), SessionError> {
        let io = |cause| SessionError::Io { path: path.to_owned(), action: "read", cause };
        let bytes = fs::read(path).map_err(io)?;
        let modified = fs::metadata(path).and_then(|of| of.modified()).map_err(io)?;
        let name = path.strip_prefix(dir).map_or_else(|_| path.display().to_string(), with_slashes);
        Ok((Self::of_bytes(&name, &bytes), modified))
    }

    /// Checksum of a file with this content.
    pub(super) fn of_bytes(name: &str, bytes: &[u8]) -> Self {
        Self { name: name.to_owned(), bytes: bytes.len(), sha256: checksum(bytes) }
    }
}

/// SHA-256 in hexadecimal.
pub(super) fn checksum(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().fold(String::new(), |mut text, byte| {
        // Writing to a string does not fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

fn day_of(date: Date) -> String {
    format!("{:04}-{:02}-{:02}", date.year(), u8::from(date.month()), date.day())
}

/// A time of a file, to the second.
fn moment(time: SystemTime) -> String {
    let utc = OffsetDateTime::from(time);
    format!("{} {:02}:{:02}:{:02} UTC", day_of(utc.date()), utc.hour(), utc.minute(), utc.second())
}
