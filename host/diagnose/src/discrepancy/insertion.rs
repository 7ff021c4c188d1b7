//! Patterns in insertions: differences between nominally equal insertions, and errors of tracker and guides.

use super::{Around, Cause, GroupPatterns, Groups, Made, Scope};
use crate::data::{Datum, Kind, Source};
use mechanics::insertion::Cutting;
use mechanics::unknowns::discrepancy::insertion as size;
use mechanics::unknowns::{Unknown, rig, sensors, tissue};
use mechanics::{Experiment, Insertion, ModelError, Profile};
use std::f64::consts::PI;
use std::ops::Range;

/// Smooth changes over depth are cosines: the period of number k is twice this length divided by k. The next constants are the numbers of
/// cosines of each kind.
const SMOOTH_M: f64 = 100e-3;
const LOAD_WAVES: usize = 4;
const PATH_WAVES: usize = 3;
const DIRECTION_WAVES: usize = 3;
/// Spacing of the knots of a smooth load.
const KNOT_M: f64 = 4e-3;
/// Steps of the numerical derivatives.
const LN_STEP: f64 = 1e-3;
const SHIFT_STEP_M: f64 = 1e-4;
const ROLL_STEP_RAD: f64 = 1e-3;

/// All groups of insertions; lateral runs have no patterns of them.
pub(super) fn groups(all: &[Around<'_>]) -> Result<Vec<GroupPatterns>, ModelError> {
    let mut groups = Groups::new(all, Kind::Insertion);
    // A single realisation does not determine the size of an imperfection: these sizes are known.
    groups.add(&size::MODULUS_OF_ONE, Scope::Own, Cause::Run, modulus)?;
    groups
        .add(&size::LOAD_OF_ONE, Scope::Own, Cause::Run, |around| Ok(vec![under_load(around, &|_| 1.0)?]))?;
    let by_hand = all.iter().any(|around| around.model.rig.has_one_guide());
    // Both variants have the same names, so that the sizes in a model file apply to both.
    let [angle, tilt] = if by_hand {
        [
            Unknown { name: size::ENTRY_ANGLE.name, ..size::ENTRY_ANGLE_BY_HAND },
            Unknown { name: size::TILT.name, ..size::TILT_BY_HAND },
        ]
    } else {
        [size::ENTRY_ANGLE, size::TILT]
    };
    groups.add(&angle, Scope::Own, Cause::INSTRUMENT, |around| Ok(linear(around)))?;
    groups.add(&size::SURFACE_OF_ONE, Scope::Own, Cause::Run, entry)?;
    groups.add(&size::ROLL_OF_ONE, Scope::Own, Cause::Run, roll)?;
    groups.add(&size::LOAD_OVER_DEPTH_OF_ONE, Scope::Own, Cause::Physics, load_waves)?;
    groups.add(&size::LOAD_OVER_DEPTH, Scope::Shared, Cause::Physics, load_waves)?;
    groups.add(&size::DRIFT_OF_ONE, Scope::Own, Cause::Physics, |around| Ok(smooth(around)))?;
    groups.add(&size::SMOOTH_PATH, Scope::Shared, Cause::Physics, |around| Ok(smooth(around)))?;
    groups.add(&size::DIRECTION_DRIFT_OF_ONE, Scope::Own, Cause::Physics, |around| {
        Ok(smooth_direction(around))
    })?;
    groups
        .add(&size::SMOOTH_DIRECTION, Scope::Shared, Cause::Physics, |around| Ok(smooth_direction(around)))?;
    // A direction sensor is some millimetres long, and lies behind the tip.
    groups.add(&size::DIRECTION_PROPORTIONAL, Scope::Shared, Cause::Physics, |around| {
        Ok(proportional_direction(around))
    })?;
    groups.add(&size::DIRECTION_PROPORTIONAL_OF_ONE, Scope::Own, Cause::Physics, |around| {
        Ok(proportional_direction(around))
    })?;
    // After remounting, a hand holds the needle along another line.
    groups.add(&tilt, Scope::Shared, Cause::Instrument { mounted: by_hand }, |around| Ok(linear(around)))?;
    groups.add(&sensors::COIL_ANGLE, Scope::Shared, Cause::INSTRUMENT, |around| Ok(coil(around)))?;
    groups.add(&rig::GUIDE2_ZERO, Scope::Shared, Cause::Physics, guide2)?;
    groups.add(&tissue::SURFACE_IN_INSERTIONS, Scope::Shared, Cause::Mounting, entry)?;
    groups.add(&size::ROLL, Scope::Shared, Cause::Mounting, roll)?;
    Ok(groups.shown())
}

/// Derivative of the path with respect to the logarithm of the modulus.
fn modulus(around: &Around<'_>) -> Made {
    let slope = around.slope(LN_STEP, |model, _| {
        model.foundation = model.foundation.scaled(LN_STEP.exp())?;
        Ok(())
    });
    Ok(vec![slope?])
}

/// Derivative of the path with respect to the distance of the surface.
fn entry(around: &Around<'_>) -> Made {
    let slope = around.slope(SHIFT_STEP_M, |model, _| {
        model.rig.entry_m += SHIFT_STEP_M;
        Ok(())
    });
    Ok(vec![slope?])
}

/// Derivative of the path with respect to the roll of the bevel.
fn roll(around: &Around<'_>) -> Made {
    let slope = around.slope(ROLL_STEP_RAD, |model, _| {
        model.tip.along_bevel.roll_rad += ROLL_STEP_RAD;
        Ok(())
    });
    Ok(vec![slope?])
}

/// Changes of the path by tip loads that vary with depth.
fn load_waves(around: &Around<'_>) -> Made {
    (1..=LOAD_WAVES)
        .map(|k| under_load(around, &|depth_m| (k as f64 * PI * depth_m / SMOOTH_M).cos()))
        .collect()
}

/// Change of the path if the tip load is larger by a fraction that varies with depth.
fn under_load(around: &Around<'_>, share: &dyn Fn(f64) -> f64) -> Result<Vec<f64>, ModelError> {
    let last_m = around.run.depth_m;
    let count = (last_m / KNOT_M).ceil().max(1.0) as usize;
    around.slope(1.0, |model, _| {
        if let Cutting::Load(planes) = &mut model.tip.cutting {
            for profile in planes {
                let depths_m = (0..=count).map(|i| last_m * i as f64 / count as f64);
                let knots = depths_m.map(|m| [m, profile.before(m) * (1.0 + share(m))]);
                *profile = Profile::new(knots.collect())?;
            }
        }
        Ok(())
    })
}

/// Rotation of the path and the needle's direction by an angle, in each plane.
fn linear(around: &Around<'_>) -> Vec<Vec<f64>> {
    [0, 1]
        .into_iter()
        .map(|plane| {
            around.each(|_, datum| match datum.source {
                _ if datum.channel.plane() != plane => 0.0,
                Source::Direction(_) => 1.0,
                _ => datum.place.depth_m,
            })
        })
        .collect()
}

/// Rotation of the measured direction by an angle, in each plane.
fn coil(around: &Around<'_>) -> Vec<Vec<f64>> {
    waves(around, 0..1, |datum| matches!(datum.source, Source::Direction(_)))
}

/// Smooth changes of the tip's position over depth, in each plane.
fn smooth(around: &Around<'_>) -> Vec<Vec<f64>> {
    waves(around, 1..PATH_WAVES + 1, |datum| matches!(datum.source, Source::Tip(_)))
}

/// Smooth changes of the tip's direction over depth, in each plane.
fn smooth_direction(around: &Around<'_>) -> Vec<Vec<f64>> {
    waves(around, 1..DIRECTION_WAVES + 1, |datum| matches!(datum.source, Source::Direction(_)))
}

/// Changes of the direction by a fraction that is smooth in depth, in each plane.
fn proportional_direction(around: &Around<'_>) -> Vec<Vec<f64>> {
    [0, 1]
        .into_iter()
        .flat_map(|plane| (0..DIRECTION_WAVES).map(move |k| (plane, k)))
        .map(|(plane, k)| {
            around.each(|i, datum| match datum.source {
                Source::Direction(_) if datum.channel.plane() == plane => {
                    around.predicted[i] * (k as f64 * PI * datum.place.depth_m / SMOOTH_M).cos()
                }
                _ => 0.0,
            })
        })
        .collect()
}

/// Cosines over depth with these numbers, in each plane, for some of the data.
fn waves(around: &Around<'_>, numbers: Range<usize>, shows: impl Fn(&Datum) -> bool) -> Vec<Vec<f64>> {
    [0, 1]
        .into_iter()
        .flat_map(|plane| numbers.clone().map(move |k| (plane, k)))
        .map(|(plane, k)| {
            around.each(|_, datum| {
                let wave = (k as f64 * PI * datum.place.depth_m / SMOOTH_M).cos();
                if datum.channel.plane() == plane && shows(datum) { wave } else { 0.0 }
            })
        })
        .collect()
}

/// Derivative of the path with respect to a constant error of guide 2, in each plane.
fn guide2(around: &Around<'_>) -> Result<Vec<Vec<f64>>, ModelError> {
    [0, 1]
        .into_iter()
        .map(|plane| {
            around.slope(SHIFT_STEP_M, |_, experiment| {
                if let Experiment::Insertion(Insertion { guide2_m: Some(planes), .. }) = experiment
                    && let Some(profile) = planes.get_mut(plane)
                {
                    *profile = profile.shifted(SHIFT_STEP_M);
                }
                Ok(())
            })
        })
        .collect()
}
