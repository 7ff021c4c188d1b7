//! The mean of correlated samples, with the standard error it deserves.

use super::median::median;
use super::spikes::without_spikes;

/// The mean of a stretch of a time series.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mean {
    /// The mean.
    pub value: f64,
    /// Standard deviation of a single sample about the mean.
    pub scatter: f64,
    /// Number of samples.
    pub samples: usize,
    /// Number of independent samples that would determine the mean as well.
    pub effective_samples: f64,
    /// Further samples that are no part of the mean, since they are single ones far from their neighbours.
    pub spikes: usize,
}

impl Mean {
    /// Standard error of the mean if a single sample has the standard deviation `sd`.
    pub fn standard_error(&self, sd: f64) -> f64 {
        sd / self.effective_samples.sqrt()
    }

    /// Standard error of the mean where the standard deviation of a reading may be stated: what that is beyond the scatter stays the same.
    pub fn error(&self, stated: Option<f64>) -> f64 {
        let (scatter, systematic) = scatter_and_systematic(self.scatter, stated, 0.0);
        self.standard_error(scatter).hypot(systematic)
    }
}

/// Standard deviation of a single reading, and the part of it that averaging over a hold does not reduce.
///
/// A stated noise that is twice the scatter within holds or more is not scatter: the rest of it stays the same over a
/// hold. `least` is the least such rest where no noise is stated: rounding.
pub fn scatter_and_systematic(scatter: f64, stated: Option<f64>, least: f64) -> (f64, f64) {
    match stated {
        Some(stated) if scatter < 0.5 * stated => (scatter, (stated * stated - scatter * scatter).sqrt()),
        Some(stated) => (scatter.max(stated), 0.0),
        None => (scatter, least),
    }
}

/// Mean, scatter and effective number of samples, `n / (1 + 2 sum rho_k)`.
///
/// The autocorrelations `rho_k` are summed in pairs up to the first pair that is not positive (Geyer's initial positive
/// sequence), so that drift and slow oscillation count as correlation and white noise as none.
pub fn mean(values: &[f64]) -> Mean {
    let samples = values.len();
    let n = samples as f64;
    let value = values.iter().sum::<f64>() / n;
    let centred: Vec<f64> = values.iter().map(|v| v - value).collect();
    let variance = autocovariance(0, &centred, n);
    if samples < 2 || variance <= 0.0 {
        return Mean { value, scatter: 0.0, samples, effective_samples: n.max(1.0), spikes: 0 };
    }
    let mut time = -1.0;
    for pair in 0..samples / 2 {
        let sum =
            (autocovariance(2 * pair, &centred, n) + autocovariance(2 * pair + 1, &centred, n)) / variance;
        if sum <= 0.0 {
            break;
        }
        time += 2.0 * sum;
    }
    let scatter = (variance * n / (n - 1.0)).sqrt();
    let effective_samples = (n / time.max(1.0)).clamp(1.0, n);
    Mean { value, scatter, samples, effective_samples, spikes: 0 }
}

fn autocovariance(lag: usize, centred: &[f64], n: f64) -> f64 {
    centred.iter().zip(centred.iter().skip(lag)).map(|(a, b)| a * b).sum::<f64>() / n
}

/// Means of stretches of one channel, whose noise is the same in all of them; without spikes.
///
/// A stretch of a few dozen samples shows less of its correlation than there is: the mean that is subtracted takes a part of it with it, and the sum
/// ends early by chance. So the autocorrelation is the median of those of all stretches, with what their means take of it (the variance of a mean,
/// found by iteration), and a stretch has as many independent samples as that leaves, or as it shows itself where that is fewer: it may drift.
pub fn means(stretches: &[&[f64]]) -> Vec<Mean> {
    let unspiked: Vec<Vec<f64>> = stretches.iter().map(|values| without_spikes(values)).collect();
    let mut hold_means: Vec<Mean> = unspiked.iter().map(|values| mean(values)).collect();
    let time = pooled_time(&unspiked);
    for (mean, values) in hold_means.iter_mut().zip(stretches) {
        mean.spikes = values.len() - mean.samples;
        mean.effective_samples = mean.effective_samples.min(mean.samples as f64 / time).max(1.0);
    }
    hold_means
}

/// Most iterations for the variance of a mean, which changes the autocorrelation that it is computed from.
const ITERATIONS: usize = 20;
/// Variance of a mean beside that of a sample, at most: beyond that the samples say nothing of it.
const MOST_OF_MEAN: f64 = 0.5;

/// Number of samples of a stretch that are worth one independent sample, 1 or more, from all stretches
/// together.
fn pooled_time(stretches: &[Vec<f64>]) -> f64 {
    let scaled: Vec<Vec<f64>> = stretches.iter().filter_map(|values| scaled(values)).collect();
    let Some(shortest) = scaled.iter().map(Vec::len).min() else { return 1.0 };
    let samples = scaled.len() as f64 / scaled.iter().map(|values| 1.0 / values.len() as f64).sum::<f64>();
    let mut sums: Vec<f64> = Vec::new();
    let (mut time, mut of_mean) = (1.0, 0.0);
    for _ in 0..ITERATIONS {
        let (mut sum, mut pair) = (0.0, 0);
        while 2 * pair + 1 < shortest / 2 {
            if sums.len() <= pair {
                let of_each = scaled.iter().map(|values| {
                    autocorrelation_sum(values, 2 * pair) + autocorrelation_sum(values, 2 * pair + 1)
                });
                sums.push(median(of_each.collect()));
            }
            // The mean that was subtracted took as much of every autocovariance.
            let Some(pair_sum) = sums.get(pair) else { break };
            let of_pair = (pair_sum + 2.0 * of_mean) / (1.0 + of_mean);
            if of_pair <= 0.0 {
                break;
            }
            (sum, pair) = (sum + of_pair, pair + 1);
        }
        time = (2.0 * sum - 1.0).max(1.0);
        of_mean = (time / samples).min(MOST_OF_MEAN);
    }
    // The scatter about the mean is too small by the same.
    time * (1.0 + of_mean)
}

fn autocorrelation_sum(values: &[f64], lag: usize) -> f64 {
    let products = values.iter().zip(values.iter().skip(lag)).map(|(a, b)| a * b);
    products.sum::<f64>() / (values.len() - lag) as f64
}

/// Values about their mean in units of their scatter; nothing where they do not vary.
fn scaled(values: &[f64]) -> Option<Vec<f64>> {
    let n = values.len() as f64;
    let middle = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|value| (value - middle).powi(2)).sum::<f64>() / n;
    let scatter = (variance > 0.0).then(|| variance.sqrt())?;
    Some(values.iter().map(|value| (value - middle) / scatter).collect())
}
