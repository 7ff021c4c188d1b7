//! The needle as a beam on an elastic foundation, solved exactly (theory, eq. 1 to 5).
//!
//! `EI u'''' + ((P - G) u')' + K(z) u = F delta(z - c2) - k u delta(z - c)`, clamped at guide 1 (`u = 0`, and `u' = 0` or
//! `u' = compliance EI u''`; where guide 2 is the only guide it is at 0, and its force there stands for `u = 0`), free at the tip
//! (`u'' = 0`, `EI u''' + (P - G) u' = -F_t`); see Paper A (Lehmann et al.), section II, for the problem. P: axial load over the whole
//! needle; G: shear layer of the tissue; k: spring at the surface. Springs may hold the rotation at guide 2 and the deflection of the tip, too.
//!
//! Within a piece of constant K the solution is an entire function, summed as a power series ([`series`]). Pieces are kept shorter than
//! the characteristic length `(4 EI/K)^(1/4)`, where the series converges to the last digit within 24 terms without cancellation, for any K
//! from zero upwards. Continuity and boundary conditions are solved from the tip to guide 1 and back ([`sweep`]). A layer is a few
//! more pieces.

mod in_body;
mod sweep;

use super::series::{self, Equation, Series};
use super::{BeamProblem, Foundation, ModelError, Rig, check};
use sweep::{Beyond, LOADS, Link};

/// The loads.
const GUIDE2: usize = 0;
const TIP: usize = 1;
/// More pieces than this mean a modulus that no needle bends in.
const MAX_PIECES: f64 = 2000.0;

/// The needle's response to unit forces at guide 2 and at the tip.
#[derive(Debug, Clone)]
pub struct Beam {
    bending_stiffness_n_m2: f64,
    length_m: f64,
    spans: Vec<Span>,
    guide2_m_per_n: f64,
    /// Twice the energy of an elastic body under 1 N at guide 2; 0 where the tissue is made of springs.
    body_m_per_n: f64,
}

impl BeamProblem {
    /// Solves for unit forces at guide 2 and at the tip.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] where a length, stiffness or compliance is out of range.
    pub fn solve(&self) -> Result<Beam, ModelError> {
        if self.support.is_body() {
            return self.solve_in_body();
        }
        let mut pieces = self.pieces()?;
        let stiffness = self.bending_stiffness_n_m2;
        let force = 1.0 / stiffness;

        let mut section_load = Beyond::default();
        section_load.add(self.tip_support_n_per_m * force, TIP, force);
        let mut last = true;
        for piece in pieces.iter_mut().rev() {
            if piece.ends_at_guide2 {
                section_load.add(0.0, GUIDE2, force);
                section_load.resist_turning(self.guide2_turn_n_m_per_rad * force);
            }
            if piece.ends_at_entry && !last {
                section_load.add(self.skin_n_per_m * force, GUIDE2, 0.0);
            }
            last = false;
            let linked = Link::new(piece.equation, piece.fundamental, piece.length_m, section_load);
            (piece.link, section_load) = linked.ok_or(ModelError::Singular)?;
        }

        let compliance = self.clamp_compliance_rad_per_n_m * stiffness;
        let (mut deflection_m, mut slope) = if self.only_guide {
            section_load.add(0.0, GUIDE2, force);
            section_load.resist_turning(self.guide2_turn_n_m_per_rad * force);
            section_load.free(compliance)
        } else {
            ([0.0; LOADS], section_load.slope(compliance))
        };
        let mut spans = Vec::with_capacity(pieces.len());
        spans.resize_with(pieces.len(), Span::default);
        for (piece, span) in pieces.iter().zip(&mut spans) {
            let inverse_length_per_m = 1.0 / piece.length_m;
            (span.start_m, span.per_m) = (piece.start_m, inverse_length_per_m);
            let start = [deflection_m, slope.map(|slope| slope * piece.length_m)];
            let (states, [end_m, end_rotation_m]) = piece.link.hand_on(piece.equation, start);
            for (state, series) in states.into_iter().zip(&mut span.series) {
                piece.equation.expand(state, series);
            }
            (deflection_m, slope) =
                (end_m, end_rotation_m.map(|end_rotation_m| end_rotation_m * inverse_length_per_m));
        }
        let mut beam = Beam {
            bending_stiffness_n_m2: stiffness,
            length_m: self.entry_m + self.depth_m,
            spans,
            guide2_m_per_n: 0.0,
            body_m_per_n: 0.0,
        };
        beam.guide2_m_per_n = beam.guide2_force().deflection_m(self.guide2_m);
        beam.checked()
    }

