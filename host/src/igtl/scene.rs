//! Values that are published to clients: guide and force as they are measured, needle and tip as the model has them,
//! results with their intervals.
//!
//! The frame `Reference` is the session's: z along the straight needle from guide 1, x horizontal, y vertical. In it,
//!
//! | message | content |
//! |---|---|
//! | TRANSFORM `GuideToReference` | where guide 2 is |
//! | SENSOR `Force` | lateral force along x and y |
//! | STRING `Guide` | both with all digits, what the device does, and since when the force no longer follows a model, as JSON |
//! | TRANSFORM `NeedleTipToReference` | the tip for this displacement of guide 2, z along the needle |
//! | POINT `NeedleShape` | the needle for this displacement of guide 2 |
//! | POINT `MeasuredShape` | a sweep as the ultrasound saw it |
//! | STRING `Identification` | modulus with its interval, as JSON |
//! | STRING `Prediction` | tip load and path of the last insertion with their intervals, as JSON |
//! | POINT `PredictedPath` | that path; the diameter of a point is the width of its 95 % band |
//!
//! The model is the linear beam, from a needle that was straight: relaxation and stiffening of the tissue are not in it.

use device::igtl::message::{Content, Message, Point as ListPoint, Pose};
use device::link::{Batch, Point};
use formats::session::ShapeRow;
use inference::identify::Identification;
use inference::predict::Prediction;
use mechanics::{Beam, Model, ModelError, Plane};
use nalgebra::Vector3;
use serde::Serialize;
use std::time::Duration;

/// Name and version of the documents in STRING messages.
pub const SCHEMA: &str = "guide.igtl/1";
/// Distance between points of the needle.
const STEP_M: f64 = 5e-3;

/// The needle in the tissue, solved.
#[derive(Debug, Clone)]
struct Needle {
    depth_m: f64,
    beam_y: Beam,
    beam_x: Beam,
}

/// Published values of one rig.
#[derive(Debug, Clone)]
pub struct Scene {
    guide2_m: f64,
    entry_m: f64,
    needle: Option<Needle>,
    /// What no longer follows a model, in words.
    parted: Vec<String>,
}

#[derive(Serialize)]
struct GuideDocument<'a> {
    schema: &'static str,
    time_s: f64,
    state: &'static str,
    step: Option<u8>,
    position_x_mm: f64,
    position_y_mm: f64,
    force_x_n: f64,
    force_y_n: f64,
    depth_mm: Option<f64>,
    #[serde(skip_serializing_if = "<[String]>::is_empty")]
    parted: &'a [String],
}

#[derive(Serialize)]
struct IdentificationDocument<'a> {
    schema: &'static str,
    session: Option<&'a str>,
    runs: usize,
    k_kpa: f64,
    sd_kpa: f64,
    ci95_kpa: [f64; 2],
    youngs_modulus_kpa: f64,
    youngs_modulus_ci95_kpa: [f64; 2],
    relation: &'a str,
    warnings: usize,
}

#[derive(Serialize)]
struct PredictionDocument<'a> {
    schema: &'static str,
    session: Option<&'a str>,
    insertion: &'a str,
    identified_until_mm: f64,
    tip_force_n: Option<f64>,
    tip_force_sd_n: Option<f64>,
    tip_force_x_n: Option<f64>,
    tip_force_x_sd_n: Option<f64>,
    depth_mm: &'a [f64],
    tip_y_mm: Vec<f64>,
    lo95_y_mm: Vec<f64>,
    hi95_y_mm: Vec<f64>,
    tip_x_mm: Option<Vec<f64>>,
    lo95_x_mm: Option<Vec<f64>>,
    hi95_x_mm: Option<Vec<f64>>,
}

impl Scene {
    /// A rig in which nothing is known of the tissue.
    pub fn new(guide2_m: f64, entry_m: f64) -> Self {
        Self { guide2_m, entry_m, needle: None, parted: Vec::new() }
    }

