//! Curves drawn in 3D Slicer (`.mrk.json`, lists of older versions as `.fcsv`) as the shape of a needle: control points in patient coordinates.

use super::fiducials::{self, Fiducials};
use super::frame::NeedlePoints;
use crate::document::{Place, Problem, SessionError, read_foreign_text, split_message};
use serde::Deserialize;
use serde::de::{Deserializer, Error, Unexpected, Visitor};
use std::fmt;
use std::path::Path;

/// Coordinates that a scanner has, millimetres.
pub(super) const MAX_MM: f64 = 5000.0;
/// Kinds of markups that are a line of points.
const KINDS: [&str; 4] = ["Curve", "ClosedCurve", "Line", "Fiducial"];

#[derive(Deserialize)]
struct Markups {
    markups: Vec<Markup>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Markup {
    #[serde(rename = "type")]
    kind: Option<Kind>,
    coordinate_system: System,
    coordinate_units: Option<Units>,
    #[serde(default)]
    control_points: Vec<ControlPoint>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct ControlPoint {
    position: Option<Position>,
    position_status: Option<String>,
    selected: Option<bool>,
}

/// Directions of x and y: left and posterior, or right and anterior; z is superior in both.
#[derive(Clone, Copy)]
enum System {
    Lps,
    Ras,
}

/// One of [`KINDS`].
struct Kind(String);

/// Millimetres in one of the unit of positions.
struct Units(f64);

struct Position([f64; 3]);

/// Reads the one curve, line or list of points of a markups file, in right-anterior-superior coordinates, in the order of its points.
///
/// # Errors
/// [`SessionError`] with file, line and column.
pub fn slicer(path: &Path) -> Result<NeedlePoints, SessionError> {
    let text = read_foreign_text(path)?;
    if text.starts_with(fiducials::START) {
        return Ok(points(path, &Markup::of_fiducials(Fiducials::parse(path, &text)?)));
    }
    let location_at = |line, column| Place { path: path.to_owned(), line, column };
    let file: Markups = serde_json::from_str(&text).map_err(|error| {
        // The place is separated from the words.
        let words = error.to_string();
        let words = words.rsplit_once(" at line ").map_or(words.as_str(), |(words, _)| words).to_owned();
        let words = words.replace("EOF while parsing", "the file ends in");
        let (problem, expected) = split_message(&words, "a markups file of 3D Slicer (.mrk.json)");
        let location = location_at(error.line().max(1), error.column().max(1));
        SessionError::Field { place: location, field: "markups".to_owned(), problem, expected }
    })?;
    let [markup] = file.markups.as_slice() else {
        let (field, expected) = ("markups".to_owned(), "one curve per file".to_owned());
        let problem = Problem::Count(file.markups.len());
        return Err(SessionError::Field { place: location_at(1, 1), field, problem, expected });
    };
    Ok(points(path, markup))
}

impl Markup {
    fn of_fiducials(list: Fiducials) -> Self {
        let control_points = list.points.into_iter().map(|(position_mm, is_selected)| ControlPoint {
            position: Some(Position(position_mm)),
            position_status: None,
            selected: Some(is_selected),
        });
        Self {
            kind: None,
            coordinate_system: if list.is_lps { System::Lps } else { System::Ras },
            coordinate_units: None,
            control_points: control_points.collect(),
        }
    }
}

/// The points of a curve or a list that are to be used.
fn points(path: &Path, markup: &Markup) -> NeedlePoints {
    let sign = match markup.coordinate_system {
        System::Lps => -1.0,
        System::Ras => 1.0,
    };
    let scale = 1e-3 * markup.coordinate_units.as_ref().map_or(1.0, |Units(mm)| *mm);
    let mut points = NeedlePoints { path: path.to_owned(), points_m: Vec::new(), notes: Vec::new() };
    // Programs that are handed a list get its selected points; a list of which none is selected is meant as a whole.
    let has_selected = markup.control_points.iter().any(|point| point.selected != Some(false));
    let (mut unplaced, mut deselected) = (0usize, 0usize);
    for point in &markup.control_points {
        let is_defined = point.position_status.as_deref().is_none_or(|status| status == "defined");
        let Some(Position([x, y, z])) = point.position.as_ref().filter(|_| is_defined) else {
            unplaced += 1;
            continue;
        };
        if has_selected && point.selected == Some(false) {
            deselected += 1;
            continue;
        }
        points.points_m.push([scale * sign * x, scale * sign * y, scale * z]);
    }
    for (count, why) in [(unplaced, "placed"), (deselected, "selected")] {
        if count > 0 {
            points.notes.push(format!("{}: {count} control points are not {why}: skipped", path.display()));
        }
    }
    if markup.kind.as_ref().is_some_and(|Kind(kind)| kind == "ClosedCurve") {
        points.notes.push(format!("{}: a closed curve is taken as an open one", path.display()));
    }
    points
}

impl<'de> Deserialize<'de> for System {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Word;
        impl Visitor<'_> for Word {
            type Value = System;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("coordinateSystem \"LPS\" or \"RAS\", or 1 or 0 as older versions wrote them")
            }

            fn visit_str<E: Error>(self, word: &str) -> Result<System, E> {
                match word {
                    "LPS" | "1" => Ok(System::Lps),
                    "RAS" | "0" => Ok(System::Ras),
                    other => Err(E::invalid_value(Unexpected::Str(other), &self)),
                }
            }

            fn visit_u64<E: Error>(self, code: u64) -> Result<System, E> {
                match code {
                    0 => Ok(System::Ras),
                    1 => Ok(System::Lps),
                    other => Err(E::invalid_value(Unexpected::Unsigned(other), &self)),
                }
            }
        }
        deserializer.deserialize_any(Word)
    }
}

impl<'de> Deserialize<'de> for Kind {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let kind = String::deserialize(deserializer)?;
        if KINDS.contains(&kind.as_str()) {
            Ok(Self(kind))
        } else {
            Err(D::Error::custom(format!("type \"{kind}\", expected {}", KINDS.join(", "))))
        }
    }
}

impl<'de> Deserialize<'de> for Units {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        // A word, or the same word for each axis, or a coded entry that has it in front: the code, its scheme and its words.
        let value = serde_json::Value::deserialize(deserializer)?;
        fn millimetres(value: &serde_json::Value) -> Option<f64> {
            match value.as_str()?.split(';').next()? {
                "mm" => Some(1.0),
                "cm" => Some(10.0),
                "m" => Some(1e3),
                _ => None,
            }
        }
        let mm = match &value {
            serde_json::Value::Array(words)
                if words.get(1).and_then(|word| word.as_str()) == Some("UCUM") =>
            {
                words.first().and_then(millimetres)
            }
            serde_json::Value::Array(axes) => {
                let first = axes.first().and_then(millimetres);
                first.filter(|_| axes.iter().all(|axis| millimetres(axis) == first))
            }
            word => millimetres(word),
        };
        mm.map(Self).ok_or_else(|| {
            D::Error::custom(format!("coordinateUnits {value}, expected \"mm\", \"cm\" or \"m\""))
        })
    }
}

impl<'de> Deserialize<'de> for Position {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let position = <[f64; 3]>::deserialize(deserializer)?;
        match position.iter().find(|mm| mm.abs() > MAX_MM) {
            Some(mm) => Err(D::Error::custom(format!(
                "position {mm}, expected millimetres from -{MAX_MM} to {MAX_MM}"
            ))),
            None => Ok(Self(position)),
        }
    }
}
