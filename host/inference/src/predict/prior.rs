//! A prediction with a prior of K from many sessions, beside the prediction without it.

use super::tissue::stated_or_lateral;
use super::{Options, PredictError, Prediction, PredictionPrior, WithoutPrior, predict_from};
use formats::NORMAL_975;
use formats::prior_file::ModulusPrior;
use formats::session::Session;
use modulus::prior::PriorResult;

/// Standard deviation of ln K for a modulus that is stated without one.
const MIN_SD_LN: f64 = 1e-3;

/// Predicts without the prior, checks the prior against the data, and predicts with it if the two agree.
pub(super) fn predict_with(
    session: &Session,
    options: &Options,
    prior: &ModulusPrior,
) -> Result<Prediction, PredictError> {
    let options = Options { prior: None, ..options.clone() };
    let plain = predict_from(session, &options)?;
    let measured = stated_or_lateral(session, &options, &mut Vec::new())?;
    let measured =
        measured.map(|(foundation, sd_ln)| (foundation.modulus_pa(0.0).ln(), sd_ln.max(MIN_SD_LN)));
    let (modulus, compared_with) = match measured {
        Some(own) => (PriorResult::new(prior, Some(own)), "lateral"),
        None => (of_paths(prior, &plain), "insertions"),
    };
    let without_prior = plain.insertions.iter().map(WithoutPrior::of).collect();
    let mut result = match modulus.with_prior {
        Some(with) => {
            let modulus_pa = 1e3 * with.k_kpa;
            predict_from(
                session,
                &Options { modulus_pa: Some([modulus_pa, with.ln_k_sd * modulus_pa]), ..options },
            )?
        }
        None => plain,
    };
    result.prior = Some(PredictionPrior { modulus, compared_with, without: without_prior });
    Ok(result)
}

/// The prior alone, from which every path then updates K; it is checked against K of the insertion that identifies it best.
fn of_paths(prior: &ModulusPrior, plain: &Prediction) -> PriorResult {
    let identified = plain.insertions.iter().filter_map(|one| one.learned.as_ref());
    let identified_modulus = identified.filter(|learned| learned.k_status == "identified").map(|learned| {
        let [low, high] = learned.k_ci95_kpa;
        ((1e3 * learned.k_kpa).ln(), (high / low).ln() / (2.0 * NORMAL_975))
    });
    let most_precise = identified_modulus.filter(|(_, sd)| *sd > 0.0).min_by(|a, b| a.1.total_cmp(&b.1));
    let (checked, alone) = (PriorResult::new(prior, most_precise), PriorResult::new(prior, None));
    // The paths are data of the prediction itself, so that they must not enter its prior too.
    let with_prior = alone.with_prior.filter(|_| checked.used);
    PriorResult { with_prior, ..checked }
}
