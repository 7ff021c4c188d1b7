//! Search for the sizes of the discrepancy's groups at which the evidence is largest (theory, eq. 61).

use super::{Patterns, Products};
use argmin::core::{CostFunction, Executor, Gradient, State, TerminationReason};
use argmin::solver::linesearch::MoreThuenteLineSearch;
use argmin::solver::quasinewton::LBFGS;
use std::cell::RefCell;

/// Steps of the search for the sizes, and the largest change of a logarithm of a size in one.
const MAX_STEPS: u64 = 12;
const MAX_SIZE_STEP: f64 = 6.0;
/// It ends where the objective falls by less than this in a step, or its slopes are smaller than this.
const MIN_DECREASE: f64 = 1e-3;
const MIN_SLOPE: f64 = 1e-2;
/// Slopes of the objective beyond this make the search's first steps too long: it is approached in steps of at most so much of a
/// logarithm, so many at most.
const LARGE_SLOPE: f64 = 30.0;
const LONGEST_APPROACH: f64 = 1.0;
const MAX_APPROACHES: usize = 12;
/// The search starts again where its line search gives up, so many times in all, after an approach from slopes so many times smaller.
const MAX_STARTS: i32 = 3;
const SMALLER_SLOPE: f64 = 10.0;
/// Value where sizes make no sense: above every other one, and small enough that a line search can interpolate with it.
const UNUSABLE: f64 = 1e12;

/// A point with the value and the slopes there.
type Evaluated = (Vec<f64>, f64, Vec<f64>);

/// Minus the log evidence as a function of the logarithms of the free sizes.
struct Cost<'a> {
    patterns: &'a Patterns,
    products: &'a Products,
    free: &'a [usize],
    start: &'a [f64],
    /// The last point with its value and slopes: both are needed one after the other.
    last: RefCell<Option<Evaluated>>,
}

impl Cost<'_> {
    fn at(&self, x: &[f64]) -> (f64, Vec<f64>) {
        if let Some((_, value, slopes)) = self.last.borrow().as_ref().filter(|(point, ..)| point == x) {
            return (*value, slopes.clone());
        }
        let mut sizes = self.start.to_vec();
        for (group, ln) in self.free.iter().zip(x) {
            sizes[*group] = ln.clamp(-60.0, 30.0).exp();
        }
        let (value, slopes) = match self.patterns.evidence(&sizes, self.products) {
            Some(evidence)
                if evidence.minus_ln < UNUSABLE
                    && evidence.gradient.iter().all(|slope| slope.is_finite()) =>
            {
                (evidence.minus_ln, self.free.iter().map(|g| evidence.gradient[*g]).collect())
            }
            _ => (UNUSABLE, vec![0.0; x.len()]),
        };
        *self.last.borrow_mut() = Some((x.to_vec(), value, slopes.clone()));
        (value, slopes)
    }
}

/// The same in units of its first slopes: a quasi-Newton search takes its first step along them, as long as they are.
struct Scaled<'a> {
    cost: &'a Cost<'a>,
    scale: f64,
}

impl CostFunction for Scaled<'_> {
    type Param = Vec<f64>;
    type Output = f64;

    fn cost(&self, x: &Vec<f64>) -> Result<f64, argmin::core::Error> {
        Ok(self.scale * self.cost.at(x).0)
    }
}

impl Gradient for Scaled<'_> {
    type Param = Vec<f64>;
    type Gradient = Vec<f64>;

    fn gradient(&self, x: &Vec<f64>) -> Result<Vec<f64>, argmin::core::Error> {
        Ok(self.cost.at(x).1.iter().map(|slope| self.scale * slope).collect())
    }
}

impl Cost<'_> {
    /// Steps that no slope makes too long, from where slopes are large to where the search has its right lengths; the objective never
    /// grows.
    fn approach(&self, start: &[f64], large_slope: f64) -> Vec<f64> {
        let mut x = start.to_vec();
        let (mut value, mut slopes) = self.at(&x);
        let mut longest = LONGEST_APPROACH;
        for _ in 0..MAX_APPROACHES {
            if slopes.iter().all(|slope| slope.abs() < large_slope) {
                break;
            }
            let step = |slope: &f64| (-slope / large_slope).clamp(-longest, longest);
            let next: Vec<f64> = x.iter().zip(&slopes).map(|(x, slope)| x + step(slope)).collect();
            let (next_value, next_slopes) = self.at(&next);
            if next_value < value {
                (x, value, slopes) = (next, next_value, next_slopes);
            } else {
                longest *= 0.3;
            }
        }
        x
    }
}

/// The logarithms of the free sizes at which the objective is least, from a start; as near as the search came where its line search gives
/// up. All other sizes are those of `sizes`.
pub(super) fn search(
    patterns: &Patterns,
    products: &Products,
    free: &[usize],
    sizes: &[f64],
    start: &[f64],
) -> Vec<f64> {
    let cost = Cost { patterns, products, free, start: sizes, last: RefCell::new(None) };
    let mut x = start.to_vec();
    for attempt in 0..MAX_STARTS {
        x = cost.approach(&x, LARGE_SLOPE / SMALLER_SLOPE.powi(attempt));
        let (value, slopes) = cost.at(&x);
        let steepest = slopes.iter().map(|slope| slope * slope).sum::<f64>().sqrt();
        let scale = 1.0 / steepest.max(1.0);
        let solver = MoreThuenteLineSearch::new()
            .with_bounds(1e-4, MAX_SIZE_STEP)
            .and_then(|line| LBFGS::new(line, 7).with_tolerance_cost(scale * MIN_DECREASE))
            .and_then(|solver| solver.with_tolerance_grad(scale * MIN_SLOPE));
        let run = solver.and_then(|solver| {
            Executor::new(Scaled { cost: &cost, scale }, solver)
                .configure(|state| state.param(x.clone()).max_iters(MAX_STEPS))
                .run()
        });
        let Ok(run) = run else { continue };
        let state = run.state();
        if let Some(best) = state.get_best_param().filter(|best| cost.at(best).0 <= value) {
            x.clone_from(best);
        }
        if !matches!(state.get_termination_reason(), Some(TerminationReason::SolverExit(_))) {
            break;
        }
    }
    x
}
