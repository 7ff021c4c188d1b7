//! The distribution of a quantity between sessions once each session's own error is taken out (theory, eq. 70 and 71).
//!
//! Variance between sessions by restricted likelihood, beside that of Paule and Mandel; its interval by the profile of Cochran's Q
//! (Viechtbauer 2007); the mean's by Hartung and Knapp, modified so that it is never narrower than the one without (Roever 2015); the
//! prediction of a new session with a t-distribution of n - p - 1 degrees of freedom (Higgins 2009). Veroniki and others (2016) compare
//! these estimators.

use crate::nested::{Nested, Observations};
use statrs::distribution::{ChiSquared, ContinuousCDF, StudentsT};

/// Bisections of a root: to the last digit.
const BISECTIONS: usize = 200;

/// The result for one group of sessions.
#[derive(Debug, Clone, PartialEq)]
pub struct RandomEffects {
    /// Number of sessions.
    pub sessions: usize,
    /// Parameters of the mean (constant, covariates) with their standard errors and 95 % intervals.
    pub beta: Vec<(f64, f64, [f64; 2])>,
    /// Standard deviation of the sessions by restricted likelihood, then of every level from the outermost.
    pub tau: Vec<f64>,
    /// Standard deviation between sessions of all levels together.
    pub tau_total: f64,
    /// Its 95 % interval; nothing from one session.
    pub tau_ci95: Option<[f64; 2]>,
    /// By Paule and Mandel.
    pub tau_paule_mandel: f64,
    /// Prediction interval of a new session's true value at the mean of the covariates; nothing from fewer than three.
    pub prediction95: Option<[f64; 2]>,
    /// Cochran's Q, its degrees of freedom and p.
    pub q: (f64, usize, f64),
    /// Share of the variance that is between sessions, percent.
    pub i_squared_percent: f64,
    /// Intraclass correlation of the outermost level, between two sessions of a group as measured; where there are levels.
    pub icc: Option<f64>,
    /// The fit.
    fit_covariance: Vec<f64>,
    /// Typical variance of a session's own error (Higgins and Thompson 2002).
    pub typical_variance: f64,
}

/// Analyses one group; `None` where the mean is not determined.
pub fn random_effects(data: &Observations) -> Option<RandomEffects> {
    let fit = Nested::fit(data)?;
    let flat = Observations { levels: Vec::new(), ..data.clone() };
    let order = flat.order();
    let (n, p) = (data.len(), data.parameters());
    let freedom = n.saturating_sub(p);
    let q_at = |tau: f64| Nested::at(&flat, &order, &[tau]).map_or(0.0, |fit| fit.squares);
    let q = q_at(0.0);
    let q_p = ChiSquared::new(freedom as f64).map_or(1.0, |chi| chi.sf(q));
    let largest = 100.0 * data.spread().max(f64::MIN_POSITIVE);
    let tau_paule_mandel = root(&q_at, freedom as f64, largest);
    let interval = || {
        let chi = ChiSquared::new(freedom as f64).ok()?;
        Some([0.975, 0.025].map(|share| root(&q_at, chi.inverse_cdf(share), largest)))
    };
    let tau_total = fit.tau.iter().map(|tau| tau * tau).sum::<f64>().sqrt();
    // Of Hartung and Knapp, never below one.
    let factor = if freedom > 0 { (fit.squares / freedom as f64).max(1.0) } else { 1.0 };
    let t = |freedom: f64| StudentsT::new(0.0, 1.0, freedom).map_or(f64::INFINITY, |t| t.inverse_cdf(0.975));
    let quantile = if freedom > 0 { t(freedom as f64) } else { crate::NORMAL_975 };
    let beta: Vec<(f64, f64, [f64; 2])> = fit
        .beta
        .iter()
        .enumerate()
        .map(|(i, value)| {
            let se = (factor * fit.covariance[(i, i)]).sqrt();
            (*value, se, [value - quantile * se, value + quantile * se])
        })
        .collect();
    let typical_variance = typical(data);
    let prediction95 = (freedom > 1).then(|| {
        let at = data.mean_row();
        let center: f64 = at.iter().zip(fit.beta.iter()).map(|(x, beta)| x * beta).sum();
        let variance = factor * quadratic(&fit.covariance, &at) + tau_total * tau_total;
        let half = t(freedom as f64 - 1.0) * variance.sqrt();
        [center - half, center + half]
    });
    let between = tau_total * tau_total;
    Some(RandomEffects {
        sessions: n,
        beta,
        tau_ci95: if freedom > 0 { interval() } else { None },
        tau_total,
        tau_paule_mandel,
        prediction95,
        q: (q, freedom, q_p),
        i_squared_percent: 100.0 * between / (between + typical_variance),
        icc: (!data.levels.is_empty()).then(|| {
            let outer = fit.tau.get(1).map_or(0.0, |tau| tau * tau);
            outer / (between + typical_variance)
        }),
        fit_covariance: fit.covariance.as_slice().to_vec(),
        tau: fit.tau,
        typical_variance,
    })
}

