//! Times of a table, and whether two tables have one clock.

use super::super::TableError;
use super::super::mapping::{Choice, is_time};
use super::super::raw::{RawColumn, RawTable};
use super::super::stated_unit::UnitDoubt;
use super::super::unit::{Quantity, Unit};
use super::{Options, Part, coarse, counter};

/// Seconds of a day, and what a clock of the day steps back by at midnight at least.
const DAY_S: f64 = 86_400.0;
/// Numbers from which times are since 1970 in ns, us, ms and s: no experiment lasts a year, 3e7 s.
const SINCE_1970: [(f64, &str); 4] = [(1e17, "ns"), (1e14, "us"), (1e11, "ms"), (1e8, "s")];

/// Days of the years 1982 to 2064, as spreadsheets count them.
const DAYS: std::ops::Range<i64> = 30_000..60_000;
/// Rows that would be nearer than this in seconds, which no load cell is read at, may be in days.
const SHORTEST_S: f64 = 1e-4;
/// Rows of a push are nearer than this; what is further apart in days may be seconds.
const LONGEST_S: f64 = 2.0;

/// The unit of a column of times.
pub(super) fn unit(
    table: &RawTable,
    column: &RawColumn,
    choice: &Choice,
    notes: &mut Vec<String>,
) -> Result<Unit, TableError> {
    if column.is_stamp {
        return Ok(Unit::si(Quantity::Time));
    }
    super::note_other_unit(column, choice, table, notes);
    if let Some(unit) = choice.unit.as_ref().or(column.unit.as_ref()) {
        if unit.quantity == Quantity::Time {
            return Ok(unit.clone());
        }
        return Err(super::map_fault(
            choice,
            &format!("its unit, {}, is one of {}", unit.name, unit.quantity),
            "a unit of time",
        ));
    }
    fn named(name: &str, table: &RawTable) -> Result<Unit, TableError> {
        Unit::parse(name).ok_or_else(|| missing(table))
    }
    if let Some((_, unit)) = SINCE_1970.iter().find(|(least, _)| column.origin as f64 >= *least) {
        notes.push(format!("{}: \"{}\" is taken as {unit} since 1970", table.path.display(), column.header));
        return named(unit, table);
    }
    let mut steps: Vec<f64> =
        column.values.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0.0).collect();
    steps.sort_by(f64::total_cmp);
    let usual = steps.get(steps.len() / 2).copied().unwrap_or(0.0);
    // A row a second, or one in a millisecond: both are usual.
    if usual >= 1.0 {
        let expected = format!("--map '{}=time_s:UNIT' with {}", choice.column, Quantity::Time.examples());
        return Err(super::map_fault(
            choice,
            &format!("no unit is stated, and rows are {usual} apart"),
            &expected,
        ));
    }
    if usual > 0.0 && usual < SHORTEST_S {
        if DAYS.contains(&column.origin) && usual * DAY_S < LONGEST_S {
            notes.push(format!(
                "{}: \"{}\" is taken as days, as spreadsheets count them",
                table.path.display(),
                column.header
            ));
            return named("d", table);
        }
        let expected = format!(
            "--map '{}=time_s:UNIT' with {}, or d for the days of a spreadsheet",
            choice.column,
            Quantity::Time.examples()
        );
        return Err(super::map_fault(
            choice,
            &format!("no unit is stated, and rows are {usual:.3e} apart"),
            &expected,
        ));
    }
    if let Some(doubt) = column.unit_doubt.as_ref().filter(|doubt| !matches!(doubt, UnitDoubt::Unknown(_))) {
        let expected = format!("--map '{}=time_s:UNIT' with {}", choice.column, Quantity::Time.examples());
        return Err(super::map_fault(choice, &doubt.to_string(), &expected));
    }
    notes.push(format!(
        "{}: \"{}\" states no unit, and is taken as seconds",
        table.path.display(),
        column.header
    ));
    named("s", table)
}

/// Whether times are those of a computer, since 1970.
pub(super) fn is_of_computer(column: &RawColumn, unit: &Unit) -> bool {
    column.origin as f64 * unit.to_si >= SINCE_1970[3].0
}

