//! The rows of a table that are readings: where they end, and what is in them.

use super::RawTable;
use super::cells::{Number, is_missing};
use super::dropouts::CHANCE;
use super::raw::RawColumn;

impl RawTable {
    /// Behind the last row of readings: rows at the end with a word in the first column of numbers are a summary or a note of the program, of which there are fewer than readings.
    pub(super) fn end(&self, rows: &[(usize, Vec<String>)], first: usize, has_decimal_comma: bool) -> usize {
        let Some(column_index) = self.columns.first().map(|column| column.number - 1) else {
            return rows.len();
        };
        fn is_word(cell: &str, has_decimal_comma: bool) -> bool {
            !is_missing(cell)
                && cell.chars().any(char::is_alphabetic)
                && Number::parse(cell, has_decimal_comma).is_none()
        }
        let cells = rows.iter().skip(first).rev().map(|(_, cells)| cells.get(column_index));
        let count =
            cells.take_while(|cell| cell.is_some_and(|cell| is_word(cell, has_decimal_comma))).count();
        if first + 2 * count > rows.len() { rows.len() } else { rows.len() - count }
    }

    /// Adds a row; not where it has no number at all.
    pub(super) fn add(&mut self, line: usize, cells: &[String], has_decimal_comma: bool) -> bool {
        fn read(column: &RawColumn, has_decimal_comma: bool, cells: &[String]) -> Option<Number> {
            cells.get(column.number - 1).and_then(|cell| Number::parse(cell, has_decimal_comma))
        }
        if self.columns.iter().all(|column| read(column, has_decimal_comma, cells).is_none()) {
            return false;
        }
        for column in &mut self.columns {
            let number = read(column, has_decimal_comma, cells);
            let cell = cells.get(column.number - 1).map_or("", String::as_str);
            let value = match number {
                Some(number) => {
                    if !std::mem::replace(&mut column.has_values, true) {
                        column.is_stamp = number.is_stamp;
                        // Without the first whole part, so that the digits behind it are not lost.
                        column.origin = number.whole;
                    }
                    if column.is_stamp == number.is_stamp {
                        number.whole.saturating_sub(column.origin) as f64 + number.rest
                    } else {
                        column.bad.get_or_insert_with(|| (line, cell.to_owned()));
                        f64::NAN
                    }
                }
                None => {
                    if !is_missing(cell) {
                        column.bad.get_or_insert_with(|| (line, cell.to_owned()));
                    }
                    f64::NAN
                }
            };
            column.values.push(value);
        }
        self.lines.push(line);
        true
    }
}

/// Whether the number in the last cell of the last row ends within: with a sign that no row above ends with, or with fewer digits.
pub(super) fn ends_within(rows: &[(usize, Vec<String>)], first: usize) -> bool {
    fn is_open((_, cells): &(usize, Vec<String>)) -> bool {
        cells.last().is_some_and(|cell| cell.ends_with(['.', ',', '-', '+', 'e', 'E']) && !is_missing(cell))
    }
    let Some((last, earlier_rows)) = rows.get(first..).and_then(<[_]>::split_last) else { return false };
    is_open(last) && !earlier_rows.iter().any(is_open) || has_fewer_digits(rows, first)
}

/// Whether the last cell of the last row is shorter behind its decimal sign than that of any row above it, of which all have as many digits.
/// A program that leaves out zeros at the end of a number does so in one row of ten: rows that show that this one does not are so many
/// that they would all be the other nine with a chance below [`CHANCE`].
fn has_fewer_digits(rows: &[(usize, Vec<String>)], first: usize) -> bool {
    fn decimals((_, cells): &(usize, Vec<String>)) -> Option<usize> {
        let cell = cells.last()?;
        Some(cell.rsplit_once(['.', ',']).map_or(0, |(_, decimals)| decimals.len()))
    }
    let Some((last, earlier_rows)) = rows.get(first..).and_then(<[_]>::split_last) else { return false };
    let usual = earlier_rows.first().and_then(decimals);
    let chance = 0.9f64.powi(i32::try_from(earlier_rows.len()).unwrap_or(i32::MAX));
    chance < CHANCE && earlier_rows.iter().all(|row| decimals(row) == usual) && decimals(last) < usual
}

/// Whether a row between the readings names columns: by the names above them in any order, or by a word in each of as many cells.
pub(super) fn are_names(cells: &[String], names: &[String]) -> bool {
    fn is_word(cell: &str) -> bool {
        cell.chars().any(char::is_alphabetic) && !is_missing(cell)
    }
    let known_count = cells.iter().filter(|cell| is_word(cell) && names.contains(cell)).count();
    known_count >= 2
        || cells.len() >= 3 && cells.len() == names.len() && cells.iter().all(|cell| is_word(cell))
}

/// Whether a row is a remark between the readings.
pub(super) fn is_comment(cells: &[String]) -> bool {
    cells.first().is_some_and(|cell| cell.starts_with(['#', '%']) && !is_missing(cell))
}