    /// The tissue is known: tip and shape are published from now on.
    ///
    /// # Errors
    /// As [`Model::problem_in`].
    pub fn tissue(&mut self, model: &Model, depth_m: f64) -> Result<(), ModelError> {
        let solved = |plane| model.problem_in(plane, depth_m)?.solve();
        self.needle = Some(Needle { depth_m, beam_y: solved(Plane::Y)?, beam_x: solved(Plane::X)? });
        Ok(())
    }

    /// The force no longer follows a model, in words: stated with every sample from now on.
    pub fn parted(&mut self, sentence: String) {
        self.parted.push(sentence);
    }

    /// The last sample of a batch, as it is; `stamp` is when it was taken.
    pub fn live(&self, batch: &Batch, point: &Point, stamp: Duration) -> Vec<Message> {
        let [x_m, y_m] = point.displacement_m;
        let document = GuideDocument {
            schema: SCHEMA,
            time_s: point.time_s,
            state: device::link::display::state(batch.state),
            step: batch.step,
            position_x_mm: 1e3 * x_m,
            position_y_mm: 1e3 * y_m,
            force_x_n: point.force_n[0],
            force_y_n: point.force_n[1],
            depth_mm: self.needle.as_ref().map(|needle| 1e3 * needle.depth_m),
            parted: &self.parted,
        };
        let mut messages = vec![
            message(
                "GuideToReference",
                Content::Transform(Pose::at(millimetres([x_m, y_m, self.guide2_m]))),
                stamp,
            ),
            message("Force", Content::Sensor(point.force_n.to_vec()), stamp),
            message("Guide", text(&document), stamp),
        ];
        if let Some(needle) = &self.needle {
            let tip = needle.pose(point.displacement_m, self.entry_m + needle.depth_m);
            messages.push(message("NeedleTipToReference", Content::Transform(tip), stamp));
            let points = needle.points(point.displacement_m, self.entry_m);
            messages.push(message("NeedleShape", Content::Points(points), stamp));
        }
        messages
    }

    /// A sweep as it was measured.
    pub fn measured(rows: impl Iterator<Item = ShapeRow>, stamp: Duration) -> Message {
        let points = rows
            .map(|row| ListPoint {
                group: "measured".to_owned(),
                position_mm: millimetres([row.deflection_x_m, row.deflection_y_m, row.z_m]),
                ..ListPoint::default()
            })
            .collect();
        Message { device: "MeasuredShape".to_owned(), stamp, content: Content::Points(points) }
    }

    /// The modulus of a session.
    pub fn identification(found: &Identification, stamp: Duration) -> Message {
        let document = IdentificationDocument {
            schema: SCHEMA,
            session: found.session.as_deref(),
            runs: found.pooled.runs,
            k_kpa: found.pooled.k_kpa,
            sd_kpa: found.pooled.sd_kpa,
            ci95_kpa: found.pooled.ci95_kpa,
            youngs_modulus_kpa: found.youngs_modulus_kpa.value.unwrap_or(f64::NAN),
            youngs_modulus_ci95_kpa: found.youngs_modulus_kpa.ci95.unwrap_or([f64::NAN; 2]),
            relation: found.youngs_modulus_kpa.relation,
            warnings: found.warnings.len(),
        };
        Message { device: "Identification".to_owned(), stamp, content: text(&document) }
    }

