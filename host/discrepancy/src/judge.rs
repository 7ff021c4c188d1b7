//! Test of a law on held-out runs: whether it reduces their misfit significantly.
//!
//! Two models that were fitted to the other runs predict the held-out runs in two ways: as whole runs, and one reading ahead, given
//! the residuals of the earlier readings and the correlation of the model's noise (Dawid, "Present position and potential
//! developments: the prequential approach", J. R. Stat. Soc. A 147:278, 1984). Both are needed. The errors of whole runs are
//! strongly correlated, so that a thousand readings may be worth five independent ones; but a constant shows in whole runs only,
//! not one reading ahead. A better model has smaller errors of both kinds, one of them significantly smaller; the smaller of the
//! two p-values is doubled (Bonferroni).
//!
//! The difference of the squared errors is a sum over readings of twice the difference of the two predictions, which is known,
//! times the mean of the two errors, which is random. Its autocovariance is estimated by that of the model's own errors over whole
//! runs, up to the first pair of lags whose sum is not positive (Geyer, "Practical Markov chain Monte Carlo", Stat. Sci. 7:473,
//! 1992). The model's own errors are noise alone if the model is right, and contain half of the difference of the two models if
//! both are equally far from the truth.
//! Student's t test, with the effective number of independent readings, decides whether the difference is significant (Vuong,
//! Econometrica 57:307, 1989). With the variance of the differences themselves, a law that acts twice in a run would count as
//! two readings, however many readings confirm it.

use super::bench::Bench;
use super::fit::Fitted;
use super::model::Error;
use super::noise::one_ahead;
use super::weights::STATED_PROBABILITY;
use nalgebra::DVector;
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Comparison of a model with another one on held-out runs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Judgement {
    /// Relative reduction of the squared error of whole runs, compared with the other model; negative for an increase.
    pub gain: f64,
    /// Standard deviation of `gain`.
    pub gain_sd: f64,
    /// The relative reduction for predictions one reading ahead.
    pub gain_one_ahead: f64,
    /// Effective number of independent readings in the held-out runs, in the decisive test.
    pub effective_readings: f64,
    /// p-value of the reductions under the hypothesis that the model is no better.
    pub p: f64,
}

impl Judgement {
    /// Whether the model predicts whole runs and single readings better, one of them significantly.
    pub fn is_confirmed(&self) -> bool {
        self.p < 1.0 - STATED_PROBABILITY && self.gain > 0.0 && self.gain_one_ahead > 0.0
    }
}

/// Residuals of the held-out runs; `None` if the model has no prediction of a run.
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

/// Errors in held-out runs, one series per run and channel, in units of the channels' scales.
pub(crate) struct HeldOutErrors {
    whole: Vec<Vec<f64>>,
    one_ahead: Vec<Vec<f64>>,
}

/// Errors of a model; `None` if no run is held out, or the model has no prediction of a run.
pub(crate) fn errors(bench: &Bench<'_>, fitted: &Fitted) -> Result<Option<HeldOutErrors>, Error> {
    if bench.held_out.is_empty() {
        return Ok(None);
    }
    let Some(residuals) = held_out_residuals(bench, fitted)? else { return Ok(None) };
    let mut innovations = residuals.clone();
    for (prepared, residuals) in bench.held_out.iter().zip(&mut innovations) {
        one_ahead(&prepared.segments, &fitted.noises, residuals);
    }
    Ok(Some(HeldOutErrors { whole: series(bench, &residuals), one_ahead: series(bench, &innovations) }))
}

fn series(bench: &Bench<'_>, residuals: &[DVector<f64>]) -> Vec<Vec<f64>> {
    let mut series = Vec::with_capacity(bench.held_out.len() * bench.scales.len());
    for (prepared, residuals) in bench.held_out.iter().zip(residuals) {
        for channel in 0..bench.scales.len() {
            let rows = prepared.rows_of(channel);
            series.push(residuals.rows(rows.start, rows.len()).iter().copied().collect());
        }
    }
    series
}

/// Autocovariance of a series about zero at a lag, with the length of the series as divisor.
fn mean_product(series: &[f64], lag: usize) -> f64 {
    series.iter().zip(series.iter().skip(lag)).map(|(a, b)| a * b).sum::<f64>() / series.len().max(1) as f64
}

/// Autocovariances of errors up to the cut-off, and the effective number of independent readings. The mean of the errors over a run is not
/// subtracted, because it is an error too.
fn covariances(errors: &[f64]) -> (Vec<f64>, f64) {
    let count = errors.len() as f64;
    let mut covariances: Vec<f64> = Vec::new();
    // Sums over pairs of neighbouring lags are positive and decrease for a stationary reversible Markov chain; they are cut off at the first
    // pair that is not positive.
    let (mut sum, mut previous_pair) = (0.0, f64::INFINITY);
    while covariances.len() + 1 < errors.len() {
        let lag = covariances.len();
        let both = [mean_product(errors, lag), mean_product(errors, lag + 1)];
        let pair = (both[0] + both[1]).min(previous_pair);
        if pair <= 0.0 {
            break;
        }
        (sum, previous_pair) = (sum + pair, pair);
        covariances.extend(both);
    }
    let inflation = covariances.first().map_or(1.0, |variance| (2.0 * sum / variance - 1.0).max(1.0));
    (covariances, count / inflation)
}

