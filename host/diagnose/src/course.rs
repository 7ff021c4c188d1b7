//! The trajectory of guide 2 from noisy readings.
//!
//! The input of the model is the position of guide 2, whose readings have errors. If these readings were taken as exact, their
//! white noise would favour a delayed force, because a delay averages the noise. Therefore the trajectory between two holds is
//! unknown ([`Window`]), and the model uses its posterior mean: the errors about that mean are uncorrelated with it and cause
//! no bias (regression calibration). Their covariance enters that of the forces.
//!
//! A priori guide 2 starts at any time, moves at constant speed and stops at any time; the deviation from that motion has normal
//! second differences with an unknown scale, from zero to twice the largest one of the readings. The posterior averages over times
//! and scale, weighted by their likelihood. The priors of the times are uniform, so that the mean has no tendency to start or to
//! stop early. A hold is detected only when motion exceeds the noise; therefore the window of the unknown trajectory extends into
//! the holds for as long as noise can hide motion at the mean speed. Readings without noise are followed exactly.
//!
//! Carroll, Ruppert, Stefanski and Crainiceanu, "Measurement error in nonlinear models" (2006), chapter 4; Wahba, "A
//! comparison of GCV and GML for choosing the smoothing parameter" (1985).

use nalgebra::{DMatrix, DVector};
use std::f64::consts::PI;
use std::ops::Range;

/// Ratio of neighbouring sizes of the second differences on the grid, and shift of the middle of the window by the smallest size, in standard
/// deviations of a reading.
const SIZE_RATIO: f64 = 2.0;
const UNSEEN_SHIFT: f64 = 0.1;
/// If the largest second difference exceeds this many standard deviations of a reading, the noise is negligible.
const NO_NOISE: f64 = 1e3;
/// Number of start times, and of stop times, on the grid, and number of times that the grid is narrowed to the likely range.
const TIMES: usize = 24;
const REFINEMENTS: usize = 3;
/// Shortest motion, as a fraction of a cell: a shorter one does not differ from a step.
const STEP: f64 = 0.1;
/// Times and sizes whose probability, relative to the largest, is below this are ignored.
const NEGLIGIBLE: f64 = 1e-4;
/// Number of standard deviations that noise does not exceed.
const NO_CHANCE: f64 = 3.0;

/// Readings of one plane, in cells.
pub(super) struct Track<'a> {
    /// Middle of every cell, s.
    pub time_s: &'a [f64],
    /// Time from the first to the last reading of a cell, s.
    pub length_s: &'a [f64],
    /// Mean reading of every cell.
    pub read_m: &'a [f64],
    /// Number of the hold of every cell; `None` during a motion.
    pub hold: &'a [Option<usize>],
    /// Standard deviation of the reading of a cell.
    pub sd_m: f64,
}

/// Cells in which guide 2 may have moved, and the covariance of its positions there, in units of the variance of a reading.
#[derive(Debug, Clone)]
pub(super) struct Window {
    /// The cells.
    pub cells: Range<usize>,
    /// Covariance of their positions.
    pub covariance: DMatrix<f64>,
}

impl Window {
    /// Covariance of the mean positions of two stretches of cells.
    pub fn covariance_of(&self, one: &[usize], other: &[usize]) -> f64 {
        let mut sum = 0.0;
        for row in self.inside(one) {
            sum += self.inside(other).filter_map(|column| self.covariance.get((row, column))).sum::<f64>();
        }
        sum / (one.len() * other.len()) as f64
    }

    /// Indices within the window of those of the cells that are in it.
    fn inside(&self, cells: &[usize]) -> impl Iterator<Item = usize> {
        let count = self.cells.len();
        cells
            .iter()
            .filter_map(move |cell| cell.checked_sub(self.cells.start))
            .filter(move |row| *row < count)
    }
}

