//! Plan of a simulated session: tissue, tip and effects as in a model file, lateral runs and
//! insertions.

use formats::document::Fields;
use formats::model_file::ModelFile;
use formats::session::{
    DEPTH_RANGE_MM, FILE_NAME, Problem, SessionError, WALL_FIELDS, Walls, is_file_name, read_text,
};
use std::collections::HashSet;
use std::path::Path;

const MM: f64 = 1e-3;
/// Levels that a lateral run goes through unless it states others, millimetres.
const LEVELS_MM: [f64; 9] = [0.0, 0.4, 0.8, 1.2, 0.8, 0.0, -0.6, -1.2, 0.0];
/// Levels that differ by less are the same.
const SAME_M: f64 = 1e-9;
/// Fewest rows of a hold, so that it is found again; most rows and points of a run.
const MIN_ROWS: f64 = 20.0;
const MAX_ROWS: f64 = 1e6;

/// Direction in which guide 2 is moved.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axis {
    /// Vertical.
    Y,
    /// Horizontal.
    X,
}

/// Holds in which the shape is swept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SweepLevels {
    /// Those at zero, at the largest and at the smallest level.
    Extremes,
    /// All.
    All,
}

/// A lateral run: from level to level, with a hold at each.
#[derive(Debug, Clone, PartialEq)]
pub struct LateralPlan {
    /// Name of the run.
    pub id: String,
    /// Length of the needle inside the tissue.
    pub depth_m: f64,
    /// Direction of the levels.
    pub axis: Axis,
    /// Displacement of guide 2 at each hold.
    pub levels_m: Vec<f64>,
    /// Length of every hold.
    pub hold_s: f64,
    /// Speed between the holds.
    pub ramp_m_per_s: f64,
    /// Rows per second.
    pub rate_hz: f64,
    /// Holds with a sweep.
    pub sweep_levels: SweepLevels,
    /// Distance between the points of a sweep.
    pub spacing_m: f64,
}

/// An insertion at a steady speed.
#[derive(Debug, Clone, PartialEq)]
pub struct InsertionPlan {
    /// Name of the run.
    pub id: String,
    /// Final depth.
    pub depth_m: f64,
    /// Speed.
    pub speed_m_per_s: f64,
    /// Depth at which the needle is turned by half a turn.
    pub turn_at_m: Option<f64>,
    /// Distance between the depths at which the tip is measured.
    pub step_m: f64,
}

/// Plan of a simulated session.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SimulationPlan {
    /// Tissue, tip and effects.
    pub model: ModelFile,
    /// Lateral runs.
    pub lateral: Vec<LateralPlan>,
    /// Insertions.
    pub insertion: Vec<InsertionPlan>,
}

/// A hold of a lateral plan.
pub(super) struct Hold {
    pub from_s: f64,
    pub level_m: f64,
}

/// Names of runs, each of which becomes the name of files.
#[derive(Default)]
pub(super) struct RunIds(HashSet<String>);

impl RunIds {
    pub(super) fn read(&mut self, fields: &Fields<'_>) -> Result<String, SessionError> {
        let id = fields.text("id")?;
        if !is_file_name(&id) {
            let problem = Problem::Syntax(format!("\"{id}\" cannot be part of a file name"));
            return Err(fields.field_fault("id", problem, FILE_NAME));
        }
        if self.0.insert(id.clone()) {
            Ok(id)
        } else {
            Err(fields.field_fault("id", Problem::Duplicate(id), "one run per id"))
        }
    }
}

