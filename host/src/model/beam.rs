//! The needle as a beam on an elastic foundation, solved exactly.
//!
//! `EI u'''' + ((P - G) u')' + K(z) u = F delta(z - c2) - k u delta(z - c)`, clamped at guide 1 (`u = 0`, and `u' = 0` or
//! `u' = compliance EI u''`), free at the tip (`u'' = 0`, `EI u''' + (P - G) u' = -F_t`); see Paper A (Lehmann et al.), section
//! II, for the problem. P: axial load over the whole needle; G: shear layer of the tissue; k: spring at the surface.
//!
//! Within a piece of constant K the solution is the entire function `sum b_n x^n` with
//! `b_(n+4) = -((K/EI) b_n + ((P - G)/EI) (n+1)(n+2) b_(n+2)) / ((n+1)(n+2)(n+3)(n+4))`. Pieces are kept shorter than the characteristic length
//! `(4 EI/K)^(1/4)`, where the series converges to the last digit within 24 terms without cancellation, for any K from
//! zero upwards. The unknowns are value and three derivatives at the start of every piece; continuity and boundary
//! conditions give a banded system, solved with partial pivoting. A layer is a few more pieces.

mod system;

use super::{Foundation, ModelError, Rig, check};
use system::Banded;

/// Terms of the series; the last ones are below 1e-15 of the first for pieces up to the characteristic length.
const TERMS: usize = 24;
/// More pieces than this mean a modulus that no needle bends in.
const MAX_PIECES: f64 = 2000.0;

/// What is solved: geometry, stiffness and supports of the needle in the tissue.
#[derive(Debug, Clone, PartialEq)]
pub struct BeamProblem {
    /// Bending stiffness of the needle.
    pub bending_stiffness_n_m2: f64,
    /// Position of guide 2, where the lateral force acts.
    pub guide2_m: f64,
    /// Position of the tissue surface.
    pub entry_m: f64,
    /// Length of the needle inside the tissue.
    pub depth_m: f64,
    /// Rotation of the needle in guide 1 per moment; 0 is a perfect clamp.
    pub clamp_compliance_rad_per_n_m: f64,
    /// Compressive axial load of the needle, P: energy `-P/2 int_0^L u'^2`.
    pub axial_load_n: f64,
    /// Shear layer of the tissue, G (Pasternak): energy `G/2 int_c^L u'^2`.
    pub shear_n: f64,
    /// Spring at the surface, k.
    pub skin_n_per_m: f64,
    /// The tissue.
    pub foundation: Foundation,
    /// What the tissue does beyond a linear spring; [`BeamProblem::solve`] leaves it out.
    pub law: TissueLaw,
}

/// How the tissue departs from a linear spring.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TissueLaw {
    /// Stiffening, `1/u0`: the reaction is `K u (1 + (u/u0)^2)`.
    pub inverse_u0_per_m: f64,
    /// Share of K that relaxes while the needle is held: a standard linear solid.
    pub relaxing_share: f64,
    /// Time in which it relaxes.
    pub relaxation_s: f64,
}

/// The needle's response to unit forces at guide 2 and at the tip.
#[derive(Debug, Clone)]
pub struct Beam {
    bending_stiffness_n_m2: f64,
    length_m: f64,
    /// Where each piece starts.
    starts_m: Vec<f64>,
    /// Series of each piece in `(z - start) / length_m`, for 1 N at guide 2 and 1 N at the tip.
    series: Vec<[[f64; TERMS]; 2]>,
    guide2_m_per_n: f64,
}

impl BeamProblem {
    /// The needle of `rig`, inserted to `depth_m`, perfectly clamped in guide 1.
    pub fn new(rig: &Rig, foundation: Foundation, depth_m: f64) -> Self {
        Self {
            bending_stiffness_n_m2: rig.needle.bending_stiffness_n_m2(),
            guide2_m: rig.guide2_m,
            entry_m: rig.entry_m,
            depth_m,
            clamp_compliance_rad_per_n_m: 0.0,
            axial_load_n: 0.0,
            shear_n: 0.0,
            skin_n_per_m: 0.0,
            foundation,
            law: TissueLaw::default(),
        }
    }

