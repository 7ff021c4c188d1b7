//! Readings over time, and what is wrong with them.

use super::super::TableError;
use super::super::raw::{RawColumn, RawTable};
use super::{Part, Zero};

/// Between readings that are further apart than so many periods nothing is interpolated.
const MAX_GAP: f64 = 3.5;
/// A displacement that is never nearer to 0 than this share of its range is a position of a stage.
const ABSOLUTE: f64 = 0.25;
/// Readings at the beginning of which the position is that of the zero.
const FIRST: usize = 11;
/// Correlation of force and displacement below which the force acts against it.
const AGAINST: f64 = -0.5;

/// Readings in the order of their times, all of which differ.
#[derive(Debug, Clone, PartialEq)]
pub(in super::super) struct Series {
    readings: Vec<(f64, f64)>,
    period_s: f64,
}

impl Series {
    /// The readings of a column, in SI. Those of one time are one.
    pub fn new(part: &Part, times_s: &[f64]) -> Result<Self, TableError> {
        let values = values(part)?;
        let finite_pairs = times_s
            .iter()
            .copied()
            .zip(values)
            .filter(|(time_s, value)| time_s.is_finite() && value.is_finite());
        Ok(Self::of(finite_pairs.collect()))
    }

    /// Series of readings whose times never step back.
    pub fn of(all: Vec<(f64, f64)>) -> Self {
        let readings: Vec<(f64, f64)> = all
            .chunk_by(|a, b| a.0 == b.0)
            .filter_map(|same| {
                let mean = same.iter().map(|(_, value)| value).sum::<f64>() / same.len() as f64;
                Some((same.first()?.0, mean))
            })
            .collect();
        let mut steps: Vec<f64> = readings.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
        steps.sort_by(f64::total_cmp);
        let period_s = steps.get(steps.len() / 2).copied().unwrap_or(0.0);
        Self { readings, period_s }
    }

    pub fn readings(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.readings.iter().copied()
    }

    pub fn len(&self) -> usize {
        self.readings.len()
    }

    /// Time from one reading to the next, usually.
    pub fn period_s(&self) -> f64 {
        self.period_s
    }

    /// First and last time.
    pub fn span_s(&self) -> Option<[f64; 2]> {
        Some([self.readings.first()?.0, self.readings.last()?.0])
    }

    /// The same, later by this.
    pub fn shifted(mut self, by_s: f64) -> Self {
        self.readings.iter_mut().for_each(|(time_s, _)| *time_s += by_s);
        self
    }

    /// The value at a time, linearly between readings; none outside of them and in gaps.
    pub fn at(&self, time_s: f64) -> Option<f64> {
        let next_index = self.readings.partition_point(|(reading_s, _)| *reading_s <= time_s);
        let (earlier_s, earlier_value) = *self.readings.get(next_index.checked_sub(1)?)?;
        let Some((later_s, later_value)) = self.readings.get(next_index).copied() else {
            return (time_s == earlier_s).then_some(earlier_value);
        };
        if earlier_s == time_s {
            return Some(earlier_value);
        }
        let gap_s = later_s - earlier_s;
        (gap_s <= MAX_GAP * self.period_s)
            .then(|| earlier_value + (later_value - earlier_value) * (time_s - earlier_s) / gap_s)
    }
}

/// The values of a column in SI; NaN where there is none.
pub(super) fn values(part: &Part) -> Result<Vec<f64>, TableError> {
    let Part { table, column, unit, .. } = part;
    if let Some((line, text)) = &column.bad {
        return Err(bad(table, column, *line, text));
    }
    let origin = column.origin as f64;
    Ok(column.values.iter().map(|value| (origin + value) * unit.to_si).collect())
}

/// A cell that is no number.
pub(super) fn bad(table: &RawTable, column: &RawColumn, line: usize, text: &str) -> TableError {
    TableError::Cell {
        path: table.path.clone(),
        line,
        field: column.header.clone(),
        problem: format!("\"{}\" is not a number", text.chars().take(40).collect::<String>()),
        expected: "numbers, empty cells or nan".to_owned(),
    }
}

/// Refuses columns of two files where one is expected.
pub(super) fn same_table(a: &Part, b: &Part) -> Result<(), TableError> {
    if std::ptr::eq(a.table, b.table) {
        return Ok(());
    }
    Err(TableError::Map {
        choice: b.target.name.to_owned(),
        problem: format!("in another file than {}", a.target.name),
        expected: "both in one file, row by row".to_owned(),
    })
}

/// Counts a displacement from where the run begins.
pub(super) fn refer_to_zero(name: &str, values_m: &mut [f64], zero: Zero, notes: &mut Vec<String>) {
    let (least, most) =
        values_m.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, m), v| (l.min(*v), m.max(*v)));
    let nearest = if least > 0.0 { least } else { (-most).max(0.0) };
    let is_absolute = nearest > ABSOLUTE * (most - least);
    let is_moved = match zero {
        Zero::Auto => is_absolute,
        Zero::First => true,
        Zero::Written => false,
    };
    if !is_moved {
        return;
    }
    let mut first: Vec<f64> = values_m.iter().take(FIRST).copied().collect();
    first.sort_by(f64::total_cmp);
    let zero_m = first.get(first.len() / 2).copied().unwrap_or(0.0);
    values_m.iter_mut().for_each(|value| *value -= zero_m);
    let why = if zero == Zero::Auto {
        format!("is never near 0 ({:.3} to {:.3} mm) and taken as a position", 1e3 * least, 1e3 * most)
    } else {
        "is counted from where it begins".to_owned()
    };
    notes.push(format!(
        "{name} {why}: its zero is where the run begins, {:.4} mm (--zero written keeps it)",
        1e3 * zero_m
    ));
}

/// Refuses what no run has: a wrong unit.
pub(super) fn check_range(name: &str, values: &[f64], most: f64) -> Result<(), TableError> {
    match values.iter().find(|value| value.abs() > most) {
        Some(value) => Err(TableError::Map {
            choice: name.to_owned(),
            problem: format!("{value:.6} in SI"),
            expected: format!(
                "at most {most} m or N: is the unit right? A number that stands for a missing reading is left empty"
            ),
        }),
        None => Ok(()),
    }
}

/// Remarks on a force that acts against the displacement.
pub(super) fn check_sign(force_n: &[f64], moved_m: &[f64], notes: &mut Vec<String>) {
    let n = force_n.len() as f64;
    let (f0, x0) = (force_n.iter().sum::<f64>() / n, moved_m.iter().sum::<f64>() / n);
    let (mut ff, mut xx, mut fx) = (0.0, 0.0, 0.0);
    for (f, x) in force_n.iter().zip(moved_m) {
        (ff, xx, fx) = (ff + (f - f0).powi(2), xx + (x - x0).powi(2), fx + (f - f0) * (x - x0));
    }
    if fx < AGAINST * (ff * xx).sqrt() {
        notes.push(
            "the force falls where the displacement rises, as that of the tissue on the sensor does: a minus before its unit turns it round (--map '...=force_y_n:-N')"
                .to_owned(),
        );
    }
}
