//! Finds the numbers of a table, and the names of its columns.

use super::cells::{Number, is_missing};
use super::forms::{Form, has_words};
use super::grid::Grid;
use super::left_out::without;
use super::readings::{are_names, ends_within, is_comment};
use super::remarks::Remark;
use super::stated_rate::StatedRate;
use super::stated_unit::{StatedUnit, UnitDoubt};
use super::summary::{rows_apart, rows_of_statistics};
use super::unit::Unit;
use super::{TableError, names, remarks, status, thousands};
use std::path::{Path, PathBuf};

/// Rows by which columns of numbers are told from others.
const SAMPLE: usize = 50;
/// A column of numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct RawColumn {
    /// Its name without the unit; `column 3` where there is none.
    pub name: String,
    /// As its header writes it.
    pub header: String,
    /// Its unit, where it is stated.
    pub unit: Option<Unit>,
    /// Why there is none although something is stated.
    pub unit_doubt: Option<UnitDoubt>,
    /// Its place, from 1.
    pub number: usize,
    /// Whether it holds dates or times of day; its values are seconds then.
    pub is_stamp: bool,
    /// Origin to be added to its values.
    pub origin: i64,
    /// A value for each row; NaN where there is none.
    pub values: Vec<f64>,
    /// The first cell that is neither a number nor empty: its line and text.
    pub bad: Option<(usize, String)>,
    /// Whether there has been a value.
    pub(super) has_values: bool,
}

impl RawColumn {
    /// The name by which a mapping finds it again.
    pub fn own_name(&self) -> String {
        if self.header.contains('=') { format!("#{}", self.number) } else { self.header.clone() }
    }

    /// Its value in a row; NaN where there is none.
    pub fn value(&self, row: usize) -> f64 {
        self.values.get(row).copied().unwrap_or(f64::NAN)
    }
}

/// A column without numbers, or with too few.
#[derive(Debug, Clone, PartialEq)]
pub struct WordColumn {
    /// As its header writes it.
    pub header: String,
    /// Its unit, where it is stated.
    pub unit: Option<Unit>,
    /// The first cell that is neither a number nor empty: its line and text; none in a file without cells.
    pub first: Option<(usize, String)>,
}

impl WordColumn {
    /// One of a file without cells.
    #[cfg(any(feature = "bags", feature = "matlab"))]
    pub(super) fn named(header: String) -> Self {
        Self { header, unit: None, first: None }
    }
}

/// The numbers of a table.
#[derive(Debug, Clone, PartialEq)]
pub struct RawTable {
    /// The file.
    pub path: PathBuf,
    /// Encoding, separator, decimal sign, line of the names.
    pub form: String,
    /// Columns of numbers, in their order.
    pub columns: Vec<RawColumn>,
    /// Columns without numbers.
    pub words: Vec<WordColumn>,
    /// Line of each row.
    pub lines: Vec<usize>,
    /// Number of each row among all that were recorded, from 0: those that are left out count.
    pub places: Vec<usize>,
    /// Remarks between the rows.
    pub remarks: Vec<Remark>,
    /// Rows a second, as a line above the names states them.
    pub stated_rate: Option<StatedRate>,
    /// Notes on content that was left out.
    pub notes: Vec<String>,
}