    /// Solves for unit forces at guide 2 and at the tip.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] where a length, stiffness or compliance is out of range.
    pub fn solve(&self) -> Result<Beam, ModelError> {
        let pieces = self.pieces()?;
        let length_m = self.entry_m + self.depth_m;
        let stiffness = self.bending_stiffness_n_m2;
        let cubed = length_m.powi(3) / stiffness;

        let n = pieces.len();
        let mut system = Banded::new(4 * n);
        system.set(0, 0, 1.0);
        system.set(1, 1, -1.0);
        system.set(1, 2, self.clamp_compliance_rad_per_n_m * stiffness / length_m);
        for (i, piece) in pieces.iter().enumerate() {
            let scaled = piece.scaled(length_m, stiffness);
            let reach = piece.length_m / length_m;
            let last = i + 1 == n;
            let ends = derivatives(&expand(UNIT, scaled), reach);
            for order in if last { 2..4 } else { 0..4 } {
                let row = 4 * i + if last { order } else { order + 2 };
                for (column, (value, slope)) in ends[order].into_iter().zip(ends[1]).enumerate() {
                    let pulled = if order == 3 { value + scaled.axial * slope } else { value };
                    system.set(row, 4 * i + column, pulled);
                }
            }
            if let Some(next) = pieces.get(i + 1) {
                for order in 0..4 {
                    system.set(4 * i + 2 + order, 4 * (i + 1) + order, -1.0);
                }
                system.set(4 * i + 5, 4 * (i + 1) + 1, -next.scaled(length_m, stiffness).axial);
                if piece.ends_at_entry {
                    system.set(4 * i + 5, 4 * (i + 1), -self.skin_n_per_m * cubed);
                }
                if piece.ends_at_guide2 {
                    system.right[4 * i + 5][0] = -cubed;
                }
            } else if piece.ends_at_guide2 {
                system.right[4 * i + 3][0] = -cubed;
            }
        }
        system.right[4 * n - 1][1] = -cubed;
        let states = system.solve().ok_or(ModelError::Singular)?;

        let series = pieces.iter().zip(states.as_chunks().0).map(|(piece, state)| {
            let both = expand(*state, piece.scaled(length_m, stiffness));
            [both.map(|of| of[0]), both.map(|of| of[1])]
        });
        let mut beam = Beam {
            bending_stiffness_n_m2: stiffness,
            length_m,
            starts_m: pieces.iter().map(|piece| piece.start_m).collect(),
            series: series.collect(),
            guide2_m_per_n: 0.0,
        };
        beam.guide2_m_per_n = beam.guide2_force().deflection_m(self.guide2_m);
        let positive = beam.guide2_m_per_n.is_finite() && beam.guide2_m_per_n > 0.0;
        if positive { Ok(beam) } else { Err(ModelError::Singular) }
    }

    /// Refuses what no needle can be.
    pub(super) fn check(&self) -> Result<(), ModelError> {
        let stiffness = self.bending_stiffness_n_m2;
        let compliance = self.clamp_compliance_rad_per_n_m;
        check("bending_stiffness_n_m2", stiffness, "more than 0", stiffness > 0.0)?;
        check("guide2_m", self.guide2_m, "more than 0", self.guide2_m > 0.0)?;
        check("entry_m", self.entry_m, "guide2_m or more", self.entry_m >= self.guide2_m)?;
        check("depth_m", self.depth_m, "0 or more", self.depth_m >= 0.0)?;
        check("clamp_compliance_rad_per_n_m", compliance, "0 or more", compliance >= 0.0)?;
        check("axial_load_n", self.axial_load_n, "a finite number", true)?;
        check("shear_n", self.shear_n, "0 or more", self.shear_n >= 0.0)?;
        check("skin_n_per_m", self.skin_n_per_m, "0 or more", self.skin_n_per_m >= 0.0)
    }

