//! A lateral recording in cells: means over a twentieth of a second, without what is misread, and stretches of cells over which forces
//! are averaged.

use crate::holds::Hold;
use formats::session::LateralRun;
use std::ops::Range;

/// At either end of a hold so much may still be motion.
const EDGE_S: f64 = 0.1;
/// Length of a cell.
const CELL_S: f64 = 0.05;
/// Ends of the stretches of a hold; beyond the last in steps of it.
const HOLD_S: [f64; 8] = [0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.5, 6.0];
/// Stretches of ramps, in cells.
const RAMP_CELLS: usize = 2;
/// Readings so many standard deviations off their neighbours are misread.
const MISREAD: f64 = 5.0;

/// Drive samples of a lateral run: means over stretches of at least a twentieth of a second.
#[derive(Debug, Clone, Default)]
pub(super) struct Cells {
    pub time_s: Vec<f64>,
    /// Vertical and horizontal force; NaN where no reading is usable.
    pub force_n: [Vec<f64>; 2],
    /// Readings of the displacement, as read.
    pub read_m: [Vec<f64>; 2],
    /// The hold of every cell.
    pub hold: Vec<Option<usize>>,
}

/// Readings, those that are far off their neighbours as NaN.
fn cleaned(values: &[f64]) -> Vec<f64> {
    const REACH: usize = 3;
    let off: Vec<f64> = (0..values.len())
        .map(|i| {
            let around = &values[i.saturating_sub(REACH)..(i + REACH + 1).min(values.len())];
            let mut sorted = around.to_vec();
            sorted.sort_by(f64::total_cmp);
            values[i] - sorted[sorted.len() / 2]
        })
        .collect();
    let mut sizes: Vec<f64> = off.iter().map(|off| off.abs()).filter(|off| *off > 0.0).collect();
    sizes.sort_by(f64::total_cmp);
    let usual = 1.4826 * sizes.get(sizes.len() / 2).copied().unwrap_or(0.0);
    values.iter().zip(off).map(|(v, off)| if off.abs() > MISREAD * usual { f64::NAN } else { *v }).collect()
}

/// Means over short stretches of a recording.
pub(super) fn cells(run: &LateralRun, holds: &[Hold]) -> Cells {
    let force = &run.force;
    let rows = force.time_s.len();
    let zeros = || vec![0.0; rows];
    let force_n = [cleaned(&force.force_y_n), force.force_x_n.as_deref().map_or_else(zeros, cleaned)];
    let read_m = [force.displacement_y_m.clone(), force.displacement_x_m.clone().unwrap_or_else(zeros)];
    let hold_of = |time_s: f64| {
        let inside = |h: &Hold| (h.time_s[0] + EDGE_S..=h.time_s[1] - EDGE_S).contains(&time_s);
        holds.iter().position(|h| inside(h) && h.lost_samples == 0)
    };
    let mut cells = Cells::default();
    let mut row = 0;
    while row < rows {
        let hold = hold_of(force.time_s[row]);
        let end_s = force.time_s[row] + CELL_S * (1.0 - 1e-9);
        let mut end = row + 1;
        while end < rows && force.time_s[end] < end_s && hold_of(force.time_s[end]) == hold {
            end += 1;
        }
        let mean = |values: &[f64]| {
            let usable = values[row..end].iter().filter(|v| v.is_finite());
            usable.clone().sum::<f64>() / usable.count() as f64
        };
        cells.time_s.push(mean(&force.time_s));
        for plane in 0..2 {
            cells.force_n[plane].push(mean(&force_n[plane]));
            cells.read_m[plane].push(mean(&read_m[plane]));
        }
        cells.hold.push(hold);
        row = end;
    }
    cells
}

/// Where guide 2 stood in every hold: mean of the readings inside it.
pub(super) fn stood(cells: &Cells, holds: usize) -> Vec<[f64; 2]> {
    let mut sums = vec![[0.0; 3]; holds];
    for (i, hold) in cells.hold.iter().enumerate() {
        if let Some(sum) = hold.and_then(|hold| sums.get_mut(hold)) {
            sum[0] += cells.read_m[0][i];
            sum[1] += cells.read_m[1][i];
            sum[2] += 1.0;
        }
    }
    sums.into_iter().map(|[y, x, count]| [y / count, x / count]).collect()
}

