//! What interval an experiment will give before it is made: the information about K in a lateral run, over depth,
//! displacement and position of guide 2.
//!
//! The covariance at the truth is the Cramer-Rao bound, which the likelihood reaches; so the plan is what
//! [`identify`](crate::identify) will report. K is not known beforehand: every figure is the worst over a range of K.

use crate::inference::{
    FitError, LateralData, LevelData, Measured, Parameter, ShapeDatum, effect_parameters, fit,
};
use crate::model::effects::Effect;
use crate::model::{Beam, Foundation, ModelError, Rig};
use serde::Serialize;

/// What is asked.
#[derive(Debug, Clone)]
pub struct Question {
    /// Needle, guides and tissue surface.
    pub rig: Rig,
    /// Foundation moduli that the tissue may have, least and greatest.
    pub modulus_range_pa: [f64; 2],
    /// Standard deviation of a hold's force.
    pub force_sd_n: f64,
    /// Standard deviation of a hold's displacement.
    pub displacement_sd_m: f64,
    /// Standard deviation of one deflection of the shape.
    pub shape_sd_m: f64,
    /// Distance between points of the shape.
    pub shape_spacing_m: f64,
    /// Effects whose parameters are unknown too, with their priors.
    pub nuisances: Vec<&'static dyn Effect>,
    /// Insertion depths to choose from.
    pub depths_m: Vec<f64>,
    /// Displacements of guide 2 to choose from.
    pub displacements_m: Vec<f64>,
    /// Positions of guide 2 to choose from.
    pub guide2_m: Vec<f64>,
    /// What may not be exceeded.
    pub limits: Limits,
}

/// What an experiment may not exceed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Lateral force.
    pub force_n: f64,
    /// Strain of the needle's surface: beyond about 0.002 steel stays bent.
    pub needle_strain: f64,
    /// Deflection of the needle inside the tissue.
    pub deflection_m: f64,
}

/// One experiment and what it will give; the worst over the range of K.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Choice {
    /// Position of guide 2.
    pub guide2_mm: f64,
    /// Insertion depth.
    pub depth_mm: f64,
    /// Displacement of guide 2.
    pub displacement_mm: f64,
    /// Half the width of the 95 % interval of K.
    pub half_width_percent: f64,
    /// Largest lateral force.
    pub force_n: f64,
    /// Largest strain of the needle.
    pub needle_strain_percent: f64,
    /// Largest deflection inside the tissue.
    pub deflection_mm: f64,
    /// Whether all limits are kept.
    pub within_limits: bool,
}

/// Every experiment in question, and the best of them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Plan {
    /// Name and version of this form.
    pub schema: &'static str,
    /// All of them, by guide position, depth and displacement.
    pub choices: Vec<Choice>,
    /// The narrowest interval within the limits; nothing where none keeps them.
    pub best: Option<Choice>,
}

/// Why there is no plan.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PlanError {
    /// The experiment cannot be modelled.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The experiment does not determine K.
    #[error(transparent)]
    Fit(#[from] FitError),
}

/// Number of moduli that the range is looked at.
const MODULI: u32 = 5;
const LN_STEP: f64 = 1e-4;

/// Works out every choice.
///
/// # Errors
/// [`PlanError`] where a choice cannot be modelled.
pub fn plan(question: &Question) -> Result<Plan, PlanError> {
    let mut choices = Vec::new();
    for guide2_m in &question.guide2_m {
        let rig = Rig { guide2_m: *guide2_m, ..question.rig.clone() };
        for depth_m in &question.depths_m {
            for displacement_m in &question.displacements_m {
                choices.push(choice(question, &rig, *depth_m, *displacement_m)?);
            }
        }
    }
    let kept = choices.iter().filter(|choice| choice.within_limits).copied();
    let best = kept.min_by(|a, b| a.half_width_percent.total_cmp(&b.half_width_percent));
    Ok(Plan { schema: "guide.plan/1", choices, best })
}

