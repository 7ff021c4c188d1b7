//! The likeliest sizes of the unknowns, by a quasi-Newton method, and how wide the posterior is about them.

use argmin::core::{CostFunction, Executor, Gradient, State};
use argmin::solver::linesearch::MoreThuenteLineSearch;
use argmin::solver::quasinewton::LBFGS;
use std::cell::RefCell;

/// Steps of the search.
const MAX_STEPS: u64 = 30;
/// Step of the differences that give a slope, and of those that give a curvature.
const SLOPE_STEP: f64 = 1e-3;
const BEND_STEP: f64 = 0.3;

/// A function of some of the numbers of a point.
struct Along<'c> {
    cost: &'c dyn Fn(&[f64]) -> f64,
    point: &'c [f64],
    active: &'c [usize],
    /// The last place with its value: the slope is wanted where the value was.
    last: RefCell<Option<(Vec<f64>, f64)>>,
}

impl<'c> Along<'c> {
    fn new(cost: &'c dyn Fn(&[f64]) -> f64, point: &'c [f64], active: &'c [usize]) -> Self {
        Self { cost, point, active, last: RefCell::default() }
    }

    fn value(&self, x: &[f64]) -> f64 {
        if let Some((_, value)) = self.last.borrow().as_ref().filter(|(at, _)| at == x) {
            return *value;
        }
        let value = (self.cost)(&self.at(x));
        self.last.replace(Some((x.to_vec(), value)));
        value
    }

    fn at(&self, x: &[f64]) -> Vec<f64> {
        let mut point = self.point.to_vec();
        self.active.iter().zip(x).for_each(|(i, x)| point[*i] = *x);
        point
    }
}

impl CostFunction for Along<'_> {
    type Param = Vec<f64>;
    type Output = f64;

    fn cost(&self, x: &Vec<f64>) -> Result<f64, argmin::core::Error> {
        Ok(self.value(x))
    }
}

impl Gradient for Along<'_> {
    type Param = Vec<f64>;
    type Gradient = Vec<f64>;

    fn gradient(&self, x: &Vec<f64>) -> Result<Vec<f64>, argmin::core::Error> {
        let base_cost = self.value(x);
        Ok((0..x.len())
            .map(|i| {
                let mut moved = x.clone();
                moved[i] += SLOPE_STEP;
                ((self.cost)(&self.at(&moved)) - base_cost) / SLOPE_STEP
            })
            .collect())
    }
}

/// The point of least cost near `start`, with only the `active` numbers free; `start` where the search fails.
pub(super) fn likeliest(cost: &dyn Fn(&[f64]) -> f64, start: &[f64], active: &[usize]) -> Vec<f64> {
    let search_line = Along::new(cost, start, active);
    let start_values: Vec<f64> = active.iter().map(|i| start[*i]).collect();
    let best = || {
        let line = MoreThuenteLineSearch::new().with_bounds(1e-3, 8.0).ok()?;
        let solver = LBFGS::new(line, 7).with_tolerance_cost(1e-2).ok()?.with_tolerance_grad(5e-2).ok()?;
        let problem = Along::new(cost, start, active);
        let run = Executor::new(problem, solver)
            .configure(|state| state.param(start_values).max_iters(MAX_STEPS))
            .run();
        run.ok()?.state().get_best_param().cloned()
    };
    best().map_or_else(|| start.to_vec(), |x| search_line.at(&x))
}

/// Standard deviation of the posterior along each number; never wider than the prior, which has unit width.
pub(super) fn widths(cost: &dyn Fn(&[f64]) -> f64, point: &[f64], active: &[usize]) -> Vec<f64> {
    let least = cost(point);
    (0..point.len()).map(|i| if active.contains(&i) { width(i, least, cost, point) } else { 1.0 }).collect()
}

/// Width of a Gaussian with the cost's curvature.
fn width(i: usize, least: f64, cost: &dyn Fn(&[f64]) -> f64, point: &[f64]) -> f64 {
    let bend = (cost_moved(i, BEND_STEP, cost, point) - 2.0 * least + cost_moved(i, -BEND_STEP, cost, point))
        / (BEND_STEP * BEND_STEP);
    1.0 / bend.max(1.0).sqrt()
}

/// Cost at a point with one coordinate moved.
fn cost_moved(i: usize, step: f64, cost: &dyn Fn(&[f64]) -> f64, point: &[f64]) -> f64 {
    let mut moved = point.to_vec();
    moved[i] += step;
    cost(&moved)
}
