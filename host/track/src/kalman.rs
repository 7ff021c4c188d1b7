//! Comparators: an extended and an unscented Kalman filter on the needle's state and the logarithms of mean stiffness and damping.
//!
//! Three modes, the measured base force as input, implicit Euler steps (which let the stiff modes rest), base and tip measured, the path
//! cut by the estimated tip. Stiffness and damping are random walks in depth. (Written here and not taken from a crate: what fits
//! by size is tied to another release of the matrix library and to functions without surroundings; a filter step is
//! twenty lines.)

use super::method::{MeanModel, Method, Report};
use estimator::{Sample, field};
use mechanics::steering::history::{CutPathForce, ShapeFunctions, SupportMatrix};
use mechanics::steering::modes::{FreeMode, free_modes};
use mechanics::{Dynamics, ModelError, Needle};
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

const MODES: usize = 3;
/// Generalised coordinates.
const X: usize = 1 + MODES;
/// Coordinates, velocities, two logarithms.
const STATE: usize = 2 * X + 2;

type Vector = SVector<f64, STATE>;
type Square = SMatrix<f64, STATE, STATE>;
type Coordinates = SVector<f64, X>;
type Overlaps = SMatrix<f64, X, X>;

/// Choice of the filter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Jacobians.
    Extended,
    /// Sigma points.
    Unscented,
}

/// Start and noise of the filters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FilterConfig {
    /// Stiffness and damping at first.
    pub start: [f64; 2],
    /// Standard deviations of base, force and tip.
    pub base_sd_m: f64,
    /// Noise of the force.
    pub force_sd_n: f64,
    /// Noise of the tip.
    pub tip_sd_m: f64,
}

/// Standard deviation of the logarithms at first (a factor of a hundred is one of them), and of their walk over a metre.
const LOG_SD: f64 = 4.6;
const LOG_WALK: f64 = 3.0;
/// Range of stiffness and damping, the same as the other estimator's.
const RANGES: [[f64; 2]; 2] = [field::STIFFNESS_RANGE, [1.0, field::DAMPING_RANGE[1]]];

/// A logarithm of stiffness (0) or damping (1) within what is possible.
fn possible(which: usize, logarithm: f64) -> f64 {
    let [least, most] = RANGES[which].map(f64::ln);
    logarithm.clamp(least, most)
}

/// The filter.
#[derive(Debug, Clone)]
pub struct Kalman {
    kind: Kind,
    config: FilterConfig,
    mass: Overlaps,
    elastic: Overlaps,
    base: Coordinates,
    tip: Coordinates,
    factors: nalgebra::DMatrix<f64>,
    overlap: SupportMatrix,
    pull: CutPathForce,
    state: Vector,
    covariance: Square,
    last: Option<Sample<f64>>,
    start_m: f64,
    model: MeanModel,
}

/// Inserted part of the needle in one step.
struct Inserted {
    step_s: f64,
    force_n: f64,
    overlap: Overlaps,
    pull: Coordinates,
    /// Share of the new end of the path, times the tip.
    end: Coordinates,
}

impl Kalman {
    /// For a needle.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] for a needle that is none.
    pub fn new(
        kind: Kind,
        needle: &Needle,
        dynamics: &Dynamics,
        config: FilterConfig,
    ) -> Result<Self, ModelError> {
        let modes: Vec<FreeMode> = free_modes(&dynamics.clamped(needle), MODES)?;
        let functions = ShapeFunctions::of(&modes, dynamics.length_m);
        let factors = functions.factors(&modes);
        let mut mass = Overlaps::identity();
        mass[(0, 0)] = dynamics.moving_mass_kg();
        let mut elastic = Overlaps::zeros();
        for (i, mode) in modes.iter().enumerate() {
            elastic[(1 + i, 1 + i)] = mode.frequency_rad_s.powi(2);
        }
        let mut state = Vector::zeros();
        let mut covariance = Square::zeros();
        for i in 0..X {
            covariance[(i, i)] = config.base_sd_m.powi(2);
            covariance[(X + i, X + i)] = 1e-8;
        }
        for i in 0..2 {
            state[2 * X + i] = possible(i, config.start[i].ln());
            covariance[(2 * X + i, 2 * X + i)] = LOG_SD * LOG_SD;
        }
        Ok(Self {
            kind,
            config,
            mass,
            elastic,
            base: scaled_functions(0.0, &factors, &functions),
            tip: scaled_functions(dynamics.length_m, &factors, &functions),
            overlap: SupportMatrix::new(&functions),
            pull: CutPathForce::new(&functions),
            factors,
            state,
            covariance,
            last: None,
            start_m: 0.0,
            model: MeanModel::new(needle, dynamics, MODES)?,
        })
    }

