//! A prediction with what many sessions predict of K, and without it beside.

use super::{InsertionResult, Options, PredictError, Prediction, predict_from, stated_or_lateral};
use crate::prior::PriorResult;
use formats::NORMAL_975;
use formats::prior_file::ModulusPrior;
use formats::session::Session;
use serde::Serialize;

/// Least standard deviation of ln K of a modulus that is stated without one.
const MIN_SD_LN: f64 = 1e-3;

/// A prior in a prediction.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PredictionPrior {
    /// The prior, and K of prior and data together, from which the insertions are predicted.
    #[serde(flatten)]
    pub modulus: PriorResult,
    /// What the check compares it with: `lateral` runs or a stated modulus, or the paths of the `insertions`.
    pub compared_with: &'static str,
    /// The insertions predicted without it, in the order of the session.
    pub without: Vec<WithoutPrior>,
}

/// An insertion that is predicted without the prior.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WithoutPrior {
    /// Its name.
    pub id: String,
    /// Vertical tip load at the depth up to which it was observed.
    pub tip_force_n: Option<f64>,
    /// Its 95 % interval.
    pub tip_force_ci95_n: Option<[f64; 2]>,
    /// Foundation modulus of this insertion, from its path too.
    pub k_kpa: Option<f64>,
    /// Its 95 % interval.
    pub k_ci95_kpa: Option<[f64; 2]>,
    /// Vertical tip position at the last depth.
    pub tip_y_mm: Option<f64>,
    /// Its 95 % band.
    pub band95_y_mm: Option<[f64; 2]>,
    /// Mean distance between predicted and measured tip beyond the observed part.
    pub mae_mm: Option<f64>,
    /// Distance at the last depth measured beyond the observed part.
    pub last_error_mm: Option<f64>,
}

impl WithoutPrior {
    fn of(one: &InsertionResult) -> Self {
        let learned = one.learned.as_ref();
        Self {
            id: one.id.clone(),
            tip_force_n: one.tip_force_n,
            tip_force_ci95_n: one.tip_force_ci95_n,
            k_kpa: learned.map(|learned| learned.k_kpa),
            k_ci95_kpa: learned.map(|learned| learned.k_ci95_kpa),
            tip_y_mm: one.tip_y_mm.last().copied(),
            band95_y_mm: one.lo95_y_mm.last().zip(one.hi95_y_mm.last()).map(|(low, high)| [*low, *high]),
            mae_mm: one.mae_mm,
            last_error_mm: one.last_error_mm,
        }
    }
}

/// Predicts without the prior, compares, and predicts with it where it does not contradict.
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
    let without = plain.insertions.iter().map(WithoutPrior::of).collect();
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
    result.prior = Some(PredictionPrior { modulus, compared_with, without });
    Ok(result)
}

/// The prior alone, from which every path then updates K; it is checked against K of the insertion that identifies it best.
fn of_paths(prior: &ModulusPrior, plain: &Prediction) -> PriorResult {
    let identified = plain.insertions.iter().filter_map(|one| one.learned.as_ref());
    let own = identified.filter(|learned| learned.k_status == "identified").map(|learned| {
        let [low, high] = learned.k_ci95_kpa;
        ((1e3 * learned.k_kpa).ln(), (high / low).ln() / (2.0 * NORMAL_975))
    });
    let own = own.filter(|(_, sd)| *sd > 0.0).min_by(|a, b| a.1.total_cmp(&b.1));
    let (checked, alone) = (PriorResult::new(prior, own), PriorResult::new(prior, None));
    // The paths are data of the prediction itself: they must not count twice.
    let with_prior = alone.with_prior.filter(|_| checked.used);
    PriorResult { with_prior, ..checked }
}
