//! From the model and what was done to what every sensor should have read.

use super::cache::Cache;
use super::effects::{Effect, ObservationContext};
use super::insertion::{self, Insertion, TipLaw};
use super::lateral::Drive;
use super::prepared::{self, ObservationPlan, PreparedNeedle};
use super::steering::{self, Dynamics, Steering};
use super::terms::Conditions;
use super::{Beam, BeamProblem, Foundation, ModelError, Rig, Support};
use std::borrow::Cow;

/// The model: hardware and tissue.
#[derive(Debug, Clone)]
pub struct Model {
    /// Needle, guides and tissue surface.
    pub rig: Rig,
    /// The tissue: the foundation modulus K of springs, or Young's modulus E of a body.
    pub foundation: Foundation,
    /// Support of the needle by the tissue.
    pub support: Support,
    /// The tip, in insertions.
    pub tip: TipLaw,
    /// Drive and resistance of the motion, in steering runs.
    pub dynamics: Option<Dynamics>,
    /// Effects with the values of their parameters, applied in this order.
    pub effects: Vec<(&'static dyn Effect, Vec<f64>)>,
}

impl PartialEq for Model {
    fn eq(&self, other: &Self) -> bool {
        self.rig == other.rig
            && self.foundation == other.foundation
            && self.support == other.support
            && self.tip == other.tip
            && self.dynamics == other.dynamics
            && named_effects(self) == named_effects(other)
    }
}

/// Effects of a model by their ids, with the values of their parameters.
fn named_effects(model: &Model) -> Vec<(&str, Vec<f64>)> {
    model.effects.iter().map(|(effect, values)| (effect.id(), values.clone())).collect()
}

impl Model {
    /// Uniform tissue made of springs of a foundation modulus K, and no effects.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] where the modulus is negative or not finite.
    pub fn uniform(rig: Rig, modulus_pa: f64) -> Result<Self, ModelError> {
        Self::on(rig, Support::Springs, modulus_pa)
    }

    /// A uniform elastic body of this Young's modulus and Poisson's ratio, and no effects.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] where the modulus is negative or not finite, or Poisson's ratio not in 0 to 0.5.
    pub fn body(rig: Rig, youngs_pa: f64, poisson: f64) -> Result<Self, ModelError> {
        Self::on(rig, Support::half_space(poisson), youngs_pa)
    }

    /// Uniform tissue made of springs or a body, of this K or E, and no effects.
    ///
    /// # Errors
    /// As [`Self::uniform`] and [`Self::body`].
    pub fn on(rig: Rig, support: Support, modulus_pa: f64) -> Result<Self, ModelError> {
        support.check()?;
        let foundation = Foundation::uniform(modulus_pa)?;
        Ok(Self { rig, foundation, support, tip: TipLaw::default(), dynamics: None, effects: Vec::new() })
    }

    /// The needle inserted to `depth_m`, solved for unit loads.
    ///
    /// # Errors
    /// As [`BeamProblem::solve`].
    pub fn beam(&self, depth_m: f64) -> Result<Beam, ModelError> {
        self.problem(depth_m)?.solve()
    }

    /// The needle inserted to `depth_m`, as its effects make it.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] where an effect's values are impossible.
    pub fn problem(&self, depth_m: f64) -> Result<BeamProblem, ModelError> {
        self.problem_in(Plane::Y, depth_m)
    }

    /// The same in a plane: the tissue may differ between them.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] where an effect's values are impossible.
    pub fn problem_in(&self, plane: Plane, depth_m: f64) -> Result<BeamProblem, ModelError> {
        self.problem_under(plane, &Conditions { depth_m, ..Conditions::default() })
    }

    /// The same under conditions of a run.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] where an effect's values are impossible.
    pub fn problem_under(&self, plane: Plane, conditions: &Conditions) -> Result<BeamProblem, ModelError> {
        let depth_m = conditions.depth_m;
        let foundation = self.foundation.clone();
        let support = match (plane, self.support.block()) {
            (Plane::X, Some(block)) => self.support.with_block(Some(block.turned())),
            _ => self.support,
        };
        let mut problem = BeamProblem { support, ..BeamProblem::new(&self.rig, foundation, depth_m) };
        problem.clamp_compliance_rad_per_n_m =
            self.rig.rear_compliance_rad_per_n_m(if plane == Plane::Y { 0 } else { 1 });
        for (effect, values) in &self.effects {
            effect.beam(values, plane, &mut problem)?;
            effect.tissue(values, conditions, plane, &mut problem)?;
        }
        Ok(problem)
    }

    /// Largest lag of the needle behind guide 2 as it is commanded: clearance and play, m.
    pub fn clearance_m(&self) -> f64 {
        let mut drive = Drive::default();
        self.effects.iter().for_each(|(effect, values)| effect.drive(values, &mut drive));
        drive.clearance_m + drive.play_m
    }

