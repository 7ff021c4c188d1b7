//! Rows of a recording that are readings of a needle that goes in: each row that is not is skipped for a stated reason.

use super::super::InsertionRun;
use serde::Serialize;
use std::fmt;

/// Why a row of a recording is skipped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SkipReason {
    /// The tip sensor gave no number.
    Missing,
    /// The tip sensor gave zeros.
    Silent,
    /// The reading before it once more, bit for bit, while the guide moved: the sensor was frozen.
    Frozen,
    /// The reading before it once more, bit for bit, at rest: not a new reading.
    Repeated,
    /// A position far from those before and after it, or before the first ones.
    Jump,
    /// The needle was drawn out: after the last reading near the deepest one.
    Withdrawn,
    /// A value that a session cannot have.
    OutOfRange,
}

impl fmt::Display for SkipReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Missing => "missing: the tip sensor gave no number",
            Self::Silent => "silent: the tip sensor gave 0, 0, 0",
            Self::Frozen => "frozen: the same reading again while the guide moved",
            Self::Repeated => "repeated: the same reading again, at rest",
            Self::Jump => "jump: more than 20 mm from the readings before and after it",
            Self::Withdrawn => "withdrawn: the needle was drawn out at the end",
            Self::OutOfRange => "out of range: a value that a session cannot have",
        })
    }
}

/// Rows that were skipped for one reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Skipped {
    /// Why.
    pub reason: SkipReason,
    /// Number of rows.
    pub rows: usize,
    /// The first of them; rows count from 1 below the header.
    pub first_row: usize,
}

impl fmt::Display for Skipped {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let rows = if self.rows == 1 { "row" } else { "rows" };
        write!(f, "{} {rows} from row {} on, {}", self.rows, self.first_row, self.reason)
    }
}

/// Positions that differ by more than this from those before and after are no motion of a needle that is pushed by hand.
const JUMP_M: f64 = 20e-3;
/// A jump comes back within so many rows.
const JUMP_ROWS: usize = 50;
/// Rows this far behind the deepest one, to the end of the recording, are a withdrawal.
const WITHDRAWN_M: f64 = 3e-3;
/// A guide that moves by less than this is at rest.
const GUIDE_STILL_M: f64 = 0.05e-3;

/// The part of a recording's row that is screened.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Reading {
    /// Depth, and tip position in both planes, m.
    pub tip_m: [f64; 3],
    /// Slopes of the needle at the tip, or other output of the tip sensor; compared bit for bit.
    pub orientation: [f64; 4],
    /// The guide in both planes, m.
    pub guide_m: [f64; 2],
}

impl Reading {
    /// Whether the tip sensor gave a position: without one it writes zeros, or no numbers.
    pub fn is_measured(&self) -> bool {
        self.tip_m.iter().all(|m| m.is_finite()) && self.tip_m.iter().any(|m| *m != 0.0)
    }
}

/// Per row the reason for which it is skipped, if any. `is_valid`: whether a row is valid in a session.
pub(super) fn screen(readings: &[Reading], is_valid: impl Fn(usize) -> bool) -> Vec<Option<SkipReason>> {
    let mut reasons = vec![None; readings.len()];
    for (row, reading) in readings.iter().enumerate() {
        if !reading.tip_m.iter().all(|m| m.is_finite()) {
            reasons[row] = Some(SkipReason::Missing);
        } else if !reading.is_measured() {
            reasons[row] = Some(SkipReason::Silent);
        }
    }
    repeated(readings, &mut reasons);
    jumps(readings, &mut reasons);
    withdrawn(readings, &mut reasons);
    for (row, reason) in reasons.iter_mut().enumerate() {
        if reason.is_none() && !is_valid(row) {
            *reason = Some(SkipReason::OutOfRange);
        }
    }
    reasons
}

/// Per row the reason for which a position is none of a needle that goes in, if any: of sensors that mark readings that are missing otherwise.
pub(crate) fn screen_positions(readings: &[Reading]) -> Vec<Option<SkipReason>> {
    let mut reasons = vec![None; readings.len()];
    jumps(readings, &mut reasons);
    withdrawn(readings, &mut reasons);
    reasons
}

