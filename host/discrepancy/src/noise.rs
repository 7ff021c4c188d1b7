//! Noise of a channel: white, and correlated in time.
//!
//! Readings are `y_i = f_i + x(t_i) + e_i` with independent `e_i` of variance `(1 - c) s^2 w_i^2` and a stationary process x of variance
//! `c s^2` whose correlation falls as `exp(-|t| / m)`. Scale s, fraction c and memory m of every channel maximize the evidence,
//! so that intervals have their coverage with autocorrelated residuals too. A Kalman filter whitens the readings; its work is
//! linear in their number, at any spacing (Kalman, 1960).

use argmin::core::{CostFunction, Executor, State};
use argmin::solver::neldermead::NelderMead;
use nalgebra::{DMatrix, DVector};

/// Largest number of iterations of the search per channel, and the standard deviation of the objective over the simplex at which it
/// ends: a hundredth of log evidence changes no result.
const MAX_STEPS: u64 = 60;
const MIN_DIFFERENCE: f64 = 0.01;
/// Standard deviation of the prior of the log odds of c: with 95 % probability c is between 0.7 and 99.3 %.
const ODDS_SD: f64 = 2.5;

/// Readings of one channel of a run, or means over blocks of them.
#[derive(Debug, Clone)]
pub struct Segment {
    /// Number of the channel.
    pub channel: usize,
    /// Instants.
    pub time_s: Vec<f64>,
    /// Relative standard deviations.
    pub weights: Vec<f64>,
}

/// Noise of one channel, in the unit of the residuals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Standard deviation of a reading.
    pub sd: f64,
    /// Fraction of the variance that is correlated.
    pub correlated: f64,
    /// Time after which the correlation is 1/e.
    pub memory_s: f64,
}

impl Noise {
    /// The same noise without correlation.
    pub fn white(self) -> Self {
        Self { correlated: 0.0, ..self }
    }
}

/// Update of the Kalman filter at one reading: the decay of the correlated noise since the previous reading, the gain, and the standard
/// deviation of the innovation.
struct Update {
    decay: f64,
    gain: f64,
    sd: f64,
}

fn updates(segment: &Segment, noise: &Noise) -> Vec<Update> {
    let stationary = noise.correlated * noise.sd * noise.sd;
    let white = (1.0 - noise.correlated) * noise.sd * noise.sd;
    let (mut variance, mut previous_time) = (stationary, None::<f64>);
    let updates = segment.time_s.iter().zip(&segment.weights).map(|(time, weight)| {
        let decay =
            previous_time.map_or(0.0, |previous_time| (-(time - previous_time) / noise.memory_s).exp());
        previous_time = Some(*time);
        variance = decay * decay * variance + stationary * (1.0 - decay * decay);
        let total = (variance + white * weight * weight).max(f64::MIN_POSITIVE);
        let gain = variance / total;
        variance -= gain * variance;
        Update { decay, gain, sd: total.sqrt() }
    });
    updates.collect()
}

/// Replaces values by their innovations: each value less its expectation given the earlier ones.
fn innovate<'a>(values: impl Iterator<Item = &'a mut f64>, updates: &[Update]) {
    let mut mean = 0.0;
    for (value, Update { decay, gain, .. }) in values.zip(updates) {
        mean *= decay;
        *value -= mean;
        mean += gain * *value;
    }
}

/// Whitens columns of a run in place: their noise becomes independent and of unit variance. Returns the sum of the logarithms of the
/// standard deviations by which the innovations were divided.
pub fn whiten(segments: &[Segment], noises: &[Noise], columns: &mut DMatrix<f64>) -> f64 {
    let mut ln_sds = 0.0;
    let mut start = 0;
    for segment in segments {
        let Some(noise) = noises.get(segment.channel) else { continue };
        let updates = updates(segment, noise);
        ln_sds += updates.iter().map(|update| update.sd.ln()).sum::<f64>();
        for mut column in columns.column_iter_mut() {
            let mut rows = column.rows_mut(start, updates.len());
            innovate(rows.iter_mut(), &updates);
            rows.iter_mut().zip(&updates).for_each(|(value, update)| *value /= update.sd);
        }
        start += updates.len();
    }
    ln_sds
}

/// Errors of predictions one reading ahead, given the residuals of earlier readings, in the unit of the residuals.
pub fn one_ahead(segments: &[Segment], noises: &[Noise], residuals: &mut DVector<f64>) {
    let mut start = 0;
    for segment in segments {
        let Some(noise) = noises.get(segment.channel) else { continue };
        let updates = updates(segment, noise);
        innovate(residuals.rows_mut(start, updates.len()).iter_mut(), &updates);
        start += updates.len();
    }
}

