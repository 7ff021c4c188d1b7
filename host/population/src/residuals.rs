//! Unusual sessions: how far each is from the others (theory, eq. 72).
//!
//! The residual of a session is from the mean of the others, standardised with its own error, the variance between sessions and the
//! error of that mean. For small groups the variance between sessions is estimated without the session too, so that one that is far off
//! does not hide behind the variance that it makes. A second residual is from a fit of Student's t with four degrees of freedom, in which
//! several that are far off do not hide each other.

use crate::nested::{Nested, Observations};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use statrs::distribution::{ContinuousCDF, Normal};

/// Sessions up to which the variance is estimated again without each.
const EXACT: usize = 200;
/// Degrees of freedom of the robust fit.
const FREEDOM: f64 = 4.0;
const ROUNDS: usize = 200;
const SETTLED: f64 = 1e-10;

/// One session beside the others of its group.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Residual {
    /// Residual without the session, standardised.
    pub standardised: f64,
    /// Residual from the robust fit, standardised.
    pub robust: f64,
    /// Probability of a larger one in at least one of so many sessions, of the larger of the two.
    pub p_adjusted: f64,
    /// Estimate of the session's true value: between its own and the mean of its group, and its standard deviation.
    pub shrunk: (f64, f64),
}

/// Residuals and shrunk estimates of all sessions under a fit; nested levels count as variance.
pub fn residuals(data: &Observations, fit: &Nested) -> Vec<Residual> {
    let tau2: f64 = fit.tau.iter().map(|tau| tau * tau).sum();
    let n = data.len();
    let flat = Observations { levels: Vec::new(), ..data.clone() };
    let whole = weighted(&flat, tau2);
    let robust = Robust::fit(&flat);
    let normal = Normal::standard();
    let of = |index: usize| {
        let row = DVector::from_vec(data.covariates(index));
        let (y, v) = (data.y[index], data.v[index]);
        let standardised = without(&flat, index, tau2, whole.as_ref()).unwrap_or(0.0);
        let robust = robust.as_ref().map_or(0.0, |fit| (y - row.dot(&fit.beta)) / (v + fit.tau2).sqrt());
        let largest = standardised.abs().max(robust.abs());
        let mean = row.dot(&fit.beta);
        let share = if tau2 > 0.0 { tau2 / (tau2 + v) } else { 0.0 };
        let of_mean = row.dot(&(&fit.covariance * &row));
        Residual {
            standardised,
            robust,
            p_adjusted: (n as f64 * 2.0 * normal.sf(largest)).min(1.0),
            shrunk: (mean + share * (y - mean), (share * v + (1.0 - share).powi(2) * of_mean).sqrt()),
        }
    };
    (0..n).into_par_iter().map(of).collect()
}

/// Parameters of the mean and the inverse of their normal matrix.
struct Weighted {
    beta: DVector<f64>,
    inverse: DMatrix<f64>,
}

fn weighted(data: &Observations, tau2: f64) -> Option<Weighted> {
    let p = data.parameters();
    let (mut normal, mut along) = (DMatrix::zeros(p, p), DVector::zeros(p));
    for index in 0..data.len() {
        let row = DVector::from_vec(data.covariates(index));
        let weight = (data.v[index] + tau2).recip();
        normal.ger(weight, &row, &row, 1.0);
        along.axpy(weight * data.y[index], &row, 1.0);
    }
    let factor = normal.cholesky()?;
    Some(Weighted { beta: factor.solve(&along), inverse: factor.inverse() })
}

/// Standardised residual of a session from the mean of the others; `None` where these have none.
fn without(data: &Observations, index: usize, tau2: f64, whole: Option<&Weighted>) -> Option<f64> {
    let row = DVector::from_vec(data.covariates(index));
    if data.len() <= EXACT {
        let others = Nested::fit(&data.without(index))?;
        let tau2 = others.tau.iter().map(|tau| tau * tau).sum::<f64>();
        let variance = data.v[index] + tau2 + row.dot(&(&others.covariance * &row));
        return Some((data.y[index] - row.dot(&others.beta)) / variance.sqrt());
    }
    // With the same variance the others' mean follows by one rank-one update.
    let whole = whole?;
    let variance = data.v[index] + tau2;
    let leverage = row.dot(&(&whole.inverse * &row)) / variance;
    let rest = (data.y[index] - row.dot(&whole.beta)) / (1.0 - leverage);
    Some(rest / (variance / (1.0 - leverage)).sqrt())
}

/// Mean and variance between sessions where errors and sessions together follow Student's t.
struct Robust {
    beta: DVector<f64>,
    tau2: f64,
}

