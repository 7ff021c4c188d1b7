//! Probability of a hit.

/// Probability that a normally distributed point lies within a radius of the target.
pub(crate) fn probability_within(miss_m: [f64; 2], covariance_m2: [f64; 3], radius_m: f64) -> f64 {
    let [xx, xy, yy] = covariance_m2;
    // Along the axes of the ellipse.
    let half = 0.5 * (xx - yy);
    let root = half.hypot(xy);
    let middle = 0.5 * (xx + yy);
    let sds = [(middle + root).max(1e-16).sqrt(), (middle - root).max(1e-16).sqrt()];
    let turn = 0.5 * xy.atan2(half);
    let (sin, cos) = turn.sin_cos();
    let rotated_mm = [cos * miss_m[0] + sin * miss_m[1], -sin * miss_m[0] + cos * miss_m[1]];
    // Midpoints over the first axis, exactly over the second.
    let count = 400;
    let [low, high] =
        [(-radius_m).max(rotated_mm[0] - 8.0 * sds[0]), radius_m.min(rotated_mm[0] + 8.0 * sds[0])];
    if high <= low {
        return 0.0;
    }
    let width = (high - low) / f64::from(count);
    (0..count)
        .map(|i| {
            let x = low + width * (f64::from(i) + 0.5);
            let half_chord = (radius_m * radius_m - x * x).max(0.0).sqrt();
            let density = (-0.5 * ((x - rotated_mm[0]) / sds[0]).powi(2)).exp()
                / (sds[0] * std::f64::consts::TAU.sqrt());
            width
                * density
                * (mass_below(half_chord, rotated_mm, sds) - mass_below(-half_chord, rotated_mm, sds))
        })
        .sum::<f64>()
        .clamp(0.0, 1.0)
}

fn mass_below(y: f64, rotated_mm: [f64; 2], sds: [f64; 2]) -> f64 {
    normal_cdf((y - rotated_mm[1]) / sds[1])
}

fn normal_cdf(x: f64) -> f64 {
    0.5 * statrs::function::erf::erfc(-x / std::f64::consts::SQRT_2)
}
