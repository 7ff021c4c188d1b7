//! Judgement of a law by held-out runs: whether it makes their misfit smaller beyond chance.
//!
//! Two models fitted to the other runs predict the held-out ones: whole runs, and one reading ahead, which knows the residuals of earlier readings as
//! far as the memory of the model's own noise goes (Dawid, "Present position and potential developments: the prequential approach", J. R. Stat.
//! Soc. A 147:278, 1984). A simulated level that has drifted off stays there: of the errors of whole runs a thousand readings may be worth five,
//! while a constant shows in them and not in a single step. A better model has both errors smaller, and one of them beyond chance; of two tests
//! the smaller p-value counts twice (Bonferroni).
//!
//! The differences of squared errors have a mean, and a variance of the mean. What is left of a correlation in time is counted: the number of
//! independent readings follows from the autocorrelation of the differences themselves (Geyer, "Practical Markov chain Monte Carlo", Stat. Sci.
//! 7:473, 1992), and Student's t over that number decides (Vuong, Econometrica 57:307, 1989).

use super::bench::{Bench, Prepared};
use super::fit::Fitted;
use super::model::Error;
use super::noise::one_ahead;
use super::weights::STATED_PROBABILITY;
use nalgebra::DVector;
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Judgement of one model beside another by held-out runs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Judgement {
    /// By which fraction of the other's squared error in whole runs the model's is smaller; negative where it is larger.
    pub gain: f64,
    /// Standard deviation of that by chance.
    pub gain_sd: f64,
    /// The same of predictions one reading ahead.
    pub gain_one_ahead: f64,
    /// Number of independent readings that the held-out runs are worth, in the test that decides.
    pub effective_readings: f64,
    /// Probability of such gains by chance where the model is no better.
    pub p: f64,
}

impl Judgement {
    /// Whether the model predicts whole runs and single readings better, one of them beyond chance.
    pub fn is_confirmed(&self) -> bool {
        self.p < 1.0 - STATED_PROBABILITY && self.gain > 0.0 && self.gain_one_ahead > 0.0
    }
}

/// Residuals of the held-out runs; nothing where the model cannot predict one.
pub(crate) fn held_out_residuals(
    bench: &Bench<'_>,
    fitted: &Fitted,
) -> Result<Option<Vec<DVector<f64>>>, Error> {
    let terms = bench.terms(&fitted.laws, &fitted.values);
    match bench.residuals_of(&bench.held_out, &fitted.values, &terms) {
        Ok(residuals) => Ok(Some(residuals)),
        Err(error) if error.is_of_these_values() => Ok(None),
        Err(error) => Err(error),
    }
}

/// Squared errors in held-out runs, one series per run and channel, in units of the channels' scales.
pub(crate) struct Losses {
    whole: Vec<Vec<f64>>,
    one_ahead: Vec<Vec<f64>>,
}

/// Losses of a model; nothing where no run judges or the model cannot predict one.
pub(crate) fn losses(bench: &Bench<'_>, fitted: &Fitted) -> Result<Option<Losses>, Error> {
    if bench.held_out.is_empty() {
        return Ok(None);
    }
    let Some(residuals) = held_out_residuals(bench, fitted)? else { return Ok(None) };
    let mut new = residuals.clone();
    for (prepared, residuals) in bench.held_out.iter().zip(&mut new) {
        one_ahead(&prepared.segments, &fitted.noises, residuals);
    }
    Ok(Some(Losses { whole: squares(bench, &residuals), one_ahead: squares(bench, &new) }))
}

fn squares(bench: &Bench<'_>, residuals: &[DVector<f64>]) -> Vec<Vec<f64>> {
    let of_run = |(prepared, residuals): (&Prepared<'_>, &DVector<f64>)| {
        let of_channel = |channel: usize| {
            let rows = prepared.rows_of(channel);
            residuals.rows(rows.start, rows.len()).iter().map(|value| value * value).collect::<Vec<f64>>()
        };
        (0..bench.scales.len()).map(of_channel).collect::<Vec<_>>()
    };
    bench.held_out.iter().zip(residuals).flat_map(of_run).collect()
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

/// Difference of two models' losses.
struct Comparison {
    gain: f64,
    gain_sd: f64,
    effective_readings: f64,
    p: f64,
}

/// Compares one model with another, channel by channel in units of the errors of the better one.
fn compare(other: &[Vec<f64>], model: &[Vec<f64>]) -> Comparison {
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
    Comparison { gain: sum / total, gain_sd: variance.sqrt() / total, effective_readings: effective, p }
}

/// Judges one model by the losses of another.
pub(crate) fn judge(other: &Losses, model: &Losses) -> Judgement {
    let whole = compare(&other.whole, &model.whole);
    let one_ahead = compare(&other.one_ahead, &model.one_ahead);
    let deciding = if whole.p < one_ahead.p { &whole } else { &one_ahead };
    Judgement {
        gain: whole.gain,
        gain_sd: whole.gain_sd,
        gain_one_ahead: one_ahead.gain,
        effective_readings: deciding.effective_readings,
        p: (2.0 * deciding.p).min(1.0),
    }
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
            confirmed += u32::from(compare(&first, &second).p < 1.0 - STATED_PROBABILITY);
        }
        assert!((4..=40).contains(&confirmed), "{confirmed} of 400");
    }
}
