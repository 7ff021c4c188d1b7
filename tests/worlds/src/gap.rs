//! Distance of the measurements from those of a simpler truth, by the generator alone: no noise, no forward model.

use super::design::{Design, NoisePlan};
use super::sensors::{CORRELATED_FORCE, CORRELATED_SHAPE, SAMPLE_SPACING_M};
use super::{Background, MM, Truth, session_on};
use formats::session::Session;
use nalgebra::{DMatrix, DVector};

/// Gauss-Newton steps of modulus and tip load, their largest change, and the difference of a derivative.
const STEPS: usize = 6;
const MAX_CHANGE: f64 = 0.5;
const DIFFERENCE: f64 = 1e-3;
const STILL: f64 = 1e-5;

/// Distance of two noiseless sessions in units of the noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Misfit {
    /// Chi-square that is to be expected above that of the noise; readings with correlated errors count less.
    pub chi2: f64,
    /// The same per reading, as if errors were independent.
    pub per_reading: f64,
}

/// Misfit of a session of `truth` on a background to a model that is `model` but for modulus and tip load, which adapt.
pub fn misfit(truth: &Truth, background: &Background, model: &Truth, design: &Design) -> Misfit {
    let quiet = Design { noise: design.noise.none(), ..design.clone() };
    let measured = session_on(truth, background, &quiet, 1);
    let no_background = Background::default();
    let predict = |[modulus, load]: [f64; 2]| {
        let model =
            Truth { k_kpa: model.k_kpa * modulus, tip_load_n: model.tip_load_n * load, ..model.clone() };
        session_on(&model, &no_background, &quiet, 1)
    };
    misfit_of(&measured, &predict, &design.noise)
}

/// The same of any noiseless session and a model of such sessions with factors of modulus and tip load.
pub fn misfit_of(measured: &Session, model: &dyn Fn([f64; 2]) -> Session, noise: &NoisePlan) -> Misfit {
    let weights = [1.0, 0.0].map(|correlated| Weights::new(noise, correlated));
    let parameters = 1 + usize::from(!measured.insertion.is_empty());
    let predict = |values: &[f64]| model([factor_of(0, values), factor_of(1, values)]);
    let off = |values: &[f64]| weights[0].residuals(measured, &predict(values));
    let mut values = vec![0.0; parameters];
    let mut residuals = off(&values);
    for _ in 0..STEPS {
        let mut slopes = DMatrix::zeros(residuals.len(), parameters);
        for column in 0..parameters {
            let mut moved = values.clone();
            moved[column] += DIFFERENCE;
            slopes.set_column(column, &((off(&moved) - &residuals) / DIFFERENCE));
        }
        let normal = slopes.tr_mul(&slopes);
        let Some(step) = normal.cholesky().map(|factor| factor.solve(&slopes.tr_mul(&residuals))) else {
            break;
        };
        let step: Vec<f64> = step.iter().map(|step| step.clamp(-MAX_CHANGE, MAX_CHANGE)).collect();
        let trial: Vec<f64> = values.iter().zip(&step).map(|(value, step)| value - step).collect();
        let trial_misfit = off(&trial);
        if trial_misfit.norm_squared() > residuals.norm_squared() {
            break;
        }
        (values, residuals) = (trial, trial_misfit);
        if step.iter().all(|step| step.abs() < STILL) {
            break;
        }
    }
    let white = weights[1].residuals(measured, &predict(&values));
    Misfit { chi2: residuals.norm_squared(), per_reading: white.norm_squared() / white.len().max(1) as f64 }
}

fn factor_of(number: usize, values: &[f64]) -> f64 {
    values.get(number).map_or(1.0, |value| value.exp())
}

/// Reciprocal standard deviations of the channels.
struct Weights {
    per_n: f64,
    per_shape_m: f64,
    per_tip_m: f64,
}

impl Weights {
    /// `correlated`: 1 to count readings with correlated errors for as many as they are worth where the signal is smooth, 0 not to.
    fn new(noise: &NoisePlan, correlated: f64) -> Self {
        let force =
            worth_of_reading(CORRELATED_FORCE, 1.0 / noise.rate_hz, noise.force_correlation_s, correlated)
                .sqrt();
        let shape =
            worth_of_reading(CORRELATED_SHAPE, SAMPLE_SPACING_M / MM, noise.shape_correlation_mm, correlated)
                .sqrt();
        Self {
            per_n: 1.0 / (with_rounding(noise.force_n, noise.force_step_n) * force),
            per_shape_m: 1.0 / (MM * with_rounding(noise.shape_mm, noise.pixel_mm) * shape),
            per_tip_m: 1.0 / (MM * noise.tip_mm).max(f64::MIN_POSITIVE),
        }
    }

    fn residuals(&self, a: &Session, b: &Session) -> DVector<f64> {
        let mut residuals = Vec::new();
        for (a, b) in a.lateral.iter().zip(&b.lateral) {
            add_differences(&a.force.force_y_n, &b.force.force_y_n, self.per_n, &mut residuals);
            add_differences(maybe(&a.force.force_x_n), maybe(&b.force.force_x_n), self.per_n, &mut residuals);
            add_differences(&a.shape.y_m, &b.shape.y_m, self.per_shape_m, &mut residuals);
            add_differences(maybe(&a.shape.x_m), maybe(&b.shape.x_m), self.per_shape_m, &mut residuals);
        }
        for (a, b) in a.insertion.iter().zip(&b.insertion) {
            add_differences(&a.tip_y_m, &b.tip_y_m, self.per_tip_m, &mut residuals);
            add_differences(maybe(&a.tip_x_m), maybe(&b.tip_x_m), self.per_tip_m, &mut residuals);
        }
        DVector::from_vec(residuals)
    }
}

fn add_differences(a: &[f64], b: &[f64], weight: f64, residuals: &mut Vec<f64>) {
    residuals.extend(a.iter().zip(b).map(|(a, b)| (a - b) * weight));
}

fn with_rounding(sd: f64, step: f64) -> f64 {
    sd.hypot(step / 12f64.sqrt()).max(f64::MIN_POSITIVE)
}

fn worth_of_reading(share: f64, spacing: f64, length: f64, correlated: f64) -> f64 {
    let neighbours = if length > 0.0 { (-spacing / length).exp() } else { 0.0 };
    1.0 + 2.0 * correlated * share * neighbours / (1.0 - neighbours)
}

fn maybe(values: &Option<Vec<f64>>) -> &[f64] {
    values.as_deref().unwrap_or_default()
}
