//! Relation between foundation modulus and Young's modulus: the foundation modulus that a lateral run identifies in an
//! elastic body ([`Continuum`]). It depends on needle, depth, Poisson's ratio and guide positions, on Young's modulus
//! itself, through the needle's flexibility, and a little on what is measured how well, because no springs do exactly
//! what a body does (theory, eq. 20). For needles deeper than about 60 mm it is more than a little: there the shape
//! requires softer springs than the force, and K is a number of the test as much as of the tissue. Young's modulus
//! found through the relation for that very test is not affected.

use mechanics::continuum::{Continuum, check_youngs};
use mechanics::unknowns::sensors::{DISPLACEMENT_NOISE, FORCE_NOISE, SHAPE_NOISE};
use mechanics::{Rig, Support};
use readings::{
    FitError, ForceZero, HoldData, LateralData, Measured, Parameter, ShapeDatum, SharedErrors, fit,
};

/// Foundation modulus of the beam on springs that comes closest to the needle in the body: what
/// `identify` finds in a lateral run in such a body.
///
/// # Errors
/// [`ModelError::OutOfRange`](mechanics::ModelError::OutOfRange) for a Young's modulus outside [`YOUNGS_RANGE_PA`](mechanics::continuum::YOUNGS_RANGE_PA), [`FitError`] where the body or the beam cannot be
/// solved.
pub fn foundation_modulus_pa(
    body: &Continuum,
    rig: &Rig,
    youngs_pa: f64,
    run: &Run,
) -> Result<f64, FitError> {
    check_youngs(youngs_pa)?;
    fitted_modulus_pa(body, rig, youngs_pa, run)
}

fn fitted_modulus_pa(body: &Continuum, rig: &Rig, youngs_pa: f64, run: &Run) -> Result<f64, FitError> {
    let unit = body.response(rig, youngs_pa)?;
    let force_n = run.displacement_m / unit.deflection_m(rig.guide2_m);
    let points = (body.depth_m() / run.spacing_m).round().max(3.0) as usize;
    let level = HoldData {
        displacement_m: vec![Measured { value: run.displacement_m, sd: run.displacement_sd_m }],
        force_n: vec![Measured { value: force_n, sd: run.force_sd_n }],
        shape: (0..points)
            .map(|i| {
                let z_m = rig.entry_m + body.depth_m() * (i as f64 + 0.5) / points as f64;
                ShapeDatum::new(z_m, [force_n * unit.deflection_m(z_m), 0.0])
            })
            .collect(),
    };
    let data = LateralData {
        rig: rig.clone(),
        support: Support::Springs,
        depth_m: body.depth_m(),
        planes: 1,
        levels: vec![level],
        shape_sd_m: run.shape_sd_m,
        force_zero: ForceZero::Exact,
        shared: SharedErrors::default(),
        uses_force: true,
        effects: Vec::new(),
        fixed: None,
    };
    let start = (youngs_pa * body.rigid_ratio()?).ln();
    Ok(fit(&[Parameter::free(start, 1e-4)], &[data])?.shared.first().copied().unwrap_or(f64::NAN).exp())
}

/// Young's modulus of a body in which `identify` finds this foundation modulus.
///
/// # Errors
/// As [`foundation_modulus_pa`].
pub fn youngs_modulus_pa(body: &Continuum, rig: &Rig, modulus_pa: f64, run: &Run) -> Result<f64, FitError> {
    let mut youngs_pa = modulus_pa / body.rigid_ratio()?;
    // The ratio hardly depends on the modulus itself: a fixed point that is reached quickly.
    for _ in 0..60 {
        let next_pa = youngs_pa * modulus_pa / fitted_modulus_pa(body, rig, youngs_pa, run)?;
        let change = (next_pa / youngs_pa - 1.0).abs();
        youngs_pa = next_pa;
        if change < 1e-5 {
            check_youngs(youngs_pa)?;
            return Ok(youngs_pa);
        }
    }
    Err(FitError::NotConverged)
}

/// The lateral run that is identified: its noise sets the weights of force and shape where springs and continuum differ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Run {
    /// Displacement of guide 2.
    pub displacement_m: f64,
    /// Standard deviation of a hold's displacement.
    pub displacement_sd_m: f64,
    /// Standard deviation of a hold's force.
    pub force_sd_n: f64,
    /// Standard deviation of one deflection.
    pub shape_sd_m: f64,
    /// Distance between points of the shape.
    pub spacing_m: f64,
}

impl Default for Run {
    fn default() -> Self {
        Self {
            displacement_m: 1.2e-3,
            displacement_sd_m: DISPLACEMENT_NOISE.mean(),
            force_sd_n: FORCE_NOISE.mean(),
            shape_sd_m: SHAPE_NOISE.mean(),
            spacing_m: 1e-3,
        }
    }
}

/// The table that is part of the program, CSV, as `cargo xtask study modulus-relation` makes it.
pub const TABLE: &str = include_str!("relation.csv");

/// Relative uncertainty of the relation as computed, at 95 %: mesh, far boundary and the rigid sections, as the
/// comparison with other solutions shows it. The real contact between tissue and needle is not included.
pub const RELATIVE_ERROR: f64 = 0.02;

#[cfg(test)]
mod tests;
