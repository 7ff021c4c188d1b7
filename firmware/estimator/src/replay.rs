//! The replay, which keeps the filter consistent: it takes in all rows again, one at a time, at the current parameters (theory,
//! eq. 54).

use super::filter::Filter;
use super::information::dot;
use super::needle::Shape;
use super::noise::StandardDeviations;
use super::{Row, Settings};
use nalgebra::{RealField, convert};

/// A second filter that goes through all rows again at fixed parameters.
#[derive(Debug, Clone)]
pub struct Replay<T: RealField, const M: usize, const C: usize, const N: usize> {
    filter: Filter<T, M, C, N>,
    next: usize,
    /// The best parameters of all complete replays, their number of rows, and their cost.
    best: Option<([T; N], usize, T)>,
    /// Cost of this replay at the number of rows of the best one.
    cost_then: T,
    halvings: u8,
    /// Number of consecutive replays that were too far from the best parameters to be accepted.
    far: u8,
    /// Number of rows of the last converged replay.
    settled_rows: usize,
    settled: bool,
}

/// A replay is far from the best parameters where a step would remove this fraction of its squared residuals, and this absolute
/// amount; the third number is the limit of consecutive ones.
const FAR_SHARE: f64 = 0.5;
const FAR_LEAST: f64 = 25.0;
const MAX_FAR: u8 = 10;
/// A step has made the fit worse where the squared residuals have grown by this factor and by this absolute amount. New rows
/// have come in the meantime, so that the fit of the older ones may lose a little.
const WORSE_SHARE: f64 = 1.3;
const WORSE_LEAST: f64 = 5.0;
/// A replay has converged where the squared length of its step, in standard deviations of all eighteen parameters together, is
/// below this.
const SETTLED: f64 = 1.0;
/// Largest number of halvings of a step.
const MAX_HALVINGS: u8 = 6;

impl<T: RealField + Copy, const M: usize, const C: usize, const N: usize> Replay<T, M, C, N> {
    /// Not begun.
    pub fn new(filter: &Filter<T, M, C, N>) -> Self {
        let mut filter = filter.clone();
        let start = filter.parameters;
        filter.restart(start);
        Self {
            filter,
            next: 0,
            best: None,
            cost_then: T::zero(),
            halvings: 0,
            far: 0,
            settled_rows: 0,
            settled: false,
        }
    }

    /// Whether the last replay changed nothing.
    pub fn is_settled(&self) -> bool {
        self.settled
    }

    /// Advances by one row. After the last row the live filter continues from this replay.
    pub fn step(
        &mut self,
        settings: &Settings<T, M>,
        shape: &Shape<T, M>,
        rows: &[Row<T>],
        deviation: StandardDeviations<T>,
        live: &mut Filter<T, M, C, N>,
    ) {
        // Pauses until there are a few more rows.
        if self.settled && rows.len() < self.settled_rows + 1 + self.settled_rows / 16 {
            return;
        }
        if let Some(row) = rows.get(self.next) {
            if self.filter.absorb(settings, shape, row, deviation).is_none() {
                self.begin(live.parameters);
                return;
            }
            self.next += 1;
            if self.best.is_some_and(|(_, rows, _)| rows == self.next) {
                self.cost_then = self.filter.cost;
            }
        } else if self.next > 0 {
            self.end(live);
        }
    }

    /// The rows were merged, so that all results of the old ones are discarded.
    pub fn renew(&mut self, live: &Filter<T, M, C, N>) {
        (self.best, self.halvings, self.far, self.settled, self.settled_rows) = (None, 0, 0, false, 0);
        self.begin(live.parameters);
    }

    fn begin(&mut self, parameters: [T; N]) {
        self.filter.restart(parameters);
        self.next = 0;
    }

    /// All rows are replayed.
    fn end(&mut self, live: &mut Filter<T, M, C, N>) {
        if let Some((best, rows, cost)) = self.best
            && self.halvings < MAX_HALVINGS
            && self.next < rows + rows / 4
            && self.cost_then > cost * convert(WORSE_SHARE) + convert(WORSE_LEAST)
        {
            // The fit is worse than before the step, so that the step is halved.
            self.halvings += 1;
            let mut midpoint = best;
            for (midpoint, here) in midpoint.iter_mut().zip(&self.filter.parameters) {
                *midpoint = (*midpoint + *here) * convert(0.5);
            }
            self.begin(midpoint);
            return;
        }
        self.halvings = 0;
        let filter = &mut self.filter;
        self.best = Some((filter.parameters, self.next, filter.cost));
        let target = filter.solution();
        // Converged where the step is small against the posterior's standard deviations.
        let mut misfit = T::zero();
        for index in 0..N {
            let (row, _) = filter.information.row(index);
            let mut step = target;
            step.iter_mut().zip(&filter.parameters).for_each(|(step, here)| *step -= *here);
            let row_change = dot(&row, &step);
            misfit += row_change * row_change;
        }
        // If the step would remove most of the misfit, it is long and its outcome uncertain. The live filter is then kept while
        // it fits better. The next replay begins at the end of the step, or, after many such replays, at the parameters of the
        // live filter.
        let is_converged = misfit < filter.squares * convert(FAR_SHARE) || misfit < convert(FAR_LEAST);
        if !is_converged && filter.squares > live.squares {
            self.far += 1;
            let mut next = live.parameters;
            if self.far < MAX_FAR {
                let step = filter.step_to(&target);
                next = filter.parameters;
                next.iter_mut().zip(step).for_each(|(next, step)| *next += step);
            } else {
                self.far = 0;
                self.best = None;
            }
            self.begin(next);
            return;
        }
        self.far = 0;
        self.settled = misfit < convert(SETTLED);
        self.settled_rows = self.next;
        filter.settled = self.settled;
        filter.latest = live.latest;
        *live = filter.clone();
        // Squared residuals after the step, to first order.
        live.squares = (live.squares - misfit).max(live.squares * convert(0.1));
        live.move_to(&target);
        self.begin(live.parameters);
    }
}
