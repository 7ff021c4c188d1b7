//! Shapes, row by row: they have no common clock with the force, or none at all.

use super::clock::Timed;
use super::{Options, Part, ZOrigin, series};
use crate::foreign::TableError;
use crate::foreign::align::Clock;
use crate::session::ShapeSeries;

/// The column for this target, where there is one.
pub(super) fn part_named<'p, 't>(parts: &'p [Part<'t>], name: &str) -> Option<&'p Part<'t>> {
    parts.iter().find(|part| part.target.name == name)
}

/// The values of these rows.
pub(super) fn pick(values: &[f64], rows: &[usize]) -> Vec<f64> {
    rows.iter().filter_map(|row| values.get(*row).copied()).collect()
}

/// The shape, where there is one; `clock` brings times of a table to those of the run.
pub(super) fn shape(
    parts: &[Part],
    timed: &[Timed],
    options: &Options,
    clock: impl Fn(usize) -> Option<Clock>,
) -> Result<Option<ShapeSeries>, TableError> {
    let (Some(z), Some(y)) = (part_named(parts, "z_mm"), part_named(parts, "deflection_y_mm")) else {
        return Ok(None);
    };
    let origin_m = match options.z_from {
        Some(ZOrigin::Guide1) => 0.0,
        Some(ZOrigin::Surface) => options.entry_m,
        None => {
            return Err(missing_origin());
        }
    };
    let x = part_named(parts, "deflection_x_mm");
    for other in [Some(y), x].into_iter().flatten() {
        series::same_table(z, other)?;
    }
    let table_index = timed.iter().position(|timed| std::ptr::eq(timed.table, z.table)).unwrap_or(0);
    let times_s = match timed.get(table_index).and_then(|timed| timed.times_s.as_ref()) {
        None => None,
        Some(times_s) => {
            let clock = clock(table_index).ok_or_else(|| TableError::Map {
                choice: "--merge-on".to_owned(),
                problem: format!("{} has a clock of its own", z.table.path.display()),
                expected: "the column of times that it shares with the force; or no column of times, for a shape of the last hold".to_owned(),
            })?;
            Some(times_s.iter().map(|time_s| clock.time_s(*time_s)).collect::<Vec<f64>>())
        }
    };
    let columns: Vec<Vec<f64>> =
        [Some(z), Some(y), x].into_iter().flatten().map(series::values).collect::<Result<_, _>>()?;
    let rows: Vec<usize> = (0..z.column.values.len())
        .filter(|row| columns.iter().all(|column| column.get(*row).is_some_and(|value| value.is_finite())))
        .collect();
    let picked = |table_index: usize| columns.get(table_index).map(|values| pick(values, &rows));
    Ok(Some(ShapeSeries {
        time_s: times_s.as_ref().map(|times_s| pick(times_s, &rows)),
        z_m: picked(0).unwrap_or_default().into_iter().map(|z_m| z_m + origin_m).collect(),
        y_m: picked(1).unwrap_or_default(),
        x_m: x.and_then(|_| picked(2)),
        ..ShapeSeries::default()
    }))
}

/// A shape without the place from which its positions are.
pub(super) fn missing_origin() -> TableError {
    TableError::Map {
        choice: "--z-from".to_owned(),
        problem: "missing".to_owned(),
        expected:
            "guide1 or surface: the place from which the positions along the needle (z_mm) are measured"
                .to_owned(),
    }
}

/// Refuses a shape of another time than the run, which ends at `end_s`.
pub(super) fn check_times(shape: Option<&ShapeSeries>, end_s: f64) -> Result<(), TableError> {
    let times_s = shape.and_then(|shape| shape.time_s.as_deref()).unwrap_or_default();
    let least_s = times_s.iter().copied().fold(f64::INFINITY, f64::min);
    let most_s = times_s.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if times_s.is_empty() || least_s <= end_s && most_s >= 0.0 {
        return Ok(());
    }
    Err(TableError::Map {
        choice: "time_s".to_owned(),
        problem: format!("the shape is at {least_s:.3} to {most_s:.3} s, and the force at 0 to {end_s:.3} s"),
        expected: "a shape that was measured during the run: one clock (--merge-on COLUMN), with the same day, and am or pm alike"
            .to_owned(),
    })
}
