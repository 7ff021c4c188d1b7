//! Finding the stretches of a displacement series in which nothing moves.
//!
//! The series is averaged into bins of about a twentieth of a second. A hold is a stretch of bins that stay within a
//! tolerance of their mean in every plane, is long enough, and has no significant slope over its whole length (a slow
//! ramp has). If the recorder marked the steps of a motion program, each hold lies within one step, and steps that move
//! have none. The tolerance follows the noise, which is taken from second differences: those vanish on ramps.

use super::median::median;
use formats::session::{HOLD_STRETCHES, Mark};
use std::ops::Range;

/// Criteria for a hold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HoldCriteria {
    /// Shortest hold.
    pub min_duration_s: f64,
    /// Movement that never counts as such: drift over a hold, rounding of the displacement sensor.
    pub still_m: f64,
    /// Largest distance from zero that may count as zero displacement (and at most a tenth of the largest level).
    pub zero_m: f64,
}

impl Default for HoldCriteria {
    fn default() -> Self {
        Self { min_duration_s: SHORTEST_HOLD_S, still_m: 0.02e-3, zero_m: 0.1e-3 }
    }
}

/// A hold.
#[derive(Debug, Clone, PartialEq)]
pub struct HoldSpan {
    /// Rows of the series.
    pub rows: Range<usize>,
    /// Times of its first and last row.
    pub time_s: [f64; 2],
}

/// Length of a bin.
pub(super) const BIN_S: f64 = 0.05;
/// Time that detection cuts off a hold, at both ends together, if rows come with this period: a bin, or a row, at
/// either end.
pub fn trimmed_s(period_s: f64) -> f64 {
    HOLD_STRETCHES[1] as f64 * BIN_S.max(period_s)
}

/// Fewest bins of a hold.
const MIN_BINS: usize = HOLD_STRETCHES[0];
/// Bins on either side of a stretch that decide whether it is part of a ramp.
const FLANK: usize = 4;
/// Multiple of the noise that is still noise.
const SIGMAS: f64 = 4.0;
/// Largest sum of deviations from the mean, over noise and the root of their number, that is noise as those are: the
/// supremum of a Brownian bridge exceeds it as rarely as a normal value does `SIGMAS` (Kolmogorov, 2 exp(-2 c^2)).
const CHANGE: f64 = 2.28;
/// Levels are apart from so many standard deviations of a bin on.
const APART: f64 = 2.0;

/// Holds of a series of increasing times and one displacement column per plane, in order of time.
pub fn find_holds(time_s: &[f64], planes_m: &[&[f64]], criteria: &HoldCriteria) -> Vec<HoldSpan> {
    search(time_s, planes_m, &[Part { rows: 0..time_s.len(), kind: Kind::Unmarked }], criteria)
}

/// As [`find_holds`], with what the device was doing at each row.
pub fn find_marked_holds(
    time_s: &[f64],
    planes_m: &[&[f64]],
    marks: &[Mark],
    criteria: &HoldCriteria,
) -> Vec<HoldSpan> {
    let mut sections = Vec::new();
    let mut row = 0;
    for same in marks.get(..time_s.len()).unwrap_or(marks).chunk_by(|a, b| a == b) {
        let kind = match same.first() {
            Some(Mark { step: Some(_), moving: Some(true) }) => Kind::Move,
            Some(Mark { step: Some(_), moving: Some(false) }) => Kind::HoldSpan,
            Some(Mark { step: Some(_), moving: None }) => Kind::Step,
            Some(Mark { step: None, .. }) | None => Kind::Unmarked,
        };
        sections.push(Part { rows: row..row + same.len(), kind });
        row += same.len();
    }
    search(time_s, planes_m, &sections, criteria)
}

/// Rows between which no hold reaches over.
struct Part {
    rows: Range<usize>,
    kind: Kind,
}

/// Mark of a section.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// No mark.
    Unmarked,
    /// It is one step of a program.
    Step,
    /// It is a step that does not move.
    HoldSpan,
    /// It is a step that moves.
    Move,
}