/// Posterior mean of the position of guide 2 in every cell, and the windows in which guide 2 may have moved. `stood_m` are the positions of
/// the holds.
pub(super) fn course(track: &Track<'_>, stood_m: &[f64]) -> (Vec<f64>, Vec<Window>) {
    let holds_m: Vec<Option<f64>> =
        track.hold.iter().map(|hold| hold.and_then(|hold| stood_m.get(hold).copied())).collect();
    let mut positions_m: Vec<f64> =
        track.read_m.iter().zip(&holds_m).map(|(read_m, hold_m)| hold_m.unwrap_or(*read_m)).collect();
    let mut windows = Vec::new();
    let mut start = 0;
    let chunks: Vec<&[Option<usize>]> = track.hold.chunk_by(|a, b| a == b).collect();
    for (number, same) in chunks.iter().enumerate() {
        let gap = start..start + same.len();
        start = gap.end;
        if same.first().is_none_or(Option::is_some) {
            continue;
        }
        let previous_m = gap.start.checked_sub(1).and_then(|cell| holds_m[cell]);
        let next_m = holds_m.get(gap.end).copied().flatten();
        let (Some(first_m), Some(last_m)) = (previous_m.or(next_m), next_m.or(previous_m)) else { continue };
        // The window extends into the holds on both sides by the time in which noise can hide motion at the mean speed.
        let hidden_m = NO_CHANCE * track.sd_m;
        let visible_m = (last_m - first_m).abs() - 2.0 * hidden_m;
        let hidden = if visible_m > 0.0 {
            (hidden_m * gap.len() as f64 / visible_m).ceil() as usize
        } else {
            usize::MAX
        };
        let [reach_before, reach_after] = [number.checked_sub(1), Some(number + 1)].map(|chunk| {
            let half_hold = chunk.and_then(|chunk| chunks.get(chunk)).map_or(0, |hold| hold.len() / 2);
            hidden.min(half_hold)
        });
        let cells = gap.start - reach_before..gap.end + reach_after;
        let passage = Passage { track, cells: cells.clone(), ends_m: [previous_m, next_m] };
        if let Some((means_m, covariance)) = passage.posterior() {
            cells.clone().zip(means_m).for_each(|(cell, mean_m)| positions_m[cell] = mean_m);
            windows.push(Window { cells, covariance });
        }
    }
    (positions_m, windows)
}

/// Cells between two holds, or between a hold and an end of the recording.
struct Passage<'a> {
    track: &'a Track<'a>,
    cells: Range<usize>,
    /// Position of the hold before and of the one after.
    ends_m: [Option<f64>; 2],
}

impl Passage<'_> {
    /// Mean and covariance of the positions given the readings; `None` if the readings are followed exactly.
    fn posterior(&self) -> Option<(Vec<f64>, DMatrix<f64>)> {
        let Track { time_s, length_s, read_m, sd_m, .. } = *self.track;
        let count = self.cells.len();
        let [previous_m, next_m] = self.ends_m;
        if sd_m <= 0.0 {
            return None;
        }
        let base_m = previous_m.or(next_m)?;
        let distance = next_m.map_or(0.0, |next_m| (next_m - base_m) / sd_m);
        let readings = DVector::from_iterator(
            count,
            read_m.get(self.cells.clone())?.iter().map(|m| (m - base_m) / sd_m),
        );
        let modes = Modes::new(count, previous_m.is_some(), next_m.is_some());
        let largest = modes.largest_second_difference(&readings, distance);
        if !largest.is_finite() || largest > NO_NOISE {
            return None;
        }
        let sizes = modes.sizes(largest);
        let reading_modes = modes.of(&readings);
        let cell_s: Vec<[f64; 2]> =
            self.cells.clone().filter_map(|cell| Some([*time_s.get(cell)?, *length_s.get(cell)?])).collect();
        let first_s = cell_s.first().map_or(0.0, |[at_s, length_s]| at_s - 0.5 * length_s);
        let last_s = cell_s.last().map_or(0.0, |[at_s, length_s]| at_s + 0.5 * length_s);
        let mut ranges = [[first_s, last_s]; 2];
        let moves = distance.abs() > NO_CHANCE && last_s > first_s;
        let mut courses = Courses::new(&modes, &cell_s, ranges, if moves { distance } else { 0.0 });
        if moves {
            for _ in 0..REFINEMENTS {
                ranges = courses.likely_ranges(&reading_modes, &modes, &sizes, [first_s, last_s]);
                let refined = Courses::new(&modes, &cell_s, ranges, distance);
                if refined.longest_s() < refined.step_s {
                    break;
                }
                courses = refined;
            }
        }
        let (mean, covariance) = courses.posterior(&reading_modes, &modes, &sizes);
        let means_m = (&modes.basis * mean).iter().map(|value| base_m + sd_m * value).collect();
        Some((means_m, &modes.basis * covariance * modes.basis.transpose()))
    }
}

