//! Recorded insertions in which guide 2 steers: what each of its moves does to the tip, as the posterior of `guide predict` has it before the
//! move, and as a Jacobian by Broyden's rule has it that was updated along the same readings.

use crate::steer::Jacobian;
use anyhow::{Result, ensure};
use formats::session::{InsertionRun, Session};
use inference::insertion::{
    Bin, Candidates, Moments, Posterior, ReadingNoise, TipPath, direction_scatter_rad, learn, row_scatter_m,
};
use inference::predict::{Options, tissue};
use serde::Serialize;

/// Bins nearer to a stop than this belong to it, m: what was done at rest happens at one depth, but for rounding.
const AT_STOP_M: f64 = 1.5e-3;
/// Guide moves below this are none, m.
const SMALLEST_MOVE_M: f64 = 0.1e-3;
/// Insertions of which less is recorded before the first move are not used: two depths give no direction.
const FEWEST_BINS: usize = 3;
/// Noise of a reading where neither the session nor its rows give it.
const DEFAULT_NOISE: ReadingNoise = ReadingNoise { position_m: 0.1e-3, direction_rad: 1e-3 };
/// Tip per guide displacement, and its slope per guide displacement, mrad/mm, with which the published Jacobian begins.
const FIRST_TIP: f64 = -0.5;
const FIRST_SLOPE: f64 = -10.0;
/// Depth after which the published Jacobian is updated where no move was made, m: its pushes are 5 mm.
const PUSH_M: f64 = 4e-3;
/// Stops up to which the published controller plans ahead.
const HORIZON: usize = 4;

/// Predicted quantity.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum Quantity {
    /// Displacement of the tip by a guide move at rest, mm.
    Move,
    /// Change of the needle's slope at the tip by it, mrad.
    MoveDirection,
    /// Displacement of the tip from there to the next stop, mm.
    NextStop,
    /// Displacement within four stops, all moves made as they were, mm.
    FourStops,
}

impl Quantity {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Move, Self::MoveDirection, Self::NextStop, Self::FourStops];

    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Move => "a move, tip, mm",
            Self::MoveDirection => "a move, slope at the tip, mrad",
            Self::NextStop => "to the next stop, tip, mm",
            Self::FourStops => "over four stops, tip, mm",
        }
    }
}

/// One quantity in one plane, recorded and predicted, in the unit of its name.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Compared {
    /// Predicted quantity.
    pub quantity: Quantity,
    /// As recorded.
    pub recorded: f64,
    /// By the posterior that learns from the other insertions too, with its standard deviation (that of two readings is part of it).
    pub posterior: [f64; 2],
    /// By the posterior from the readings of this insertion up to here alone.
    pub alone: [f64; 2],
    /// By the Jacobian.
    pub broyden: f64,
}

/// A stop at which the guide moved.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Stop {
    /// Depth at the first and at the last of its moves, m: the same but for what the needle slips meanwhile.
    depths_m: [f64; 2],
    /// Guide 2 on arriving and on leaving, m.
    guide_m: [[f64; 2]; 2],
    /// Readings then.
    bins: [Bin; 2],
}

/// Stops with a move and readings before and after it, in order of depth. Moves that are recorded in parts at nearly one depth are one.
fn stops(path: &TipPath) -> Vec<Stop> {
    let Some(planes) = &path.done.guide2_m else { return Vec::new() };
    let mut depths_m: Vec<f64> =
        planes.iter().flat_map(|plane| plane.jumps_m().collect::<Vec<_>>()).collect();
    depths_m.sort_by(f64::total_cmp);
    depths_m
        .chunk_by(|a, b| b - a < AT_STOP_M)
        .filter_map(|depths_m| {
            let (first_m, last_m) = (*depths_m.first()?, *depths_m.last()?);
            let guide_m = [
                [0, 1].map(|plane: usize| planes[plane].before(first_m)),
                [0, 1].map(|plane: usize| planes[plane].after(last_m)),
            ];
            let moved_m =
                (0..2).map(|plane| (guide_m[1][plane] - guide_m[0][plane]).abs()).fold(0.0, f64::max);
            let bins = [nearest_bin(first_m, false, &path.bins)?, nearest_bin(last_m, true, &path.bins)?];
            (moved_m > SMALLEST_MOVE_M).then_some(Stop { depths_m: [first_m, last_m], guide_m, bins })
        })
        .collect()
}

fn nearest_bin(depth_m: f64, leaving: bool, bins: &[Bin]) -> Option<Bin> {
    let stop_bins = bins.iter().filter(|bin| bin.leaving == leaving);
    stop_bins
        .filter(|bin| distance_m(bin, depth_m) < AT_STOP_M)
        .min_by(|a, b| distance_m(a, depth_m).total_cmp(&distance_m(b, depth_m)))
        .copied()
}

fn distance_m(bin: &Bin, depth_m: f64) -> f64 {
    (bin.depth_m - depth_m).abs()
}

