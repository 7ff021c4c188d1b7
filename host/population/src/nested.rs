//! Restricted likelihood of nested random effects with known variances of the observations (theory, eq. 70).
//!
//! An observation of a session `i` in groups `g` of every level is `y_i = x_i^T beta + sum_l u_lg(i) + w_i + e_i`, with
//! `u_l ~ N(0, tau_l^2)` shared by the sessions of a group, `w ~ N(0, tau_0^2)` of the session and `e ~ N(0, v_i)` its own error. The
//! covariance of a group is that of its members plus a constant, so that the products `[X, y]^T V^-1 [X, y]` and the determinant follow
//! from those of its members by one rank-one update each (Woodbury): the work is linear in the number of sessions.

use argmin::core::{CostFunction, Error, Executor, State};
use argmin::solver::brent::BrentOpt;
use nalgebra::{DMatrix, DVector};

/// Searches of one component after the other.
const MAX_SWEEPS: usize = 60;
/// Change of a component, relative to the largest one, at which they end.
const SETTLED: f64 = 1e-8;
/// Points of the search for the best bracket of a component.
const GRID: usize = 24;
/// Range of a component, as multiples of the sd of the observations.
const LEAST: f64 = 1e-4;
const MOST: f64 = 10.0;

/// Observations with known variances; columns of equal length.
#[derive(Debug, Clone, PartialEq)]
pub struct Observations {
    /// Observed values.
    pub y: Vec<f64>,
    /// Their variances, without any random effect.
    pub v: Vec<f64>,
    /// Covariates of every observation, without the constant; each of the same length.
    pub x: Vec<Vec<f64>>,
    /// Group of every observation on each level, outermost level first; groups of an inner level lie within one of the outer.
    pub levels: Vec<Vec<usize>>,
}

impl Observations {
    /// Number of observations.
    pub fn len(&self) -> usize {
        self.y.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.y.is_empty()
    }

    /// Number of parameters of the mean.
    pub fn parameters(&self) -> usize {
        1 + self.x.first().map_or(0, Vec::len)
    }

    /// Without one observation.
    pub fn without(&self, index: usize) -> Self {
        let mut less = self.clone();
        less.y.remove(index);
        less.v.remove(index);
        if index < less.x.len() {
            less.x.remove(index);
        }
        less.levels.iter_mut().for_each(|level| {
            level.remove(index);
        });
        less
    }

    /// Row `[1, x, y]` of an observation.
    fn row(&self, index: usize) -> Vec<f64> {
        let covariates = self.x.get(index).into_iter().flatten().copied();
        std::iter::once(1.0).chain(covariates).chain([self.y[index]]).collect()
    }
}

/// Products in the metric of the covariance.
#[derive(Debug, Clone)]
struct Products {
    /// `[X, y]^T V^-1 [X, y]`.
    matrix: DMatrix<f64>,
    /// `ln det V`.
    ln_determinant: f64,
}

impl Products {
    fn none(size: usize) -> Self {
        Self { matrix: DMatrix::zeros(size, size), ln_determinant: 0.0 }
    }

    fn add(&mut self, other: &Self) {
        self.matrix += &other.matrix;
        self.ln_determinant += other.ln_determinant;
    }

    /// What is shared by all of them with this variance.
    fn share(&mut self, variance: f64) {
        let gain = 1.0 + variance * self.matrix[(0, 0)];
        let first = self.matrix.column(0).into_owned();
        self.matrix.ger(-variance / gain, &first, &first, 1.0);
        self.ln_determinant += gain.ln();
    }
}

/// A fit of nested random effects.
#[derive(Debug, Clone)]
pub struct Nested {
    /// Parameters of the mean: the constant, then the covariates'.
    pub beta: DVector<f64>,
    /// `(X^T V^-1 X)^-1`.
    pub covariance: DMatrix<f64>,
    /// Standard deviation of the sessions, then of every level from the outermost.
    pub tau: Vec<f64>,
    /// Squares of the residuals in the metric of `V`.
    pub squares: f64,
    /// Twice the negative restricted log likelihood, without its constant.
    pub deviance: f64,
}

