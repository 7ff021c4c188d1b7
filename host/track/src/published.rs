//! The estimator of the spring-beam-damper paper, (7)-(10), as printed, with the errata (theory, eq. 57): recursive least
//! squares with forgetting on the second difference of tip and base, one mode, powers of the depth in metres within a
//! segment, covariance reset at the segment's start. And a relative with a variable forgetting factor.

use super::method::{MeanModel, Method, Report};
use estimator::Sample;
use mechanics::steering::history::{CutPathForce, ShapeFunctions, SupportMatrix};
use mechanics::steering::modes::{FreeMode, free_modes};
use mechanics::{Dynamics, ModelError, Needle};
use nalgebra::{DMatrix, DVector, Matrix2, Vector2};

/// Settings of the paper.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PublishedSettings {
    /// Order of the polynomials.
    pub order: usize,
    /// Length of a segment.
    pub segment_m: f64,
    /// Forgetting.
    pub forgetting: Forgetting,
    /// Every coefficient of the damping and of the stiffness at first.
    pub start: [f64; 2],
    /// Covariance at first and after a reset, a multiple of the unit matrix.
    pub covariance: f64,
    /// Corner frequency of the filter through which all signals go first.
    pub filter_hz: f64,
}

impl Default for PublishedSettings {
    fn default() -> Self {
        Self {
            order: 5,
            segment_m: 0.04,
            forgetting: Forgetting::Constant(0.99),
            start: [3e5, 2e6],
            covariance: 1e16,
            filter_hz: 2.0,
        }
    }
}

/// Rule by which old rows are forgotten.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Forgetting {
    /// Always by this factor.
    Constant(f64),
    /// So that the information in the residuals stays the same (Fortescue, Kershenbaum, Ydstie 1981): the sum of squared
    /// residuals, in m^2, that is kept.
    Variable(f64),
}

/// Least forgetting factor of the variable kind.
const MIN_FORGETTING: f64 = 0.9;

/// The estimator.
#[derive(Debug, Clone)]
pub struct Published {
    settings: PublishedSettings,
    factors: DMatrix<f64>,
    overlap: SupportMatrix,
    pull: CutPathForce,
    /// `B M^-1`, `B^-1`, elastic stiffness, load of the base force.
    from_load: Matrix2<f64>,
    to_modes: Matrix2<f64>,
    elastic: Matrix2<f64>,
    base: Vector2<f64>,
    filters: [LowPass; 3],
    /// The last two filtered samples with what the inserted part was then: time, outputs, force, overlap, pull.
    past: Vec<Past>,
    last_depth_m: f64,
    segment: usize,
    parameters: DVector<f64>,
    covariance: DMatrix<f64>,
    model: MeanModel,
    start_m: Option<f64>,
}

#[derive(Debug, Clone)]
struct Past {
    time_s: f64,
    outputs: Vector2<f64>,
    force_n: f64,
    overlap: Matrix2<f64>,
    pull: Vector2<f64>,
}

impl Published {
    /// For a needle.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] for a needle that is none.
    pub fn new(
        needle: &Needle,
        dynamics: &Dynamics,
        settings: PublishedSettings,
    ) -> Result<Self, ModelError> {
        let modes: Vec<FreeMode> = free_modes(&dynamics.clamped(needle), 1)?;
        let functions = ShapeFunctions::of(&modes, dynamics.length_m);
        let factors = functions.factors(&modes);
        let (base, tip) = (
            scaled_functions(0.0, &factors, &functions),
            scaled_functions(dynamics.length_m, &factors, &functions),
        );
        let outputs = Matrix2::from_rows(&[base.transpose(), tip.transpose()]);
        let mass = Matrix2::from_diagonal(&Vector2::new(dynamics.moving_mass_kg(), 1.0));
        let frequency = modes.first().map_or(0.0, |mode| mode.frequency_rad_s);
        let count = 2 * (settings.order + 1);
        let mut estimator = Self {
            settings,
            overlap: SupportMatrix::new(&functions),
            pull: CutPathForce::new(&functions),
            factors,
            from_load: outputs * inverse(mass)?,
            to_modes: inverse(outputs)?,
            elastic: Matrix2::from_diagonal(&Vector2::new(0.0, frequency.powi(2))),
            base,
            filters: [LowPass::default(); 3],
            past: Vec::new(),
            last_depth_m: 0.0,
            segment: 0,
            parameters: DVector::zeros(count),
            covariance: DMatrix::zeros(count, count),
            model: MeanModel::new(needle, dynamics, 1)?,
            start_m: None,
        };
        for i in 0..count {
            estimator.parameters[i] = estimator.settings.start[usize::from(i > estimator.settings.order)];
        }
        estimator.reset();
        Ok(estimator)
    }

    fn reset(&mut self) {
        let count = self.parameters.len();
        self.covariance = DMatrix::identity(count, count) * self.settings.covariance;
    }

    /// Damping and stiffness at a depth.
    fn values(&self, depth_m: f64) -> [f64; 2] {
        let count = self.settings.order + 1;
        let s_m = depth_m - self.segment as f64 * self.settings.segment_m;
        let at = |from: usize| (0..count).rev().fold(0.0, |sum, i| sum * s_m + self.parameters[from + i]);
        [at(0), at(count)]
    }

