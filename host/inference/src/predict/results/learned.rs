//! Posterior of rig and tissue in a prediction.

use super::{NORMAL_95, NORMAL_975};
use identify::KPerEi;
use insertion::{Identifiability, Moments, Posterior, Rear, TipPath, Tissue};
use serde::Serialize;

/// Rig and tissue, learned from the other insertions and the observed part.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LearnedResult {
    /// Number of training insertions.
    pub from: Vec<String>,
    /// Foundation modulus of this insertion just below the surface: the common one and the insertion's own difference.
    pub k_kpa: f64,
    /// Its 95 % interval. For a bound: the bound with 95 % probability, and the end of the range.
    pub k_ci95_kpa: [f64; 2],
    /// Ratio of K to the needle's bending stiffness, if that stiffness is unknown; K then refers to the reference needle.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub k_per_ei: Option<KPerEi>,
    /// `identified`, `lower_bound`, `upper_bound` or `not_identified`.
    pub k_status: &'static str,
    /// Effective gap between guide 2 and the tissue.
    pub gap_mm: f64,
    /// Its 95 % interval, as that of the modulus.
    pub gap_ci95_mm: [f64; 2],
    /// As `k_status`.
    pub gap_status: &'static str,
    /// Moment per slope of the needle's rear in its only guide, vertical, where the session does not state it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rear_rotation_y: Option<RearResult>,
    /// The same, horizontal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rear_rotation_x: Option<RearResult>,
    /// Angle between the needle and the axis of depth, vertical and horizontal. It includes a tilt of the tracker, which cannot
    /// be separated from it.
    pub entry_angle_deg: Vec<f64>,
    /// Their standard deviations.
    pub entry_angle_sd_deg: Vec<f64>,
    /// Standard deviation of the mean tip load from insertion to insertion.
    pub load_sd_between_insertions_n: f64,
    /// Process noise of the tip load over 100 mm, the part of this insertion alone.
    pub load_process_noise_n: f64,
    /// Process noise of the tip load over 100 mm, the part that all insertions share.
    pub shared_load_process_noise_n: f64,
    /// Standard deviation of the tip about a smooth path.
    pub path_irregularity_sd_mm: f64,
    /// Standard deviation of one reading of the tip.
    pub tip_reading_sd_mm: f64,
}

/// Rotation stiffness of a needle's rear, of this insertion.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RearResult {
    /// Moment per slope.
    pub n_m_per_rad: f64,
    /// Its 95 % interval, as that of the modulus.
    pub ci95_n_m_per_rad: [f64; 2],
    /// As [`LearnedResult::k_status`].
    pub status: &'static str,
}

impl RearResult {
    /// The interval is transformed from that of the load fraction, which grows as the stiffness falls.
    fn new((share, determined): (Moments, Identifiability), rear: &Rear) -> Self {
        let ends = match determined {
            Identifiability::LowerBound => [NORMAL_95, f64::NEG_INFINITY],
            Identifiability::UpperBound => [f64::INFINITY, -NORMAL_95],
            Identifiability::Identified | Identifiability::NotIdentified => [NORMAL_975, -NORMAL_975],
        };
        Self {
            n_m_per_rad: stiffness_at(0.0, rear, share.mean, share.sd),
            ci95_n_m_per_rad: ends.map(|sds| stiffness_at(sds, rear, share.mean, share.sd)),
            status: determined.name(),
        }
    }

    /// As text.
    pub fn text(&self) -> String {
        let [low, high] = self.ci95_n_m_per_rad;
        match self.status {
            "lower_bound" => format!("above {low:.2} N m/rad"),
            "upper_bound" => format!("below {high:.2} N m/rad"),
            "not_identified" => "not identifiable".to_owned(),
            _ => format!("{:.2} ({low:.2} to {high:.2}) N m/rad", self.n_m_per_rad),
        }
    }
}

fn stiffness_at(sds: f64, rear: &Rear, mean: f64, sd: f64) -> f64 {
    rear.stiffness_n_m_per_rad(mean + sds * sd)
}