fn search(time_s: &[f64], planes_m: &[&[f64]], parts: &[Part], criteria: &HoldCriteria) -> Vec<HoldSpan> {
    let bins = Bins::new(time_s, planes_m, parts, criteria);
    let mut holds = Vec::new();
    for part in parts.iter().filter(|part| part.kind != Kind::Move) {
        let of_part = bins.of(&part.rows);
        let mut start = of_part.start;
        while let Some(stretch) = bins.grow(start..of_part.end, part.kind, criteria) {
            if stretch.is_empty() {
                start += 1;
                continue;
            }
            start = stretch.end;
            let rows = bins.rows(&stretch);
            // The rest at the end of a move is shorter than the move.
            if part.kind == Kind::Step && 2 * rows.len() < part.rows.len() {
                continue;
            }
            if let (Some(first_s), Some(last_s)) =
                (time_s.get(rows.start), time_s.get(rows.end.saturating_sub(1)))
            {
                holds.push(HoldSpan { rows, time_s: [*first_s, *last_s] });
            }
        }
    }
    holds
}

/// The series in bins.
struct Bins {
    /// First row of each bin, and the number of rows at the end.
    edges: Vec<usize>,
    time_s: Vec<f64>,
    /// Mean per plane and bin.
    planes_m: Vec<Vec<f64>>,
    /// Deviation from the mean of a hold that is still noise, per plane.
    tolerance_m: Vec<f64>,
    /// Standard deviation of a bin, per plane.
    noise_m: Vec<f64>,
}

impl Bins {
    fn new(time_s: &[f64], planes_m: &[&[f64]], parts: &[Part], criteria: &HoldCriteria) -> Self {
        let mut edges = vec![];
        let mut opened_s = f64::NEG_INFINITY;
        let mut starts = parts.iter().map(|part| part.rows.start).peekable();
        for (row, time_s) in time_s.iter().enumerate() {
            let part_starts = starts.next_if_eq(&row).is_some();
            if part_starts || time_s - opened_s >= BIN_S * (1.0 - 1e-9) {
                edges.push(row);
                opened_s = *time_s;
            }
        }
        edges.push(time_s.len());
        let binned: Vec<Vec<f64>> = planes_m.iter().map(|plane| bin_means(plane, &edges)).collect();
        let noise_m: Vec<f64> = binned.iter().map(|plane| noise(plane)).collect();
        let tolerance_m =
            noise_m.iter().map(|noise_m| (SIGMAS * noise_m).max(2.0 * criteria.still_m)).collect();
        Self { time_s: bin_means(time_s, &edges), planes_m: binned, edges, tolerance_m, noise_m }
    }

    /// Bins of the rows of a part.
    fn of(&self, rows: &Range<usize>) -> Range<usize> {
        let bin = |row: usize| self.edges.partition_point(|edge| *edge < row);
        bin(rows.start)..bin(rows.end)
    }

    /// The hold that starts at the first of these bins: empty where none starts there, `None` where they end too soon.
    fn grow(&self, bins: Range<usize>, kind: Kind, criteria: &HoldCriteria) -> Option<Range<usize>> {
        let Range { start, end } = bins;
        let end_s = self.time_s.get(start)? + criteria.min_duration_s - BIN_S;
        let seed_end = self.time_s.partition_point(|time_s| *time_s < end_s * (1.0 - 1e-12)) + 1;
        let mut stretch = start..seed_end.max(start + MIN_BINS);
        if stretch.end > end {
            return None;
        }
        let no_growth = Some(start..start);
        if !self.within(&stretch, stretch.clone()) || !self.still(&stretch, criteria) {
            return no_growth;
        }
        // One bin out of tolerance is a spike; two end the hold.
        loop {
            let next = stretch.end;
            if next < end && self.within(&stretch, next..next + 1) {
                stretch.end += 1;
            } else if next + 1 < end && self.within(&stretch, next + 1..next + 2) {
                stretch.end += 2;
            } else {
                break;
            }
        }
        self.cut(&mut stretch, criteria);
        // A ramp loses much of its stretch when its ends are trimmed, and has a slope before; a hold has only its ends off.
        let whole = stretch.clone();
        self.trim(&mut stretch);
        let mostly_ends = || 4 * stretch.len() < 3 * whole.len() && !self.still(&whole, criteria);
        let ramp = kind != Kind::HoldSpan && (mostly_ends() || self.goes_on(&whole, criteria));
        let (Some(first_s), Some(last_s)) =
            (self.time_s.get(stretch.start), self.time_s.get(stretch.end - 1))
        else {
            return no_growth;
        };
        let long = last_s - first_s + BIN_S >= 0.9 * criteria.min_duration_s;
        if long && !ramp && self.still(&stretch, criteria) { Some(stretch) } else { no_growth }
    }

