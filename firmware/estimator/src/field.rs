//! Stiffness and damping of the tissue against depth, from the parameters (theory, eq. 50).
//!
//! Depth is cut into segments. In each, the logarithm of the stiffness and the damping itself are sums of Legendre polynomials of
//! the depth scaled to -1 .. 1: these are orthogonal, so that the parameters of a segment are weakly correlated, whereas the
//! scales of powers of the depth would span twenty decades. The logarithm keeps stiffness positive; damping, which may be zero,
//! is bounded below by 0.

use nalgebra::{RealField, convert};

/// Largest number of coefficients per segment.
pub const MAX_COEFFICIENTS: usize = 8;
/// Damping that a parameter value of 1 stands for, N s/m^2.
pub const DAMPING_UNIT: f64 = 1e3;
/// Bounds of the tissue's stiffness, N/m^2, within which a search stays.
pub const STIFFNESS_RANGE: [f64; 2] = [2e2, 5e6];
/// Bounds of the tissue's damping, N s/m^2.
pub const DAMPING_RANGE: [f64; 2] = [0.0, 1e4];

/// Layout of parameters: per segment the coefficients of the stiffness, then per segment those of the damping, then the
/// offsets of force and tip sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    /// Segments of depth.
    pub segments: usize,
    /// Coefficients of the stiffness in a segment: order + 1.
    pub stiffness: usize,
    /// Coefficients of the damping in a segment.
    pub damping: usize,
}

impl Layout {
    /// Resulting number of parameters.
    pub const fn parameters(&self) -> usize {
        self.segments * (self.stiffness + self.damping) + 2
    }

    /// First parameter of a segment's stiffness.
    pub const fn stiffness_at(&self, segment: usize) -> usize {
        segment * self.stiffness
    }

    /// First parameter of a segment's damping.
    pub const fn damping_at(&self, segment: usize) -> usize {
        self.segments * self.stiffness + segment * self.damping
    }

    /// Offset of the force sensor.
    pub const fn force_offset(&self) -> usize {
        self.segments * (self.stiffness + self.damping)
    }

    /// Offset of the tip sensor relative to the base.
    pub const fn tip_offset(&self) -> usize {
        self.force_offset() + 1
    }
}

/// The tissue in `C` cells of depth.
#[derive(Debug, Clone, Copy)]
pub struct Field<T, const C: usize> {
    layout: Layout,
    segment: [u8; C],
    basis: [[T; MAX_COEFFICIENTS]; C],
    /// Stiffness of each cell, N/m^2.
    pub stiffness: [T; C],
    /// Damping of each cell, N s/m^2.
    pub damping: [T; C],
}

impl<T: RealField + Copy, const C: usize> Field<T, C> {
    /// Cells and segments of these lengths. The last segment reaches to `reach_m`, or has the length of the others if `reach_m`
    /// is not beyond its start. The tissue beyond it has the properties at its end.
    pub fn new(layout: Layout, cell_m: T, segment_m: T, reach_m: T) -> Self {
        let mut segment = [0; C];
        let mut basis = [[T::zero(); MAX_COEFFICIENTS]; C];
        let mut middle_m = cell_m * convert(0.5);
        for (segment, basis) in segment.iter_mut().zip(&mut basis) {
            let mut top_m = T::zero();
            while usize::from(*segment) + 1 < layout.segments && middle_m > top_m + segment_m {
                *segment += 1;
                top_m += segment_m;
            }
            let is_last = usize::from(*segment) + 1 == layout.segments;
            let length_m = if is_last && reach_m > top_m { reach_m - top_m } else { segment_m };
            let u = ((middle_m - top_m) / length_m * convert(2.0) - T::one()).min(T::one());
            legendre(u, basis);
            middle_m += cell_m;
        }
        Self { layout, segment, basis, stiffness: [T::zero(); C], damping: [T::zero(); C] }
    }

    /// Segment of a cell.
    pub fn segment(&self, cell: usize) -> usize {
        usize::from(self.segment[cell])
    }

    /// Takes the parameters' values, for the first `cells`.
    pub fn set<const N: usize>(&mut self, parameters: &[T; N], cells: usize) {
        for cell in 0..cells.min(C) {
            let (parameter, basis) = self.stiffness_basis(cell);
            let logarithm = sum(&parameters[parameter..], basis);
            let (parameter, basis) = self.damping_basis(cell);
            let damping = sum(&parameters[parameter..], basis) * convert(DAMPING_UNIT);
            let [least, most] = STIFFNESS_RANGE;
            self.stiffness[cell] = logarithm.exp().clamp(convert(least), convert(most));
            let [least, most] = DAMPING_RANGE;
            self.damping[cell] = damping.clamp(convert(least), convert(most));
        }
    }

    /// First parameter of a cell's stiffness and the derivatives of its logarithm.
    pub fn stiffness_basis(&self, cell: usize) -> (usize, &[T]) {
        let first_parameter = self.layout.stiffness_at(usize::from(self.segment[cell]));
        (first_parameter, &self.basis[cell][..self.layout.stiffness])
    }

    /// First parameter of a cell's damping and its derivatives, in damping units.
    pub fn damping_basis(&self, cell: usize) -> (usize, &[T]) {
        let first_parameter = self.layout.damping_at(usize::from(self.segment[cell]));
        (first_parameter, &self.basis[cell][..self.layout.damping])
    }
}

fn sum<T: RealField + Copy>(parameters: &[T], basis: &[T]) -> T {
    parameters.iter().zip(basis).fold(T::zero(), |sum, (&a, &b)| sum + a * b)
}

/// Legendre polynomials by their recursion.
fn legendre<T: RealField + Copy>(u: T, values: &mut [T; MAX_COEFFICIENTS]) {
    values[0] = T::one();
    values[1] = u;
    for n in 2..MAX_COEFFICIENTS {
        let order: T = convert(n as f64);
        let odd = order + order - T::one();
        values[n] = (odd * u * values[n - 1] - (order - T::one()) * values[n - 2]) / order;
    }
}
