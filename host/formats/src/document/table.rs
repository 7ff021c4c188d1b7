//! Numeric CSV tables: named columns in any order, `#` comments, every fault with its place.

mod clock;

pub(crate) use clock::Clock;

use super::error::{Place, Problem, SessionError, read_text};
use super::names::misspelt;
use clock::{TIME, less};
use std::path::Path;

/// A column of the format: its name in the file, the factor to SI and the values that can be right, in the file's
/// unit.
#[derive(Debug, Clone, Copy)]
pub struct Column {
    /// Name in the header, with unit.
    pub name: &'static str,
    /// Whether a file without it is refused.
    pub required: bool,
    /// Factor from the file's unit to SI.
    pub to_si: f64,
    /// Least and greatest value that can be right.
    pub range: [f64; 2],
    /// Whether every value must exceed the one before.
    pub increasing: bool,
    /// Whether a value may not be below the one before.
    pub steady: bool,
    /// Whether a cell may be empty or NaN: its value is NaN then.
    pub blank: bool,
    /// Whether a value with a fraction is none.
    pub whole: bool,
}

impl Column {
    /// A column that must be there.
    pub const fn required(name: &'static str, to_si: f64, range: [f64; 2]) -> Self {
        Self {
            name,
            required: true,
            to_si,
            range,
            increasing: false,
            steady: false,
            blank: false,
            whole: false,
        }
    }

    /// A column that may be there.
    pub const fn optional(name: &'static str, to_si: f64, range: [f64; 2]) -> Self {
        Self {
            name,
            required: false,
            to_si,
            range,
            increasing: false,
            steady: false,
            blank: false,
            whole: false,
        }
    }

    /// The same, with values that must increase.
    pub const fn increasing(mut self) -> Self {
        self.increasing = true;
        self
    }

    /// The same, with values that never step back.
    pub const fn steady(mut self) -> Self {
        self.steady = true;
        self
    }

    /// The same, with cells that may be empty or NaN.
    pub const fn blank(mut self) -> Self {
        self.blank = true;
        self
    }

    /// The same, with whole numbers only.
    pub const fn whole(mut self) -> Self {
        self.whole = true;
        self
    }
}

/// The known columns of a table, in SI.
#[derive(Debug)]
pub struct Table {
    columns: Vec<(&'static str, Vec<f64>)>,
    /// Line of the header.
    pub(crate) header_line: usize,
    /// Origin that was subtracted from its times, whole seconds.
    pub(crate) origin_s: i64,
}

impl Table {
    /// Reads the known columns of a CSV file with at least one row; others are ignored.
    ///
    /// # Errors
    /// [`SessionError`] with file, line, column and field.
    pub fn read(path: &Path, known: &[Column]) -> Result<Self, SessionError> {
        Self::parse(path, &read_text(path)?, known, 1)
    }

    /// Reads the known columns of a text with at least so many rows.
    ///
    /// # Errors
    /// [`SessionError`] with file, line, column and field.
    pub(crate) fn parse(
        path: &Path,
        text: &str,
        known: &[Column],
        least_rows: usize,
    ) -> Result<Self, SessionError> {
        Self::parse_on(path, text, known, least_rows, Clock::AsWritten)
    }

    /// As [`Self::read`], but a recording that ended before its first row is a table too, and a last row that is cut off, as a full disk
    /// or a power failure leaves it, is skipped ([`cut_row`]).
    ///
    /// # Errors
    /// [`SessionError`] with file, line, column and field.
    pub fn read_recording(path: &Path, known: &[Column]) -> Result<Self, SessionError> {
        Self::read_recording_on(path, known, Clock::AsWritten)
    }

