//! Solutions of `u'''' + a u'' + t u = 0` within a piece, as power series in `x` from 0 at its start to 1 at its end
//! (theory, eq. 3).
//!
//! `sum b_n x^n` with `b_(n+4) = -(t b_n / ((n+1)(n+2)(n+3)(n+4)) + a b_(n+2) / ((n+3)(n+4)))`. The magnitude of the roots of
//! `r^4 + a r^2 + t` is at most the fourth root of `s = (|a| + sqrt(t))^2`, so that `b_n` is at most `s^(n/4) / n!` of the start.

use pulp::{Arch, Simd, WithSimd};

/// Terms are counted in groups of four; so many suffice for pieces up to the characteristic length, where `s` is at most 9.
pub(super) const GROUPS: usize = 6;
const TERMS: usize = 4 * GROUPS;

/// Up to which `s` one group, two, and so on neglect less than 2e-15 of what foundation and axial load do to the shear (and far
/// less of what they do to the deflection): `s^(m-1) < 2e-15 (4m-3)!` for m groups. Without either the series ends by itself.
const MAX_ROOTS: [f64; GROUPS - 1] = [0.0, 2e-13, 2.6e-5, 2.3e-2, 0.91];

/// Coefficients of a solution, two by two, as the recursion gives them.
pub(crate) type Series = [[f64; 2]; TERMS / 2];

/// Equation of a piece of length h in terms of `x`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Equation {
    /// t, `K h^4 / EI`.
    pub modulus: f64,
    /// a, `(P - G) h^2 / EI`.
    pub axial: f64,
    /// Number of groups of terms that count.
    pub groups: usize,
}

impl Equation {
    /// Given also the root of s.
    pub fn new(modulus: f64, axial: f64, root: f64) -> Self {
        let groups = 1 + MAX_ROOTS.iter().filter(|limit| root * root > **limit).count();
        Self { modulus, axial, groups }
    }

    /// Value and three derivatives at the end of the solution that starts with `u''' = 1` and nothing else. Every other solution is made
    /// of it and its derivatives, as this one's fourth derivative is known from the equation.
    pub fn fundamental(self) -> [f64; 4] {
        // It has odd powers only: n and n + 2 from n = 3 on, four by four.
        let mut terms = [1.0 / 6.0, -self.axial / 120.0];
        let mut sums = [[0.0; 2]; 4];
        for (group, of_group) in DERIVED.iter().enumerate().take(self.groups) {
            for (sum, derived) in sums.iter_mut().zip(of_group) {
                *sum = [sum[0] + derived[0] * terms[0], sum[1] + derived[1] * terms[1]];
            }
            let n = 4 * group + 3;
            let first = self.next(n, terms[0], terms[1]);
            terms = [first, self.next(n + 2, terms[1], first)];
        }
        sums.map(|[a, b]| a + b)
    }

    /// Coefficient n + 4 from the coefficients n and n + 2.
    fn next(self, n: usize, by_modulus: f64, by_axial: f64) -> f64 {
        self.modulus * BY_MODULUS[n] * by_modulus + self.axial * BY_AXIAL[n] * by_axial
    }

    /// The solution that starts with a value and three derivatives; to zeros.
    pub fn expand(self, start: [f64; 4], series: &mut Series) {
        let [value, slope, second, third] = start;
        let mut preceding = [value, slope];
        let mut last = [second / 2.0, third / 6.0];
        (series[0], series[1]) = (preceding, last);
        for (pair, to) in series.iter_mut().enumerate().take(2 * self.groups).skip(2) {
            let n = 2 * pair - 4;
            *to = std::array::from_fn(|i| self.next(n + i, preceding[i], last[i]));
            (preceding, last) = (last, *to);
        }
    }
}

/// Values of a series at places that lie in its piece, several at once where the processor can: the same numbers on all of them, as
/// nothing is summed in another order.
pub(super) fn values(series: &Series, start_m: f64, per_m: f64, z_m: &[f64], values: &mut [f64]) {
    let Some(([[a, b], [c, d]], tail)) = series.split_first_chunk() else { return };
    if tail.as_flattened().iter().all(|term| *term == 0.0) {
        // In the open it is a cubic.
        for (at, z_m) in values.iter_mut().zip(z_m) {
            let x = (z_m - start_m) * per_m;
            let square = x * x;
            *at = a + c * square + x * (b + d * square);
        }
        return;
    }
    Arch::new().dispatch(Values { series, start_m, per_m, z_m, values });
}

/// Argument of [`values`].
struct Values<'a> {
    series: &'a Series,
    start_m: f64,
    per_m: f64,
    z_m: &'a [f64],
    values: &'a mut [f64],
}

impl WithSimd for Values<'_> {
    type Output = ();

    // Into the function that is compiled for wide registers.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (at, z_m) in self.values.iter_mut().zip(self.z_m) {
            *at = value(self.series, (z_m - self.start_m) * self.per_m);
        }
    }
}

/// Value of a series at x. All terms, of which the last may be zeros: short chains without a branch take less time than few terms.
#[inline(always)]
pub(super) fn value(series: &Series, x: f64) -> f64 {
    let square = x * x;
    let fourth = square * square;
    let eighth = fourth * fourth;
    let [a, b, c, d, e, f, g, h, i, j, k, l] = *series;
    let even = line(line(a, c, fourth), line(line(e, g, fourth), line(i, k, fourth), eighth), eighth);
    let odd = line(line(b, d, fourth), line(line(f, h, fourth), line(j, l, fourth), eighth), eighth);
    let [whole, by_x] = line(even, odd, square);
    whole + x * by_x
}

/// Two terms at once; of every second pair.
fn line(a: [f64; 2], b: [f64; 2], y: f64) -> [f64; 2] {
    [a[0] + b[0] * y, a[1] + b[1] * y]
}

/// Derivative of order 1 to 3 of a series, by Horner's rule.
pub(super) fn derivative(series: &Series, order: usize, x: f64) -> f64 {
    let terms = series.as_flattened().iter().enumerate().skip(order).rev();
    terms.fold(0.0, |sum, (n, coefficient)| sum * x + falling(n, order) * coefficient)
}

/// `n! / (n - order)!`: what the derivative of an order makes of `x^n`; 0 where nothing is left.
const fn falling(n: usize, order: usize) -> f64 {
    let (mut factor, mut k) = (1.0, 0);
    while k < order {
        factor *= n as f64 - k as f64;
        k += 1;
    }
    factor
}

/// Derivatives of order 0 to 3 at x = 1 of the terms n and n + 2, n = 3, 7 and so on.
const DERIVED: [[[f64; 2]; 4]; GROUPS] = {
    let mut factors = [[[0.0; 2]; 4]; GROUPS];
    let mut i = 0;
    while i < 8 * GROUPS {
        let (group, order, term) = (i / 8, i / 2 % 4, i % 2);
        factors[group][order][term] = falling(4 * group + 3 + 2 * term, order);
        i += 1;
    }
    factors
};

/// `-1 / ((n+1)(n+2)(n+3)(n+4))`, for all n for which a next coefficient is needed.
const BY_MODULUS: [f64; TERMS + 2] = negated_inverses(4);
/// `-1 / ((n+3)(n+4))`.
const BY_AXIAL: [f64; TERMS + 2] = negated_inverses(2);

const fn negated_inverses(order: usize) -> [f64; TERMS + 2] {
    let mut inverses = [0.0; TERMS + 2];
    let mut n = 0;
    while n < inverses.len() {
        inverses[n] = -1.0 / falling(n + 4, order);
        n += 1;
    }
    inverses
}