impl SimulationPlan {
    /// Reads the tables `[tissue]`, `[tip]`, `[[effect]]`, `[[lateral]]` and `[[insertion]]` of a file; `model` replaces its
    /// values. Other tables are left alone.
    ///
    /// # Errors
    /// [`SessionError`] for the first fault found, with its place.
    pub fn read(path: &Path, model: Option<&ModelFile>) -> Result<Self, SessionError> {
        let text = read_text(path)?;
        Fields::parse(path, &text, |file| {
            // Layers and inclusions are those of steering runs, what is known of Poisson's ratio is for the session that is written.
            let more = ["layers", "inclusions", "poisson_sd"];
            let own = ModelFile::tables(file, &[&more[..], &WALL_FIELDS].concat())?;
            let walls =
                file.optional_table("tissue")?.map(|tissue| Walls::read(&tissue)).transpose()?.flatten();
            let mut ids = RunIds::default();
            let lateral: Vec<LateralPlan> = file
                .tables("lateral")?
                .iter()
                .map(|fields| LateralPlan::read(fields, ids.read(fields)?))
                .collect::<Result<_, _>>()?;
            let insertion: Vec<InsertionPlan> = file
                .tables("insertion")?
                .iter()
                .map(|fields| InsertionPlan::read(fields, ids.read(fields)?))
                .collect::<Result<_, _>>()?;
            let mut plan = Self {
                model: match model {
                    Some(model) => own.replaced_by(model),
                    None => own,
                },
                lateral,
                insertion,
            };
            plan.model.support =
                plan.model.support.map(|support| support.with_block(walls.and_then(Walls::block)));
            let on_body = plan.model.support.is_some_and(|support| support.is_body());
            let missing = if on_body { plan.model.youngs_pa } else { plan.model.modulus_pa }.is_none();
            if missing && on_body && !plan.is_empty() {
                return Err(file.field_fault(
                    "tissue.youngs_kpa",
                    Problem::Missing,
                    "Young's modulus of the body, 0.01 to 10000 kPa",
                ));
            }
            if missing && !plan.is_empty() {
                let tissue = file.optional_table("tissue")?;
                return Err(tissue.as_ref().unwrap_or(file).field_fault(
                    if tissue.is_some() { "k_kpa" } else { "tissue.k_kpa" },
                    Problem::Missing,
                    "the foundation modulus of the tissue, 0.01 to 10000 kPa",
                ));
            }
            Ok(plan)
        })
    }

    /// Whether there is nothing to be done.
    pub fn is_empty(&self) -> bool {
        self.lateral.is_empty() && self.insertion.is_empty()
    }
}

impl LateralPlan {
    fn read(fields: &Fields<'_>, id: String) -> Result<Self, SessionError> {
        fields.only(&[
            "id",
            "depth_mm",
            "axis",
            "levels_mm",
            "hold_s",
            "ramp_mm_per_s",
            "rate_hz",
            "sweep_levels",
            "spacing_mm",
        ])?;
        let levels_mm = fields.optional_list("levels_mm", [-50.0, 50.0], 0)?;
        if let Some([]) = levels_mm.as_deref() {
            return Err(fields.field_fault("levels_mm", Problem::Empty, "one level or more"));
        }
        let plan = Self {
            id,
            depth_m: MM * fields.number_or_zero("depth_mm", DEPTH_RANGE_MM)?,
            axis: choice(fields, "axis", [("y", Axis::Y), ("x", Axis::X)])?,
            levels_m: levels_mm.unwrap_or(LEVELS_MM.to_vec()).into_iter().map(|mm| MM * mm).collect(),
            hold_s: number_or("hold_s", [0.5, 3600.0], 3.0, fields)?,
            ramp_m_per_s: MM * number_or("ramp_mm_per_s", [0.01, 100.0], 1.0, fields)?,
            rate_hz: number_or("rate_hz", [1.0, 1000.0], 20.0, fields)?,
            sweep_levels: choice(
                fields,
                "sweep_levels",
                [("extremes", SweepLevels::Extremes), ("all", SweepLevels::All)],
            )?,
            spacing_m: MM * number_or("spacing_mm", [0.05, 100.0], 1.0, fields)?,
        };
        let rows = plan.hold_s * plan.rate_hz;
        if rows < MIN_ROWS {
            let expected = format!("{MIN_ROWS} rows or more: {} s", MIN_ROWS / plan.rate_hz);
            return Err(fields.field_fault("hold_s", Problem::OutOfRange(plan.hold_s), expected));
        }
        let end_s = plan.holds().last().map_or(0.0, |hold| hold.from_s + plan.hold_s);
        // In air a sweep covers all of the needle, of which this file's table does not state the length.
        let swept_m = if plan.depth_m > 0.0 { plan.depth_m } else { MM * DEPTH_RANGE_MM[1] };
        let points = swept_m / plan.spacing_m * plan.levels_m.len() as f64;
        let sizes = [
            ("rate_hz", (end_s * plan.rate_hz).ceil(), "rows", "levels_mm, hold_s and rate_hz make them"),
            ("spacing_mm", points.ceil(), "shape points", "depth_mm, levels_mm and spacing_mm make them"),
        ];
        if let Some((field, count, subject, why)) = sizes.into_iter().find(|(_, count, ..)| *count > MAX_ROWS)
        {
            let problem = Problem::Syntax(format!("{count} {subject}"));
            return Err(fields.field_fault(field, problem, format!("at most {MAX_ROWS} in a run: {why}")));
        }
        Ok(plan)
    }

