//! Lag between images and the readings of the probe's position: a sweep forth and back shows one needle only at the right lag.

use crate::curve::{Curve, Knot};
use crate::pose::Poses;
use crate::track::{Decision, Echo, Track};

/// Lags that are tried, seconds.
const RANGE_S: [f64; 2] = [-0.5, 0.5];
const STEP_S: f64 = 0.01;
/// A lag that is less certain is not identifiable from this motion.
const MAX_SD_S: f64 = 0.03;

/// An estimated lag.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lag {
    /// How much readings of the position lag behind images, seconds; negative where images lag.
    pub lag_s: f64,
    /// Its standard deviation.
    pub sd_s: f64,
}

/// The lag with the least squares around smooth curves; nothing where the motion does not determine it.
pub(super) fn estimate(track: &Track, poses: &Poses, echoes: &dyn Fn(f64) -> Vec<Vec<Echo>>) -> Option<Lag> {
    if !poses.has_times() {
        return None;
    }
    let squares = |lag_s: f64| -> Option<f64> {
        let placed = echoes(lag_s);
        let used: Vec<Echo> = placed
            .iter()
            .zip(&track.decisions)
            .filter_map(|(echoes, decision)| match decision {
                Decision::Used { echo } => echoes.get(*echo).copied(),
                _ => None,
            })
            .collect();
        let of_axis = |axis: usize| {
            let knots: Vec<Knot> = used
                .iter()
                .map(|echo| Knot { z_mm: echo.z_mm, value_mm: echo.across_mm[axis], sd_mm: echo.sd_mm[axis] })
                .collect();
            let curve = Curve::fit(&knots)?;
            let sum: f64 =
                knots.iter().map(|knot| ((knot.value_mm - curve.at(knot.z_mm)) / knot.sd_mm).powi(2)).sum();
            let freedom = knots.len().checked_sub(curve.parameters()).filter(|freedom| *freedom > 0)?;
            Some((sum, freedom as f64))
        };
        // Each axis on the scale of its own noise, so that neither outweighs the other.
        let (x, y) = (of_axis(0)?, of_axis(1)?);
        Some(x.1 * x.0.max(f64::MIN_POSITIVE).ln() + y.1 * y.0.max(f64::MIN_POSITIVE).ln())
    };
    let count = ((RANGE_S[1] - RANGE_S[0]) / STEP_S).round() as usize;
    let tried: Vec<(f64, f64)> = (0..=count)
        .filter_map(|i| {
            let lag_s = RANGE_S[0] + STEP_S * i as f64;
            Some((lag_s, squares(lag_s)?))
        })
        .collect();
    let best = tried.iter().enumerate().min_by(|a, b| a.1.1.total_cmp(&b.1.1))?.0;
    // A parabola through points that lie far enough apart to be above the roughness of a changing choice of knots.
    let reach = 4;
    let (before, at, after) =
        (tried.get(best.checked_sub(reach)?)?, tried.get(best)?, tried.get(best + reach)?);
    let bend = (before.1 - 2.0 * at.1 + after.1) / (reach as f64 * STEP_S).powi(2);
    let slope = (after.1 - before.1) / (2.0 * reach as f64 * STEP_S);
    if bend <= 0.0 {
        return None;
    }
    let lag_s = at.0 - slope / bend;
    // Minus twice the log likelihood, where the noise is estimated too; frames that share their error count once.
    let sd_s = (2.0 * track.correlated_frames() / bend).sqrt();
    (sd_s < MAX_SD_S).then_some(Lag { lag_s, sd_s })
}