    /// Whether the bins `part` lie within tolerance of the mean of the bins `of`, in every plane.
    fn within(&self, of: &Range<usize>, part: Range<usize>) -> bool {
        self.planes_m.iter().zip(&self.tolerance_m).all(|(plane, tolerance_m)| {
            let (Some(whole_values), Some(part_values)) = (plane.get(of.clone()), plane.get(part.clone()))
            else {
                return false;
            };
            let mean = whole_values.iter().sum::<f64>() / whole_values.len() as f64;
            part_values.iter().all(|bin| (bin - mean).abs() <= *tolerance_m)
        })
    }

    /// Whether a straight line through the bins moves no more over them than noise and the criteria allow.
    fn still(&self, part: &Range<usize>, criteria: &HoldCriteria) -> bool {
        self.planes_m.iter().zip(&self.noise_m).all(|(plane, noise_m)| {
            let noise = SIGMAS * noise_m * (12.0 / part.len() as f64).sqrt();
            drift(plane, part).abs() <= noise.max(criteria.still_m)
        })
    }

    /// Whether the series goes on before and after the stretch as it moves within it: then it is part of a ramp.
    fn goes_on(&self, part: &Range<usize>, criteria: &HoldCriteria) -> bool {
        let Some(flank_start) = part.start.checked_sub(FLANK) else { return false };
        self.planes_m.iter().zip(&self.noise_m).any(|(plane, noise_m)| {
            let (Some(flank_before), Some(flank_after)) =
                (flank_mean(flank_start..part.start, plane), flank_mean(part.end..part.end + FLANK, plane))
            else {
                return false;
            };
            let chord = (flank_after - flank_before) * part.len() as f64 / (part.len() + FLANK) as f64;
            let drift = drift(plane, part);
            drift.abs() > criteria.still_m && chord.abs() > 2.0 * noise_m && drift / chord > 0.4
        })
    }

    /// Ends the stretch where its level changes: two holds whose levels no single bin tells apart are still two (Page 1954, cumulative sums).
    fn cut(&self, stretch: &mut Range<usize>, criteria: &HoldCriteria) {
        while let Some(end) = self.change(stretch, criteria) {
            stretch.end = end;
        }
    }

    /// The bin with which another level begins, in any plane.
    fn change(&self, stretch: &Range<usize>, criteria: &HoldCriteria) -> Option<usize> {
        let planes = self.planes_m.iter().zip(&self.noise_m);
        planes.filter_map(|(plane, noise_m)| change_of(plane, *noise_m, stretch, criteria)).min()
    }

    /// Cuts off bins at both ends that belong to the ramps: off by more than the noise, and one more.
    fn trim(&self, stretch: &mut Range<usize>) {
        let whole = stretch.clone();
        while stretch.len() > MIN_BINS && self.is_apart(&whole, stretch.start) {
            stretch.start += 1;
        }
        while stretch.len() > MIN_BINS && self.is_apart(&whole, stretch.end - 1) {
            stretch.end -= 1;
        }
        if stretch.len() > 2 * MIN_BINS {
            stretch.start += 1;
            stretch.end -= 1;
        }
    }

    fn is_apart(&self, stretch: &Range<usize>, bin: usize) -> bool {
        self.planes_m.iter().zip(&self.noise_m).any(|(plane, noise_m)| {
            let middle = median(plane.get(stretch.clone()).unwrap_or_default().to_vec());
            plane.get(bin).is_some_and(|value| (value - middle).abs() > (APART * noise_m).max(1e-6))
        })
    }