impl Robust {
    /// Expectation and maximisation: weights of the sessions, then mean and variance. The variance is that of a normal distribution with
    /// the same weights, so that residuals of clean sessions are standard normal.
    fn fit(data: &Observations) -> Option<Self> {
        let n = data.len();
        if n <= data.parameters() {
            return None;
        }
        let first = weighted(data, 0.0)?;
        let rests = |beta: &DVector<f64>| -> Vec<f64> {
            (0..n).map(|i| data.y[i] - DVector::from_vec(data.covariates(i)).dot(beta)).collect()
        };
        let mut sorted: Vec<f64> = rests(&first.beta).iter().map(|rest| rest.abs()).collect();
        sorted.sort_by(f64::total_cmp);
        // Median absolute deviation of a normal distribution: 0.6745 sd.
        let (mut beta, mut tau2) = (first.beta, (sorted[n / 2] / 0.6745).powi(2));
        for _ in 0..ROUNDS {
            let rest = rests(&beta);
            let weight =
                |i: usize| (FREEDOM + 1.0) / (FREEDOM + rest[i].powi(2) / (CONSISTENCY * (data.v[i] + tau2)));
            let scaled =
                Observations { v: (0..n).map(|i| (data.v[i] + tau2) / weight(i)).collect(), ..data.clone() };
            let next = weighted(&scaled, 0.0)?.beta;
            let rest = rests(&next);
            // One step of the scale: squares with these weights against their expectation.
            let (mut above, mut below) = (0.0, 0.0);
            for (i, rest) in rest.iter().enumerate() {
                let of_all = (data.v[i] + tau2).powi(-2);
                above += of_all * (weight(i) * rest * rest / CONSISTENCY - data.v[i]);
                below += of_all;
            }
            let next_tau2 = (above / below).max(0.0);
            let moved = (next_tau2 - tau2).abs();
            (beta, tau2) = (next, next_tau2);
            if moved < SETTLED * (tau2 + SETTLED) {
                break;
            }
        }
        Some(Self { beta, tau2 })
    }
}

/// What the squares of a standard normal variable are on average with the weights of the t: the root c of `E[5 z^2 / (4 c + z^2)] = 1`.
const CONSISTENCY: f64 = 0.690_567;

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    fn drawn(n: usize, far: &[(usize, f64)], seed: u64) -> Observations {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
        let v: Vec<f64> = (0..n).map(|i| (0.02 + 0.04 * (i % 5) as f64 / 4.0).powi(2)).collect();
        let mut y: Vec<f64> = v.iter().map(|v| 2.5 + 0.12 * normal() + v.sqrt() * normal()).collect();
        far.iter().for_each(|(index, by)| y[*index] += by);
        Observations { y, v, x: Vec::new(), levels: Vec::new() }
    }

    fn of(data: &Observations) -> Vec<Residual> {
        residuals(data, &Nested::fit(data).expect("fitted"))
    }

    #[test]
    fn clean_sessions_have_standard_normal_residuals_of_both_kinds() {
        let found = of(&drawn(400, &[], 5));
        let sd = |of: fn(&Residual) -> f64| (found.iter().map(|r| of(r).powi(2)).sum::<f64>() / 400.0).sqrt();
        let (standardised, robust) = (sd(|r| r.standardised), sd(|r| r.robust));
        assert!((standardised - 1.0).abs() < 0.1 && (robust - 1.0).abs() < 0.15, "{standardised} {robust}");
        assert!(found.iter().all(|r| r.p_adjusted > 0.05));
    }

    #[test]
    fn sessions_that_are_far_off_do_not_hide_each_other() {
        let far: Vec<(usize, f64)> = (0..6).map(|i| (i, 1.2)).collect();
        let found = of(&drawn(60, &far, 7));
        assert!(found[..6].iter().all(|r| r.p_adjusted < 0.05), "{:?}", &found[..6]);
        assert_eq!(found[6..].iter().filter(|r| r.p_adjusted < 0.05).count(), 0);
    }

    #[test]
    fn the_update_without_a_session_is_the_fit_without_it_at_the_same_variance() {
        let data = drawn(300, &[], 11);
        let tau2 = 0.0144;
        let whole = weighted(&data, tau2);
        let fast = without(&data, 17, tau2, whole.as_ref()).expect("a residual");
        let others = weighted(&data.without(17), tau2).expect("fitted");
        let variance = data.v[17] + tau2 + others.inverse[(0, 0)];
        let slow = (data.y[17] - others.beta[0]) / variance.sqrt();
        assert!((fast - slow).abs() < 1e-10, "{fast} {slow}");
    }
}
