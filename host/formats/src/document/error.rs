//! Errors of a session, with their place.

use std::fmt;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

/// Why a session could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// A file or folder could not be opened, read or written.
    #[error("{}: cannot {action}: {cause}", path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// Action that failed.
        action: &'static str,
        /// Error of the operating system.
        cause: std::io::Error,
    },
    /// Something in a file is not what the format requires.
    #[error("{place}: {field}: {problem}, expected {expected}")]
    Field {
        /// Place of the error.
        place: Place,
        /// Name of the field or column, with its table.
        field: String,
        /// Content of the place.
        problem: Problem,
        /// Expected content.
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
    /// A run cannot join a session that states another tissue.
    #[error("{}: tissue.{field}: the session states {there}, the new run {new}, expected the same tissue", path.display())]
    OtherTissue {
        /// The session file.
        path: PathBuf,
        /// Name of the field that differs.
        field: &'static str,
        /// Value in the session.
        there: String,
        /// Value of the new run.
        new: String,
    },
    /// Another writer has the session.
    #[error("{}: {holder} writes to this session: wait until it has ended, or use another folder", path.display())]
    Locked {
        /// The session's folder.
        path: PathBuf,
        /// Who it is.
        holder: String,
    },
    /// A run's id is taken, or cannot be part of a file name.
    #[error("{}: id: \"{id}\" {problem}, expected {expected}", path.display())]
    Id {
        /// The session file.
        path: PathBuf,
        /// The requested id.
        id: String,
        /// Problem of the content.
        problem: &'static str,
        /// Accepted content.
        expected: &'static str,
    },
    /// A value to be written is one that the format does not have.
    #[error("{}: {field}: {value} is out of range, expected a number from {} to {}", path.display(), range[0], range[1])]
    OutOfRange {
        /// The file.
        path: PathBuf,
        /// Name of the column.
        field: &'static str,
        /// The value, in the unit of the column.
        value: f64,
        /// Least and greatest value that the format has.
        range: [f64; 2],
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
    pub fn at(path: &Path, text: &str, offset: usize) -> Self {
        let preceding_text = text.get(..offset).unwrap_or(text);
        let (mut line, mut line_start) = (1, 0);
        for (at, end) in preceding_text.match_indices(['\n', '\r']) {
            line_start = at + end.len();
            // A carriage return followed by a newline counts as one line.
            line += usize::from(end == "\n" || !text.get(line_start..).is_some_and(|t| t.starts_with('\n')));
        }
        let column = preceding_text.get(line_start..).unwrap_or_default().chars().count() + 1;
        Self { path: path.to_owned(), line, column }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}:{}", self.path.display(), self.line, self.column)
    }
}

/// Content in place of the expected one.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Problem {
    /// Missing.
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
    #[error("this is {article} {0}", article = article(.0))]
    WrongType(&'static str),
    /// A number with a fraction where there can be none.
    #[error("{0} is not a whole number")]
    NotWhole(f64),
    /// Missing, but a similar name is there.
    #[error("missing, but there is \"{0}\"")]
    Misspelt(String),
    /// A file that is named here cannot be read: its path, and the error of the operating system.
    #[error("cannot read {0}")]
    Unreadable(String),
    /// A name used twice.
    #[error("\"{0}\" appears twice")]
    Duplicate(String),
    /// A name that means nothing here.
    #[error("\"{0}\" is not known")]
    Unknown(String),
    /// A version of the format that is not read.
    #[error("{0} is not known")]
    Unsupported(String),
    /// A list of another length.
    #[error("a list of {0}")]
    Count(usize),
    /// Not TOML, not CSV or not UTF-8.
    #[error("{0}")]
    Syntax(String),
}

fn article(noun: &str) -> &'static str {
    if noun.starts_with(['a', 'e', 'i', 'o', 'u']) { "an" } else { "a" }
}

/// The two halves of a parser's message: what is wrong, and what was expected where it is stated.
pub fn split_message(message: &str, otherwise: &str) -> (Problem, String) {
    let (problem, expected) = match message.strip_prefix("expected ") {
        Some(expected) => ("unexpected text", expected),
        None => message.split_once(", expected ").unwrap_or((message, otherwise)),
    };
    (Problem::Syntax(problem.trim().to_owned()), expected.trim().to_owned())
}

/// Most bytes that are read of what has no end of its own, such as a device.
const MAX_BYTES: u64 = 64 << 20;

/// Reads a whole text file, without a byte order mark.
pub fn read_text(path: &Path) -> Result<String, SessionError> {
    text(path, read_bytes(path)?)
}

/// As [`read_text`], of another program, whose text may be UTF-16 with its mark.
pub fn read_foreign_text(path: &Path) -> Result<String, SessionError> {
    fn wide(rest: &[u8], letter: fn([u8; 2]) -> u16) -> Vec<u8> {
        let letters = char::decode_utf16(rest.as_chunks::<2>().0.iter().map(|pair| letter(*pair)));
        letters.map(|letter| letter.unwrap_or(char::REPLACEMENT_CHARACTER)).collect::<String>().into_bytes()
    }
    let bytes = match read_bytes(path)?.as_slice() {
        [0xff, 0xfe, rest @ ..] => wide(rest, u16::from_le_bytes),
        [0xfe, 0xff, rest @ ..] => wide(rest, u16::from_be_bytes),
        bytes => bytes.to_vec(),
    };
    text(path, bytes)
}

fn text(path: &Path, bytes: Vec<u8>) -> Result<String, SessionError> {
    fn fault(place: Place, what: &str, expected: &str) -> SessionError {
        SessionError::Field {
            place,
            field: "text".to_owned(),
            problem: Problem::Syntax(what.to_owned()),
            expected: expected.to_owned(),
        }
    }
    if bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]) {
        return Err(fault(Place::at(path, "", 0), "this is UTF-16", "UTF-8 text (save it as UTF-8)"));
    }
    let mut text = String::from_utf8(bytes).map_err(|error| {
        let good = error.utf8_error().valid_up_to();
        let valid = String::from_utf8_lossy(error.as_bytes().get(..good).unwrap_or_default()).into_owned();
        fault(Place::at(path, &valid, good), "a byte that is not UTF-8", "UTF-8 text")
    })?;
    if text.starts_with('\u{feff}') {
        text.drain(..'\u{feff}'.len_utf8());
    }
    // A power cut leaves such bytes, UTF-16 without its mark has them, and no number is written with them.
    match text.find('\0') {
        Some(nul) => Err(fault(Place::at(path, &text, nul), "a NUL byte", "UTF-8 text without any")),
        None => Ok(text),
    }
}

fn read_bytes(path: &Path) -> Result<Vec<u8>, SessionError> {
    all_bytes(path).map_err(|cause| SessionError::Io { path: path.to_owned(), action: "read", cause })
}

fn all_bytes(path: &Path) -> io::Result<Vec<u8>> {
    let file = File::open(path)?;
    let mut bytes = Vec::new();
    if file.metadata()?.is_file() {
        (&file).read_to_end(&mut bytes)?;
    // No text has a NUL byte: what is behind one is not waited for.
    } else if BufReader::new((&file).take(MAX_BYTES + 1)).read_until(0, &mut bytes)? as u64 > MAX_BYTES {
        return Err(io::Error::other("this is no file, and does not end"));
    }
    Ok(bytes)
}
