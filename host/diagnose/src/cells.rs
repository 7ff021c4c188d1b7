//! Division of a lateral recording into cells, which are means over a twentieth of a second without outliers, and into stretches of
//! cells over which forces are averaged.

use super::course::{Track, Window, course};
use formats::session::LateralRun;
use readings::holds::Hold;
use readings::outliers::farthest;
use std::ops::Range;

/// Time at either end of a hold that may still be motion, and is not part of the hold's cells.
const EDGE_S: f64 = 0.1;
/// Length of a cell, and largest length of the last cell of a hold or of a motion.
const CELL_S: f64 = 0.05;
const LONGEST_CELL_S: f64 = 1.5 * CELL_S;
/// Ends of the stretches of a hold, in seconds from its begin; after the last one the stretches have the length of the last value.
const HOLD_S: [f64; 8] = [0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.5, 6.0];
/// Length of the stretches of a motion, in cells.
const RAMP_CELLS: usize = 2;

/// Cells of a lateral run: means over about a twentieth of a second.
#[derive(Debug, Clone, Default)]
pub(super) struct Cells {
    pub time_s: Vec<f64>,
    /// Vertical and horizontal force; NaN where no reading is usable.
    pub force_n: [Vec<f64>; 2],
    /// Readings of the displacement, before any correction.
    pub read_m: [Vec<f64>; 2],
    /// Number of the hold of every cell; `None` during a motion.
    pub hold: Vec<Option<usize>>,
    /// Time from the first to the last reading of every cell.
    pub length_s: Vec<f64>,
    /// Cells in which guide 2 may have moved, vertically and horizontally.
    pub windows: [Vec<Window>; 2],
    /// Scatter of the readings of the force within the cells of holds.
    pub force_scatter: Scatter,
    /// Scatter of the readings of the displacement within the cells of holds.
    pub displacement_scatter: Scatter,
}

/// Scatter of single readings about the mean of the cell in which they are averaged.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Scatter {
    cells: usize,
    readings: usize,
    /// Sum of the squared deviations.
    squares: f64,
}

impl Scatter {
    /// Adds the readings of a cell.
    fn add(&mut self, readings: &[f64], mean: f64) {
        let usable = readings.iter().filter(|value| value.is_finite());
        self.cells += 1;
        self.readings += usable.clone().count();
        self.squares += usable.map(|value| (value - mean).powi(2)).sum::<f64>();
    }

    /// Pooled scatter of two recordings.
    pub fn with(self, other: Self) -> Self {
        Self {
            cells: self.cells + other.cells,
            readings: self.readings + other.readings,
            squares: self.squares + other.squares,
        }
    }

    /// Mean number of readings of a cell.
    pub fn readings_of_a_cell(self) -> f64 {
        if self.cells == 0 { 1.0 } else { (self.readings as f64 / self.cells as f64).max(1.0) }
    }

    /// Mean squared deviation of the readings from the mean of their cell: the variance of a reading less that of a cell's mean.
    pub fn within_cells(self) -> f64 {
        if self.readings == 0 { 0.0 } else { self.squares / self.readings as f64 }
    }
}

/// Readings, with those far from the median of their neighbourhood replaced by NaN.
fn cleaned(values: &[f64]) -> Vec<f64> {
    const REACH: usize = 3;
    let deviations: Vec<f64> = (0..values.len())
        .map(|i| {
            let neighbourhood = &values[i.saturating_sub(REACH)..(i + REACH + 1).min(values.len())];
            let mut sorted = neighbourhood.to_vec();
            sorted.sort_by(f64::total_cmp);
            values[i] - sorted[sorted.len() / 2]
        })
        .collect();
    // A reading that is itself the median has no deviation; such zeros would lower the threshold.
    let farthest = farthest(deviations.iter().copied().filter(|deviation| *deviation != 0.0));
    values
        .iter()
        .zip(deviations)
        .map(|(v, deviation)| if deviation.abs() > farthest { f64::NAN } else { *v })
        .collect()
}

/// Mean of the finite readings.
fn mean(values: &[f64]) -> f64 {
    let usable = values.iter().filter(|v| v.is_finite());
    usable.clone().sum::<f64>() / usable.count() as f64
}