/// Difference of the squared errors of two models.
struct Comparison {
    gain: f64,
    gain_sd: f64,
    effective_readings: f64,
    p: f64,
}

/// Compares a model with another one; every series of errors is in units of the mean squared error of the better model.
fn compare(other: &[Vec<f64>], model: &[Vec<f64>]) -> Comparison {
    let (mut sum, mut variance, mut effective, mut total) = (0.0, 0.0, 0.0, 0.0);
    for (other, model) in other.iter().zip(model) {
        let scale = mean_product(model, 0).min(mean_product(other, 0));
        let unit = scale.max(f64::MIN_POSITIVE).recip();
        let pairs = other.iter().zip(model);
        let means: Vec<f64> = pairs.clone().map(|(a, b)| 0.5 * (a + b)).collect();
        let weights: Vec<f64> = pairs.map(|(a, b)| 2.0 * unit * (a - b)).collect();
        let (covariances, of_effective) = covariances(model);
        let of_lags = covariances.iter().enumerate().map(|(lag, covariance)| {
            let twice = if lag == 0 { 1.0 } else { 2.0 };
            twice * covariance * mean_product(&weights, lag) * weights.len() as f64
        });
        let of_lags: Vec<f64> = of_lags.collect();
        let independent = of_lags.first().copied().unwrap_or(0.0);
        let of_variance: f64 = of_lags.iter().sum();
        sum += weights.iter().zip(&means).map(|(weight, mean)| weight * mean).sum::<f64>();
        // The sum that was cut off may be smaller than the variance for independent errors.
        variance += of_variance.max(independent);
        effective += of_effective;
        total += unit * mean_product(other, 0) * other.len() as f64;
    }
    let p = match StudentsT::new(0.0, 1.0, effective - 1.0) {
        Ok(student) if variance > 0.0 => student.sf(sum / variance.sqrt()),
        _ => 1.0,
    };
    let total = total.max(f64::MIN_POSITIVE);
    Comparison { gain: sum / total, gain_sd: variance.sqrt() / total, effective_readings: effective, p }
}

/// Judges one model by the errors of another.
pub(crate) fn judge(other: &HeldOutErrors, model: &HeldOutErrors) -> Judgement {
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

    /// A first-order autoregressive series with this correlation of neighbours.
    fn series(rng: &mut ChaCha8Rng, count: usize, correlation: f64) -> Vec<f64> {
        let mut value: f64 = StandardNormal.sample(rng);
        let innovation = (1.0 - correlation * correlation).sqrt();
        let values = (0..count).map(|_| {
            let drawn: f64 = StandardNormal.sample(rng);
            value = correlation * value + innovation * drawn;
            value
        });
        values.collect()
    }

    #[test]
    fn correlated_readings_are_worth_fewer_independent_ones() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let (_, white) = covariances(&series(&mut rng, 4000, 0.0));
        let (_, coloured) = covariances(&series(&mut rng, 4000, 0.9));
        // A first-order process has n (1 - r) / (1 + r).
        assert!(white > 3300.0 && (120.0..340.0).contains(&coloured), "{white} {coloured}");
    }

    /// A model that is no better is confirmed in about five of a hundred cases.
    #[test]
    fn equal_models_are_confirmed_as_rarely_as_stated() {
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        let mut confirmed = 0;
        for _ in 0..400 {
            let [first, second] = [(); 2].map(|()| vec![series(&mut rng, 500, 0.95)]);
            confirmed += u32::from(compare(&first, &second).p < 1.0 - STATED_PROBABILITY);
        }
        assert!((4..=40).contains(&confirmed), "{confirmed} of 400");
    }

    /// Errors of two models, each of which lacks such a fraction of a law that acts in two parts of a run.
    fn rare(rng: &mut ChaCha8Rng, shares: [f64; 2], correlation: f64) -> [Vec<Vec<f64>>; 2] {
        let noise = series(rng, 500, correlation);
        shares.map(|share| {
            let mut errors = noise.clone();
            for acting in [100..120, 300..320] {
                errors[acting].iter_mut().for_each(|error| *error += share * 2.0);
            }
            vec![errors]
        })
    }

    #[test]
    fn a_law_that_acts_twice_is_confirmed_where_it_is_there() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let [without, with] = rare(&mut rng, [1.0, 0.0], 0.5);
        let comparison = compare(&without, &with);
        assert!(comparison.p < 0.01, "{}", comparison.p);
        // One model has too much of the law, the other too little.
        for correlation in [0.0, 0.5, 0.9] {
            let mut confirmed = 0;
            for _ in 0..400 {
                let [one, other] = rare(&mut rng, [0.5, -0.5], correlation);
                confirmed += u32::from(compare(&one, &other).p < 1.0 - STATED_PROBABILITY);
            }
            assert!((4..=40).contains(&confirmed), "{confirmed} of 400 at {correlation}");
        }
    }
}
