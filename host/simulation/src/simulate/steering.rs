//! Steering runs that are to be simulated: layers and inclusions of the tissue, and what is done in each run.

use super::plan::RunIds;
use crate::rig::steering::{Inclusion, Plan, SteeringRig, Tissue, TissueLayer};
use formats::document::Fields;
use formats::session::{Problem, SessionError, Setup, read_text};
use mechanics::Rig;
use std::path::Path;

const STIFFNESS: [f64; 2] = [0.0, 1e8];
const DAMPING: [f64; 2] = [0.0, 1e7];
/// Depths of faces and inclusions.
const DEPTH_MM: [f64; 2] = [0.0, 500.0];
/// More jerks than this in a run are no disturbance.
const MAX_DISTURBANCES: f64 = 1000.0;
/// Most samples of a run.
const MAX_SAMPLES: f64 = 1e6;

/// Steering runs with the tissue that they go through.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SteeringPlan {
    /// The tissue.
    pub tissue: Tissue,
    /// The runs.
    pub runs: Vec<Plan>,
    /// Length of the needle from its fixture, and mass of the fixture; there where there are runs.
    length_and_mass: [f64; 2],
}

impl SteeringPlan {
    /// Reads the tables `[[steering]]` of a file, and for them the lists `layers` and `inclusions` of `[tissue]`.
    ///
    /// # Errors
    /// [`SessionError`] for the first fault found, with its place.
    pub fn read(path: &Path, setup: &Setup) -> Result<Self, SessionError> {
        let text = read_text(path)?;
        Fields::parse(path, &text, |file| {
            let mut ids = RunIds::default();
            let runs = file.tables("steering")?;
            let runs: Vec<Plan> =
                runs.iter().map(|fields| run(fields, ids.read(fields)?)).collect::<Result<_, _>>()?;
            let tissue = match file.optional_table("tissue")? {
                Some(tissue) => self::tissue(&tissue)?,
                None => Tissue::default(),
            };
            if runs.is_empty() {
                return Ok(Self { tissue, ..Self::default() });
            }
            if tissue.layers.is_empty() {
                let expected = "at least one layer, for steering runs";
                return match file.optional_table("tissue")? {
                    Some(table) => Err(table.field_fault("layers", Problem::Missing, expected)),
                    None => Err(file.field_fault("tissue.layers", Problem::Missing, expected)),
                };
            }
            let length_m = setup.rig.needle.length_m.ok_or_else(|| {
                let expected = "the length from the fixture to the tip, for steering runs";
                file.table("needle").map_or_else(
                    |fault| fault,
                    |needle| needle.field_fault("length_mm", Problem::Missing, expected),
                )
            })?;
            let fixture_mass_kg = setup.fixture_mass_kg.ok_or_else(|| {
                let expected = "a number from 0 to 100, for steering runs";
                file.table("rig").map_or_else(
                    |fault| fault,
                    |rig| rig.field_fault("fixture_mass_kg", Problem::Missing, expected),
                )
            })?;
            Ok(Self { tissue, runs, length_and_mass: [length_m, fixture_mass_kg] })
        })
    }

    /// Needle and tissue of the runs.
    ///
    /// # Errors
    /// [`mechanics::ModelError`] where no needle is like that.
    pub fn rig(&self, rig: &Rig) -> Result<SteeringRig, mechanics::ModelError> {
        let [length_m, fixture_mass_kg] = self.length_and_mass;
        SteeringRig::new(rig.clone(), length_m, fixture_mass_kg, &self.tissue)
    }
}

fn tissue(fields: &Fields<'_>) -> Result<Tissue, SessionError> {
    let mut layers: Vec<TissueLayer> = Vec::new();
    for layer in fields.tables("layers")? {
        layer.only(&["bottom_mm", "stiffness_n_per_m2", "damping_n_s_per_m2"])?;
        let bottom_mm = layer.number("bottom_mm", DEPTH_MM)?;
        let top_mm = layers.last().map_or(0.0, |above| above.bottom_mm);
        if bottom_mm <= top_mm {
            let expected = format!("more than {top_mm}, where the layer begins");
            return Err(layer.field_fault("bottom_mm", Problem::OutOfRange(bottom_mm), expected));
        }
        layers.push(TissueLayer {
            bottom_mm,
            stiffness_n_per_m2: layer.number("stiffness_n_per_m2", STIFFNESS)?,
            damping_n_s_per_m2: layer.number("damping_n_s_per_m2", DAMPING)?,
        });
    }
    let inclusions = fields.tables("inclusions")?;
    Ok(Tissue {
        layers,
        inclusions: inclusions
            .iter()
            .map(|one| {
                one.only(&["depth_mm", "width_mm", "factor"])?;
                Ok(Inclusion {
                    depth_mm: one.number("depth_mm", DEPTH_MM)?,
                    width_mm: one.number("width_mm", [0.1, 100.0])?,
                    factor: one.number("factor", [0.0, 100.0])?,
                })
            })
            .collect::<Result<_, SessionError>>()?,
    })
}

fn run(fields: &Fields<'_>, id: String) -> Result<Plan, SessionError> {
    fields.only(&[
        "id",
        "speed_mm_s",
        "depth_mm",
        "lateral_mm",
        "straight_mm",
        "wobble_mm",
        "wobble_hz",
        "period_ms",
        "disturbances",
    ])?;
    let plan = Plan {
        id,
        speed_mm_s: fields.number("speed_mm_s", [0.1, 100.0])?,
        depth_mm: number_or("depth_mm", [1.0, 300.0], 80.0, fields)?,
        lateral_mm: number_or("lateral_mm", [-100.0, 100.0], 20.0, fields)?,
        straight_mm: number_or("straight_mm", [0.0, 300.0], 0.0, fields)?,
        wobble_mm: number_or("wobble_mm", [0.0, 20.0], 0.0, fields)?,
        wobble_hz: number_or("wobble_hz", [0.01, 5.0], 0.5, fields)?,
        period_ms: number_or("period_ms", [1.0, 1000.0], 20.0, fields)?,
        disturbances: fields
            .optional_whole("disturbances", [0.0, MAX_DISTURBANCES])?
            .map_or(0, |count| count as usize),
    };
    if plan.straight_mm >= plan.depth_mm {
        let expected = format!("less than depth_mm, {}", plan.depth_mm);
        return Err(fields.field_fault("straight_mm", Problem::OutOfRange(plan.straight_mm), expected));
    }
    let samples = (1e3 * plan.depth_mm / plan.speed_mm_s / plan.period_ms).ceil();
    if samples > MAX_SAMPLES {
        let problem = Problem::Syntax(format!("{samples} samples"));
        let expected =
            format!("at most {MAX_SAMPLES} in a run: depth_mm, speed_mm_s and period_ms make them");
        return Err(fields.field_fault("period_ms", problem, expected));
    }
    Ok(plan)
}

fn number_or(field: &str, range: [f64; 2], or: f64, fields: &Fields<'_>) -> Result<f64, SessionError> {
    fields.optional_number(field, range).map(|found| found.unwrap_or(or))
}
