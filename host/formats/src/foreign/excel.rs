//! Sheets of workbooks: their cells as text.

mod hidden;

use super::cells::Number;
use super::{Grid, TableError};
use calamine::{Data, Range, Reader, SheetVisible, open_workbook_auto};
use hidden::{HiddenRows, RowState};
use std::fs;
use std::path::Path;

/// Largest file: a workbook is read as a whole, and its sheets are larger than it.
const MAX_BYTES: u64 = 128 << 20;
/// Day of 1970-01-01 in a workbook.
const DAY_1970: f64 = 25_569.0;
const DAY_S: f64 = 86_400.0;
/// Rows of numbers that a sheet of readings has more than.
const READINGS: usize = 3;

/// Reads a sheet, the first one with readings that is shown where none is named. Rows that a filter or a hand hides are left out.
pub(super) fn read(path: &Path, sheet: Option<&str>) -> Result<Grid, TableError> {
    fn fault(problem: String, expected: &str, path: &Path) -> TableError {
        TableError::File { path: path.to_owned(), problem, expected: expected.to_owned() }
    }
    let size = fs::metadata(path).map_err(|cause| TableError::Io { path: path.to_owned(), cause })?.len();
    if size > MAX_BYTES {
        return Err(fault(format!("{size} bytes"), "a workbook of at most 128 MiB, or CSV", path));
    }
    let mut workbook =
        open_workbook_auto(path).map_err(|cause| fault(cause.to_string(), "a workbook", path))?;
    let names = workbook.sheet_names();
    let is_shown = |name: &String| {
        let states = workbook.sheets_metadata();
        states.iter().any(|state| state.name == *name && state.visible == SheetVisible::Visible)
    };
    let (shown, concealed): (Vec<String>, Vec<String>) = names.iter().cloned().partition(is_shown);
    let name = match sheet {
        Some(name) => names.iter().find(|known| *known == name).cloned(),
        // Sheets before the readings may describe them.
        None => shown
            .iter()
            .chain(&concealed)
            .find(|name| workbook.worksheet_range(name).is_ok_and(|range| has_numbers(&range)))
            .or_else(|| names.first())
            .cloned(),
    };
    let name = name.ok_or_else(|| {
        let expected = format!("one of the sheets {}", names.join(", "));
        fault(format!("no sheet {}", sheet.unwrap_or_default()), &expected, path)
    })?;
    let range = workbook
        .worksheet_range(&name)
        .map_err(|cause| fault(cause.to_string(), "a sheet of cells", path))?;
    let first = range.start().map_or(0, |(row, _)| row as usize);
    let has_decimal_comma = has_decimal_comma(&range);
    fn written(cell: &Data, has_decimal_comma: bool) -> String {
        let text = text(cell);
        let is_number = !matches!(cell, Data::String(_));
        if has_decimal_comma && is_number { text.replace('.', ",") } else { text }
    }
    let rows: Vec<(usize, Vec<String>)> = range
        .rows()
        .enumerate()
        .map(|(at, cells)| {
            (
                first + at + 1,
                cells.iter().map(|cell| written(cell, has_decimal_comma)).collect::<Vec<String>>(),
            )
        })
        .filter(|(_, cells)| cells.iter().any(|cell| !cell.is_empty()))
        .collect();
    let hidden = HiddenRows::read(path, &name);
    let (rows, left_out): (Vec<_>, Vec<_>) =
        rows.into_iter().partition(|(row, _)| hidden.state(*row) != Some(RowState::Hidden));
    let left_out: Vec<usize> = left_out.into_iter().map(|(row, _)| row).collect();
    let folded: Vec<usize> =
        rows.iter().map(|(row, _)| *row).filter(|row| hidden.state(*row).is_some()).collect();
    let notes = [
        (&left_out, "are hidden in the sheet, and left out"),
        (&folded, "are folded in the sheet, and used"),
    ]
    .into_iter()
    .filter_map(|(rows, remark)| {
        Some(format!("{} rows, from row {} on, {remark}", rows.len(), rows.first()?))
    })
    .collect();
    let other_sheets: Vec<&str> = names.iter().filter(|other| **other != name).map(String::as_str).collect();
    let form = if other_sheets.is_empty() || sheet.is_some() {
        format!("workbook, sheet \"{name}\"")
    } else {
        format!("workbook, sheet \"{name}\", not {}", other_sheets.join(", "))
    };
    let path = if sheet.is_some() { format!("{}#{name}", path.display()).into() } else { path.to_owned() };
    Ok(Grid {
        path,
        rows,
        has_decimal_comma,
        form,
        is_cut: false,
        left_out,
        notes,
        of_other_form: Vec::new(),
    })
}

