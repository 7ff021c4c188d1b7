//! The offset between two clocks from what both have recorded: force follows displacement, so that their ramps fall together at one offset.
//!
//! With independent noise the log likelihood of an offset is `-n/2 ln(1 - r^2)`, where `r` is the correlation of both
//! series at it and `n` the number of independent readings; its curvature gives the standard deviation. Relaxation of
//! the tissue within a reading is not separated from an offset.

use super::apply::Series;
use super::summary::LEAST_RUN;

/// Readings of the longer series in the search, and around what it finds.
const COARSE: usize = 400;
const FINE: usize = 4_000;
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

/// Estimates the offset; `around_s` is where both series would start together.
///
/// # Errors
/// [`OffsetError`].
pub(super) fn estimate(force: &Series, displacement: &Series) -> Result<Offset, OffsetError> {
    let no_offset = OffsetError::Unlike { r2: 0.0 };
    let ([f0_s, f1_s], [d0_s, d1_s]) =
        (force.span_s().ok_or(no_offset.clone())?, displacement.span_s().ok_or(no_offset.clone())?);
    let (f_span_s, d_span_s) = (f1_s - f0_s, d1_s - d0_s);
    let overlap_s = OVERLAP * f_span_s.min(d_span_s);
    let [least_s, most_s] = [f0_s + overlap_s - d1_s, f1_s - overlap_s - d0_s];
    let step_s = (f_span_s.max(d_span_s) / COARSE as f64).max(1e-9);
    let count = ((most_s - least_s) / step_s).ceil() as usize;
    let candidates: Vec<(f64, f64)> = (0..=count)
        .map(|i| least_s + step_s * i as f64)
        .filter_map(|offset_s| Some((offset_s, correlated(force, displacement, offset_s, COARSE)?.r2)))
        .collect();
    let best = candidates.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1)).ok_or(no_offset.clone())?;
    let best_offset = refined(force, displacement, best.0, step_s).ok_or(no_offset)?;
    if best_offset.offset.r2 < LEAST_R2 {
        return Err(OffsetError::Unlike { r2: best_offset.offset.r2 });
    }
    // The best of the other peaks.
    fn is_peak(at: usize, candidates: &[(f64, f64)]) -> bool {
        fn r2(at: usize, candidates: &[(f64, f64)]) -> f64 {
            candidates.get(at).map_or(f64::NEG_INFINITY, |(_, r2)| *r2)
        }
        let value = r2(at, candidates);
        value >= r2(at.wrapping_sub(1), candidates) && value >= r2(at + 1, candidates)
    }
    fn is_far(offset_s: f64, step_s: f64, best_0: f64) -> bool {
        (offset_s - best_0).abs() > 2.5 * step_s
    }
    let other_peaks = candidates
        .iter()
        .enumerate()
        .filter(|(at, (offset_s, _))| is_peak(*at, &candidates) && is_far(*offset_s, step_s, best.0));
    let second = other_peaks
        .map(|(_, one)| *one)
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .and_then(|(offset_s, _)| refined(force, displacement, offset_s, step_s));
    if let Some(second) = second
        && 0.5
            * best_offset.independent
            * ((1.0 - second.offset.r2) / (1.0 - best_offset.offset.r2).max(1e-12)).ln()
            < ALIKE
    {
        let [first_s, second_s] = [best_offset, second].map(|one| one.offset.offset_s);
        return Err(OffsetError::Ambiguous { first_s, second_s });
    }
    Ok(best_offset.offset)
}

#[derive(Clone, Copy)]
struct Peak {
    offset: Offset,
    independent: f64,
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
    Some(Peak { offset, independent: best.independent })
}

/// A line through pairs, and how much of the second number it explains.
#[derive(Debug, Clone, Copy)]
pub(super) struct Correlation {
    pub slope: f64,
    r2: f64,
    /// Number of independent readings, by the residuals of neighbours.
    independent: f64,
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
        Some(Self { slope, r2: xy * xy / (xx * yy), independent })
    }

    /// Log likelihood of the line beside none.
    pub fn log_likelihood(&self) -> f64 {
        -0.5 * self.independent * (1.0 - self.r2).max(1e-12).ln()
    }
}

/// Correlation of force and displacement at an offset, over so many readings of their overlap.
fn correlated(force: &Series, displacement: &Series, offset_s: f64, most: usize) -> Option<Correlation> {
    let ([f0_s, f1_s], [d0_s, d1_s]) = (force.span_s()?, displacement.span_s()?);
    let (start_s, end_s) = (f0_s.max(d0_s + offset_s), f1_s.min(d1_s + offset_s));
    let period_s = force.period_s().max(displacement.period_s()).max((end_s - start_s) / most as f64);
    let count = ((end_s - start_s) / period_s).floor().max(0.0) as usize;
    let pairs: Vec<(f64, f64)> = (0..=count)
        .filter_map(|i| {
            let sample_s = start_s + period_s * i as f64;
            Some((displacement.at(sample_s - offset_s)?, force.at(sample_s)?))
        })
        .collect();
    if pairs.len() < LEAST_RUN {
        return None;
    }
    Correlation::of(&pairs)
}
