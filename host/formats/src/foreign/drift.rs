//! How much faster one clock runs than another, from the ramps that both have recorded.
//!
//! An offset alone leaves a drift in the residuals: they fall where the times of the displacement are stretched about their middle. By the
//! likelihood ratio the drift counts at 95 %, as one parameter more. Play of a drive delays the ramps behind a reversal and looks like a drift where
//! there are few: the drift has to explain more than play of any width.

use super::align::{ALIKE, Clock, Correlation, FINE, Offset, correlated};
use super::apply::Series;

/// Times that the steps of the search are halved: to a sixty-fourth.
const HALVINGS: usize = 6;
/// Steps of the search at most.
const STEPS: usize = 200;

/// An estimated drift.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drift {
    /// Seconds that the displacement's clock loses in one.
    pub rate: f64,
    /// Its standard deviation.
    pub sd: f64,
    /// Share of the force that the displacement explains with it.
    pub r2: f64,
    /// The clock of the displacement on that of the force.
    pub(super) clock: Clock,
}

/// The drift beside an offset, if the readings tell it.
pub(super) fn estimate(force: &Series, displacement: &Series, offset: &Offset) -> Option<Drift> {
    let [start_s, end_s] = displacement.span_s()?;
    let (about_s, half_s) = (0.5 * (start_s + end_s), 0.5 * (end_s - start_s));
    let step_s = offset.sd_s.max(displacement.period_s());
    let clock = |[offset_s, rate]: [f64; 2]| Clock { offset_s, rate, about_s };
    let of_drift = |at: [f64; 2]| correlated(force, &displacement.clone().on(&clock(at)), 0.0, FINE);
    let steps = [step_s, step_s / half_s];
    let (best, drifted) = climb([offset.offset_s, 0.0], steps, of_drift)?;
    let gain = likelihood_gain(&of_drift([offset.offset_s, 0.0])?, &drifted);
    let (_, played) = climb([offset.offset_s, 0.0], [step_s, reach(displacement)], |[offset_s, width]| {
        let behind = displacement.clone().behind_play(width.abs());
        correlated(force, &behind, offset_s, FINE)
    })?;
    let [below, above] = [-1.0, 1.0].map(|sign| {
        of_drift([best[0], best[1] + sign * steps[1]]).map(|other| likelihood_gain(&other, &drifted))
    });
    let bend = (below? + above?) / (steps[1] * steps[1]);
    let sd = if bend > 0.0 { bend.sqrt().recip() } else { f64::INFINITY };
    (gain > ALIKE && drifted.r2 > played.r2 && best[1].abs() > sd).then(|| Drift {
        rate: best[1],
        sd,
        r2: drifted.r2,
        clock: clock(best),
    })
}

/// Log likelihood of one line over that of another, by the independent readings of the first.
fn likelihood_gain(other: &Correlation, best: &Correlation) -> f64 {
    0.5 * best.independent * ((1.0 - other.r2).max(1e-12) / (1.0 - best.r2).max(1e-12)).ln()
}

/// First width of play that is tried: a tenth of what the guide moves.
fn reach(displacement: &Series) -> f64 {
    let [least, most] =
        displacement.readings().fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], (_, value)| {
            [least.min(value), most.max(value)]
        });
    0.1 * (most - least)
}

/// The greatest correlation near a start, by steps along both axes that are halved where none is uphill.
fn climb(
    start: [f64; 2],
    mut steps: [f64; 2],
    of: impl Fn([f64; 2]) -> Option<Correlation>,
) -> Option<([f64; 2], Correlation)> {
    let mut best = (start, of(start)?);
    let mut halvings = 0;
    for _ in 0..STEPS {
        let [x, y] = best.0;
        let [dx, dy] = steps;
        let uphill = [[x + dx, y], [x - dx, y], [x, y + dy], [x, y - dy]]
            .into_iter()
            .filter_map(|at| Some((at, of(at)?)))
            .filter(|(_, correlation)| correlation.r2 > best.1.r2)
            .max_by(|a, b| a.1.r2.total_cmp(&b.1.r2));
        match uphill {
            Some(better) => best = better,
            None if halvings == HALVINGS => break,
            None => {
                halvings += 1;
                steps = steps.map(|step| 0.5 * step);
            }
        }
    }
    Some(best)
}