impl Nested {
    /// Fits at given standard deviations; `None` where the mean is not determined.
    pub fn at(data: &Observations, order: &[usize], tau: &[f64]) -> Option<Self> {
        let size = data.parameters() + 1;
        let variances: Vec<f64> = tau.iter().map(|tau| tau * tau).collect();
        let (session, levels) = variances.split_first()?;
        // Open groups: the innermost last, below all of them the total.
        let mut open = vec![Products::none(size); levels.len() + 1];
        let close = |open: &mut Vec<Products>, from: usize| {
            for level in (from..levels.len()).rev() {
                let mut done = std::mem::replace(&mut open[level + 1], Products::none(size));
                done.share(levels[level]);
                open[level].add(&done);
            }
        };
        let mut last: Option<usize> = None;
        for &index in order {
            if let Some(last) = last {
                let differs = data.levels.iter().position(|level| level[index] != level[last]);
                if let Some(level) = differs {
                    close(&mut open, level);
                }
            }
            last = Some(index);
            let variance = data.v[index] + session;
            let row = DVector::from_vec(data.row(index));
            let innermost = &mut open[levels.len()];
            innermost.matrix.ger(1.0 / variance, &row, &row, 1.0);
            innermost.ln_determinant += variance.ln();
        }
        close(&mut open, 0);
        let total = open.swap_remove(0);
        let p = size - 1;
        let normal = total.matrix.view((0, 0), (p, p)).into_owned();
        let along = total.matrix.view((0, p), (p, 1)).column(0).into_owned();
        let factor = normal.cholesky()?;
        let beta = factor.solve(&along);
        let squares = (total.matrix[(p, p)] - along.dot(&beta)).max(0.0);
        let ln_normal = 2.0 * factor.l().diagonal().map(f64::ln).sum();
        let deviance = total.ln_determinant + ln_normal + squares;
        deviance.is_finite().then(|| Self {
            beta,
            covariance: factor.inverse(),
            tau: tau.to_vec(),
            squares,
            deviance,
        })
    }

    /// Maximises the restricted likelihood over the standard deviations of the sessions and of all levels; `None` where the mean is
    /// not determined.
    pub fn fit(data: &Observations) -> Option<Self> {
        let order = data.order();
        let count = data.levels.len() + 1;
        let mean = data.y.iter().sum::<f64>() / data.len() as f64;
        let sd = (data.y.iter().map(|y| (y - mean).powi(2)).sum::<f64>() / data.len() as f64).sqrt();
        let scale = sd.max(f64::MIN_POSITIVE.sqrt());
        let mut tau = vec![0.0; count];
        let mut best = Self::at(data, &order, &tau)?;
        if data.len() <= data.parameters() || sd == 0.0 {
            return Some(best);
        }
        tau[0] = 0.5 * scale;
        for _ in 0..if count == 1 { 1 } else { MAX_SWEEPS } {
            let before = tau.clone();
            for component in 0..count {
                tau[component] = likeliest(data, &order, &tau, component, scale);
            }
            let moved = before.iter().zip(&tau).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            if moved < SETTLED * scale {
                break;
            }
        }
        if let Some(fit) = Self::at(data, &order, &tau).filter(|fit| fit.deviance <= best.deviance) {
            best = fit;
        }
        Some(best)
    }
}

impl Observations {
    /// Order in which the members of every group are neighbours.
    pub fn order(&self) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.len()).collect();
        order.sort_by_key(|index| self.levels.iter().map(|level| level[*index]).collect::<Vec<_>>());
        order
    }
}

/// The restricted likelihood over one component.
#[derive(Clone, Copy)]
struct Profile<'a> {
    data: &'a Observations,
    order: &'a [usize],
    tau: &'a [f64],
    component: usize,
}

impl CostFunction for Profile<'_> {
    type Param = f64;
    type Output = f64;

    fn cost(&self, value: &f64) -> Result<f64, Error> {
        let mut tau = self.tau.to_vec();
        tau[self.component] = *value;
        Ok(Nested::at(self.data, self.order, &tau).map_or(f64::INFINITY, |fit| fit.deviance))
    }
}

/// The likeliest value of one component beside the others.
fn likeliest(data: &Observations, order: &[usize], tau: &[f64], component: usize, scale: f64) -> f64 {
    let profile = Profile { data, order, tau, component };
    let cost = |value: f64| profile.cost(&value).unwrap_or(f64::INFINITY);
    let step = (MOST / LEAST).powf(1.0 / (GRID - 1) as f64);
    let grid: Vec<f64> = std::iter::once(0.0)
        .chain((0..GRID).map(|number| scale * LEAST * step.powi(number as i32)))
        .collect();
    let costs: Vec<f64> = grid.iter().map(|value| cost(*value)).collect();
    let at = (0..grid.len()).min_by(|a, b| costs[*a].total_cmp(&costs[*b])).unwrap_or(0);
    let (low, high) = (grid[at.saturating_sub(1)], grid[(at + 1).min(grid.len() - 1)]);
    let solver = BrentOpt::new(low, high).set_tolerance(1e-9, 1e-12 * scale);
    let run = Executor::new(profile, solver).configure(|state| state.max_iters(200)).run();
    let found = run.ok().and_then(|result| result.state().get_best_param().copied());
    found.filter(|found| cost(*found) <= costs[at]).unwrap_or(grid[at])
}
