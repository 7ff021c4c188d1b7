//! Chooses the candidate of each frame that is the needle: decided by the whole sequence, since a needle is one
//! smooth curve.
//!
//! 1. Curves of second order through candidates of three frames are drawn at random, likely ones first, and the one is kept that has the
//!    most of the sequence's echoes near it. Two of the three are drawn; the one between them is each that a needle through both can have:
//!    of frames with twenty echoes one pair in a hundred is the needle, and one triple in some thousands.
//! 2. A spline with the prior of a beam ([`crate::curve`]) is fitted to the nearest candidates, with a gate that closes to what the
//!    residuals need.
//! 3. The errors of the echoes are estimated with what neighbours share ([`noise`]).
//! 4. A second curve with about as many echoes is another needle, a wire or the screen: then nothing is decided.

use crate::curve::{Curve, Knot};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

mod noise;
pub use noise::Noise;

/// A candidate in space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Echo {
    /// Position across the needle, `[x, y]`, millimetres.
    pub across_mm: [f64; 2],
    /// Position along the needle, millimetres.
    pub z_mm: f64,
    /// Standard deviations of the position across, from the image.
    pub sd_mm: [f64; 2],
    /// Contrast.
    pub score: f64,
}

/// Decision about a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Decision {
    /// No candidate.
    NoEcho,
    /// No candidate is near the sequence; the distance of the nearest.
    Outlier {
        /// Millimetres.
        distance_mm: f64,
    },
    /// Two candidates are, and about as bright.
    Ambiguous,
    /// One is.
    Used {
        /// Its number.
        echo: usize,
    },
}

/// A needle through a sequence.
#[derive(Debug, Clone)]
pub struct Track {
    /// Decision about each frame.
    pub decisions: Vec<Decision>,
    /// Smooth curves through the used echoes, `[x, y]`.
    pub curves: [Curve; 2],
    /// Errors of echoes, `[x, y]`.
    pub noise: [Noise; 2],
}

impl Track {
    /// Successive frames that share their error, since they have the same speckle: along the axis where they are more.
    pub fn correlated_frames(&self) -> f64 {
        self.noise.iter().map(|noise| noise.correlated_frames).fold(1.0, f64::max)
    }
}

/// Why there is no track.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TrackError {
    /// Hardly any echo.
    #[error("{found} of {frames} frames have an echo on one smooth curve, expected {least} or more")]
    NoNeedle {
        /// Frames on the best curve.
        found: usize,
        /// Frames of the sequence.
        frames: usize,
        /// Fewest.
        least: usize,
    },
    /// Two curves explain the sequence about equally well.
    #[error(
        "two smooth curves have about as many echoes: at x {:.1} y {:.1} mm and at x {:.1} y {:.1} mm in the middle of the sequence; \
         expected one needle: limit the frames to it with --region",
        first[0], first[1], second[0], second[1]
    )]
    Ambiguous {
        /// Position of the first in the middle of the sequence.
        first: [f64; 2],
        /// Position of the second.
        second: [f64; 2],
    },
}

/// Half width of the tube around a curve of second order in which echoes count, millimetres: a bent needle is nearly of second order.
const TUBE_MM: f64 = 0.6;
/// Curves that are drawn.
const DRAWS: usize = 3000;
/// Least distance along the needle of two echoes that a curve goes through.
const MIN_APART_MM: f64 = 1e-3;
/// Steepest slope and strongest bending of a needle that guides push.
const MAX_SLOPE: f64 = 0.5;
const MAX_BEND_PER_MM: f64 = 0.02;
/// Fewest frames of a track.
const MIN_USED: usize = 8;
/// Least share of the frames that have an echo near the curve.
const MIN_SHARE: f64 = 0.2;
/// A second curve makes the sequence ambiguous from this share of the first one's echoes.
const AMBIGUOUS_SHARE: f64 = 0.75;
/// Gate in standard deviations, and least gate.
const GATE_SD: f64 = 4.0;
const MIN_GATE_MM: f64 = 0.02;
/// An echo is about as bright as another from this share of its contrast.
const ALIKE: f64 = 0.5;

