//! Patterns in insertions: how pushes that are meant to be alike differ, and what tracker and guides are off by.

use super::group_of;
use super::{Around, Cause, GroupPatterns, Made, Scope};
use crate::data::{Datum, Kind, Source};
use mechanics::insertion::Cutting;
use mechanics::unknowns::discrepancy::insertion as size;
use mechanics::unknowns::{Unknown, rig, sensors, tissue};
use mechanics::{Experiment, Insertion, ModelError, Profile};
use std::f64::consts::PI;
use std::ops::Range;

/// Smooth changes over depth have waves of twice this length over their number, numbers from 1 up to these.
const SMOOTH_M: f64 = 100e-3;
const LOAD_WAVES: usize = 4;
const PATH_WAVES: usize = 3;
const DIRECTION_WAVES: usize = 3;
/// Knots of a smooth load.
const KNOT_M: f64 = 4e-3;
/// Steps of the differences.
const LN_STEP: f64 = 1e-3;
const SHIFT_STEP_M: f64 = 1e-4;
const ROLL_STEP_RAD: f64 = 1e-3;

/// All groups; lateral runs have none of their patterns.
pub(super) fn groups(all: &[Around<'_>]) -> Result<Vec<GroupPatterns>, ModelError> {
    let mut groups = Vec::new();
    let mut add = |unknown: &Unknown,
                   scope: Scope,
                   cause: Cause,
                   of: &dyn Fn(&Around<'_>) -> Made|
     -> Result<(), ModelError> {
        let of_runs = all
            .iter()
            .map(|around| if around.run.kind == Kind::Insertion { of(around) } else { Ok(Vec::new()) })
            .collect::<Result<_, _>>()?;
        groups.push(GroupPatterns { group: group_of(unknown), scope, of_runs, cause });
        Ok(())
    };
    let modulus = |around: &Around<'_>| {
        let slope = around.slope(LN_STEP, |model, _| {
            model.foundation = model.foundation.scaled(LN_STEP.exp())?;
            Ok(())
        });
        Ok(vec![slope?])
    };
    let entry = |around: &Around<'_>| {
        let slope = around.slope(SHIFT_STEP_M, |model, _| {
            model.rig.entry_m += SHIFT_STEP_M;
            Ok(())
        });
        Ok(vec![slope?])
    };
    let roll = |around: &Around<'_>| {
        let slope = around.slope(ROLL_STEP_RAD, |model, _| {
            model.tip.along_bevel.roll_rad += ROLL_STEP_RAD;
            Ok(())
        });
        Ok(vec![slope?])
    };
    // The size of something that happens once cannot be found from it: it is known.
    add(&size::MODULUS_OF_ONE, Scope::Own, Cause::Run, &modulus)?;
    add(&size::LOAD_OF_ONE, Scope::Own, Cause::Run, &|around| Ok(vec![under_load(around, &|_| 1.0)?]))?;
    let by_hand = all.iter().any(|around| around.model.rig.has_one_guide());
    // The same groups by name, so that what a model file states of them holds for both.
    let [angle, tilt] = if by_hand {
        let named = |of: Unknown, by: Unknown| Unknown { name: of.name, ..by };
        [named(size::ENTRY_ANGLE, size::ENTRY_ANGLE_BY_HAND), named(size::TILT, size::TILT_BY_HAND)]
    } else {
        [size::ENTRY_ANGLE, size::TILT]
    };
    add(&angle, Scope::Own, Cause::INSTRUMENT, &|around| Ok(linear(around)))?;
    add(&size::SURFACE_OF_ONE, Scope::Own, Cause::Run, &entry)?;
    add(&size::ROLL_OF_ONE, Scope::Own, Cause::Run, &roll)?;
    let waves = |around: &Around<'_>| {
        (1..=LOAD_WAVES)
            .map(|k| under_load(around, &|depth_m| (k as f64 * PI * depth_m / SMOOTH_M).cos()))
            .collect::<Result<Vec<_>, _>>()
    };
    add(&size::LOAD_OVER_DEPTH_OF_ONE, Scope::Own, Cause::Physics, &waves)?;
    add(&size::LOAD_OVER_DEPTH, Scope::Shared, Cause::Physics, &waves)?;
    add(&size::DRIFT_OF_ONE, Scope::Own, Cause::Physics, &|around| Ok(smooth(around)))?;
    add(&size::SMOOTH_PATH, Scope::Shared, Cause::Physics, &|around| Ok(smooth(around)))?;
    add(&size::DIRECTION_DRIFT_OF_ONE, Scope::Own, Cause::Physics, &|around| Ok(smooth_direction(around)))?;
    add(&size::SMOOTH_DIRECTION, Scope::Shared, Cause::Physics, &|around| Ok(smooth_direction(around)))?;
    // A sensor is some millimetres long, and behind the tip.
    add(&size::DIRECTION_PROPORTIONAL, Scope::Shared, Cause::Physics, &|around| {
        Ok(proportional_direction(around))
    })?;
    add(&size::DIRECTION_PROPORTIONAL_OF_ONE, Scope::Own, Cause::Physics, &|around| {
        Ok(proportional_direction(around))
    })?;
    // A hand takes the needle again, along another line.
    add(&tilt, Scope::Shared, Cause::Instrument { mounted: by_hand }, &|around| Ok(linear(around)))?;
    add(&sensors::COIL_ANGLE, Scope::Shared, Cause::INSTRUMENT, &|around| Ok(coil(around)))?;
    add(&rig::GUIDE2_ZERO, Scope::Shared, Cause::Physics, &guide2)?;
    add(&tissue::SURFACE_IN_INSERTIONS, Scope::Shared, Cause::Mounting, &entry)?;
    add(&size::ROLL, Scope::Shared, Cause::Mounting, &roll)?;
    groups.retain(|group| group.of_runs.iter().flatten().flatten().any(|value| *value != 0.0));
    Ok(groups)
}

/// Change of the path where the tip load is larger by a share that varies with depth.
fn under_load(around: &Around<'_>, share: &dyn Fn(f64) -> f64) -> Result<Vec<f64>, ModelError> {
    let last_m = around.run.depth_m;
    let count = (last_m / KNOT_M).ceil().max(1.0) as usize;
    around.slope(1.0, |model, _| {
        if let Cutting::Load(planes) = &mut model.tip.cutting {
            for profile in planes {
                let loaded_point = |depth_m: f64| [depth_m, profile.before(depth_m) * (1.0 + share(depth_m))];
                let knots = (0..=count).map(|i| loaded_point(last_m * i as f64 / count as f64));
                *profile = Profile::new(knots.collect())?;
            }
        }
        Ok(())
    })
}

/// In each plane the path and the needle turned by an angle.
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

/// In each plane the measured direction turned by an angle.
fn coil(around: &Around<'_>) -> Vec<Vec<f64>> {
    waves(around, 0..1, |datum| matches!(datum.source, Source::Direction(_)))
}

/// In each plane something smooth in depth that the position of the tip has.
fn smooth(around: &Around<'_>) -> Vec<Vec<f64>> {
    waves(around, 1..PATH_WAVES + 1, |datum| matches!(datum.source, Source::Tip(_)))
}

/// In each plane something smooth in depth that the direction of the tip has.
fn smooth_direction(around: &Around<'_>) -> Vec<Vec<f64>> {
    waves(around, 1..DIRECTION_WAVES + 1, |datum| matches!(datum.source, Source::Direction(_)))
}

/// In each plane the direction larger by a share that is smooth in depth.
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

/// Waves over depth of these numbers in each plane, in some of the data.
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

/// In each plane guide 2 is off by a constant.
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
