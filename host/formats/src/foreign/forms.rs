//! One form of a table from its first row to its last: rows of numbers between other separators, with another decimal sign or of another width are
//! readings too, and none is lost without a word.
//!
//! A program that changes its form writes many such rows, and one line of numbers above a table is often its number of rows or a factor. Two
//! lines or more are rows, and an error at the line where the form changes; a single one is noted.

use super::RawTable;
use super::TableError;
use super::cells::{Number, is_missing};
use super::grid::{SEPARATORS, form_of, split};
use super::readings::is_comment;
use std::path::Path;

/// Numbers of a line that is a row.
const LEAST_NUMBERS: usize = 2;
/// Lines of numbers above a table that are rows of it.
const LEAST_ROWS: usize = 2;

/// Lines of a file, from their number to their cells.
pub(super) type Rows = [(usize, Vec<String>)];

/// Whether every cell that is not empty is a number, of which there are two or more.
fn is_of_numbers(cells: &[String], has_decimal_comma: bool) -> bool {
    let mut numbers = 0;
    let are_numbers = cells.iter().all(|cell| {
        let is_number = Number::parse(cell, has_decimal_comma).is_some();
        numbers += usize::from(is_number);
        is_number || is_missing(cell)
    });
    are_numbers && numbers >= LEAST_NUMBERS
}

/// Whether a cell is neither a number nor empty.
pub(super) fn has_words(cells: &[String], has_decimal_comma: bool) -> bool {
    cells.iter().any(|cell| !is_missing(cell) && Number::parse(cell, has_decimal_comma).is_none())
}

/// The other form in which a line consists of numbers alone, where it does not in its table's own.
pub(super) fn other_form(
    line: &str,
    cells: &[String],
    separator: char,
    has_decimal_comma: bool,
) -> Option<String> {
    if !has_words(cells, has_decimal_comma) {
        return None;
    }
    let forms = SEPARATORS.iter().flat_map(|(other, _)| [(*other, false), (*other, true)]);
    forms
        .filter(|form| {
            *form != (separator, has_decimal_comma) && (*form != (',', true) || line.contains('"'))
        })
        .find(|(other, comma)| is_of_numbers(&split(line, *other), *comma))
        .map(|(other, comma)| form_of(other, comma))
}

/// Form of a table's rows.
pub(super) struct Form<'f> {
    pub path: &'f Path,
    /// As it is shown.
    pub words: &'f str,
    pub has_decimal_comma: bool,
    /// Number of cells of a row.
    pub width: usize,
    /// Lines that are rows in another form, and which.
    pub others: &'f [(usize, String)],
}

