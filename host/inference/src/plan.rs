//! Expected interval of an experiment: the information about K, or about E of an elastic body, in a lateral run, over
//! depth, displacement and position of guide 2.
//!
//! The covariance at the true values is the Cramer-Rao bound, which the maximum-likelihood estimate of [`identify`] reaches.
//! Noise is that of one reading and averages over the readings of a hold; true displacements and the force sensor's zero are
//! unknown. As the modulus is unknown before the experiment, every figure is the worst over a range of moduli. `cargo xtask
//! study plan` compares the plan with the scatter of simulated sessions.

mod results;

pub use results::{Choice, Plan, Protocol};

use formats::NORMAL_975;
use formats::session::{DEPTH_RANGE_MM, Walls};
use mechanics::effects::Effect;
use mechanics::unknowns::sensors::FORCE_ZERO;
use mechanics::{Beam, Model, ModelError, Rig, Support};
use modulus::walls::WallsResult;
use readings::holds::{HoldCriteria, trimmed_s};
use readings::{
    FitError, ForceZero, HoldData, LateralData, Measured, Parameter, ShapeDatum, SharedErrors,
    effect_parameters, fit,
};

/// Request of a plan.
#[derive(Debug, Clone)]
pub struct PlanInput {
    /// Needle, guides and tissue surface.
    pub rig: Rig,
    /// Support of the needle by the tissue.
    pub support: Support,
    /// Standard deviation of Poisson's ratio of a body: it widens the interval of Young's modulus.
    pub poisson_sd: f64,
    /// Statement about the walls of the tissue. A block is also part of `support`.
    pub walls: Option<Walls>,
    /// Smallest and largest modulus of the tissue: K of springs, E of a body.
    pub modulus_range_pa: [f64; 2],
    /// Standard deviation of one reading of the force.
    pub force_sd_n: f64,
    /// Standard deviation of one reading of the displacement.
    pub displacement_sd_m: f64,
    /// Standard deviation of one deflection of the shape.
    pub shape_sd_m: f64,
    /// Distance between points of the shape.
    pub shape_spacing_m: f64,
    /// Readings per second of force and displacement.
    pub rate_hz: f64,
    /// Length of every hold.
    pub hold_s: f64,
    /// Holds of the run, as multiples of the displacement: 0 is a hold at zero displacement, which determines the force
    /// sensor's zero. Without such a hold the zero is assumed to be exact, as in `identify`.
    pub levels: Vec<f64>,
    /// Effects whose parameters are nuisance parameters with priors.
    pub nuisances: Vec<&'static dyn Effect>,
    /// Insertion depths to choose from.
    pub depths_m: Vec<f64>,
    /// Displacements of guide 2 to choose from.
    pub displacements_m: Vec<f64>,
    /// Positions of guide 2 to choose from.
    pub guide2_m: Vec<f64>,
    /// Limits of the experiment.
    pub limits: Limits,
}

/// Limits of an experiment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Lateral force.
    pub force_n: f64,
    /// Strain of the needle's surface: beyond about 0.002 steel stays bent.
    pub needle_strain: f64,
    /// Deflection of the needle inside the tissue.
    pub deflection_m: f64,
}

/// Why there is no plan.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PlanError {
    /// A quantity has a value that no run can have.
    #[error("{field}: {value}, expected {least} to {most}")]
    OutOfRange {
        /// The quantity, with unit.
        field: &'static str,
        /// Its value.
        value: f64,
        /// Least valid value.
        least: f64,
        /// Greatest valid value.
        most: f64,
    },
    /// No displacement, or no choice.
    #[error("{field}: {problem}")]
    Empty {
        /// The quantity.
        field: &'static str,
        /// Missing content.
        problem: &'static str,
    },
    /// A hold has too few readings to be detected.
    #[error(
        "hold_s: {hold_s} s at {rate_hz} Hz are {readings:.0} readings, expected {MIN_READINGS:.0} or more"
    )]
    FewReadings {
        /// Length of a hold.
        hold_s: f64,
        /// Readings per second.
        rate_hz: f64,
        /// Readings in it.
        readings: f64,
    },
    /// Too few points of the shape to identify anything.
    #[error("spacing_mm: {spacing_mm} leaves {found} shape points in {depth_mm} mm of depth, expected at least {MIN_POINTS}: at most {:.3}", depth_mm / MIN_POINTS as f64)]
    FewPoints {
        /// Distance between points.
        spacing_mm: f64,
        /// Insertion depth.
        depth_mm: f64,
        /// Number of points.
        found: usize,
    },
    /// The experiment cannot be modelled.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The experiment does not determine K.
    #[error(transparent)]
    Fit(#[from] FitError),
}

/// Fewest shape points that `identify` accepts.
const MIN_POINTS: usize = modulus::energy::MIN_POINTS;
/// Number of moduli of the range at which a choice is evaluated.
const MODULI: u32 = 5;
const LN_STEP: f64 = 1e-4;
/// A modulus with a wider interval than this is not identifiable.
const MAX_HALF_WIDTH_PERCENT: f64 = 1e3;
/// Fewest readings of a hold.
const MIN_READINGS: f64 = 20.0;