/// Compares all insertions of a session in which guide 2 moves.
///
/// # Errors
/// Where guide 2 moves in none of them, or one cannot be read.
pub fn compare(session: &Session) -> Result<Vec<Compared>> {
    let paths = session.insertion.iter().map(TipPath::new).collect::<Result<Vec<_>, _>>()?;
    let reach_m = paths.iter().map(|path| path.deepest_m).fold(0.0, f64::max);
    let tissue = tissue(session, &Options::default(), &mut Vec::new())?;
    let candidates = Candidates::new(&tissue, &paths, reach_m)?;
    let mut compared = Vec::new();
    for (number, path) in paths.iter().enumerate() {
        let stops = stops(path);
        if stops.is_empty() {
            continue;
        }
        let other_paths: Vec<usize> = (0..paths.len()).filter(|other| *other != number).collect();
        let recordings: Vec<(&InsertionRun, f64)> = other_paths
            .iter()
            .filter_map(|other| Some((session.insertion.get(*other)?, f64::INFINITY)))
            .collect();
        let noise = noise(session, &recordings);
        let learned = learn(&candidates, &paths, &other_paths, number, noise);
        let of_others = |until: Until| {
            let mut posterior = Posterior::new(&candidates, &learned);
            until.of(path).iter().for_each(|bin| posterior.update(bin));
            posterior
        };
        let of_itself = |until: Until| -> Posterior<'_> {
            let mut known_paths = paths.clone();
            known_paths[number] = path.with_bins(until.of(path));
            let learned = learn(&candidates, &known_paths, &[], number, noise);
            let mut posterior = Posterior::new(&candidates, &learned);
            posterior.update_all(&known_paths[number]);
            posterior
        };
        let jacobians = jacobians(path, &stops);
        for (at, stop) in stops.iter().enumerate() {
            let before_move = Until { depth_m: stop.bins[0].depth_m, leaving: false };
            if before_move.of(path).len() < FEWEST_BINS {
                continue;
            }
            let [jacobian_before, jacobian_after] = &jacobians[at];
            let after_move = Until { depth_m: stop.bins[1].depth_m, leaving: true };
            let moved_m = [0, 1].map(|plane: usize| stop.guide_m[1][plane] - stop.guide_m[0][plane]);
            let [arriving, leaving] = [(stop.depths_m[0], false), (stop.depths_m[1], true)];
            let posteriors_before = [of_others(before_move), of_itself(before_move)];
            let posteriors_after = [of_others(after_move), of_itself(after_move)];
            let mut add =
                |quantity: Quantity, recorded: Recorded, predicted: [Vec<Moments>; 2], rows: [f64; 2]| {
                    let direction = quantity == Quantity::MoveDirection;
                    let sd = if direction { noise.direction_rad } else { noise.position_m };
                    for (plane, by_jacobian) in rows.into_iter().enumerate().take(paths[number].planes) {
                        let Some(change) = recorded.change[plane] else { continue };
                        compared.push(Compared {
                            quantity,
                            recorded: 1e3 * change,
                            posterior: moments_in_plane(&predicted[0], plane, sd, recorded.readings),
                            alone: moments_in_plane(&predicted[1], plane, sd, recorded.readings),
                            broyden: by_jacobian,
                        });
                    }
                };
            let [bin_before, bin_after] = &stop.bins;
            let [tip, slope] = change_by(jacobian_before, moved_m, 0.0);
            add(
                Quantity::Move,
                change(bin_after, bin_before),
                posterior_in_plane(&posteriors_before, arriving, leaving),
                tip,
            );
            let directions =
                posteriors_before.each_ref().map(|one| one.direction_change_rad(arriving, leaving));
            if let [Some(from_others), Some(alone)] = directions {
                let recorded = Recorded {
                    change: [0, 1].map(|plane| {
                        Some(bin_after.direction_rad[plane]? - bin_before.direction_rad[plane]?)
                    }),
                    readings: change(bin_after, bin_before).readings,
                };
                add(Quantity::MoveDirection, recorded, [from_others, alone], slope);
            }
            for (quantity, ahead) in [(Quantity::NextStop, 1), (Quantity::FourStops, HORIZON)] {
                let Some(next) = stops.get(at + ahead) else { continue };
                let then = (next.depths_m[0], false);
                let moved_m = [0, 1].map(|plane: usize| next.guide_m[0][plane] - stop.guide_m[1][plane]);
                let [tip, _] = change_by(jacobian_after, moved_m, next.depths_m[0] - stop.depths_m[1]);
                add(
                    quantity,
                    change(&next.bins[0], bin_after),
                    posterior_in_plane(&posteriors_after, leaving, then),
                    tip,
                );
            }
        }
    }
    ensure!(
        !compared.is_empty(),
        "{}: insertion: guide 2 moves at rest in none, expected one or more that are steered",
        session.dir.display()
    );
    Ok(compared)
}

