//! A needle in a body that stiffens: Newton's method on the equations of [`Ritz`].
//!
//! Beside the linear body a reaction `k u (u/u0)^2` acts at every point of the needle, with k the mean line load per deflection of
//! a needle that moves as a whole: what the springs' law `K u (1 + (u/u0)^2)` adds, on a body.

use super::ritz::{Load, Ritz, Shape};
use super::table::{MODES, Matrix};
use crate::elements::Deformed;
use crate::quadrature::points;
use crate::{BeamProblem, ModelError};

/// Elements of the shape that is handed on.
const ELEMENTS: usize = 40;
const MAX_ITERATIONS: usize = 60;
/// A step of this share of the displacement is the last.
const LAST_STEP: f64 = 1e-9;
/// Panels of ten Gauss points below the surface.
const PANELS: usize = 3;

/// A needle in a body that stiffens.
#[derive(Debug)]
pub(crate) struct Stiffened {
    /// `None` if no body holds the needle.
    ritz: Option<Ritz>,
    problem: BeamProblem,
    /// `k / u0^2` times the weight, and the polynomials, at every Gauss point.
    points: Vec<(f64, [f64; MODES])>,
}

impl Stiffened {
    /// The needle of a problem with its law of stiffening.
    ///
    /// # Errors
    /// As [`Ritz::new`].
    pub fn new(problem: &BeamProblem) -> Result<Self, ModelError> {
        let ritz = Ritz::new(problem)?;
        let mut stiffened_points = Vec::new();
        if let Some(ritz) = &ritz {
            let [_, depth_m] = ritz.body_m();
            let rigid = std::array::from_fn(|i| if i == 0 { 1.0 } else { 0.0 });
            let [whole, ..] = ritz.tissue_forces(&rigid);
            let per_m2 = problem.law.inverse_u0_per_m.powi(2);
            for panel in 0..PANELS {
                let ends = [panel, panel + 1].map(|end| -1.0 + 2.0 * end as f64 / PANELS as f64);
                // The weights of (-1, 1) are halves of those over the depth.
                stiffened_points
                    .extend(points(ends[0], ends[1]).map(|(x, w)| (0.5 * w * whole * per_m2, legendre(x))));
            }
            debug_assert!(depth_m > 0.0);
        }
        Ok(Self { ritz, problem: problem.clone(), points: stiffened_points })
    }

    /// The needle while guide 2 is held at a displacement, with or without what stiffening adds.
    ///
    /// # Errors
    /// [`ModelError::NotConverged`], [`ModelError::Singular`].
    pub fn held(&self, displacement_m: f64, stiffens: bool) -> Result<Deformed, ModelError> {
        let Some(ritz) = &self.ritz else {
            let bare = self.problem.solve()?;
            return Ok(sampled(bare.length_m(), bare.force_n(displacement_m), |z_m| {
                let unit = bare.guide2_force();
                let force_n = bare.force_n(displacement_m);
                [force_n * unit.deflection_m(z_m), force_n * unit.slope(z_m)]
            }));
        };
        let linear = ritz.factor()?;
        let unit = ritz.shape(&linear, Load::Guide2);
        let mut force_n = displacement_m / ritz.work(Load::Guide2, &unit);
        let mut shape = unit.scaled(force_n);
        if stiffens {
            let mut converged = false;
            for _ in 0..MAX_ITERATIONS {
                let (tangent, internal) = self.stiffening(&ritz.coefficients(&shape));
                let solved = ritz.factor_with(&tangent)?;
                // (K + 3 k u^2) x = F e + 2 k u^3, with F such that guide 2 is where it is held.
                let unit = ritz.shape(&solved, Load::Guide2);
                let free = ritz.solve(&solved, ritz.on_coefficients(&internal.map(|force| 2.0 * force)));
                force_n = (displacement_m - ritz.work(Load::Guide2, &free)) / ritz.work(Load::Guide2, &unit);
                let next = free.plus(&unit.scaled(force_n));
                let step = ritz.distance(&next, &shape);
                shape = next;
                if step <= LAST_STEP * displacement_m.abs() {
                    converged = true;
                    break;
                }
            }
            if !converged {
                return Err(ModelError::NotConverged);
            }
        }
        Ok(self.deformed(ritz, &shape, force_n))
    }

    /// Tangent stiffness `3 k u^2` and forces `k u^3` against the coefficients.
    fn stiffening(&self, coefficients: &[f64; MODES]) -> (Matrix, [f64; MODES]) {
        let (mut tangent, mut forces) = ([[0.0; MODES]; MODES], [0.0; MODES]);
        for (weight, polynomials) in &self.points {
            let u: f64 = polynomials.iter().zip(coefficients).map(|(p, c)| p * c).sum();
            for (i, row) in tangent.iter_mut().enumerate() {
                let weighted = weight * u * u * polynomials[i];
                row.iter_mut().zip(polynomials).for_each(|(value, p)| *value += 3.0 * weighted * p);
                forces[i] += weighted * u;
            }
        }
        (tangent, forces)
    }

    fn deformed(&self, ritz: &Ritz, shape: &Shape, force_n: f64) -> Deformed {
        sampled(self.problem.entry_m + self.problem.depth_m, force_n, |z_m| ritz.at(shape, z_m))
    }
}

/// Deflection and slope at the nodes of equal elements.
fn sampled(length_m: f64, force_n: f64, at: impl Fn(f64) -> [f64; 2]) -> Deformed {
    let nodes_m: Vec<f64> = (0..=ELEMENTS).map(|i| length_m * i as f64 / ELEMENTS as f64).collect();
    let states = nodes_m.iter().map(|z_m| at(*z_m)).collect();
    Deformed::new(nodes_m, states, force_n)
}

/// Legendre polynomials at a place in (-1, 1).
fn legendre(x: f64) -> [f64; MODES] {
    let (mut previous, mut now) = (0.0, 1.0);
    std::array::from_fn(|n| {
        let value = now;
        let n = n as f64;
        now = ((2.0 * n + 1.0) * x * now - n * previous) / (n + 1.0);
        previous = value;
        value
    })
}
