//! Readings for a calibration, as people note them down: known loads with the reported forces, a gauge with the reported positions.

use crate::document::SessionError;
use crate::document::table::{Column, Table};
use std::path::Path;

/// Newtons; more than any sensor of the rig takes.
const FORCE_N: [f64; 2] = [-1_000.0, 1_000.0];
/// Range of a record's 16 bits of micrometres.
const POSITION_MM: [f64; 2] = [-32.768, 32.767];
const MM: f64 = 1e-3;
const LOADS: [Column; 4] = [
    Column::required("load_x_n", 1.0, FORCE_N),
    Column::required("load_y_n", 1.0, FORCE_N),
    Column::required("force_x_n", 1.0, FORCE_N),
    Column::required("force_y_n", 1.0, FORCE_N),
];
const GAUGE: [Column; 2] =
    [Column::required("gauge_mm", MM, POSITION_MM), Column::required("position_mm", MM, POSITION_MM)];

/// Reads known loads: `load_x_n,load_y_n,force_x_n,force_y_n`. True and reported force on the sensor of each row, along
/// x and y, newtons.
///
/// # Errors
/// [`SessionError`] with file, line, column and field.
pub fn read_loads(path: &Path) -> Result<Vec<[[f64; 2]; 2]>, SessionError> {
    let mut table = Table::read(path, &LOADS)?;
    let [x, y, force_x, force_y] = LOADS.map(|column| table.take_required(column.name));
    let loads = x.into_iter().zip(y).zip(force_x.into_iter().zip(force_y));
    Ok(loads.map(|((x, y), (force_x, force_y))| [[x, y], [force_x, force_y]]).collect())
}

/// Reads a gauge, in the order of the motion: `gauge_mm,position_mm`. Position by the gauge and reported position of
/// each row, metres.
///
/// # Errors
/// [`SessionError`] with file, line, column and field.
pub fn read_gauge(path: &Path) -> Result<Vec<[f64; 2]>, SessionError> {
    let mut table = Table::read(path, &GAUGE)?;
    let [gauge, reported] = GAUGE.map(|column| table.take_required(column.name));
    Ok(gauge.into_iter().zip(reported).map(|(gauge, reported)| [gauge, reported]).collect())
}