impl PlanInput {
    /// Number of readings in the mean of a hold: the detection cuts off both ends, which may belong to a motion.
    pub fn readings_per_hold(&self) -> f64 {
        (self.rate_hz * (self.hold_s - trimmed_s(1.0 / self.rate_hz))).floor().max(1.0)
    }

    fn protocol(&self) -> Protocol {
        Protocol {
            rate_hz: self.rate_hz,
            hold_s: self.hold_s,
            levels: self.levels.clone(),
            readings_per_hold: self.readings_per_hold(),
            force_sd_n: self.force_sd_n,
            displacement_sd_mm: 1e3 * self.displacement_sd_m,
            shape_sd_mm: 1e3 * self.shape_sd_m,
            foundation: self.support.name(),
            poisson: self.support.poisson(),
            poisson_sd: self.poisson_sd,
            walls: self.support.poisson().map(|poisson| {
                let deepest_m = self.depths_m.iter().copied().fold(0.0, f64::max);
                WallsResult::new(self.walls, &self.rig.needle, deepest_m, poisson)
            }),
        }
    }

    fn check(&self) -> Result<(), PlanError> {
        for (field, empty) in [
            ("depth_mm", self.depths_m.is_empty()),
            ("displacement_mm", self.displacements_m.is_empty()),
            ("guide2_mm", self.guide2_m.is_empty()),
        ] {
            if empty {
                return Err(PlanError::Empty {
                    field,
                    problem: "nothing to choose from, expected one value or more",
                });
            }
        }
        let modulus = if self.support.is_body() { "youngs_kpa" } else { "k_kpa" };
        check_range(modulus, &self.modulus_range_pa, 1e-3, [0.01, 1e4])?;
        check_range("poisson_sd", &[self.poisson_sd], 1.0, [0.0, 0.2])?;
        check_range("depth_mm", &self.depths_m, 1e3, DEPTH_RANGE_MM)?;
        check_range("displacement_mm", &self.displacements_m, 1e3, [0.01, 50.0])?;
        check_range("guide2_mm", &self.guide2_m, 1e3, [1.0, 1e3])?;
        check_range("spacing_mm", &[self.shape_spacing_m], 1e3, [0.05, 100.0])?;
        check_range("rate_hz", &[self.rate_hz], 1.0, [1.0, 1e5])?;
        check_range("hold_s", &[self.hold_s], 1.0, [HoldCriteria::default().min_duration_s, 3600.0])?;
        check_range("levels", &self.levels, 1.0, [-1.0, 1.0])?;
        check_range("force_n", &[self.force_sd_n], 1.0, [1e-9, 100.0])?;
        check_range("displacement_mm (noise)", &[self.displacement_sd_m], 1e3, [1e-6, 10.0])?;
        check_range("shape_mm (noise)", &[self.shape_sd_m], 1e3, [1e-6, 10.0])?;
        if self.levels.iter().all(|level| *level == 0.0) {
            return Err(PlanError::Empty {
                field: "levels",
                problem: "no displaced hold, expected one or more",
            });
        }
        let (hold_s, rate_hz, readings) = (self.hold_s, self.rate_hz, self.hold_s * self.rate_hz);
        if readings < MIN_READINGS * (1.0 - 1e-9) {
            return Err(PlanError::FewReadings { hold_s, rate_hz, readings });
        }
        let sparse_depth = self.depths_m.iter().find(|depth_m| self.points(**depth_m) < MIN_POINTS);
        sparse_depth.map_or(Ok(()), |depth_m| {
            let (spacing_mm, depth_mm) = (1e3 * self.shape_spacing_m, 1e3 * depth_m);
            Err(PlanError::FewPoints { spacing_mm, depth_mm, found: self.points(*depth_m) })
        })
    }

    /// Shape points of a sweep at a depth.
    fn points(&self, depth_m: f64) -> usize {
        (depth_m / self.shape_spacing_m + 1e-9).floor() as usize
    }
}

fn check_range(
    field: &'static str,
    values: &[f64],
    scale: f64,
    [least, most]: [f64; 2],
) -> Result<(), PlanError> {
    // Lengths in millimetres, without the digits that scaling leaves behind.
    let wrong = values
        .iter()
        .map(|value| (1e9 * scale * value).round() / 1e9)
        .find(|value| !(least..=most).contains(value));
    wrong.map_or(Ok(()), |value| Err(PlanError::OutOfRange { field, value, least, most }))
}

