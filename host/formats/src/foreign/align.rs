//! The offset between two clocks from what both have recorded: force follows displacement, so that their ramps fall together at one offset.
//!
//! With independent noise the log likelihood of an offset is `-n/2 ln(1 - r^2)`, where `r` is the correlation of both
//! series at it and `n` the number of independent readings; its curvature gives the standard deviation. Relaxation of
//! the tissue within a reading is not separated from an offset.

use super::apply::Series;
use super::summary::LEAST_RUN;
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

/// Readings of the longer series in the search, and around what it finds.
const COARSE: usize = 400;
pub(super) const FINE: usize = 4_000;
/// Both series overlap by this share of the shorter one.
const OVERLAP: f64 = 0.5;
/// Least share of the force that the displacement explains.
const LEAST_R2: f64 = 0.5;
/// Two offsets whose log likelihoods differ by less are not told apart: 95 % of a chi-square of one degree of freedom, halved.
pub(super) const ALIKE: f64 = 1.92;

/// An estimated offset.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Offset {
    /// To be added to times of the displacement.
    pub offset_s: f64,
    /// Its standard deviation.
    pub sd_s: f64,
    /// Share of the force that the displacement explains there.
    pub r2: f64,
}

/// Why there is none.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum OffsetError {
    /// The series have nothing in common.
    #[error(
        "the two clocks: displacement explains {:.0} % of the force at best, expected ramps in both files: --merge-on COLUMN where they share a \
         clock, or --offset-s", 100.0 * r2
    )]
    Unlike {
        /// Greatest share that is explained.
        r2: f64,
    },
    /// Several are alike.
    #[error(
        "the two clocks: offsets of {first_s:.3} and {second_s:.3} s fit alike, expected ramps that are no repetition of each other: --merge-on COLUMN \
         where they share a clock, or --offset-s"
    )]
    Ambiguous {
        /// The best one.
        first_s: f64,
        /// Another one.
        second_s: f64,
    },
}

/// From the times of one clock to those of another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Clock {
    pub offset_s: f64,
    /// Seconds that it gains in one, from `about_s` on.
    pub rate: f64,
    pub about_s: f64,
}

impl Clock {
    /// One that is later, and no faster.
    pub fn shift(offset_s: f64) -> Self {
        Self { offset_s, rate: 0.0, about_s: 0.0 }
    }

    pub fn time_s(&self, time_s: f64) -> f64 {
        time_s + self.offset_s + self.rate * (time_s - self.about_s)
    }
}

/// Estimates the offset.
///
/// # Errors
/// [`OffsetError`].
pub(super) fn estimate(force: &Series, displacement: &Series) -> Result<Offset, OffsetError> {
    let (best, alike) = search(force, displacement)?;
    match alike {
        None => Ok(best.offset),
        Some(other) => {
            let [first_s, second_s] = [best, other].map(|one| one.offset.offset_s);
            Err(OffsetError::Ambiguous { first_s, second_s })
        }
    }
}

/// The offset to be added to times of a displacement at which a force follows it, if the readings tell it from none: times in their order, each with a
/// reading.
pub fn clock_contradiction(force: &[(f64, f64)], displacement: &[(f64, f64)]) -> Option<Offset> {
    contradiction(&Series::of(force.to_vec()), &Series::of(displacement.to_vec()))
}

/// The offset at which force follows displacement, if the readings tell it from none: for series that are taken to have one clock.
pub(super) fn contradiction(force: &Series, displacement: &Series) -> Option<Offset> {
    let (best, _) = search(force, displacement).ok()?;
    let correlation = correlated(force, displacement, 0.0, FINE)?;
    let unshifted = Peak { offset: Offset { offset_s: 0.0, sd_s: 0.0, r2: correlation.r2 }, correlation };
    // Two standard deviations, as in the program's intervals of 95 %.
    let is_other = best.offset.offset_s.abs() > 2.0 * best.offset.sd_s && !best.is_like(&unshifted);
    is_other.then_some(best.offset)
}