/// Rows that were skipped, by reason, in the order of their first rows.
pub(crate) fn count(reasons: &[Option<SkipReason>]) -> Vec<Skipped> {
    let mut counts: Vec<Skipped> = Vec::new();
    for (row, reason) in reasons.iter().enumerate().filter_map(|(row, reason)| Some((row, (*reason)?))) {
        match counts.iter_mut().find(|skipped| skipped.reason == reason) {
            Some(skipped) => skipped.rows += 1,
            None => counts.push(Skipped { reason, rows: 1, first_row: row + 1 }),
        }
    }
    counts
}

impl InsertionRun {
    /// The same with some of its rows.
    pub(crate) fn only(&self, keep: impl Fn(usize) -> bool) -> Self {
        let kept_values = |values: &Vec<f64>| -> Vec<f64> {
            values.iter().enumerate().filter(|(row, _)| keep(*row)).map(|(_, value)| *value).collect()
        };
        let column = |values: &Option<Vec<f64>>| values.as_ref().map(kept_values);
        Self {
            id: self.id.clone(),
            path: self.path.clone(),
            depth_m: kept_values(&self.depth_m),
            tip_y_m: kept_values(&self.tip_y_m),
            tip_x_m: column(&self.tip_x_m),
            time_s: column(&self.time_s),
            rotation_rad: column(&self.rotation_rad),
            guide2_y_m: column(&self.guide2_y_m),
            guide2_x_m: column(&self.guide2_x_m),
            base_force_y_n: column(&self.base_force_y_n),
            tip_direction_y_rad: column(&self.tip_direction_y_rad),
            tip_direction_x_rad: column(&self.tip_direction_x_rad),
        }
    }
}

/// Rows that are kept so far.
fn kept(reasons: &[Option<SkipReason>]) -> Vec<usize> {
    (0..reasons.len()).filter(|row| reasons[*row].is_none()).collect()
}

/// Real readings scatter: one that is the same bit for bit as the one before is that one.
fn repeated(readings: &[Reading], reasons: &mut [Option<SkipReason>]) {
    fn is_repeated(a: &Reading, b: &Reading) -> bool {
        a.tip_m == b.tip_m && a.orientation == b.orientation
    }
    for group in kept(reasons).chunk_by(|a, b| is_repeated(&readings[*a], &readings[*b])) {
        let moved_m = [0, 1].map(|plane: usize| {
            let plane_m = group.iter().map(|row| readings[*row].guide_m[plane]);
            let (low_m, high_m) = plane_m.fold((f64::MAX, f64::MIN), |(l, h), m| (l.min(m), h.max(m)));
            high_m - low_m
        });
        let frozen = moved_m[0].max(moved_m[1]) > GUIDE_STILL_M;
        let reason = if frozen { SkipReason::Frozen } else { SkipReason::Repeated };
        group.iter().skip(1).for_each(|row| reasons[*row] = Some(reason));
    }
}

/// Positions far from the last good one that come back to it.
fn jumps(readings: &[Reading], reasons: &mut [Option<SkipReason>]) {
    let rows = kept(reasons);
    let jump_size = |a: usize, b: usize| {
        let (a, b) = (readings[a].tip_m, readings[b].tip_m);
        a.iter().zip(b).any(|(a, b)| (a - b).abs() > JUMP_M)
    };
    // The first good one is near the one after it.
    let Some(start) =
        (0..rows.len()).find(|i| rows.get(i + 1).is_some_and(|next| !jump_size(rows[*i], *next)))
    else {
        return;
    };
    rows[..start].iter().for_each(|row| reasons[*row] = Some(SkipReason::Jump));
    let mut good = start;
    let mut row_index = start + 1;
    while row_index < rows.len() {
        let next_rows = rows.iter().skip(row_index + 1).take(JUMP_ROWS);
        let returns = jump_size(rows[good], rows[row_index])
            && next_rows
                .clone()
                .any(|later| !jump_size(rows[good], *later) && jump_size(rows[row_index], *later));
        // The last row of all cannot come back: a needle that is drawn out goes on from there, a misreading does not.
        let alone = row_index + 1 == rows.len() && jump_size(rows[good], rows[row_index]);
        if returns || alone {
            reasons[rows[row_index]] = Some(SkipReason::Jump);
        } else {
            good = row_index;
        }
        row_index += 1;
    }
}