impl Form<'_> {
    fn other(&self, line: usize) -> Option<&str> {
        let index = self.others.binary_search_by_key(&line, |(other, _)| *other).ok()?;
        self.others.get(index).map(|(_, form)| form.as_str())
    }

    /// Whether a line is a row, in any form.
    fn is_row(&self, line: usize, cells: &[String]) -> bool {
        self.other(line).is_some() || is_of_numbers(cells, self.has_decimal_comma)
    }

    fn change(&self, line: usize, field: &str, problem: String) -> TableError {
        TableError::Cell {
            path: self.path.to_owned(),
            line,
            field: field.to_owned(),
            problem,
            expected: format!(
                "one form in a file: split it at line {line}, write both parts in one form below the same names, and import the result"
            ),
        }
    }

    /// Refuses rows right above the first one of this form, and notes a single line of numbers there.
    pub fn check_above(
        &self,
        above: &Rows,
        first_line: usize,
        notes: &mut Vec<String>,
    ) -> Result<(), TableError> {
        let lines_above = above.iter().rev().filter(|(_, cells)| !is_comment(cells));
        let lost: Vec<&(usize, Vec<String>)> =
            lines_above.take_while(|(line, cells)| self.is_row(*line, cells)).collect();
        let (Some((last_line, cells)), Some((lost_line, _))) = (lost.first(), lost.last()) else {
            return Ok(());
        };
        let width = cells.len();
        let has = match self.other(*last_line) {
            Some(form) => form.to_owned(),
            None if width == self.width => {
                return self.note_single(*lost_line, "fewer numbers", lost.len(), notes);
            }
            None => format!("{width} columns"),
        };
        if lost.len() < LEAST_ROWS {
            return self.note_single(*lost_line, &has, lost.len(), notes);
        }
        let own_form =
            if self.other(*last_line).is_some() { self.words.to_owned() } else { self.width.to_string() };
        let field =
            if self.other(*last_line).is_some() { "separator and decimal sign" } else { "number of columns" };
        Err(self.change(
            first_line,
            field,
            format!("{own_form} from here on, where lines {lost_line} to {last_line} have {has}"),
        ))
    }

    fn note_single(
        &self,
        line: usize,
        has: &str,
        count: usize,
        notes: &mut Vec<String>,
    ) -> Result<(), TableError> {
        notes.push(format!(
            "line {line}: a line of numbers right above the rows has {has}, and the rows have {} columns: it is not used as a reading (such lines in all: {count})",
            self.width
        ));
        Ok(())
    }

    /// Refuses a row in another form behind the first one.
    pub fn check_behind(&self, behind: &Rows) -> Result<(), TableError> {
        let first_other = behind.iter().find_map(|(line, _)| Some((*line, self.other(*line)?)));
        match first_other {
            None => Ok(()),
            Some((line, form)) => Err(self.change(
                line,
                "separator and decimal sign",
                format!("{form}, where the rows above have {}", self.words),
            )),
        }
    }
}

impl RawTable {
    /// Places of rows that lack numbers, of which it cannot be told which. Refuses rows with more numbers than there are columns, and rows that lack
    /// some at an end of the table: there the columns have changed.
    pub(super) fn short_rows(
        &self,
        kept: &[&[String]],
        width: usize,
        has_decimal_comma: bool,
    ) -> Result<Vec<usize>, TableError> {
        let at_ends = [kept.iter().take_while(|cells| self.is_short(cells, has_decimal_comma)).count(), {
            kept.iter().rev().take_while(|cells| self.is_short(cells, has_decimal_comma)).count()
        }];
        let first_places = [0, kept.len() - at_ends[1]];
        let changed =
            kept.iter().position(|cells| has_surplus(cells, width, has_decimal_comma)).or_else(|| {
                at_ends
                    .iter()
                    .zip(first_places)
                    .find(|(count, _)| **count >= LEAST_ROWS)
                    .map(|(_, place)| place)
            });
        if let Some((cells, line)) = changed.and_then(|place| kept.get(place).zip(self.lines.get(place))) {
            return Err(self.other_width(*line, cells.len(), width));
        }
        Ok((0..kept.len())
            .filter(|place| kept.get(*place).is_some_and(|cells| self.is_short(cells, has_decimal_comma)))
            .collect())
    }

    /// Whether a row lacks numbers at its end.
    fn is_short(&self, cells: &[String], has_decimal_comma: bool) -> bool {
        self.columns.iter().any(|column| column.number > cells.len())
            && is_of_numbers(cells, has_decimal_comma)
    }

    fn other_width(&self, line: usize, count: usize, width: usize) -> TableError {
        TableError::Cell {
            path: self.path.clone(),
            line,
            field: "number of columns".to_owned(),
            problem: format!("{count} cells, where most rows have {width}"),
            expected: "the same columns in every row: split the file where they change, or write an empty cell for a number that is missing"
                .to_owned(),
        }
    }
}

/// Whether a row has numbers behind its last column.
fn has_surplus(cells: &[String], width: usize, has_decimal_comma: bool) -> bool {
    cells.iter().skip(width).any(|cell| Number::parse(cell, has_decimal_comma).is_some())
}