    /// When each level is held.
    pub(super) fn holds(&self) -> Vec<Hold> {
        let mut start_s = 0.0;
        let mut previous_m: Option<f64> = None;
        self.levels_m
            .iter()
            .map(|level_m| {
                let distance_m = previous_m.map_or(0.0, |previous_m| (level_m - previous_m).abs());
                start_s += distance_m / self.ramp_m_per_s + previous_m.map_or(0.0, |_| self.hold_s);
                previous_m = Some(*level_m);
                Hold { from_s: start_s, level_m: *level_m }
            })
            .collect()
    }

    /// Position of guide 2.
    pub(super) fn displacement_m(&self, holds: &[Hold], time_s: f64) -> f64 {
        let next = holds.partition_point(|hold| hold.from_s <= time_s);
        let now = next.checked_sub(1).and_then(|now| holds.get(now));
        match (now, holds.get(next)) {
            (Some(now), Some(next)) => {
                let hold_end_s = now.from_s + self.hold_s;
                let fraction = ((time_s - hold_end_s) / (next.from_s - hold_end_s)).max(0.0);
                if time_s <= hold_end_s {
                    now.level_m
                } else {
                    now.level_m + fraction * (next.level_m - now.level_m)
                }
            }
            (Some(only), None) | (None, Some(only)) => only.level_m,
            (None, None) => 0.0,
        }
    }

    /// Whether the shape is swept at a level.
    pub(super) fn is_swept(&self, level_m: f64) -> bool {
        let largest_m = self.levels_m.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let smallest_m = self.levels_m.iter().copied().fold(f64::INFINITY, f64::min);
        let extreme = [0.0, largest_m, smallest_m].iter().any(|m| (level_m - m).abs() <= SAME_M);
        extreme || self.sweep_levels == SweepLevels::All
    }
}

fn number_or(field: &str, range: [f64; 2], or: f64, fields: &Fields<'_>) -> Result<f64, SessionError> {
    fields.optional_number(field, range).map(|found| found.unwrap_or(or))
}

impl InsertionPlan {
    fn read(fields: &Fields<'_>, id: String) -> Result<Self, SessionError> {
        fields.only(&["id", "depth_mm", "speed_mm_per_s", "turn_at_mm", "step_mm"])?;
        let depth_mm = fields.number("depth_mm", [1.0, 300.0])?;
        Ok(Self {
            id,
            depth_m: MM * depth_mm,
            speed_m_per_s: MM * or_default(fields.optional_number("speed_mm_per_s", [0.01, 1000.0])?, 5.0),
            turn_at_m: fields.optional_number("turn_at_mm", [0.0, depth_mm])?.map(|mm| MM * mm),
            step_m: MM * or_default(fields.optional_number("step_mm", [0.01, depth_mm])?, 0.5),
        })
    }
}

fn or_default(found: Option<f64>, or: f64) -> f64 {
    found.unwrap_or(or)
}

/// One of two words; the first where there is none.
fn choice<T: Copy>(fields: &Fields<'_>, field: &str, words: [(&str, T); 2]) -> Result<T, SessionError> {
    let [(first, or), (second, _)] = words;
    match fields.optional_text(field)? {
        None => Ok(or),
        Some(found) => {
            words.iter().find(|(word, _)| *word == found).map(|(_, value)| *value).ok_or_else(|| {
                let expected = format!("\"{first}\" or \"{second}\"");
                fields.field_fault(field, Problem::Unknown(found), expected)
            })
        }
    }
}