    /// One implicit Euler step; and what it inverts.
    fn advance(&self, state: &Vector, inserted: &Inserted) -> Option<(Vector, Overlaps)> {
        let step_s = inserted.step_s;
        let [stiffness, damping] = [state[2 * X], state[2 * X + 1]].map(f64::exp);
        let position = state.fixed_rows::<X>(0).into_owned();
        let velocity = state.fixed_rows::<X>(X).into_owned();
        let springs =
            inserted.overlap * stiffness - inserted.end * self.tip.transpose() * stiffness + self.elastic;
        let matrix = self.mass + inserted.overlap * (damping * step_s) + springs * step_s.powi(2);
        let load = self.base * inserted.force_n + inserted.pull * stiffness - springs * position;
        let inverse = matrix.try_inverse()?;
        let next = inverse * (self.mass * velocity + load * step_s);
        let mut next_state = *state;
        next_state.fixed_rows_mut::<X>(0).copy_from(&(position + next * step_s));
        next_state.fixed_rows_mut::<X>(X).copy_from(&next);
        Some((next_state, inverse))
    }

    /// Derivatives of [`Kalman::advance`], by differentiating its equation.
    fn jacobian(&self, state: &Vector, after: &Vector, inverse: &Overlaps, inserted: &Inserted) -> Square {
        let step_s = inserted.step_s;
        let [stiffness, damping] = [state[2 * X], state[2 * X + 1]].map(f64::exp);
        let springs = inserted.overlap - inserted.end * self.tip.transpose();
        let position = after.fixed_rows::<X>(0).into_owned();
        let velocity = after.fixed_rows::<X>(X).into_owned();
        let by_position = -inverse * (springs * stiffness + self.elastic) * step_s;
        let by_velocity = inverse * self.mass;
        let by_stiffness = inverse * (inserted.pull - springs * position) * (stiffness * step_s);
        let by_damping = -inverse * inserted.overlap * velocity * (damping * step_s);
        let mut jacobian = Square::identity();
        let mut block = |column: usize, by: &dyn Fn(usize) -> f64, of_position: bool| {
            for i in 0..X {
                jacobian[(X + i, column)] = by(i);
                let identity_term = f64::from(u8::from(of_position && column == i));
                jacobian[(i, column)] = identity_term + step_s * by(i);
            }
        };
        for j in 0..X {
            block(j, &|i| by_position[(i, j)], true);
            block(X + j, &|i| by_velocity[(i, j)], false);
        }
        block(2 * X, &|i| by_stiffness[i], false);
        block(2 * X + 1, &|i| by_damping[i], false);
        jacobian
    }

    fn process_noise(&self, inserted: &Inserted, inverse: &Overlaps, step_m: f64) -> Square {
        let mut noise = Square::zeros();
        let kick = inverse * self.base * (inserted.step_s * self.config.force_sd_n);
        let mut input_direction = Vector::zeros();
        input_direction.fixed_rows_mut::<X>(0).copy_from(&(kick * inserted.step_s));
        input_direction.fixed_rows_mut::<X>(X).copy_from(&kick);
        noise += input_direction * input_direction.transpose();
        for i in 0..2 {
            noise[(2 * X + i, 2 * X + i)] += LOG_WALK.powi(2) * step_m;
        }
        // Errors by the omitted modes and by the path's trapezoid: a hundredth of a millimetre.
        for i in 0..X {
            noise[(X + i, X + i)] += 1e-12;
        }
        noise
    }

