//! Scatter of the readings of a tip sensor at rest.

use formats::session::InsertionRun;
use readings::holds::median;

/// Standard deviation of a single tip reading, from rows that follow each other at rest; `None` where there are fewer than ten
/// such pairs. Each recording is read up to a depth. Robust: from the median of the differences.
pub fn row_scatter_m(runs: &[(&InsertionRun, f64)]) -> Option<f64> {
    scatter(runs, |run| [Some(&run.tip_y_m), run.tip_x_m.as_ref()])
}

/// The same of a single reading of the tip's direction, rad.
pub fn direction_scatter_rad(runs: &[(&InsertionRun, f64)]) -> Option<f64> {
    scatter(runs, |run| [run.tip_direction_y_rad.as_ref(), run.tip_direction_x_rad.as_ref()])
}

fn scatter(
    runs: &[(&InsertionRun, f64)],
    columns: impl Fn(&InsertionRun) -> [Option<&Vec<f64>>; 2],
) -> Option<f64> {
    let mut differences = Vec::new();
    for (run, until_m) in runs {
        for (i, pair) in run.depth_m.windows(2).enumerate() {
            if (pair[1] - pair[0]).abs() > 0.3e-3 || pair[0].max(pair[1]) > *until_m {
                continue;
            }
            for column in columns(run).into_iter().flatten() {
                if let Some([a, b]) = column.get(i..i + 2) {
                    differences.push((a - b).abs());
                }
            }
        }
    }
    differences.retain(|difference| difference.is_finite());
    // The median of |N(0, 2 sd^2)| is 0.6745 sqrt(2) sd.
    (differences.len() >= 10).then(|| median(differences) / (0.674_489_75 * std::f64::consts::SQRT_2))
}