/// Whether a sheet has readings: rows of two numbers or more, also where they are written as text.
fn has_numbers(range: &Range<Data>) -> bool {
    range
        .rows()
        .filter(|cells| cells.iter().filter(|cell| is_number(cell)).count() >= 2)
        .nth(READINGS)
        .is_some()
}

fn is_number(cell: &Data) -> bool {
    match cell {
        Data::String(text) => [false, true].iter().any(|comma| Number::parse(text, *comma).is_some()),
        Data::Empty | Data::Error(_) | Data::Bool(_) => false,
        _ => true,
    }
}

/// Whether numbers that are written as text have a decimal comma, as where a table was pasted.
fn has_decimal_comma(range: &Range<Data>) -> bool {
    fn count(range: &Range<Data>, sign: char) -> usize {
        range.rows().flatten().filter(|cell| matches!(cell, Data::String(text) if text.contains(sign) && Number::parse(text, sign == ',').is_some())).count()
    }
    count(range, ',') > count(range, '.')
}

/// A cell as text; times are seconds since 1970, or of the day.
fn text(cell: &Data) -> String {
    match cell {
        Data::Empty | Data::Error(_) => String::new(),
        Data::String(text) | Data::DateTimeIso(text) | Data::DurationIso(text) => text.trim().to_owned(),
        Data::Float(number) => number.to_string(),
        Data::Int(number) => number.to_string(),
        Data::Bool(is_so) => u8::from(*is_so).to_string(),
        Data::DateTime(at) => {
            let days = at.as_f64();
            let seconds =
                if days < 1.0 || at.is_duration() { days * DAY_S } else { (days - DAY_1970) * DAY_S };
            // Days are doubles: there is nothing below a microsecond.
            format!("{seconds:.6}")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::foreign::{Mapping, Options, RawTable, take};

    fn data(name: &str) -> std::path::PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
    }

    #[test]
    fn sheets_of_a_workbook_hold_the_values_they_were_made_of() {
        // The third one has notes on its first sheet, and numbers with decimal commas as text; the last one durations that pass 24 hours.
        for (name, within_s) in
            [("push.xlsx", 1e-3), ("push.xlsx#Seconds", 1e-9), ("text.xlsx", 1e-9), ("elapsed.xlsx", 1e-3)]
        {
            let tables = RawTable::read(&data(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
            let lateral_run = take(&tables, &Mapping::default(), &Options::default()).expect("a run");
            let force = lateral_run.force.expect("a force");
            assert_eq!(force.time_s.len(), 60, "{name}");
            for (at, ((t, y_m), f)) in
                force.time_s.iter().zip(&force.displacement_y_m).zip(&force.force_y_n).enumerate()
            {
                let truth_s = 0.05 * at as f64;
                let truth_m = 1.2e-3 * (truth_s - 1.0).clamp(0.0, 1.0);
                assert!((t - truth_s).abs() < within_s, "{name}: {t} and {truth_s}");
                assert!(
                    (y_m - truth_m).abs() < 1e-8 && (f - 250.0 * truth_m).abs() < 1e-6,
                    "{name} {at}: {y_m} {f}"
                );
            }
        }
        let error = RawTable::read(&data("push.xlsx#Pull")).expect_err("no such sheet").to_string();
        assert!(error.contains("no sheet Pull, expected one of the sheets Push, Seconds"), "{error}");
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("none.xlsx");
        fs::write(&path, b"PK no workbook").expect("written");
        assert!(read(&path, None).is_err());
    }
}

#[cfg(test)]
mod hidden_tests;
