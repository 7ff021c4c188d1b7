//! Assigns columns to quantities of the session: as the user states it, and as names and units show.

use super::TableError;
use super::raw::{RawColumn, RawTable};
use super::unit::{Quantity, Unit};
use crate::document::{Fields, Problem, SessionError, names::misspelt, read_text};
use std::fmt::Write as _;
use std::path::Path;

/// A quantity of a session.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Target {
    /// Its column in the session.
    pub name: &'static str,
    /// Quantity of the column.
    pub quantity: Quantity,
    /// SI to the unit of that column.
    pub from_si: i32,
}

const fn target(name: &'static str, quantity: Quantity, from_si: i32) -> Target {
    Target { name, quantity, from_si }
}

impl Target {
    /// All of them; `from_si` is the power of ten from SI to the unit in the name.
    pub const ALL: [Self; 14] = [
        target("time_s", Quantity::Time, 0),
        target("displacement_y_mm", Quantity::Length, 3),
        target("force_y_n", Quantity::Force, 0),
        target("displacement_x_mm", Quantity::Length, 3),
        target("force_x_n", Quantity::Force, 0),
        target("z_mm", Quantity::Length, 3),
        target("deflection_y_mm", Quantity::Length, 3),
        target("deflection_x_mm", Quantity::Length, 3),
        target("depth_mm", Quantity::Length, 3),
        target("tip_y_mm", Quantity::Length, 3),
        target("tip_x_mm", Quantity::Length, 3),
        target("rotation_deg", Quantity::Angle, 0),
        target("guide2_y_mm", Quantity::Length, 3),
        target("guide2_x_mm", Quantity::Length, 3),
    ];

    /// The one of this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|target| target.name == name)
    }

    /// In the unit of its name.
    pub fn shown(self, si: f64) -> f64 {
        if self.quantity == Quantity::Angle { si.to_degrees() } else { si * 10f64.powi(self.from_si) }
    }
}

/// One column that is taken: `Force [g]=force_y_n:g`.
#[derive(Debug, Clone, PartialEq)]
pub struct Choice {
    /// Name of the column, or `#3`.
    pub column: String,
    /// Target of the column.
    pub target: Target,
    /// Its unit, where the user states it; a minus before it turns the direction.
    pub unit: Option<Unit>,
}

impl Choice {
    /// Reads `COLUMN=QUANTITY[:UNIT]`.
    ///
    /// # Errors
    /// [`TableError::Map`].
    pub fn parse(text: &str) -> Result<Self, TableError> {
        fn fault(problem: String, expected: String, text: &str) -> TableError {
            TableError::Map { choice: text.to_owned(), problem, expected }
        }
        fn form() -> String {
            "COLUMN=QUANTITY:UNIT, such as 'Force [g]=force_y_n:g'".to_owned()
        }
        let (column, unit_text) =
            text.rsplit_once('=').ok_or_else(|| fault("no =".to_owned(), form(), text))?;
        let (name, unit) =
            unit_text.split_once(':').map_or((unit_text, None), |(name, unit)| (name, Some(unit)));
        let target = Target::named(name.trim()).ok_or_else(|| {
            let target_names = Target::ALL.map(|target| target.name);
            let meant =
                misspelt(name.trim(), target_names).map_or_else(String::new, |meant| format!("{meant}, or "));
            fault(
                format!("\"{}\" is no quantity", name.trim()),
                format!("{meant}one of {}", target_names.join(", ")),
                text,
            )
        })?;
        let unit = unit.map(|unit| {
            let matching_unit = Unit::multiple(unit).filter(|known| known.quantity == target.quantity);
            let quantity = target.quantity;
            matching_unit.ok_or_else(|| {
                let expected = format!("{}, or a multiple: {}", quantity.examples(), quantity.multiple());
                fault(format!("\"{}\" is no unit of {quantity}", unit.trim()), expected, text)
            })
        });
        Ok(Self { column: column.trim().to_owned(), target, unit: unit.transpose()? })
    }