impl RawTable {
    /// Reads the tables of a file: one, or one for each topic of a bag.
    ///
    /// # Errors
    /// [`TableError`].
    pub fn read(path: &Path) -> Result<Vec<Self>, TableError> {
        if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mcap")) {
            #[cfg(feature = "bags")]
            return super::bag::read(path);
            #[cfg(not(feature = "bags"))]
            return Err(TableError::File {
                path: path.to_owned(),
                problem: "a bag of ROS 2".to_owned(),
                expected: "CSV: this program was built without bags (its feature `bags`)".to_owned(),
            });
        }
        if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mat")) {
            #[cfg(feature = "matlab")]
            return super::mat::read(path);
            #[cfg(not(feature = "matlab"))]
            return Err(TableError::File {
                path: path.to_owned(),
                problem: "a file of MATLAB".to_owned(),
                expected: "CSV: writetable(table(t, x, f), 'run.csv'); this program was built without MATLAB (its feature `matlab`)"
                    .to_owned(),
            });
        }
        Ok(vec![Self::new(Grid::read(path)?)?])
    }

    /// Finds the numbers of a grid.
    ///
    /// # Errors
    /// [`TableError`] where there are none.
    pub fn new(grid: Grid) -> Result<Self, TableError> {
        let Grid { path, mut rows, has_decimal_comma, form, is_cut, left_out, mut notes, mut of_other_form } =
            grid;
        let joined = thousands::join(&mut rows, has_decimal_comma);
        let rows = rows;
        fn is_number(cell: &str, has_decimal_comma: bool) -> bool {
            Number::parse(cell, has_decimal_comma).is_some()
        }
        // Signs between thousands are no other form.
        of_other_form.retain(|(line, _)| {
            rows.binary_search_by_key(line, |(number, _)| *number)
                .is_ok_and(|at| rows.get(at).is_some_and(|(_, cells)| has_words(cells, has_decimal_comma)))
        });
        let numbers: Vec<usize> = rows
            .iter()
            .map(|(_, cells)| cells.iter().filter(|cell| is_number(cell, has_decimal_comma)).count())
            .collect();
        // As many cells as most rows of two numbers or more have.
        let mut widths: Vec<usize> = rows
            .iter()
            .zip(&numbers)
            .filter(|(_, count)| **count >= 2)
            .map(|((_, cells), _)| cells.len())
            .collect();
        widths.sort_unstable();
        let width = widths
            .chunk_by(|a, b| a == b)
            .max_by_key(|same| same.len())
            .and_then(|same| same.first().copied());
        // As many numbers as most of these rows have: words with a number or two among them are a preamble.
        fn is_wide(at: usize, rows: &[(usize, Vec<String>)], width: &Option<usize>) -> bool {
            rows.get(at).is_some_and(|(_, cells)| Some(cells.len()) == *width)
        }
        let mut counts: Vec<usize> = numbers
            .iter()
            .enumerate()
            .filter(|(at, _)| is_wide(*at, &rows, &width))
            .map(|(_, count)| *count)
            .collect();
        counts.sort_unstable();
        let usual = counts
            .chunk_by(|a, b| a == b)
            .max_by_key(|same| same.len())
            .and_then(|same| same.first().copied());
        let least = (3 * usual.unwrap_or(0)).div_ceil(4).max(2);
        let is_data =
            |at: usize| is_wide(at, &rows, &width) && numbers.get(at).is_some_and(|count| *count >= least);
        let is_filled = |at: usize| {
            fn missing(cells: &[String]) -> usize {
                cells.iter().filter(|cell| is_missing(cell)).count()
            }
            let filled = numbers.get(at).copied().unwrap_or(0);
            is_wide(at, &rows, &width)
                && filled > 0
                && rows.get(at).is_some_and(|(_, cells)| filled + missing(cells) >= least)
        };
        // Two rows of them, so that a line of numbers in a preamble is none.
        let first = (0..rows.len()).find(|at| is_data(*at) && (is_filled(at + 1) || at + 1 == rows.len()));
        let Some((first, width)) = first.zip(width) else {
            let expected = "rows of numbers below a line of names".to_owned();
            let problem = format!("no rows of two numbers or more ({form})");
            return Err(TableError::File { path, problem, expected });
        };
        let (preamble, data_rows) = rows.split_at(first);
        let words_of_form = form.split_once(", ").map_or(form.as_str(), |(_, words)| words);
        let form_of_rows =
            Form { path: &path, words: words_of_form, has_decimal_comma, width, others: &of_other_form };
        let first_line = data_rows.first().map_or(0, |(line, _)| *line);
        form_of_rows.check_above(preamble, first_line, &mut notes)?;
        form_of_rows.check_behind(data_rows)?;
        let (names, units, header_line) = names::find(preamble, width, has_decimal_comma, data_rows);
        let stated_rate = StatedRate::find(preamble);
        let sample = rows.get(first..).unwrap_or_default().iter().take(SAMPLE);
        let mut columns: Vec<RawColumn> = Vec::new();
        let mut words = Vec::new();
        for index in 0..width {
            let cells: Vec<&String> = sample.clone().filter_map(|(_, cells)| cells.get(index)).collect();
            let number_count = cells.iter().filter(|cell| is_number(cell, has_decimal_comma)).count();
            let filled = cells.iter().filter(|cell| !is_missing(cell)).count();
            let header = names.get(index).filter(|name| !name.is_empty()).cloned();
            let header = header.unwrap_or_else(|| format!("column {}", index + 1));
            let StatedUnit { name, unit, doubt } =
                StatedUnit::of(&header, units.get(index).cloned().flatten());
            if number_count == 0 || 2 * number_count < filled {
                let first = sample.clone().find_map(|(line, cells)| {
                    let cell = cells.get(index)?;
                    (!is_missing(cell) && !is_number(cell, has_decimal_comma)).then(|| (*line, cell.clone()))
                });
                words.push(WordColumn { header, unit, first });
                continue;
            }
            let values = Vec::with_capacity(rows.len() - first);
            columns.push(RawColumn {
                name,
                header,
                unit,
                unit_doubt: doubt,
                number: index + 1,
                is_stamp: false,
                origin: 0,
                values,
                bad: None,
                has_values: false,
            });
        }
        let mut table = Self {
            path,
            form,
            columns,
            words,
            lines: Vec::new(),
            places: Vec::new(),
            remarks: Vec::new(),
            stated_rate,
            notes: Vec::new(),
        };
        let header = header_line.and_then(|line| rows.iter().find(|(number, _)| *number == line));
        let mut skipped: Vec<usize> = Vec::new();
        let mut row_count = 0usize;
        let last = rows.len().saturating_sub(1);
        let end = table.end(&rows, first, has_decimal_comma);
        if let Some((line, _)) = rows.get(end) {
            notes
                .push(format!("the rows from line {line} on contain words, like a summary, and are skipped"));
        }
        let mut kept_rows: Vec<&[String]> = Vec::new();
        for (at, (line, cells)) in rows.iter().enumerate().take(end).skip(first) {
            if is_comment(cells) {
                skipped.push(*line);
                table.remarks.push(Remark::new(*line, cells));
            } else if at == last && at > first && (cells.len() < width || is_cut && ends_within(&rows, first))
            {
                notes.push(format!("line {line}: the last row is cut off, and skipped"));
            } else if !table.add(*line, cells, has_decimal_comma) {
                if header.is_some_and(|(_, names)| are_names(cells, names)) {
                    return Err(TableError::File {
                        path: table.path,
                        problem: format!("line {line} has names again: two tables one after the other"),
                        expected: "one recording in a file".to_owned(),
                    });
                }
                skipped.push(*line);
                if cells.iter().all(|cell| is_missing(cell)) {
                    row_count += 1;
                } else {
                    table.remarks.push(Remark::new(*line, cells));
                }
            } else {
                table.places.push(row_count + left_out.partition_point(|out| out < line));
                row_count += 1;
                kept_rows.push(cells);
            }
        }
        // A row that is left out is no empty line between others.
        let row_numbers: Vec<usize> =
            table.lines.iter().map(|line| line - left_out.partition_point(|out| out < line)).collect();
        let of_statistics = rows_of_statistics(&table.columns, &kept_rows, &row_numbers, has_decimal_comma);
        let (count, reason) = match of_statistics {
            0 => (rows_apart(&table.columns, &row_numbers), "stand apart and do not go on from those above"),
            count => (count, "are means, totals or other statistics of those above"),
        };
        let end = kept_rows.len() - count;
        if let Some(line) = table.lines.get(end).copied() {
            notes.push(format!("the rows from line {line} on {reason}, and are skipped"));
            kept_rows.truncate(end);
            table.lines.truncate(end);
            table.places.truncate(end);
            for column in &mut table.columns {
                column.values.truncate(end);
                column.bad.take_if(|(bad, _)| *bad >= line);
            }
        }
        if let Some(line) = skipped.first() {
            let texts = remarks::shown(&table.remarks);
            notes.push(format!(
                "rows without numbers: {}, from line {line} on, skipped{texts}",
                skipped.len()
            ));
        }
        let short = table.short_rows(&kept_rows, width, has_decimal_comma)?;
        if let Some(line) = short.first().and_then(|row| table.lines.get(*row)) {
            notes.push(format!(
                "{} rows, from line {line} on, have fewer numbers than there are columns, so that it is unknown which are missing: they are left out",
                short.len()
            ));
            table.leave_out_rows(&short);
            kept_rows = without(&kept_rows, &short);
        }
        for index in (0..width).filter(|index| table.columns.iter().all(|column| column.number != index + 1))
        {
            table.remarks.extend(remarks::events(&table.lines, &kept_rows, index));
        }
        for (index, header) in names.iter().enumerate().filter(|(_, header)| status::is_status(header)) {
            let marked_rows = table.leave_out_marked(header, &kept_rows, index, &mut notes);
            kept_rows = without(&kept_rows, &marked_rows);
        }
        for column in table.columns.iter().filter(|column| joined.contains(&(column.number - 1))) {
            notes.push(format!("\"{}\": thousands separators are left out", column.header));
        }
        table.leave_out_numbers(&mut notes);
        table.notes = notes;
        table.form = match header_line {
            Some(line) => format!("{}, names in line {line}", table.form),
            None => format!("{}, without names", table.form),
        };
        Ok(table)
    }
}
