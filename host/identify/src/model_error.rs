//! Model error in the intervals: what every rig and tissue leaves behind any model, beside the noise of the readings
//! (theory, eq. 29).
//!
//! The runs are fitted once more with the discrepancy of a diagnosis, the parameters of its effects and what is stated of the rig free
//! within their priors. Value and interval are those of this posterior, as in a diagnosis.

use super::fitting::NORMAL_975;
use super::options::TissueModel;
use super::{Fitted, FoundationChoice, NoiseAlone, Options, Pooled, RestsOn};
use diagnose::{
    DiscrepancyFitInput, DiscrepantModulus, FoundationEvidence, ModulusDraws, Moved, fit_with_discrepancy,
    modulus_interval_pa,
};
use formats::session::Session;
use mechanics::effects::Effect;

/// The runs that are used, fitted beside the discrepancy.
pub(super) struct DiscrepancyFits {
    /// As springs.
    pub springs: DiscrepantModulus,
    /// As a body, unless the tissue is stated to be springs.
    pub body: Option<Result<FoundationEvidence, String>>,
    /// Parameters of the rig that have changed.
    pub moved: Vec<Moved>,
    /// Draws on springs and in a body, where they were requested.
    pub draws: Option<(ModulusDraws, Option<ModulusDraws>)>,
}

/// Fits the runs that are used beside the discrepancy.
pub(super) fn fit(
    session: &Session,
    runs: &[Fitted],
    options: &Options,
    tissue: TissueModel,
) -> Result<DiscrepancyFits, String> {
    let (fitted_runs, fixed_effects) = for_diagnosis(session, runs, options)?;
    let body = (tissue.foundation != FoundationChoice::Springs).then_some(tissue.poisson);
    let (known_parameters, discrepancy) = (options.known.as_slice(), &options.discrepancy);
    let draws = options.draws;
    let input =
        DiscrepancyFitInput { given: &fixed_effects, known: known_parameters, discrepancy, body, draws };
    let discrepancy_fit = fit_with_discrepancy(&fitted_runs, &input).map_err(|why| why.to_string())?;
    let body = discrepancy_fit.body.map(|discrepancy_fit| discrepancy_fit.map_err(|why| why.to_string()));
    Ok(DiscrepancyFits {
        springs: discrepancy_fit.springs,
        body,
        moved: discrepancy_fit.moved,
        draws: discrepancy_fit.draws,
    })
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
    let diagnosis_session = Session {
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
    let unknown = runs.first().map(|run| run.data.effects.as_slice()).unwrap_or_default();
    let fixed_values =
        options
            .fixed
            .iter()
            .cloned()
            .chain(unknown.iter().map(|effect| {
                (*effect, effect.parameters().iter().map(|info| info.neutral).collect::<Vec<_>>())
            }))
            .collect();
    Ok((diagnosis_session, fixed_values))
}

/// Half-width of a 95 % interval of the logarithm of a modulus, model error in it. Noise alone has the longer one where the runs differ
/// by more than their noise, or where noise is hardly known.
pub(super) fn half_with_model_error(noise_half: f64, discrepant: DiscrepantModulus) -> f64 {
    noise_half.max(NORMAL_975 * discrepant.sd_ln)
}

impl Pooled {
    /// With the value and the interval of the posterior that has model error, and what is not exactly known of the rig, in it. The interval
    /// stays in the range of moduli of the table of unknowns, as that of a diagnosis.
    pub(super) fn with_model_error(mut self, discrepant: DiscrepantModulus) -> Self {
        let noise = NoiseAlone { k_kpa: self.k_kpa, sd_kpa: self.sd_kpa, ci95_kpa: self.ci95_kpa };
        let half = half_with_model_error(noise.half_ln(), discrepant);
        self.k_kpa = 1e-3 * discrepant.ln_pa.exp();
        let ends_pa = modulus_interval_pa([-half, half].map(|to| discrepant.ln_pa + to), 1e3 * self.k_kpa);
        self.ci95_kpa = ends_pa.map(|end_pa| 1e-3 * end_pa);
        self.sd_kpa = self.k_kpa * discrepant.sd_ln.max(noise.sd_kpa / noise.k_kpa);
        self.noise_alone = Some(noise);
        self.rests_on = discrepant
            .rests_on
            .map(|(assumption, share_of_variance)| RestsOn { assumption, share_of_variance });
        self
    }

    /// Half-width of a 95 % interval of ln K that model error adds to that of the noise.
    pub(super) fn model_error_ln(&self) -> f64 {
        let half = self.ci95_kpa.into_iter().map(|end| (end / self.k_kpa).ln().abs()).fold(0.0, f64::max);
        self.noise_alone.map_or(0.0, |noise| (half.powi(2) - noise.half_ln().powi(2)).max(0.0).sqrt())
    }

    /// K over what noise alone gives: what is not exactly known of the rig is the same at every depth.
    pub(super) fn over_noise_alone(&self) -> f64 {
        self.noise_alone.map_or(1.0, |noise| self.k_kpa / noise.k_kpa)
    }
}

impl NoiseAlone {
    /// Half-width of the 95 % interval of ln K.
    fn half_ln(&self) -> f64 {
        self.ci95_kpa.into_iter().map(|end| (end / self.k_kpa).ln().abs()).fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs with a shape that makes no sense determine the modulus to no better than a factor of billions.
    #[test]
    fn the_ends_of_the_interval_are_moduli_that_a_tissue_can_have() {
        let pooled = Pooled {
            k_kpa: 12.0,
            sd_kpa: 120.0,
            ci95_kpa: [1e-9, 4.5e11],
            noise_alone: None,
            rests_on: None,
            profile: None,
            bootstrap: None,
            nuisances: Vec::new(),
            runs: 1,
            heterogeneity: None,
        };
        let discrepant = DiscrepantModulus { ln_pa: 10e3_f64.ln(), sd_ln: 0.1, rests_on: None };
        let with_error = pooled.with_model_error(discrepant);
        let range_kpa = mechanics::unknowns::tissue::MODULUS.range.map(|end_pa| 1e-3 * end_pa);
        assert_eq!(with_error.ci95_kpa, range_kpa);
        assert!((with_error.k_kpa - 10.0).abs() < 1e-9);
    }
}