    /// As it is given.
    pub fn text(&self) -> String {
        let unit = self.unit.as_ref().map_or_else(String::new, |unit| format!(":{}", unit.name));
        format!("{}={}{unit}", self.column, self.target.name)
    }
}

/// The columns that are taken.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Mapping {
    /// In the order of the user.
    pub choices: Vec<Choice>,
}

impl Mapping {
    /// Reads a mapping's file.
    ///
    /// # Errors
    /// [`TableError`] with its place.
    pub fn read(path: &Path) -> Result<Self, TableError> {
        let text = read_text(path)?;
        let mut choices = Vec::new();
        let read = Fields::parse(path, &text, |file| {
            let table = file.table("table")?;
            table.format()?;
            file.tables("column")?
                .iter()
                .map(|column| {
                    column.only(&["name", "is", "unit"])?;
                    let unit =
                        column.optional_text("unit")?.map_or_else(String::new, |unit| format!(":{unit}"));
                    let text = format!("{}={}{unit}", column.text("name")?, column.text("is")?);
                    Choice::parse(&text).map_err(|error| {
                        let words = error.to_string();
                        column.field_fault(
                            "is",
                            Problem::Syntax(words),
                            "a quantity of a session and its unit",
                        )
                    })
                })
                .collect::<Result<Vec<_>, SessionError>>()
        })?;
        choices.extend(read);
        Ok(Self { choices })
    }

    /// The file's text.
    pub fn to_toml(&self) -> String {
        fn quoted(text: &str) -> String {
            toml::Value::from(text).to_string()
        }
        let mut text = "# Quantities of the columns of a table: guide import table FILE --map-file THIS\n[table]\nformat = 1\n".to_owned();
        for Choice { column, target, unit } in &self.choices {
            let _ = write!(text, "\n[[column]]\nname = {}\nis = \"{}\"\n", quoted(column), target.name);
            if let Some(unit) = unit {
                let _ = writeln!(text, "unit = {}", quoted(&unit.name));
            }
        }
        text
    }

    /// Whether a choice is of this column of a table.
    fn is_taken(&self, table: &RawTable, column: &RawColumn) -> bool {
        self.choices.iter().any(|choice| {
            table.find(&choice.column).ok().flatten().and_then(|at| table.columns.get(at)) == Some(column)
        })
    }

    /// Adds what names and units show, for quantities that nothing is stated of: nothing where two columns are alike.
    pub fn completed(&self, tables: &[RawTable]) -> Self {
        let mut choices = self.choices.clone();
        for table in tables {
            let free: Vec<&RawColumn> =
                table.columns.iter().filter(|column| !self.is_taken(table, column)).collect();
            let has_time = choices.iter().any(|choice| {
                choice.target.quantity == Quantity::Time
                    && table.find(&choice.column).is_ok_and(|place| place.is_some())
            });
            let of_day = (!has_time).then(|| stamp_and_fraction(&free)).flatten();
            if let Some(pair) = of_day {
                choices.extend(pair);
            } else if !has_time && let Some(time) = only(&free, is_time).or_else(|| only(&free, is_in_time)) {
                choices.push(Choice {
                    column: time.own_name(),
                    target: Target::ALL[0],
                    unit: time.unit.clone().filter(|_| !time.is_stamp),
                });
            }
            if !has_time && let Some(pair) = seconds_and_fraction(&free) {
                choices.extend(pair);
            }
            // The session's own names are what they say, in a table of which the user states nothing.
            if table.columns.iter().filter(|column| self.is_taken(table, column)).all(is_time) {
                for (column, target) in named_as_in_a_session(&free) {
                    if choices.iter().all(|choice| choice.target != target) {
                        choices.push(Choice { column: column.own_name(), target, unit: column.unit.clone() });
                    }
                }
            }
            // What the user states of a shape or an insertion applies to all columns of its table.
            fn is_of_push(choice: &Choice) -> bool {
                ["time_", "force_", "displacement_"].iter().any(|start| choice.target.name.starts_with(start))
            }
            let is_here = |choice: &&Choice| table.find(&choice.column).is_ok_and(|found| found.is_some());
            if !self.choices.iter().filter(is_here).all(is_of_push) {
                continue;
            }
            // A column is one quantity: that along x is not that along y, too.
            let stated = Self { choices: choices.clone() };
            let free: Vec<&RawColumn> =
                free.into_iter().filter(|column| !stated.is_taken(table, column)).collect();
            for (target, quantity, words) in GUESSED {
                let Some(target) = Target::named(target) else { continue };
                let is_chosen = |name: &str| choices.iter().any(|choice| choice.target.name == name);
                // A position along the needle is one of a shape.
                if is_chosen(target.name) || target.name == "z_mm" && !is_chosen("deflection_y_mm") {
                    continue;
                }
                let is_stated = |column: &RawColumn| column.unit.is_some() && is_of(column, quantity, words);
                // A unit that is not known beside one that is: of another quantity.
                let has_stated = free.iter().any(|column| is_stated(column));
                if let Some(column) = if has_stated {
                    only(&free, is_stated)
                } else {
                    only(&free, |column| is_of(column, quantity, words))
                } {
                    choices.push(Choice { column: column.own_name(), target, unit: column.unit.clone() });
                }
            }
        }
        // A deflection without its place along the needle is none, whatever its name is.
        if choices.iter().all(|choice| choice.target.name != "z_mm") {
            choices.retain(|choice| {
                !choice.target.name.starts_with("deflection_") || self.choices.contains(choice)
            });
        }
        Self { choices }
    }
}

