//! Restricted likelihood of nested random effects with known variances of the observations (theory, eq. 70).
//!
//! An observation of a session `i` in groups `g` of every level is `y_i = x_i^T beta + sum_l u_lg(i) + w_i + e_i`, with
//! `u_l ~ N(0, tau_l^2)` shared by the sessions of a group, `w ~ N(0, tau_0^2)` of the session and `e ~ N(0, v_i)` its own error.

use crate::components::freedom;
use crate::tree::{Excess, Products, Tree, product};
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
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Observations {
    /// Observed values.
    pub y: Vec<f64>,
    /// Their variances, without any random effect.
    pub v: Vec<f64>,
    /// Covariates of every observation, without the constant; each of the same length.
    pub x: Vec<Vec<f64>>,
    /// Group of every observation on each level, outermost level first; groups of an inner level lie within one of the outer.
    pub levels: Vec<Vec<usize>>,
    /// Rig of every observation, whose sessions have a part of their stated errors in common; none: all are of one.
    pub rig: Vec<usize>,
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

    /// Row `[1, x, y]` of an observation.
    pub(crate) fn row(&self, index: usize) -> Vec<f64> {
        let covariates = self.x.get(index).into_iter().flatten().copied();
        std::iter::once(1.0).chain(covariates).chain([self.y[index]]).collect()
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
    pub(crate) fn at(tree: &Tree, tau: &[f64]) -> Option<Self> {
        let (session, levels) = tau.split_first()?;
        let (mut subtotals, mut sums, mut ln_determinant) = (Vec::new(), Vec::new(), 0.0);
        // The innermost level is the last one.
        for (stage, tau) in std::iter::once(session).chain(levels.iter().rev()).enumerate() {
            tree.sums(stage, Excess::of(tau * tau), &subtotals, &mut sums, Some(&mut ln_determinant));
            std::mem::swap(&mut subtotals, &mut sums);
        }
        let Mean { beta, covariance, squares, ln_normal } = Mean::of(&subtotals, tree.parameters())?;
        let deviance = ln_determinant + ln_normal + squares;
        deviance.is_finite().then(|| Self { beta, covariance, tau: tau.to_vec(), squares, deviance })
    }

    /// Maximises the restricted likelihood over the standard deviations of the sessions and of all levels; `None` where the mean is
    /// not determined.
    pub fn fit(data: &Observations) -> Option<Self> {
        let tree = Tree::new(data);
        Self::fit_tree(&tree, &freedom(&tree))
    }

    /// The same of sessions that are in their groups, some of them with less weight; `freedom` of every stage: those without any have
    /// no spread of their own.
    pub(crate) fn fit_tree(tree: &Tree, freedom: &[usize]) -> Option<Self> {
        let count = tree.stages();
        let free: Vec<usize> = tree
            .outwards()
            .enumerate()
            .filter(|(_, stage)| freedom[*stage] > 0)
            .map(|(place, _)| place)
            .collect();
        let n = tree.order.len();
        let y: Vec<f64> = (0..n).filter_map(|session| tree.row(session).last().copied()).collect();
        let mean = y.iter().sum::<f64>() / n as f64;
        let sd = (y.iter().map(|y| (y - mean).powi(2)).sum::<f64>() / n as f64).sqrt();
        let scale = sd.max(f64::MIN_POSITIVE.sqrt());
        let mut tau = vec![0.0; count];
        let best = Self::at(tree, &tau)?;
        if sd == 0.0 {
            return Some(best);
        }
        for _ in 0..if free.len() < 2 { 1 } else { MAX_SWEEPS } {
            let previous_tau = tau.clone();
            for component in &free {
                tau[*component] = likeliest(tree, &tau, *component, scale);
            }
            let moved = previous_tau.iter().zip(&tau).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            if moved < SETTLED * scale {
                break;
            }
        }
        let fit = Self::at(tree, &tau).filter(|fit| fit.deviance <= best.deviance);
        Some(fit.unwrap_or(best))
    }
}

/// The mean from the products of all sessions.
pub(crate) struct Mean {
    /// Its parameters.
    pub beta: DVector<f64>,
    /// Their covariance.
    pub covariance: DMatrix<f64>,
    /// Squares of the residuals.
    squares: f64,
    /// `ln det X^T V^-1 X`.
    ln_normal: f64,
}

impl Mean {
    /// Estimate for so many parameters; `None` if they are not determined.
    pub fn of(products: &Products, parameters: usize) -> Option<Self> {
        let normal = DMatrix::from_fn(parameters, parameters, |i, j| product(products, i, j));
        let column = DVector::from_fn(parameters, |i, _| product(products, i, parameters));
        let factor = normal.cholesky()?;
        let beta = factor.solve(&column);
        let squares = (product(products, parameters, parameters) - column.dot(&beta)).max(0.0);
        let ln_normal = 2.0 * factor.l_dirty().diagonal().map(f64::ln).sum();
        Some(Self { beta, covariance: factor.inverse(), squares, ln_normal })
    }
}

/// The restricted likelihood over one component.
#[derive(Clone, Copy)]
struct Profile<'a> {
    tree: &'a Tree,
    tau: &'a [f64],
    component: usize,
}

impl Profile<'_> {
    fn deviance(&self, value: f64) -> f64 {
        let mut tau = self.tau.to_vec();
        tau[self.component] = value;
        Nested::at(self.tree, &tau).map_or(f64::INFINITY, |fit| fit.deviance)
    }
}

impl CostFunction for Profile<'_> {
    type Param = f64;
    type Output = f64;

    fn cost(&self, value: &f64) -> Result<f64, Error> {
        Ok(self.deviance(*value))
    }
}

/// The likeliest value of one component beside the others.
fn likeliest(tree: &Tree, tau: &[f64], component: usize, scale: f64) -> f64 {
    let profile = Profile { tree, tau, component };
    let step = (MOST / LEAST).powf(1.0 / (GRID - 1) as f64);
    let grid: Vec<f64> = std::iter::once(0.0)
        .chain((0..GRID).map(|number| scale * LEAST * step.powi(number as i32)))
        .collect();
    let costs: Vec<f64> = grid.iter().map(|value| profile.deviance(*value)).collect();
    let cheapest = (0..grid.len()).min_by(|a, b| costs[*a].total_cmp(&costs[*b])).unwrap_or(0);
    let (low, high) = (grid[cheapest.saturating_sub(1)], grid[(cheapest + 1).min(grid.len() - 1)]);
    let solver = BrentOpt::new(low, high).set_tolerance(1e-9, 1e-12 * scale);
    let run = Executor::new(profile, solver).configure(|state| state.max_iters(200)).run();
    let minimum = run.ok().and_then(|result| result.state().get_best_param().copied());
    minimum.filter(|minimum| profile.deviance(*minimum) <= costs[cheapest]).unwrap_or(grid[cheapest])
}