/// Everything after the last reading near the deepest one.
fn withdrawn(readings: &[Reading], reasons: &mut [Option<SkipReason>]) {
    let rows = kept(reasons);
    let depth_m = |row: &usize| readings[*row].tip_m[0];
    let deepest_m = rows.iter().map(depth_m).fold(f64::NEG_INFINITY, f64::max);
    let Some(last) = rows.iter().rposition(|row| depth_m(row) >= deepest_m - WITHDRAWN_M) else { return };
    rows[last + 1..].iter().for_each(|row| reasons[*row] = Some(SkipReason::Withdrawn));
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Depth and guide in millimetres; the tip's lateral positions scatter, so that no two rows are alike.
    fn readings(rows: &[[f64; 2]]) -> Vec<Reading> {
        rows.iter()
            .enumerate()
            .map(|(i, [depth_mm, guide_mm])| Reading {
                tip_m: [1e-3 * depth_mm, 1e-3 + 1e-6 * i as f64, 2e-3],
                orientation: [1.0, 0.0, 0.0, 1e-4 * i as f64],
                guide_m: [0.0, 1e-3 * guide_mm],
            })
            .collect()
    }

    fn reasons(readings: &[Reading]) -> Vec<Skipped> {
        count(&screen(readings, |row| readings[row].tip_m[0] > -0.05))
    }

    #[test]
    fn distinguishes_a_frozen_sensor_from_one_at_rest() {
        let mut rows =
            readings(&[[1.0, 0.0], [2.0, 0.0], [2.0, 0.0], [2.0, 0.0], [3.0, 0.0], [3.0, 0.5], [3.0, 1.0]]);
        (rows[3].tip_m, rows[3].orientation) = (rows[2].tip_m, rows[2].orientation);
        for row in [5, 6] {
            (rows[row].tip_m, rows[row].orientation) = (rows[4].tip_m, rows[4].orientation);
        }
        let skipped = reasons(&rows);
        assert_eq!(
            skipped,
            [
                Skipped { reason: SkipReason::Repeated, rows: 1, first_row: 4 },
                Skipped { reason: SkipReason::Frozen, rows: 2, first_row: 6 }
            ]
        );
        // With the same position and another orientation it is a reading of its own.
        rows[3].orientation[3] += 1e-6;
        assert_eq!(reasons(&rows).len(), 1);
    }

    #[test]
    fn jumps_are_skipped_wherever_they_are_and_motion_is_not() {
        let depth = [-300.0, 0.0, 5.0, 70.0, 71.0, 6.0, 9.0, 14.0, 40.0, 45.0, 50.0, -50.5];
        let rows = readings(&depth.map(|mm| [mm, 0.0]));
        assert_eq!(reasons(&rows), [Skipped { reason: SkipReason::Jump, rows: 4, first_row: 1 }]);
        let kept_rows: Vec<usize> =
            (0..rows.len()).filter(|row| screen(&rows, |_| true)[*row].is_none()).collect();
        // From 14 to 40 mm it went on: the needle was pushed while nothing was recorded.
        assert_eq!(kept_rows, [1, 2, 5, 6, 7, 8, 9, 10]);
    }

    #[test]
    fn a_withdrawal_at_the_end_is_skipped_and_springing_back_is_not() {
        let depth = [0.0, 20.0, 18.5, 20.0, 40.0, 38.0, 37.5, 30.0, 10.0, -48.0, -50.5, -51.0];
        let skipped = reasons(&readings(&depth.map(|mm| [mm, 0.0])));
        assert_eq!(skipped, [Skipped { reason: SkipReason::Withdrawn, rows: 5, first_row: 8 }]);
        assert_eq!(
            skipped[0].to_string(),
            "5 rows from row 8 on, withdrawn: the needle was drawn out at the end"
        );
    }

    #[test]
    fn what_a_session_cannot_have_is_skipped_for_that() {
        let depth = [-60.0, -58.0, -45.0, -30.0, -15.0, 0.0, 10.0];
        let skipped = reasons(&readings(&depth.map(|mm| [mm, 0.0])));
        assert_eq!(skipped, [Skipped { reason: SkipReason::OutOfRange, rows: 2, first_row: 1 }]);
    }

    #[test]
    fn no_rows_skip_nothing_and_rows_without_signal_are_skipped() {
        assert!(reasons(&[]).is_empty());
        let silent = Reading { tip_m: [0.0; 3], orientation: [0.0; 4], guide_m: [0.0; 2] };
        assert_eq!(reasons(&[silent; 3]), [Skipped { reason: SkipReason::Silent, rows: 3, first_row: 1 }]);
    }
}
