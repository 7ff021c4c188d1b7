//! Runs that cannot belong to the others: excluded from the pool, by a stated rule and with the reason.
//!
//! The rule: what the fit leaves of the run's shape is more than [`FAR`] times the median of the other runs of its depth, or its residuals
//! (root of chi-square per degree of freedom, where all noise is stated) are more than [`FAR`] and more than [`FAR`] times that median. A run
//! without others of its depth is compared with all, by [`FAR_OF_ALL`]: layers make a deep run fit worse than a shallow one, and that is
//! tissue and no fault.
//!
//! This is no rule for single values ([`readings::outliers`]): a wrong sign, unit or depth makes a misfit many times larger, and
//! the few misfits of a session are no sample of a distribution.

use super::{Fitted, RunError, RunResult};
use formats::session::LateralRun;
use readings::LateralData;
use readings::holds::UnusedPart;

/// Multiple of the residuals of the other runs of a depth beyond which a run cannot belong to them.
const FAR: f64 = 5.0;
/// The same of runs of other depths.
const FAR_OF_ALL: f64 = 20.0;
/// Depths closer than this are one depth.
const SAME_DEPTH_M: f64 = 0.5e-3;
/// Levels that lie this share of the largest displacement apart give a slope between them.
const SPREAD: f64 = 0.5;
/// Beyond this slope a single level is turned too; less may be an offset of the shape.
const TURNED_SINGLE: f64 = -0.6;
/// Slope of deflection against displacement near the surface below which the sign of one of them is turned: 1 for a needle that
/// follows guide 2, above -0.1 for any tissue and rig that the model has.
const TURNED_SLOPE: f64 = -0.2;
/// Part of the inserted length that counts as near the surface.
const NEAR_SURFACE: f64 = 0.3;

/// Deflection and displacement of guide 2 have the same sign near the surface; where they do not, one of their signs is turned.
///
/// # Errors
/// [`RunError::ShapeSign`].
pub(super) fn check_shape_sign(run: &LateralRun, data: &LateralData) -> Result<(), RunError> {
    let surface_limit_m = data.rig.entry_m + NEAR_SURFACE * data.depth_m;
    // Levels with their mean deflection near the surface; slope through their mean, so that an offset of the shape does not count.
    let mut points: Vec<[f64; 2]> = Vec::new();
    let mut is_spread = false;
    for plane in 0..data.planes {
        let first = points.len();
        for level in &data.levels {
            let surface_points =
                level.shape.iter().filter(|point| (data.rig.entry_m..=surface_limit_m).contains(&point.z_m));
            let values: Vec<f64> =
                surface_points.filter_map(|point| point.deflection_m.get(plane)).copied().collect();
            if let (Some(displacement), false) = (level.displacement_m.get(plane), values.is_empty()) {
                points.push([displacement.value, values.iter().sum::<f64>() / values.len() as f64]);
            }
        }
        let depth_points = points.get_mut(first..).unwrap_or_default();
        // Levels at one place have nothing to be compared with but the straight needle.
        let [low, high] = depth_points
            .iter()
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], [u, _]| [low.min(*u), high.max(*u)]);
        if high - low > SPREAD * high.abs().max(low.abs()) {
            is_spread = true;
            let n = depth_points.len() as f64;
            let mean = depth_points
                .iter()
                .fold([0.0; 2], |sum, point| [sum[0] + point[0] / n, sum[1] + point[1] / n]);
            depth_points.iter_mut().for_each(|point| *point = [point[0] - mean[0], point[1] - mean[1]]);
        }
    }
    let square: f64 = points.iter().map(|[u, _]| u * u).sum();
    let product: f64 = points.iter().map(|[u, d]| u * d).sum();
    let slope = product / square;
    if square > 0.0 && slope < if is_spread { TURNED_SLOPE } else { TURNED_SINGLE } {
        return Err(RunError::ShapeSign { path: run.shape_path.clone(), slope });
    }
    Ok(())
}