    /// As [`Self::read_recording`], with times counted from there.
    ///
    /// # Errors
    /// [`SessionError`] with file, line, column and field.
    pub(crate) fn read_recording_on(
        path: &Path,
        known: &[Column],
        clock: Clock,
    ) -> Result<Self, SessionError> {
        let text = read_text(path)?;
        let whole =
            cut_row(path, &text).map_or(text.as_str(), |cut| text.get(..cut.offset).unwrap_or_default());
        Self::parse_on(path, whole, known, 0, clock)
    }

    /// Moves a column out; nothing where the file does not have it.
    pub fn take(&mut self, name: &str) -> Option<Vec<f64>> {
        let index = self.columns.iter().position(|(column, _)| *column == name)?;
        Some(self.columns.swap_remove(index).1)
    }

    /// Whether the file has a column.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.columns.iter().any(|(column, _)| *column == name)
    }

    /// Adds a column that the file does not have.
    pub(crate) fn add(&mut self, name: &'static str, values: Vec<f64>) {
        self.columns.push((name, values));
    }

    /// Number of rows.
    pub(crate) fn rows(&self) -> usize {
        self.columns.first().map_or(0, |(_, values)| values.len())
    }

    /// Moves a required column out.
    pub fn take_required(&mut self, name: &str) -> Vec<f64> {
        self.take(name).unwrap_or_default()
    }

    fn parse_on(
        path: &Path,
        text: &str,
        known: &[Column],
        least_rows: usize,
        clock: Clock,
    ) -> Result<Self, SessionError> {
        let mut reader = csv::ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .comment(Some(b'#'))
            .from_reader(text.as_bytes());
        fn is_blank(cell: &str) -> bool {
            cell.trim().is_empty()
        }
        let mut record = csv::StringRecord::new();
        let location = |record: &csv::StringRecord, index: usize| {
            let start = record.position().map_or(0, csv::Position::byte) as usize;
            Place::at(path, text, cell_offset(text, start, index))
        };
        let fault = |record: &csv::StringRecord, index: usize, field: &str, problem, expected: String| {
            SessionError::Field { place: location(record, index), field: field.to_owned(), problem, expected }
        };
        // The next line that is not blank.
        let mut next = |record: &mut csv::StringRecord| loop {
            let has_record = reader.read_record(record).map_err(|error| {
                let offset = error.position().map_or(0, csv::Position::byte) as usize;
                SessionError::Field {
                    place: Place::at(path, text, offset),
                    field: "row".to_owned(),
                    problem: Problem::Syntax(error.to_string()),
                    expected: "comma-separated values".to_owned(),
                }
            })?;
            // A quotation mark that is never closed would swallow the rows that follow.
            if let Some(index) = record.iter().position(|cell| cell.contains(['\n', '\r'])) {
                let problem = Problem::Syntax("a quotation mark that is not closed on its line".to_owned());
                return Err(fault(record, index, "row", problem, "quotation marks in pairs".to_owned()));
            }
            if !has_record || record.len() != 1 || !record.get(0).is_some_and(is_blank) {
                return Ok(has_record);
            }
        };

        next(&mut record)?;
        let mut header = record.clone();
        header.trim();
        let mut columns_read = Vec::new();
        for column in known {
            let mut column_indices =
                header.iter().enumerate().filter(|(_, name)| *name == column.name).map(|(i, _)| i);
            match (column_indices.next(), column_indices.next()) {
                (Some(_), Some(again)) => {
                    let problem = Problem::Duplicate(column.name.to_owned());
                    return Err(fault(&header, again, "header", problem, "each column once".to_owned()));
                }
                (Some(index), None) => columns_read.push((index, *column, Vec::new())),
                (None, _) if column.required => {
                    let Absent { index, problem, expected } = absent(&header, column, known);
                    return Err(fault(&header, index, column.name, problem, expected));
                }
                (None, _) => {}
            }
        }
        let width = header.len();
        let (mut rows, mut origin_s) = (0, 0);
        while next(&mut record)? {
            rows += 1;
            let has_extra_cells = record.iter().skip(width).any(|cell| !is_blank(cell));
            let short = columns_read.iter().any(|(index, ..)| *index >= record.len());
            if has_extra_cells || short {
                let problem = Problem::Syntax(match record.len() {
                    1 => "1 cell".to_owned(),
                    count => format!("{count} cells"),
                });
                let comma = if has_extra_cells { "; numbers with a decimal point, not a comma" } else { "" };
                let expected = format!("{width}, one for each column of the header{comma}");
                return Err(fault(&record, width.min(record.len()), "row", problem, expected));
            }
            for (index, column, values) in &mut columns_read {
                // Here, and not by the reader, which would make a new record of every row.
                let text = record.get(*index).map(str::trim);
                if rows == 1 && column.name == TIME {
                    origin_s = clock.origin_s(text);
                }
                let origin = if column.name == TIME { origin_s } else { 0 };
                let value = cell(text, column, values.last().copied(), origin).map_err(|problem| {
                    let [least, most] = column.range;
                    let expected = match &problem {
                        Problem::NotIncreasing(_) if column.steady => {
                            "a value that is not below the one before: was the clock set, or are two recordings joined?".to_owned()
                        }
                        Problem::NotIncreasing(_) => "increasing values".to_owned(),
                        Problem::NotWhole(_) => format!("a whole number from {least} to {most}"),
                        Problem::NotANumber(text) if text.replace(',', ".").parse::<f64>().is_ok() => {
                            format!("a number from {least} to {most}, with a decimal point")
                        }
                        _ => format!("a number from {least} to {most}"),
                    };
                    fault(&record, *index, column.name, problem, expected)
                })?;
                values.push(value);
            }
        }
        if rows < least_rows {
            return Err(fault(
                &header,
                0,
                "rows",
                Problem::NoRows,
                "at least one row below the header".to_owned(),
            ));
        }
        let columns = columns_read
            .into_iter()
            .map(|(_, c, values)| (c.name, values.iter().map(|v| v * c.to_si).collect()))
            .collect();
        Ok(Self { columns, header_line: location(&header, 0).line, origin_s })
    }
}