/// A table without times where they are needed.
pub(super) fn missing(table: &RawTable) -> TableError {
    fn names(table: &RawTable, is: impl Fn(&&RawColumn) -> bool) -> Vec<&str> {
        table.columns.iter().filter(is).map(|column| column.header.as_str()).collect()
    }
    let of_time = names(table, |column| is_time(column));
    let problem = if of_time.len() > 1 {
        format!("{} are columns of times", of_time.join(" and "))
    } else {
        format!("no column of times among {}", names(table, |_| true).join(", "))
    };
    TableError::File {
        path: table.path.clone(),
        problem,
        expected: match table.stated_rate {
            Some(stated) => format!(
                "--map 'COLUMN=time_s:UNIT', or --rate-hz {} for rows at one rate, as line {} states",
                stated.hz, stated.line
            ),
            None => "--map 'COLUMN=time_s:UNIT', or --rate-hz for rows at one rate".to_owned(),
        },
    }
}

/// Notes a rate of the user where the file states another.
fn note_stated_rate(table: &RawTable, hz: f64, notes: &mut Vec<String>) {
    if let Some(stated) = table.stated_rate.filter(|stated| !stated.is(hz)) {
        notes.push(format!(
            "{}: line {}: the file states {} rows a second, and --rate-hz {hz} is taken",
            table.path.display(),
            stated.line,
            stated.hz
        ));
    }
}

/// Notes a rate of the user where the file has times: these are taken.
fn note_unused_rate(table: &RawTable, header: &str, times_s: &[f64], hz: f64, notes: &mut Vec<String>) {
    let mut steps_s: Vec<f64> =
        times_s.windows(2).map(|pair| pair[1] - pair[0]).filter(|step_s| *step_s > 0.0).collect();
    steps_s.sort_by(f64::total_cmp);
    let usual_hz = steps_s.get(steps_s.len() / 2).copied().unwrap_or(0.0).recip();
    // By less than a row over the whole record.
    if (usual_hz - hz).abs() * times_s.len() as f64 > usual_hz {
        notes.push(format!(
            "{}: \"{header}\" has times, usually {usual_hz:.4} rows a second: they are taken, and --rate-hz {hz} is not used",
            table.path.display()
        ));
    }
}

/// Adds what a column holds of a time beyond the whole units of another one, as `nanosec` does beside `sec`.
fn add_fraction(
    times_s: &mut [f64],
    table: &RawTable,
    fraction: &Part,
    whole_to_si: f64,
) -> Result<(), TableError> {
    let (column, to_si) = (fraction.column, fraction.unit.to_si);
    if let Some((line, text)) = &column.bad {
        return Err(super::series::bad(table, &column.header, *line, text));
    }
    for ((time_s, value), line) in times_s.iter_mut().zip(&column.values).zip(&table.lines) {
        let fraction_s = (column.origin as f64 + value) * to_si;
        if fraction_s < 0.0 || fraction_s >= whole_to_si {
            return Err(TableError::Cell {
                path: table.path.clone(),
                line: *line,
                field: column.header.clone(),
                problem: format!("{fraction_s} s beside a time in units of {whole_to_si} s"),
                expected: "one column of times, or a second one with the fraction of its unit".to_owned(),
            });
        }
        *time_s += fraction_s;
    }
    Ok(())
}

/// A table with its times.
pub(in super::super) struct Timed<'t> {
    pub table: &'t RawTable,
    /// From the column's origin; none where it has no times.
    pub times_s: Option<Vec<f64>>,
    /// Name and header of the column.
    names: Vec<String>,
    /// The origin in its unit, and that unit.
    origin: i64,
    to_si: f64,
    /// Whether it is a date, a time since 1970 or a time of day, which other files have too.
    is_shared: bool,
}