    /// Tip load and path of the last insertion that could be predicted.
    pub fn prediction(&self, found: &Prediction, stamp: Duration) -> Vec<Message> {
        let Some(last) = found.insertions.iter().rev().find(|insertion| insertion.error.is_none()) else {
            return Vec::new();
        };
        // A micrometre; a text message has 64 kB.
        let rounded = |values: &[f64]| values.iter().map(|mm| (1e3 * mm).round() / 1e3).collect::<Vec<_>>();
        let horizontal = |values: &Option<Vec<f64>>| values.as_deref().map(rounded);
        let document = PredictionDocument {
            schema: SCHEMA,
            session: found.session.as_deref(),
            insertion: &last.id,
            identified_until_mm: last.identified_until_mm,
            tip_force_n: last.tip_force_n,
            tip_force_sd_n: last.tip_force_sd_n,
            tip_force_x_n: last.tip_force_x_n,
            tip_force_x_sd_n: last.tip_force_x_sd_n,
            depth_mm: &last.depth_mm,
            tip_y_mm: rounded(&last.tip_y_mm),
            lo95_y_mm: rounded(&last.lo95_y_mm),
            hi95_y_mm: rounded(&last.hi95_y_mm),
            tip_x_mm: horizontal(&last.tip_x_mm),
            lo95_x_mm: horizontal(&last.lo95_x_mm),
            hi95_x_mm: horizontal(&last.hi95_x_mm),
        };
        let points = last
            .depth_mm
            .iter()
            .enumerate()
            .map(|(index, depth_mm)| {
                let width_y = value_or_zero(&last.hi95_y_mm, index) - value_or_zero(&last.lo95_y_mm, index);
                let width_x = second_value_or_zero(&last.hi95_x_mm, index)
                    - second_value_or_zero(&last.lo95_x_mm, index);
                let (x_mm, y_mm) =
                    (second_value_or_zero(&last.tip_x_mm, index), value_or_zero(&last.tip_y_mm, index));
                let measured = *depth_mm <= last.identified_until_mm;
                ListPoint {
                    name: format!("{depth_mm} mm"),
                    group: if measured { "measured" } else { "predicted" }.to_owned(),
                    position_mm: [x_mm, y_mm, 1e3 * self.entry_m + depth_mm].map(|mm| mm as f32),
                    diameter_mm: width_y.max(width_x) as f32,
                }
            })
            .collect();
        vec![
            message("Prediction", text(&document), stamp),
            message("PredictedPath", Content::Points(points), stamp),
        ]
    }
}

fn second_value_or_zero(values: &Option<Vec<f64>>, index: usize) -> f64 {
    values.as_deref().map_or(0.0, |values| value_or_zero(values, index))
}

fn value_or_zero(values: &[f64], index: usize) -> f64 {
    values.get(index).copied().unwrap_or(0.0)
}

fn message(device: &str, content: Content, stamp: Duration) -> Message {
    Message { device: device.to_owned(), stamp, content }
}

impl Needle {
    /// A point of the needle and its direction while guide 2 is held at a displacement along x and y.
    fn pose(&self, displacement_m: [f64; 2], z_m: f64) -> Pose {
        let [x, y] = displacement_m;
        let ((x_m, slope_x), (y_m, slope_y)) =
            (in_plane(&self.beam_x, x, z_m), in_plane(&self.beam_y, y, z_m));
        let tangent = Vector3::new(slope_x, slope_y, 1.0).normalize();
        let normal = Vector3::y().cross(&tangent).normalize();
        let axes = [normal, tangent.cross(&normal), tangent].map(|axis| axis.cast::<f32>().into());
        Pose { axes, position_mm: millimetres([x_m, y_m, z_m]) }
    }

    /// Points from guide 1 to the tip.
    fn points(&self, displacement_m: [f64; 2], entry_m: f64) -> Vec<ListPoint> {
        let tip_m = entry_m + self.depth_m;
        let steps = (tip_m / STEP_M).ceil().max(1.0) as u32;
        (0..=steps)
            .map(|step| {
                let z_m = tip_m * f64::from(step) / f64::from(steps);
                ListPoint {
                    group: if z_m < entry_m { "outside" } else { "inside" }.to_owned(),
                    position_mm: self.pose(displacement_m, z_m).position_mm,
                    ..ListPoint::default()
                }
            })
            .collect()
    }
}

fn in_plane(beam: &Beam, held_m: f64, z_m: f64) -> (f64, f64) {
    let force_n = beam.force_n(held_m);
    (beam.deflection_m(held_m, z_m), force_n * beam.guide2_force().slope(z_m))
}

fn millimetres(metres: [f64; 3]) -> [f32; 3] {
    metres.map(|m| (1e3 * m) as f32)
}

/// A document; numbers that are none are `null`.
fn text(document: &impl Serialize) -> Content {
    Content::Text(serde_json::to_string(document).unwrap_or_default())
}
