//! A needle in tissue with properties that the sliders set: readings of the sensors by the forward model.

use crate::answer::AnswerError;
use mechanics::effects::{Effect, effect, neutral};
use mechanics::{
    DriveSample, Experiment, Insertion, Lateral, Model, ModelError, Needle, Rig, ShapePoint, TipLaw, predict,
};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Position of guide 2 along the needle: that of the rig of Paper A (Lehmann et al.), m.
const GUIDE2_M: f64 = 0.06;
/// Distance of the points of the shape, m.
const SPACING_M: f64 = 1e-3;
/// Samples of a quarter of the cycle.
const QUARTER: usize = 16;
/// Length of the cycle, s.
const CYCLE_S: f64 = 16.0;
/// Distance of the depths of the insertion, m.
const STEP_M: f64 = 2e-3;
const MM: f64 = 1e-3;

/// State of the sliders.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlayInput {
    /// Foundation modulus.
    pub k_kpa: f64,
    /// Insertion depth.
    pub depth_mm: f64,
    /// Displacement of guide 2.
    pub displacement_mm: f64,
    /// From guide 2 to the surface.
    pub gap_mm: f64,
    /// Load on the tip while it is inserted.
    pub tip_load_n: f64,
    /// Effects by id, with values of their parameters by name.
    #[serde(default)]
    pub effects: BTreeMap<String, BTreeMap<String, f64>>,
}

#[derive(Serialize)]
struct Play {
    guide2_mm: f64,
    entry_mm: f64,
    outer_diameter_mm: f64,
    /// With the effects.
    with: Side,
    /// Without the effects; `None` if there are none.
    without: Option<Side>,
}

/// Readings of the sensors.
#[derive(Serialize)]
struct Side {
    /// Force at the largest displacement.
    force_n: f64,
    /// The needle at the largest displacement, from guide 1 to the tip.
    z_mm: Vec<f64>,
    deflection_mm: Vec<f64>,
    /// A slow cycle of guide 2, to the displacement, to the other side and back.
    displacement_mm: Vec<f64>,
    cycle_force_n: Vec<f64>,
    /// The tip on its way in.
    depth_mm: Vec<f64>,
    tip_mm: Vec<f64>,
}

/// Range of a slider.
fn within(name: &'static str, value: f64, [least, most]: [f64; 2]) -> Result<f64, AnswerError> {
    if (least..=most).contains(&value) {
        Ok(value)
    } else {
        let expected = format!("{least} to {most}");
        Err(AnswerError::Value { name, value: value.to_string(), expected })
    }
}

/// Values of an effect's parameters.
fn values(id: &str, given: &BTreeMap<String, f64>) -> Result<(&'static dyn Effect, Vec<f64>), AnswerError> {
    let effect = effect(id).ok_or_else(|| value_error("effects", id, "the id of an effect".to_owned()))?;
    let mut values = neutral(effect);
    for (name, value) in given {
        let infos = effect.parameters().iter().zip(values.iter_mut());
        let effect_parameter = infos.into_iter().find(|(info, _)| info.name == name);
        let (info, slot) =
            effect_parameter.ok_or_else(|| value_error("effects", name, parameter_names(effect)))?;
        *slot = within(info.name, *value, info.range)?;
    }
    Ok((effect, values))
}

fn parameter_names(effect: &dyn Effect) -> String {
    effect.parameters().iter().map(|info| info.name).collect::<Vec<_>>().join(", ")
}

fn value_error(name: &'static str, value: &str, expected: String) -> AnswerError {
    AnswerError::Value { name, value: value.to_owned(), expected }
}

/// Expected readings of the sensors.
pub fn play(input: &PlayInput) -> Result<String, AnswerError> {
    let k_pa = 1e3 * within("k_kpa", input.k_kpa, [0.1, 1000.0])?;
    let depth_m = MM * within("depth_mm", input.depth_mm, [5.0, 150.0])?;
    let displacement_m = MM * within("displacement_mm", input.displacement_mm, [-5.0, 5.0])?;
    let entry_m = GUIDE2_M + MM * within("gap_mm", input.gap_mm, [0.0, 50.0])?;
    let load_n = within("tip_load_n", input.tip_load_n, [-2.0, 2.0])?;
    let effects = input.effects.iter().map(|(id, given)| values(id, given)).collect::<Result<Vec<_>, _>>()?;
    let needle = Needle::gauge_18();
    let outer_diameter_mm = 1e3 * needle.outer_diameter_m;
    let mut model = Model::uniform(Rig::two_guides(needle, GUIDE2_M, entry_m), k_pa)?;
    model.tip = TipLaw::load([load_n, 0.0]);
    let plain = model.clone();
    model.effects = effects;
    let without_effects =
        if model.effects.is_empty() { None } else { Some(side(&plain, depth_m, displacement_m)?) };
    Ok(serde_json::to_string(&Play {
        guide2_mm: 1e3 * GUIDE2_M,
        entry_mm: 1e3 * entry_m,
        outer_diameter_mm,
        with: side(&model, depth_m, displacement_m)?,
        without: without_effects,
    })?)
}

fn side(model: &Model, depth_m: f64, displacement_m: f64) -> Result<Side, ModelError> {
    let samples = 4 * QUARTER;
    let drive: Vec<DriveSample> = (0..=samples)
        .map(|sample| {
            let phase = sample as f64 / QUARTER as f64;
            // Out, back through zero to the other side, and back.
            let phase_fraction = if phase <= 1.0 {
                phase
            } else if phase <= 3.0 {
                2.0 - phase
            } else {
                phase - 4.0
            };
            let time_s = CYCLE_S * sample as f64 / samples as f64;
            DriveSample { time_s, y_m: phase_fraction * displacement_m, x_m: 0.0 }
        })
        .collect();
    let top_s = 0.25 * CYCLE_S;
    let end_m = model.rig.entry_m + depth_m;
    let points = (end_m / SPACING_M).ceil() as usize;
    let z_m: Vec<f64> = (0..=points).map(|point| end_m * point as f64 / points as f64).collect();
    let shape = z_m.iter().map(|z_m| ShapePoint::new(top_s, *z_m)).collect();
    let displacement_mm = drive.iter().map(|sample| 1e3 * sample.y_m).collect();
    let lateral = Lateral { depth_m, drive, shape, reversal_m: [0.0; 2], order: 0.0 };
    let read = predict(model, &Experiment::Lateral(lateral))?;
    let steps = (depth_m / STEP_M).ceil() as usize;
    let depths_m: Vec<f64> = (0..=steps).map(|step| depth_m * step as f64 / steps as f64).collect();
    let insertion =
        Insertion { depth_m: depths_m.clone(), guide2_m: Some(Default::default()), ..Insertion::default() };
    let inserted = predict(model, &Experiment::Insertion(insertion))?;
    Ok(Side {
        force_n: read.force_n.y.get(QUARTER).copied().unwrap_or(f64::NAN),
        z_mm: in_mm(&z_m),
        deflection_mm: in_mm(&read.shape_m.y),
        displacement_mm,
        cycle_force_n: read.force_n.y,
        depth_mm: in_mm(&depths_m),
        tip_mm: in_mm(&inserted.tip_m.y),
    })
}

fn in_mm(values: &[f64]) -> Vec<f64> {
    values.iter().map(|value| 1e3 * value).collect()
}
