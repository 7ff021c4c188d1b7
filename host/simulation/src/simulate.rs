//! Lateral runs and insertions from the forward model with effects, as a plan in a file states them: what is to be found is known.
//!
//! The sensors' noise is white and normal, drawn from a seed, each run from its own stream: one more run changes no other.

mod plan;
mod steering;

pub use plan::{Axis, InsertionPlan, LateralPlan, SimulationPlan, SweepLevels};
pub use steering::SteeringPlan;

use crate::rig::{Noise as Random, Stream};
use formats::session::{
    ForceRow, ForceSeries, InsertionRun, LateralRun, Noise, SessionError, SessionWriter, ShapeRow,
    ShapeSeries,
};
use mechanics::{
    Channels, DriveSample, Experiment, Insertion, Lateral, Model, ModelError, Profile, Rig, ShapeImage,
    ShapePoint, TipLaw, predict,
};
use std::f64::consts::PI;

/// Part of a hold after which a sweep begins, and the part of it that the sweep takes.
const SWEEP_STARTS: f64 = 0.3;
const SWEEP_TAKES: f64 = 0.5;
/// A probe above the needle.
const BEAM_RAD: f64 = -0.5 * PI;

/// Standard deviations of the sensors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sensors {
    /// Lateral force.
    pub force_n: f64,
    /// Displacement of guide 2.
    pub displacement_m: f64,
    /// Deflection of the needle.
    pub shape_m: f64,
    /// Position of the tip.
    pub tip_m: f64,
    /// Slope of the needle at the tip, where a sensor measures it.
    pub tip_direction_rad: Option<f64>,
}

impl Sensors {
    /// As stated, and as in an ordinary lab where nothing is.
    pub fn new(stated: &Noise) -> Self {
        Self {
            force_n: stated.force_n.unwrap_or(0.02),
            displacement_m: stated.displacement_m.unwrap_or(0.01e-3),
            shape_m: stated.shape_m.unwrap_or(0.025e-3),
            tip_m: stated.tip_m.unwrap_or(0.05e-3),
            tip_direction_rad: stated.tip_direction_rad,
        }
    }
}

/// Result of a simulated plan.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Simulated {
    /// Lateral runs.
    pub lateral: Vec<LateralRun>,
    /// Insertions.
    pub insertion: Vec<InsertionRun>,
}

impl SimulationPlan {
    /// The model that this plan is carried out with.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] where the modulus is impossible.
    pub fn model(&self, rig: &Rig) -> Result<Model, ModelError> {
        let support = self.model.support.unwrap_or_default();
        let modulus_pa = if support.is_body() { self.model.youngs_pa } else { self.model.modulus_pa };
        let mut model = Model::on(rig.clone(), support, modulus_pa.unwrap_or(0.0))?;
        model.tip = TipLaw::load([self.model.tip_load_n.unwrap_or(0.0), 0.0]);
        model.effects = self.model.effects();
        Ok(model)
    }

    /// Carries out every run with these sensors.
    ///
    /// # Errors
    /// [`ModelError`] where the forward model refuses the rig, the tissue or an effect.
    pub fn carry_out(&self, rig: &Rig, sensors: Sensors, seed: u64) -> Result<Simulated, ModelError> {
        let model = self.model(rig)?;
        let mut simulated = Simulated::default();
        for (number, plan) in (0..).zip(&self.lateral) {
            simulated.lateral.push(plan.carry_out(&model, sensors, seed, number)?);
        }
        for (number, plan) in (0..).zip(&self.insertion) {
            let noise = Random::numbered(seed, Stream::InsertionPlans, number);
            simulated.insertion.push(insertion(&model, plan, sensors, noise)?);
        }
        Ok(simulated)
    }
}

impl LateralPlan {
    /// Carries out this plan as the run of this number in a session, from 0.
    ///
    /// # Errors
    /// [`ModelError`] where the forward model refuses the plan.
    pub fn carry_out(
        &self,
        model: &Model,
        sensors: Sensors,
        seed: u64,
        number: u64,
    ) -> Result<LateralRun, ModelError> {
        lateral(model, (self, number as f64), sensors, Random::numbered(seed, Stream::LateralPlans, number))
    }