/// Divides a recording into cells. A cell contains readings of one hold, or of one motion.
pub(super) fn cells(run: &LateralRun, holds: &[Hold]) -> Cells {
    let force = &run.force;
    let rows = force.time_s.len();
    let zeros = vec![0.0; rows];
    let force_n = [cleaned(&force.force_y_n), force.force_x_n.as_deref().map_or(zeros.clone(), cleaned)];
    let read_m = [force.displacement_y_m.clone(), force.displacement_x_m.clone().unwrap_or(zeros)];
    let hold_of_rows = force.time_s.iter().map(|time_s| {
        holds.iter().position(|hold| {
            let [begin_s, end_s] = hold.time_s;
            (begin_s + EDGE_S..=end_s - EDGE_S).contains(time_s) && hold.lost_samples == 0
        })
    });
    let hold_of_rows: Vec<Option<usize>> = hold_of_rows.collect();
    let mut cells = Cells::default();
    let mut row = 0;
    while row < rows {
        let hold = hold_of_rows[row];
        // The last cell of a hold or of a motion takes up the remaining readings, because a cell of few readings would be noisier.
        let [end, longest] = [CELL_S, LONGEST_CELL_S].map(|length_s| {
            let end_s = force.time_s[row] + length_s * (1.0 - 1e-9);
            let in_cell =
                (row + 1..rows).take_while(|i| force.time_s[*i] < end_s && hold_of_rows[*i] == hold);
            in_cell.last().unwrap_or(row) + 1
        });
        let is_last = hold_of_rows.get(longest).is_none_or(|next| *next != hold);
        let end = if is_last { longest } else { end };
        cells.time_s.push(mean(&force.time_s[row..end]));
        cells.length_s.push(force.time_s[end - 1] - force.time_s[row]);
        for plane in 0..2 {
            let (cell_n, cell_m) = (mean(&force_n[plane][row..end]), mean(&read_m[plane][row..end]));
            // A missing column is all zeros.
            if hold.is_some() && cell_n.is_finite() && cell_n != 0.0 {
                cells.force_scatter.add(&force_n[plane][row..end], cell_n);
            }
            if hold.is_some() && cell_m != 0.0 {
                cells.displacement_scatter.add(&read_m[plane][row..end], cell_m);
            }
            cells.force_n[plane].push(cell_n);
            cells.read_m[plane].push(cell_m);
        }
        cells.hold.push(hold);
        row = end;
    }
    cells
}

/// Position of guide 2 in every hold: mean of the readings inside it.
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

/// Position of guide 2 in every cell of a plane, and the windows in which it is not that of a hold, for a sensor of this standard deviation.
pub(super) fn travelled(
    cells: &Cells,
    plane: usize,
    stood_m: &[[f64; 2]],
    sd_m: f64,
) -> (Vec<f64>, Vec<Window>) {
    let stood_m: Vec<f64> = stood_m.iter().map(|m| m[plane]).collect();
    let track = Track {
        time_s: &cells.time_s,
        length_s: &cells.length_s,
        read_m: &cells.read_m[plane],
        hold: &cells.hold,
        sd_m,
    };
    course(&track, &stood_m)
}

/// Range of the cells of every hold.
pub(super) fn held(cells: &Cells) -> Vec<Range<usize>> {
    let mut start = 0;
    let mut held_runs = Vec::new();
    for same in cells.hold.chunk_by(|a, b| a == b) {
        if same.first().is_some_and(Option::is_some) {
            held_runs.push(start..start + same.len());
        }
        start += same.len();
    }
    held_runs
}

/// Stretches of cells over which forces are averaged.
pub(super) fn stretches(cells: &Cells) -> Vec<Range<usize>> {
    let mut stretches = Vec::new();
    let mut start = 0;
    while start < cells.hold.len() {
        let hold = cells.hold[start];
        let end = start + cells.hold[start..].iter().take_while(|other| **other == hold).count();
        let classes = (start..end).map(|i| match hold {
            None => (i - start) / RAMP_CELLS,
            Some(_) => {
                let elapsed_s = cells.time_s[i] - cells.time_s[start];
                let extra_parts = (elapsed_s / HOLD_S[HOLD_S.len() - 1]) as usize;
                if extra_parts > 0 {
                    HOLD_S.len() + extra_parts
                } else {
                    HOLD_S.partition_point(|s| *s <= elapsed_s)
                }
            }
        });
        for stretch in classes.collect::<Vec<usize>>().chunk_by(|a, b| a == b) {
            stretches.push(start..start + stretch.len());
            start += stretch.len();
        }
    }
    stretches
}
