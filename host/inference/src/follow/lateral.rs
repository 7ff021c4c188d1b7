//! The force of a lateral run against a model that was learned.
//!
//! Readings are gathered over a tenth of a second. The first seconds in which guide 2 rests show the noise and the
//! zero; nothing is said before. The possible error of the model is not counted: the interval of its modulus, what
//! every rig leaves behind any model, and friction that the model does not have.

use super::{AXES, Difference, FALSE_ALARMS_PER_HOUR, GuideReading, Parted, STEP_S, SURE_SD, norm};
use formats::model_file::ModelFile;
use mechanics::effects::effect;
use mechanics::unknowns::discrepancy::lateral as everyday;
use mechanics::unknowns::sensors::FORCE_ZERO;
use mechanics::{DriveSample, Model, ModelError, ObservationPlan, PreparedNeedle, Rig, Series, Support};
use readings::holds::median;
use readings::sequential::{Departure, Detector, StepNoise};
use std::borrow::Cow;
use std::fmt;

/// Steps at rest from which the noise is learned: three seconds.
const REST_STEPS: usize = 30;
/// Guide 2 rests while it moves by less from one step to the next.
const REST_M: f64 = 0.01e-3;
/// No force sensor is better than this.
const LEAST_NOISE_N: f64 = 1e-4;
/// Steps of the course that effects with a memory see: five minutes.
const COURSE: usize = 3_000;
/// Usual travel of guide 2: what is solved for it is solved once.
const TRAVEL_M: f64 = 5e-3;
/// By how much a force has to differ to be found, at the last step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Discernible {
    /// By so much the model may be off, newtons.
    pub possible_n: f64,
    /// Standard deviation of a step, newtons.
    pub noise_n: f64,
}

/// Follows the readings of one needle at one depth.
pub struct Follower {
    needle: PreparedNeedle<'static>,
    course: Vec<DriveSample>,
    /// Share of the force that the model may be off, and newtons beside that.
    relative: f64,
    absolute_n: f64,
    friction_n: f64,
    open: Vec<GuideReading>,
    open_until_s: Option<f64>,
    steps: Vec<Step>,
    axes: [Axis; 2],
    parted: Vec<Parted>,
}

/// A step that is over.
#[derive(Clone, Copy)]
struct Step {
    time_s: f64,
    displacement_m: [f64; 2],
}

/// State of one axis.
#[derive(Default)]
struct Axis {
    /// Differences in the present rest, and those of all rests less their means.
    rest_n: Vec<f64>,
    learned_n: Vec<f64>,
    zero_n: Option<f64>,
    /// Modelled force where the zero was found: what it may be off is in the zero.
    zero_load_n: f64,
    detector: Option<(u64, Detector)>,
    /// Standard deviation of a step as it was learned, and by how much the model may be off at the last one.
    noise_n: f64,
    possible_n: f64,
    /// Modelled force, direction of the last motion, and whether it has parted.
    force_n: f64,
    direction: f64,
    has_parted: bool,
}