fn choice(question: &Question, rig: &Rig, depth_m: f64, displacement_m: f64) -> Result<Choice, PlanError> {
    let mut choice = Choice {
        guide2_mm: 1e3 * rig.guide2_m,
        depth_mm: 1e3 * depth_m,
        displacement_mm: 1e3 * displacement_m,
        half_width_percent: 0.0,
        force_n: 0.0,
        needle_strain_percent: 0.0,
        deflection_mm: 0.0,
        within_limits: false,
    };
    let [least, most] = question.modulus_range_pa;
    for i in 0..MODULI {
        let modulus_pa = least * (most / least).powf(f64::from(i) / f64::from(MODULI - 1));
        let beam = Beam::solve(rig, &Foundation::uniform(modulus_pa)?, depth_m)?;
        let force_n = beam.force_n(displacement_m);
        let unit = beam.guide2_force();
        let stiffness = rig.needle.bending_stiffness_n_m2();
        // The moment is greatest at guide 1 or at guide 2.
        let moment_n_m = unit.moment_n_m(0.0).abs().max(unit.moment_n_m(rig.guide2_m).abs()) * force_n;
        let strain = 0.5 * rig.needle.outer_diameter_m * moment_n_m / stiffness;
        let points = (depth_m / question.shape_spacing_m + 1e-9).floor() as usize;
        let z_m = |i: usize| rig.entry_m + (i as f64 + 0.5) * depth_m / points.max(1) as f64;
        let at = |i: usize| beam.deflection_m(displacement_m, z_m(i));
        let ends =
            [rig.entry_m, rig.entry_m + depth_m].map(|z_m| beam.deflection_m(displacement_m, z_m).abs());

        let data = LateralData {
            support: crate::model::Support::Springs,
            rig: rig.clone(),
            depth_m,
            planes: 1,
            levels: vec![LevelData {
                displacement_m: vec![Measured { value: displacement_m, sd: question.displacement_sd_m }],
                force_n: vec![Measured { value: force_n, sd: question.force_sd_n }],
                shape: (0..points).map(|i| ShapeDatum { z_m: z_m(i), deflection_m: [at(i), 0.0] }).collect(),
            }],
            shape_sd_m: question.shape_sd_m,
            force_offset: false,
            uses_force: true,
            effects: question.nuisances.clone(),
            fixed: None,
        };
        let mut unknowns = vec![Parameter::free(modulus_pa.ln(), LN_STEP)];
        unknowns.extend(effect_parameters(&question.nuisances));
        let fit = fit(&unknowns, &[data])?;
        let sd_ln = fit.covariance.get((0, 0)).copied().unwrap_or(f64::NAN).sqrt();
        let half_width_percent = 100.0 * ((1.959_963_984_540_054 * sd_ln).exp() - 1.0);

        choice.half_width_percent = choice.half_width_percent.max(half_width_percent);
        choice.force_n = choice.force_n.max(force_n);
        choice.needle_strain_percent = choice.needle_strain_percent.max(100.0 * strain);
        choice.deflection_mm = choice.deflection_mm.max(1e3 * ends[0].max(ends[1]));
    }
    let limits = question.limits;
    choice.within_limits = choice.force_n <= limits.force_n
        && choice.needle_strain_percent <= 100.0 * limits.needle_strain
        && choice.deflection_mm <= 1e3 * limits.deflection_m;
    Ok(choice)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Needle;
    use crate::model::effects::effect;

    fn question() -> Question {
        Question {
            rig: Rig::two_guides(Needle::gauge_18(), 0.06, 0.07),
            modulus_range_pa: [16e3, 16e3],
            force_sd_n: 0.1,
            displacement_sd_m: 15e-6,
            shape_sd_m: 25e-6,
            shape_spacing_m: 1e-3,
            nuisances: Vec::new(),
            depths_m: vec![0.02, 0.03, 0.04],
            displacements_m: vec![1.2e-3],
            guide2_m: vec![0.06],
            limits: Limits { force_n: 4.0, needle_strain: 2e-3, deflection_m: 2e-3 },
        }
    }

    #[test]
    fn half_widths_are_those_of_the_reference_bound() {
        let plan = plan(&question()).expect("a plan");
        let bounds = [0.05517608893544766, 0.02335154058660031, 0.013981029964844035];
        for (choice, sd_ln) in plan.choices.iter().zip(bounds) {
            let expected = 100.0 * (f64::exp(1.959964 * sd_ln) - 1.0);
            assert!((choice.half_width_percent / expected - 1.0).abs() < 1e-3, "{choice:?}");
        }
        assert_eq!(plan.best.expect("a best").depth_mm, 40.0);
        assert!((plan.choices[1].force_n - 1.309563697895257).abs() < 1e-9);
    }

    #[test]
    fn the_worst_of_the_range_counts_and_limits_are_kept() {
        let wide = Question { modulus_range_pa: [8e3, 32e3], ..question() };
        let wide_plan = plan(&wide).expect("a plan");
        let narrow_plan = plan(&question()).expect("a plan");
        for (wide, narrow) in wide_plan.choices.iter().zip(&narrow_plan.choices) {
            assert!(wide.half_width_percent >= narrow.half_width_percent && wide.force_n > narrow.force_n);
        }
        let gentle = Question { limits: Limits { force_n: 1.4, ..question().limits }, ..question() };
        assert_eq!(plan(&gentle).expect("a plan").best.expect("a best").depth_mm, 30.0);
        let nothing = Question { limits: Limits { force_n: 0.1, ..question().limits }, ..question() };
        assert_eq!(plan(&nothing).expect("a plan").best, None);
    }

    /// Without tissue guide 2 bends a cantilever of its own length: a moment of `3 EI u / L^2` at the clamp.
    #[test]
    fn needle_strain_is_that_of_a_cantilever_where_there_is_no_tissue() {
        let air = Question { modulus_range_pa: [1e-3, 1e-3], force_sd_n: 1e-9, ..question() };
        let expected = 100.0 * 0.5 * Needle::gauge_18().outer_diameter_m * 3.0 * 1.2e-3 / 0.06f64.powi(2);
        let found = plan(&air).expect("air is a foundation too").choices[0].needle_strain_percent;
        assert!((found / expected - 1.0).abs() < 1e-3, "{found} {expected}");
    }

    #[test]
    fn the_figure_has_a_line_per_displacement() {
        let question = Question { displacements_m: vec![0.6e-3, 1.2e-3], ..question() };
        let figure = crate::figures::plan(&plan(&question).expect("a plan")).expect("a figure");
        assert!(figure.contains("guide 2 at 60 mm, 0.6 mm") && figure.matches("<circle").count() == 6);
    }

    #[test]
    fn nuisances_widen() {
        let nuisances = ["rig.clamp_compliance", "sensor.depth_shift"];
        let nuisances = nuisances.iter().map(|id| effect(id).expect("an effect")).collect();
        let plain = plan(&question()).expect("a plan");
        let honest = plan(&Question { nuisances, ..question() }).expect("a plan");
        for (plain, honest) in plain.choices.iter().zip(&honest.choices) {
            assert!(honest.half_width_percent > 1.02 * plain.half_width_percent, "{plain:?} {honest:?}");
        }
    }
}
