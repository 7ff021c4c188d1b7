//! A second opinion for tests: the same needle by Hermite finite elements, sharing no code with the exact solution.

use nalgebra::{DMatrix, DVector};

/// Deflection at every node of `elements` equal elements per stretch under 1 N at guide 2, as `(z, u)`.
///
/// Stretches: guide 1 to guide 2, guide 2 to entry (if any), entry to tip. Relative error about 1e-7 at 60 elements.
pub fn unit_shape(
    ei: f64,
    guide2_m: f64,
    entry_m: f64,
    depth_m: f64,
    k_pa: f64,
    elements: usize,
) -> Vec<(f64, f64)> {
    let mut nodes_m = vec![0.0];
    let mut moduli = Vec::new();
    for (end_m, modulus) in [(guide2_m, 0.0), (entry_m, 0.0), (entry_m + depth_m, k_pa)] {
        let start_m = nodes_m[nodes_m.len() - 1];
        if end_m - start_m > 1e-12 {
            for i in 1..=elements {
                nodes_m.push(start_m + (end_m - start_m) * i as f64 / elements as f64);
                moduli.push(modulus);
            }
        }
    }
    let size = 2 * nodes_m.len();
    let mut stiffness = DMatrix::zeros(size, size);
    for (e, modulus) in moduli.iter().enumerate() {
        let l = nodes_m[e + 1] - nodes_m[e];
        let (b, f) = (ei / l.powi(3), modulus * l / 420.0);
        let bending = [
            [12.0, 6.0 * l, -12.0, 6.0 * l],
            [6.0 * l, 4.0 * l * l, -6.0 * l, 2.0 * l * l],
            [-12.0, -6.0 * l, 12.0, -6.0 * l],
            [6.0 * l, 2.0 * l * l, -6.0 * l, 4.0 * l * l],
        ];
        let foundation = [
            [156.0, 22.0 * l, 54.0, -13.0 * l],
            [22.0 * l, 4.0 * l * l, 13.0 * l, -3.0 * l * l],
            [54.0, 13.0 * l, 156.0, -22.0 * l],
            [-13.0 * l, -3.0 * l * l, -22.0 * l, 4.0 * l * l],
        ];
        for i in 0..4 {
            for j in 0..4 {
                stiffness[(2 * e + i, 2 * e + j)] += b * bending[i][j] + f * foundation[i][j];
            }
        }
    }
    let free = stiffness.view((2, 2), (size - 2, size - 2)).into_owned();
    let mut load = DVector::zeros(size - 2);
    load[2 * elements - 2] = 1.0;
    let solution = free.cholesky().expect("positive definite").solve(&load);
    let inner = nodes_m.iter().skip(1).enumerate().map(|(i, z_m)| (*z_m, solution[2 * i]));
    [(0.0, 0.0)].into_iter().chain(inner).collect()
}