/// Follows the needle through the frames' candidates. The seed only orders the search.
///
/// # Errors
/// [`TrackError`].
pub fn follow(frames: &[Vec<Echo>], seed: u64) -> Result<Track, TrackError> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let (count, least) = (frames.len(), MIN_USED.max(frames.len() / 5));
    let (score, arc) = search(frames, None, &mut random).ok_or_else(|| no_needle(0, count, least))?;
    // Few echoes are near one curve by chance.
    if score < MIN_SHARE {
        return Err(no_needle((score * count as f64) as usize, count, least));
    }
    let middle_mm = middle(frames);
    let other_arc =
        search(frames, Some(&arc), &mut random).filter(|(other, _)| *other > AMBIGUOUS_SHARE * score);
    if let Some((_, other_arc)) = other_arc {
        return Err(TrackError::Ambiguous { first: arc.at(middle_mm), second: other_arc.at(middle_mm) });
    }
    let mut gate_mm = [TUBE_MM; 2];
    let mut place = |z_mm: f64| arc.at(z_mm);
    let mut fitted = refit(frames, &mut place, gate_mm).ok_or_else(|| no_needle(0, count, least))?;
    for _ in 0..12 {
        let previous_gate_mm = gate_mm;
        for (gate_mm, needed_mm) in gate_mm.iter_mut().zip(fitted.gate_mm) {
            *gate_mm = needed_mm.clamp(MIN_GATE_MM, *gate_mm);
        }
        let curves = fitted.curves.clone();
        fitted = refit(frames, &mut |z_mm| [0, 1].map(|axis: usize| curves[axis].at(z_mm)), gate_mm)
            .ok_or_else(|| no_needle(0, count, least))?;
        if previous_gate_mm == gate_mm {
            break;
        }
    }
    let curves = fitted.curves;
    let decisions: Vec<Decision> = frames.iter().map(|echoes| decide(echoes, &curves, gate_mm)).collect();
    let used_count = decisions.iter().filter(|decision| matches!(decision, Decision::Used { .. })).count();
    if used_count < least {
        return Err(no_needle(used_count, count, least));
    }
    let echoes = used_echoes(frames, &decisions);
    let noise = [0, 1].map(|axis: usize| {
        let alone = Noise { scale: fitted.scale[axis], correlated_frames: 1.0 };
        Noise::of(&echoes, axis).unwrap_or(alone)
    });
    Ok(Track { decisions, curves, noise })
}

fn no_needle(found: usize, count: usize, least: usize) -> TrackError {
    TrackError::NoNeedle { found, frames: count, least }
}

/// A curve of second order in both directions, through three echoes.
#[derive(Debug, Clone, Copy)]
struct Arc {
    z_mm: [f64; 3],
    value_mm: [[f64; 3]; 2],
    /// Divided differences (Newton): computed once, as an arc is evaluated at every echo.
    slope: [f64; 2],
    bend_per_mm: [f64; 2],
}

impl Arc {
    /// Through echoes in the order of their places along the needle.
    fn through(echoes: [Echo; 3]) -> Option<Self> {
        let z_mm @ [a, b, c] = echoes.map(|echo| echo.z_mm);
        if b - a < MIN_APART_MM || c - b < MIN_APART_MM {
            return None;
        }
        let value_mm = [0, 1].map(|axis: usize| echoes.map(|echo| echo.across_mm[axis]));
        let slope = value_mm.map(|values| (values[1] - values[0]) / (b - a));
        let next = value_mm.map(|values| (values[2] - values[1]) / (c - b));
        let bend_per_mm = [0, 1].map(|axis: usize| (next[axis] - slope[axis]) / (c - a));
        Some(Self { z_mm, value_mm, slope, bend_per_mm })
    }

    fn at(&self, z_mm: f64) -> [f64; 2] {
        let [a, b, _] = self.z_mm;
        [0, 1].map(|axis: usize| {
            self.value_mm[axis][0] + (z_mm - a) * (self.slope[axis] + (z_mm - b) * self.bend_per_mm[axis])
        })
    }

    /// Share of the frames that have an echo near it, less for echoes that are darker than others of their frame, or further off; nothing
    /// where it is `least` or less.
    fn share(&self, frames: &[Vec<(Echo, f64)>], least: f64) -> Option<f64> {
        let count = frames.len() as f64;
        let (mut sum, mut most) = (0.0, count);
        for frame in frames {
            let frame_likelihood = self.frame_share(frame);
            sum += frame_likelihood;
            most -= 1.0 - frame_likelihood;
            // Nor can the frames that are left make it better.
            if most <= least * count {
                return None;
            }
        }
        Some(sum / count)
    }