    /// Prediction of a model for this plan as the run of this number, without noise.
    ///
    /// # Errors
    /// [`ModelError`] where the forward model refuses the plan.
    pub fn foreseen(&self, model: &Model, order: f64) -> Result<LateralRun, ModelError> {
        let exact =
            Sensors { force_n: 0.0, displacement_m: 0.0, shape_m: 0.0, tip_m: 0.0, tip_direction_rad: None };
        lateral(model, (self, order), exact, Random::numbered(0, Stream::LateralPlans, 0))
    }
}

impl Simulated {
    /// Writes the runs into a session.
    ///
    /// # Errors
    /// As [`SessionWriter::lateral`] and [`SessionWriter::insertion`].
    pub fn write(&self, session: &mut SessionWriter) -> Result<(), SessionError> {
        for run in &self.lateral {
            let mut writer = session.lateral(&run.id, run.depth_m)?;
            let LateralRun { force, shape, .. } = run;
            if shape.images.is_some() {
                writer.imaged();
            }
            let planes = force.displacement_y_m.iter().zip(&force.force_y_n);
            for (row, (time_s, (displacement_y_m, force_y_n))) in force.time_s.iter().zip(planes).enumerate()
            {
                writer.force(&ForceRow {
                    time_s: *time_s,
                    displacement_y_m: *displacement_y_m,
                    force_y_n: *force_y_n,
                    displacement_x_m: value_or_zero(&force.displacement_x_m, row),
                    force_x_n: value_or_zero(&force.force_x_n, row),
                    ..ForceRow::default()
                })?;
            }
            for (row, (z_m, y_m)) in shape.z_m.iter().zip(&shape.y_m).enumerate() {
                writer.shape(&ShapeRow {
                    time_s: value_or_zero(&shape.time_s, row),
                    z_m: *z_m,
                    deflection_y_m: *y_m,
                    deflection_x_m: value_or_zero(&shape.x_m, row),
                    image: shape.image(row),
                })?;
            }
            writer.finish()?;
        }
        self.insertion.iter().try_for_each(|run| session.insertion(run))
    }
}

fn value_or_zero(column: &Option<Vec<f64>>, row: usize) -> f64 {
    column.as_ref().and_then(|values| values.get(row)).copied().unwrap_or_default()
}

fn lateral(
    model: &Model,
    (plan, order): (&LateralPlan, f64),
    sensors: Sensors,
    mut noise: Random,
) -> Result<LateralRun, ModelError> {
    let holds = plan.holds();
    let end_s = holds.last().map_or(0.0, |hold| hold.from_s + plan.hold_s);
    let rows = (end_s * plan.rate_hz + 1e-6).floor() as usize;
    let time_s: Vec<f64> = (0..=rows).map(|row| row as f64 / plan.rate_hz).collect();
    let drive = time_s.iter().map(|time_s| {
        let guide_m = plan.displacement_m(&holds, *time_s);
        let [y_m, x_m] = if plan.axis == Axis::Y { [guide_m, 0.0] } else { [0.0, guide_m] };
        DriveSample { time_s: *time_s, y_m, x_m }
    });
    // In air all of the needle beyond guide 1 can be imaged.
    let first_m = if plan.depth_m > 0.0 { model.rig.entry_m } else { 0.0 };
    let length_m = model.rig.entry_m + plan.depth_m - first_m;
    let points = (length_m / plan.spacing_m + 1e-9).floor() as usize;
    let mut shape = Vec::new();
    let step_s = plan.hold_s * SWEEP_TAKES / points.max(1) as f64;
    let is_imaged = model.effects.iter().any(|(effect, _)| effect.needs_images());
    let image = is_imaged.then(|| ShapeImage { beam_rad: BEAM_RAD, probe_m_per_s: plan.spacing_m / step_s });
    for hold in holds.iter().filter(|hold| plan.is_swept(hold.level_m)) {
        shape.extend((0..points).map(|point| ShapePoint {
            time_s: hold.from_s
                + plan.hold_s * (SWEEP_STARTS + SWEEP_TAKES * point as f64 / points.max(1) as f64),
            z_m: first_m + (point + 1) as f64 * plan.spacing_m,
            image,
        }));
    }
    let (depth_m, drive) = (plan.depth_m, drive.collect());
    let lateral = Lateral { depth_m, drive, shape: shape.clone(), reversal_m: [0.0; 2], order };
    let Channels { displacement_m, force_n, shape_m, .. } = predict(model, &Experiment::Lateral(lateral))?;
    let mut both = |y: Vec<f64>, x: Option<Vec<f64>>, sd: f64| {
        (with_noise(y, sd, &mut noise), x.map(|x| with_noise(x, sd, &mut noise)))
    };
    let (displacement_y_m, displacement_x_m) =
        both(displacement_m.y, displacement_m.x, sensors.displacement_m);
    let (force_y_n, force_x_n) = both(force_n.y, force_n.x, sensors.force_n);
    let (y_m, x_m) = both(shape_m.y, shape_m.x, sensors.shape_m);
    Ok(LateralRun {
        id: plan.id.clone(),
        depth_m: plan.depth_m,
        force_path: format!("{}.force.csv", plan.id).into(),
        shape_path: format!("{}.shape.csv", plan.id).into(),
        provenance: Default::default(),
        force: ForceSeries {
            time_s,
            displacement_y_m,
            force_y_n,
            displacement_x_m,
            force_x_n,
            displacement_y_sd_m: None,
            displacement_x_sd_m: None,
            lost_before: None,
            marks: None,
        },
        shape: ShapeSeries {
            time_s: Some(shape.iter().map(|point| point.time_s).collect()),
            z_m: shape.iter().map(|point| point.z_m).collect(),
            y_m,
            x_m,
            images: is_imaged.then(|| shape.iter().filter_map(|point| point.image).collect()),
            ..ShapeSeries::default()
        },
    })
}

