//! Statistics over many sessions.
//!
//! | step | file |
//! |---|---|
//! | the record of a session, `needle.summary/1` | `summary` |
//! | records from files | `read` |
//! | levels of sessions from their labels | `levels` |
//! | nested random effects: sums over groups, restricted likelihood | `tree`, `nested` |
//! | uncertainty of all variances together | `components` |
//! | mean, spread of every level, prediction | `random_effects` |
//! | unusual sessions and groups | `predictive`, `outliers` |
//! | two rigs or methods on the same subjects | `agreement` |
//! | likelihood of an effect in groups of sessions | `sharing` |
//! | groups in which an effect may be shared, dates of a drift | `patterns` |
//! | search for effects that groups share, and drift | `search` |
//! | effects that vary, or are in single sessions | `spread` |
//! | everything together | `analysis`, `results`, `display` |
//! | prior for the next session | `prior` |
//!
//! Everything here works on the records, which `inference::summarize` makes: the measurements are not needed again.
//!
//! # Example
//!
//! ln K of six subjects, each with its variance: the mean with its interval, and the spread between subjects:
//!
//! ```
//! use population::{Observations, random_effects};
//!
//! let y: Vec<f64> = [10.0_f64, 11.5, 12.0, 12.4, 13.1, 14.0].iter().map(|k_kpa| k_kpa.ln()).collect();
//! let v = vec![0.02_f64.powi(2); y.len()];
//! let found = random_effects(&Observations { y, v, ..Observations::default() }).expect("a mean");
//! let [low, high] = found.mean.ci95;
//! assert!(low < found.mean.value && found.mean.value < high && (11.0..13.0).contains(&found.mean.value.exp()));
//! assert!((0.05..0.2).contains(&found.tau_total), "{}", found.tau_total);
//! ```
#![forbid(unsafe_code)]
#![deny(missing_docs)]

use statrs::distribution::{ContinuousCDF, Normal};

mod agreement;
mod analysis;
mod components;
mod display;
mod error;
mod levels;
mod nested;
mod outliers;
mod patterns;
mod predictive;
mod prior;
mod random_effects;
mod read;
mod records;
mod results;
mod search;
mod sharing;
mod spread;
mod summary;
mod tree;

pub use agreement::{Agreement, agreement};
pub use analysis::{Options, analyse};
pub use error::PopulationError;
pub use nested::{Nested, Observations};
pub use prior::prior_toml;
pub use random_effects::{Estimate, RandomEffects, Spread, random_effects};
pub use read::read_summaries;
pub use records::Records;
pub use results::*;
pub use summary::*;

/// Half-width of a 95 % interval of a normal distribution, in standard deviations.
pub(crate) fn normal_975() -> f64 {
    Normal::standard().inverse_cdf(0.975)
}