    /// Stress-free curvature of the needle, vertical and horizontal before it is turned, 1/m.
    pub fn curvature_per_m(&self) -> [f64; 2] {
        let mut curvature_per_m = [0.0; 2];
        self.effects
            .iter()
            .for_each(|(effect, values)| effect.stress_free_curvature(values, &mut curvature_per_m));
        curvature_per_m
    }

    pub(super) fn observe(&self, context: &ObservationContext<'_>, channels: &mut Channels) {
        self.effects.iter().for_each(|(effect, values)| effect.observe(values, context, channels));
    }
}

/// A plane in which the needle bends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Plane {
    /// Vertical.
    Y,
    /// Horizontal.
    X,
}

/// Conditions of an experiment, without any measured answer in it.
#[derive(Debug, Clone, PartialEq)]
pub enum Experiment {
    /// Guide 2 moved sideways at a fixed depth.
    Lateral(Lateral),
    /// Guide 2 pushed sideways with a given force at a fixed depth.
    LateralForce(LateralForce),
    /// The needle was inserted.
    Insertion(Insertion),
    /// The needle was inserted while its base was moved.
    Steering(Steering),
}

/// A lateral run: where guide 2 was, and where and when the shape was measured.
#[derive(Debug, Clone, PartialEq)]
pub struct Lateral {
    /// Length of the needle inside the tissue.
    pub depth_m: f64,
    /// Displacement of guide 2 against time, in increasing time.
    pub drive: Vec<DriveSample>,
    /// Points at which the shape was measured.
    pub shape: Vec<ShapePoint>,
    /// Motion back by this or less is noise of `drive`, vertical and horizontal; 0 where `drive` is the commanded motion.
    pub reversal_m: [f64; 2],
    /// Number of the run among the lateral ones of its session, 0 for the first.
    pub order: f64,
}

/// A lateral run that is driven by force: a weight, or an actuator under force control.
#[derive(Debug, Clone, PartialEq)]
pub struct LateralForce {
    /// Length of the needle inside the tissue.
    pub depth_m: f64,
    /// Force of guide 2 against time, in increasing time.
    pub drive: Vec<ForceSample>,
    /// Points at which the shape was measured.
    pub shape: Vec<ShapePoint>,
}

/// Force of guide 2 at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForceSample {
    /// Time.
    pub time_s: f64,
    /// Vertical force.
    pub y_n: f64,
    /// Horizontal force.
    pub x_n: f64,
}

/// Displacement of guide 2 at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriveSample {
    /// Time.
    pub time_s: f64,
    /// Vertical displacement.
    pub y_m: f64,
    /// Horizontal displacement.
    pub x_m: f64,
}

/// A point of the needle measured at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShapePoint {
    /// Time.
    pub time_s: f64,
    /// Position along the needle from guide 1.
    pub z_m: f64,
    /// Image of the point, if it is known.
    pub image: Option<ShapeImage>,
}

impl ShapePoint {
    /// A point of which nothing is known of its image.
    pub const fn new(time_s: f64, z_m: f64) -> Self {
        Self { time_s, z_m, image: None }
    }
}

/// Conditions under which a point of the shape was imaged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShapeImage {
    /// Direction in which the beam leaves the probe, in the plane across the needle: from the horizontal x towards y, rad.
    pub beam_rad: f64,
    /// Speed of the probe along the needle, m/s; positive where z grows.
    pub probe_m_per_s: f64,
}

impl ShapeImage {
    /// Unit vector along the beam, vertical and horizontal.
    pub fn along(&self) -> [f64; 2] {
        let (y, x) = self.beam_rad.sin_cos();
        [y, x]
    }
}

/// One sensor's values in the vertical and, where there is one, the horizontal plane.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Series {
    /// Vertical.
    pub y: Vec<f64>,
    /// Horizontal; nothing in a one-plane experiment.
    pub x: Option<Vec<f64>>,
}

/// Readings of the sensors, predicted or measured: one value per drive sample, shape point or
/// depth.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Channels {
    /// Displacement of guide 2 at every drive sample.
    pub displacement_m: Series,
    /// Lateral force at guide 2 at every drive sample, or at the base at every time of a steering run.
    pub force_n: Series,
    /// Deflection at every shape point.
    pub shape_m: Series,
    /// Position of the tip at every depth of an insertion, or time of a steering run.
    pub tip_m: Series,
    /// Slope of the needle at the tip at every depth of an insertion, where it is measured
    /// ([`Insertion::tip_direction`]).
    pub tip_direction_rad: Series,
    /// Lateral position of the base at every time of a steering run.
    pub base_m: Series,
}

impl Channels {
    pub(super) fn two_planes() -> Self {
        Self {
            displacement_m: empty_series(),
            force_n: empty_series(),
            shape_m: empty_series(),
            tip_m: empty_series(),
            tip_direction_rad: empty_series(),
            base_m: Series::default(),
        }
    }
}

fn empty_series() -> Series {
    Series { y: Vec::new(), x: Some(Vec::new()) }
}

