//! Young's modulus from the needle in an elastic body, fitted to the same runs as the springs, and which of the two explains them
//! (theory, eq. 30).

use super::fitting::{Estimate, NORMAL_975, VARIED_ERROR, fit_alone};
use super::model_error::{DiscrepancyFits, half_with_model_error};
use super::options::TissueModel;
use super::{
    BodyResult, Fitted, FoundationChoice, FoundationResult, Layers, Options, Pooled, YoungsModulus, pool,
};
use diagnose::{DiscrepantModulus, VARIED_NATS, modulus_interval_pa};
use mechanics::Support;
use readings::{FitError, LateralData};

impl FoundationResult {
    /// Follows the choice of two layers where these are established and the tissue is not stated: what one modulus explains better as
    /// springs or as a body does not apply to tissue that has two.
    pub(super) fn with_layers(mut self, layers: Option<&Layers>, tissue: TissueModel) -> Self {
        let established = layers.filter(|found| found.established && found.body_log_evidence_gain.is_some());
        if let (Some(layers), FoundationChoice::Auto) = (established, tissue.foundation) {
            (self.used, self.by) = (layers.foundation, "layers");
        }
        self
    }

    /// Warning that the choice of the foundation assumes one modulus: the modulus varies with depth, and two layers do not
    /// decide between the foundations.
    pub(super) fn undecided(&self) -> Option<String> {
        let varied =
            self.log_evidence_of_varied.filter(|gain| self.by == "evidence" && *gain >= VARIED_NATS)?;
        let used = if self.used == "springs" { "springs" } else { "an elastic body" };
        Some(format!(
            "the choice of {used} assumes one modulus for all depths, but a modulus that varies with depth explains the runs better (log evidence \
             {varied:+.1}): K and E depend on this choice; compare both foundations with two layers (guide identify --layers), or search for the \
             missing effect (guide diagnose)"
        ))
    }

    /// Model of the tissue, its reason, and the result of the other foundation: one sentence each, for people.
    pub fn sentences(&self, springs: &Pooled, youngs: &YoungsModulus) -> Vec<String> {
        let is_body = self.body.as_ref().is_some_and(|body| self.used == body.support().name());
        let model_name = if is_body { "an elastic body" } else { "springs" };
        let why = match (self.log_evidence_gain, self.log_evidence_margin) {
            _ if self.by == "layers" => "by the evidence of two layers".to_owned(),
            (Some(gain), Some(margin)) => format!(
                "by evidence (log evidence of an elastic body over springs {gain:+.1} nats, more than {margin:+.1} needed)"
            ),
            _ if self.by == "stated" => "as stated".to_owned(),
            _ => "by default: an elastic body could not be compared with them".to_owned(),
        };
        let mut sentences = vec![format!("{model_name}, {why}")];
        let by_relation = youngs.relations.iter().find(|relation| relation.relation == "continuum");
        match &self.body {
            Some(_) if is_body => {
                let [low, high] = springs.ci95_kpa;
                let youngs = by_relation.map_or(String::new(), |relation| {
                    format!(", E {:.2} kPa by `{}`", relation.youngs_modulus_kpa, relation.relation)
                });
                sentences
                    .push(format!("as springs: K {:.2} ({low:.2} to {high:.2}) kPa{youngs}", springs.k_kpa));
            }
            Some(BodyResult { youngs_modulus_kpa, ci95_kpa: [low, high], poisson, poisson_sd }) => {
                sentences.push(format!(
                    "as an elastic body: E {youngs_modulus_kpa:.2} ({low:.2} to {high:.2}) kPa, Poisson's ratio {poisson} (sd {poisson_sd})"
                ));
            }
            None => {
                sentences
                    .extend(self.body_error.as_ref().map(|why| format!("as an elastic body: no fit: {why}")));
            }
        }
        sentences
    }
}

/// Relative error of the operator, at 95 %: table, interpolation and mesh.
const OPERATOR_ERROR: f64 = 1e-3;

