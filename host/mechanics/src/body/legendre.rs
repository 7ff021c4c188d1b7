//! Sums of Legendre polynomials, by which the needle in a body is described: energies, parts of a length, powers.

use crate::body::table::{MODES, Matrix};
use std::sync::LazyLock;

/// Stiffness against the Legendre coefficients of a polynomial over a whole length, from that against those over its part beyond a share.
///
/// There the polynomials are sums of those over the part, by their recurrence in `x = share + (1 - share) y`:
/// `(n + 1) P_{n+1}(x) = (2n + 1) x P_n(x) - n P_{n-1}(x)`, with `(2k + 1) y P_k(y) = (k + 1) P_{k+1}(y) + k P_{k-1}(y)`.
pub(super) fn lengthened(stiffness: &Matrix, share: f64) -> Matrix {
    let mut powers = [[0.0; MODES]; MODES];
    powers[0][0] = 1.0;
    for n in 0..MODES - 1 {
        let next = times_coordinate(&powers[n], share);
        for k in 0..MODES {
            let preceding = if n > 0 { n as f64 * powers[n - 1][k] } else { 0.0 };
            powers[n + 1][k] = ((2 * n + 1) as f64 * next[k] - preceding) / (n + 1) as f64;
        }
    }
    let forces = powers.map(|of| stiffness.map(|row| row.iter().zip(&of).map(|(t, c)| t * c).sum::<f64>()));
    powers.map(|of| std::array::from_fn(|j| of.iter().zip(&forces[j]).map(|(c, f)| c * f).sum()))
}

/// Coefficients of a series times the coordinate along the lengthened part.
fn times_coordinate(of: &[f64; MODES], share: f64) -> [f64; MODES] {
    std::array::from_fn(|k| {
        let from_below = if k > 0 { k as f64 * by_distance(k - 1, share, of) } else { 0.0 };
        let from_above = if k + 1 < MODES { (k + 1) as f64 * by_distance(k + 1, share, of) } else { 0.0 };
        share * of[k] + from_below + from_above
    })
}

/// Coefficient of one order over the number of the polynomials that it stands for.
fn by_distance(k: usize, share: f64, of: &[f64; MODES]) -> f64 {
    (1.0 - share) * of[k] / (2 * k + 1) as f64
}

/// Integrals over (-1, 1) of products of Legendre polynomials' derivatives.
pub(super) struct Energies {
    pub slopes: Matrix,
    pub curvatures: Matrix,
}

/// Integrals of all pairs.
pub(super) static ENERGIES: LazyLock<Energies> = LazyLock::new(|| {
    let first: [[f64; MODES]; MODES] = std::array::from_fn(|n| derivative(&unit(n)));
    let second = first.map(|of| derivative(&of));
    Energies {
        slopes: std::array::from_fn(|i| std::array::from_fn(|j| product(&first[i], &first[j]))),
        curvatures: std::array::from_fn(|i| std::array::from_fn(|j| product(&second[i], &second[j]))),
    }
});

/// Derivatives are sums of Legendre polynomials of lower degree: P_n' = sum (2k + 1) P_k over k = n - 1, n - 3 and so on.
fn derivative(coefficients: &[f64; MODES]) -> [f64; MODES] {
    std::array::from_fn(|k| {
        let higher_sum = coefficients.iter().skip(k + 1).step_by(2).sum::<f64>();
        (2 * k + 1) as f64 * higher_sum
    })
}

/// Coefficients of one polynomial alone.
fn unit(n: usize) -> [f64; MODES] {
    std::array::from_fn(|k| if k == n { 1.0 } else { 0.0 })
}

/// Integral of the product of two sums of Legendre polynomials.
fn product(a: &[f64; MODES], b: &[f64; MODES]) -> f64 {
    a.iter().zip(b).enumerate().map(|(k, (a, b))| 2.0 * a * b / (2 * k + 1) as f64).sum()
}

/// Value and slope of a sum of powers of x, over pieces of a length.
pub(super) fn evaluated(terms: &[f64], x: f64, length_m: f64) -> [f64; 2] {
    let [value, slope] =
        terms.iter().rev().fold([0.0, 0.0], |[value, slope], term| [value * x + term, slope * x + value]);
    [value, slope / length_m]
}

/// A needle in the body as a polynomial.
pub(crate) struct InBody {
    pub(super) powers: [f64; MODES],
    pub(super) body_m: f64,
    pub(super) depth_m: f64,
}

impl InBody {
    /// Deflection and slope at a place in the body.
    pub fn at(&self, z_m: f64) -> [f64; 2] {
        evaluated(&self.powers, (z_m - self.body_m) / self.depth_m, self.depth_m)
    }
}

/// Powers of x from 0 to 1 that make a sum of Legendre polynomials of `2 x - 1`.
pub(crate) fn powers(coefficients: &[f64; MODES]) -> [f64; MODES] {
    std::array::from_fn(|power| coefficients.iter().zip(&*POWERS).map(|(c, row)| c * row[power]).sum())
}

/// Coefficients of the Legendre polynomials of `2 x - 1`: `(-1)^(n+k) C(n, k) C(n+k, k)`.
static POWERS: LazyLock<Matrix> = LazyLock::new(|| {
    std::array::from_fn(|n| {
        let mut value = if n.is_multiple_of(2) { 1.0 } else { -1.0 };
        std::array::from_fn(|k| {
            let now = if k <= n { value } else { 0.0 };
            let (n, k) = (n as f64, k as f64);
            value *= -(n - k) * (n + k + 1.0) / ((k + 1.0) * (k + 1.0));
            now
        })
    })
});