    fn frame_share(&self, frame: &[(Echo, f64)]) -> f64 {
        frame
            .iter()
            .map(|(echo, weight)| {
                let curve_mm = self.at(echo.z_mm);
                let square =
                    (echo.across_mm[0] - curve_mm[0]).powi(2) + (echo.across_mm[1] - curve_mm[1]).powi(2);
                weight * (1.0 - square / (TUBE_MM * TUBE_MM))
            })
            .fold(0.0, f64::max)
    }

    /// Whether a needle can have it.
    fn is_needle(&self) -> bool {
        let [_, b, c] = self.z_mm;
        [0, 1].into_iter().all(|axis: usize| {
            let next = (self.value_mm[axis][2] - self.value_mm[axis][1]) / (c - b);
            let bend_per_mm = 2.0 * self.bend_per_mm[axis];
            self.slope[axis].abs() <= MAX_SLOPE
                && next.abs() <= MAX_SLOPE
                && bend_per_mm.abs() <= MAX_BEND_PER_MM
        })
    }
}

fn middle(frames: &[Vec<Echo>]) -> f64 {
    let z_mm = || frames.iter().flatten().map(|echo| echo.z_mm);
    0.5 * (z_mm().fold(f64::INFINITY, f64::min) + z_mm().fold(f64::NEG_INFINITY, f64::max))
}

/// The arc with the most echoes, and their share of the frames; echoes on another arc count for nothing.
fn search(frames: &[Vec<Echo>], without: Option<&Arc>, random: &mut ChaCha8Rng) -> Option<(f64, Arc)> {
    let step = frames.len().div_ceil(150).max(1);
    let mut sample: Vec<Vec<(Echo, f64)>> = Vec::new();
    for echoes in frames.iter().step_by(step) {
        let best = echoes.iter().map(|echo| echo.score).fold(f64::MIN_POSITIVE, f64::max);
        let of_frame: Vec<_> = echoes
            .iter()
            .filter(|echo| without.is_none_or(|arc| distance(echo, arc.at(echo.z_mm)) > 1.5 * TUBE_MM))
            .map(|echo| (*echo, (echo.score / best).sqrt()))
            .collect();
        if !of_frame.is_empty() {
            sample.push(of_frame);
        }
    }
    sample.sort_by(|a, b| first_z_mm(a).total_cmp(&first_z_mm(b)));
    let thirds = [0, sample.len() / 3, 2 * sample.len() / 3, sample.len()];
    if sample.len() < 3 {
        return None;
    }
    let mut best = None;
    for _ in 0..DRAWS {
        let mut frame = |third: usize| {
            sample.get(random.random_range(thirds[third]..thirds[third + 1].max(thirds[third] + 1)))
        };
        let [first, middle, last] = [frame(0)?, frame(1)?, frame(2)?];
        let (Some(a), Some(c)) = (likely(first, random), likely(last, random)) else { continue };
        for (b, _) in middle {
            let Some(arc) = Arc::through([a, *b, c]).filter(Arc::is_needle) else { continue };
            let most = best.map_or(0.0, |(most, _)| most);
            best = arc.share(&sample, most).map(|share| (share, arc)).or(best);
        }
    }
    best
}

fn first_z_mm(frame: &[(Echo, f64)]) -> f64 {
    frame.first().map_or(0.0, |(echo, _)| echo.z_mm)
}

/// An echo of a frame, drawn by its weight.
fn likely(frame: &[(Echo, f64)], random: &mut ChaCha8Rng) -> Option<Echo> {
    let total: f64 = frame.iter().map(|(_, weight)| weight).sum();
    let mut remaining = random.random_range(0.0..1.0) * total;
    let reached = frame.iter().find(|(_, weight)| {
        remaining -= weight;
        remaining <= 0.0
    });
    reached.or(frame.last()).map(|(echo, _)| *echo)
}