/// The likeliest offset, and another one that fits alike.
fn search(force: &Series, displacement: &Series) -> Result<(Peak, Option<Peak>), OffsetError> {
    let no_offset = OffsetError::Unlike { r2: 0.0 };
    let ([f0_s, f1_s], [d0_s, d1_s]) =
        (force.span_s().ok_or(no_offset.clone())?, displacement.span_s().ok_or(no_offset.clone())?);
    let (f_span_s, d_span_s) = (f1_s - f0_s, d1_s - d0_s);
    let overlap_s = OVERLAP * f_span_s.min(d_span_s);
    let [least_s, most_s] = [f0_s + overlap_s - d1_s, f1_s - overlap_s - d0_s];
    let step_s = (f_span_s.max(d_span_s) / COARSE as f64).max(1e-9);
    let count = ((most_s - least_s) / step_s).ceil() as usize;
    // By the likelihood of all readings, of which those beyond the overlap have that of no relation: a staircase that goes up and down falls
    // on itself turned over, too, by half of its length.
    let candidates: Vec<(f64, f64)> = (0..=count)
        .map(|i| least_s + step_s * i as f64)
        .filter_map(|offset_s| {
            Some((offset_s, correlated(force, displacement, offset_s, COARSE)?.log_likelihood()))
        })
        .collect();
    let best = candidates.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1)).ok_or(no_offset.clone())?;
    let best_offset = refined(force, displacement, best.0, step_s).ok_or(no_offset)?;
    if best_offset.offset.r2 < LEAST_R2 {
        return Err(OffsetError::Unlike { r2: best_offset.offset.r2 });
    }
    let peaks = (0..candidates.len())
        .filter(|at| is_peak(*at, &candidates))
        .filter_map(|at| candidates.get(at))
        .filter(|(offset_s, _)| (offset_s - best.0).abs() > 2.5 * step_s);
    let alike: Option<Peak> = peaks
        .filter_map(|(offset_s, _)| refined(force, displacement, *offset_s, step_s))
        .find(|other| best_offset.is_like(other));
    Ok((best_offset, alike))
}

/// Whether one of the candidates is above its neighbours.
fn is_peak(at: usize, candidates: &[(f64, f64)]) -> bool {
    let ln_at = |at: usize| candidates.get(at).map_or(f64::NEG_INFINITY, |(_, ln)| *ln);
    ln_at(at) >= ln_at(at.wrapping_sub(1)) && ln_at(at) >= ln_at(at + 1)
}

#[derive(Clone, Copy)]
struct Peak {
    offset: Offset,
    correlation: Correlation,
}

impl Peak {
    /// Whether the readings do not tell another offset from this one, the likeliest. The residuals of the two are of other readings, and by
    /// chance one variance is the larger one: it has to be so by an F-test at 95 %. Ramps that repeat fit on themselves a period later. On
    /// themselves turned over they fit by a part; there the number of readings decides that each explains, with the worse residuals for both.
    fn is_like(&self, other: &Self) -> bool {
        let [variance, other_variance] = [self, other].map(|peak| (1.0 - peak.offset.r2).max(1e-12));
        let [own_count, other_count] = [self, other].map(|peak| peak.correlation.independent);
        let by_chance = FisherSnedecor::new(other_count, own_count).map_or(1.0, |f| f.inverse_cdf(0.95));
        if other_variance > by_chance * variance {
            return false;
        }
        let is_turned = self.correlation.slope * other.correlation.slope < 0.0;
        let more = own_count * (1.0 - other.correlation.count / self.correlation.count);
        !is_turned || 0.5 * more * -variance.max(other_variance).ln() < ALIKE
    }
}

/// The offset with the greatest correlation near one, by a parabola through the log likelihood.
fn refined(force: &Series, displacement: &Series, near_s: f64, step_s: f64) -> Option<Peak> {
    fn at(offset_s: f64, force: &Series, displacement: &Series) -> Option<Correlation> {
        correlated(force, displacement, offset_s, FINE)
    }
    let (mut centre_s, mut reach_s) = (near_s, step_s);
    let mut finest = None;
    // Halved until it is within a sixteenth of the search's step.
    for _ in 0..5 {
        let five: Vec<(f64, Correlation)> = (-2..=2)
            .filter_map(|i| {
                let offset_s = centre_s + 0.5 * reach_s * f64::from(i);
                Some((offset_s, at(offset_s, force, displacement)?))
            })
            .collect();
        let best = five.iter().copied().max_by(|a, b| a.1.r2.total_cmp(&b.1.r2))?;
        centre_s = best.0;
        reach_s *= 0.5;
        finest = Some(best);
    }
    let (_, best) = finest?;
    let spread_s = step_s;
    fn loss(c: Correlation, best_independent: f64) -> f64 {
        0.5 * best_independent * (1.0 - c.r2).max(1e-12).ln()
    }
    let (lower_loss, upper_loss) = (
        loss(at(centre_s - spread_s, force, displacement)?, best.independent),
        loss(at(centre_s + spread_s, force, displacement)?, best.independent),
    );
    let bend = (lower_loss - 2.0 * loss(best, best.independent) + upper_loss) / (spread_s * spread_s);
    let slope = (upper_loss - lower_loss) / (2.0 * spread_s);
    let (shift_s, sd_s) = if bend > 0.0 {
        ((-slope / bend).clamp(-0.5 * reach_s, 0.5 * reach_s), bend.sqrt().recip())
    } else {
        (0.0, spread_s)
    };
    // Readings are at their own times, up to half a period of both beside a change.
    let periods_s = force.period_s().hypot(displacement.period_s()) / 12f64.sqrt();
    let offset = Offset { offset_s: centre_s + shift_s, sd_s: sd_s.hypot(periods_s), r2: best.r2 };
    Some(Peak { offset, correlation: best })
}