    /// The regression (8) and the step (10).
    fn learn(&mut self, now: &Past, depth_m: f64) {
        let [earlier, last] = match self.past.as_slice() {
            [before, last] => [before, last],
            _ => return,
        };
        let step_s = last.time_s - earlier.time_s;
        let modes = self.to_modes * earlier.outputs;
        let extrapolated = 2.0 * last.outputs - earlier.outputs
            + step_s.powi(2) * self.from_load * (self.base * earlier.force_n - self.elastic * modes);
        let difference = last.outputs - earlier.outputs;
        let damper = -step_s * self.from_load * earlier.overlap * self.to_modes * difference;
        let spring = step_s.powi(2) * self.from_load * (earlier.pull - earlier.overlap * modes);
        let count = self.settings.order + 1;
        let s_m = depth_m - self.segment as f64 * self.settings.segment_m;
        let mut regressor = DMatrix::zeros(2 * count, 2);
        let mut power = 1.0;
        for i in 0..count {
            for output in 0..2 {
                regressor[(i, output)] = damper[output] * power;
                regressor[(count + i, output)] = spring[output] * power;
            }
            power *= s_m;
        }
        let residual = DVector::from_column_slice((now.outputs - extrapolated).as_slice())
            - regressor.transpose() * &self.parameters;
        let covariance_regressor = &self.covariance * &regressor;
        let spread = regressor.transpose() * &covariance_regressor;
        let forgetting = match self.settings.forgetting {
            Forgetting::Constant(factor) => factor,
            Forgetting::Variable(kept) => {
                let information = residual.norm_squared() / (1.0 + spread.trace());
                (1.0 - information / kept).clamp(MIN_FORGETTING, 1.0)
            }
        };
        let Some(inverse) = (spread + DMatrix::identity(2, 2) * forgetting).try_inverse() else { return };
        let gain = &covariance_regressor * inverse;
        self.parameters += &gain * residual;
        self.covariance = (&self.covariance - &gain * covariance_regressor.transpose()) / forgetting;
    }
}

fn inverse(matrix: Matrix2<f64>) -> Result<Matrix2<f64>, ModelError> {
    matrix.try_inverse().ok_or(ModelError::Singular)
}

fn scaled_functions(x_m: f64, factors: &DMatrix<f64>, functions: &ShapeFunctions) -> Vector2<f64> {
    Vector2::from_column_slice((factors * functions.at(x_m)).as_slice())
}

impl Method for Published {
    fn update(&mut self, sample: &Sample<f64>) -> Option<Report> {
        let step_s = self.past.last().map(|last| sample.time_s - last.time_s);
        let raw = [sample.base_m, sample.tip_m, sample.force_n];
        let mut smooth = raw;
        for ((smooth, filter), raw) in smooth.iter_mut().zip(&mut self.filters).zip(raw) {
            *smooth = filter.step(raw, step_s, self.settings.filter_hz);
        }
        let [base_m, tip_m, force_n] = smooth;
        let start_m = *self.start_m.get_or_insert(base_m);
        let depth_m = sample.depth_m.max(self.last_depth_m);
        let step_m = depth_m - self.last_depth_m;
        let last_tip_m = self.past.last().map_or(0.0, |past| past.outputs[1]);
        self.pull.advance(step_m, 1.0, last_tip_m);
        let end = self.pull.end(step_m, 1.0);
        self.pull.close(&end, tip_m - start_m);
        self.overlap.advance(self.last_depth_m, depth_m, std::iter::once((step_m, 1.0)));
        self.last_depth_m = depth_m;
        let [damping, stiffness] = self.values(depth_m);
        let tip_then_m = self.model.advance(sample, stiffness, damping).ok()?;
        let overlap = &self.factors * self.overlap.matrix() * self.factors.transpose();
        let now = Past {
            time_s: sample.time_s,
            outputs: Vector2::new(base_m - start_m, tip_m - start_m),
            force_n,
            overlap: Matrix2::from_column_slice(overlap.as_slice()),
            pull: Vector2::from_column_slice((&self.factors * self.pull.sum()).as_slice()),
        };
        let segment = (depth_m / self.settings.segment_m) as usize;
        if segment > self.segment {
            // Go on with the values of the segment's end.
            let values = self.values(depth_m);
            self.segment = segment;
            self.parameters.fill(0.0);
            self.parameters[0] = values[0];
            self.parameters[self.settings.order + 1] = values[1];
            self.reset();
        }
        self.learn(&now, depth_m);
        self.past.push(now);
        if self.past.len() > 2 {
            self.past.remove(0);
        }
        let [damping, stiffness] = self.values(depth_m);
        Some(Report {
            depth_m,
            stiffness: Some(stiffness),
            stiffness_ci95: None,
            damping: Some(damping),
            damping_ci95: None,
            tip_m: tip_then_m,
        })
    }
}

/// Two first-order low passes in a row; all signals get the same.
#[derive(Debug, Clone, Copy, Default)]
struct LowPass {
    states: Option<[f64; 2]>,
}

impl LowPass {
    fn step(&mut self, value: f64, step_s: Option<f64>, corner_hz: f64) -> f64 {
        let (Some(states), Some(step_s)) = (&mut self.states, step_s) else {
            self.states = Some([value; 2]);
            return value;
        };
        let gain = 1.0 - (-std::f64::consts::TAU * corner_hz * step_s).exp();
        states[0] += gain * (value - states[0]);
        states[1] += gain * (states[0] - states[1]);
        states[1]
    }
}