/// The last line of a table, cut off.
pub(crate) struct CutRow {
    /// Position at which it begins.
    pub offset: usize,
    /// The same as a place.
    pub place: Place,
}

/// The last line of a text where it has no line end and fewer cells than the header.
pub(crate) fn cut_row(path: &Path, text: &str) -> Option<CutRow> {
    let offset = text.rfind(['\n', '\r']).map_or(0, |end| end + 1);
    fn is_row(line: &&str) -> bool {
        !line.starts_with('#') && !line.trim().is_empty()
    }
    let (preceding_text, last) = text.split_at_checked(offset)?;
    let header = preceding_text.split(['\n', '\r']).find(is_row)?;
    fn cells(line: &str) -> usize {
        line.matches(',').count()
    }
    let cut = is_row(&last) && cells(last) < cells(header);
    cut.then(|| CutRow { offset, place: Place::at(path, text, offset) })
}

/// Optional columns that are not in the header of a text, where one of a similar name is: its place, its name and
/// the name that was probably intended.
pub(crate) fn misspelt_columns(
    path: &Path,
    text: &str,
    known: &[Column],
) -> Vec<(Place, String, &'static str)> {
    fn is_comment(line: &str) -> bool {
        line.starts_with('#') || line.trim().is_empty()
    }
    let mut start = 0;
    let header = text.split_inclusive(['\n', '\r']).find(|line| {
        let is_header = !is_comment(line);
        start += if is_header { 0 } else { line.len() };
        is_header
    });
    let names: Vec<&str> =
        header.unwrap_or_default().split(',').map(|name| name.trim().trim_matches('"')).collect();
    let unknown_names =
        || names.iter().copied().filter(|name| known.iter().all(|column| column.name != *name));
    let mut misspelt_names = Vec::new();
    for column in known.iter().filter(|column| !column.required && !names.contains(&column.name)) {
        let Some(name) = misspelt(column.name, unknown_names()) else { continue };
        let index = names.iter().position(|other| *other == name).unwrap_or_default();
        misspelt_names.push((
            Place::at(path, text, cell_offset(text, start, index)),
            name.to_owned(),
            column.name,
        ));
    }
    misspelt_names
}

