//! A recorded insertion as the estimators use it: tip positions in bins of depth, and what was done.
//!
//! Recordings are made by hand: needles rest and rows repeat, depth is noisy, each push springs back by a millimetre or two, the
//! needle is drawn back at the end. A row counts while the tip is near where it cuts; rows at one depth with the same rotation and
//! guide position make one bin.

mod scatter;

pub use scatter::{direction_scatter_rad, row_scatter_m};

use formats::session::InsertionRun;
use mechanics::{Insertion, ModelError, Profile};
use readings::holds::median;
use readings::outliers::farthest;

/// Rows this far behind the deepest so far are a retraction (or a depth that was misread).
const RETRACTED_M: f64 = 3e-3;
/// Rows this far from the median of them and their neighbours are misread.
const MISREAD_M: f64 = 20e-3;
/// Rows this far before the surface are still taken as at the surface.
const BEFORE_SURFACE_M: f64 = 0.5e-3;
/// Width of a bin of depth.
const BIN_M: f64 = 1e-3;
/// Positions of guide 2 that differ by less are the same.
const GUIDE2_STILL_M: f64 = 0.05e-3;
/// Rests whose depths differ by less are one: what is done there happens at one depth.
const REST_M: f64 = 0.1e-3;
/// Rotations that differ by less are the same.
pub(super) const ROTATION_STILL_RAD: f64 = 0.02;
/// A recording rests where at least this share of its rows is in bins of three or more.
const RESTING: f64 = 0.4;
/// So far from its neighbours' line the bend of a path takes a bin that is no outlier.
const BENT_M: f64 = 0.1e-3;
/// A path without samples over such a length has a gap.
const GAP_M: f64 = 15e-3;

/// Why a recording is no insertion.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PathError {
    /// Hardly any row is in the tissue.
    #[error(
        "depth_mm: {rows} of {all} rows advance into the tissue, expected 5 or more at increasing depths"
    )]
    TooFew {
        /// Rows that count.
        rows: usize,
        /// All rows.
        all: usize,
    },
    /// Lengths in another unit.
    #[error("depth_mm: the deepest row is at {deepest_mm} mm, expected 5 or more: is this in millimetres?")]
    Shallow {
        /// Largest depth.
        deepest_mm: f64,
    },
    /// There are no readings to identify from.
    #[error("depth_mm: {bins} depths up to {until_mm} mm, expected 3 or more to identify the tip load from")]
    TooFewDepths {
        /// Depths that count.
        bins: usize,
        /// Depth at which the identification ends.
        until_mm: f64,
    },
    /// No candidate explains it.
    #[error("tip_y_mm: no tip load explains this path, expected that of a needle")]
    Unexplained,
    /// The insertion cannot be modelled.
    #[error(transparent)]
    Model(#[from] ModelError),
}

/// Tip positions at one depth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bin {
    /// Mean depth of its rows.
    pub depth_m: f64,
    /// Median tip position, vertical and horizontal (0 where that was not measured).
    pub tip_m: [f64; 2],
    /// Median slope of the needle at the tip, vertical and horizontal, of the rows in which it was measured.
    pub direction_rad: [Option<f64>; 2],
    /// Number of rows.
    pub rows: f64,
    /// Whether the needle was on its way: a single reading, in a recording in which it rests.
    pub moving: bool,
    /// Whether it was taken after what happened at rest at its depth, not before.
    pub leaving: bool,
}

/// A recorded insertion.
#[derive(Debug, Clone, PartialEq)]
pub struct TipPath {
    /// Its name.
    pub id: String,
    /// Measured planes: 1 (vertical) or 2.
    pub planes: usize,
    /// In order of depth.
    pub bins: Vec<Bin>,
    /// Depth to which it is recorded.
    pub deepest_m: f64,
    /// Motion of the insertion.
    pub done: Insertion,
    /// Stretches of 15 mm or more without samples, m.
    pub gaps_m: Vec<[f64; 2]>,
    /// Rows that are no part of the insertion: before the surface, drawn back, or in the middle of a turn.
    pub rows_skipped: usize,
    /// The rows behind the bins.
    pub(super) rows: Vec<Row>,
}

/// A row of a recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Row {
    depth_m: f64,
    tip_m: [f64; 2],
    /// NaN where it was not measured.
    direction_rad: [f64; 2],
    rotation_rad: f64,
    guide2_m: [f64; 2],
}

