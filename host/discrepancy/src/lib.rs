//! Diagnosis of any forward model by measurements: the regions where model and data disagree, the missing law, and the reduction of the
//! misfit by that law.
//!
//! The four steps are those that a laboratory would take by hand:
//!
//! | step | by |
//! |---|---|
//! | where do they differ? | regions in which the residuals exceed noise and small imperfections ([`Report::regions`]) |
//! | what is missing? | a law consists of a site in the model, a regressor on which it depends, and a [`Form`]; every combination is scored, and the best are fitted |
//! | add | sets of laws are weighted by their evidence; each law needs a probability of 95 %, and held-out runs have to confirm it |
//! | by how much does the misfit shrink? | in the runs that were fitted and in those that were not |
//!
//! Residuals of real rigs are correlated in time, and no model is exact: every fit contains autocorrelated noise, and a
//! discrepancy of small functions of every regressor, whose sizes maximize the evidence. Therefore intervals have their coverage,
//! and a small discrepancy is not named as a law.
//!
//! # Example
//!
//! The model of a mass on a rail has only viscous friction:
//!
//! ```
//! use discrepancy::*;
//!
//! let parameter = |name: &str, mean| Parameter { name: name.into(), unit: String::new(), mean, sd: mean, range: None };
//! let speed = Regressor { name: "speed".into(), unit: "m/s".into(), range: None, resolution: 0.0, history: false };
//! let friction = Site {
//!     name: "friction".into(),
//!     unit: "N".into(),
//!     adds_to: Some("force".into()),
//!     regressors: vec![speed],
//!     forms: Vec::new(),
//! };
//! let parameters = vec![parameter("mass", 2.0), parameter("viscous", 1.0)];
//! let model = FunctionModel::new(parameters, vec![friction], |run: &Run, parameters: &[f64], _: &Terms<'_>| {
//!     let pairs = run.needed("acceleration")?.iter().zip(run.needed("speed")?);
//!     Ok(vec![pairs.map(|(a, v)| parameters[0] * a + parameters[1] * v).collect()])
//! });
//!
//! // Two runs of a rail of 2.2 kg and 0.8 N s/m with 0.5 N of dry friction, which the model does not have.
//! let run = |name: &str, hz: f64, judges| {
//!     let time_s: Vec<f64> = (0..400).map(|i| 0.01 * f64::from(i)).collect();
//!     let speed: Vec<f64> = time_s.iter().map(|t| (hz * t).sin() + 0.3 * (2.3 * hz * t).sin()).collect();
//!     let rate = |t: f64| hz * (hz * t).cos() + 0.69 * hz * (2.3 * hz * t).cos();
//!     let acceleration: Vec<f64> = time_s.iter().map(|t| rate(*t)).collect();
//!     let noise = |i: usize| 0.05 * ((i * i * 7919 % 1009) as f64 / 504.5 - 1.0);
//!     let force = |(i, (a, v)): (usize, (&f64, &f64))| 2.2 * a + 0.8 * v + 0.5 * v.signum() + noise(i);
//!     let values = acceleration.iter().zip(&speed).enumerate().map(force).collect();
//!     let column = |name: &str, values| Column { name: name.into(), unit: String::new(), values };
//!     Run {
//!         name: name.into(),
//!         channels: vec![Channel { name: "force".into(), unit: "N".into(), values, sds: None }],
//!         columns: vec![column("acceleration", acceleration), column("speed", speed)],
//!         time_s,
//!         judges,
//!     }
//! };
//! let data = Data::new(vec![run("slow", 3.0, false), run("fast", 4.0, true)])?;
//! let report = diagnose(&model, &data, &Options::default(), &|_| ())?;
//! assert_eq!(report.terms[0].law.id(), "friction/speed/sign");
//! # Ok::<(), discrepancy::Error>(())
//! ```
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod basis;
mod bench;
mod data;
mod display;
pub mod evidence;
mod fit;
mod form;
mod function;
mod judge;
mod made;
mod model;
mod noise;
mod parts;
pub mod process;
pub mod regions;
mod report;
mod rivals;
mod score;
mod search;
mod sums;
mod table;
mod term;
pub mod weights;

pub use data::{Channel, Column, Data, DataError, Run, TIME};
pub use form::{Form, Shape, Span};
pub use function::FunctionModel;
pub use judge::Judgement;
pub use model::{Error, ForwardModel, ModelFailure, Parameter, Regressor, Site};
pub use report::{
    ChannelReport, DiscrepancyReport, Estimate, LawName, Misfit, NoiseReport, ParameterReport, PartReport,
    RefusedReport, Report, Rival, TermReport, Verdict,
};
pub use score::Effect;
pub use table::TableError;
pub use term::{Ranges, Term, Terms};

use basis::Basis;
use bench::Bench;
use fit::Fitted;
use search::{Search, final_values, plain};

/// Passes of the search: in the second the discrepancy is computed around the model that the first has found.
const PASSES: usize = 2;

/// Settings of a diagnosis.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Typical size of the discrepancy of an adequate model: the effect of each regressor on the channels, as a fraction of their
    /// standard deviations. The default of 1 % is that of ordinary sensors and drives.
    pub everyday: f64,
    /// Laws that are tried; if empty, all that the sites allow.
    pub effects: Vec<Effect>,
}

impl Default for Options {
    fn default() -> Self {
        Self { everyday: 0.01, effects: Vec::new() }
    }
}

/// Diagnoses a model with data. `on_step` receives a line about each step.
///
/// # Errors
/// [`Error`] if model and data do not fit together, or the model fails at its prior means.
pub fn diagnose(
    model: &dyn ForwardModel,
    data: &Data,
    options: &Options,
    on_step: &(dyn Fn(&str) + Sync),
) -> Result<Report, Error> {
    if !(options.everyday.is_finite() && options.everyday > 0.0) {
        return Err(Error::Declaration {
            what: "option",
            name: "everyday".to_owned(),
            problem: format!("is {}", options.everyday),
            expected: "a fraction above 0".to_owned(),
        });
    }
    on_step("checking the model");
    let bench = Bench::new(model, data)?;
    let candidates = score::candidates(&bench, &options.effects);
    if candidates.is_empty() {
        return Err(Error::Declaration {
            what: "sites",
            name: String::new(),
            problem: "no law can be tried".to_owned(),
            expected: "a site with a form that effects do not exclude".to_owned(),
        });
    }
    on_step("fitting the plain model");
    let (mut basis, base) = plain(&bench, options.everyday)?;
    let mut outcome =
        Search { bench: &bench, basis: &basis, candidates: &candidates, on_step }.run(base.clone())?;
    for _ in 1..PASSES {
        if outcome.fitted.laws.is_empty() {
            break;
        }
        basis = Basis::of_search(&bench, &outcome.fitted, options.everyday)?;
        let start = Fitted::new(&bench, &basis, &outcome.fitted.laws, &outcome.fitted.start())?;
        outcome = Search { bench: &bench, basis: &basis, candidates: &candidates, on_step }.run(start)?;
    }
    on_step("writing the report");
    let (_, base) = final_values(&bench, &base, options.everyday)?;
    let (final_basis, outcome) = outcome.with_final_values(&bench, options.everyday)?;
    made::report(&bench, [&basis, &final_basis], &base, &outcome, candidates.len())
}