fn with_noise(values: Vec<f64>, sd: f64, noise: &mut Random) -> Vec<f64> {
    values.into_iter().map(|value| value + sd * noise.draw()).collect()
}

fn insertion(
    model: &Model,
    plan: &InsertionPlan,
    sensors: Sensors,
    mut noise: Random,
) -> Result<InsertionRun, ModelError> {
    let steps = (plan.depth_m / plan.step_m + 1e-9).floor() as usize;
    let mut depth_m: Vec<f64> = (0..=steps).map(|step| step as f64 * plan.step_m).collect();
    // A turn happens at a measured depth, and so does the end.
    depth_m.extend(plan.turn_at_m);
    depth_m.push(plan.depth_m);
    depth_m.sort_by(f64::total_cmp);
    depth_m.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
    let turned = |depth_m: &f64| plan.turn_at_m.is_some_and(|turn_m| *depth_m > turn_m + 1e-9);
    let rotation_rad = match plan.turn_at_m {
        Some(turn_m) => Profile::new(vec![[turn_m, 0.0], [turn_m, PI]])?,
        None => Profile::default(),
    };
    let insertion = Insertion {
        depth_m: depth_m.clone(),
        rotation_rad,
        guide2_m: Some(Default::default()),
        speed_m_per_s: Profile::constant(plan.speed_m_per_s),
        tip_direction: sensors.tip_direction_rad.is_some(),
        ..Insertion::default()
    };
    let Channels { tip_m, tip_direction_rad, .. } = predict(model, &Experiment::Insertion(insertion))?;
    Ok(InsertionRun {
        id: plan.id.clone(),
        path: format!("{}.csv", plan.id).into(),
        tip_y_m: with_noise(tip_m.y, sensors.tip_m, &mut noise),
        tip_x_m: tip_m.x.map(|x_m| with_noise(x_m, sensors.tip_m, &mut noise)),
        tip_direction_y_rad: sensors
            .tip_direction_rad
            .map(|sd_rad| with_noise(tip_direction_rad.y, sd_rad, &mut noise)),
        tip_direction_x_rad: sensors
            .tip_direction_rad
            .and_then(|sd_rad| tip_direction_rad.x.map(|x_rad| with_noise(x_rad, sd_rad, &mut noise))),
        time_s: Some(depth_m.iter().map(|depth_m| depth_m / plan.speed_m_per_s).collect()),
        rotation_rad: plan
            .turn_at_m
            .map(|_| depth_m.iter().map(|depth_m| if turned(depth_m) { PI } else { 0.0 }).collect()),
        depth_m,
        guide2_y_m: None,
        guide2_x_m: None,
        base_force_y_n: None,
    })
}

#[cfg(test)]
mod tests;
