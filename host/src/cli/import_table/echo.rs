//! What an import of tables has taken for what: for people before anything is written, and as a result.

use super::MISSING_DEPTH;
use crate::cli::import_shapes::last_hold_note;
use anyhow::{Context, bail, ensure};
use formats::foreign::{Taken, TakenColumn};
use formats::session::DEPTH_RANGE_MM;
use serde::Serialize;
use std::fmt::{self, Display};
use std::path::PathBuf;

/// Imported run.
#[derive(Serialize)]
pub struct Imported {
    pub schema: &'static str,
    pub session: PathBuf,
    pub runs: Vec<ImportedRun>,
    /// The command line that does the same.
    pub again: String,
}

#[derive(Serialize)]
pub struct ImportedRun {
    pub id: String,
    kind: &'static str,
    rows: usize,
    shape_points: usize,
    pub depth_mm: Option<f64>,
    files: Vec<String>,
    columns: Vec<TakenColumn>,
    others: Vec<String>,
    offset_s: Option<f64>,
    offset_sd_s: Option<f64>,
    /// How much slower the displacement's clock is, of its own time.
    drift: Option<f64>,
    drift_sd: Option<f64>,
    notes: Vec<String>,
}

impl ImportedRun {
    pub fn new(id: String, taken: &Taken, depth_mm: Option<f64>, entry_m: f64) -> anyhow::Result<Self> {
        let (kind, rows) = match (&taken.force, &taken.insertion) {
            (Some(force), _) => ("lateral", force.time_s.len()),
            (None, Some(insertion)) => ("insertion", insertion.depth_m.len()),
            (None, None) => bail!("no run in these files"),
        };
        let depth_mm = match kind {
            "lateral" => {
                let depth_mm = depth_mm.context(MISSING_DEPTH)?;
                let [least_mm, most_mm] = DEPTH_RANGE_MM;
                let is_depth = depth_mm == 0.0 || (least_mm..=most_mm).contains(&depth_mm);
                ensure!(is_depth, "--depth-mm: {depth_mm}, expected 0 or {least_mm} to {most_mm} mm");
                Some(depth_mm)
            }
            _ => None,
        };
        Ok(Self {
            id,
            kind,
            rows,
            shape_points: taken.shape.as_ref().map_or(0, |shape| shape.z_m.len()),
            depth_mm,
            files: taken.forms.clone(),
            columns: taken.columns.clone(),
            others: taken.others.clone(),
            offset_s: taken.offset.map(|offset| offset.offset_s),
            offset_sd_s: taken.offset.map(|offset| offset.sd_s),
            drift: taken.drift.map(|drift| drift.rate),
            drift_sd: taken.drift.map(|drift| drift.sd),
            notes: taken
                .notes
                .iter()
                .cloned()
                .chain(note_of_hold(taken, depth_mm))
                .chain(note_of_places(taken, depth_mm, entry_m))
                .collect(),
        })
    }
}

/// Remark on the hold to which a shape without times belongs.
fn note_of_hold(taken: &Taken, depth_mm: Option<f64>) -> Option<String> {
    let (force, shape) = taken.force.as_ref().zip(taken.shape.as_ref())?;
    let of_force = taken.columns.iter().find(|column| column.is == "force_y_n")?;
    if shape.time_s.is_some() {
        return None;
    }
    let remedy = "a column time_s in its table states when it was measured";
    last_hold_note(&of_force.file, force.clone(), 1e-3 * depth_mm.unwrap_or(0.0), remedy)
}

/// Remark on a shape of which no point is in the tissue.
fn note_of_places(taken: &Taken, depth_mm: Option<f64>, entry_m: f64) -> Option<String> {
    let shape = taken.shape.as_ref().filter(|_| depth_mm != Some(0.0))?;
    let deepest_m = shape.z_m.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    (deepest_m < entry_m).then(|| {
        format!(
            "z_mm: all points of the shape are before the tissue's surface, at {:.1} mm from guide 1 or less, and the surface is at {:.1} mm: does z count from \
             the surface (--z-from surface), or the other way (a minus before its unit)?",
            1e3 * deepest_m,
            1e3 * entry_m
        )
    })
}

/// Quantities that columns were taken for.
pub struct TakenTable<'a>(pub &'a ImportedRun);

impl Display for TakenTable<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ImportedRun { id, columns, others, files, notes, .. } = self.0;
        write!(f, "{id}: what is taken for what")?;
        let (is, unit) = (
            column_width(&|c| c.is.len(), 8, columns),
            column_width(&|c| c.unit.chars().count(), 4, columns),
        );
        let column = column_width(&|c| c.column.chars().count(), 6, columns);
        write!(
            f,
            "\n  {:<is$}  {:<column$}  {:<unit$}  from ... to, in the unit of the quantity",
            "quantity", "column", "unit"
        )?;
        for TakenColumn { is: name, column: header, unit: of, range: [least, most], rows, file } in columns {
            let file = file.file_name().unwrap_or_default().to_string_lossy();
            write!(
                f,
                "\n  {name:<is$}  {header:<column$}  {of:<unit$}  {least:.4} ... {most:.4}, {rows} rows of {file}"
            )?;
        }
        if let Some(clock) = self.0.clock() {
            write!(f, "\n  {clock}")?;
        }
        for other in others {
            write!(f, "\n  not taken: {other}")?;
        }
        for line in files.iter().chain(notes) {
            write!(f, "\n  {line}")?;
        }
        Ok(())
    }
}

impl ImportedRun {
    /// How the displacement's clock is brought to that of the force, where that was estimated.
    fn clock(&self) -> Option<String> {
        let (offset_s, sd_s) = self.offset_s.zip(self.offset_sd_s)?;
        let drift = match self.drift.zip(self.drift_sd) {
            None => "no drift seen".to_owned(),
            Some((rate, sd)) => format!(
                "{:.3} % (sd {:.3} %) {}",
                100.0 * rate.abs(),
                100.0 * sd,
                if rate < 0.0 { "fast" } else { "slow" }
            ),
        };
        Some(format!("clock of the displacement: {offset_s:+.4} s (sd {sd_s:.4} s), {drift}, by the ramps"))
    }
}

fn column_width(of: &dyn Fn(&TakenColumn) -> usize, least: usize, columns: &[TakenColumn]) -> usize {
    columns.iter().map(of).max().unwrap_or(0).max(least)
}

impl Display for Imported {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for ImportedRun { id, kind, rows, shape_points, depth_mm, .. } in &self.runs {
            let depth = depth_mm.map_or_else(String::new, |mm| format!(", {mm:.1} mm deep"));
            let shape = match (*kind, shape_points) {
                ("lateral", 0) => ", without a shape".to_owned(),
                ("lateral", points) => format!(", {points} points of shape"),
                _ => String::new(),
            };
            writeln!(f, "{kind:<12} {id}: {rows} rows{depth}{shape}")?;
        }
        writeln!(f, "session      {}", self.session.display())
    }
}
