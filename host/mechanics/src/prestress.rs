//! Prestress: forces and shape before guide 2 moves, of a needle that is not straight when it is free of stress.
//!
//! A needle of stress-free curvature is inserted along the path it takes between the guides, so that the tissue is unstressed on
//! it; guide 2 at zero holds it. `EI (u'' - kappa) = F (c2 - z)` before guide 2 and 0 beyond it, `u(0) = 0`,
//! `u'(0) = compliance EI (u''(0) - kappa)`, `u(c2) = 0`: with a perfect clamp `F = -3 EI kappa / (2 c2)` is the force of guide 2 on
//! the needle.

use super::{BeamProblem, Model};

/// Prestress in both planes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Prestress([Plane; 2]);

#[derive(Debug, Clone, Copy, Default)]
struct Plane {
    curvature_per_m: f64,
    stiffness_n_m2: f64,
    guide2_m: f64,
    clamp_rad_per_n_m: f64,
    force_n: f64,
}

impl Prestress {
    /// As the effects of a model make it.
    pub fn of(model: &Model, problems: [&BeamProblem; 2]) -> Self {
        let mut curvature_per_m = [0.0; 2];
        model
            .effects
            .iter()
            .for_each(|(effect, values)| effect.stress_free_curvature(values, &mut curvature_per_m));
        Self([0, 1].map(|plane| Plane::new(curvature_per_m[plane], problems[plane])))
    }

    /// Force of guide 2 on the needle.
    pub fn force_n(&self, plane: usize) -> f64 {
        self.0[plane].force_n
    }

    /// Puts the deflections at these places behind others.
    pub fn add_deflections_m(&self, plane: usize, z_m: &[f64], to_m: &mut Vec<f64>) {
        let plane = &self.0[plane];
        if plane.curvature_per_m == 0.0 {
            to_m.resize(to_m.len() + z_m.len(), 0.0);
        } else {
            to_m.extend(z_m.iter().map(|z_m| plane.deflection_m(*z_m)));
        }
    }
}

impl Plane {
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