/// Misfit of a run: of its shape in metres, and of everything in standard deviations where these are stated.
#[derive(Clone, Copy)]
struct Misfit {
    depth_m: f64,
    shape_m: f64,
    sigmas: Option<f64>,
}

fn misfit(result: &RunResult, fitted: &Fitted) -> Misfit {
    let shape = result.fit.iter().find(|channel| channel.channel == "shape");
    let rms = shape.map_or(0.0, |shape| (shape.chi_square / shape.count.max(1) as f64).sqrt());
    let sigmas = result.chi_square.zip(result.degrees_of_freedom);
    let sigmas = sigmas.map(|(square, freedom)| (square / freedom.max(1) as f64).sqrt());
    let depth_m = fitted.data.depth_m;
    Misfit { depth_m, shape_m: rms * fitted.data.shape_sd_m, sigmas: sigmas.filter(|_| fitted.known_noise) }
}

/// Takes the runs that cannot belong to the others out of `fitted`, marks them in `runs`, and warns.
pub(super) fn set_apart(
    runs: &mut [RunResult],
    fitted: &mut Vec<Fitted>,
    warnings: &mut Vec<String>,
) -> Vec<UnusedPart> {
    let mut good: Vec<&mut RunResult> = runs.iter_mut().filter(|run| run.error.is_none()).collect();
    let misfits: Vec<Misfit> =
        good.iter().zip(fitted.iter()).map(|(run, fitted)| misfit(run, fitted)).collect();
    let reasons: Vec<Option<String>> = (0..misfits.len()).map(|own| reason(&misfits, own)).collect();
    // The rule is for single outlying runs: where it takes half of the runs or more none is outlying.
    if 2 * reasons.iter().flatten().count() >= reasons.len() {
        return Vec::new();
    }
    let mut unused = Vec::new();
    for (run, reason) in good.iter_mut().zip(&reasons) {
        let Some(reason) = reason else { continue };
        warnings.push(format!("run {} is excluded from the pool: {reason}", run.id));
        run.skipped = Some(reason.clone());
        let points = run.holds.iter().map(|hold| hold.shape_points).sum();
        unused.push(UnusedPart {
            run: run.id.clone(),
            part: "run",
            time_s: None,
            count: points,
            reason: reason.clone(),
        });
    }
    let mut run_is_kept = reasons.iter().map(Option::is_none);
    fitted.retain(|_| run_is_kept.next().unwrap_or(true));
    unused
}

/// Why a run cannot belong to the others; `None` where it can.
fn reason(misfits: &[Misfit], own: usize) -> Option<String> {
    let Misfit { depth_m, shape_m, sigmas } = misfits.get(own).copied()?;
    let other_misfits =
        || misfits.iter().enumerate().filter(|(other, _)| *other != own).map(|(_, misfit)| *misfit);
    let (same_depth, farthest): (Vec<Misfit>, f64) = match other_misfits()
        .filter(|misfit| (misfit.depth_m - depth_m).abs() < SAME_DEPTH_M)
        .collect::<Vec<_>>()
    {
        none if none.is_empty() => (other_misfits().collect(), FAR_OF_ALL),
        of_depth => (of_depth, FAR),
    };
    let usual_m = median_of(same_depth.iter().map(|misfit| misfit.shape_m).collect())?;
    if usual_m > 0.0 && shape_m > farthest * usual_m {
        return Some(format!(
            "its shape is {:.3} mm (RMS) off its own fit, {:.1} times as much as that of the other runs (rule: more than {farthest}); a \
             sign, a unit or the depth may be wrong",
            1e3 * shape_m,
            shape_m / usual_m
        ));
    }
    let usual = median_of(same_depth.iter().filter_map(|misfit| misfit.sigmas).collect())?;
    sigmas.filter(|sigmas| *sigmas > farthest && *sigmas > farthest * usual).map(|sigmas| {
        format!(
            "its residuals are {sigmas:.1} times the stated noise, those of the other runs {usual:.1} times (rule: more than {farthest} and \
             {farthest} times as much); a sign, a unit or the depth may be wrong"
        )
    })
}

fn median_of(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}
