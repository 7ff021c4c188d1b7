//! Names and units of columns, in the rows above the numbers.

use super::cells::{Number, is_missing};
use super::unit::Unit;

/// Rows above the first numbers in which the names may be.
const HEADER: usize = 4;
/// Rows by which it is told whether the first cells number them.
const SAMPLE: usize = 50;

/// Names and units of the columns, from the rows above the numbers, and the line of the names.
pub(super) type Names = (Vec<String>, Vec<Option<Unit>>, Option<usize>);

/// `rows` are those of the numbers.
pub(super) fn find(
    above: &[(usize, Vec<String>)],
    width: usize,
    has_decimal_comma: bool,
    rows: &[(usize, Vec<String>)],
) -> Names {
    let has_row_names = are_of_rows(rows);
    // A separator behind the last number of every row, and none behind the names.
    let has_empty_end =
        rows.iter().all(|(_, cells)| cells.len() != width || cells.last().is_some_and(String::is_empty));
    let mut units: Vec<Option<Unit>> = Vec::new();
    for (line, cells) in above.iter().rev().take(HEADER) {
        let mut cells = without_mark(cells);
        // The names of rows have none themselves, as R writes a table.
        if has_row_names && cells.len() + 1 == width {
            cells.insert(0, String::new());
        } else if has_empty_end && cells.len() + 1 == width {
            cells.push(String::new());
        }
        // Names may end before the last column, or behind it; LabVIEW names comments that its rows do not have.
        let has_surplus = cells.last().is_some_and(|cell| cell.is_empty() || cell == "Comment");
        let is_as_wide = cells.len() == width || cells.len() == width + 1 && has_surplus;
        let is_words = cells.iter().all(|cell| Number::parse(cell, has_decimal_comma).is_none());
        let has_letters = cells.iter().any(|cell| cell.chars().any(char::is_alphabetic));
        if !is_as_wide || !is_words || !has_letters {
            continue;
        }
        let cell_units: Vec<Option<Unit>> = cells.iter().map(|cell| bare_unit(cell)).collect();
        let is_units = cells
            .iter()
            .zip(&cell_units)
            .all(|(cell, unit)| unit.is_some() || is_missing(&bare(cell)) || bare(cell).len() <= 3);
        // Names differ; what repeats (`count`, `count`, `N`, `um`) is none.
        let repeats =
            cells.iter().enumerate().any(|(i, cell)| cells.iter().take(i).any(|other| other == cell));
        if (is_units || repeats) && cell_units.iter().any(Option::is_some) && units.is_empty() {
            units = cell_units;
            continue;
        }
        return (cells, units, Some(*line));
    }
    (Vec::new(), units, None)
}

/// Whether the first cells of rows number them, from 1 on.
fn are_of_rows(rows: &[(usize, Vec<String>)]) -> bool {
    let mut sample = rows.iter().take(SAMPLE).enumerate();
    rows.len() > 1
        && sample.all(|(at, (_, cells))| cells.first().is_some_and(|cell| *cell == (at + 1).to_string()))
}

/// Cells without the mark of a comment before the first one.
fn without_mark(cells: &[String]) -> Vec<String> {
    let mut cells = cells.to_vec();
    if let Some(first) = cells.first_mut() {
        let name = first.trim_start_matches(['#', '%', '/']).trim().to_owned();
        // A column without a name is one; a mark alone is none.
        let is_mark = name.is_empty() && !first.is_empty();
        *first = name;
        if is_mark && cells.len() > 1 {
            cells.remove(0);
        }
    }
    cells
}

fn bare(cell: &str) -> String {
    cell.trim_matches(['(', ')', '[', ']', ' ']).to_owned()
}

fn bare_unit(cell: &str) -> Option<Unit> {
    Unit::parse(&bare(cell))
}