/// The noise as unbounded coordinates.
fn coordinates(noise: &Noise) -> [f64; 3] {
    let correlated = noise.correlated.clamp(1e-4, 1.0 - 1e-4);
    [noise.sd.ln(), (correlated / (1.0 - correlated)).ln(), noise.memory_s.ln()]
}

fn from_coordinates(x: &[f64], memories_s: [f64; 2]) -> Noise {
    let [ln_sd, logit_correlated, ln_memory] = [0, 1, 2].map(|i| x.get(i).copied().unwrap_or(0.0));
    Noise {
        sd: ln_sd.clamp(-40.0, 40.0).exp(),
        correlated: 1.0 / (1.0 + (-logit_correlated).exp()),
        memory_s: ln_memory.exp().clamp(memories_s[0], memories_s[1]),
    }
}

struct Cost<'a, F> {
    minus_ln: F,
    memories_s: &'a [[f64; 2]],
}

impl<F: Fn(&[Noise]) -> Option<f64>> CostFunction for Cost<'_, F> {
    type Param = Vec<f64>;
    type Output = f64;

    fn cost(&self, x: &Vec<f64>) -> Result<f64, argmin::core::Error> {
        let noises: Vec<Noise> =
            x.chunks(3).zip(self.memories_s).map(|(x, memories)| from_coordinates(x, *memories)).collect();
        // A quadratic penalty on the memory outside its range, because the likelihood is constant there; and the prior of the correlated
        // fraction.
        let priors: f64 = x
            .chunks(3)
            .zip(&noises)
            .map(|(x, noise)| {
                let memory = x.get(2).map_or(0.0, |ln| ln - noise.memory_s.ln());
                let odds = x.get(1).map_or(0.0, |odds| odds / ODDS_SD);
                0.5 * (memory * memory + odds * odds)
            })
            .sum();
        Ok((self.minus_ln)(&noises).map_or(1e12, |value| value + priors))
    }
}

/// Noise parameters that maximize a log evidence, given as its negative, from a start; memories stay in their ranges.
pub fn likeliest(
    start: &[Noise],
    memories_s: &[[f64; 2]],
    minus_ln: impl Fn(&[Noise]) -> Option<f64>,
) -> Vec<Noise> {
    let first: Vec<f64> = start.iter().flat_map(coordinates).collect();
    let mut simplex = vec![first.clone()];
    for (i, step) in [0.3, 0.7, 0.7].iter().cycle().take(first.len()).enumerate() {
        let mut corner = first.clone();
        if let Some(value) = corner.get_mut(i) {
            *value += step;
        }
        simplex.push(corner);
    }
    let cost = Cost { minus_ln, memories_s };
    let start_cost = cost.cost(&first).unwrap_or(f64::INFINITY);
    let solver = NelderMead::new(simplex).with_sd_tolerance(MIN_DIFFERENCE);
    let run = solver.and_then(|solver| {
        Executor::new(cost, solver).configure(|state| state.max_iters(MAX_STEPS * start.len() as u64)).run()
    });
    let Ok(run) = run else { return start.to_vec() };
    let state = run.state();
    match state.get_best_param() {
        Some(best) if state.get_best_cost() <= start_cost => {
            best.chunks(3).zip(memories_s).map(|(x, memories)| from_coordinates(x, *memories)).collect()
        }
        _ => start.to_vec(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn segment() -> Segment {
        let time_s = vec![0.0, 0.1, 0.25, 0.3, 0.7, 0.75, 1.2];
        Segment { channel: 0, weights: vec![1.0, 1.0, 2.0, 1.0, 0.5, 1.0, 1.0], time_s }
    }

    /// The whitening is compared with the dense covariance.
    #[test]
    fn whitening_inverts_the_covariance() {
        let (segment, noise) = (segment(), Noise { sd: 0.7, correlated: 0.6, memory_s: 0.3 });
        let count = segment.time_s.len();
        let variance = noise.sd * noise.sd;
        let covariance = DMatrix::from_fn(count, count, |i, j| {
            let distance: f64 = segment.time_s[i] - segment.time_s[j];
            let coloured = noise.correlated * variance * (-distance.abs() / noise.memory_s).exp();
            let white = (1.0 - noise.correlated) * variance * segment.weights[i].powi(2);
            coloured + if i == j { white } else { 0.0 }
        });
        let mut columns = DMatrix::identity(count, count);
        let ln_sds = whiten(std::slice::from_ref(&segment), &[noise], &mut columns);
        let expected = covariance.clone().try_inverse().expect("regular");
        assert!((columns.tr_mul(&columns) - expected).norm() < 1e-10);
        assert!((ln_sds - 0.5 * covariance.determinant().ln()).abs() < 1e-10);
    }
}
