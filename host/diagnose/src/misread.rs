//! Outliers of a sweep, and its rounding step.

use nalgebra::{DMatrix, DVector};
use readings::outliers::farthest;

/// Fraction of the distances between neighbouring values that may be shorter than the step, because values were joined from several
/// images.
const SHORTER: f64 = 0.05;
/// Values closer than this are the same.
const SAME_M: f64 = 1e-9;
/// Golden ratio: the fractional parts of its multiples fill an interval evenly, whatever their number.
const GOLDEN: f64 = 0.618_033_988_749_894_9;

/// Whether each point of a sweep is kept. An outlier is off a smooth curve by many times the median distance; the values are rounded to
/// `step_m`.
pub(super) fn without_misread(z_m: &[f64], values_m: &[f64], step_m: f64) -> Vec<bool> {
    let mut is_kept = vec![true; z_m.len()];
    let degree = (z_m.len() / 4).min(4);
    for _ in 0..3 {
        let indices: Vec<usize> = (0..z_m.len()).filter(|i| is_kept[*i]).collect();
        if indices.len() < degree + 4 {
            return is_kept;
        }
        let curve = polynomials(z_m, degree);
        let design = DMatrix::from_fn(indices.len(), degree + 1, |i, j| curve[(indices[i], j)]);
        let measured = DVector::from_fn(indices.len(), |i, _| values_m[indices[i]]);
        let Ok(coefficients) = design.svd(true, true).solve(&measured, 1e-12) else { return is_kept };
        let deviations: Vec<f64> = (&curve * coefficients).iter().zip(values_m).map(|(c, v)| v - c).collect();
        // If most values are rounded to the same number, the median deviation is nearly zero whatever the noise is. Therefore the
        // deviations are spread over the rounding step before the median is taken.
        let spread = indices.iter().map(|i| deviations[*i] + step_m * ((*i as f64 * GOLDEN).fract() - 0.5));
        let farthest_m = farthest(spread).max(1e-6);
        let next: Vec<bool> = deviations.iter().map(|deviation| deviation.abs() <= farthest_m).collect();
        if next == is_kept {
            break;
        }
        is_kept = next;
    }
    is_kept
}

/// The step to which values are rounded; if they are not rounded, a small distance of neighbouring values, and 0 if all are equal.
pub(super) fn step_m(values_m: &[f64]) -> f64 {
    let mut distinct_m: Vec<f64> = values_m.iter().copied().filter(|value| value.is_finite()).collect();
    distinct_m.sort_by(f64::total_cmp);
    distinct_m.dedup_by(|a, b| (*a - *b).abs() < SAME_M);
    let mut spacings_m: Vec<f64> =
        distinct_m.iter().zip(distinct_m.iter().skip(1)).map(|(a, b)| b - a).collect();
    spacings_m.sort_by(f64::total_cmp);
    let Some(first_m) = spacings_m.get((SHORTER * spacings_m.len() as f64) as usize) else { return 0.0 };
    // Printed values are rounded themselves; distances over many steps give the step more accurately.
    let lowest_m = distinct_m.first().copied().unwrap_or_default();
    let from_lowest = distinct_m.iter().map(|value| value - lowest_m).filter(|m| *m > 0.0);
    from_lowest.fold(*first_m, |step_m, m| m / (m / step_m).round().max(1.0))
}

/// Powers of the position, scaled to -1..1, up to a degree.
pub(super) fn polynomials(at: &[f64], degree: usize) -> DMatrix<f64> {
    let (low, high) = at.iter().fold((f64::MAX, f64::MIN), |(l, h), z| (l.min(*z), h.max(*z)));
    let half = (0.5 * (high - low)).max(f64::MIN_POSITIVE);
    DMatrix::from_fn(at.len(), degree + 1, |i, j| ((at[i] - low) / half - 1.0).powi(j as i32))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    fn normal(random: &mut ChaCha8Rng) -> f64 {
        StandardNormal.sample(random)
    }

    #[test]
    fn the_step_is_found_of_printed_pixels_and_of_numbers_that_are_not_rounded() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let [pixel_step_m, fine_step_m] = [51.28e-6, 1e-6].map(|true_step_m: f64| {
            let readings_m =
                (0..800).map(|i| 2e-3 * (f64::from(i) * 0.01).sin() + 2e-5 * normal(&mut random));
            let printed_m =
                readings_m.map(|m| ((m / true_step_m).round() * true_step_m * 1e6).round() * 1e-6);
            step_m(&printed_m.collect::<Vec<f64>>())
        });
        assert!((pixel_step_m / 51.28e-6 - 1.0).abs() < 1e-3, "{pixel_step_m}");
        assert!(fine_step_m < 2e-6);
        assert_eq!(step_m(&[0.0; 5]), 0.0);
        assert_eq!(step_m(&[]), 0.0);
    }

    #[test]
    fn of_a_straight_needle_in_pixels_none_is_misread_but_what_is_far_off() {
        let z_m: Vec<f64> = (0..70).map(|i| 1e-3 * f64::from(i)).collect();
        let (mut kept_count, mut outlier_count) = (0, 0);
        for seed in 0..100 {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            // Most points are in the pixel of the needle.
            let noise_m = [8e-6, 14e-6, 20e-6, 30e-6][seed as usize % 4];
            let mut values_m: Vec<f64> = (0..z_m.len())
                .map(|_| ((12e-6 + noise_m * normal(&mut random)) / 51e-6).round() * 51e-6)
                .collect();
            values_m[30] += 255e-6;
            let of_all = without_misread(&z_m, &values_m, 51e-6);
            outlier_count += usize::from(!of_all[30]);
            kept_count += of_all.iter().filter(|is_kept| **is_kept).count() - usize::from(of_all[30]);
        }
        assert!(kept_count >= 100 * 69 - 5, "{kept_count} of {}", 100 * 69);
        assert!(outlier_count >= 97, "{outlier_count}");
    }
}
