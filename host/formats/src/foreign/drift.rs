//! The drift between two clocks, from the ramps that both have recorded.
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

/// Force and displacement, whose times are stretched about a middle.
struct Search<'s> {
    force: &'s Series,
    displacement: &'s Series,
    middle_s: f64,
}

impl Search<'_> {
    /// The clock of an offset and a rate.
    fn clock(&self, [offset_s, rate]: [f64; 2]) -> Clock {
        Clock { offset_s, rate, about_s: self.middle_s }
    }

    fn correlation(&self, offset_and_rate: [f64; 2]) -> Option<Correlation> {
        let displacement = self.displacement.clone().on(&self.clock(offset_and_rate));
        correlated(self.force, &displacement, 0.0, FINE)
    }
}

/// The drift beside an offset, if the readings tell it.
pub(super) fn estimate(force: &Series, displacement: &Series, offset: &Offset) -> Option<Drift> {
    let [start_s, end_s] = displacement.span_s()?;
    let (middle_s, half_s) = (0.5 * (start_s + end_s), 0.5 * (end_s - start_s));
    let step_s = offset.sd_s.max(displacement.period_s());
    let search = Search { force, displacement, middle_s };
    let steps = [step_s, step_s / half_s];
    let (best, drifted) = climb([offset.offset_s, 0.0], steps, |at| search.correlation(at))?;
    let gain = likelihood_gain(&search.correlation([offset.offset_s, 0.0])?, &drifted);
    let (_, played) = climb([offset.offset_s, 0.0], [step_s, reach(displacement)], |[offset_s, width]| {
        let driven = displacement.clone().behind_play(width.abs());
        correlated(force, &driven, offset_s, FINE)
    })?;
    let [lower_gain, upper_gain] = [-1.0, 1.0].map(|sign| {
        search
            .correlation([best[0], best[1] + sign * steps[1]])
            .map(|other| likelihood_gain(&other, &drifted))
    });
    let bend = (lower_gain? + upper_gain?) / (steps[1] * steps[1]);
    let sd = if bend > 0.0 { bend.sqrt().recip() } else { f64::INFINITY };
    // One that puts no reading nearer to the place of its neighbour does not matter.
    let is_seen = best[1].abs() * half_s > 0.5 * displacement.period_s().max(force.period_s());
    (is_seen && gain > ALIKE && drifted.r2 > played.r2 && best[1].abs() > sd).then(|| Drift {
        rate: best[1],
        sd,
        r2: drifted.r2,
        clock: search.clock(best),
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Stairs of 1.5 s between these levels, with noise, on a clock that gains `rate` in a second and begins at `begin_s`.
    fn stairs(levels: &[f64], [begin_s, rate]: [f64; 2], noise: f64, seed: u64) -> Series {
        let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15);
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        };
        let value = |i: usize| {
            let (step, ramp_position) = (i / 75, (i % 75) as f64 / 15.0);
            let [start, end] = [levels[step.saturating_sub(1)], levels[step]];
            start + (end - start) * ramp_position.min(1.0)
        };
        let times_s = (0..75 * levels.len()).map(|i| begin_s + 0.02 * (1.0 + rate) * i as f64);
        Series::of(times_s.enumerate().map(|(i, time_s)| (time_s, value(i) + noise * random())).collect())
    }

    /// The drift of a displacement whose clock is this much ahead in the middle of the record.
    fn found(force: &Series, displacement: &Series, ahead_s: f64) -> Option<Drift> {
        estimate(force, displacement, &Offset { offset_s: -ahead_s, sd_s: 0.01, r2: 0.99 })
    }

    const LEVELS: [f64; 13] = [0.0, 1.0, 2.5, 1.0, 3.0, 2.0, 0.5, 2.5, 0.0, 1.5, 3.0, 0.5, 0.0];

    #[test]
    fn a_drift_is_found_and_its_interval_holds_it() {
        for (rate, noise) in [(5e-3, 0.02), (-5e-3, 0.02), (1e-2, 0.05), (-2e-3, 0.01)] {
            for seed in 1..=2 {
                let force = stairs(&LEVELS.map(|level| 0.6 * level), [0.0; 2], noise, seed);
                let displacement = stairs(&LEVELS, [12.0, rate], 1e-3, 100 + seed);
                let middle_s = 0.5 * 0.02 * (75 * LEVELS.len()) as f64;
                let drift = found(&force, &displacement, 12.0 + rate * middle_s)
                    .unwrap_or_else(|| panic!("none of {rate}"));
                let right = (1.0 + rate).recip() - 1.0;
                assert!((drift.rate - right).abs() < 4.0 * drift.sd, "{rate} {seed}: {drift:?}");
                // The last reading of the displacement is put to within two readings of its place.
                let end_s = displacement.span_s().expect("readings")[1];
                let right_s = 0.02 * (75 * LEVELS.len() - 1) as f64;
                assert!((drift.clock.time_s(end_s) - right_s).abs() < 0.04, "{rate} {seed}: {drift:?}");
            }
        }
    }

    #[test]
    fn clocks_that_do_not_drift_and_play_are_no_drift() {
        let protocols: [&[f64]; 4] =
            [&[0.0, 2.0, 0.0], &[0.0, 1.0, 2.5, 1.5, 3.0, 0.0], &[0.0, 1.0, 2.0, 3.0], &LEVELS];
        let mut named = Vec::new();
        for levels in protocols {
            for seed in 1..=4 {
                for play in [0.0, 0.3] {
                    let displacement = stairs(levels, [37.0, 0.0], 1e-3, 100 + seed);
                    let driven = stairs(levels, [0.0; 2], 0.0, 1).behind_play(play);
                    let noise = stairs(&vec![0.0; levels.len()], [0.0; 2], 0.03, seed);
                    let readings = driven.readings().zip(noise.readings());
                    let force =
                        Series::of(readings.map(|((time_s, y), (_, n))| (time_s, 0.6 * y + n)).collect());
                    named.extend(
                        found(&force, &displacement, 37.0)
                            .map(|drift| (levels.len(), seed, play, drift.rate)),
                    );
                }
            }
        }
        // 5 % of 32 are two; more than five have a chance of 1 % (binomial).
        assert!(named.len() <= 5, "{named:?}");
    }
}
