//! Patterns in lateral runs: imperfections of tissue, image, force sensor and guides that a careful laboratory would not
//! notice.

use super::{Around, Cause, GroupPatterns, Groups, Scope};
use crate::data::{Kind, Source};
use crate::predicted::predicted;
use mechanics::effects::effect;
use mechanics::unknowns::discrepancy::lateral as size;
use mechanics::unknowns::{rig as of_rig, sensors, tissue};
use mechanics::{Experiment, Foundation, Layer, ModelError, predict_with};
use nalgebra::DMatrix;
use std::f64::consts::PI;

/// Thickness of the slices in which the modulus may differ, and correlation length of these differences.
const SLICE_M: f64 = 3e-3;
const ALIKE_M: f64 = 10e-3;
/// Limit of the correlation of two slices at small distances.
const ALIKE: f64 = 0.7;
/// Spacing of the nodes of a shape error that repeats in every sweep, and largest number of nodes.
const REPEAT_M: f64 = 1e-3;
const MAX_REPEATS: usize = 60;
/// Smooth errors of the shape are cosines over depth: the period of number k is twice this length divided by k, and k is below [`SMOOTH`].
const SMOOTH_M: f64 = 40e-3;
const SMOOTH: usize = 5;
/// Number of smooth errors of a single run.
const SMOOTH_OF_RUN: usize = 2;
/// Time constants of the creep of a force sensor: they cover the durations of steps, of holds and of runs.
const CREEP_S: [f64; 3] = [1.0, 4.0, 16.0];
/// Steps of the numerical derivatives: relative (modulus, stiffness), then in metres.
const LN_STEP: f64 = 1e-3;
const ENTRY_STEP_M: f64 = 1e-5;
const CLEARANCE_STEP_M: f64 = 5e-6;
const MM: f64 = 1e-3;

/// Whether a datum is a force, whether its plane is that in which guide 2 moves, and its plane.
struct Part {
    force: bool,
    driven: bool,
    plane: usize,
}

fn part(around: &Around<'_>, index: usize) -> Part {
    let datum = &around.run.data[index];
    let plane = datum.channel.plane();
    Part { force: matches!(datum.source, Source::Force(_)), driven: plane == around.run.axis, plane }
}

