//! Assigns shape points to holds.
//!
//! A point belongs to the hold during which it was measured. Clocks of two instruments are rounded to their own sampling and the
//! detection of holds cuts off what may still be motion, so a point stamped a little before or after a hold belongs to it too,
//! provided that guide 2 stood at the displacement of the hold at the last reading up to the stamp or at the reading next to it.

use super::detection::BIN_S;
use super::{Hold, HoldCriteria, Path};
use formats::session::{ForceSeries, ShapeSeries};
use std::ops::Range;

/// Times between readings, or bins, by which a stamp may lie outside a hold: one bin that detection always cuts off, one that noise
/// may, and the last sample itself.
const TOLERANCE_PERIODS: f64 = 3.0;
/// Distance from the hold's mean up to which guide 2 counts as at rest, standard deviations of a reading.
const STANDS_SD: f64 = 4.0;
/// A pause between the points of a sweep, in median steps of time, that separates two sweeps.
const PAUSE_STEPS: f64 = 5.0;

/// Why shape points belong to no hold.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct UnassignedPoints {
    /// First and last time.
    pub time_s: [f64; 2],
    /// Number of points.
    pub points: usize,
    /// Whether other points of the same sweep do belong to a hold.
    pub is_part: bool,
    /// Why.
    pub reason: &'static str,
}

/// Gives every level the shape points that belong to it; the rest, sweep by sweep.
pub(super) fn assign(
    levels: &mut [Hold],
    shape: &ShapeSeries,
    force: &ForceSeries,
    criteria: &HoldCriteria,
) -> Vec<UnassignedPoints> {
    let Some(times_s) = &shape.time_s else {
        if let Some(last) = levels.iter_mut().rev().find(|level| level.path != Path::Zero) {
            last.shape = (0..shape.z_m.len()).collect();
        }
        return Vec::new();
    };
    let tolerance_s = TOLERANCE_PERIODS * BIN_S.max(median_step(&force.time_s));
    let mut strays = Vec::new();
    for sweep in sweeps(times_s, &shape.z_m) {
        let mut stray_times_s: Vec<f64> = Vec::new();
        let points = sweep.len();
        for (index, time_s) in sweep.clone().zip(times_s.get(sweep).unwrap_or_default()) {
            match hold_of(levels, force, *time_s, tolerance_s, criteria).and_then(|at| levels.get_mut(at)) {
                Some(level) => level.shape.push(index),
                None => stray_times_s.push(*time_s),
            }
        }
        if !stray_times_s.is_empty() {
            let first_s = stray_times_s.iter().copied().fold(f64::INFINITY, f64::min);
            let last_s = stray_times_s.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            strays.push(UnassignedPoints {
                time_s: [first_s, last_s],
                points: stray_times_s.len(),
                is_part: stray_times_s.len() < points,
                reason: reason(levels, force, [first_s, last_s]),
            });
        }
    }
    strays
}

fn reason(levels: &[Hold], force: &ForceSeries, [first_s, last_s]: [f64; 2]) -> &'static str {
    let begins_s = force.time_s.first().copied().unwrap_or_default();
    let ends_s = force.time_s.last().copied().unwrap_or_default();
    if levels.is_empty() {
        "the run has no hold: hold guide 2 still for a second or more at each displacement"
    } else if last_s < begins_s || first_s > ends_s {
        "its times lie outside those of the force file: are both clocks the same?"
    } else {
        "guide 2 moves or is not held long enough then: hold for longer than a sweep takes"
    }
}

/// The hold that a stamp belongs to: the one that contains it, else the nearest within the tolerance at which guide 2 stood.
fn hold_of(
    levels: &[Hold],
    force: &ForceSeries,
    time_s: f64,
    tolerance_s: f64,
    criteria: &HoldCriteria,
) -> Option<usize> {
    let nearest = (0..levels.len())
        .min_by(|a, b| outside_s(&levels[*a], time_s).total_cmp(&outside_s(&levels[*b], time_s)))?;
    let level = levels.get(nearest)?;
    let distance_s = outside_s(level, time_s);
    if distance_s == 0.0 {
        return Some(nearest);
    }
    // The reading at or before the stamp, and the one next to it: the guide moved no earlier than after the former.
    let next_row = force.time_s.partition_point(|row_s| *row_s <= time_s);
    let previous_row = next_row.saturating_sub(1);
    let next = if gap_s(next_row, time_s, &force.time_s) < gap_s(previous_row, time_s, &force.time_s) {
        next_row
    } else {
        previous_row
    };
    let stands = |row: usize| {
        let planes = [
            (Some(&force.displacement_y_m), Some(level.displacement_y_m)),
            (force.displacement_x_m.as_ref(), level.displacement_x_m),
        ];
        planes.into_iter().all(|(column, mean)| match (column.and_then(|column| column.get(row)), mean) {
            (Some(at_m), Some(mean)) => {
                (at_m - mean.value).abs() <= (STANDS_SD * mean.scatter).max(2.0 * criteria.still_m)
            }
            _ => true,
        })
    };
    (distance_s <= tolerance_s * (1.0 + 1e-9) && (stands(previous_row) || stands(next))).then_some(nearest)
}

fn gap_s(row: usize, time_s: f64, force_time_s: &[f64]) -> f64 {
    force_time_s.get(row).map_or(f64::INFINITY, |row_s| (row_s - time_s).abs())
}

/// Time between a hold and a moment outside it.
fn outside_s(level: &Hold, time_s: f64) -> f64 {
    (level.time_s[0] - time_s).max(time_s - level.time_s[1]).max(0.0)
}

/// The sweeps of a shape series: points of one stamp where stamps repeat, else points without a pause and without a jump back.
fn sweeps(times_s: &[f64], z_m: &[f64]) -> Vec<Range<usize>> {
    let rows = times_s.len().min(z_m.len());
    let mut distinct = times_s.to_vec();
    distinct.sort_by(f64::total_cmp);
    distinct.dedup();
    let stamped = 2 * distinct.len() <= rows;
    let pause_s = PAUSE_STEPS * median_step(times_s);
    let (low_m, high_m) =
        z_m.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), z| (low.min(*z), high.max(*z)));
    let is_new = |row: usize| {
        let (Some([t0_s, t1_s]), Some([z0_m, z1_m])) = (times_s.get(row - 1..=row), z_m.get(row - 1..=row))
        else {
            return false;
        };
        if stamped {
            return t1_s != t0_s;
        }
        (t1_s - t0_s).abs() > pause_s || (z1_m - z0_m).abs() > 0.5 * (high_m - low_m)
    };
    let mut sweeps_found = Vec::new();
    let mut start = 0;
    for row in 1..=rows {
        if row == rows || is_new(row) {
            sweeps_found.push(start..row);
            start = row;
        }
    }
    sweeps_found.retain(|sweep: &Range<usize>| !sweep.is_empty());
    sweeps_found
}

/// Median of the positive steps of time; 0 where there is none.
fn median_step(times_s: &[f64]) -> f64 {
    let steps = times_s.iter().zip(times_s.iter().skip(1)).map(|(a, b)| (b - a).abs());
    // 0 for fewer than two sweeps.
    super::median::median(steps.filter(|step_s| *step_s > 0.0).collect()).max(0.0)
}