impl TipPath {
    /// Reads a recording.
    ///
    /// # Errors
    /// [`PathError`] where it is no insertion.
    pub fn new(run: &InsertionRun) -> Result<Self, PathError> {
        let deepest_m = run.depth_m.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let rows = advancing(run);
        if rows.len() >= 5 && deepest_m < 5e-3 {
            return Err(PathError::Shallow { deepest_mm: 1e3 * deepest_m });
        }
        let end_m = rows.last().map_or(0.0, |row| row.depth_m);
        let start_m = rows.first().map_or(0.0, |row| row.depth_m);
        if rows.len() < 5 || end_m - start_m < BIN_M {
            return Err(PathError::TooFew { rows: rows.len(), all: run.depth_m.len() });
        }
        let insertion = done(run, &rows)?;
        let bins = bins(&rows, &insertion);
        let row_count: f64 = bins.iter().map(|bin| bin.rows).sum();
        Ok(Self {
            id: run.id.clone(),
            planes: if run.tip_x_m.is_some() { 2 } else { 1 },
            rows_skipped: run.depth_m.len() - row_count as usize,
            deepest_m,
            done: insertion,
            gaps_m: gaps_m(&bins),
            bins,
            rows,
        })
    }

    /// The same, observed up to a depth only; what was done stays known, as a plan is.
    ///
    /// # Errors
    /// [`PathError::TooFewDepths`] where fewer than three depths are left.
    pub fn until(&self, until_m: f64) -> Result<Self, PathError> {
        let rows: Vec<Row> = self.rows.iter().filter(|row| row.depth_m <= until_m).copied().collect();
        let bins = bins(&rows, &self.done);
        if bins.len() < 3 {
            return Err(PathError::TooFewDepths { bins: bins.len(), until_mm: 1e3 * until_m });
        }
        Ok(Self { gaps_m: gaps_m(&bins), bins, rows, ..self.clone() })
    }

    /// Share of the bins in which the needle was on its way.
    pub fn moving_share(&self) -> f64 {
        self.bins.iter().filter(|bin| bin.moving).count() as f64 / self.bins.len() as f64
    }

    /// The same with other tip positions.
    pub fn with_bins(&self, bins: Vec<Bin>) -> Self {
        Self { bins, ..self.clone() }
    }

    /// Whether guide 2 is moved on the way to a depth.
    pub fn moves_guide2(&self, until_m: f64) -> bool {
        self.done.guide2_m.iter().flatten().any(|plane| {
            // Profiles are linear between rows that lie much closer than this.
            !plane.is_constant()
                && (0..)
                    .map(|i| BIN_M * f64::from(i))
                    .take_while(|m| *m <= until_m.min(self.deepest_m))
                    .any(|at_m| plane.before(at_m) != plane.after(0.0))
        })
    }

    /// Whether the needle is turned on the way.
    pub fn is_turned(&self) -> bool {
        !self.done.rotation_rad.is_constant()
    }
}

/// Rows in the tissue that are not drawn back.
fn advancing(run: &InsertionRun) -> Vec<Row> {
    let mut deepest_m = f64::NEG_INFINITY;
    let mut rows = Vec::new();
    for (i, depth_m) in run.depth_m.iter().copied().enumerate() {
        // One misread depth must not make a retraction of all that follows: the median of three is what counts.
        let neighbourhood =
            [i.saturating_sub(1), i, (i + 1).min(run.depth_m.len() - 1)].map(|j| run.depth_m[j]);
        let (low, high) = neighbourhood.iter().fold((f64::MAX, f64::MIN), |(l, h), m| (l.min(*m), h.max(*m)));
        let steady_m = neighbourhood.iter().sum::<f64>() - low - high;
        deepest_m = deepest_m.max(steady_m.min(depth_m));
        let misread = (depth_m - steady_m).abs() > MISREAD_M;
        if depth_m < -BEFORE_SURFACE_M || depth_m < deepest_m - RETRACTED_M || misread {
            continue;
        }
        let (Some(tip_y_m), tip_x_m) = (run.tip_y_m.get(i).copied(), value_at(&run.tip_x_m, i)) else {
            continue;
        };
        rows.push(Row {
            depth_m: depth_m.max(0.0),
            tip_m: [tip_y_m, tip_x_m.unwrap_or(0.0)],
            direction_rad: [&run.tip_direction_y_rad, &run.tip_direction_x_rad]
                .map(|column| value_at(column, i).unwrap_or(f64::NAN)),
            rotation_rad: value_at(&run.rotation_rad, i).unwrap_or(0.0),
            guide2_m: [
                value_at(&run.guide2_y_m, i).unwrap_or(0.0),
                value_at(&run.guide2_x_m, i).unwrap_or(0.0),
            ],
        });
    }
    if !rows.windows(2).all(|pair| is_same_state(&pair[0], &pair[1])) {
        // Changes at rest happen at one depth: that to which the needle has come to stay.
        let mut stays_m = f64::INFINITY;
        for row in rows.iter_mut().rev() {
            stays_m = stays_m.min(row.depth_m);
            row.depth_m = REST_M * (stays_m / REST_M).round();
        }
    }
    rows
}

