//! Tables of other laboratories and programs: the quantity of every column, and the session made of the table.

use crate::answer::AnswerError;
use crate::series::thinned;
use formats::foreign::{Choice, Mapping, Options, RawTable, Taken, TakenColumn, Target, ZOrigin, Zero, take};
use formats::session::import::id_of;
use formats::session::{DEPTH_RANGE_MM, InsertionRun, SessionFiles, Setup};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Values of a column that are shown beside its name.
const SHOWN: usize = 3;
/// Needle and guides where none are stated: those of `guide import`.
const RIG: &str = "[needle]\nyoungs_modulus_gpa = 200.0\nouter_diameter_mm = 1.27\ninner_diameter_mm = 1.0\n\
                   [rig]\nguide2_mm = 60.0\nentry_mm = 70.0\n";

/// Files, and what the person has chosen.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TableRequest {
    /// All are parts of one run.
    pub files: Vec<PathBuf>,
    /// Columns as `--map` states them; found by names and units where there are none.
    #[serde(default)]
    pub maps: Vec<String>,
    /// Length of the needle in the tissue.
    #[serde(default)]
    pub depth_mm: Option<f64>,
    /// Name of the run; that of the first file otherwise.
    #[serde(default)]
    pub id: Option<String>,
    /// `guide1` or `surface`.
    #[serde(default)]
    pub z_from: Option<String>,
    /// Column of times that all files share.
    #[serde(default)]
    pub merge_on: Option<String>,
    /// Between the files' clocks.
    #[serde(default)]
    pub offset_s: Option<f64>,
    /// Rate of the rows if there is no column of times.
    #[serde(default)]
    pub rate_hz: Option<f64>,
    /// Tables `[needle]`, `[rig]` and `[noise]` of a session.
    #[serde(default)]
    pub rig: Option<String>,
}

#[derive(Serialize)]
struct Answer {
    /// Columns of numbers of all files.
    columns: Vec<ColumnEntry>,
    /// Possible quantities of a column.
    quantities: Vec<QuantityEntry>,
    /// Maps of the request, and those by names and units, as `--map` states them.
    maps: Vec<String>,
    /// Columns of the session made of them; empty if there is a problem.
    taken: Vec<TakenColumn>,
    others: Vec<String>,
    forms: Vec<String>,
    notes: Vec<String>,
    /// Why there is no run yet.
    problem: Option<String>,
    kind: Option<&'static str>,
    rows: usize,
    /// Force over displacement, or the tip over the depth, to look at.
    drawn: Drawn,
    /// Files of a session with the run.
    files: BTreeMap<String, String>,
    /// The map as a file.
    map_file: String,
}

#[derive(Serialize, Default)]
struct Drawn {
    x: Vec<f64>,
    y: Vec<f64>,
}

#[derive(Serialize)]
struct ColumnEntry {
    file: PathBuf,
    /// As a map names it.
    name: String,
    unit: Option<String>,
    is_stamp: bool,
    values: Vec<f64>,
}

#[derive(Serialize)]
struct QuantityEntry {
    name: &'static str,
    units: &'static str,
}

