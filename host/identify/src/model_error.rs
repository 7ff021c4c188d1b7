//! Model error in the intervals: what every rig and tissue leaves behind any model, beside the noise of the readings
//! (theory, eq. 29).
//!
//! The runs are fitted once more with the discrepancy of a diagnosis, the parameters of its effects free within their priors.
//! The value stays that of the likelihood of the noise; the interval reaches as far as noise and discrepancy together, and as far as the
//! two fits differ.

use super::fitting::NORMAL_975;
use super::options::TissueModel;
use super::{Fitted, FoundationChoice, NoiseAlone, Options, Pooled};
use diagnose::{DiscrepancyFitInput, DiscrepantModulus, FoundationEvidence, Moved, fit_with_discrepancy};
use formats::session::Session;
use mechanics::effects::Effect;

/// The runs that are used, fitted beside the discrepancy.
pub(super) struct DiscrepancyFits {
    /// As springs.
    pub springs: DiscrepantModulus,
    /// As a body, unless the tissue is stated to be springs.
    pub body: Option<Result<FoundationEvidence, String>>,
    /// What of the rig is not what it was.
    pub moved: Vec<Moved>,
}

/// Fits the runs that are used beside the discrepancy.
pub(super) fn fit(
    session: &Session,
    runs: &[Fitted],
    options: &Options,
    tissue: TissueModel,
) -> Result<DiscrepancyFits, String> {
    let (used, given) = for_diagnosis(session, runs, options)?;
    let body = (tissue.foundation != FoundationChoice::Springs).then_some(tissue.poisson);
    let (known, discrepancy) = (options.known.as_slice(), &options.discrepancy);
    let input = DiscrepancyFitInput { given: &given, known, discrepancy, body };
    let found = fit_with_discrepancy(&used, &input).map_err(|why| why.to_string())?;
    let body = found.body.map(|found| found.map_err(|why| why.to_string()));
    Ok(DiscrepancyFits { springs: found.springs, body, moved: found.moved })
}

/// Effects with first values of their parameters.
pub(super) type Given = Vec<(&'static dyn Effect, Vec<f64>)>;

/// The runs that are used, and the effects that are in the model, as a diagnosis takes them.
///
/// # Errors
/// Why these runs cannot be fitted beside the discrepancy of a diagnosis.
pub(super) fn for_diagnosis(
    session: &Session,
    runs: &[Fitted],
    options: &Options,
) -> Result<(Session, Given), String> {
    if !session.rig.needle.stiffness_known {
        return Err("the needle's bending stiffness is not known".to_owned());
    }
    let lateral = session.lateral.iter().filter(|run| runs.iter().any(|used| used.id == run.id)).cloned();
    let used = Session {
        dir: session.dir.clone(),
        name: None,
        rig: session.rig.clone(),
        fixture_mass_kg: None,
        noise: session.noise,
        tissue: session.tissue,
        lateral: lateral.collect(),
        insertion: Vec::new(),
        indentation: Vec::new(),
        steering: Vec::new(),
    };
    let neutral = |effect: &&'static dyn Effect| {
        (*effect, effect.parameters().iter().map(|info| info.neutral).collect::<Vec<_>>())
    };
    let unknown = runs.first().map(|run| run.data.effects.as_slice()).unwrap_or_default();
    let given = options.fixed.iter().cloned().chain(unknown.iter().map(neutral)).collect();
    Ok((used, given))
}

/// The half-width of a 95 % interval of the logarithm of a modulus and its standard deviation, with model error.
pub(super) fn with_model_error(ln_pa: f64, noise: [f64; 2], discrepant: DiscrepantModulus) -> [f64; 2] {
    let [half, sd] = noise;
    let sd_ln = discrepant.sd_ln.hypot(discrepant.ln_pa - ln_pa);
    [half.max(NORMAL_975 * sd_ln), sd.max(sd_ln)]
}

impl Pooled {
    /// With model error in its interval.
    pub(super) fn with_model_error(mut self, discrepant: DiscrepantModulus) -> Self {
        let noise = NoiseAlone { sd_kpa: self.sd_kpa, ci95_kpa: self.ci95_kpa };
        let ends = self.ci95_kpa.map(|end| (end / self.k_kpa).ln().abs());
        let half = ends.into_iter().fold(0.0, f64::max);
        let [half, sd] =
            with_model_error((1e3 * self.k_kpa).ln(), [half, self.sd_kpa / self.k_kpa], discrepant);
        self.ci95_kpa = [self.k_kpa * (-half).exp(), self.k_kpa * half.exp()];
        self.sd_kpa = self.k_kpa * sd;
        self.noise_alone = Some(noise);
        self
    }

    /// Half-width of a 95 % interval of ln K that model error adds to that of the noise.
    pub(super) fn model_error_ln(&self) -> f64 {
        let half =
            |ends: [f64; 2]| ends.into_iter().map(|end| (end / self.k_kpa).ln().abs()).fold(0.0, f64::max);
        let added = |noise: NoiseAlone| half(self.ci95_kpa).powi(2) - half(noise.ci95_kpa).powi(2);
        self.noise_alone.map_or(0.0, |noise| added(noise).max(0.0).sqrt())
    }
}