    /// The needle cut into pieces of constant foundation modulus, none longer than the characteristic length.
    fn pieces(&self) -> Result<Vec<Piece>, ModelError> {
        self.check()?;
        let stiffness = self.bending_stiffness_n_m2;
        let (outside_n, inside_n) = (self.axial_load_n, self.axial_load_n - self.shear_n);
        let mut pieces: Vec<Piece> = Vec::new();
        let mut start_m = 0.0;
        let outside = [(self.guide2_m, 0.0, outside_n), (self.entry_m - self.guide2_m, 0.0, outside_n)];
        let inside = self.foundation.parts(self.depth_m);
        let inside = inside.map(|(thickness_m, modulus_pa)| (thickness_m, modulus_pa, inside_n));
        for (number, (thickness_m, modulus_pa, axial_n)) in outside.into_iter().chain(inside).enumerate() {
            if thickness_m > 0.0 {
                let bends =
                    (modulus_pa / (4.0 * stiffness)).powf(0.25).max((axial_n.abs() / stiffness).sqrt());
                let count = (thickness_m * bends).ceil().max(1.0);
                check("modulus_pa", modulus_pa, "a modulus that lets the needle bend", count <= MAX_PIECES)?;
                let length_m = thickness_m / count;
                for i in 0..count as usize {
                    let start_m = start_m + i as f64 * length_m;
                    let (ends_at_guide2, ends_at_entry) = (false, false);
                    pieces.push(Piece {
                        start_m,
                        length_m,
                        modulus_pa,
                        axial_n,
                        ends_at_guide2,
                        ends_at_entry,
                    });
                }
                start_m += thickness_m;
            }
            if let Some(piece) = pieces.last_mut() {
                piece.ends_at_guide2 |= number == 0;
                piece.ends_at_entry |= number == 1;
            }
        }
        Ok(pieces)
    }
}

impl Beam {
    /// Solves the needle of `rig` in `foundation` at `depth_m`; short for [`BeamProblem::new`] and
    /// [`BeamProblem::solve`].
    ///
    /// # Errors
    /// As [`BeamProblem::solve`].
    pub fn solve(rig: &Rig, foundation: &Foundation, depth_m: f64) -> Result<Self, ModelError> {
        BeamProblem::new(rig, foundation.clone(), depth_m).solve()
    }

    /// Response to 1 N at guide 2.
    pub fn guide2_force(&self) -> Response<'_> {
        Response { beam: self, load: 0 }
    }

    /// Response to 1 N at the tip, guide 2 free.
    pub fn tip_force(&self) -> Response<'_> {
        Response { beam: self, load: 1 }
    }

    /// Length of the beam from guide 1 to the tip.
    pub fn length_m(&self) -> f64 {
        self.length_m
    }

    /// Lateral stiffness at guide 2: force per displacement.
    pub fn lateral_stiffness_n_per_m(&self) -> f64 {
        1.0 / self.guide2_m_per_n
    }

    /// Force of guide 2 that holds it at `displacement_m`.
    pub fn force_n(&self, displacement_m: f64) -> f64 {
        displacement_m / self.guide2_m_per_n
    }

    /// Deflection at `z_m` while guide 2 is held at `displacement_m`.
    pub fn deflection_m(&self, displacement_m: f64, z_m: f64) -> f64 {
        self.force_n(displacement_m) * self.guide2_force().deflection_m(z_m)
    }
}

/// The needle under one unit force: deflection, slope, moment and shear at any `z`.
///
/// Before guide 1 and beyond the tip the needle's tangent continues.
#[derive(Debug, Clone, Copy)]
pub struct Response<'a> {
    beam: &'a Beam,
    /// 0: at guide 2, 1: at the tip.
    load: usize,
}

impl Response<'_> {
    /// Deflection `u`, in m per N.
    pub fn deflection_m(&self, z_m: f64) -> f64 {
        let inside_m = z_m.clamp(0.0, self.beam.length_m);
        let straight_m = z_m - inside_m;
        self.derivative(inside_m, 0) + if straight_m == 0.0 { 0.0 } else { straight_m * self.slope(inside_m) }
    }

    /// Slope `u'`, in 1 per N.
    pub fn slope(&self, z_m: f64) -> f64 {
        self.derivative(z_m.clamp(0.0, self.beam.length_m), 1)
    }

    /// Bending moment `EI u''`, in N m per N.
    pub fn moment_n_m(&self, z_m: f64) -> f64 {
        self.beam.bending_stiffness_n_m2 * self.derivative(z_m, 2)
    }

    /// `EI u'''`, in N per N: the derivative of the moment, without what an axial load adds to the shear. It jumps by the force at guide 2, where this is the value
    /// beyond the guide.
    pub fn shear_n(&self, z_m: f64) -> f64 {
        self.beam.bending_stiffness_n_m2 * self.derivative(z_m, 3)
    }

    fn derivative(&self, z_m: f64, order: usize) -> f64 {
        let beam = self.beam;
        let piece = beam.starts_m.partition_point(|start_m| *start_m <= z_m).saturating_sub(1);
        let (Some(start_m), Some(series)) = (beam.starts_m.get(piece), beam.series.get(piece)) else {
            return f64::NAN;
        };
        derivative(&series[self.load], order, (z_m - start_m) / beam.length_m)
            / beam.length_m.powi(order as i32)
    }
}

