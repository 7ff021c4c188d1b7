//! The series of a run from tables and a mapping: one clock, SI, and a statement of what was taken for what.

use super::TableError;
use super::align::{Offset, estimate};
use super::dropouts;
use super::mapping::{Choice, Mapping, Target};
use super::raw::{RawColumn, RawTable, WordColumn};
use super::summary::LEAST_RUN;
use super::unit::{Quantity, Unit, split_name};
use crate::session::{ForceSeries, InsertionRun, ShapeSeries};
use serde::Serialize;
use std::path::{Path, PathBuf};

mod clock;
mod coarse;
mod rows;
mod series;

use clock::Timed;
use rows::{insertion, shape};
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
    /// Choice of zero displacement.
    pub zero: Zero,
    /// From where positions along the needle are.
    pub z_from: Option<ZOrigin>,
    /// Position of the tissue's surface from guide 1, metres.
    pub entry_m: f64,
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
                clock::unit(table, column, choice, &mut result.notes)?
            } else {
                unit(column, choice)?
            };
            let complete_choice =
                Choice { unit: Some(unit.clone()).filter(|_| !column.is_stamp), ..choice.clone() };
            if !result.mapping.choices.contains(&complete_choice) {
                result.mapping.choices.push(complete_choice);
            }
            columns_used.push(Part { table, column, target: choice.target, unit });
        }
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
    result.describe(tables, &columns_used);
    let timed: Vec<Timed> = tables
        .iter()
        .map(|table| Timed::new(table, &columns_used, options, &mut result.notes))
        .collect::<Result<_, _>>()?;
    fn has(parts: &[Part], name: &str) -> bool {
        parts.iter().any(|part| part.target.name == name)
    }
    if has(&columns_used, "depth_mm") {
        result.insertion = Some(insertion(&columns_used, &timed)?);
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
    Ok(result)
}

/// The column of a choice in each table that has it.
fn found<'t>(
    tables: &'t [RawTable],
    choice: &Choice,
) -> Result<Vec<(&'t RawTable, &'t RawColumn)>, TableError> {
    let mut matching = Vec::new();
    for table in tables {
        let column_number =
            table.find(&choice.column).map_err(|problem| map_fault(choice, &problem, "one column"))?;
        matching.extend(
            column_number
                .and_then(|column_number| table.columns.get(column_number))
                .map(|column| (table, column)),
        );
    }
    // A number is meant for a file without names.
    let unnamed = choice.column.strip_prefix('#').map(|number| format!("column {number}"));
    if unnamed.as_ref().is_some_and(|name| matching.iter().any(|(_, column)| column.header == *name)) {
        matching.retain(|(_, column)| Some(&column.header) == unnamed.as_ref());
    }
    if matching.is_empty() {
        let frames = choice.column.split_once(':').map(|(topic, _)| format!("{topic}@"));
        let headers = tables.iter().flat_map(|table| &table.columns).map(|column| &column.header);
        let of_frames: Vec<&str> = headers
            .filter(|header| frames.as_ref().is_some_and(|start| header.starts_with(start)))
            .map(String::as_str)
            .collect();
        if !of_frames.is_empty() {
            return Err(map_fault(
                choice,
                "the topic has messages of several frames",
                &format!("the column of one frame: one of {}", of_frames.join(", ")),
            ));
        }
        fn is_named(column: &WordColumn, choice: &Choice) -> bool {
            let is_numbered = choice.column.starts_with('#');
            let (name, _) = split_name(&column.header);
            !is_numbered && [&column.header, &name].iter().any(|of| of.eq_ignore_ascii_case(&choice.column))
        }
        if let Some(error) = not_numbers(tables, |column| is_named(column, choice)) {
            return Err(error);
        }
        let column_names: Vec<String> = tables
            .iter()
            .flat_map(|table| &table.columns)
            .map(|column| format!("\"{}\"", column.header))
            .collect();
        return Err(map_fault(
            choice,
            "no file has such a column of numbers",
            &format!("one of {}", column_names.join(", ")),
        ));
    }
    Ok(matching)
}

