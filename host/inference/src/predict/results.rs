//! The result of a prediction, as `guide predict --json` prints it. Fields may be added, but never removed or changed in
//! meaning.

mod grid;
mod learned;
mod measured;

pub(super) use grid::Grid;
pub use learned::{LearnedResult, RearResult};
pub(super) use measured::Measured;

use formats::NORMAL_975;
use formats::session::InsertionRun;
use modulus::prior::PriorResult;
use readings::draws::Draws;
use serde::Serialize;

/// Name and version of this form.
pub(super) const SCHEMA: &str = "guide.predict/2";

const NORMAL_95: f64 = 1.644_853_626_951_472_7;

/// Every insertion of a session, predicted.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Prediction {
    /// Name and version of this form.
    pub schema: &'static str,
    /// Name of the session.
    pub session: Option<String>,
    /// Prior of K from many sessions, and the prediction without it; `None` if it was not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub prior: Option<PredictionPrior>,
    /// The models over which it is averaged, with their probabilities; empty for a single model.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub models: Vec<ModelResult>,
    /// In the order of the session.
    pub insertions: Vec<InsertionResult>,
    /// Warnings about the session.
    pub warnings: Vec<String>,
    /// Draws from the posterior, where they were requested.
    #[serde(skip)]
    pub draws: Option<Draws>,
}

/// A prior in a prediction.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PredictionPrior {
    /// The prior, and the posterior of K that the insertions are predicted with.
    #[serde(flatten)]
    pub modulus: PriorResult,
    /// Reference of the check: `lateral` runs or a stated modulus, or the paths of the `insertions`.
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
    pub(super) fn of(one: &InsertionResult) -> Self {
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

impl Prediction {
    /// Warnings about the session, then about its insertions: each message once, with the insertions that it concerns.
    pub fn messages(&self) -> Vec<String> {
        let mut messages: Vec<(&str, Vec<&str>)> = Vec::new();
        for one in &self.insertions {
            for warning in &one.warnings {
                match messages.iter_mut().find(|(text, _)| text == warning) {
                    Some((_, ids)) => ids.push(&one.id),
                    None => messages.push((warning, vec![&one.id])),
                }
            }
        }
        let predicted = self.insertions.iter().filter(|one| one.error.is_none()).count();
        self.warnings
            .iter()
            .cloned()
            .chain(messages.into_iter().map(|(text, ids)| {
                if ids.len() == predicted && predicted > 2 {
                    format!("all {predicted} insertions: {text}")
                } else {
                    format!("{}: {text}", ids.join(", "))
                }
            }))
            .collect()
    }
}

/// One of the models over which a prediction is averaged.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ModelResult {
    /// Ids of its effects.
    pub effects: Vec<String>,
    /// Its probability.
    pub probability: f64,
}

/// One insertion. Lists have one value per depth; the horizontal plane is `null` where it was not measured.
#[derive(Debug, Clone, PartialEq, Serialize, Default)]
pub struct InsertionResult {
    /// Its name.
    pub id: String,
    /// Depth up to which it was observed.
    pub identified_until_mm: f64,
    /// Vertical tip load at that depth, before the needle was turned.
    pub tip_force_n: Option<f64>,
    /// Its standard deviation.
    pub tip_force_sd_n: Option<f64>,
    /// Its 95 % interval, marginal over all other unknowns.
    pub tip_force_ci95_n: Option<[f64; 2]>,
    /// Horizontal tip load at that depth.
    pub tip_force_x_n: Option<f64>,
    /// Its standard deviation.
    pub tip_force_x_sd_n: Option<f64>,
    /// Its 95 % interval.
    pub tip_force_x_ci95_n: Option<[f64; 2]>,
    /// Every millimetre from 0 to the last depth.
    pub depth_mm: Vec<f64>,
    /// Vertical tip position: smoothed in the observed part, predicted beyond it.
    pub tip_y_mm: Vec<f64>,
    /// Lower end of the 95 % predictive band of the measured position (the median of the readings there).
    pub lo95_y_mm: Vec<f64>,
    /// Upper end of its 95 % band.
    pub hi95_y_mm: Vec<f64>,
    /// Median of the rows within 1.3 mm of the depth.
    pub measured_y_mm: Vec<Option<f64>>,
    /// Horizontal tip position.
    pub tip_x_mm: Option<Vec<f64>>,
    /// Lower end of its 95 % band.
    pub lo95_x_mm: Option<Vec<f64>>,
    /// Upper end of its 95 % band.
    pub hi95_x_mm: Option<Vec<f64>>,
    /// Median of the rows within 1.3 mm of the depth.
    pub measured_x_mm: Option<Vec<Option<f64>>>,
    /// Tip load against depth, vertical.
    pub load_y: PlaneResult,
    /// Tip load against depth, horizontal.
    pub load_x: Option<PlaneResult>,
    /// Mean distance between predicted and measured tip beyond the observed part, over the depths measured.
    pub mae_mm: Option<f64>,
    /// Distance at the last depth measured beyond the observed part.
    pub last_error_mm: Option<f64>,
    /// Last measured depth.
    pub last_measured_mm: Option<f64>,
    /// Measured values beyond the observed part, of both planes.
    pub band_readings: usize,
    /// Number of these values in their 95 % band.
    pub band_held: usize,
    /// Posterior of rig and tissue.
    pub learned: Option<LearnedResult>,
    /// Predictions of other methods from the same data.
    pub compare: Vec<CompareResult>,
    /// Warnings about this insertion.
    pub warnings: Vec<String>,
    /// Why it was skipped.
    pub error: Option<String>,
}

/// A value with its standard deviation at every depth.
#[derive(Debug, Clone, PartialEq, Serialize, Default)]
pub struct PlaneResult {
    /// Force.
    pub force_n: Vec<f64>,
    /// Its standard deviation.
    pub sd_n: Vec<f64>,
}

/// Another method's prediction.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CompareResult {
    /// `quadratic`, `cubic`, `bicycle`, `mean-of-others` or `published`.
    pub method: &'static str,
    /// Its tip load, vertical and horizontal, where it has one.
    pub tip_force_n: Option<Vec<f64>>,
    /// As in [`InsertionResult::mae_mm`].
    pub mae_mm: Option<f64>,
    /// As in [`InsertionResult::last_error_mm`].
    pub last_error_mm: Option<f64>,
    /// Vertical tip position.
    pub tip_y_mm: Vec<f64>,
    /// Horizontal tip position.
    pub tip_x_mm: Option<Vec<f64>>,
}

impl CompareResult {
    pub(super) fn new(method: &'static str, grid: &Grid, planes_m: Vec<Vec<f64>>) -> Self {
        let mut planes = planes_m.into_iter().map(|path_m| -> Vec<f64> {
            path_m.into_iter().take(grid.depth_m.len()).map(|u_m| 1e3 * u_m).collect()
        });
        let tip_y_mm = planes.next().unwrap_or_default();
        let tip_x_mm = planes.next();
        let (mae_mm, last_error_mm) = grid.measured().errors(&tip_y_mm, tip_x_mm.as_deref());
        Self { method, tip_force_n: None, mae_mm, last_error_mm, tip_y_mm, tip_x_mm }
    }
}

impl InsertionResult {
    /// An insertion that could not be predicted.
    pub(super) fn failed(run: &InsertionRun, until_m: f64, why: String) -> Self {
        Self { id: run.id.clone(), identified_until_mm: 1e3 * until_m, error: Some(why), ..Self::default() }
    }
}
