//! The published tip load and prediction (Paper A, Lehmann et al., section III), for comparison: the tip load that each measured
//! tip position requires, averaged over the last part observed, and carried on as a constant. Modulus and gap are taken as
//! exact, measured positions as the cut path.

use super::path::TipPath;
use mechanics::growth::{GrowingBeam, Guide2Grip, NodeLoads};
use mechanics::insertion::grid_m;
use mechanics::{Model, ModelError};

/// Step of the measured path, m.
const STEP_M: f64 = 1e-3;

/// Tip load and predicted path.
#[derive(Debug, Clone, PartialEq)]
pub struct Published {
    /// Mean tip load per plane, N.
    pub load_n: Vec<f64>,
    /// Depths of the path, every millimetre.
    pub depth_m: Vec<f64>,
    /// Path per plane: as measured up to where it was observed, predicted beyond.
    pub tip_m: Vec<Vec<f64>>,
}

/// Predicts from `path` up to `until_m`, with the load averaged from `from_m` on, down to `last_m`.
/// `offset_m`: reading of the tip sensor, per plane, of a needle that is straight. The needle is taken as not turned.
///
/// # Errors
/// As [`GrowingBeam::new`].
pub fn published(
    model: &Model,
    path: &TipPath,
    offset_m: [f64; 2],
    [from_m, until_m, last_m]: [f64; 3],
) -> Result<Published, ModelError> {
    let growth = GrowingBeam::new(&model.problem(last_m)?, grid_m(last_m, STEP_M, &[]), Guide2Grip::Holding)?;
    let depth_m = growth.depths_m().to_vec();
    let observed = depth_m.partition_point(|m| *m <= until_m + 1e-9);
    let first = depth_m.partition_point(|m| *m < from_m - 1e-9).min(observed.saturating_sub(1));
    let (mut loads_n, mut paths_m) = (Vec::new(), Vec::new());
    for plane in 0..path.planes {
        let guide2_m: Vec<f64> = match &path.done.guide2_m {
            Some(profiles) => depth_m.iter().map(|m| profiles[plane].before(*m)).collect(),
            None => vec![0.0; depth_m.len()],
        };
        let measured_m: Vec<f64> =
            depth_m[..observed].iter().map(|m| tip_at(path, plane, *m) - offset_m[plane]).collect();
        let load_n = growth.load_of_path_n(&measured_m, &guide2_m[..observed]);
        let averaged = load_n.get(first..).unwrap_or_default();
        let mean_n = averaged.iter().sum::<f64>() / averaged.len() as f64;
        let states = growth.under_load(|node| NodeLoads {
            load_n: [load_n.get(node).copied().unwrap_or(mean_n); 2],
            guide2_m: [guide2_m[node]; 2],
        });
        loads_n.push(mean_n);
        paths_m.push(states.iter().map(|state| state.tip_m[0] + offset_m[plane]).collect());
    }
    Ok(Published { load_n: loads_n, depth_m, tip_m: paths_m })
}

/// Measured tip position at a depth: linear between bins, constant beyond.
pub(super) fn tip_at(path: &TipPath, plane: usize, depth_m: f64) -> f64 {
    let next = path.bins.partition_point(|bin| bin.depth_m < depth_m);
    match (next.checked_sub(1).and_then(|before| path.bins.get(before)), path.bins.get(next)) {
        (Some(a), Some(b)) => {
            let fraction = (depth_m - a.depth_m) / (b.depth_m - a.depth_m);
            a.tip_m[plane] + fraction * (b.tip_m[plane] - a.tip_m[plane])
        }
        (Some(only), None) | (None, Some(only)) => only.tip_m[plane],
        (None, None) => f64::NAN,
    }
}