impl LearnedResult {
    pub(in crate::predict) fn new(
        posterior: &Posterior<'_>,
        tissue: &Tissue,
        others: &[&TipPath],
        reading_m: f64,
    ) -> Self {
        let surface_kpa = 1e-3 * tissue.model.foundation.modulus_pa(0.0);
        let [factor, gap] = posterior.ln_modulus_factor_and_gap();
        let [k_determined, gap_determined] = posterior.determined();
        let [[k_low, k_high], [gap_low, gap_high]] = posterior.range();
        let angles = posterior.entry_angle_rad();
        let k_kpa = surface_kpa * factor.mean.exp();
        let k_ci95_kpa = modulus_interval(factor, k_determined, surface_kpa, [k_low, k_high]);
        Self {
            from: others.iter().map(|other| other.id.clone()).collect(),
            k_kpa,
            k_ci95_kpa,
            k_status: k_determined.name(),
            k_per_ei: KPerEi::of(&tissue.model.rig.needle, k_kpa, k_ci95_kpa),
            gap_mm: 1e3 * gap.mean.exp(),
            gap_ci95_mm: modulus_interval(gap, gap_determined, 1e3, [gap_low, gap_high]),
            gap_status: gap_determined.name(),
            rear_rotation_y: rear_result(0, posterior, tissue.rear),
            rear_rotation_x: rear_result(1, posterior, tissue.rear),
            entry_angle_deg: angles.iter().map(|angle| angle.mean.to_degrees()).collect(),
            entry_angle_sd_deg: angles.iter().map(|angle| angle.sd.to_degrees()).collect(),
            load_sd_between_insertions_n: posterior.typical(|scales| scales.load_n),
            load_process_noise_n: posterior.typical(|scales| scales.process_noise_over_n(0.1)[1]),
            shared_load_process_noise_n: posterior.typical(|scales| scales.process_noise_over_n(0.1)[0]),
            path_irregularity_sd_mm: 1e3 * posterior.typical(|scales| scales.irregularity_m),
            tip_reading_sd_mm: 1e3 * reading_m,
        }
    }
}

fn rear_result(plane: usize, posterior: &Posterior<'_>, rear: Option<Rear>) -> Option<RearResult> {
    let rear_estimate = posterior.rear_share()?[plane]?;
    Some(RearResult::new(rear_estimate, rear.as_ref()?))
}

fn modulus_interval(ln: Moments, determined: Identifiability, unit: f64, [low, high]: [f64; 2]) -> [f64; 2] {
    match determined {
        Identifiability::LowerBound => [
            modulus_at(-NORMAL_95, unit, ln.mean, ln.sd),
            (unit * high).max(modulus_at(0.0, unit, ln.mean, ln.sd)),
        ],
        Identifiability::UpperBound => [
            (unit * low).min(modulus_at(0.0, unit, ln.mean, ln.sd)),
            modulus_at(NORMAL_95, unit, ln.mean, ln.sd),
        ],
        Identifiability::Identified | Identifiability::NotIdentified => {
            [modulus_at(-NORMAL_975, unit, ln.mean, ln.sd), modulus_at(NORMAL_975, unit, ln.mean, ln.sd)]
        }
    }
}

fn modulus_at(sds: f64, unit: f64, mean: f64, sd: f64) -> f64 {
    unit * (mean + sds * sd).exp()
}

impl LearnedResult {
    /// Replaces modulus and gap by their priors, where the paths do not determine them.
    pub(in crate::predict) fn assume(&mut self, tissue: &Tissue) {
        self.k_kpa = 1e-3 * tissue.model.foundation.modulus_pa(0.0);
        self.k_ci95_kpa = log_normal_interval(self.k_kpa, tissue.modulus_sd_ln);
        self.gap_mm = 1e3 * tissue.gap_m;
        self.gap_ci95_mm = log_normal_interval(self.gap_mm, tissue.gap_sd_ln);
        (self.k_status, self.gap_status) =
            (Identifiability::NotIdentified.name(), Identifiability::NotIdentified.name());
        self.k_per_ei = KPerEi::of(&tissue.model.rig.needle, self.k_kpa, self.k_ci95_kpa);
    }

    /// Modulus with its interval, in kPa, as text.
    pub fn modulus_text(&self) -> String {
        estimate_text(self.k_kpa, self.k_ci95_kpa, self.k_status, "kPa")
    }

    /// Rotation stiffness of the rear in both planes with its intervals, as text; `None` where the session states it.
    pub fn rear_text(&self) -> Option<String> {
        let is_unknown = self.rear_rotation_y.is_some() || self.rear_rotation_x.is_some();
        is_unknown.then(|| {
            format!("{}, {}", rear_or_stated(&self.rear_rotation_y), rear_or_stated(&self.rear_rotation_x))
        })
    }

    /// Gap with its interval, in mm, as text.
    pub fn gap_text(&self) -> String {
        estimate_text(self.gap_mm, self.gap_ci95_mm, self.gap_status, "mm")
    }
}

fn rear_or_stated(rear: &Option<RearResult>) -> String {
    rear.as_ref().map_or("as stated".to_owned(), RearResult::text)
}

fn log_normal_interval(value: f64, sd_ln: f64) -> [f64; 2] {
    [-NORMAL_975, NORMAL_975].map(|sds| value * (sds * sd_ln).exp())
}

/// A value with its interval; nothing at the end of a range is given as a value.
fn estimate_text(value: f64, [low, high]: [f64; 2], status: &str, unit: &str) -> String {
    match status {
        "lower_bound" => format!("above {low:.1} {unit}"),
        "upper_bound" => format!("below {high:.1} {unit}"),
        "not_identified" => format!("not identifiable ({low:.1} to {high:.1} {unit})"),
        _ => format!("{value:.1} ({low:.1} to {high:.1}) {unit}"),
    }
}