impl<'t> Timed<'t> {
    pub(super) fn new(
        table: &'t RawTable,
        parts: &[Part],
        options: &Options,
        notes: &mut Vec<String>,
    ) -> Result<Self, TableError> {
        let mut time_parts: Vec<&Part> = parts
            .iter()
            .filter(|part| part.target.quantity == Quantity::Time && std::ptr::eq(part.table, table))
            .collect();
        time_parts.sort_by(|a, b| b.unit.to_si.total_cmp(&a.unit.to_si));
        let Some((time_column, finer)) = time_parts.split_first() else {
            // A shape has no rate.
            let rate_hz = options.rate_hz.filter(|_| {
                parts.iter().any(|part| {
                    let is_own = std::ptr::eq(part.table, table);
                    is_own
                        && ["force_", "displacement_"].iter().any(|start| part.target.name.starts_with(start))
                })
            });
            let times_s = rate_hz.map(|hz| {
                note_stated_rate(table, hz, notes);
                counter::row_numbers(table, parts, notes).into_iter().map(|number| number / hz).collect()
            });
            return Ok(Self { table, times_s, names: Vec::new(), origin: 0, to_si: 1.0, is_shared: false });
        };
        let column = time_column.column;
        if let Some((line, text)) = &column.bad {
            return Err(super::series::bad(table, &column.header, *line, text));
        }
        let to_si = time_column.unit.to_si;
        let mut times_s: Vec<f64> = column.values.iter().map(|value| value * to_si).collect();
        for fraction in finer.iter().filter(|finer| !std::ptr::eq(finer.column, column)) {
            add_fraction(&mut times_s, table, fraction, to_si)?;
        }
        let measures_force = parts
            .iter()
            .any(|part| std::ptr::eq(part.table, table) && part.target.quantity == Quantity::Force);
        if let Some(hz) = options.rate_hz.filter(|_| measures_force) {
            note_unused_rate(table, &column.header, &times_s, hz, notes);
        }
        let is_of_day = column.is_stamp && column.origin < DAY_S as i64;
        let mut days = 0.0;
        let (mut latest_s, mut repeated) = (f64::NEG_INFINITY, 0usize);
        for (time_s, line) in times_s.iter_mut().zip(&table.lines) {
            if time_s.is_nan() {
                continue;
            }
            *time_s += days;
            if is_of_day && *time_s < latest_s - 0.5 * DAY_S {
                days += DAY_S;
                *time_s += DAY_S;
            }
            if *time_s < latest_s {
                return Err(TableError::Cell {
                    path: table.path.clone(),
                    line: *line,
                    field: column.header.clone(),
                    problem: format!("{:.6} s before the row before", latest_s - *time_s),
                    expected: "times that never step back: was the clock set, or are two recordings joined?"
                        .to_owned(),
                });
            }
            repeated += usize::from(*time_s == latest_s);
            latest_s = *time_s;
        }
        if days > 0.0 {
            notes.push(format!("{}: \"{}\" passes midnight", table.path.display(), column.header));
        }
        // Points of a shape share the time of their sweep.
        let has_shape =
            parts.iter().any(|part| std::ptr::eq(part.table, table) && part.target.name == "z_mm");
        if repeated > 0 && !has_shape {
            let measured: Vec<&Part> = parts
                .iter()
                .filter(|part| std::ptr::eq(part.table, table) && part.target.quantity != Quantity::Time)
                .collect();
            let remedy = match coarse::spread(&mut times_s, &measured) {
                Some(hz) => {
                    format!("the clock shows fewer digits, and they are spread evenly, {hz:.4} a second")
                }
                None => "the mean of such rows is taken".to_owned(),
            };
            notes.push(format!(
                "{}: {repeated} rows have the time of the row before: {remedy}",
                table.path.display()
            ));
        }
        let is_shared = column.is_stamp || is_of_computer(column, &time_column.unit);
        let names = vec![column.header.clone(), column.name.clone()];
        Ok(Self { table, times_s: Some(times_s), names, origin: column.origin, to_si, is_shared })
    }

    /// Whether its column of times has this name.
    pub(super) fn is_named(&self, name: &str) -> bool {
        self.names.iter().any(|known| known.to_lowercase() == name.to_lowercase())
    }

    /// Shift from its times to those of another table, if both have one clock.
    pub(super) fn shift_to(&self, base: &Self, options: &Options) -> Option<f64> {
        if std::ptr::eq(self.table, base.table) {
            return Some(0.0);
        }
        let is_one = options
            .merge_on
            .as_ref()
            .is_some_and(|name| [self, base].iter().all(|timed| timed.is_named(name)))
            || self.is_shared && base.is_shared;
        is_one.then(|| self.origin_shift_s(base))
    }

    /// The same as if both had one clock: the difference of what is subtracted from their times.
    pub(super) fn origin_shift_s(&self, base: &Self) -> f64 {
        // Whole numbers are subtracted as such where the units are the same.
        if self.to_si == base.to_si {
            self.origin.saturating_sub(base.origin) as f64 * self.to_si
        } else {
            self.origin as f64 * self.to_si - base.origin as f64 * base.to_si
        }
    }
}
