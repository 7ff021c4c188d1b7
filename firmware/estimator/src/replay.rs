//! The replay that keeps the filter consistent: all rows again, one at a time, at the current parameters
//! (theory, eq. 54).

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
    /// The best parameters of all whole replays, the number of their rows, and their cost.
    best: Option<([T; N], usize, T)>,
    /// Cost of this replay when it had as many rows as the best one.
    cost_then: T,
    halvings: u8,
    /// Replays in a row that were too far from the best parameters to be accepted.
    far: u8,
    /// Rows of the last replay whose parameters came to rest.
    settled_rows: usize,
    settled: bool,
}

/// A replay is far from the best parameters where this share of its squared deviations, and this much, would be gone with a
/// step; so many of them in a row.
const FAR_SHARE: f64 = 0.5;
const FAR_LEAST: f64 = 25.0;
const MAX_FAR: u8 = 10;
/// A step has made the fit worse where deviations have grown by this factor and this much. The kept rows are the newest
/// ones too: the older ones may well lose a little.
const WORSE_SHARE: f64 = 1.3;
const WORSE_LEAST: f64 = 5.0;
/// A replay has come to rest where its step is this short, squared, in standard deviations of the eighteen parameters together.
const SETTLED: f64 = 1.0;
/// Most halvings of a step.
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

    /// One row further; or, behind the last one, the live filter continues from here.
    pub fn step(
        &mut self,
        settings: &Settings<T, M>,
        shape: &Shape<T, M>,
        rows: &[Row<T>],
        deviation: StandardDeviations<T>,
        live: &mut Filter<T, M, C, N>,
    ) {
        // Rest until there are a few more rows.
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

    /// The rows are others now: everything that was found with the old ones is forgotten.
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
            // Worse than where it came from: half the way back.
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
        // At rest where the step is small against what is not known.
        let mut misfit = T::zero();
        for index in 0..N {
            let (row, _) = filter.information.row(index);
            let mut step = target;
            step.iter_mut().zip(&filter.parameters).for_each(|(step, here)| *step -= *here);
            let row_change = dot(&row, &step);
            misfit += row_change * row_change;
        }
        // If most of the misfit would vanish with the step, the step is long and its outcome not certain. While the
        // live filter does better it is not replaced: the next replay begins at the step's end, and after many of them
        // where the live filter is.
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
        // Deviations that remain after the step, to first order.
        live.squares = (live.squares - misfit).max(live.squares * convert(0.1));
        live.move_to(&target);
        self.begin(live.parameters);
    }
}
