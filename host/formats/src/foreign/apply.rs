//! The series of a run from tables and a mapping: one clock, SI, and a statement of what was taken for what.

use super::TableError;
use super::align::Offset;
use super::drift::Drift;
use super::dropouts;
use super::mapping::{Choice, Mapping, Target};
use super::raw::{RawColumn, RawTable};
use super::remarks;
use super::unit::{Quantity, Unit};
use crate::session::{ForceSeries, InsertionRun, ShapeSeries};
use serde::Serialize;
use std::path::PathBuf;

mod clock;
mod coarse;
mod counter;
mod insertion;
mod lateral;
mod missing;
mod rows;
mod series;
mod straight;
mod zero;

use clock::Timed;
use insertion::insertion;
use lateral::lateral;
use missing::{found, half_of_shape, not_numbers, nothing, unused_file};
pub(super) use series::Series;

/// Options of the user beside the mapping.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Options {
    /// Rows a second of tables without a column of times.
    pub rate_hz: Option<f64>,
    /// Name of the column of times that all files share.
    pub merge_on: Option<String>,
    /// To be added to the displacement's times; estimated where it is none and the files have clocks of their own.
    pub offset_s: Option<f64>,
    /// Whether the clocks of two files are brought together by the ramps although both are dates or since 1970.
    pub by_ramps: bool,
    /// Choice of zero displacement, of the zero of a shape, and of a tip.
    pub zero: Zero,
    /// From where positions along the needle are.
    pub z_from: Option<ZOrigin>,
    /// Position of the tissue's surface from guide 1, metres.
    pub entry_m: f64,
    /// Position of guide 2 from guide 1, metres; 0 where it is the only guide.
    pub guide2_m: f64,
}

/// Choice of zero displacement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Zero {
    /// Start of the run if it is never near 0; as it is written otherwise.
    #[default]
    Auto,
    /// Start of the run.
    First,
    /// As it is written.
    Written,
}

/// From where positions along the needle are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ZOrigin {
    /// From guide 1.
    Guide1,
    /// From the tissue's surface.
    Surface,
}

/// A column, and what was made of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TakenColumn {
    /// Quantity of the session.
    pub is: &'static str,
    /// The file.
    pub file: PathBuf,
    /// Its name there.
    pub column: String,
    /// Its unit, or how its times are written.
    pub unit: String,
    /// Least and greatest value, in the unit of the session.
    pub range: [f64; 2],
    /// Rows with a value.
    pub rows: usize,
}

/// A run, and what was taken for what.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Taken {
    /// Every column that is taken.
    pub columns: Vec<TakenColumn>,
    /// Columns that are not, with their files.
    pub others: Vec<String>,
    /// Form of every file.
    pub forms: Vec<String>,
    /// Remarks, a sentence each.
    pub notes: Vec<String>,
    /// The mapping with every unit that was found.
    pub mapping: Mapping,
    /// Offset between two clocks, where it was estimated.
    pub offset: Option<Offset>,
    /// Drift between them, where the readings tell one.
    pub drift: Option<Drift>,
    /// Force and displacement of a lateral run.
    pub force: Option<ForceSeries>,
    /// Its shape.
    pub shape: Option<ShapeSeries>,
    /// An insertion.
    pub insertion: Option<InsertionRun>,
}

/// A column that is a quantity.
pub(super) struct Part<'t> {
    pub table: &'t RawTable,
    pub column: &'t RawColumn,
    pub target: Target,
    /// SI units in one of the column.
    pub unit: Unit,
}