/// Orthonormal functions on the cells that diagonalise the second differences: sines that vanish in the hold beyond an end, and have zero
/// slope at an end without a hold.
struct Modes {
    basis: DMatrix<f64>,
    /// Second difference of every mode, relative to the mode.
    curvature: Vec<f64>,
    has_hold: [bool; 2],
}

impl Modes {
    fn new(count: usize, hold_before: bool, hold_after: bool) -> Self {
        let is_between_holds = hold_before && hold_after;
        let period = if is_between_holds { (count + 1) as f64 } else { count as f64 + 0.5 };
        let first = if is_between_holds { 1.0 } else { 0.5 };
        let waves: Vec<f64> = (0..count).map(|mode| PI * (mode as f64 + first) / period).collect();
        Self {
            basis: DMatrix::from_fn(count, count, |row, mode| {
                // Cells count from the hold.
                let cell = if hold_before { row as f64 + 1.0 } else { (count - row) as f64 };
                (2.0 / period).sqrt() * (waves[mode] * cell).sin()
            }),
            curvature: waves.iter().map(|wave| 4.0 * (0.5 * wave).sin().powi(2)).collect(),
            has_hold: [hold_before, hold_after],
        }
    }

    fn of(&self, values: &DVector<f64>) -> DVector<f64> {
        self.basis.tr_mul(values)
    }

    /// Largest second difference of readings that start at zero and end at `way`; at least 1.
    fn largest_second_difference(&self, readings: &DVector<f64>, way: f64) -> f64 {
        let [hold_before, hold_after] = self.has_hold;
        let mut values: Vec<f64> = readings.iter().copied().collect();
        if hold_before {
            values.insert(0, 0.0);
        }
        if hold_after {
            values.push(way);
        }
        values.windows(3).map(|three| (three[0] - 2.0 * three[1] + three[2]).abs()).fold(1.0, f64::max)
    }

    /// Grid of sizes of the second differences: zero, and from an invisible one to twice the largest.
    fn sizes(&self, largest: f64) -> Vec<f64> {
        let slowest = self.curvature.first().copied().unwrap_or(1.0);
        let steps = (2.0 * largest / (UNSEEN_SHIFT * slowest)).log(SIZE_RATIO).ceil().max(1.0) as i32;
        (0..=steps).map(|step| UNSEEN_SHIFT * slowest * SIZE_RATIO.powi(step)).chain([0.0]).collect()
    }

    /// Share of the variance of a reading that is noise, mode by mode.
    fn noise_share(&self, size: f64) -> DVector<f64> {
        DVector::from_iterator(
            self.curvature.len(),
            self.curvature.iter().map(|c| 1.0 / (1.0 + (size / c).powi(2))),
        )
    }
}

/// Motions at constant speed from a start time to a stop time, for all pairs of times on the grid.
struct Courses {
    /// Start times, followed by the stop times.
    times_s: Vec<f64>,
    /// Number of start times.
    starts: usize,
    /// Shortest duration of a motion: a shorter one does not differ from a step.
    step_s: f64,
    /// Distance from the hold before to the one after, in standard deviations of a reading.
    way: f64,
    /// Distance moved since each of the times at a speed of one, in modes.
    ways: DMatrix<f64>,
}