    /// The needle cut into pieces of constant foundation modulus, none longer than the characteristic length.
    fn pieces(&self) -> Result<Vec<Piece>, ModelError> {
        self.check()?;
        let per_stiffness = 1.0 / self.bending_stiffness_n_m2;
        let (free_axial_n, tissue_axial_n) = (self.axial_load_n, self.axial_load_n - self.shear_n);
        let mut pieces: Vec<Piece> = Vec::new();
        let mut start_m = 0.0;
        let free_pieces =
            [(self.guide2_m, 0.0, free_axial_n), (self.entry_m - self.guide2_m, 0.0, free_axial_n)];
        let foundation_parts = self.foundation.parts(self.depth_m);
        let tissue_pieces =
            foundation_parts.map(|(thickness_m, modulus_pa)| (thickness_m, modulus_pa, tissue_axial_n));
        for (number, (thickness_m, modulus_pa, axial_n)) in
            free_pieces.into_iter().chain(tissue_pieces).enumerate()
        {
            if thickness_m > 0.0 {
                let (modulus, axial) = (modulus_pa * per_stiffness, axial_n * per_stiffness);
                let root = modulus.sqrt();
                let reach = thickness_m * (0.5 * root).max(axial.abs()).sqrt();
                let count = if reach <= 1.0 { 1.0 } else { reach.ceil() };
                check("modulus_pa", modulus_pa, "a modulus that lets the needle bend", count <= MAX_PIECES)?;
                let length_m = if count == 1.0 { thickness_m } else { thickness_m / count };
                let square = length_m * length_m;
                let root = (axial.abs() + root) * square;
                let equation = Equation::new(modulus * square * square, axial * square, root);
                let piece = Piece {
                    start_m,
                    length_m,
                    equation,
                    fundamental: equation.fundamental(),
                    ends_at_guide2: false,
                    ends_at_entry: false,
                    link: Link::default(),
                };
                pieces.extend(
                    (0..count as usize)
                        .map(|i| Piece { start_m: start_m + i as f64 * length_m, ..piece.clone() }),
                );
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

    /// Refuses a needle that yields no stiffness.
    fn checked(self) -> Result<Self, ModelError> {
        let positive = self.guide2_m_per_n.is_finite() && self.guide2_m_per_n > 0.0;
        if positive { Ok(self) } else { Err(ModelError::Singular) }
    }

    /// Twice the energy of an elastic body while guide 2 is held at 1 m, N/m.
    pub(super) fn body_n_per_m(&self) -> f64 {
        self.body_m_per_n * self.lateral_stiffness_n_per_m().powi(2)
    }

    /// Response to 1 N at guide 2.
    pub fn guide2_force(&self) -> Response<'_> {
        Response { beam: self, load: GUIDE2 }
    }

    /// Response to 1 N at the tip, guide 2 free.
    pub fn tip_force(&self) -> Response<'_> {
        Response { beam: self, load: TIP }
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

    /// Deflections at many places while guide 2 is held at `displacement_m`.
    pub fn deflections_m(&self, displacement_m: f64, z_m: &[f64]) -> Vec<f64> {
        let force_n = self.force_n(displacement_m);
        let mut deflections_m = self.guide2_force().deflections_m(z_m);
        deflections_m.iter_mut().for_each(|at_m| *at_m *= force_n);
        deflections_m
    }
}

/// The needle under one unit force: deflection, slope, moment and shear at any `z`.
///
/// Before guide 1 and beyond the tip the needle's tangent continues.
#[derive(Debug, Clone, Copy)]
pub struct Response<'a> {
    beam: &'a Beam,
    /// [`GUIDE2`] or [`TIP`].
    load: usize,
}

impl<'a> Response<'a> {
    /// Deflection `u`, in m per N.
    #[inline]
    pub fn deflection_m(&self, z_m: f64) -> f64 {
        let clamped_m = z_m.clamp(0.0, self.beam.length_m);
        let Some((span, x)) = self.place(clamped_m) else { return f64::NAN };
        let deflection_m = series::value(&span.series[self.load], x);
        let straight_m = z_m - clamped_m;
        if straight_m == 0.0 { deflection_m } else { deflection_m + straight_m * self.slope(clamped_m) }
    }