/// Takes a run out of tables.
///
/// # Errors
/// [`TableError`].
pub fn take(tables: &[RawTable], mapping: &Mapping, options: &Options) -> Result<Taken, TableError> {
    let complete = mapping.completed(tables);
    let measured = dropouts::without(tables, &complete);
    let tables = measured.as_slice();
    let mut result = Taken::default();
    let mut columns_used: Vec<Part> = Vec::new();
    let mut missing: Vec<TableError> = Vec::new();
    for choice in &complete.choices {
        let candidates = found(tables, choice)?;
        if candidates.len() > 1 && choice.target.quantity != Quantity::Time {
            let files: Vec<String> =
                candidates.iter().map(|(table, _)| table.path.display().to_string()).collect();
            return Err(map_fault(
                choice,
                &format!("{} have such a column", files.join(" and ")),
                "a name that one file has",
            ));
        }
        for (table, column) in candidates {
            let unit = if choice.target.quantity == Quantity::Time {
                clock::unit(table, column, choice, &mut result.notes)
            } else {
                unit(column, choice, table, &mut result.notes)
            };
            let unit = match unit {
                Ok(unit) => unit,
                Err(error) => {
                    missing.push(error);
                    continue;
                }
            };
            let complete_choice =
                Choice { unit: Some(unit.clone()).filter(|_| !column.is_stamp), ..choice.clone() };
            if !result.mapping.choices.contains(&complete_choice) {
                result.mapping.choices.push(complete_choice);
            }
            columns_used.push(Part { table, column, target: choice.target, unit });
        }
    }
    let has_shape = complete.choices.iter().any(|choice| choice.target.name == "z_mm");
    if !missing.is_empty() && has_shape && options.z_from.is_none() {
        missing.push(rows::missing_origin());
    }
    match missing.len() {
        0 => {}
        1 => return Err(missing.remove(0)),
        _ => return Err(TableError::Several(missing)),
    }
    for (at, part) in columns_used.iter().enumerate() {
        // One name may be that of the same column in two choices, and a time may have its fraction in a column of its own.
        fn is_twice(other: &Part, one: &Part) -> bool {
            let is_elsewhere = !std::ptr::eq(other.table, one.table);
            let is_of_time = other.target.quantity == Quantity::Time;
            other.target == one.target
                && !std::ptr::eq(other.column, one.column)
                && !(is_of_time && (is_elsewhere || other.unit.to_si != one.unit.to_si))
        }
        if let Some(duplicate) = columns_used.iter().skip(at + 1).find(|other| is_twice(other, part)) {
            let (a, b) = (&part.column.header, &duplicate.column.header);
            return Err(TableError::Map {
                choice: part.target.name.to_owned(),
                problem: format!("both \"{a}\" and \"{b}\" are taken for it"),
                expected: "one column for each quantity".to_owned(),
            });
        }
    }
    if let Some(error) = half_of_shape(&columns_used) {
        return Err(error);
    }
    result.describe(tables, &columns_used);
    for part in &columns_used {
        let is_over_time =
            ["force_", "displacement_"].iter().any(|start| part.target.name.starts_with(start));
        if is_over_time {
            remarks::check(part.table, part.column, &mut result.notes)?;
        }
    }
    let timed: Vec<Timed> = tables
        .iter()
        .map(|table| Timed::new(table, &columns_used, options, &mut result.notes))
        .collect::<Result<_, _>>()?;
    fn has(parts: &[Part], name: &str) -> bool {
        parts.iter().any(|part| part.target.name == name)
    }
    if has(&columns_used, "depth_mm") {
        result.insertion = Some(insertion(&columns_used, &timed, options.zero, &mut result.notes)?);
    } else if has(&columns_used, "force_y_n") && has(&columns_used, "displacement_y_mm") {
        lateral(&mut result, &columns_used, &timed, options)?;
    } else {
        return Err(not_numbers(tables, |column| {
            column
                .unit
                .as_ref()
                .is_some_and(|unit| matches!(unit.quantity, Quantity::Force | Quantity::Length))
        })
        .unwrap_or_else(|| nothing(tables, &columns_used)));
    }
    match unused_file(tables, &columns_used) {
        Some(error) => Err(error),
        None => Ok(result),
    }
}

fn map_fault(choice: &Choice, problem: &str, expected: &str) -> TableError {
    let (choice, problem, expected) =
        (format!("--map '{}'", choice.text()), problem.to_owned(), expected.to_owned());
    TableError::Map { choice, problem, expected }
}