fn distance(echo: &Echo, at_mm: [f64; 2]) -> f64 {
    (echo.across_mm[0] - at_mm[0]).hypot(echo.across_mm[1] - at_mm[1])
}

/// Distance in gates.
fn in_gates(echo: &Echo, at_mm: [f64; 2], gate_mm: [f64; 2]) -> f64 {
    ((echo.across_mm[0] - at_mm[0]) / gate_mm[0]).hypot((echo.across_mm[1] - at_mm[1]) / gate_mm[1])
}

/// Curves with what their residuals say.
struct Refit {
    curves: [Curve; 2],
    scale: [f64; 2],
    gate_mm: [f64; 2],
}

/// Fits curves to the nearest echoes in a gate around a place.
fn refit(frames: &[Vec<Echo>], place: &mut dyn FnMut(f64) -> [f64; 2], gate_mm: [f64; 2]) -> Option<Refit> {
    let mut nearest: Vec<Echo> = Vec::new();
    for echoes in frames {
        let mut best: Option<(f64, Echo)> = None;
        for echo in echoes {
            let distance = in_gates(echo, place(echo.z_mm), gate_mm);
            if distance <= 1.0 && best.is_none_or(|(least, _)| distance < least) {
                best = Some((distance, *echo));
            }
        }
        nearest.extend(best.map(|(_, echo)| echo));
    }
    let fit = |axis: usize| {
        let knots: Vec<Knot> = nearest
            .iter()
            .map(|echo| Knot { z_mm: echo.z_mm, value_mm: echo.across_mm[axis], sd_mm: echo.sd_mm[axis] })
            .collect();
        let curve = Curve::fit(&knots)?;
        let freedom = knots.len().checked_sub(curve.parameters()).filter(|freedom| *freedom > 0)? as f64;
        let squares: f64 =
            knots.iter().map(|knot| ((knot.value_mm - curve.at(knot.z_mm)) / knot.sd_mm).powi(2)).sum();
        let mut deviations: Vec<f64> =
            knots.iter().map(|knot| (knot.value_mm - curve.at(knot.z_mm)).abs()).collect();
        deviations.sort_by(f64::total_cmp);
        let spread_mm = 1.4826
            * deviations.get(deviations.len() / 2).copied().unwrap_or(0.0)
            * (knots.len() as f64 / freedom).sqrt();
        Some((curve, (squares / freedom).sqrt(), GATE_SD * spread_mm))
    };
    let (x, y) = (fit(0)?, fit(1)?);
    Some(Refit { curves: [x.0, y.0], scale: [x.1, y.1], gate_mm: [x.2, y.2] })
}

fn decide(echoes: &[Echo], curves: &[Curve; 2], gate_mm: [f64; 2]) -> Decision {
    let mut gated: Vec<(f64, usize, f64)> = echoes
        .iter()
        .enumerate()
        .map(|(number, echo)| (in_gates(echo, place_of(echo, curves), gate_mm), number, echo.score))
        .collect();
    gated.sort_by(|a, b| a.0.total_cmp(&b.0));
    match *gated.as_slice() {
        [] => Decision::NoEcho,
        [(far, number, _), ..] if far > 1.0 => {
            let distance_mm =
                echoes.get(number).map_or(f64::NAN, |echo| distance(echo, place_of(echo, curves)));
            Decision::Outlier { distance_mm }
        }
        [(_, _, own), (far, _, other), ..] if far <= 1.0 && other >= ALIKE * own => Decision::Ambiguous,
        [(_, echo, _), ..] => Decision::Used { echo },
    }
}

fn place_of(echo: &Echo, curves: &[Curve; 2]) -> [f64; 2] {
    [0, 1].map(|axis: usize| curves[axis].at(echo.z_mm))
}

/// The echoes of used frames along the needle.
pub(crate) fn used_echoes(frames: &[Vec<Echo>], decisions: &[Decision]) -> Vec<Echo> {
    let mut echoes_used: Vec<Echo> = frames
        .iter()
        .zip(decisions)
        .filter_map(|(echoes, decision)| match decision {
            Decision::Used { echo } => echoes.get(*echo).copied(),
            _ => None,
        })
        .collect();
    echoes_used.sort_by(|a, b| a.z_mm.total_cmp(&b.z_mm));
    echoes_used
}

#[cfg(test)]
mod tests;