/// A line through pairs, and how much of the second number it explains.
#[derive(Debug, Clone, Copy)]
pub(super) struct Correlation {
    pub slope: f64,
    pub r2: f64,
    /// Number of independent readings, by the residuals of neighbours.
    pub independent: f64,
    /// Number of readings.
    count: f64,
}

impl Correlation {
    /// None where either number is always the same.
    pub fn of(pairs: &[(f64, f64)]) -> Option<Self> {
        let n = pairs.len() as f64;
        fn mean(of: fn(&(f64, f64)) -> f64, pairs: &[(f64, f64)], n: f64) -> f64 {
            pairs.iter().map(of).sum::<f64>() / n
        }
        let (x0, y0) = (mean(|pair| pair.0, pairs, n), mean(|pair| pair.1, pairs, n));
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for (x, y) in pairs {
            (xx, xy, yy) = (xx + (x - x0).powi(2), xy + (x - x0) * (y - y0), yy + (y - y0).powi(2));
        }
        if xx <= 0.0 || yy <= 0.0 {
            return None;
        }
        let slope = xy / xx;
        let residuals: Vec<f64> = pairs.iter().map(|(x, y)| y - y0 - slope * (x - x0)).collect();
        let squares: f64 = residuals.iter().map(|r| r * r).sum();
        let next: f64 = residuals.iter().zip(residuals.iter().skip(1)).map(|(a, b)| a * b).sum();
        let rho = if squares > 0.0 { (next / squares).clamp(0.0, 0.99) } else { 0.0 };
        let independent = (n * (1.0 - rho) / (1.0 + rho)).max(3.0);
        Some(Self { slope, r2: xy * xy / (xx * yy), independent, count: n })
    }

    /// Log likelihood of the line beside none.
    pub fn log_likelihood(&self) -> f64 {
        -0.5 * self.independent * (1.0 - self.r2).max(1e-12).ln()
    }
}

/// Correlation of force and displacement at an offset, at so many readings of the force in their overlap: between readings its noise would be
/// smaller, and offsets that put them there likelier.
pub(super) fn correlated(
    force: &Series,
    displacement: &Series,
    offset_s: f64,
    most: usize,
) -> Option<Correlation> {
    let ([f0_s, f1_s], [d0_s, d1_s]) = (force.span_s()?, displacement.span_s()?);
    let (start_s, end_s) = (f0_s.max(d0_s + offset_s), f1_s.min(d1_s + offset_s));
    let period_s = displacement.period_s().max((end_s - start_s) / most as f64);
    let stride = (period_s / force.period_s()).round().max(1.0) as usize;
    let pairs: Vec<(f64, f64)> = force
        .between(start_s, end_s)
        .iter()
        .step_by(stride)
        .filter_map(|(time_s, value)| Some((displacement.at(time_s - offset_s)?, *value)))
        .collect();
    if pairs.len() < LEAST_RUN {
        return None;
    }
    Correlation::of(&pairs)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Stairs of 1.5 s, with noise of a generator of its own.
    fn stairs(levels: &[f64], begin_s: f64, noise: f64, seed: u64) -> Series {
        let mut state = seed;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        };
        let count = 75 * levels.len();
        let value = |i: usize| {
            let (step, ramp_position) = (i / 75, (i % 75) as f64 / 15.0);
            let [start, end] = [levels[step.saturating_sub(1)], levels[step]];
            start + (end - start) * ramp_position.min(1.0)
        };
        Series::of((0..count).map(|i| (begin_s + 0.02 * i as f64, value(i) + noise * random())).collect())
    }

    /// Up and down again, it falls on itself turned over by half of its length, whose residuals are smaller by chance in half of all draws.
    #[test]
    fn a_staircase_is_not_joined_turned_over() {
        for levels in [&[0.0, 2.0, 0.0][..], &[0.0, 1.0, 2.0, 1.0, 0.0], &[0.0, 1.0, 2.5, 1.5, 3.0, 0.0]] {
            for seed in 1..=12 {
                for sign in [1.0, -1.0] {
                    let forces: Vec<f64> = levels.iter().map(|level| 0.6 * sign * level).collect();
                    let force = stairs(&forces, 0.0, 0.03, seed);
                    let displacement = stairs(levels, 37.0, 0.01, 100 + seed);
                    match estimate(&force, &displacement) {
                        Ok(found) => {
                            assert!(
                                (found.offset_s + 37.0).abs() < 0.05,
                                "{levels:?} {seed} {sign}: {found:?}"
                            );
                        }
                        Err(error) => panic!("{levels:?} {seed} {sign}: {error}"),
                    }
                }
            }
        }
    }
}