impl RandomEffects {
    /// Mean at a row `[1, x]` and its variance without the factor of Hartung and Knapp.
    pub fn mean_at(&self, row: &[f64]) -> (f64, f64) {
        let value = row.iter().zip(&self.beta).map(|(x, (beta, ..))| x * beta).sum();
        let p = self.beta.len();
        let covariance = nalgebra::DMatrix::from_column_slice(p, p, &self.fit_covariance);
        (value, quadratic(&covariance, row))
    }
}

fn quadratic(matrix: &nalgebra::DMatrix<f64>, row: &[f64]) -> f64 {
    let row = nalgebra::DVector::from_column_slice(row);
    row.dot(&(matrix * &row))
}

impl Observations {
    /// Row `[1, x]` of an observation.
    pub fn covariates(&self, index: usize) -> Vec<f64> {
        std::iter::once(1.0).chain(self.x.get(index).into_iter().flatten().copied()).collect()
    }

    /// Mean of the rows `[1, x]`.
    pub fn mean_row(&self) -> Vec<f64> {
        let mut sum = vec![0.0; self.parameters()];
        for index in 0..self.len() {
            sum.iter_mut().zip(self.covariates(index)).for_each(|(sum, x)| *sum += x);
        }
        sum.into_iter().map(|sum| sum / self.len().max(1) as f64).collect()
    }

    fn spread(&self) -> f64 {
        let ends = self
            .y
            .iter()
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], y| [low.min(*y), high.max(*y)]);
        let largest_v = self.v.iter().copied().fold(0.0, f64::max);
        (ends[1] - ends[0]).max(largest_v.sqrt())
    }
}

/// The typical variance of Higgins and Thompson: `(n - p) / tr(P)` with `P = W - W X (X^T W X)^-1 X^T W`, `W` the precisions.
fn typical(data: &Observations) -> f64 {
    let p = data.parameters();
    let mut normal = nalgebra::DMatrix::zeros(p, p);
    let mut squared = nalgebra::DMatrix::zeros(p, p);
    let mut trace = 0.0;
    for index in 0..data.len() {
        let row = nalgebra::DVector::from_vec(data.covariates(index));
        let weight = data.v[index].recip();
        normal.ger(weight, &row, &row, 1.0);
        squared.ger(weight * weight, &row, &row, 1.0);
        trace += weight;
    }
    let Some(factor) = normal.cholesky() else { return 0.0 };
    let trace = trace - factor.solve(&squared).trace();
    let freedom = data.len().saturating_sub(p) as f64;
    if trace > 0.0 && freedom > 0.0 { freedom / trace } else { data.v.first().copied().unwrap_or(0.0) }
}

/// Where a falling function of tau has a value; 0 where it is below that at 0 already.
fn root(function: &impl Fn(f64) -> f64, value: f64, largest: f64) -> f64 {
    if function(0.0) <= value {
        return 0.0;
    }
    let (mut low, mut high) = (0.0, largest);
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (low + high);
        if middle <= low || middle >= high || (high - low) < 1e-12 * high {
            break;
        }
        if function(middle) > value {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

#[cfg(test)]
#[path = "random_effects_tests.rs"]
mod tests;