/// The body fitted to the runs that the springs were fitted to, and which of the two is used; where that is the body also the runs
/// as of a body.
pub(super) fn compare(
    beside: Option<&Result<DiscrepancyFits, String>>,
    runs: &[Fitted],
    options: &Options,
    tissue: TissueModel,
    warnings: &mut Vec<String>,
) -> (FoundationResult, Option<Vec<Fitted>>) {
    let choice = tissue.foundation;
    let mut result = FoundationResult {
        used: Support::Springs.name(),
        by: if choice == FoundationChoice::Auto { "default" } else { "stated" },
        log_evidence_gain: None,
        log_evidence_margin: None,
        log_evidence_of_varied: None,
        body: None,
        body_error: None,
    };
    if choice == FoundationChoice::Springs {
        return (result, None);
    }
    let (body, of_body) = match body(runs, options, tissue, warnings) {
        Ok(found) => found,
        Err(why) => {
            warnings.push(format!("no Young's modulus from an elastic body: {why}"));
            // Springs are used though a body may have been stated.
            result.by = "default";
            result.body_error = Some(why.to_string());
            return (result, None);
        }
    };
    let evidence = match beside {
        Some(Ok(DiscrepancyFits { body: Some(evidence), .. })) => evidence.clone(),
        Some(Err(why)) => Err(why.clone()),
        Some(Ok(DiscrepancyFits { body: None, .. })) | None => Err("it was not fitted".to_owned()),
    };
    let body = match &evidence {
        Ok(evidence) if options.model_error => body.with_model_error(evidence.body),
        _ => body,
    };
    if choice == FoundationChoice::Body {
        result.used = body.support().name();
    } else {
        match evidence {
            Ok(evidence) => {
                result.by = "evidence";
                result.log_evidence_gain = Some(evidence.gain);
                result.log_evidence_margin = Some(evidence.margin);
                result.log_evidence_of_varied = Some(evidence.varied);
                if evidence.is_for_body() {
                    result.used = body.support().name();
                }
            }
            Err(why) => {
                warnings.push(format!("springs are used: an elastic body was not compared with them: {why}"));
                result.body_error = Some(why);
            }
        }
    }
    result.body = Some(body);
    let foundation = result.used;
    (result, Some(of_body).filter(|_| foundation == tissue.body().name()))
}

impl BodyResult {
    /// With model error in its interval, which stays in the range of moduli.
    fn with_model_error(mut self, discrepant: DiscrepantModulus) -> Self {
        let noise_kpa = self.youngs_modulus_kpa;
        let ln_ends = self.ci95_kpa.map(|kpa| {
            let by_data = (kpa / noise_kpa).ln();
            discrepant.ln_pa + half_with_model_error(by_data.abs(), discrepant).copysign(by_data)
        });
        let value_pa = discrepant.ln_pa.exp();
        self.ci95_kpa = modulus_interval_pa(ln_ends, value_pa).map(|end_pa| 1e-3 * end_pa);
        self.youngs_modulus_kpa = 1e-3 * value_pa;
        self
    }

    fn support(&self) -> Support {
        Support::half_space(self.poisson)
    }
}

/// The runs as of a body, each fitted by itself; where the noise of the shape is not stated it is that of these fits.
fn fitted(runs: &[Fitted], support: Support) -> Result<Vec<Fitted>, FitError> {
    runs.iter()
        .map(|run| {
            let mut data = LateralData { support, ..run.data.clone() };
            let single_fit = fit_alone(&mut data, run.known_shape_noise)?;
            if single_fit.at_bound.first() == Some(&true) {
                return Err(FitError::Undetermined);
            }
            let estimate = Estimate::of(&single_fit, run.known_noise);
            let (ln_k, variance) = (estimate.ln_k, estimate.sd_ln.powi(2));
            Ok(Fitted { data, ln_k, variance, ..run.clone() })
        })
        .collect()
}

/// Young's modulus of all runs, with what Poisson's ratio and the operator add to its interval.
fn body(
    runs: &[Fitted],
    options: &Options,
    tissue: TissueModel,
    warnings: &mut Vec<String>,
) -> Result<(BodyResult, Vec<Fitted>), FitError> {
    let TissueModel { poisson, poisson_sd, .. } = tissue;
    let plain = Options { profile: false, bootstrap: 0, ..options.clone() };
    let mut notes = Vec::new();
    let body_fits = fitted(runs, tissue.body())?;
    let pooled = pool::pool(&body_fits, &plain, &mut notes);
    warnings.extend(notes.into_iter().map(|note| format!("elastic body (read E for K): {note}")));
    let value = pooled.k_kpa;
    let mut by_poisson = 0.0;
    if let Some(alternative) = tissue.other_body() {
        // The stiffer the body sideways the softer the modulus that explains the runs.
        let alternative_fits = fitted(runs, alternative)?;
        by_poisson = NORMAL_975 * (pool::pool(&alternative_fits, &plain, &mut Vec::new()).k_kpa / value).ln();
    }
    let fixed = options.fixed.iter().map(|(effect, _)| effect.id());
    let operator = if fixed
        .chain(options.nuisances.iter().map(|n| n.id()))
        .any(|id| matches!(id, "tissue.layers" | "tissue.gradient"))
    {
        VARIED_ERROR
    } else {
        OPERATOR_ERROR
    };
    let result = BodyResult {
        youngs_modulus_kpa: value,
        ci95_kpa: pooled.ci95_kpa.map(|kpa| {
            let by_data = (kpa / value).ln();
            value * by_data.hypot(by_poisson).hypot(operator).copysign(by_data).exp()
        }),
        poisson,
        poisson_sd,
    };
    Ok((result, body_fits))
}
