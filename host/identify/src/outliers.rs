//! Single points of a shape that are far from their neighbours: an echo of something else, a wrong digit.
//!
//! The residual of a point is compared with the median residual of its neighbours, so that an error of the model, which
//! is smooth along the needle, cancels. One point of nine standard deviations among a hundred moves K by almost as much
//! as all noise does.

use readings::holds::median;
use readings::outliers::farthest;
use readings::{Fit, LateralData};
use std::ops::Range;

/// Neighbours on either side, along the needle.
const BESIDE: usize = 2;
/// Fewest points whose distances have a standard deviation.
const MIN_POINTS: usize = 20;
/// More than this share are no single points.
const MAX_SHARE: f64 = 0.05;

/// Takes single points that the fit leaves far from their neighbours out of the data; how many these are.
pub(super) fn take_outliers(data: &mut LateralData, fit: &Fit) -> usize {
    let points = data.levels.iter().map(|level| level.shape.len()).sum::<usize>();
    let mut is_outlier = vec![false; points];
    let distances: Vec<Distance> =
        (0..data.planes).flat_map(|plane| distances(data, &left(data, fit, plane))).collect();
    if distances.len() < MIN_POINTS {
        return 0;
    }
    let farthest = farthest(distances.iter().map(|of| of.from_others));
    for of in distances.iter().filter(|of| of.from_all.abs() > farthest) {
        is_outlier[of.point] = true;
    }
    let count = is_outlier.iter().filter(|is_far| **is_far).count();
    if farthest <= 0.0 || count as f64 > MAX_SHARE * points as f64 {
        return 0;
    }
    let mut of_points = is_outlier.iter().copied();
    for level in &mut data.levels {
        level.shape.retain(|_| !of_points.next().unwrap_or_default());
    }
    if let Some(fixed) = &mut data.fixed {
        let mut of_points = is_outlier.iter().copied();
        fixed.course.shape_time_s.retain(|_| !of_points.next().unwrap_or_default());
    }
    count
}

/// Residuals of every point in a plane, standard deviations, hold by hold.
fn left(data: &LateralData, fit: &Fit, plane: usize) -> Vec<f64> {
    let points: usize = data.levels.iter().map(|level| level.shape.len()).sum();
    let readings = data.levels.len() * if data.uses_force { 2 } else { 1 };
    let first_reading = plane * (readings + points) + readings;
    fit.residuals.first().into_iter().flatten().skip(first_reading).take(points).copied().collect()
}

/// Distance of a point from its neighbours.
struct Distance {
    /// Its number.
    point: usize,
    /// From the median of its neighbours: as noise has it.
    from_others: f64,
    /// From the median of these and itself: where what the fit leaves steps, points beside the step are close to those on their side.
    from_all: f64,
}

/// Distances of every point in its hold; none for the first and last ones.
fn distances(data: &LateralData, left: &[f64]) -> Vec<Distance> {
    let mut start = 0;
    let holds: Vec<Range<usize>> = data
        .levels
        .iter()
        .map(|level| {
            start += level.shape.len();
            start - level.shape.len()..start
        })
        .collect();
    let mut point_distances = Vec::new();
    for (hold, level) in holds.into_iter().zip(&data.levels) {
        let mut ordered_points: Vec<(f64, usize, f64)> = level
            .shape
            .iter()
            .zip(hold)
            .filter_map(|(point, at)| Some((point.z_m, at, *left.get(at)?)))
            .collect();
        ordered_points.sort_by(|a, b| a.0.total_cmp(&b.0));
        point_distances.extend(ordered_points.windows(2 * BESIDE + 1).map(|window| {
            let (_, point, own_residual) = window[BESIDE];
            let neighbour_residuals =
                window.iter().filter(|(_, other, _)| *other != point).map(|(.., value)| *value);
            let window_residuals = window.iter().map(|(.., value)| *value);
            Distance {
                point,
                from_others: own_residual - median(neighbour_residuals.collect()),
                from_all: own_residual - median(window_residuals.collect()),
            }
        }));
    }
    point_distances
}