/// Where guide 2 was in every cell, vertical and horizontal: in a hold its mean, between holds as read. A reading that lies beyond the
/// holds on both sides by less than a reversal is noise about them: guide 2 has not gone there and come back.
pub(super) fn travelled(cells: &Cells, stood_m: &[[f64; 2]], reversal_m: [f64; 2]) -> [Vec<f64>; 2] {
    let count = cells.hold.len();
    let mut after = vec![None; count];
    let mut next = None;
    for (after, hold) in after.iter_mut().zip(&cells.hold).rev() {
        next = hold.or(next);
        *after = next;
    }
    let mut before = None;
    let mut places: [Vec<f64>; 2] = [0, 1].map(|_| Vec::with_capacity(count));
    for (i, after) in after.into_iter().enumerate() {
        before = cells.hold[i].or(before);
        for (plane, places) in places.iter_mut().enumerate() {
            let read_m = cells.read_m[plane][i];
            let around = || [before, after].into_iter().flatten().filter_map(|hold| stood_m.get(hold));
            let low_m = around().map(|m| m[plane]).fold(f64::INFINITY, f64::min);
            let high_m = around().map(|m| m[plane]).fold(f64::NEG_INFINITY, f64::max);
            if let Some(stood_m) = cells.hold[i].and_then(|hold| stood_m.get(hold)) {
                places.push(stood_m[plane]);
                continue;
            }
            let is_noise =
                low_m <= high_m && (low_m - reversal_m[plane]..=high_m + reversal_m[plane]).contains(&read_m);
            places.push(if is_noise { read_m.clamp(low_m, high_m) } else { read_m });
        }
    }
    places
}

/// Cells of every hold.
pub(super) fn held(cells: &Cells) -> Vec<Range<usize>> {
    let mut start = 0;
    let mut found = Vec::new();
    for same in cells.hold.chunk_by(|a, b| a == b) {
        if same.first().is_some_and(Option::is_some) {
            found.push(start..start + same.len());
        }
        start += same.len();
    }
    found
}

/// Stretches of cells over which forces are averaged.
pub(super) fn stretches(cells: &Cells) -> Vec<Range<usize>> {
    let mut stretches = Vec::new();
    let mut start = 0;
    while start < cells.hold.len() {
        let hold = cells.hold[start];
        let end = start + cells.hold[start..].iter().take_while(|other| **other == hold).count();
        let mut from = start;
        for i in start..end {
            let since_s = |i: usize| cells.time_s[i] - cells.time_s[start];
            let class = |i: usize| match hold {
                None => (i - start) / RAMP_CELLS,
                Some(_) => {
                    let last_s = HOLD_S[HOLD_S.len() - 1];
                    let beyond = (since_s(i) / last_s) as usize;
                    if beyond > 0 {
                        HOLD_S.len() + beyond
                    } else {
                        HOLD_S.partition_point(|s| *s <= since_s(i))
                    }
                }
            };
            if i + 1 == end || class(i + 1) != class(i) {
                stretches.push(from..i + 1);
                from = i + 1;
            }
        }
        start = end;
    }
    stretches
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn guide_2_goes_no_further_than_the_holds_it_is_on_its_way_to() {
        let read_m = vec![0.0, 0.2, 0.5, 1.02, 1.0, 1.0, 0.99, 1.5, 0.3, 0.0];
        let hold = vec![Some(0), None, None, None, Some(1), Some(1), None, None, None, Some(2)];
        let cells = Cells { read_m: [read_m, vec![0.0; 10]], hold, ..Cells::default() };
        let stood_m = [[0.0; 2], [1.0, 0.0], [0.0; 2]];
        let [y, x] = travelled(&cells, &stood_m, [0.05; 2]);
        // 1.02 is noise about the hold; 1.5 is where guide 2 has been.
        assert_eq!(y, [0.0, 0.2, 0.5, 1.0, 1.0, 1.0, 0.99, 1.5, 0.3, 0.0]);
        assert_eq!(x, [0.0; 10]);
    }
}