impl Follower {
    /// By a model that was learned, for a needle at a depth.
    ///
    /// # Errors
    /// Why the model cannot be followed.
    pub fn new(model: &ModelFile, rig: &Rig, depth_m: f64) -> Result<Self, FollowError> {
        let (modulus_pa, ends_pa, support) = match (model.support, model.youngs_pa, model.modulus_pa) {
            (Some(support), Some(youngs_pa), _) => (youngs_pa, model.youngs_ci95_pa, support),
            (_, _, Some(modulus_pa)) => (modulus_pa, model.modulus_ci95_pa, Support::Springs),
            _ => return Err(FollowError::NoModulus),
        };
        let of_modulus =
            ends_pa.map_or(0.0, |[low, high]| (high / modulus_pa).max(modulus_pa / low) - 1.0).max(0.0);
        let usual = [
            everyday::MODULUS_FROM_RUN_TO_RUN,
            everyday::MODULUS_OVER_DEPTH,
            everyday::FORCE_GAIN_OF_RUN,
            everyday::NONLINEAR_FORCE,
            everyday::FORCE_HYSTERESIS,
            everyday::FORCE_CREEP,
        ];
        let relative = of_modulus + SURE_SD * norm(&usual.map(|unknown| unknown.typical_sd()));
        let usual_n =
            [everyday::FORCE_OF_HOLD, everyday::FORCE_ON_THE_WAY, everyday::FORCE_DRIFT, FORCE_ZERO];
        let absolute_n = SURE_SD * norm(&usual_n.map(|unknown| unknown.typical_sd()));
        let effects: Vec<_> =
            model.effects().into_iter().filter(|(effect, _)| effect.info().observable_in.lateral).collect();
        let has_friction = effects.iter().any(|(effect, _)| effect.id() == "rig.friction");
        let friction = effect("rig.friction").and_then(|friction| friction.parameters().first());
        let friction_n = friction.filter(|_| !has_friction).map_or(0.0, |info| info.prior_sd);
        let mut plain = Model::on(rig.clone(), support, modulus_pa)?;
        plain.effects = effects;
        let plan = ObservationPlan {
            shape: &[],
            most_m: [TRAVEL_M; 2],
            planes: 2,
            reversal_m: [REST_M; 2],
            order: 0.0,
        };
        Ok(Self {
            needle: PreparedNeedle::new(Cow::Owned(plain), depth_m, plan, None)?,
            course: Vec::new(),
            relative,
            absolute_n,
            friction_n,
            open: Vec::new(),
            open_until_s: None,
            steps: Vec::new(),
            axes: Default::default(),
            parted: Vec::new(),
        })
    }

    /// Takes in readings; what was found with them, each axis once.
    pub fn push(&mut self, points: &[GuideReading]) -> Vec<Parted> {
        let mut departures = Vec::new();
        for point in points {
            let close_time_s = *self.open_until_s.get_or_insert(point.time_s + STEP_S);
            let began_again = point.time_s < close_time_s - 2.0 * STEP_S;
            if point.time_s >= close_time_s || began_again {
                departures.extend(self.close());
                // A device that starts again has a clock that does, and readings may be missing.
                self.open_until_s = Some(if began_again || point.time_s >= close_time_s + STEP_S {
                    point.time_s + STEP_S
                } else {
                    close_time_s + STEP_S
                });
            }
            if !point.repeats_force {
                self.open.push(*point);
            }
        }
        departures
    }

    /// Whether noise and zero are known, so that something can be said.
    pub fn is_following(&self) -> bool {
        self.axes.iter().all(|axis| axis.detector.is_some())
    }

    /// By how much the force along x and y has to differ to be found; nothing before [`Self::is_following`].
    pub fn discernible(&self) -> [Option<Discernible>; 2] {
        self.axes.each_ref().map(|axis| {
            axis.detector.as_ref().map(|_| Discernible { possible_n: axis.possible_n, noise_n: axis.noise_n })
        })
    }

    /// Axes whose force no longer follows the model so far.
    pub fn parted(&self) -> &[Parted] {
        &self.parted
    }

