//! Lag between images and the readings of the probe's position: a sweep forth and back shows one needle only at the right lag.

use crate::curve::{Curve, Knot};
use crate::pose::Poses;
use crate::track::{Decision, Echo, Track, used_echoes};

/// Lags that are tried, seconds.
const RANGE_S: [f64; 2] = [-0.5, 0.5];
const STEP_S: f64 = 0.01;
/// A lag that is less certain is not identifiable from this motion.
const MAX_SD_S: f64 = 0.03;
/// The way back is at least this share of the way forth, and the other way round: jitter of a tracker, some tenths of a millimetre, is
/// less of the centimetres that a sweep is long.
const BOTH_WAYS: f64 = 0.1;
/// Frames that are further apart share no speckle, millimetres.
const SHARED_MM: f64 = 3.0;

/// An estimated lag.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lag {
    /// Delay of position readings after images, seconds; negative if images are later.
    pub lag_s: f64,
    /// Its standard deviation.
    pub sd_s: f64,
}

/// The lag with the least squares around smooth curves; nothing where the motion does not determine it.
pub(super) fn estimate(track: &Track, poses: &Poses, echoes: &dyn Fn(f64) -> Vec<Vec<Echo>>) -> Option<Lag> {
    if !poses.has_times() || !goes_both_ways(poses.along_mm()) {
        return None;
    }
    let squares = |lag_s: f64| -> Option<f64> {
        let placed_echoes = echoes(lag_s);
        let echoes_used = used_echoes(&placed_echoes, &track.decisions);
        // Each axis on the scale of its own noise, so that neither outweighs the other.
        let (x, y) = (squares_of_axis(0, &echoes_used)?, squares_of_axis(1, &echoes_used)?);
        Some(x.1 * x.0.max(f64::MIN_POSITIVE).ln() + y.1 * y.0.max(f64::MIN_POSITIVE).ln())
    };
    let count = ((RANGE_S[1] - RANGE_S[0]) / STEP_S).round() as usize;
    let costs_by_lag: Vec<(f64, f64)> = (0..=count)
        .filter_map(|i| {
            let lag_s = RANGE_S[0] + STEP_S * i as f64;
            Some((lag_s, squares(lag_s)?))
        })
        .collect();
    let best = costs_by_lag.iter().enumerate().min_by(|a, b| a.1.1.total_cmp(&b.1.1))?.0;
    // A parabola through points that lie far enough apart to be above the roughness of a changing choice of knots.
    let reach = 4;
    let (lower_cost, best_cost, upper_cost) = (
        costs_by_lag.get(best.checked_sub(reach)?)?,
        costs_by_lag.get(best)?,
        costs_by_lag.get(best + reach)?,
    );
    let bend = (lower_cost.1 - 2.0 * best_cost.1 + upper_cost.1) / (reach as f64 * STEP_S).powi(2);
    let slope = (upper_cost.1 - lower_cost.1) / (2.0 * reach as f64 * STEP_S);
    if bend <= 0.0 {
        return None;
    }
    let lag_s = best_cost.0 - slope / bend;
    // Minus twice the log likelihood, where the noise is estimated too.
    let sd_s = (2.0 * alike(track, poses, lag_s, &echoes(lag_s)) / bend).sqrt();
    (sd_s < MAX_SD_S).then_some(Lag { lag_s, sd_s })
}

fn squares_of_axis(axis: usize, echoes_used: &[Echo]) -> Option<(f64, f64)> {
    let knots: Vec<Knot> = echoes_used
        .iter()
        .map(|echo| Knot { z_mm: echo.z_mm, value_mm: echo.across_mm[axis], sd_mm: echo.sd_mm[axis] })
        .collect();
    let curve = Curve::fit(&knots)?;
    let sum: f64 =
        knots.iter().map(|knot| ((knot.value_mm - curve.at(knot.z_mm)) / knot.sd_mm).powi(2)).sum();
    let freedom = knots.len().checked_sub(curve.parameters()).filter(|freedom| *freedom > 0)?;
    Some((sum, freedom as f64))
}

/// Whether a probe goes forth and back: on one way alone a lag is a shift of the needle along itself, and what is left of the squares is the
/// pile of frames at the ends of the readings.
fn goes_both_ways(along_mm: impl Iterator<Item = f64>) -> bool {
    let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
    let (mut rise, mut fall) = (0.0_f64, 0.0_f64);
    for z_mm in along_mm {
        (least, most) = (least.min(z_mm), most.max(z_mm));
        (rise, fall) = (rise.max(z_mm - least), fall.max(most - z_mm));
    }
    rise.min(fall) > BOTH_WAYS * rise.max(fall)
}

/// By how much more a lag is uncertain than with frames whose errors are independent.
///
/// A lag moves frames of the way forth to one side and those of the way back to the other, so it is moved by the errors of both with opposite
/// signs: what they share at one place, since speckle stays where it is, cancels, and what frames of one way share with their neighbours
/// does not.
fn alike(track: &Track, poses: &Poses, lag_s: f64, placed: &[Vec<Echo>]) -> f64 {
    let echo_directions =
        placed.iter().zip(&track.decisions).enumerate().filter_map(|(number, (echoes, decision))| {
            let Decision::Used { echo } = decision else { return None };
            let scan_direction = poses.motion(number, lag_s).map_or(0.0, |motion| motion.mm_per_s.signum());
            Some((*echoes.get(*echo)?, scan_direction))
        });
    let mut directed_echoes: Vec<(Echo, f64)> = echo_directions.collect();
    directed_echoes.sort_by(|a, b| a.0.z_mm.total_cmp(&b.0.z_mm));
    let longest = [0, 1].map(|axis: usize| {
        let knots: Vec<Knot> = directed_echoes
            .iter()
            .map(|(echo, _)| Knot {
                z_mm: echo.z_mm,
                value_mm: echo.across_mm[axis],
                sd_mm: echo.sd_mm[axis],
            })
            .collect();
        let Some(curve) = Curve::fit(&knots) else { return 1.0 };
        let deviations: Vec<(f64, f64)> = knots
            .iter()
            .zip(&directed_echoes)
            .map(|(knot, (_, way))| (knot.z_mm, way * (knot.value_mm - curve.at(knot.z_mm)) / knot.sd_mm))
            .collect();
        let squares: f64 = deviations.iter().map(|(_, r)| r * r).sum();
        let mut shared = 0.0;
        for (number, (z_mm, r)) in deviations.iter().enumerate() {
            let neighbours =
                deviations.iter().skip(number + 1).take_while(|(other_mm, _)| other_mm - z_mm < SHARED_MM);
            shared += neighbours.map(|(_, other)| r * other).sum::<f64>();
        }
        1.0 + 2.0 * shared / squares.max(f64::MIN_POSITIVE)
    });
    longest[0].max(longest[1]).max(1.0)
}

#[cfg(test)]
mod tests {
    use super::goes_both_ways;

    #[test]
    fn one_way_is_no_way_back_whatever_jitters() {
        assert!(!goes_both_ways((0..400).map(jittered_mm)));
        assert!(!goes_both_ways((0..400).rev().map(jittered_mm)));
        assert!(goes_both_ways((0..400).chain((300..400).rev()).map(jittered_mm)));
        assert!(!goes_both_ways(std::iter::empty()) && !goes_both_ways(std::iter::repeat_n(3.0, 5)));
    }

    fn jittered_mm(i: i32) -> f64 {
        0.1 * f64::from(i) + if i % 2 == 0 { 0.2 } else { -0.2 }
    }
}