/// The unit of a column: as the user states it, or its header.
fn unit(
    column: &RawColumn,
    choice: &Choice,
    table: &RawTable,
    notes: &mut Vec<String>,
) -> Result<Unit, TableError> {
    let target = choice.target;
    note_other_unit(column, choice, table, notes);
    let expected = || {
        let (quantity, column) = (target.quantity, &choice.column);
        format!(
            "--map '{column}={}:UNIT' with {}, or what one in the column stands for, such as {}",
            target.name,
            quantity.examples(),
            quantity.multiple()
        )
    };
    match choice.unit.as_ref().or(column.unit.as_ref()) {
        Some(unit) if unit.quantity == target.quantity => Ok(unit.clone()),
        Some(unit) => Err(map_fault(
            choice,
            &format!("its unit, {}, is one of {}", unit.name, unit.quantity),
            &expected(),
        )),
        None => {
            let doubt = column.unit_doubt.as_ref().map(ToString::to_string);
            Err(map_fault(choice, doubt.as_deref().unwrap_or("no unit is stated"), &expected()))
        }
    }
}

/// Notes a unit that the user states where the file states another: that of the user counts.
fn note_other_unit(column: &RawColumn, choice: &Choice, table: &RawTable, notes: &mut Vec<String>) {
    let Some(stated) = &choice.unit else { return };
    if let Some(doubt) = &column.unit_doubt {
        let (path, header, unit) = (table.path.display(), &column.header, &stated.name);
        notes.push(format!("{path}: \"{header}\": {doubt}: it is taken in {unit} as --map states"));
    }
    let Some(of_file) = &column.unit else { return };
    // A minus turns the direction, and the digits of one factor differ by rounding.
    let is_same = of_file.quantity == stated.quantity
        && (stated.to_si.abs() - of_file.to_si.abs()).abs() <= f64::EPSILON * 4.0 * of_file.to_si.abs();
    if !is_same {
        notes.push(format!(
            "{}: \"{}\" states {}, and is taken in {} as --map states",
            table.path.display(),
            column.header,
            of_file.name,
            stated.name
        ));
    }
}

impl Taken {
    fn describe(&mut self, tables: &[RawTable], parts: &[Part]) {
        for Part { table, column, target, unit } in parts {
            let values = column.values.iter().filter(|value| value.is_finite());
            // Dates begin with the first of them.
            let is_date =
                column.is_stamp || target.quantity == Quantity::Time && clock::is_of_computer(column, unit);
            let whole = if is_date { 0.0 } else { column.origin as f64 };
            let (least, most) =
                values.clone().fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), value| {
                    let si = (whole + *value) * unit.to_si;
                    (least.min(si), most.max(si))
                });
            let missing = table.lines.len() - values.clone().count();
            if missing > 0 {
                let row_count = table.lines.len();
                self.notes.push(format!(
                    "{}: {missing} of {row_count} rows have no number in \"{}\", and are skipped",
                    table.path.display(),
                    column.header
                ));
            }
            let name = if column.is_stamp { "date or time of day".to_owned() } else { unit.name.clone() };
            self.columns.push(TakenColumn {
                is: target.name,
                file: table.path.clone(),
                column: column.header.clone(),
                unit: name,
                range: [least, most].map(|si| target.shown(si)),
                rows: values.count(),
            });
        }
        for table in tables {
            fn is_taken(column: &RawColumn, parts: &[Part]) -> bool {
                parts.iter().any(|part| std::ptr::eq(part.column, column))
            }
            let free =
                table.columns.iter().filter(|column| !is_taken(column, parts)).map(|column| &column.header);
            let words = table.words.iter().map(|column| &column.header);
            let names: Vec<&str> = free.chain(words).map(String::as_str).collect();
            if !names.is_empty() {
                self.others.push(format!("{}: {}", table.path.display(), names.join(", ")));
            }
            self.forms.push(format!("{}: {}, {} rows", table.path.display(), table.form, table.lines.len()));
            self.notes.extend(table.notes.iter().map(|note| format!("{}: {note}", table.path.display())));
        }
    }
}