    /// Ends a step.
    fn close(&mut self) -> Vec<Parted> {
        let points = std::mem::take(&mut self.open);
        let Some(last) = points.last() else { return Vec::new() };
        let displacement_m = [0, 1].map(|axis| median_of(&|point| point.displacement_m[axis], &points));
        let force_n = [0, 1].map(|axis| median_of(&|point| point.force_n[axis], &points));
        let current_step = Step { time_s: last.time_s, displacement_m };
        let previous_step = self.steps.last().copied();
        let number = self.steps.len() as u64;
        self.steps.push(current_step);
        if self.course.len() >= COURSE {
            self.course.drain(..COURSE / 3);
        }
        let [x_m, y_m] = displacement_m;
        self.course.push(DriveSample { time_s: number as f64 * STEP_S, y_m, x_m });
        // If the model has no force there, no comparison is possible.
        let modelled = self.needle.moved(&self.course).map(|channels| last_of(&channels.force_n));
        let modelled = modelled.unwrap_or([f64::NAN; 2]);
        let step_m =
            [0, 1].map(|axis| previous_step.map_or(0.0, |b| displacement_m[axis] - b.displacement_m[axis]));
        let is_rest = step_m.iter().all(|step_m| step_m.abs() < REST_M);
        let mut departures = Vec::new();
        for (number_of, axis) in self.axes.iter_mut().enumerate() {
            let difference = force_n[number_of] - modelled[number_of];
            let load = (modelled[number_of] - axis.force_n).abs();
            let turns = step_m[number_of].abs() >= REST_M && step_m[number_of] * axis.direction <= 0.0;
            if step_m[number_of].abs() >= REST_M {
                axis.direction = step_m[number_of].signum();
            }
            axis.force_n = modelled[number_of];
            let Some((first, detector)) = &mut axis.detector else {
                axis.learn(difference, is_rest, number);
                continue;
            };
            let tolerance = self.absolute_n
                + self.friction_n
                + self.relative * (modelled[number_of].abs() + axis.zero_load_n);
            axis.possible_n = tolerance;
            let change = self.relative * load + if turns { 2.0 * self.friction_n } else { 0.0 };
            let residual_n = difference - axis.zero_n.unwrap_or_default();
            let departure = detector.step(residual_n, tolerance, change).filter(|_| !axis.has_parted);
            if let Some(Departure { since, mean, sigma }) = departure {
                axis.has_parted = true;
                let began = usize::try_from(*first + since).ok().and_then(|at| self.steps.get(at));
                let began = began.copied().unwrap_or(current_step);
                departures.push(Parted {
                    axis: AXES[number_of],
                    since_s: began.time_s,
                    found_s: current_step.time_s,
                    displacement_mm: 1e3 * began.displacement_m[number_of],
                    depth_mm: None,
                    difference: Difference::Force { mean_n: mean },
                    sigma,
                });
            }
        }
        self.parted.extend(&departures);
        departures
    }
}

fn median_of(of: &dyn Fn(&GuideReading) -> f64, points: &[GuideReading]) -> f64 {
    median(points.iter().map(of).collect())
}

impl Axis {
    /// Takes a step into what is known of noise and zero, where guide 2 rests.
    fn learn(&mut self, difference: f64, rests: bool, number: u64) {
        if !rests || !difference.is_finite() {
            self.end_rest();
            return;
        }
        self.rest_n.push(difference);
        if self.learned_n.len() + self.rest_n.len() < REST_STEPS {
            return;
        }
        self.end_rest();
        let learned = StepNoise::of_rest(&self.learned_n);
        // Readings without any noise: the best sensor there is.
        let noise = learned.unwrap_or(StepNoise::independent(LEAST_NOISE_N));
        let noise = StepNoise { sd: noise.sd.max(LEAST_NOISE_N), ..noise };
        self.noise_n = noise.sd;
        self.detector = Some((number + 1, Detector::new(noise, STEP_S, FALSE_ALARMS_PER_HOUR)));
    }

    fn end_rest(&mut self) {
        let resting_force_n = std::mem::take(&mut self.rest_n);
        if resting_force_n.is_empty() {
            return;
        }
        let mean_n = resting_force_n.iter().sum::<f64>() / resting_force_n.len() as f64;
        if self.zero_n.is_none() {
            (self.zero_n, self.zero_load_n) = (Some(mean_n), self.force_n.abs());
        }
        self.learned_n.extend(resting_force_n.iter().map(|value| value - mean_n));
    }
}

/// The last force along each axis of the device.
fn last_of(force_n: &Series) -> [f64; 2] {
    [last_value(force_n.x.as_ref()), last_value(Some(&force_n.y))]
}

fn last_value(values: Option<&Vec<f64>>) -> f64 {
    values.and_then(|values| values.last()).copied().unwrap_or(f64::NAN)
}

/// Why a model cannot be followed.
#[derive(Debug, thiserror::Error)]
pub enum FollowError {
    /// It has no modulus.
    #[error("[tissue]: no modulus, expected that of a model file of `guide diagnose --out`")]
    NoModulus,
    /// It cannot be evaluated.
    #[error(transparent)]
    Model(#[from] ModelError),
}

impl fmt::Debug for Follower {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Follower").field("steps", &self.steps.len()).field("parted", &self.parted).finish()
    }
}
