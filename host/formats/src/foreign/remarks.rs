//! Remarks between the rows of a table, and what one of a new zero means for the readings behind it.

use super::TableError;
use super::cells::is_missing;
use super::dropouts::rounded;
use super::raw::{RawColumn, RawTable};
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

/// Remarks whose text is shown.
const SHOWN: usize = 3;
/// Letters of a remark that are shown.
const LETTERS: usize = 60;
/// Beginnings of words for a new zero, and words that are one as a whole: a zero crossing and an offset are none.
const OF_ZERO: [&str; 8] =
    ["tared", "tarier", "taring", "rezero", "autozero", "genullt", "nullabgl", "zeroed"];
const ZERO: [&str; 8] = ["tare", "zero", "zeroing", "nulled", "nulling", "nullen", "null", "tara"];

/// A line of words between rows, or a word that begins in a row.
#[derive(Debug, Clone, PartialEq)]
pub struct Remark {
    /// Its line.
    pub line: usize,
    /// Its text.
    pub text: String,
}

impl Remark {
    pub(super) fn new(line: usize, cells: &[String]) -> Self {
        let text = cells.join(" ");
        Self { line, text: text.trim().chars().take(LETTERS).collect() }
    }

    /// Whether a channel has another zero from here on.
    fn is_of_zero(&self) -> bool {
        let text = self.text.to_lowercase().replace(['-', '_'], "");
        text.split(|letter: char| !letter.is_alphanumeric())
            .any(|word| ZERO.contains(&word) || OF_ZERO.iter().any(|start| word.starts_with(start)))
    }
}

/// Texts of remarks, behind a count of them.
pub(super) fn shown(remarks: &[Remark]) -> String {
    let mut texts: Vec<String> = Vec::new();
    for remark in remarks {
        let text = format!("\"{}\"", remark.text);
        if texts.len() < SHOWN && !texts.contains(&text) {
            texts.push(text);
        }
    }
    if texts.is_empty() { String::new() } else { format!(": {}", texts.join(", ")) }
}

/// Words of a new zero in a column of words, at the rows in which they begin.
pub(super) fn events(lines: &[usize], kept: &[&[String]], index: usize) -> Vec<Remark> {
    let cells: Vec<&str> = kept.iter().map(|cells| cells.get(index).map_or("", String::as_str)).collect();
    let begins = cells
        .windows(2)
        .zip(lines.iter().skip(1))
        .filter(|(pair, _)| pair[0] != pair[1] && !is_missing(pair[1]));
    begins
        .map(|(pair, line)| Remark { line: *line, text: pair[1].chars().take(LETTERS).collect() })
        .filter(Remark::is_of_zero)
        .collect()
}

/// Valid content of rows behind a new zero.
pub const ONE_ZERO: &str = "one zero for all rows: add the subtracted offset to the later rows, or import both parts as separate runs";

/// Step of a column at a remark, and the largest one elsewhere; none where there are no readings on both sides.
fn steps(table: &RawTable, column: &RawColumn, line: usize) -> Option<[f64; 2]> {
    let lines = table.lines.iter().copied().zip(column.values.iter().copied());
    let readings: Vec<(usize, f64)> = lines.filter(|(_, value)| value.is_finite()).collect();
    let next = readings.partition_point(|(of_reading, _)| *of_reading < line);
    let earlier_value = readings.get(next.checked_sub(1)?)?.1;
    let next_value = readings.get(next)?.1;
    let other_steps = readings.windows(2).enumerate().filter(|(at, _)| at + 1 != next);
    let largest = other_steps.map(|(_, pair)| (pair[1].1 - pair[0].1).abs()).fold(0.0, f64::max);
    Some([next_value - earlier_value, largest])
}

fn words(text: &str, [step, largest]: [f64; 2]) -> String {
    format!(
        "\"{text}\", and a step of {} there; elsewhere neighbouring readings differ by {} at most: another zero from here on",
        rounded(step),
        rounded(largest)
    )
}

/// Refuses a column whose zero changes at a remark between its rows, and notes a remark at which it does not.
///
/// The reading behind the remark differs from that before it by more than any two neighbours elsewhere: of `n` steps the one at the remark
/// is the largest by chance once in `n`, and then the rows are parted in vain.
pub(super) fn check(table: &RawTable, column: &RawColumn, notes: &mut Vec<String>) -> Result<(), TableError> {
    for Remark { line, text } in table.remarks.iter().filter(|remark| remark.is_of_zero()) {
        let Some([step, largest]) = steps(table, column, *line) else { continue };
        if step.abs() > largest {
            return Err(TableError::Cell {
                path: table.path.clone(),
                line: *line,
                field: column.header.clone(),
                problem: words(text, [step, largest]),
                expected: ONE_ZERO.to_owned(),
            });
        }
        notes.push(format!(
            "{}: line {line}: \"{text}\", but \"{}\" changes by {} there, not more than elsewhere: the zero is assumed to be unchanged",
            table.path.display(),
            column.header,
            rounded(step)
        ));
    }
    Ok(())
}

/// Line, column and description of a new zero among the forces of a file with a session's columns; none in one that is no table.
pub fn new_zero_among_forces(path: &Path) -> Option<(usize, String, String)> {
    let lines = BufReader::new(File::open(path).ok()?).lines();
    let mut comments = lines.map_while(Result::ok).filter(|line| line.starts_with('#'));
    comments.find(|line| Remark { line: 0, text: line.clone() }.is_of_zero())?;
    RawTable::read(path).ok()?.iter().find_map(|table| {
        let forces = table.columns.iter().filter(|column| column.header.starts_with("force_"));
        let at_remarks = forces.flat_map(|column| table.remarks.iter().map(move |remark| (column, remark)));
        at_remarks.filter(|(_, remark)| remark.is_of_zero()).find_map(|(column, Remark { line, text })| {
            let at_remark = steps(table, column, *line).filter(|[step, largest]| step.abs() > *largest)?;
            Some((*line, column.header.clone(), words(text, at_remark)))
        })
    })
}
