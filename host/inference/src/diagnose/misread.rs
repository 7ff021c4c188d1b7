//! Points of a sweep that were misread.

use nalgebra::{DMatrix, DVector};

/// Which points of a sweep are not misread: off a smooth curve by many times the usual distance.
pub(super) fn without_misread(z_m: &[f64], values_m: &[f64]) -> Vec<bool> {
    const TIMES: f64 = 4.5;
    let mut kept = vec![true; z_m.len()];
    let degree = (z_m.len() / 4).min(4);
    for _ in 0..3 {
        let indices: Vec<usize> = (0..z_m.len()).filter(|i| kept[*i]).collect();
        if indices.len() < degree + 4 {
            return kept;
        }
        let curve = polynomials(z_m, degree);
        let known = DMatrix::from_fn(indices.len(), degree + 1, |i, j| curve[(indices[i], j)]);
        let measured = DVector::from_fn(indices.len(), |i, _| values_m[indices[i]]);
        let Ok(coefficients) = known.svd(true, true).solve(&measured, 1e-12) else { return kept };
        let off: Vec<f64> =
            (&curve * coefficients).iter().zip(values_m).map(|(c, v)| (v - c).abs()).collect();
        let mut sizes: Vec<f64> = indices.iter().map(|i| off[*i]).collect();
        sizes.sort_by(f64::total_cmp);
        let usual_m = 1.4826 * sizes[sizes.len() / 2];
        let next: Vec<bool> = off.iter().map(|off| *off <= (TIMES * usual_m).max(1e-6)).collect();
        if next == kept {
            break;
        }
        kept = next;
    }
    kept
}

/// Powers of the place scaled to -1..1, up to a degree.
pub(super) fn polynomials(at: &[f64], degree: usize) -> DMatrix<f64> {
    let (low, high) = at.iter().fold((f64::MAX, f64::MIN), |(l, h), z| (l.min(*z), h.max(*z)));
    let half = (0.5 * (high - low)).max(f64::MIN_POSITIVE);
    DMatrix::from_fn(at.len(), degree + 1, |i, j| ((at[i] - low) / half - 1.0).powi(j as i32))
}
