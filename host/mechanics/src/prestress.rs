//! Prestress: forces and shape before guide 2 moves, of a needle that is not straight when it is free of stress.
//!
//! A needle of stress-free curvature is inserted along the path it takes between the guides, so that the tissue is unstressed on
//! it; guide 2 at zero holds it. `EI (u'' - kappa) = F (c2 - z)` before guide 2 and 0 beyond it, `u(0) = 0`,
//! `u'(0) = compliance EI (u''(0) - kappa)`, `u(c2) = 0`: with a perfect clamp `F = -3 EI kappa / (2 c2)` is the force of guide 2 on
//! the needle.
//!
//! A force on the tip bends the needle in the tissue while guide 2 holds it at zero: by superposition of the responses to unit forces at the
//! tip, `w`, and at guide 2, `g`, with `F w(c2) + R g(c2) = 0`, where R is the force of guide 2.

use super::terms::Conditions;
use super::{Beam, BeamProblem, Model, ModelError};

/// Prestress in both planes.
#[derive(Debug, Clone)]
pub(super) struct Prestress([Plane; 2]);

#[derive(Debug, Clone, Default)]
struct Plane {
    curved: Curved,
    pushed: Option<Pushed>,
}

/// A needle with a force on its tip.
#[derive(Debug, Clone)]
struct Pushed {
    beam: Beam,
    tip_n: f64,
    guide2_n: f64,
}

/// A needle with stress-free curvature.
#[derive(Debug, Clone, Copy, Default)]
struct Curved {
    curvature_per_m: f64,
    stiffness_n_m2: f64,
    guide2_m: f64,
    clamp_rad_per_n_m: f64,
    force_n: f64,
}

impl Prestress {
    /// As the effects of a model make it.
    ///
    /// # Errors
    /// As [`BeamProblem::solve`].
    pub fn of(
        model: &Model,
        problems: [&BeamProblem; 2],
        conditions: &Conditions,
    ) -> Result<Self, ModelError> {
        let (mut curvature_per_m, mut tip_n) = ([0.0; 2], [0.0; 2]);
        for (effect, values) in &model.effects {
            effect.stress_free_curvature(values, &mut curvature_per_m);
            effect.tip_push(values, conditions, &mut tip_n);
        }
        let plane = |plane: usize| -> Result<Plane, ModelError> {
            Ok(Plane {
                curved: Curved::new(curvature_per_m[plane], problems[plane]),
                pushed: Pushed::new(tip_n[plane], problems[plane])?,
            })
        };
        Ok(Self([plane(0)?, plane(1)?]))
    }

    /// Force of guide 2 on the needle.
    pub fn force_n(&self, plane: usize) -> f64 {
        let Plane { curved, pushed } = &self.0[plane];
        curved.force_n + pushed.as_ref().map_or(0.0, |pushed| pushed.guide2_n)
    }

    /// Puts the deflections at these places behind others.
    pub fn add_deflections_m(&self, plane: usize, z_m: &[f64], to_m: &mut Vec<f64>) {
        let Plane { curved, pushed } = &self.0[plane];
        let first = to_m.len();
        if curved.curvature_per_m == 0.0 {
            to_m.resize(first + z_m.len(), 0.0);
        } else {
            to_m.extend(z_m.iter().map(|z_m| curved.deflection_m(*z_m)));
        }
        if let Some(pushed) = pushed {
            to_m[first..].iter_mut().zip(pushed.deflections_m(z_m)).for_each(|(sum, more)| *sum += more);
        }
    }
}

impl Pushed {
    /// Nothing where nothing pushes.
    fn new(tip_n: f64, problem: &BeamProblem) -> Result<Option<Self>, ModelError> {
        if tip_n == 0.0 {
            return Ok(None);
        }
        let beam = problem.solve()?;
        let free_m = tip_n * beam.tip_force().deflection_m(problem.guide2_m);
        let guide2_n = -beam.force_n(free_m);
        Ok(Some(Self { beam, tip_n, guide2_n }))
    }

    fn deflections_m(&self, z_m: &[f64]) -> impl Iterator<Item = f64> + use<> {
        let by_tip = self.beam.tip_force().deflections_m(z_m);
        let by_guide2 = self.beam.guide2_force().deflections_m(z_m);
        let Self { tip_n, guide2_n, .. } = *self;
        by_tip.into_iter().zip(by_guide2).map(move |(tip, guide2)| tip_n * tip + guide2_n * guide2)
    }
}

impl Curved {
    fn new(curvature_per_m: f64, problem: &BeamProblem) -> Self {
        let (stiffness_n_m2, guide2_m) = (problem.bending_stiffness_n_m2, problem.guide2_m);
        let clamp_rad_per_n_m = problem.clamp_compliance_rad_per_n_m;
        if curvature_per_m == 0.0 {
            return Self::default();
        }
        let compliance = guide2_m.powi(3) / (3.0 * stiffness_n_m2) + clamp_rad_per_n_m * guide2_m * guide2_m;
        // The only guide bends nothing: the needle lies free on its curve from there on.
        let force_n =
            if problem.only_guide { 0.0 } else { -0.5 * curvature_per_m * guide2_m * guide2_m / compliance };
        Self { curvature_per_m, stiffness_n_m2, guide2_m, clamp_rad_per_n_m, force_n }
    }

    fn deflection_m(&self, z_m: f64) -> f64 {
        let beyond_guide_m = (z_m - self.guide2_m).max(0.0);
        let [guide_deflection_m, slope] = self.before_guide2(z_m.min(self.guide2_m));
        guide_deflection_m
            + slope * beyond_guide_m
            + 0.5 * self.curvature_per_m * beyond_guide_m * beyond_guide_m
    }

    /// Deflection and slope between guide 1 and guide 2.
    fn before_guide2(&self, z: f64) -> [f64; 2] {
        let Self { curvature_per_m: kappa, stiffness_n_m2: ei, guide2_m: c, force_n: f, .. } = *self;
        let clamp_rotation = self.clamp_rad_per_n_m * f * c;
        let bent = f / ei;
        [
            clamp_rotation * z + 0.5 * kappa * z * z + bent * (0.5 * c * z * z - z * z * z / 6.0),
            clamp_rotation + kappa * z + bent * (c * z - 0.5 * z * z),
        ]
    }
}