/// One size of the second differences, with its evidence and the probabilities of the times.
struct OfSize {
    ln_evidence: f64,
    noise_share: DVector<f64>,
    /// Probability of every pair of times.
    pairs: Vec<(usize, usize, f64)>,
}

impl Courses {
    fn new(modes: &Modes, cell_s: &[[f64; 2]], ranges_s: [[f64; 2]; 2], way: f64) -> Self {
        let mut times_s = Vec::new();
        for [start_s, end_s] in ranges_s.into_iter().filter(|_| way != 0.0) {
            let numbers = 0..TIMES;
            times_s.extend(numbers.map(|i| start_s + (end_s - start_s) * (i as f64 + 0.5) / TIMES as f64));
        }
        let unit_distances = DMatrix::from_fn(cell_s.len(), times_s.len(), |cell, number| {
            mean_way(cell_s[cell], times_s[number])
        });
        let [first_s, last_s] =
            [cell_s.first(), cell_s.last()].map(|cell| cell.map_or(0.0, |[at_s, _]| *at_s));
        let step_s = STEP * (last_s - first_s) / cell_s.len() as f64;
        Self { ways: modes.basis.tr_mul(&unit_distances), starts: times_s.len() / 2, times_s, step_s, way }
    }

    /// Longest duration of a motion.
    fn longest_s(&self) -> f64 {
        self.times_s.first().zip(self.times_s.last()).map_or(0.0, |(start_s, stop_s)| stop_s - start_s)
    }

    /// Evidence of a size, and the probabilities of times with it.
    fn of_size(&self, seen: &DVector<f64>, modes: &Modes, size: f64) -> OfSize {
        let noise_share = modes.noise_share(size);
        let weighted = seen.component_mul(&noise_share);
        let half_ln_determinant = -0.5 * noise_share.iter().map(|share| share.ln()).sum::<f64>();
        let still = -0.5 * seen.dot(&weighted) - half_ln_determinant;
        if self.times_s.is_empty() {
            return OfSize { ln_evidence: still, noise_share, pairs: Vec::new() };
        }
        let projections = self.ways.tr_mul(&weighted);
        let mut scaled = self.ways.clone();
        scaled.row_iter_mut().zip(noise_share.iter()).for_each(|(mut row, share)| row *= *share);
        let products = self.ways.tr_mul(&scaled);
        let mut pairs = Vec::new();
        for start in 0..self.starts {
            for stop in self.starts..self.times_s.len() {
                let duration_s = self.times_s[stop] - self.times_s[start];
                if duration_s >= self.step_s {
                    let speed = self.way / duration_s;
                    let square =
                        products[(start, start)] - 2.0 * products[(start, stop)] + products[(stop, stop)];
                    let gain =
                        speed * (projections[start] - projections[stop]) - 0.5 * speed * speed * square;
                    pairs.push((start, stop, gain));
                }
            }
        }
        let best = pairs.iter().map(|pair| pair.2).fold(f64::NEG_INFINITY, f64::max);
        pairs.iter_mut().for_each(|pair| pair.2 = (pair.2 - best).exp());
        let sum: f64 = pairs.iter().map(|pair| pair.2).sum();
        let pair_count = pairs.len() as f64;
        pairs.iter_mut().for_each(|pair| pair.2 /= sum);
        OfSize { ln_evidence: still + best + (sum / pair_count).ln(), noise_share, pairs }
    }

