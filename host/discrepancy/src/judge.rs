//! Judgement of a law by held-out runs: whether it makes their misfit smaller beyond chance.
//!
//! Two models fitted to the other runs predict the held-out ones; the differences of their squared errors have a mean, and a variance of the
//! mean. Errors of such rigs are correlated in time, so that a thousand readings may be worth twenty: the number of independent ones follows from
//! the autocorrelation of the differences themselves (Geyer, "Practical Markov chain Monte Carlo", Stat. Sci. 7:473, 1992), and Student's t
//! over that number decides (Vuong, Econometrica 57:307, 1989).

use super::bench::Bench;
use super::fit::Fitted;
use super::model::Error;
use super::weights::STATED_PROBABILITY;
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Judgement of one model beside another by held-out runs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Judgement {
    /// By which fraction of the other's squared error the model's is smaller; negative where it is larger.
    pub gain: f64,
    /// Standard deviation of that by chance.
    pub gain_sd: f64,
    /// Number of independent readings that the held-out runs are worth.
    pub effective_readings: f64,
    /// Probability of such a gain by chance where the model is no better.
    pub p: f64,
}

impl Judgement {
    /// Whether the model predicts better, beyond chance.
    pub fn is_confirmed(&self) -> bool {
        self.p < 1.0 - STATED_PROBABILITY
    }
}

/// Residuals of the held-out runs; nothing where the model cannot predict one.
pub(crate) fn held_out_residuals(
    bench: &Bench<'_>,
    fitted: &Fitted,
) -> Result<Option<Vec<nalgebra::DVector<f64>>>, Error> {
    let terms = bench.terms(&fitted.laws, &fitted.values);
    match bench.residuals_of(&bench.held_out, &fitted.values, &terms) {
        Ok(residuals) => Ok(Some(residuals)),
        Err(error) if error.is_of_these_values() => Ok(None),
        Err(error) => Err(error),
    }
}

/// Squared errors in held-out runs, one series per run and channel, in units of the channels' noises; nothing where no run judges or the
/// model cannot predict one.
pub(crate) fn losses(bench: &Bench<'_>, fitted: &Fitted) -> Result<Option<Vec<Vec<f64>>>, Error> {
    if bench.held_out.is_empty() {
        return Ok(None);
    }
    let Some(residuals) = held_out_residuals(bench, fitted)? else { return Ok(None) };
    let of_run = |(prepared, residuals): (&super::bench::Prepared<'_>, &nalgebra::DVector<f64>)| {
        let of_channel = |channel: usize| {
            let rows = prepared.rows_of(channel);
            residuals.rows(rows.start, rows.len()).iter().map(|value| value * value).collect::<Vec<f64>>()
        };
        (0..bench.scales.len()).map(of_channel).collect::<Vec<_>>()
    };
    Ok(Some(bench.held_out.iter().zip(&residuals).flat_map(of_run).collect()))
}

/// Sum of a series over all readings, variance of that sum, and number of independent readings.
fn moments(series: &[f64]) -> (f64, f64, f64) {
    let count = series.len() as f64;
    let sum: f64 = series.iter().sum();
    let mean = sum / count.max(1.0);
    let covariance = |lag: usize| {
        let pairs = series.iter().zip(series.iter().skip(lag));
        pairs.map(|(a, b)| (a - mean) * (b - mean)).sum::<f64>() / count
    };
    let variance = covariance(0);
    if variance <= 0.0 {
        return (sum, 0.0, count);
    }
    // Sums of neighbouring lags are positive for a stationary series and fall; noise of the estimate ends them.
    let (mut inflation, mut previous_pair, mut lag) = (-1.0, f64::INFINITY, 0);
    while lag + 1 < series.len() {
        let pair = ((covariance(lag) + covariance(lag + 1)) / variance).min(previous_pair);
        if pair <= 0.0 {
            break;
        }
        (inflation, previous_pair) = (inflation + 2.0 * pair, pair);
        lag += 2;
    }
    let inflation = inflation.max(1.0);
    (sum, count * variance * inflation, count / inflation)
}

/// Judges one model by the losses of another, channel by channel in units of the errors of the better one.
pub(crate) fn judge(other: &[Vec<f64>], model: &[Vec<f64>]) -> Judgement {
    let (mut sum, mut variance, mut effective, mut total) = (0.0, 0.0, 0.0, 0.0);
    for (other, model) in other.iter().zip(model) {
        let scale = model.iter().sum::<f64>().min(other.iter().sum()) / model.len().max(1) as f64;
        let unit = scale.max(f64::MIN_POSITIVE).recip();
        let differences: Vec<f64> = other.iter().zip(model).map(|(a, b)| unit * (a - b)).collect();
        let (of_series, of_variance, of_effective) = moments(&differences);
        (sum, variance, effective) = (sum + of_series, variance + of_variance, effective + of_effective);
        total += unit * other.iter().sum::<f64>();
    }
    let p = match StudentsT::new(0.0, 1.0, effective - 1.0) {
        Ok(student) if variance > 0.0 => student.sf(sum / variance.sqrt()),
        _ => 1.0,
    };
    let total = total.max(f64::MIN_POSITIVE);
    Judgement { gain: sum / total, gain_sd: variance.sqrt() / total, effective_readings: effective, p }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    /// A series whose neighbours have this correlation.
    fn series(rng: &mut ChaCha8Rng, count: usize, correlation: f64) -> Vec<f64> {
        let mut value: f64 = StandardNormal.sample(rng);
        let innovation = (1.0 - correlation * correlation).sqrt();
        let mut next = || {
            let drawn: f64 = StandardNormal.sample(rng);
            value = correlation * value + innovation * drawn;
            value
        };
        (0..count).map(|_| next()).collect()
    }

    #[test]
    fn correlated_readings_are_worth_fewer_independent_ones() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let (_, _, white) = moments(&series(&mut rng, 4000, 0.0));
        let (_, _, coloured) = moments(&series(&mut rng, 4000, 0.9));
        // A first-order process has n (1 - r) / (1 + r).
        assert!(white > 3300.0 && (120.0..340.0).contains(&coloured), "{white} {coloured}");
    }

    /// A model that is no better is confirmed in about five of a hundred.
    #[test]
    fn equal_models_are_confirmed_as_rarely_as_stated() {
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        let mut confirmed = 0;
        for _ in 0..400 {
            let squares =
                |series: Vec<f64>| vec![series.iter().map(|value| value * value).collect::<Vec<f64>>()];
            let [first, second] = [(); 2].map(|()| squares(series(&mut rng, 500, 0.95)));
            confirmed += u32::from(judge(&first, &second).is_confirmed());
        }
        assert!((4..=40).contains(&confirmed), "{confirmed} of 400");
    }
}
