//! Common interface of all estimators: samples in, mean stiffness and damping out.

use estimator::Sample;
use formats::session::SteeringRun;
use mechanics::steering::{BaseForce, MovingNeedle};
use mechanics::{Dynamics, Foundation, ModelError, Needle};

/// Report of an estimator after a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Report {
    /// Insertion depth, m.
    pub depth_m: f64,
    /// Mean stiffness over the inserted part, N/m^2; `None` where it is not identified.
    pub stiffness: Option<f64>,
    /// Its 95 % interval, where the estimator has one.
    pub stiffness_ci95: Option<[f64; 2]>,
    /// Mean damping over the inserted part, N s/m^2.
    pub damping: Option<f64>,
    /// Its 95 % interval; from 0 where only an upper bound is known.
    pub damping_ci95: Option<[f64; 2]>,
    /// Predicted position of the model's tip before this sample, m.
    pub tip_m: f64,
}

/// An online estimator.
pub trait Method {
    /// Takes a sample.
    fn update(&mut self, sample: &Sample<f64>) -> Option<Report>;

    /// No more samples: the final estimate, where it differs from the last report.
    fn finish(&mut self) -> Option<Report> {
        None
    }
}

/// The samples of a run.
pub fn samples(run: &SteeringRun) -> impl Iterator<Item = Sample<f64>> + '_ {
    let rows =
        run.time_s.iter().zip(&run.depth_m).zip(&run.base_y_m).zip(&run.base_force_y_n).zip(&run.tip_y_m);
    rows.map(|((((&time_s, &depth_m), &base_m), &force_n), &tip_m)| Sample {
        time_s,
        depth_m,
        base_m,
        force_n,
        tip_m,
    })
}

/// The steering model as the spring-beam-damper paper simulates it: stiffness and damping the same all over the inserted
/// part, with values that change as they are estimated; the base where it was measured.
#[derive(Debug, Clone)]
pub struct MeanModel {
    needle: MovingNeedle,
    moving_mass_kg: f64,
    last: Option<Sample<f64>>,
    start_m: f64,
}

/// Largest stiffness and damping that the simulation is given: beyond, the numbers only lose digits.
const LARGEST: [f64; 2] = [1e8, 1e6];

impl MeanModel {
    /// With so many modes.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] for a needle that is none.
    pub fn new(needle: &Needle, dynamics: &Dynamics, modes: usize) -> Result<Self, ModelError> {
        let unit = Foundation::uniform(1.0)?;
        let dynamics = Dynamics { modes, damping: unit.clone(), ..dynamics.clone() };
        let moving_mass_kg = dynamics.moving_mass_kg();
        Ok(Self {
            needle: MovingNeedle::new(needle, &unit, &dynamics, 0.0)?,
            moving_mass_kg,
            last: None,
            start_m: 0.0,
        })
    }

    /// Goes on to a sample's time, depth and base with these parameters, and returns where the tip is.
    ///
    /// # Errors
    /// [`ModelError::Singular`].
    pub fn advance(&mut self, sample: &Sample<f64>, stiffness: f64, damping: f64) -> Result<f64, ModelError> {
        let Some(last) = self.last else {
            self.last = Some(*sample);
            self.start_m = sample.base_m;
            return Ok(sample.base_m);
        };
        let step_s = sample.time_s - last.time_s;
        let speed_m_s = (sample.base_m - last.base_m) / step_s;
        let strength = [stiffness, damping];
        let depth_m = sample.depth_m.max(self.needle.depth_m());
        let push = BaseForce::stage(self.moving_mass_kg, sample.base_m - self.start_m, speed_m_s);
        self.needle.step(step_s, depth_m, push, [bounded(0, strength), bounded(1, strength)])?;
        self.last = Some(*sample);
        Ok(self.start_m + self.needle.tip_m())
    }
}

fn bounded(i: usize, strength: [f64; 2]) -> f64 {
    if strength[i].is_finite() { strength[i].clamp(0.0, LARGEST[i]) } else { 0.0 }
}