/// Content of the files, and the run that the choices make of them.
pub fn table(request: &TableRequest) -> Result<String, AnswerError> {
    let setup = Setup::parse(Path::new("rig"), request.rig.as_deref().unwrap_or(RIG))?;
    let mut tables = Vec::new();
    for file in &request.files {
        tables.extend(RawTable::read(file)?);
    }
    let choices = request.maps.iter().map(|map| Choice::parse(map)).collect::<Result<Vec<_>, _>>()?;
    let mapping = Mapping { choices };
    let options = request.options(&setup.rig)?;
    let outcome = take(&tables, &mapping, &options)
        .map_err(|error| error.to_string())
        .and_then(|taken| Ok((request.files_of(&setup, &taken)?, taken)));
    let (problem, session_files, columns_used) = match outcome {
        Ok((made, taken)) => (None, made, taken),
        Err(problem) => (
            Some(problem),
            SessionFiles::new(),
            Taken { mapping: mapping.completed(&tables), ..Taken::default() },
        ),
    };
    let drawn = match (&columns_used.force, &columns_used.insertion) {
        (Some(force), _) => {
            Drawn { x: thinned(&force.displacement_y_m, 1e3), y: thinned(&force.force_y_n, 1.0) }
        }
        (None, Some(run)) => Drawn { x: thinned(&run.depth_m, 1e3), y: thinned(&run.tip_y_m, 1e3) },
        (None, None) => Drawn::default(),
    };
    let rows = columns_used.force.as_ref().map(|force| force.time_s.len());
    let kind = match (&columns_used.force, &columns_used.insertion) {
        (Some(_), _) => Some("lateral"),
        (None, Some(_)) => Some("insertion"),
        (None, None) => None,
    };
    Ok(serde_json::to_string(&Answer {
        columns: tables
            .iter()
            .flat_map(|table| table.columns.iter().map(move |column| (table, column)))
            .map(entry)
            .collect(),
        quantities: Target::ALL
            .iter()
            .map(|target| QuantityEntry { name: target.name, units: target.quantity.examples() })
            .collect(),
        maps: columns_used.mapping.choices.iter().map(Choice::text).collect(),
        map_file: columns_used.mapping.to_toml(),
        rows: rows.or(columns_used.insertion.as_ref().map(|run| run.depth_m.len())).unwrap_or(0),
        taken: columns_used.columns,
        others: columns_used.others,
        forms: columns_used.forms,
        notes: columns_used.notes,
        problem,
        kind,
        drawn,
        files: session_files.into_iter().collect(),
    })?)
}

fn entry((table, column): (&RawTable, &formats::foreign::RawColumn)) -> ColumnEntry {
    let whole = column.origin as f64;
    ColumnEntry {
        file: table.path.clone(),
        name: column.own_name(),
        unit: column.unit.as_ref().map(|unit| unit.name.clone()),
        is_stamp: column.is_stamp,
        values: column
            .values
            .iter()
            .filter(|value| value.is_finite())
            .take(SHOWN)
            .map(|value| whole + value)
            .collect(),
    }
}

impl TableRequest {
    fn options(&self, rig: &mechanics::Rig) -> Result<Options, AnswerError> {
        let z_from = match self.z_from.as_deref() {
            None => None,
            Some("guide1") => Some(ZOrigin::Guide1),
            Some("surface") => Some(ZOrigin::Surface),
            Some(other) => {
                let (value, expected) = (other.to_owned(), "guide1 or surface".to_owned());
                return Err(AnswerError::Value { name: "z_from", value, expected });
            }
        };
        if let Some(hz) = self.rate_hz.filter(|hz| !(1e-3..=1e6).contains(hz)) {
            let (value, expected) = (hz.to_string(), "rows a second from 0.001 to 1000000".to_owned());
            return Err(AnswerError::Value { name: "rate_hz", value, expected });
        }
        Ok(Options {
            rate_hz: self.rate_hz,
            merge_on: self.merge_on.clone(),
            offset_s: self.offset_s,
            by_ramps: false,
            zero: Zero::Auto,
            z_from,
            entry_m: rig.entry_m,
            guide2_m: rig.guide2_m,
        })
    }

    /// Files of a session with the run, or the reason why there is none yet.
    fn files_of(&self, setup: &Setup, taken: &Taken) -> Result<SessionFiles, String> {
        let first = self.files.first().map_or(Path::new("run"), PathBuf::as_path);
        let id = self.id.clone().unwrap_or_else(|| id_of(first));
        let written_files = match (&taken.force, &taken.insertion) {
            (Some(force), _) => {
                let [least_mm, most_mm] = DEPTH_RANGE_MM;
                let depth_mm = self.depth_mm.filter(|mm| *mm == 0.0 || (least_mm..=most_mm).contains(mm)).ok_or_else(|| {
                    format!("the length of the needle in the tissue is missing, expected 0 (in air) or {least_mm} to {most_mm} mm")
                })?;
                setup.with_lateral(&id, 1e-3 * depth_mm, force, taken.shape.as_ref())
            }
            (None, Some(insertion)) => setup.with_insertion(&InsertionRun { id, ..insertion.clone() }),
            (None, None) => return Err("no run in these files".to_owned()),
        };
        written_files.map_err(|error| error.to_string())
    }
}