/// Words of names for what is guessed: quantities along one axis, taken as the vertical one.
const GUESSED: [(&str, Quantity, &[&str]); 4] = [
    ("force_y_n", Quantity::Force, &["force", "load", "weight", "kraft", "gewicht", "fy", "fx", "fz", "f"]),
    (
        "displacement_y_mm",
        Quantity::Length,
        &[
            "displacement",
            "disp",
            "extension",
            "stroke",
            "crosshead",
            "position",
            "pos",
            "stage",
            "actuator",
            "weg",
            "travel",
        ],
    ),
    ("deflection_y_mm", Quantity::Length, &["deflection", "shape", "bow", "bend", "bending", "sag"]),
    ("z_mm", Quantity::Length, &["z", "along", "arc"]),
];

/// Words of columns beside the measured one: what a controller wants, how far it is from that, what a sensor has besides.
const NOT_MEASURED: [&str; 24] = [
    "setpoint",
    "soll",
    "sollwert",
    "target",
    "command",
    "commanded",
    "cmd",
    "desired",
    "demand",
    "reference",
    "ref",
    "error",
    "err",
    "deviation",
    "offset",
    "tare",
    "limit",
    "rate",
    "velocity",
    "speed",
    "temperature",
    "temp",
    "sd",
    "std",
];

/// The one of which it is true.
fn only<'c>(columns: &[&'c RawColumn], is: impl Fn(&RawColumn) -> bool) -> Option<&'c RawColumn> {
    let mut matching_columns = columns.iter().filter(|column| is(column));
    match (matching_columns.next(), matching_columns.next()) {
        (Some(one), None) => Some(one),
        _ => None,
    }
}

/// Columns with the names of a session: of an insertion where depth and tip are among them, else of a lateral run.
fn named_as_in_a_session<'c>(columns: &[&'c RawColumn]) -> Vec<(&'c RawColumn, Target)> {
    let is_insertion =
        ["depth_mm", "tip_y_mm"].iter().all(|name| columns.iter().any(|column| column.header == *name));
    let of_insertion = ["depth_", "tip_", "rotation_", "guide2_"];
    columns
        .iter()
        .filter_map(|column| {
            let target = Target::named(&column.header)?;
            let is_meant = of_insertion.iter().any(|start| target.name.starts_with(start)) == is_insertion;
            (is_meant && target.quantity != Quantity::Time).then_some((*column, target))
        })
        .collect()
}

