//! The mean of correlated samples, with the standard error it deserves.

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
}

impl Mean {
    /// Standard error of the mean if a single sample has the standard deviation `sd`.
    pub fn standard_error(&self, sd: f64) -> f64 {
        sd / self.effective_samples.sqrt()
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
    let covariance =
        |lag: usize| centred.iter().zip(centred.iter().skip(lag)).map(|(a, b)| a * b).sum::<f64>() / n;
    let variance = covariance(0);
    if samples < 2 || variance <= 0.0 {
        return Mean { value, scatter: 0.0, samples, effective_samples: n.max(1.0) };
    }
    let mut time = -1.0;
    for pair in 0..samples / 2 {
        let sum = (covariance(2 * pair) + covariance(2 * pair + 1)) / variance;
        if sum <= 0.0 {
            break;
        }
        time += 2.0 * sum;
    }
    let scatter = (variance * n / (n - 1.0)).sqrt();
    Mean { value, scatter, samples, effective_samples: (n / time.max(1.0)).clamp(1.0, n) }
}

/// Median of the values; NaN where there are none.
pub fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let half = values.len() / 2;
    match (values.get(half), values.len() % 2) {
        (None, _) => f64::NAN,
        (Some(middle), 1) => *middle,
        (Some(upper), _) => 0.5 * (values[half - 1] + upper),
    }
}
