//! Rayleigh-Ritz with the modes of a cantilever, the numerical method of Paper A (Lehmann et al.), (13)-(20).
//!
//! It converges slowly under a point load (theory, eq. 8): it is here to reproduce the paper. Compute with the
//! exact [`Beam`](super::Beam).

use super::quadrature::integrate;
use super::{BeamProblem, ModelError, check};
use nalgebra::{DMatrix, DVector};
use std::f64::consts::PI;

/// Most modes: beyond, the matrix is as ill-conditioned as it gets without more information.
const MAX_MODES: usize = 200;

/// A mode of a cantilever over `x` from 0 at the clamp to 1 at the tip, scaled to 1 there (Paper A, (14), corrected:
/// theory, eq. 7).
///
/// Written with decaying exponentials only: `cosh - sinh` of a high mode would cancel every digit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CantileverMode {
    beta: f64,
    gamma: f64,
    /// `(gamma - 1) (cos beta + cosh beta)`.
    excess: f64,
    scale: f64,
}

impl CantileverMode {
    /// Mode number `index`, from 1: a root of `cos b cosh b = -1`.
    pub fn new(index: usize) -> Self {
        let mut beta = PI * (index as f64 - 0.5);
        // Newton's method; the first root is 0.3 from its start, all others are closer.
        for _ in 0..8 {
            let sech = 1.0 / beta.cosh();
            beta -= (beta.cos() + sech) / (-beta.sin() - sech * beta.tanh());
        }
        let (sin, cos) = beta.sin_cos();
        let excess = sin - cos - (-beta).exp();
        let gamma = 1.0 + excess / (cos + beta.cosh());
        let mode = Self { beta, gamma, excess, scale: 1.0 };
        Self { scale: 1.0 / mode.value(1.0), ..mode }
    }

    /// `b`.
    pub fn beta(&self) -> f64 {
        self.beta
    }

    /// `gamma` of Paper A, (14).
    pub fn gamma(&self) -> f64 {
        self.gamma
    }

    /// `q(x)`.
    pub fn value(&self, x: f64) -> f64 {
        let (sin, cos) = (self.beta * x).sin_cos();
        self.scale * (sin - self.gamma * cos + self.hyperbolic(x))
    }

    /// `q''(x)`, derivatives with respect to x.
    pub fn second_derivative(&self, x: f64) -> f64 {
        let (sin, cos) = (self.beta * x).sin_cos();
        self.scale * self.beta.powi(2) * (self.gamma * cos - sin + self.hyperbolic(x))
    }

    /// `gamma cosh bx - sinh bx`.
    fn hyperbolic(&self, x: f64) -> f64 {
        let b = self.beta;
        let numerator = (b * (x - 1.0)).exp() + (-b * (x + 1.0)).exp();
        let denominator = 1.0 + (-2.0 * b).exp() + 2.0 * b.cos() * (-b).exp();
        (-b * x).exp() + self.excess * numerator / denominator
    }
}

/// The needle under 1 N at guide 2, as a sum of cantilever modes.
#[derive(Debug, Clone)]
pub struct RayleighRitz {
    length_m: f64,
    modes: Vec<(CantileverMode, f64)>,
}

impl RayleighRitz {
    /// Minimises the energy over `count` modes: `Phi g = w` with `Phi_ij = EI int q_i'' q_j'' + int K q_i q_j`.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] for a number of modes that is 0 or too large, or a clamp that is not rigid (no sum of
    /// cantilever modes turns at the clamp); [`ModelError::Singular`].
    pub fn solve(problem: &BeamProblem, count: usize) -> Result<Self, ModelError> {
        let (length_m, modes, matrix) = energy(problem, count)?;
        let load = modes.iter().map(|mode| mode.value(problem.guide2_m / length_m));
        let load = DVector::from_iterator(count, load);
        let solution = matrix.cholesky().ok_or(ModelError::Singular)?.solve(&load);
        Ok(Self { length_m, modes: modes.into_iter().zip(solution.iter().copied()).collect() })
    }

    /// Deflection, in m per N.
    pub fn deflection_m(&self, z_m: f64) -> f64 {
        self.modes.iter().map(|(mode, amount)| amount * mode.value(z_m / self.length_m)).sum()
    }
}

/// Length of the beam, its modes, and the matrix `Phi` of their energy.
fn energy(
    problem: &BeamProblem,
    count: usize,
) -> Result<(f64, Vec<CantileverMode>, DMatrix<f64>), ModelError> {
    check("modes", count as f64, "1 to 200", (1..=MAX_MODES).contains(&count))?;
    let compliance = problem.clamp_compliance_rad_per_n_m;
    check("clamp_compliance_rad_per_n_m", compliance, "0", compliance == 0.0)?;
    let length_m = problem.entry_m + problem.depth_m;
    let modes: Vec<CantileverMode> = (1..=count).map(CantileverMode::new).collect();
    let bending = problem.bending_stiffness_n_m2 / (4.0 * length_m.powi(3));
    let panel_m = length_m * PI / modes.last().map_or(PI, CantileverMode::beta);
    let mut top_m = problem.entry_m;
    let mut matrix = DMatrix::from_diagonal(&DVector::from_iterator(
        count,
        modes.iter().map(|mode| bending * mode.beta.powi(4)),
    ));
    for (thickness_m, modulus_pa) in problem.foundation.parts(problem.depth_m) {
        for i in 0..count {
            for j in 0..=i {
                let overlap_m = integrate(top_m, top_m + thickness_m, panel_m, |z_m| {
                    modes[i].value(z_m / length_m) * modes[j].value(z_m / length_m)
                });
                matrix[(i, j)] += modulus_pa * overlap_m;
                matrix[(j, i)] = matrix[(i, j)];
            }
        }
        top_m += thickness_m;
    }
    Ok((length_m, modes, matrix))
}

/// Tip load at which the needle's tip is at the end of the cut path, N: the bordered system of Paper A, (20), corrected
/// (theory, eq. 9), with `count` modes. `path_m`: the cut path against position along the needle. For comparison:
/// [`GrowingBeam::load_of_path_n`](super::growth::GrowingBeam::load_of_path_n) solves it exactly.
///
/// # Errors
/// As [`RayleighRitz::solve`].
pub fn bordered_tip_load_n(
    problem: &BeamProblem,
    count: usize,
    path_m: impl Fn(f64) -> f64,
) -> Result<f64, ModelError> {
    let (length_m, modes, matrix) = energy(problem, count)?;
    let panel_m = length_m * PI / modes.last().map_or(PI, CantileverMode::beta);
    let of_path = |mode: &CantileverMode| -> f64 {
        let mut top_m = problem.entry_m;
        let mut sum = 0.0;
        for (thickness_m, modulus_pa) in problem.foundation.parts(problem.depth_m) {
            let pull = |z_m: f64| path_m(z_m) * mode.value(z_m / length_m);
            sum += modulus_pa * integrate(top_m, top_m + thickness_m, panel_m, pull);
            top_m += thickness_m;
        }
        sum
    };
    let springs = DVector::from_iterator(count, modes.iter().map(of_path));
    let factor = matrix.cholesky().ok_or(ModelError::Singular)?;
    // Every mode is 1 at the tip: 1^T Phi^-1 (w + F 1) = u_t(L).
    let unit_vector = DVector::from_element(count, 1.0);
    let tip_m = path_m(length_m);
    Ok((tip_m - factor.solve(&springs).sum()) / factor.solve(&unit_vector).sum())
}

#[cfg(test)]
#[path = "modes_tests.rs"]
mod tests;