/// Evaluates every choice.
///
/// # Errors
/// [`PlanError`] where a quantity is out of range or a choice cannot be modelled.
pub fn plan(question: &PlanInput) -> Result<Plan, PlanError> {
    question.check()?;
    let mut choices = Vec::new();
    for guide2_m in &question.guide2_m {
        let rig = Rig { guide2_m: *guide2_m, ..question.rig.clone() };
        for depth_m in &question.depths_m {
            for displacement_m in &question.displacements_m {
                choices.push(choice(question, &rig, *depth_m, *displacement_m)?);
            }
        }
    }
    let kept_choices = choices
        .iter()
        .filter(|choice| choice.within_limits && choice.half_width_percent.is_finite())
        .copied();
    let best = kept_choices.min_by(|a, b| a.half_width_percent.total_cmp(&b.half_width_percent));
    Ok(Plan { schema: "guide.plan/1", protocol: question.protocol(), choices, best, prior: None })
}

fn choice(question: &PlanInput, rig: &Rig, depth_m: f64, displacement_m: f64) -> Result<Choice, PlanError> {
    let mut choice = Choice {
        guide2_mm: 1e3 * rig.guide2_m,
        depth_mm: 1e3 * depth_m,
        displacement_mm: 1e3 * displacement_m,
        half_width_percent: 0.0,
        half_width_with_prior_percent: None,
        force_n: 0.0,
        needle_strain_percent: 0.0,
        deflection_mm: 0.0,
        within_limits: false,
    };
    let [least, most] = question.modulus_range_pa;
    for i in 0..MODULI {
        let modulus_pa = least * (most / least).powf(f64::from(i) / f64::from(MODULI - 1));
        let beam = Model::on(rig.clone(), question.support, modulus_pa)?.beam(depth_m)?;
        let force_n = beam.force_n(displacement_m);
        let unit = beam.guide2_force();
        let stiffness = rig.needle.bending_stiffness_n_m2();
        // The moment is greatest at guide 1 or at guide 2.
        let moment_n_m = unit.moment_n_m(0.0).abs().max(unit.moment_n_m(rig.guide2_m).abs()) * force_n;
        let strain = 0.5 * rig.needle.outer_diameter_m * moment_n_m / stiffness;
        let ends =
            [rig.entry_m, rig.entry_m + depth_m].map(|z_m| beam.deflection_m(displacement_m, z_m).abs());

        let data = data(question, rig, &beam, depth_m, displacement_m);
        let mut unknowns = vec![Parameter::free(modulus_pa.ln(), LN_STEP)];
        unknowns.extend(effect_parameters(&question.nuisances));
        let springs_fit = fit(&unknowns, std::slice::from_ref(&data))?;
        let sd_ln = springs_fit.covariance.get((0, 0)).copied().unwrap_or(f64::NAN).sqrt();
        let by_poisson = match question.support.one_sd_away(question.poisson_sd) {
            Some(support) => {
                let alternative_fit = fit(&unknowns, &[LateralData { support, ..data }])?;
                alternative_fit.shared.first().map_or(f64::NAN, |ln_pa| ln_pa - modulus_pa.ln())
            }
            None => 0.0,
        };
        let half_width_percent = 100.0 * ((NORMAL_975 * sd_ln.hypot(by_poisson)).exp() - 1.0);

        // The largest half-width that is reported; a wider interval is infinite.
        let half_width_percent =
            if half_width_percent <= MAX_HALF_WIDTH_PERCENT { half_width_percent } else { f64::INFINITY };
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

/// The run as it would be measured, without noise.
fn data(question: &PlanInput, rig: &Rig, beam: &Beam, depth_m: f64, displacement_m: f64) -> LateralData {
    let of_mean = question.readings_per_hold().sqrt();
    let points = question.points(depth_m);
    let (least, most) =
        question.levels.iter().fold((0.0_f64, 0.0_f64), |(least, most), at| (least.min(*at), most.max(*at)));
    LateralData {
        support: question.support,
        rig: rig.clone(),
        depth_m,
        planes: 1,
        levels: question
            .levels
            .iter()
            .map(|level| {
                let level_m = level * displacement_m;
                // The shape is swept at zero and at the extremes.
                let points = if [0.0, least, most].contains(level) { points } else { 0 };
                HoldData {
                    displacement_m: vec![Measured {
                        value: level_m,
                        sd: question.displacement_sd_m / of_mean,
                    }],
                    force_n: vec![Measured {
                        value: beam.force_n(level_m),
                        sd: question.force_sd_n / of_mean,
                    }],
                    shape: (0..points)
                        .map(|i| {
                            ShapeDatum::new(
                                point_m(i, depth_m, points, rig.entry_m),
                                [beam.deflection_m(level_m, point_m(i, depth_m, points, rig.entry_m)), 0.0],
                            )
                        })
                        .collect(),
                }
            })
            .collect(),
        shape_sd_m: question.shape_sd_m,
        shared: SharedErrors::default(),
        force_zero: if question.levels.contains(&0.0) {
            ForceZero::Measured
        } else {
            // A rig is tared before it measures.
            ForceZero::assumed(FORCE_ZERO.typical_sd())
        },
        uses_force: true,
        effects: question.nuisances.clone(),
        fixed: None,
    }
}

fn point_m(i: usize, depth_m: f64, points: usize, entry_m: f64) -> f64 {
    entry_m + (i as f64 + 0.5) * depth_m / points.max(1) as f64
}

#[cfg(test)]
mod tests;