/// A required column that is not in the header: which cell shows it, what is wrong and what was expected.
struct Absent {
    index: usize,
    problem: Problem,
    expected: String,
}

fn absent(header: &csv::StringRecord, column: &Column, known: &[Column]) -> Absent {
    const SEPARATORS: [(char, &str); 3] = [(';', "semicolons"), ('\t', "tabs"), (' ', "spaces")];
    let only = if header.len() == 1 { header.get(0).unwrap_or_default() } else { "" };
    let separator = SEPARATORS.iter().find(|(separator, _)| {
        only.split(*separator).any(|name| known.iter().any(|column| column.name == name.trim()))
            && only.contains(*separator)
    });
    if let Some((_, name)) = separator {
        let problem = Problem::Syntax(format!("missing, the header is separated by {name}"));
        let expected = "commas between columns, and decimal points".to_owned();
        return Absent { index: 0, problem, expected };
    }
    let names: Vec<_> = known.iter().filter(|c| c.required).map(|c| c.name).collect();
    let expected = format!("a header with {}", names.join(", "));
    let unknown_names = header.iter().filter(|name| known.iter().all(|column| column.name != *name));
    let meant = misspelt(column.name, unknown_names);
    match meant.and_then(|meant| Some((meant, header.iter().position(|name| name == meant)?))) {
        Some((meant, index)) => Absent { index, problem: Problem::Misspelt(meant.to_owned()), expected },
        None => Absent { index: 0, problem: Problem::Missing, expected },
    }
}

/// The value of one cell, in the file's unit, less `origin`.
fn cell(text: Option<&str>, column: &Column, before: Option<f64>, origin: i64) -> Result<f64, Problem> {
    let Some(text) = text.filter(|text| !text.is_empty()) else {
        return if column.blank { Ok(f64::NAN) } else { Err(Problem::Empty) };
    };
    let value: f64 = text.parse().map_err(|_| Problem::NotANumber(text.chars().take(40).collect()))?;
    let [least, most] = column.range;
    if value.is_nan() && column.blank {
        return Ok(value);
    }
    let counted = if origin == 0 { value } else { less(text, value, origin) };
    if !value.is_finite() {
        Err(Problem::NotFinite)
    } else if !(least..=most).contains(&value) {
        Err(Problem::OutOfRange(value))
    } else if before
        .is_some_and(|before| column.increasing && counted <= before || column.steady && counted < before)
    {
        Err(Problem::NotIncreasing(value))
    } else if column.whole && value.fract() != 0.0 {
        Err(Problem::NotWhole(value))
    } else {
        Ok(counted)
    }
}

/// Byte offset of the cell `index` of the record that starts at or after `start` (comments may come first).
fn cell_offset(text: &str, start: usize, index: usize) -> usize {
    let mut line_start = start.min(text.len());
    for line in text.get(line_start..).unwrap_or_default().split_inclusive(['\n', '\r']) {
        if !line.starts_with('#') && !line.trim().is_empty() {
            let mut quoted = false;
            let comma = |(_, c): &(usize, char)| {
                quoted ^= *c == '"';
                *c == ',' && !quoted
            };
            let cell = index.checked_sub(1).map(|commas| line.char_indices().filter(comma).nth(commas));
            return line_start
                + match cell {
                    None => 0,
                    Some(Some((comma, _))) => comma + 1,
                    Some(None) => line.trim_end().len(),
                };
        }
        line_start += line.len();
    }
    line_start
}

#[cfg(test)]
mod tests;