    /// All sizes with their probabilities.
    fn weighted(&self, seen: &DVector<f64>, modes: &Modes, sizes: &[f64]) -> Vec<(f64, OfSize)> {
        let candidates: Vec<OfSize> = sizes.iter().map(|size| self.of_size(seen, modes, *size)).collect();
        let best = candidates.iter().map(|one| one.ln_evidence).fold(f64::NEG_INFINITY, f64::max);
        let likely: Vec<(f64, OfSize)> = candidates
            .into_iter()
            .map(|one| ((one.ln_evidence - best).exp(), one))
            .filter(|(weight, _)| *weight > NEGLIGIBLE)
            .collect();
        let sum: f64 = likely.iter().map(|(weight, _)| weight).sum();
        likely.into_iter().map(|(weight, one)| (weight / sum, one)).collect()
    }

    /// Ranges in which the start and the stop times are likely, extended by one step.
    fn likely_ranges(
        &self,
        seen: &DVector<f64>,
        modes: &Modes,
        sizes: &[f64],
        bounds_s: [f64; 2],
    ) -> [[f64; 2]; 2] {
        let mut probability = vec![0.0; self.times_s.len()];
        for (weight, one) in self.weighted(seen, modes, sizes) {
            for (start, stop, of_pair) in one.pairs {
                probability[start] += weight * of_pair;
                probability[stop] += weight * of_pair;
            }
        }
        [0..self.starts, self.starts..self.times_s.len()].map(|half| {
            let times_s = &self.times_s[half.clone()];
            let step_s = times_s[1] - times_s[0];
            let most = probability[half.clone()].iter().copied().fold(0.0, f64::max);
            let mut likely = times_s.iter().zip(&probability[half]).filter(|(_, p)| **p > NEGLIGIBLE * most);
            let start_s = likely.clone().next().map_or(times_s[0], |(s, _)| *s);
            let end_s = likely.next_back().map_or(times_s[times_s.len() - 1], |(s, _)| *s);
            [(start_s - step_s).max(bounds_s[0]), (end_s + step_s).min(bounds_s[1])]
        })
    }

    /// Posterior mean and covariance of the positions, in modes.
    fn posterior(&self, seen: &DVector<f64>, modes: &Modes, sizes: &[f64]) -> (DVector<f64>, DMatrix<f64>) {
        let count = seen.len();
        let (mut mean, mut second) = (DVector::zeros(count), DMatrix::zeros(count, count));
        for (weight, one) in self.weighted(seen, modes, sizes) {
            let mut coefficients = DVector::zeros(self.times_s.len());
            let mut products = DMatrix::zeros(self.times_s.len(), self.times_s.len());
            for (start, stop, probability) in one.pairs {
                let speed = self.way / (self.times_s[stop] - self.times_s[start]);
                coefficients[start] += probability * speed;
                coefficients[stop] -= probability * speed;
                let square = probability * speed * speed;
                products[(start, start)] += square;
                products[(stop, stop)] += square;
                products[(start, stop)] -= square;
                products[(stop, start)] -= square;
            }
            let expected = &self.ways * coefficients;
            let mut of_times =
                &self.ways * products * self.ways.transpose() - &expected * expected.transpose();
            of_times.row_iter_mut().zip(one.noise_share.iter()).for_each(|(mut row, share)| row *= *share);
            of_times
                .column_iter_mut()
                .zip(one.noise_share.iter())
                .for_each(|(mut column, share)| column *= *share);
            let signal_share = one.noise_share.map(|share| 1.0 - share);
            let centre = seen.component_mul(&signal_share) + expected.component_mul(&one.noise_share);
            second +=
                weight * (of_times + DMatrix::from_diagonal(&signal_share) + &centre * centre.transpose());
            mean += weight * centre;
        }
        let covariance = second - &mean * mean.transpose();
        (mean, covariance)
    }
}

/// Mean over a cell of the distance moved since a time, at a speed of one.
fn mean_way([middle_s, length_s]: [f64; 2], since_s: f64) -> f64 {
    let [start_s, end_s] = [-0.5, 0.5].map(|share| (middle_s + share * length_s - since_s).max(0.0));
    if length_s > 0.0 { (end_s * end_s - start_s * start_s) / (2.0 * length_s) } else { end_s }
}

#[cfg(test)]
#[path = "course_tests.rs"]
mod tests;