    /// Deflections at many places, in m per N; as [`Response::deflection_m`] at each, but faster where neighbours lie in one layer.
    pub fn deflections_m(&self, z_m: &[f64]) -> Vec<f64> {
        let mut deflections_m = Vec::with_capacity(z_m.len());
        deflections_m.resize(z_m.len(), 0.0);
        let (mut remaining_m, mut output_m) = (z_m, deflections_m.as_mut_slice());
        while let Some(first_m) = remaining_m.first() {
            let (count, span) = self.stretch(remaining_m);
            let (group_m, later_m) = remaining_m.split_at(count.max(1));
            let (group_output_m, later_at_m) = output_m.split_at_mut(group_m.len());
            match span {
                Some(span) if count > 0 => {
                    series::values(
                        &span.series[self.load],
                        span.start_m,
                        span.per_m,
                        group_m,
                        group_output_m,
                    );
                }
                _ => group_output_m.fill(self.deflection_m(*first_m)),
            }
            (remaining_m, output_m) = (later_m, later_at_m);
        }
        deflections_m
    }

    /// Number of these positions, from the first one on, that lie within the needle and in one span, and
    /// that span.
    fn stretch(&self, z_m: &[f64]) -> (usize, Option<&'a Span>) {
        let spans = &self.beam.spans;
        let Some(number) = z_m.first().and_then(|first_m| self.number(*first_m)) else { return (0, None) };
        let start_m = spans.get(number).map_or(0.0, |span| span.start_m);
        let is_within_span = |z_m: &&f64| match spans.get(number + 1) {
            Some(next) => (start_m..next.start_m).contains(*z_m),
            None => (start_m..=self.beam.length_m).contains(*z_m),
        };
        (z_m.iter().take_while(is_within_span).count(), spans.get(number))
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
        let Some((span, x)) = self.place(z_m) else { return f64::NAN };
        series::derivative(&span.series[self.load], order, x) * span.per_m.powi(order as i32)
    }

    /// The span in which a place is, and where in it.
    #[inline]
    fn place(&self, z_m: f64) -> Option<(&'a Span, f64)> {
        let span = self.beam.spans.get(self.number(z_m)?)?;
        Some((span, (z_m - span.start_m) * span.per_m))
    }

    /// Number of the span in which a place is; the first or last one beyond the ends.
    #[inline]
    fn number(&self, z_m: f64) -> Option<usize> {
        let spans = &self.beam.spans;
        // In uniform tissue that is not deep it is the last one that is needed.
        match spans.last() {
            Some(last) if last.start_m <= z_m => Some(spans.len() - 1),
            _ => self.search(z_m),
        }
    }

    #[inline(never)]
    fn search(&self, z_m: f64) -> Option<usize> {
        let spans = &self.beam.spans;
        let next_span = spans.partition_point(|span| span.start_m <= z_m);
        (!spans.is_empty()).then(|| next_span.saturating_sub(1))
    }
}

/// A stretch of constant foundation modulus, while it is being solved.
#[derive(Clone)]
struct Piece {
    start_m: f64,
    length_m: f64,
    equation: Equation,
    /// Coefficients of the equation's fundamental solution.
    fundamental: [f64; 4],
    ends_at_guide2: bool,
    ends_at_entry: bool,
    link: Link,
}

/// A stretch of constant foundation modulus, solved.
#[derive(Debug, Clone, Default)]
struct Span {
    start_m: f64,
    /// 1 over its length.
    per_m: f64,
    /// Deflection per load in `(z - start) / length`.
    series: [Series; LOADS],
}

#[cfg(test)]
#[path = "beam_tests.rs"]
mod tests;
