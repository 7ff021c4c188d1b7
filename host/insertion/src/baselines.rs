//! Predictions without mechanics: extrapolate the tip's path.

use super::path::TipPath;
use super::published::tip_at;
use nalgebra::{DMatrix, DVector};

/// A way to carry on a path.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Baseline {
    /// Offset, slope and curvature, by least squares.
    Quadratic,
    /// Polynomial of third degree, by least squares.
    Cubic,
    /// Kinematic bicycle: the needle starts along its axis and turns with one curvature, whose direction turns with the needle.
    Bicycle,
    /// The mean path of the earlier insertions, moved onto the observed part.
    MeanOfOthers,
}

impl Baseline {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Quadratic, Self::Cubic, Self::Bicycle, Self::MeanOfOthers];

    /// Its name in results.
    pub fn name(self) -> &'static str {
        match self {
            Self::Quadratic => "quadratic",
            Self::Cubic => "cubic",
            Self::Bicycle => "bicycle",
            Self::MeanOfOthers => "mean-of-others",
        }
    }

    /// Tip position at each depth, per plane, from the observed part; `None` where that is too little.
    pub fn predict(self, observed: &TipPath, others: &[&TipPath], depths_m: &[f64]) -> Option<Vec<Vec<f64>>> {
        match self {
            Self::Quadratic => polynomial(observed, 2, depths_m),
            Self::Cubic => polynomial(observed, 3, depths_m),
            Self::Bicycle => bicycle(observed, depths_m),
            Self::MeanOfOthers => mean_of_others(observed, others, depths_m),
        }
    }
}

fn polynomial(observed: &TipPath, degree: usize, depths_m: &[f64]) -> Option<Vec<Vec<f64>>> {
    let reach_m = observed.bins.last()?.depth_m;
    let observed_rows: Vec<_> =
        observed.bins.iter().map(|bin| powers(bin.depth_m, degree, reach_m)).collect();
    (0..observed.planes)
        .map(|plane| {
            let measured: Vec<_> = observed.bins.iter().map(|bin| bin.tip_m[plane]).collect();
            let solution = least_squares(&observed_rows, &measured)?;
            Some(depths_m.iter().map(|depth_m| dot(&powers(*depth_m, degree, reach_m), &solution)).collect())
        })
        .collect()
}

/// Powers of a depth over the reach, up to a degree.
fn powers(depth_m: f64, degree: usize, reach_m: f64) -> Vec<f64> {
    (0..=degree).map(move |power| (depth_m / reach_m).powi(power as i32)).collect::<Vec<_>>()
}

/// Step of the integration along the path.
const STEP_M: f64 = 0.25e-3;

/// `u'' = kappa` turned by the rotation, both planes at once.
fn bicycle(observed: &TipPath, depths_m: &[f64]) -> Option<Vec<Vec<f64>>> {
    let last_m = depths_m.iter().copied().fold(0.0, f64::max).max(observed.bins.last()?.depth_m);
    // Twice integrated cosine and sine of the rotation, by the midpoint rule.
    let mut bent = vec![[0.0; 2]];
    let mut heading = [0.0; 2];
    for step in 0..=(last_m / STEP_M).ceil() as usize {
        let (sin, cos) = observed.done.rotation_rad.before((step as f64 + 0.5) * STEP_M).sin_cos();
        let previous = bent[step];
        let rotated_heading = [heading[0] + STEP_M * cos, heading[1] + STEP_M * sin];
        bent.push([0, 1].map(|i| previous[i] + 0.5 * STEP_M * (heading[i] + rotated_heading[i])));
        heading = rotated_heading;
    }
    // Unknowns: offset and curvature, vertical and horizontal.
    let rows = |depth_m: f64| {
        let [cos, sin] = between_nodes(depth_m, &bent);
        if observed.planes == 2 {
            vec![vec![1.0, 0.0, cos, -sin], vec![0.0, 1.0, sin, cos]]
        } else {
            vec![vec![1.0, cos]]
        }
    };
    let design: Vec<_> = observed.bins.iter().flat_map(|bin| rows(bin.depth_m)).collect();
    let measured: Vec<_> =
        observed.bins.iter().flat_map(|bin| bin.tip_m.into_iter().take(observed.planes)).collect();
    let solution = least_squares(&design, &measured)?;
    Some(
        (0..observed.planes)
            .map(|plane| depths_m.iter().map(|depth_m| dot(&rows(*depth_m)[plane], &solution)).collect())
            .collect(),
    )
}

/// Sum along the path at a depth, between two nodes.
fn between_nodes(depth_m: f64, bent: &[[f64; 2]]) -> [f64; 2] {
    let node = (depth_m / STEP_M).floor() as usize;
    let fraction = depth_m / STEP_M - node as f64;
    let (a, b) = (bent[node], bent[node + 1]);
    [0, 1].map(|i| a[i] + fraction * (b[i] - a[i]))
}

fn mean_of_others(observed: &TipPath, others: &[&TipPath], depths_m: &[f64]) -> Option<Vec<Vec<f64>>> {
    if others.is_empty() || others.iter().any(|other| other.planes < observed.planes) {
        return None;
    }
    Some(
        (0..observed.planes)
            .map(|plane| {
                let offset_sum: f64 = observed
                    .bins
                    .iter()
                    .map(|bin| bin.tip_m[plane] - mean_tip_m(bin.depth_m, plane, others))
                    .sum();
                let offset_m = offset_sum / observed.bins.len() as f64;
                depths_m.iter().map(|depth_m| mean_tip_m(*depth_m, plane, others) + offset_m).collect()
            })
            .collect(),
    )
}

/// Mean tip of several paths at a depth.
fn mean_tip_m(depth_m: f64, plane: usize, others: &[&TipPath]) -> f64 {
    others.iter().map(|other| tip_at(other, plane, depth_m)).sum::<f64>() / others.len() as f64
}

/// `None` if there are fewer equations than unknowns or they do not determine them.
fn least_squares(rows: &[Vec<f64>], measured: &[f64]) -> Option<Vec<f64>> {
    let unknowns = rows.first()?.len();
    if rows.len() < unknowns {
        return None;
    }
    let design = DMatrix::from_fn(rows.len(), unknowns, |i, j| rows[i][j]);
    let solution = design.svd(true, true).solve(&DVector::from_column_slice(measured), 1e-12).ok()?;
    Some(solution.iter().copied().collect())
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