    fn outputs(&self, state: &Vector) -> Vector2<f64> {
        let position = state.fixed_rows::<X>(0).into_owned();
        Vector2::new(self.base.dot(&position), self.tip.dot(&position))
    }

    /// Derivatives of the outputs with respect to the state.
    fn output_rows(&self) -> SMatrix<f64, 2, STATE> {
        let mut rows = SMatrix::<f64, 2, STATE>::zeros();
        for i in 0..X {
            rows[(0, i)] = self.base[i];
            rows[(1, i)] = self.tip[i];
        }
        rows
    }

    fn extended(
        &mut self,
        inserted: &Inserted,
        step_m: f64,
        measured: Vector2<f64>,
        noise: Matrix2<f64>,
    ) -> Option<()> {
        let (predicted_state, inverse) = self.advance(&self.state, inserted)?;
        let jacobian = self.jacobian(&self.state, &predicted_state, &inverse, inserted);
        let covariance = jacobian * self.covariance * jacobian.transpose()
            + self.process_noise(inserted, &inverse, step_m);
        let rows = self.output_rows();
        let spread = rows * covariance * rows.transpose() + noise;
        let gain = covariance * rows.transpose() * spread.try_inverse()?;
        self.state = predicted_state + gain * (measured - self.outputs(&predicted_state));
        // Joseph's form: stays positive.
        let keep = Square::identity() - gain * rows;
        self.covariance = keep * covariance * keep.transpose() + gain * noise * gain.transpose();
        Some(())
    }

    fn unscented(
        &mut self,
        inserted: &Inserted,
        step_m: f64,
        measured: Vector2<f64>,
        noise: Matrix2<f64>,
    ) -> Option<()> {
        const POINTS: usize = 2 * STATE + 1;
        // Scaled sigma points: spread 0.5, no third moment, centre weighted for a normal distribution.
        let (alpha, beta) = (0.5_f64, 2.0);
        let size = STATE as f64;
        let lambda = alpha * alpha * size - size;
        let root = (self.covariance * (size + lambda)).cholesky()?.l();
        let mut points = [self.state; POINTS];
        for i in 0..STATE {
            points[1 + i] += root.column(i);
            points[1 + STATE + i] -= root.column(i);
        }
        let (_, inverse) = self.advance(&self.state, inserted)?;
        for point in &mut points {
            for i in 0..2 {
                point[2 * X + i] = possible(i, point[2 * X + i]);
            }
            *point = self.advance(point, inserted)?.0;
        }
        let side = 0.5 / (size + lambda);
        let mean: Vector =
            points.iter().enumerate().map(|(i, point)| point * sigma_weight(i, lambda, size, side)).sum();
        let outputs = points.map(|point| self.outputs(&point));
        let expected: Vector2<f64> =
            outputs.iter().enumerate().map(|(i, output)| output * sigma_weight(i, lambda, size, side)).sum();
        let mut covariance = self.process_noise(inserted, &inverse, step_m);
        let mut spread = noise;
        let mut cross = SMatrix::<f64, STATE, 2>::zeros();
        for (i, (point, output)) in points.iter().zip(&outputs).enumerate() {
            let (state_deviation, output_off) = (point - mean, output - expected);
            covariance += state_deviation
                * state_deviation.transpose()
                * covariance_weight(i, alpha, beta, lambda, size, side);
            spread +=
                output_off * output_off.transpose() * covariance_weight(i, alpha, beta, lambda, size, side);
            cross += state_deviation
                * output_off.transpose()
                * covariance_weight(i, alpha, beta, lambda, size, side);
        }
        // The process noise is in the outputs too.
        let rows = self.output_rows();
        let process = self.process_noise(inserted, &inverse, step_m);
        spread += rows * process * rows.transpose();
        cross += process * rows.transpose();
        let gain = cross * spread.try_inverse()?;
        self.state = mean + gain * (measured - expected);
        covariance -= gain * spread * gain.transpose();
        self.covariance = (covariance + covariance.transpose()) * 0.5;
        Some(())
    }
}

