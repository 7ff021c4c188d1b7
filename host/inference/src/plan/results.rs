//! The result of a plan.

use formats::NORMAL_975;
use formats::prior_file::ModulusPrior;
use modulus::prior::PriorResult;
use modulus::walls::WallsResult;
use serde::Serialize;

/// One experiment and its expected results, each the worst over the range of moduli.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Choice {
    /// Position of guide 2.
    pub guide2_mm: f64,
    /// Insertion depth.
    pub depth_mm: f64,
    /// Displacement of guide 2.
    pub displacement_mm: f64,
    /// Half the width of the 95 % interval of K, or of E where the tissue is a body; infinite (`null` in JSON) beyond 1000 %, where the
    /// modulus is not identifiable.
    pub half_width_percent: f64,
    /// The same half-width with the prior of K from many sessions; `None` without such a prior.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub half_width_with_prior_percent: Option<f64>,
    /// Largest lateral force.
    pub force_n: f64,
    /// Largest strain of the needle.
    pub needle_strain_percent: f64,
    /// Largest deflection inside the tissue.
    pub deflection_mm: f64,
    /// Whether the experiment is within all limits.
    pub within_limits: bool,
}

/// All candidate experiments, and the best one.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Plan {
    /// Name and version of this schema.
    pub schema: &'static str,
    /// The run that is assumed.
    pub protocol: Protocol,
    /// All experiments, by guide position, depth and displacement.
    pub choices: Vec<Choice>,
    /// The experiment with the narrowest interval within the limits; `None` if no experiment is within them.
    pub best: Option<Choice>,
    /// Prior of K from many sessions; `None` if it was not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub prior: Option<PriorResult>,
}

impl Plan {
    /// The same plan with the prior of K from many sessions. Its interval is reported beside that of the run alone.
    pub fn with_prior(mut self, prior: &ModulusPrior) -> Self {
        let prior = PriorResult::new(prior, None);
        let prior_sd = prior.with_prior.map_or(f64::INFINITY, |prior| prior.ln_k_sd);
        self.choices.iter_mut().chain(&mut self.best).for_each(|choice| {
            let own_sd = (1e-2 * choice.half_width_percent).ln_1p() / NORMAL_975;
            // Precisions of two normal distributions add up; a run that identifies nothing leaves the prior.
            let sd = if own_sd.is_finite() {
                (own_sd.powi(-2) + prior_sd.powi(-2)).sqrt().recip()
            } else {
                prior_sd
            };
            choice.half_width_with_prior_percent = Some(100.0 * (NORMAL_975 * sd).exp_m1());
        });
        self.prior = Some(prior);
        self
    }
}

/// The run for which the intervals hold.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Protocol {
    /// Readings per second.
    pub rate_hz: f64,
    /// Length of every hold.
    pub hold_s: f64,
    /// Holds, as multiples of the displacement.
    pub levels: Vec<f64>,
    /// Number of readings in the mean of a hold, without those at its ends, which may belong to a motion.
    pub readings_per_hold: f64,
    /// Standard deviation of one reading of the force.
    pub force_sd_n: f64,
    /// Standard deviation of one reading of the displacement.
    pub displacement_sd_mm: f64,
    /// Standard deviation of one deflection of the shape.
    pub shape_sd_mm: f64,
    /// Model of the tissue: `springs`, of which K is identified, or `body`, of which E is.
    pub foundation: &'static str,
    /// Poisson's ratio of a body.
    pub poisson: Option<f64>,
    /// Its standard deviation.
    pub poisson_sd: f64,
    /// The walls of a body, on which E depends. If they are not stated, the half-widths do not include their uncertainty.
    pub walls: Option<WallsResult>,
}