    fn rows(&self, stretch: &Range<usize>) -> Range<usize> {
        let edge = |bin: usize| self.edges.get(bin).copied().unwrap_or_default();
        edge(stretch.start)..edge(stretch.end)
    }
}

fn flank_mean(range: Range<usize>, plane: &[f64]) -> Option<f64> {
    plane.get(range).map(|bins| bins.iter().sum::<f64>() / FLANK as f64)
}

fn bin_means(values: &[f64], edges: &[usize]) -> Vec<f64> {
    edges
        .windows(2)
        .filter_map(|edge| values.get(edge[0]..edge[1]))
        .map(|bin| bin.iter().sum::<f64>() / bin.len() as f64)
        .collect()
}

/// The bin of a plane with which another level begins.
fn change_of(plane: &[f64], noise_m: f64, stretch: &Range<usize>, criteria: &HoldCriteria) -> Option<usize> {
    let bins = plane.get(stretch.clone())?;
    let count = bins.len() as f64;
    let mean = bins.iter().sum::<f64>() / count;
    let mut sum_m = 0.0;
    let sums = bins.iter().enumerate().map(|(number, bin)| {
        sum_m += bin - mean;
        (number + 1, sum_m)
    });
    let (bins_before, sum_m) = sums.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
    // Difference of the means before and after, and its squares beside those of a straight line, as which a ramp changes.
    let step_m = sum_m.abs() * count / (bins_before as f64 * (count - bins_before as f64));
    let squares_of_line = drift(plane, stretch).powi(2) * (count * count - 1.0) / (12.0 * count);
    // A hold that ends has no slope of its own, and is no piece of a ramp.
    let drift_before_m = drift(plane, &(stretch.start..stretch.start + bins_before));
    let is_change = bins_before >= 2 * MIN_BINS
        && bins_before < stretch.len()
        && drift_before_m.abs() < 0.5 * step_m
        && sum_m.abs() > CHANGE * noise_m * count.sqrt()
        && step_m > (APART * noise_m).max(2.0 * criteria.still_m)
        && step_m * sum_m.abs() > squares_of_line;
    is_change.then_some(stretch.start + bins_before)
}

/// Drift of a straight line through the bins `part`; bins are equally long.
fn drift(plane: &[f64], part: &Range<usize>) -> f64 {
    let bins = plane.get(part.clone()).unwrap_or_default();
    let n = bins.len() as f64;
    let moment: f64 = bins.iter().enumerate().map(|(i, bin)| (i as f64 - 0.5 * (n - 1.0)) * bin).sum();
    12.0 * moment / (n * n - 1.0)
}

/// Shortest hold, in seconds and in bins: a value that stands for less is one on the way.
const SHORTEST_HOLD_S: f64 = 0.5;
const SHORTEST_HOLD: usize = (SHORTEST_HOLD_S / BIN_S + 0.5) as usize;
/// Bins of one value on average, from which on values are rounded ones.
const FEW: usize = 4;

/// Standard deviation of the noise of a bin: from second differences, and never below the rounding of the values.
pub(super) fn noise(bins: &[f64]) -> f64 {
    let second: Vec<f64> = bins.windows(3).map(|w| (w[0] - 2.0 * w[1] + w[2]).abs()).collect();
    // Median of the magnitude of a normal variable, and the variance of a second difference.
    let white = median(second).max(0.0) / (0.6745 * 6f64.sqrt());
    let mut sorted = bins.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.dedup();
    // Guide 2 passes through the values to which its sensor rounds, or noise toggles between two of them. Where every value stands as long
    // as a hold, as in a staircase that was computed, its steps are those of guide 2.
    let mut inner = bins.chunk_by(|a, b| a == b).skip(1).peekable();
    let mut is_passed = false;
    while let Some(stretch) = inner.next() {
        is_passed |= inner.peek().is_some() && stretch.len() < SHORTEST_HOLD;
    }
    let few = is_passed && sorted.len() * FEW < bins.len();
    let step =
        sorted.windows(2).map(|w| w[1] - w[0]).filter(|step| *step > 1e-9).fold(f64::INFINITY, f64::min);
    if few && step.is_finite() { white.max(step / 12f64.sqrt()) } else { white }
}