fn covariance_weight(i: usize, alpha: f64, beta: f64, lambda: f64, size: f64, side: f64) -> f64 {
    sigma_weight(i, lambda, size, side) + if i == 0 { 1.0 - alpha * alpha + beta } else { 0.0 }
}

fn sigma_weight(i: usize, lambda: f64, size: f64, side: f64) -> f64 {
    if i == 0 { lambda / (size + lambda) } else { side }
}

fn scaled_functions(x_m: f64, factors: &nalgebra::DMatrix<f64>, functions: &ShapeFunctions) -> Coordinates {
    Coordinates::from_column_slice((factors * functions.at(x_m)).as_slice())
}

impl Method for Kalman {
    fn update(&mut self, sample: &Sample<f64>) -> Option<Report> {
        let Some(last) = self.last.replace(*sample) else {
            self.start_m = sample.base_m;
            self.model.advance(sample, 0.0, 0.0).ok()?;
            return None;
        };
        let depth_m = sample.depth_m.max(last.depth_m);
        if let Some(now) = &mut self.last {
            now.depth_m = depth_m;
        }
        let step_m = depth_m - last.depth_m;
        let [stiffness, damping] = [self.state[2 * X], self.state[2 * X + 1]].map(f64::exp);
        let tip_m = self.model.advance(sample, stiffness, damping).ok()?;
        self.pull.advance(step_m, 1.0, self.outputs(&self.state)[1]);
        let end = self.pull.end(step_m, 1.0);
        self.overlap.advance(last.depth_m, depth_m, std::iter::once((step_m, 1.0)));
        let overlap = &self.factors * self.overlap.matrix() * self.factors.transpose();
        let vector = |values: nalgebra::DVector<f64>| {
            Coordinates::from_column_slice((&self.factors * values).as_slice())
        };
        let inserted = Inserted {
            step_s: sample.time_s - last.time_s,
            force_n: sample.force_n,
            overlap: Overlaps::from_column_slice(overlap.as_slice()),
            pull: vector(self.pull.sum().clone()),
            end: vector(end.clone()),
        };
        let measured = Vector2::new(sample.base_m - self.start_m, sample.tip_m - self.start_m);
        let noise = Matrix2::from_diagonal(&Vector2::new(
            self.config.base_sd_m.powi(2),
            self.config.tip_sd_m.powi(2),
        ));
        match self.kind {
            Kind::Extended => self.extended(&inserted, step_m, measured, noise)?,
            Kind::Unscented => self.unscented(&inserted, step_m, measured, noise)?,
        }
        for i in 0..2 {
            self.state[2 * X + i] = possible(i, self.state[2 * X + i]);
        }
        self.pull.close(&end, self.outputs(&self.state)[1]);
        let value = |i: usize| {
            let log_sd = self.covariance[(2 * X + i, 2 * X + i)].max(0.0).sqrt();
            let value = self.state[2 * X + i].exp();
            let factor = (1.96 * log_sd).min(30.0).exp();
            (value, [value / factor, value * factor])
        };
        let ((stiffness, stiffness_ci95), (damping, damping_ci95)) = (value(0), value(1));
        Some(Report {
            depth_m,
            stiffness: Some(stiffness),
            stiffness_ci95: Some(stiffness_ci95),
            damping: Some(damping),
            damping_ci95: Some(damping_ci95),
            tip_m,
        })
    }
}
