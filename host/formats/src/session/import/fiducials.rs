//! Lists of points of 3D Slicer before version 5 (`.fcsv`): a header behind `#`, and a point in a line.

use crate::document::{Place, Problem, SessionError};
use std::path::Path;

/// Start of such a file.
pub(super) const START: &str = "# Markups fiducial file";

/// A list of points.
pub(super) struct Fiducials {
    /// Whether x is left and y posterior, not right and anterior.
    pub is_lps: bool,
    /// Positions, millimetres, and whether they are selected.
    pub points: Vec<([f64; 3], bool)>,
}

impl Fiducials {
    /// Reads a list.
    ///
    /// # Errors
    /// [`SessionError`] with its line and cell.
    pub fn parse(path: &Path, text: &str) -> Result<Self, SessionError> {
        let fault = |line: usize, column: usize, field: &str, problem: Problem, expected: &str| {
            let location = Place { path: path.to_owned(), line, column };
            SessionError::Field {
                place: location,
                field: field.to_owned(),
                problem,
                expected: expected.to_owned(),
            }
        };
        let (mut is_lps, mut names, mut points) = (None, None, Vec::new());
        for (line, text) in text.lines().enumerate().map(|(at, text)| (at + 1, text.trim())) {
            if let Some(remark) = text.strip_prefix('#') {
                let Some((key, value)) = remark.split_once('=') else { continue };
                match (key.trim(), value.trim()) {
                    ("CoordinateSystem", "LPS" | "1") => is_lps = Some(true),
                    ("CoordinateSystem", "RAS" | "0") => is_lps = Some(false),
                    ("CoordinateSystem", other) => {
                        let problem = Problem::Unknown(other.to_owned());
                        return Err(fault(line, 1, "CoordinateSystem", problem, "LPS or RAS, or 1 or 0"));
                    }
                    ("columns", list) => {
                        names = Some(list.split(',').map(|name| name.trim().to_owned()).collect::<Vec<_>>());
                    }
                    _ => {}
                }
                continue;
            }
            if text.is_empty() {
                continue;
            }
            let names = names.as_deref().unwrap_or_default();
            let cells: Vec<&str> = text.split(',').map(str::trim).collect();
            let cell = |name: &str| -> Result<(usize, &str), SessionError> {
                let column_index = names.iter().position(|of| of == name);
                let column_index = column_index
                    .ok_or_else(|| fault(line, 1, "columns", Problem::Missing, "columns with x, y and z"))?;
                let cell = cells.get(column_index).copied();
                Ok((
                    column_index + 1,
                    cell.ok_or_else(|| {
                        fault(line, column_index + 1, name, Problem::Missing, "a cell for each column")
                    })?,
                ))
            };
            let coordinate = |name: &str| -> Result<f64, SessionError> {
                let (column, cell) = cell(name)?;
                let number = cell.parse().ok().filter(|mm: &f64| mm.abs() <= super::slicer::MAX_MM);
                number.ok_or_else(|| {
                    fault(line, column, name, Problem::NotANumber(cell.to_owned()), "millimetres")
                })
            };
            let is_selected = cell("sel").map_or(true, |(_, cell)| cell != "0");
            points.push(([coordinate("x")?, coordinate("y")?, coordinate("z")?], is_selected));
        }
        let is_lps = is_lps.ok_or_else(|| fault(1, 1, "CoordinateSystem", Problem::Missing, "LPS or RAS"))?;
        Ok(Self { is_lps, points })
    }
}
