//! Rows and numbers that a table marks as no readings.

use super::{RawTable, marks, status};

/// Numbers from which on no reading is: no counter, no clock and no converter has more than 64 bits. Instruments with SCPI commands send
/// 9.9e37 in place of a reading that is out of range, trackers of NDI -3.7e28 for a tool that is not seen, others the largest number that they have.
const OVERLOAD: f64 = u64::MAX as f64;

impl RawTable {
    /// The table without what its columns of states and its numbers mark as no readings, as a table of text is: for formats of numbers
    /// alone.
    #[cfg(any(feature = "bags", feature = "matlab"))]
    pub(super) fn of_numbers(mut self) -> Self {
        let mut notes = std::mem::take(&mut self.notes);
        for place in 0..self.columns.len() {
            let Some(column) = self.columns.get(place).filter(|column| status::is_status(&column.header))
            else {
                continue;
            };
            let (header, origin) = (column.header.clone(), column.origin as f64);
            let numbers = column.values.iter().map(|value| (origin + value, value.is_nan()));
            let cells: Vec<[String; 1]> = numbers
                .map(|(number, is_missing)| [if is_missing { String::new() } else { number.to_string() }])
                .collect();
            let rows: Vec<&[String]> = cells.iter().map(<[String; 1]>::as_slice).collect();
            self.leave_out_marked(&header, &rows, 0, &mut notes);
        }
        self.leave_out_numbers(&mut notes);
        self.notes = notes;
        self
    }

    /// Leaves out numbers that stand for no reading.
    pub(super) fn leave_out_numbers(&mut self, notes: &mut Vec<String>) {
        for column in &mut self.columns {
            let overloads = column.values.iter_mut().filter(|value| value.abs() >= OVERLOAD);
            let count = overloads.map(|value| *value = f64::NAN).count();
            if count > 0 {
                notes.push(format!(
                    "\"{}\": {count} readings beyond the range of any instrument, such as 9.9e37, are left out",
                    column.header
                ));
            }
            notes.extend(marks::take_out(column, &self.lines));
        }
    }

    /// Leaves out the rows that a column of states marks as unusable; their places among those before.
    pub(super) fn leave_out_marked(
        &mut self,
        header: &str,
        kept: &[&[String]],
        index: usize,
        notes: &mut Vec<String>,
    ) -> Vec<usize> {
        let cells = kept.iter().map(|cells| cells.get(index).map_or("", String::as_str));
        let marked = status::marked(header, cells);
        if !marked.unknown.is_empty() {
            notes.push(format!(
                "\"{header}\" has {}, and it is not known whether such rows can be used: they are used",
                marked.unknown.join(", ")
            ));
        }
        if marked.rows.is_empty() {
            return Vec::new();
        }
        let words = marked.words.join(", ");
        notes.push(format!("{} rows whose \"{header}\" is {words} are skipped", marked.rows.len()));
        self.leave_out_rows(&marked.rows);
        marked.rows
    }

    /// Leaves out the rows of these places.
    pub(super) fn leave_out_rows(&mut self, rows: &[usize]) {
        for column in &mut self.columns {
            column.values = without(&column.values, rows);
        }
        self.lines = without(&self.lines, rows);
        self.places = without(&self.places, rows);
    }
}

/// The elements but those at these places, which ascend.
pub(super) fn without<T: Clone>(elements: &[T], places: &[usize]) -> Vec<T> {
    elements
        .iter()
        .enumerate()
        .filter(|(place, _)| places.binary_search(place).is_err())
        .map(|(_, element)| element.clone())
        .collect()
}