/// Expected reading of every sensor in `experiment` if `model` is right.
///
/// Order: beam and drive, stress-free curvature, solve, map position, observe; effects of one kind in the order of the model's list.
///
/// # Errors
/// As [`BeamProblem::solve`], [`ModelError::NoDrive`] where there are shape points but no drive sample, and
/// [`ModelError::NoDynamics`] where a steering run is requested of a model without.
pub fn predict(model: &Model, experiment: &Experiment) -> Result<Channels, ModelError> {
    predict_with(model, experiment, &Cache::default())
}

/// The same as [`predict`], which solves no needle twice that the cache still holds: for many runs or many models that differ little.
///
/// # Errors
/// As [`predict`].
pub fn predict_with(model: &Model, experiment: &Experiment, cache: &Cache) -> Result<Channels, ModelError> {
    match experiment {
        Experiment::Lateral(lateral) => predict_lateral(model, lateral, cache),
        Experiment::LateralForce(forced) => predict_forced(model, forced, cache),
        Experiment::Insertion(inserted) => predict_insertion(model, inserted, cache),
        Experiment::Steering(run) => {
            let dynamics = model.dynamics.as_ref().ok_or(ModelError::NoDynamics)?;
            model.support.needs_springs("a steering run")?;
            let problem = model.problem(run.depth_m.iter().copied().fold(0.0, f64::max))?;
            let moved = steering::simulate(&model.rig.needle, &problem.foundation, dynamics, run)?;
            let mut channels = Channels {
                force_n: one_plane(moved.base_force_n),
                tip_m: one_plane(moved.tip_m),
                base_m: one_plane(moved.base_m),
                ..Channels::default()
            };
            let context = ObservationContext { time_s: &run.time_s, ..ObservationContext::default() };
            model.observe(&context, &mut channels);
            Ok(channels)
        }
    }
}

fn one_plane(y: Vec<f64>) -> Series {
    Series { y, x: None }
}

fn predict_lateral(model: &Model, lateral: &Lateral, cache: &Cache) -> Result<Channels, ModelError> {
    let Lateral { depth_m, drive, shape, reversal_m, order } = lateral;
    let (most_m, reversal_m, order) = (prepared::most_m(drive), *reversal_m, *order);
    let plan = ObservationPlan { shape, most_m, planes: 2, reversal_m, order };
    PreparedNeedle::new(Cow::Borrowed(model), *depth_m, plan, Some(cache))?.moved(drive)
}

/// Small forces: the linear needle, without what lies between actuator and needle.
fn predict_forced(model: &Model, forced: &LateralForce, cache: &Cache) -> Result<Channels, ModelError> {
    let stiffness = [Plane::Y, Plane::X].map(|plane| {
        Ok::<_, ModelError>(model.problem_in(plane, forced.depth_m)?.solve()?.lateral_stiffness_n_per_m())
    });
    let [stiffness_y, stiffness_x] = stiffness;
    let (stiffness_y, stiffness_x) = (stiffness_y?, stiffness_x?);
    let drive = forced
        .drive
        .iter()
        .map(|sample| DriveSample {
            time_s: sample.time_s,
            y_m: sample.y_n / stiffness_y,
            x_m: sample.x_n / stiffness_x,
        })
        .collect();
    let lateral = Lateral {
        depth_m: forced.depth_m,
        drive,
        shape: forced.shape.clone(),
        reversal_m: [0.0; 2],
        order: 0.0,
    };
    predict_lateral(model, &lateral, cache)
}

fn predict_insertion(model: &Model, inserted: &Insertion, cache: &Cache) -> Result<Channels, ModelError> {
    let deepest_m = inserted.depth_m.iter().copied().fold(0.0, f64::max);
    let conditions = Conditions { depth_m: deepest_m, order: inserted.order };
    let problems =
        [problem_in_plane(Plane::Y, conditions, model)?, problem_in_plane(Plane::X, conditions, model)?];
    let mut law = model.tip.clone();
    model.effects.iter().for_each(|(effect, values)| effect.tip(values, &conditions, &mut law));
    let curvature_per_m = model.curvature_per_m();
    // The compliance of the frame is part of the beam problem here.
    let inserted = inserted.through_clearance(model.clearance_m());
    let insertion::Tip { position_m, direction_rad } =
        insertion::tip(&problems, &law, curvature_per_m, &inserted, cache)?;
    let mut channels =
        Channels { tip_m: position_m, tip_direction_rad: direction_rad, ..Channels::two_planes() };
    let entry_m = model.rig.entry_m;
    let tip_depth_m = inserted.depth_m.as_slice();
    let context = ObservationContext { conditions, entry_m, tip_depth_m, ..ObservationContext::default() };
    model.observe(&context, &mut channels);
    Ok(channels)
}

/// Beam problem of a plane under the run's conditions.
fn problem_in_plane(plane: Plane, conditions: Conditions, model: &Model) -> Result<BeamProblem, ModelError> {
    model.problem_under(plane, &conditions)
}

#[cfg(test)]
mod tests;