fn is_same_state(a: &Row, b: &Row) -> bool {
    is_turned_by(a, b) < ROTATION_STILL_RAD && is_moved_by(a, b) < GUIDE2_STILL_M
}

fn value_at(column: &Option<Vec<f64>>, i: usize) -> Option<f64> {
    column.as_ref().and_then(|values| values.get(i)).copied()
}

fn is_turned_by(a: &Row, b: &Row) -> f64 {
    (a.rotation_rad - b.rotation_rad).abs()
}

fn is_moved_by(a: &Row, b: &Row) -> f64 {
    a.guide2_m.iter().zip(b.guide2_m).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// Rotation and guide 2 against depth: what happens between two rows without advance happens at rest. A row that is turned against
/// the one before it was turned where that one was.
fn done(run: &InsertionRun, rows: &[Row]) -> Result<Insertion, ModelError> {
    let mut rotation: Vec<[f64; 2]> = Vec::new();
    let mut guide2: [Vec<[f64; 2]>; 2] = Default::default();
    let mut previous_m = 0.0;
    for row in rows {
        step_to(&mut rotation, previous_m, previous_m, row.rotation_rad, ROTATION_STILL_RAD);
        for (knots, held_m) in guide2.iter_mut().zip(row.guide2_m) {
            step_to(knots, previous_m, row.depth_m, held_m, GUIDE2_STILL_M);
        }
        previous_m = row.depth_m;
    }
    let [y, x] = guide2;
    let is_recorded = run.guide2_y_m.is_some() || run.guide2_x_m.is_some();
    let guide2_m = if is_recorded { [Profile::new(y)?, Profile::new(x)?] } else { Default::default() };
    let rotation_rad = Profile::new(rotation)?;
    Ok(Insertion { rotation_rad, guide2_m: Some(guide2_m), ..Insertion::default() })
}

/// Takes a profile that was read at `before_m` to a value read at `depth_m`, if it differs: linear between, a jump
/// where the depths are the same. Only the first and the last value of several jumps at one depth are kept.
fn step_to(knots: &mut Vec<[f64; 2]>, before_m: f64, depth_m: f64, value: f64, still: f64) {
    match knots.last().copied() {
        None => knots.push([0.0, value]),
        Some([_, last]) if (last - value).abs() <= still => {}
        Some([last_m, last]) => {
            if before_m > last_m {
                knots.push([before_m, last]);
            }
            if matches!(knots.as_slice(), [.., [a_m, _], [b_m, _]] if *a_m == depth_m && *b_m == depth_m) {
                knots.pop();
            }
            knots.push([depth_m, value]);
        }
    }
}

fn bins(rows: &[Row], done: &Insertion) -> Vec<Bin> {
    // Rotation and guide 2 at a row's depth, on arriving and on leaving; the row belongs to the one it agrees with.
    let mut tagged: Vec<(i64, bool, &Row)> = rows
        .iter()
        .filter_map(|row| {
            let agrees = |at: &dyn Fn(&Profile) -> f64| {
                let is_rotated = (at(&done.rotation_rad) - row.rotation_rad).abs() <= ROTATION_STILL_RAD;
                let planes = done.guide2_m.iter().flatten().zip(row.guide2_m);
                is_rotated
                    && planes.into_iter().all(|(profile, held_m)| {
                        profile.is_constant() || (at(profile) - held_m).abs() <= GUIDE2_STILL_M
                    })
            };
            let cell = (row.depth_m / BIN_M).round() as i64;
            if agrees(&|profile| profile.before(row.depth_m)) {
                Some((cell, false, row))
            } else if agrees(&|profile| profile.after(row.depth_m)) {
                Some((cell, true, row))
            } else {
                None
            }
        })
        .collect();
    tagged.sort_by_key(bin_key);
    let mut bins: Vec<Bin> = tagged
        .chunk_by(|a, b| bin_key(a) == bin_key(b))
        .map(|group| {
            let depth_m = group.iter().map(|(_, _, row)| row.depth_m).sum::<f64>() / group.len() as f64;
            let leaving = group.first().is_some_and(|(_, leaving, _)| *leaving);
            Bin {
                depth_m,
                tip_m: [median_tip_m(0, group), median_tip_m(1, group)],
                direction_rad: [median_direction_rad(0, group), median_direction_rad(1, group)],
                rows: group.len() as f64,
                moving: false,
                leaving,
            }
        })
        .collect();
    bins.sort_by(|a, b| a.depth_m.total_cmp(&b.depth_m));
    let rested_rows = bins.iter().filter(|bin| bin.rows >= 3.0).map(|bin| bin.rows).sum::<f64>();
    if rested_rows > RESTING * rows.len() as f64 {
        bins.iter_mut().for_each(|bin| bin.moving = bin.rows < 2.0);
    }
    without_outliers(bins, done)
}

fn median_direction_rad(plane: usize, group: &[(i64, bool, &Row)]) -> Option<f64> {
    let measured = group.iter().map(|(_, _, row)| row.direction_rad[plane]);
    let measured: Vec<f64> = measured.filter(|slope| slope.is_finite()).collect();
    (!measured.is_empty()).then(|| median(measured))
}

fn median_tip_m(plane: usize, group: &[(i64, bool, &Row)]) -> f64 {
    median(group.iter().map(|(_, _, row)| row.tip_m[plane]).collect())
}

/// Rows with the same key are measurements of one state.
fn bin_key((cell, leaving, row): &(i64, bool, &Row)) -> (i64, i64, [i64; 2], bool) {
    let turn = (row.rotation_rad / ROTATION_STILL_RAD).round() as i64;
    let guide = row.guide2_m.map(|m| (m / GUIDE2_STILL_M).round() as i64);
    (*cell, turn, guide, *leaving)
}

/// Stretches between bins that are too long.
fn gaps_m(bins: &[Bin]) -> Vec<[f64; 2]> {
    let pairs = bins.windows(2).map(|pair| [pair[0].depth_m, pair[1].depth_m]);
    pairs.filter(|[from_m, to_m]| to_m - from_m >= GAP_M).collect()
}

/// Drops bins far off the line between their neighbours: glitches of the tip sensor. A change at rest moves the tip
/// too, so neighbours across a jump do not count.
fn without_outliers(bins: Vec<Bin>, done: &Insertion) -> Vec<Bin> {
    let profiles = std::iter::once(&done.rotation_rad).chain(done.guide2_m.iter().flatten());
    let jumps_m: Vec<f64> = profiles.flat_map(Profile::jumps_m).collect();
    // Distance from the lines between neighbours on both sides, per plane: the middle one of three.
    let offs: Vec<Option<f64>> = (0..bins.len())
        .map(|i| -> Option<f64> {
            let pairs =
                (1..=3).filter_map(|reach| Some((bins.get(i.checked_sub(reach)?)?, bins.get(i + reach)?)));
            let pairs: Vec<_> =
                pairs.filter(|(a, b)| !are_separate(a, b, &jumps_m) && b.depth_m > a.depth_m).collect();
            (pairs.len() >= 2)
                .then(|| difference_m(0, &pairs, &bins, i).abs().max(difference_m(1, &pairs, &bins, i).abs()))
        })
        .collect();
    let farthest_m = BENT_M + farthest(offs.iter().flatten().copied());
    bins.iter().zip(&offs).filter(|(_, off)| !is_outlier(off, farthest_m)).map(|(bin, _)| *bin).collect()
}

fn is_outlier(off: &Option<f64>, farthest_m: f64) -> bool {
    off.is_some_and(|off| off > farthest_m)
}

/// Distance of a bin from the line between pairs of its neighbours.
fn difference_m(plane: usize, pairs: &[(&Bin, &Bin)], bins: &[Bin], i: usize) -> f64 {
    median(
        pairs
            .iter()
            .map(|(a, b)| {
                let fraction = (bins[i].depth_m - a.depth_m) / (b.depth_m - a.depth_m);
                bins[i].tip_m[plane] - a.tip_m[plane] - fraction * (b.tip_m[plane] - a.tip_m[plane])
            })
            .collect(),
    )
}

/// Bins between which the needle or guide 2 moved by itself.
fn are_separate(a: &Bin, b: &Bin, jumps_m: &[f64]) -> bool {
    a.leaving != b.leaving || jumps_m.iter().any(|m| (a.depth_m..=b.depth_m).contains(m))
}