fn map_fault(choice: &Choice, problem: &str, expected: &str) -> TableError {
    let (choice, problem, expected) =
        (format!("--map '{}'", choice.text()), problem.to_owned(), expected.to_owned());
    TableError::Map { choice, problem, expected }
}

/// The unit of a column: as the user states it, or its header.
fn unit(column: &RawColumn, choice: &Choice) -> Result<Unit, TableError> {
    let target = choice.target;
    let expected =
        || format!("--map '{}={}:UNIT' with {}", choice.column, target.name, target.quantity.examples());
    match choice.unit.as_ref().or(column.unit.as_ref()) {
        Some(unit) if unit.quantity == target.quantity => Ok(unit.clone()),
        Some(unit) => Err(map_fault(
            choice,
            &format!("its unit, {}, is one of {}", unit.name, unit.quantity),
            &expected(),
        )),
        None => Err(map_fault(choice, "no unit is stated", &expected())),
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

/// Force and displacement on the clock of the force, with the shape.
fn lateral(taken: &mut Taken, parts: &[Part], timed: &[Timed], options: &Options) -> Result<(), TableError> {
    let series = |name: &str| -> Result<Option<(usize, Series)>, TableError> {
        let Some(named_part) = parts.iter().find(|part| part.target.name == name) else { return Ok(None) };
        let table_number =
            timed.iter().position(|timed| std::ptr::eq(timed.table, named_part.table)).unwrap_or(0);
        let table_times_s = timed.get(table_number).and_then(|timed| timed.times_s.as_deref());
        let times_s = table_times_s.ok_or_else(|| clock::missing(named_part.table))?;
        Ok(Some((table_number, Series::new(named_part, times_s)?)))
    };
    let required = |name: &str| -> Result<(usize, Series), TableError> {
        series(name)?.ok_or_else(|| nothing(&[], parts))
    };
    let (force_at, force) = required("force_y_n")?;
    let (moved_at, moved) = required("displacement_y_mm")?;
    let base = timed.get(force_at);
    let shift_s = |at: usize| base.zip(timed.get(at)).and_then(|(base, other)| other.shift_to(base, options));
    // Offsets are between the times that the files have.
    let origin_s = base.zip(timed.get(moved_at)).map_or(0.0, |(base, other)| other.origin_shift_s(base));
    let moved_shift_s = match (options.offset_s, shift_s(moved_at)) {
        (Some(offset_s), _) if moved_at != force_at => origin_s + offset_s,
        (_, Some(shift_s)) => shift_s,
        (_, None) => {
            let offset = estimate(&force, &moved.clone().shifted(origin_s))?;
            taken.notes.push(format!(
                "the files have clocks of their own: {:+.4} s (sd {:.4} s) is added to the times of the displacement, by which it explains {:.1} % of \
                 the force (--offset-s states another, --merge-on a column that is one clock)",
                offset.offset_s, offset.sd_s, 100.0 * offset.r2
            ));
            taken.offset = Some(offset);
            origin_s + offset.offset_s
        }
    };
    let moved = moved.shifted(moved_shift_s);
    let (force_x, moved_x) = (series("force_x_n")?, series("displacement_x_mm")?);
    let on_clock = |one: Option<(usize, Series)>| {
        one.map(|(at, series)| {
            series.shifted(if at == moved_at { moved_shift_s } else { shift_s(at).unwrap_or(0.0) })
        })
    };
    let (force_x, moved_x) = (on_clock(force_x), on_clock(moved_x));
    let rows: Vec<(f64, [f64; 4])> = force
        .readings()
        .filter_map(|(time_s, force_n)| {
            fn of(series: &Option<Series>, time_s: f64) -> Option<f64> {
                series.as_ref().map_or(Some(0.0), |series| series.at(time_s))
            }
            Some((time_s, [force_n, moved.at(time_s)?, of(&force_x, time_s)?, of(&moved_x, time_s)?]))
        })
        .collect();
    if rows.len() < LEAST_RUN {
        fn span(series: &Series) -> String {
            series.span_s().map_or_else(String::new, |[a, b]| format!("{a:.3} to {b:.3} s"))
        }
        return Err(TableError::Map {
            choice: "time_s".to_owned(),
            problem: format!(
                "force ({}) and displacement ({}) have {} rows in common",
                span(&force),
                span(&moved),
                rows.len()
            ),
            expected: format!("{LEAST_RUN} or more: one clock (--merge-on COLUMN), or --offset-s"),
        });
    }
    let dropped_rows = force.len() - rows.len();
    if dropped_rows > 0 {
        taken.notes.push(format!(
            "{dropped_rows} of {} rows of the force have no displacement at their time, and are skipped",
            force.len()
        ));
    }
    let origin_s = rows.first().map_or(0.0, |(time_s, _)| *time_s);
    fn column(at: usize, rows: &[(f64, [f64; 4])]) -> Vec<f64> {
        rows.iter().map(|(_, values)| values[at]).collect()
    }
    let (mut y_m, mut x_m) = (column(1, &rows), moved_x.is_some().then(|| column(3, &rows)));
    for (name, values) in
        [Some(("displacement_y_mm", &mut y_m)), x_m.as_mut().map(|x_m| ("displacement_x_mm", x_m))]
            .into_iter()
            .flatten()
    {
        series::refer_to_zero(name, values, options.zero, &mut taken.notes);
    }
    series::check_range("displacement_y_mm", &y_m, 0.05)?;
    series::check_range("force_y_n", &column(0, &rows), 200.0)?;
    series::check_sign(&column(0, &rows), &y_m, &mut taken.notes);
    taken.force = Some(ForceSeries {
        time_s: rows.iter().map(|(time_s, _)| time_s - origin_s).collect(),
        displacement_y_m: y_m,
        force_y_n: column(0, &rows),
        displacement_x_m: x_m.filter(|_| force_x.is_some()),
        force_x_n: (force_x.is_some() && moved_x.is_some()).then(|| column(2, &rows)),
        ..ForceSeries::default()
    });
    taken.shape = shape(parts, timed, options, |at| {
        let own_shift_s = if at == moved_at { Some(moved_shift_s) } else { shift_s(at) };
        own_shift_s.map(|shift_s| shift_s - origin_s)
    })?;
    let end_s = rows.last().map_or(0.0, |(time_s, _)| time_s - origin_s);
    rows::check_times(taken.shape.as_ref(), end_s)?;
    if taken.shape.is_none() {
        taken.notes.push(
            "there is no shape of the needle (z_mm and deflection_y_mm, of a further table or by guide import slicer, fbg or ultrasound with --force): the run has no modulus without one"
                .to_owned(),
        );
    }
    Ok(())
}

/// Error for the first column of words that is meant to have numbers.
fn not_numbers(tables: &[RawTable], is_meant: impl Fn(&WordColumn) -> bool) -> Option<TableError> {
    tables.iter().find_map(|table| {
        let column = table.words.iter().find(|column| is_meant(column))?;
        Some(match &column.first {
            Some((line, text)) => series::bad(table, &column.header, *line, text),
            None => TableError::File {
                path: table.path.clone(),
                problem: format!("\"{}\" has no real numbers", column.header),
                expected: "a column or a full array of them".to_owned(),
            },
        })
    })
}

/// Error for columns that every run needs.
fn nothing(tables: &[RawTable], parts: &[Part]) -> TableError {
    let column_names: Vec<String> = tables
        .iter()
        .flat_map(|table| &table.columns)
        .map(|column| {
            let unit = column.unit.as_ref().map_or_else(String::new, |unit| format!(" in {}", unit.name));
            format!("\"{}\"{unit}", column.header)
        })
        .collect();
    let mapped_names: Vec<&str> = parts.iter().map(|part| part.target.name).collect();
    let path = tables.first().map_or(Path::new(""), |table| table.path.as_path());
    TableError::File {
        path: path.to_owned(),
        problem: format!(
            "columns {} of which {} could be told",
            column_names.join(", "),
            if mapped_names.is_empty() { "none".to_owned() } else { mapped_names.join(", ") }
        ),
        expected: "force_y_n and displacement_y_mm of a lateral run, or depth_mm and tip_y_mm of an insertion: --map 'COLUMN=QUANTITY:UNIT' for each".to_owned(),
    }
}