fn change_by(jacobian: &Jacobian<4>, moved_m: [f64; 2], way_m: f64) -> [[f64; 2]; 2] {
    let predicted_change = jacobian.change([moved_m[0], moved_m[1], way_m].map(|m| 1e3 * m));
    [[predicted_change[0], predicted_change[1]], [predicted_change[2], predicted_change[3]]]
}

fn posterior_in_plane(
    posteriors: &[Posterior; 2],
    bin_before: (f64, bool),
    bin_after: (f64, bool),
) -> [Vec<Moments>; 2] {
    posteriors.each_ref().map(|one| one.tip_change_m(bin_before, bin_after))
}

fn change(to: &Bin, from: &Bin) -> Recorded {
    Recorded {
        change: [0, 1].map(|plane: usize| Some(to.tip_m[plane] - from.tip_m[plane])),
        readings: to.rows.recip() + from.rows.recip(),
    }
}

fn moments_in_plane(moments: &[Moments], plane: usize, sd: f64, readings: f64) -> [f64; 2] {
    let plane_moments = moments.get(plane).copied().unwrap_or_default();
    [1e3 * plane_moments.mean, 1e3 * plane_moments.sd.hypot(sd * readings.sqrt())]
}

/// Recorded path, per plane, and the sum of the reciprocal numbers of readings behind it.
struct Recorded {
    change: [Option<f64>; 2],
    readings: f64,
}

/// Used extent of a recording.
#[derive(Clone, Copy)]
struct Until {
    depth_m: f64,
    /// Whether readings after the move at that depth are included.
    leaving: bool,
}

impl Until {
    fn of(self, path: &TipPath) -> Vec<Bin> {
        path.bins
            .iter()
            .filter(|bin| {
                bin.depth_m < self.depth_m - 1e-9
                    || (bin.depth_m < self.depth_m + 1e-9 && (self.leaving || !bin.leaving))
            })
            .copied()
            .collect()
    }
}

/// Noise of a reading: as stated, or as rows at rest show it.
fn noise(session: &Session, recordings: &[(&InsertionRun, f64)]) -> ReadingNoise {
    let position_m = session.noise.tip_m.or_else(|| row_scatter_m(recordings));
    let direction_rad = session.noise.tip_direction_rad.or_else(|| direction_scatter_rad(recordings));
    ReadingNoise {
        position_m: position_m.unwrap_or(DEFAULT_NOISE.position_m),
        direction_rad: direction_rad.unwrap_or(DEFAULT_NOISE.direction_rad),
    }
}

/// The published Jacobian on arriving at each stop and on leaving it, in mm and mrad: updated after every push and after every guide move.
fn jacobians(path: &TipPath, stops: &[Stop]) -> Vec<[Jacobian<4>; 2]> {
    let mut jacobian = Jacobian::new([
        gain_row(0, FIRST_TIP),
        gain_row(1, FIRST_TIP),
        gain_row(0, FIRST_SLOPE),
        gain_row(1, FIRST_SLOPE),
    ]);
    let mut last = path.bins.first().map(|bin| (state_of(bin, [0.0; 2]), bin.depth_m));
    let mut guide_m = [0.0; 2];
    let mut jacobians = Vec::with_capacity(stops.len());
    for stop in stops {
        let mut take = |bin: &Bin, guide_m: [f64; 2]| {
            let now = state_of(bin, guide_m);
            if let Some((last, _)) = last {
                jacobian.update(last, now);
            }
            last = Some((now, bin.depth_m));
            (jacobian.clone(), bin.depth_m)
        };
        // Pushes without a move before this stop.
        let [arriving, leaving] = &stop.bins;
        let mut reached_m =
            path.bins.first().map_or(0.0, |bin| bin.depth_m).max(jacobians.last().map_or(0.0, depth_of));
        for bin in path.bins.iter().filter(|bin| !bin.moving) {
            if bin.depth_m > reached_m + PUSH_M && bin.depth_m < arriving.depth_m - PUSH_M {
                reached_m = take(bin, guide_m).1;
            }
        }
        let arriving_state = take(arriving, stop.guide_m[0]).0;
        let leaving_state = take(leaving, stop.guide_m[1]).0;
        guide_m = stop.guide_m[1];
        jacobians.push(([arriving_state, leaving_state], leaving.depth_m));
    }
    jacobians.into_iter().map(|(pair, _)| pair).collect()
}

fn state_of(bin: &Bin, guide_m: [f64; 2]) -> ([f64; 4], [f64; 3]) {
    let slope = bin.direction_rad.map(|slope| slope.unwrap_or_default());
    let readings = [bin.tip_m[0], bin.tip_m[1], slope[0], slope[1]];
    (readings.map(|value| 1e3 * value), [guide_m[0], guide_m[1], bin.depth_m].map(|m| 1e3 * m))
}

fn gain_row(plane: usize, gain: f64) -> [f64; 3] {
    [0, 1, 2].map(|i: usize| if i == plane { gain } else { 0.0 })
}

fn depth_of(found: &([Jacobian<4>; 2], f64)) -> f64 {
    found.1
}

#[cfg(test)]
#[path = "recorded_tests.rs"]
mod tests;