#[cfg(test)]
mod tests {
    use super::*;
    use mechanics::{Beam, Foundation, Needle, Rig, Support};
    use noise::Noise;
    use readings::{ForceZero, HoldData, Measured, Parameter, ShapeDatum, SharedErrors, fit};

    const SD_M: f64 = 25e-6;
    const LN_K: Parameter = Parameter { start: 9.5, step: 1e-4, least: 2.0, most: 16.0, prior: None };

    /// Three holds of a run, with noise and something added to each point by its number.
    fn run(seed: u64, added_m: impl Fn(usize) -> f64) -> LateralData {
        let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
        let beam = Beam::solve(&rig, &Foundation::uniform(16e3).expect("valid"), 0.03).expect("solves");
        let mut noise = Noise::new(seed);
        let mut level = |number: usize| {
            let level_m = 0.6e-3 * (number + 1) as f64;
            let mut point = |i: usize| {
                let z_m = 0.07 + 1e-3 * i as f64;
                let error_m = SD_M * noise.normal() + added_m(30 * number + i);
                ShapeDatum::new(z_m, [beam.deflection_m(level_m, z_m) + error_m, 0.0])
            };
            HoldData {
                shape: (0..30).map(&mut point).collect(),
                displacement_m: vec![Measured { value: level_m, sd: 1e-6 }],
                force_n: vec![Measured { value: beam.force_n(level_m), sd: 0.01 }],
            }
        };
        LateralData {
            levels: (0..3).map(&mut level).collect(),
            support: Support::Springs,
            rig,
            depth_m: 0.03,
            planes: 1,
            shape_sd_m: SD_M,
            force_zero: ForceZero::Exact,
            shared: SharedErrors::default(),
            uses_force: true,
            effects: Vec::new(),
            fixed: None,
        }
    }

    fn taken(data: &mut LateralData) -> usize {
        let fit = fit(&[LN_K], std::slice::from_ref(data)).expect("fits");
        take_outliers(data, &fit)
    }

    #[test]
    fn single_points_far_off_are_taken_and_normal_noise_is_kept() {
        let mut data = run(1, far_off_m);
        let original = data.clone();
        assert_eq!(taken(&mut data), 3);
        let kept_points: Vec<ShapeDatum> = data.levels.iter().flat_map(|level| level.shape.clone()).collect();
        let all_points: Vec<ShapeDatum> =
            original.levels.iter().flat_map(|level| level.shape.clone()).collect();
        let expected: Vec<ShapeDatum> = all_points
            .into_iter()
            .enumerate()
            .filter(|(at, _)| far_off_m(*at) == 0.0)
            .map(|(_, point)| point)
            .collect();
        assert_eq!(kept_points, expected);
        let of_noise: usize = (2..30).map(|seed| taken(&mut run(seed, |_| 0.0))).sum();
        assert!(of_noise <= 1, "{of_noise}");
    }

    fn far_off_m(at: usize) -> f64 {
        if [7, 40, 76].contains(&at) { 9.0 * SD_M } else { 0.0 }
    }

    #[test]
    fn an_error_of_the_model_has_no_outliers() {
        // A wave along the needle, ten standard deviations high, and a third of the points shifted together.
        assert_eq!(taken(&mut run(1, |at: usize| 10.0 * SD_M * (0.3 * (at % 30) as f64).sin())), 0);
        assert_eq!(taken(&mut run(2, |at| if at % 30 > 20 { 10.0 * SD_M } else { 0.0 })), 0);
    }

    #[test]
    fn many_far_points_are_no_single_ones_and_few_points_are_kept() {
        assert_eq!(taken(&mut run(1, |at| if at % 8 == 3 { 12.0 * SD_M } else { 0.0 })), 0);
        let mut short_run = run(1, |at| if at == 3 { 12.0 * SD_M } else { 0.0 });
        short_run.levels.truncate(1);
        short_run.levels[0].shape.truncate(12);
        assert_eq!(taken(&mut short_run), 0);
    }
}
