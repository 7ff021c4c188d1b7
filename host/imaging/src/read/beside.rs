//! Data in files beside a header: one, a list of names, or a pattern with a number in it.

use super::header::short;
use crate::error::ImagingError;
use crate::frame::MAX_FRAMES;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// The files that a field names: `frame.raw`, or `frame%03d.raw 1 40 1` with first and last number and their step.
///
/// # Errors
/// Names that lead out of the folder, and patterns that are none.
pub(super) fn files(path: &Path, field: &str, value: &str) -> Result<Vec<PathBuf>, ImagingError> {
    let whole = beside(path, field, value);
    if !value.contains('%') || whole.as_ref().is_ok_and(|file| file.exists()) {
        return Ok(vec![whole?]);
    }
    let expected =
        "a file beside this one, or a name with one %d and behind it first number, last number and step";
    let invalid = || ImagingError::invalid(path, field, format!("\"{}\"", short(value)), expected);
    let words: Vec<&str> = value.split_whitespace().collect();
    let (numbers, name): (Vec<&str>, Vec<&str>) = words.iter().partition(|word| word.parse::<i64>().is_ok());
    let (&[pattern], Some(&[first, last])) = (name.as_slice(), numbers.first_chunk::<2>()) else {
        return Err(invalid());
    };
    let number = |text: &str| text.parse::<i64>().map_err(|_| invalid());
    let (first, last) = (number(first)?, number(last)?);
    let step = number(numbers.get(2).copied().unwrap_or("1"))?;
    // A step towards the last number, which is one of them.
    let count =
        (last.saturating_sub(first)).checked_div(step).filter(|count| (0..MAX_FRAMES as i64).contains(count));
    let count = count.ok_or_else(invalid)?;
    (0..=count)
        .map(|at| {
            let name =
                numbered(pattern, first.saturating_add(at.saturating_mul(step))).ok_or_else(invalid)?;
            beside(path, field, &name)
        })
        .collect()
}

/// A file in the folder of the header. Its name is a file's own: it may not lead out of that folder.
///
/// # Errors
/// Other names.
pub(super) fn beside(path: &Path, field: &str, name: &str) -> Result<PathBuf, ImagingError> {
    let plain = name.strip_prefix("./").unwrap_or(name);
    let is_plain = !plain.is_empty() && plain != ".." && !plain.contains(['/', '\\']);
    path.parent().map(|folder| folder.join(plain)).filter(|_| is_plain).ok_or_else(|| {
        let problem = format!("\"{}\"", short(name));
        ImagingError::invalid(path, field, problem, "LOCAL or a file beside this one")
    })
}

/// A name with a number in the place of `%d` or `%03d`.
fn numbered(pattern: &str, number: i64) -> Option<String> {
    let (before, rest) = pattern.split_once('%')?;
    let (width, after) = rest.split_once(['d', 'i', 'u'])?;
    if after.contains('%') || !width.bytes().all(|digit| digit.is_ascii_digit()) || width.len() > 2 {
        return None;
    }
    let fill = width.parse().unwrap_or(0);
    Some(if width.starts_with('0') {
        format!("{before}{number:0fill$}{after}")
    } else {
        format!("{before}{number:fill$}{after}")
    })
}

/// Opens the data in a file.
type Opener = Box<dyn Fn(&Path) -> Result<Box<dyn Read>, ImagingError>>;

/// The data of files one behind the other, as many bytes of each.
pub(super) struct Joined {
    files: std::vec::IntoIter<PathBuf>,
    open: Opener,
    each: u64,
    current: io::Take<Box<dyn Read>>,
}

impl Joined {
    /// Joins files with `needed` bytes in all, and opens the first one.
    ///
    /// # Errors
    /// Frames that cannot be parted among the files, and a first file that is none.
    pub(super) fn new(
        path: &Path,
        field: &str,
        files: Vec<PathBuf>,
        (count, needed): (usize, u64),
        open: Opener,
    ) -> Result<Self, ImagingError> {
        let number = files.len();
        if number == 0 || !count.is_multiple_of(number) {
            let expected = format!("as many files as there are frames, {count}, or a whole part of it");
            return Err(ImagingError::invalid(path, field, format!("{number} files"), expected));
        }
        let each = needed / number as u64;
        let mut files = files.into_iter();
        let first: Box<dyn Read> = match files.next() {
            Some(first) => open(&first)?,
            None => Box::new(io::empty()),
        };
        Ok(Self { files, open, each, current: first.take(each) })
    }
}

impl Read for Joined {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.current.limit() == 0
            && let Some(next) = self.files.next()
        {
            let data = (self.open)(&next).map_err(|error| io::Error::other(error.to_string()))?;
            self.current = data.take(self.each);
        }
        self.current.read(buffer)
    }
}