/// A stretch of constant foundation modulus.
struct Piece {
    start_m: f64,
    length_m: f64,
    modulus_pa: f64,
    /// P - G.
    axial_n: f64,
    ends_at_guide2: bool,
    ends_at_entry: bool,
}

/// `K length^4 / EI` and `(P - G) length^2 / EI`.
#[derive(Clone, Copy)]
struct Scaled {
    modulus: f64,
    axial: f64,
}

impl Piece {
    fn scaled(&self, length_m: f64, stiffness_n_m2: f64) -> Scaled {
        Scaled {
            modulus: self.modulus_pa * length_m.powi(4) / stiffness_n_m2,
            axial: self.axial_n * length_m * length_m / stiffness_n_m2,
        }
    }
}

/// Value and derivatives at the start of four solutions: one of them is 1 in each.
const UNIT: [[f64; 4]; 4] =
    [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];

/// Coefficients of `C` solutions, side by side, that start with the given values and derivatives: chains of operations that do not
/// wait for one another.
fn expand<const C: usize>(start: [[f64; C]; 4], scaled: Scaled) -> [[f64; C]; TERMS] {
    let mut series = [[0.0; C]; TERMS];
    for ((first, start), factorial) in series.iter_mut().zip(start).zip([1.0, 1.0, 2.0, 6.0]) {
        *first = start.map(|value| value / factorial);
    }
    for n in 0..TERMS - 4 {
        series[n + 4] = std::array::from_fn(|c| {
            let bent = scaled.axial * FALLING[2][n + 2] * series[n + 2][c];
            -(scaled.modulus * series[n][c] + bent) / FALLING[4][n + 4]
        });
    }
    series
}

/// `n! / (n - order)!`: what the derivative of an order makes of `x^n`.
const FALLING: [[f64; TERMS]; 5] = {
    let mut factors = [[0.0; TERMS]; 5];
    let mut order = 0;
    while order < 5 {
        let mut n = order;
        while n < TERMS {
            let mut factor = 1.0;
            let mut k = n + 1 - order;
            while k <= n {
                factor *= k as f64;
                k += 1;
            }
            factors[order][n] = factor;
            n += 1;
        }
        order += 1;
    }
    factors
};

/// Derivative of the series at `x`, by Horner's rule; the value itself in four sums of every fourth term, which do not wait for one
/// another.
fn derivative(series: &[f64; TERMS], order: usize, x: f64) -> f64 {
    if order == 0 {
        let square = x * x;
        let fourth = square * square;
        let [a, b, c, d] = series
            .as_chunks()
            .0
            .iter()
            .rev()
            .fold([0.0; 4], |sums, of: &[f64; 4]| std::array::from_fn(|i| sums[i] * fourth + of[i]));
        return (a + x * b) + square * (c + x * d);
    }
    let factors = &FALLING[order];
    let terms = series.iter().zip(factors).skip(order).rev();
    terms.fold(0.0, |sum, (coefficient, factor)| sum * x + factor * coefficient)
}

/// Value and three derivatives at `x` of `C` series.
fn derivatives<const C: usize>(series: &[[f64; C]; TERMS], x: f64) -> [[f64; C]; 4] {
    let mut sums = [[0.0; C]; 4];
    for (n, coefficients) in series.iter().enumerate().rev() {
        for (order, sum) in sums.iter_mut().enumerate().take(n + 1) {
            let factor = FALLING[order][n];
            for (sum, coefficient) in sum.iter_mut().zip(coefficients) {
                *sum = *sum * x + factor * coefficient;
            }
        }
    }
    sums
}

#[cfg(test)]
#[path = "beam_tests.rs"]
mod tests;