/// Seconds and nanoseconds in columns of their own, as stamps of ROS are written: `stamp.sec` and `stamp.nanosec`.
fn seconds_and_fraction(columns: &[&RawColumn]) -> Option<[Choice; 2]> {
    fn column_in(unit: &str, endings: &[&str], columns: &[&RawColumn]) -> Option<(Vec<String>, Choice)> {
        let column = only(columns, |column| {
            words(&column.header).last().is_some_and(|word| endings.contains(&word.as_str()))
        })?;
        let mut name = words(&column.header);
        name.pop();
        let unit = Some(Unit::parse(unit)?);
        Some((name, Choice { column: column.own_name(), target: Target::ALL[0], unit }))
    }
    let (of_whole, whole) = column_in("s", &["sec", "secs", "seconds"], columns)?;
    let (of_fraction, fraction) =
        column_in("ns", &["nsec", "nsecs", "nanosec", "nanosecs", "nanoseconds"], columns)?;
    (of_whole == of_fraction).then_some([whole, fraction])
}

/// A clock of whole seconds, and its fraction in a column of its own: `10:59:58` beside `ms`.
fn stamp_and_fraction(columns: &[&RawColumn]) -> Option<[Choice; 2]> {
    let clock = only(columns, |column| column.is_stamp)?;
    if clock.values.iter().any(|value| !value.is_nan() && value.fract() != 0.0) {
        return None;
    }
    let fraction_units: [(&str, f64, &[&str]); 2] = [
        ("ms", 1e3, &["ms", "msec", "millis", "millisecond", "milliseconds", "millisec"]),
        ("us", 1e6, &["us", "usec", "micros", "microsecond", "microseconds", "microsec"]),
    ];
    fraction_units.into_iter().find_map(|(unit, most, names)| {
        let fraction = only(columns, |column| {
            let is_named = words(&column.header).last().is_some_and(|word| names.contains(&word.as_str()));
            is_named
                && column.values.iter().all(|value| {
                    let number = column.origin as f64 + value;
                    value.is_nan() || number.fract() == 0.0 && (0.0..most).contains(&number)
                })
        })?;
        fn time(column: &RawColumn, unit: Option<Unit>) -> Choice {
            Choice { column: column.own_name(), target: Target::ALL[0], unit }
        }
        Some([time(clock, None), time(fraction, Some(Unit::parse(unit)?))])
    })
}

fn words(name: &str) -> Vec<String> {
    name.to_lowercase()
        .split(|c: char| !c.is_alphanumeric())
        .filter(|word| !word.is_empty())
        .map(str::to_owned)
        .collect()
}

/// Columns of a table that may be this quantity, by their names and units.
pub(super) fn candidates<'t>(name: &str, table: &'t RawTable) -> Vec<&'t RawColumn> {
    let guessed = GUESSED.iter().find(|(target, ..)| *target == name);
    let columns = table.columns.iter();
    columns
        .filter(|column| guessed.is_some_and(|(_, quantity, words)| is_of(column, *quantity, words)))
        .collect()
}

/// Whether a column is a clock, by its name or its content.
pub(super) fn is_time(column: &RawColumn) -> bool {
    let is_named = words(&column.name).iter().any(|word| {
        ["time", "timestamp", "when", "date", "zeit", "t", "elapsed", "stamp", "temps", "tiempo", "clock"]
            .contains(&word.as_str())
    });
    let is_other = column.unit.as_ref().is_some_and(|unit| unit.quantity != Quantity::Time);
    column.is_stamp || !is_other && is_named
}

/// Whether a column in a unit of time never steps back, as a clock of any name does and a delay does not.
fn is_in_time(column: &RawColumn) -> bool {
    column.unit.as_ref().is_some_and(|unit| unit.quantity == Quantity::Time)
        && column.values.first() < column.values.last()
        && column.values.windows(2).all(|pair| pair[0] <= pair[1])
}

fn is_of(column: &RawColumn, quantity: Quantity, known: &[&str]) -> bool {
    let is_unit = column.unit.as_ref().is_none_or(|unit| unit.quantity == quantity);
    let words = words(&column.name);
    is_unit
        && words.iter().any(|word| known.contains(&word.as_str()))
        && !words.iter().any(|word| NOT_MEASURED.contains(&word.as_str()))
}