/// All groups of lateral runs; insertions have no patterns of them.
pub(super) fn groups(all: &[Around<'_>]) -> Result<Vec<GroupPatterns>, ModelError> {
    let mut groups = Groups::new(all, Kind::Lateral);
    let deepest_m = groups.around().map(|around| around.run.depth_m).fold(0.0, f64::max);

    // Tissue.
    let by_modulus = groups.around().map(by_ln_modulus).collect::<Result<Vec<_>, _>>()?;
    let mut slopes = by_modulus.iter();
    groups.add(&size::MODULUS_FROM_RUN_TO_RUN, Scope::Own, Cause::Physics, |_| {
        Ok(slopes.next().into_iter().cloned().collect())
    })?;
    let mut trends = by_modulus
        .iter()
        .enumerate()
        .map(|(number, slopes)| slopes.iter().map(|slope| number as f64 * slope).collect());
    groups.add(&size::MODULUS_CHANGING, Scope::Shared, Cause::Physics, |_| {
        Ok(trends.next().into_iter().collect())
    })?;
    let mix = slices_alike((deepest_m / SLICE_M).ceil().max(1.0) as usize);
    groups.add(&size::MODULUS_OVER_DEPTH, Scope::Shared, Cause::Physics, |around| by_slices(around, &mix))?;

    // Image.
    let repeats = ((deepest_m / REPEAT_M).ceil() as usize).clamp(2, MAX_REPEATS);
    let spacing_m = deepest_m / repeats as f64;
    groups.add(&size::REPEATING_SHAPE, Scope::Shared, Cause::Physics, |around| {
        Ok((0..=repeats)
            .map(|node| {
                around.each(|i, datum| match part(around, i) {
                    Part { force: false, driven: true, .. } => {
                        (1.0 - (datum.place.depth_m / spacing_m - node as f64).abs()).max(0.0)
                    }
                    _ => 0.0,
                })
            })
            .collect())
    })?;
    groups.add(&size::SMOOTH_SHAPE, Scope::Shared, Cause::Physics, |around| {
        Ok([0, 1]
            .into_iter()
            .flat_map(|plane| (0..SMOOTH).map(move |k| (plane, k)))
            .map(|(plane, k)| {
                around.each(|i, datum| {
                    let is_part = part(around, i);
                    if !is_part.force && is_part.plane == plane { wave(k, datum.place.depth_m) } else { 0.0 }
                })
            })
            .collect())
    })?;
    groups.add(&size::SHAPE_PROPORTIONAL, Scope::Shared, Cause::Physics, |around| {
        Ok((0..SMOOTH).map(|k| proportional(around, k)).collect())
    })?;
    groups.add(&size::SHAPE_PROPORTIONAL_OF_RUN, Scope::Own, Cause::Physics, |around| {
        Ok((0..SMOOTH_OF_RUN).map(|k| proportional(around, k)).collect())
    })?;
    groups.add(&size::SHAPE_OFFSET, Scope::Own, Cause::INSTRUMENT, |around| {
        let patterns = [(true, 0), (true, 1), (false, 0)].map(|(driven, k)| {
            around.each(|i, datum| {
                let is_part = part(around, i);
                if !is_part.force && is_part.driven == driven { wave(k, datum.place.depth_m) } else { 0.0 }
            })
        });
        Ok(patterns.to_vec())
    })?;

    // Guides and sensors.
    groups.add(&size::AXES, Scope::Shared, Cause::INSTRUMENT, axes)?;
    groups.add(&sensors::FORCE_ZERO, Scope::Own, Cause::INSTRUMENT, |around| {
        Ok([0, 1]
            .into_iter()
            .map(|plane| {
                around.each(|i, _| {
                    let is_part = part(around, i);
                    if is_part.force && is_part.plane == plane { 1.0 } else { 0.0 }
                })
            })
            .collect())
    })?;
    groups.add(&size::FORCE_GAIN_OF_RUN, Scope::Own, Cause::Physics, |around| {
        Ok(vec![force(around, |force_n| force_n)])
    })?;
    let largest_n = groups.around().map(largest_force_n).fold(1e-9, f64::max);
    groups.add(&size::NONLINEAR_FORCE, Scope::Shared, Cause::Physics, |around| {
        Ok(vec![
            force(around, |force_n| force_n * force_n / largest_n),
            force(around, |force_n| force_n.powi(3) / (largest_n * largest_n)),
            force(around, f64::abs),
        ])
    })?;
    let mut depths_mm: Vec<i64> = groups.around().map(depth_mm).collect();
    depths_mm.sort_unstable();
    depths_mm.dedup();
    groups.add(&size::FORCE_HYSTERESIS, Scope::Shared, Cause::Physics, |around| {
        let most_n = largest_force_n(around);
        Ok(depths_mm
            .iter()
            .map(|depth| {
                let is_depth = depth_mm(around) == *depth;
                around.each(|i, datum| match part(around, i) {
                    Part { force: true, driven: true, .. } if is_depth => most_n * datum.place.direction,
                    _ => 0.0,
                })
            })
            .collect())
    })?;
    groups.add(&size::FORCE_CREEP, Scope::Shared, Cause::Physics, |around| {
        Ok(CREEP_S.map(|time_s| lag_n(around, time_s)).to_vec())
    })?;
    groups.add(&size::FORCE_OF_HOLD, Scope::Own, Cause::Physics, |around| {
        Ok((0..around.run.parts())
            .map(|hold| {
                around.each(|i, datum| match part(around, i) {
                    Part { force: true, driven: true, .. } if datum.part == hold => 1.0,
                    _ => 0.0,
                })
            })
            .collect())
    })?;
    groups.add(&size::FORCE_ON_THE_WAY, Scope::Own, Cause::Physics, |around| {
        Ok(vec![around.each(|i, datum| match part(around, i) {
            Part { force: true, driven: true, .. } if datum.place.hold_s.is_none() => datum.place.direction,
            _ => 0.0,
        })])
    })?;
    groups.add(&size::FORCE_DRIFT, Scope::Own, Cause::INSTRUMENT, |around| {
        let length_s = around.run.data.iter().map(|d| d.place.time_s).fold(1e-3, f64::max);
        Ok([0, 1]
            .into_iter()
            .map(|plane| {
                around.each(|i, datum| {
                    let is_part = part(around, i);
                    if is_part.force && is_part.plane == plane {
                        datum.place.time_s / length_s - 0.5
                    } else {
                        0.0
                    }
                })
            })
            .collect())
    })?;

    // Tolerances of stated properties of the rig.
    if let Some(first) = groups.around().next() {
        let rig = &first.model.rig;
        // With two guides the position of the surface is a parameter of the model; a pattern is needed only for its change by remounting.
        let is_unknown = !rig.has_one_guide();
        let is_remounted = all.iter().any(|around| around.run.is_reference);
        if is_remounted || !is_unknown {
            let surface = tissue::SURFACE.with_sd(rig.tolerances.entry_sd_m());
            groups.add(&surface, Scope::Shared, Cause::Mounting, |around| {
                Ok(vec![around.slope(ENTRY_STEP_M, |model, _| {
                    model.rig.entry_m += ENTRY_STEP_M;
                    Ok(())
                })?])
            })?;
        }
        let stiffness = of_rig::NEEDLE_STIFFNESS.with_sd(rig.tolerances.stiffness_sd_ln(&rig.needle));
        groups.add(&stiffness, Scope::Shared, Cause::Physics, |around| {
            Ok(vec![around.slope(LN_STEP, |model, _| {
                model.rig.needle.youngs_modulus_pa *= 1.0 + LN_STEP;
                Ok(())
            })?])
        })?;
    }
    groups.add(&sensors::FORCE_GAIN, Scope::Shared, Cause::Physics, |around| {
        Ok(vec![force(around, |force_n| force_n)])
    })?;
    // Every bearing has some clearance.
    if let Some(clearance) = effect("rig.backlash") {
        groups.add(&of_rig::CLEARANCE, Scope::Shared, Cause::Physics, |around| {
            Ok(vec![around.slope(CLEARANCE_STEP_M, |model, _| {
                model.effects.push((clearance, vec![CLEARANCE_STEP_M / MM]));
                Ok(())
            })?])
        })?;
    }
    Ok(groups.shown())
}

/// A cosine over depth.
fn wave(k: usize, depth_m: f64) -> f64 {
    (k as f64 * PI * depth_m / SMOOTH_M).cos()
}

/// Change of the shape by a fraction that is a cosine over depth.
fn proportional(around: &Around<'_>, k: usize) -> Vec<f64> {
    around.each(
        |i, datum| {
            if part(around, i).force { 0.0 } else { around.predicted[i] * wave(k, datum.place.depth_m) }
        },
    )
}

/// A pattern of the force as a function of the predicted force, N.
fn force(around: &Around<'_>, pattern: impl Fn(f64) -> f64) -> Vec<f64> {
    around.each(|i, _| if part(around, i).force { pattern(around.predicted[i]) } else { 0.0 })
}

fn depth_mm(around: &Around<'_>) -> i64 {
    (1e3 * around.run.depth_m).round() as i64
}

fn largest_force_n(around: &Around<'_>) -> f64 {
    let forces = (0..around.predicted.len()).filter(|i| part(around, *i).force);
    forces.map(|i| around.predicted[i].abs()).fold(0.0, f64::max)
}

/// The predicted force less its exponential moving average with a time constant; zero at the first reading.
fn lag_n(around: &Around<'_>, smoothed_s: f64) -> Vec<f64> {
    let mut lag_n = vec![0.0; around.predicted.len()];
    for plane in [0, 1] {
        let mut times_s: Vec<(usize, f64)> = (0..around.predicted.len())
            .filter(|i| {
                let is_part = part(around, *i);
                is_part.force && is_part.plane == plane
            })
            .map(|i| (i, around.run.data[i].place.time_s))
            .collect();
        times_s.sort_by(|a, b| a.1.total_cmp(&b.1));
        let mut last: Option<(f64, f64, f64)> = None;
        for (i, now_s) in times_s {
            let force_n = around.predicted[i];
            // The force is taken as linear in time between readings.
            let smoothed_n = match last {
                Some((before_s, before_n, smoothed_n)) if now_s > before_s => {
                    let ramp_n = (force_n - before_n) * smoothed_s / (now_s - before_s);
                    let remaining_fraction = (-(now_s - before_s) / smoothed_s).exp();
                    force_n - ramp_n + (smoothed_n - before_n + ramp_n) * remaining_fraction
                }
                Some((.., smoothed_n)) => smoothed_n,
                None => force_n,
            };
            lag_n[i] = force_n - smoothed_n;
            last = Some((now_s, force_n, smoothed_n));
        }
    }
    lag_n
}

fn by_ln_modulus(around: &Around<'_>) -> Result<Vec<f64>, ModelError> {
    around.slope(LN_STEP, |model, _| {
        model.foundation = model.foundation.scaled(LN_STEP.exp())?;
        Ok(())
    })
}

/// Root of the covariance of the slices of the modulus: multiplied by independent amplitudes of unit variance it gives correlated slices.
fn slices_alike(count: usize) -> DMatrix<f64> {
    let covariance = DMatrix::from_fn(count, count, |i, j| {
        let distance_m = SLICE_M * (i as f64 - j as f64);
        let alike = ALIKE * (-0.5 * (distance_m / ALIKE_M).powi(2)).exp();
        if i == j { 1.0 } else { alike }
    });
    covariance.cholesky().map_or_else(|| DMatrix::identity(count, count), |factor| factor.unpack())
}

/// Derivative of the prediction of springs with respect to the logarithm of the modulus in every slice, times the root `mix`.
fn by_slices(around: &Around<'_>, mix: &DMatrix<f64>) -> Result<Vec<Vec<f64>>, ModelError> {
    let modulus_pa = around.model.foundation.modulus_pa(0.5 * around.run.depth_m).max(1.0);
    let uniform = on_foundation(around, Foundation::uniform(modulus_pa)?)?;
    let mut slopes: Vec<Vec<f64>> = Vec::with_capacity(mix.nrows());
    for slice in 0..mix.nrows() {
        let (top_m, bottom_m) = (SLICE_M * slice as f64, SLICE_M * (slice + 1) as f64);
        if top_m >= around.run.depth_m {
            slopes.push(vec![0.0; around.predicted.len()]);
            continue;
        }
        let mut layers = vec![Layer { bottom_m, modulus_pa: modulus_pa * LN_STEP.exp() }];
        if slice > 0 {
            layers.insert(0, Layer { bottom_m: top_m, modulus_pa });
        }
        let layered = on_foundation(around, Foundation::layered(layers, modulus_pa)?)?;
        slopes
            .push(layered.iter().zip(&uniform).map(|(layered, plain)| (layered - plain) / LN_STEP).collect());
    }
    Ok((0..mix.ncols())
        .map(|column| {
            let mut sum = vec![0.0; around.predicted.len()];
            for (row, slope) in slopes.iter().enumerate() {
                sum.iter_mut().zip(slope).for_each(|(sum, value)| *sum += mix[(row, column)] * value);
            }
            sum
        })
        .collect())
}

/// Predictions of a run on springs without effects.
fn on_foundation(around: &Around<'_>, foundation: Foundation) -> Result<Vec<f64>, ModelError> {
    let mut model = around.model.clone();
    model.effects.clear();
    model.foundation = foundation;
    Ok(predicted(around.run, &predict_with(&model, &around.run.experiment, around.cache)?))
}

/// Fractions of the driven plane's force and shape that the other plane reads, with equal and with opposite signs in runs along the two
/// axes.
fn axes(around: &Around<'_>) -> Result<Vec<Vec<f64>>, ModelError> {
    // The response of each plane to the motion of the other one.
    let rotated = around.slope(1.0, |_, experiment| {
        if let Experiment::Lateral(lateral) = experiment {
            for sample in &mut lateral.drive {
                (sample.y_m, sample.x_m) = (sample.y_m + sample.x_m, sample.x_m + sample.y_m);
            }
        }
        Ok(())
    })?;
    let sign = if around.run.axis == 0 { 1.0 } else { -1.0 };
    Ok([(true, 1.0), (true, sign), (false, 1.0), (false, sign)]
        .into_iter()
        .map(|(force, factor)| {
            around.each(|i, _| {
                let is_part = part(around, i);
                if is_part.force == force && !is_part.driven { factor * rotated[i] } else { 0.0 }
            })
        })
        .collect())
}
