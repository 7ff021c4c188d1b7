//! Interface of a forward model: parameters, sites, and a prediction.

use super::data::{Data, Run};
use super::form::Form;
use super::term::Terms;
use serde::{Deserialize, Serialize};

/// A quantity that every fit estimates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// Name.
    pub name: String,
    /// Unit, for reports.
    #[serde(default)]
    pub unit: String,
    /// Mean of its normal prior, and start of the fits.
    pub mean: f64,
    /// Standard deviation of the prior.
    pub sd: f64,
    /// Range; unbounded if `None`.
    #[serde(default)]
    pub range: Option<[f64; 2]>,
}

/// A quantity on which a law at a site may depend.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Regressor {
    /// Name: that of a column of the data if the workflow evaluates the law, else the name under which the model passes the values.
    pub name: String,
    /// Unit, for reports.
    #[serde(default)]
    pub unit: String,
    /// Range of its values; `None` for the range of the data, or of the values that the model passes.
    #[serde(default)]
    pub range: Option<[f64; 2]>,
    /// Standard deviation of the error of its values.
    #[serde(default)]
    pub resolution: f64,
    /// Whether laws with a history (a bristle, a play) may depend on it. The model evaluates such a law over whole series, in
    /// the order of time.
    #[serde(default)]
    pub history: bool,
}

/// A site: a place in the model at which a law may be missing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Site {
    /// Name.
    pub name: String,
    /// Unit of a law at this site, for reports.
    #[serde(default)]
    pub unit: String,
    /// Channel to which a law is added, with columns of the data as regressors; `None` if the model evaluates the law.
    #[serde(default)]
    pub adds_to: Option<String>,
    /// Quantities on which its laws may depend.
    pub regressors: Vec<Regressor>,
    /// Forms that are tried; if empty, all.
    #[serde(default)]
    pub forms: Vec<Form>,
}

/// Reason for which a model has no prediction.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ModelFailure {
    /// It failed at these values of the parameters; at others it may not.
    #[error("{0}")]
    Failed(String),
    /// It did not answer in time.
    #[error(
        "no answer within {limit_s} s; a longer time is stated by the option or argument for the time-out"
    )]
    Slow {
        /// The time-out.
        limit_s: f64,
    },
    /// Its process has ended, or does not follow the protocol.
    #[error("{0}")]
    Broken(String),
}

impl ModelFailure {
    /// Whether other values may work.
    pub fn is_of_these_values(&self) -> bool {
        matches!(self, Self::Failed(_))
    }
}

/// A forward model. It is deterministic and has no state: the same values give the same prediction.
pub trait ForwardModel: Sync {
    /// Quantities that every fit estimates.
    fn parameters(&self) -> &[Parameter];

    /// Places where laws may be missing.
    fn sites(&self) -> &[Site];

    /// The channels of a run in the order of its channels, one value per instant. A model with sites of its own adds
    /// [`Terms::value`] or [`Terms::add`] there.
    ///
    /// # Errors
    /// [`ModelFailure`] where it has no prediction.
    fn predict(
        &self,
        run: &Run,
        parameters: &[f64],
        terms: &Terms<'_>,
    ) -> Result<Vec<Vec<f64>>, ModelFailure>;

    /// Whether it is faster if several threads call it at once.
    fn is_parallel(&self) -> bool {
        true
    }
}

/// Reason for which no diagnosis is possible.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// The data cannot be used.
    #[error(transparent)]
    Data(#[from] super::data::DataError),
    /// An invalid declaration of parameters, sites or effects.
    #[error("{what} {name:?}: {problem}; expected {expected}")]
    Declaration {
        /// Kind of the declaration.
        what: &'static str,
        /// Its name.
        name: String,
        /// Its fault.
        problem: String,
        /// Valid declarations.
        expected: String,
    },
    /// The model has no prediction at values at which one is required.
    #[error("the model failed in run {run} at {values}: {cause}")]
    Model {
        /// Name of the run.
        run: String,
        /// Values of the parameters.
        values: String,
        /// Reason.
        cause: ModelFailure,
    },
    /// A prediction that is not finite.
    #[error(
        "the model predicts {value} in run {run}, channel {channel}, reading {reading} (at {time_s} s), at {values}"
    )]
    NotFinite {
        /// Name of the run.
        run: String,
        /// Name of the channel.
        channel: String,
        /// Number of the reading, from 1.
        reading: usize,
        /// Its instant.
        time_s: f64,
        /// The prediction.
        value: f64,
        /// Values of the parameters.
        values: String,
    },
    /// A prediction of another size.
    #[error("the model predicts {found} in run {run}; expected {expected}")]
    Size {
        /// Name of the run.
        run: String,
        /// Channels or values found.
        found: String,
        /// Those expected.
        expected: String,
    },
    /// A law at a site does not change the prediction.
    #[error(
        "site {site:?}: a law there changes no prediction; the model has to add the terms of this site in its equations"
    )]
    NoEffect {
        /// Name of the site.
        site: String,
    },
    /// The fit has no solution.
    #[error("the fit has no solution: the data determine nothing of the model ({0})")]
    Undetermined(String),
}

impl Error {
    /// Whether other values of the parameters may work.
    pub(crate) fn is_of_these_values(&self) -> bool {
        match self {
            Self::Model { cause, .. } => cause.is_of_these_values(),
            Self::NotFinite { .. } => true,
            _ => false,
        }
    }
}

fn fault(what: &'static str, name: &str, problem: String, expected: &str) -> Result<(), Error> {
    Err(Error::Declaration { what, name: name.to_owned(), problem, expected: expected.to_owned() })
}

/// Checks the declarations of a model against the data.
pub(crate) fn check(model: &dyn ForwardModel, data: &Data) -> Result<(), Error> {
    for (number, parameter) in model.parameters().iter().enumerate() {
        let Parameter { name, mean, sd, range, .. } = parameter;
        let is_used_twice = model.parameters().iter().skip(number + 1).any(|other| other.name == *name);
        if name.is_empty() || is_used_twice {
            return fault(
                "parameter",
                name,
                "the name is empty or used twice".to_owned(),
                "names of their own",
            );
        }
        if !(mean.is_finite() && sd.is_finite() && *sd > 0.0) {
            return fault(
                "parameter",
                name,
                format!("prior mean {mean}, sd {sd}"),
                "finite numbers, sd above 0",
            );
        }
        if range.is_some_and(|[least, most]| !(least <= *mean && *mean <= most && least < most)) {
            return fault(
                "parameter",
                name,
                format!("range {range:?}, mean {mean}"),
                "a range around the mean",
            );
        }
    }
    for (number, site) in model.sites().iter().enumerate() {
        if site.name.is_empty() || model.sites().iter().skip(number + 1).any(|other| other.name == site.name)
        {
            return fault(
                "site",
                &site.name,
                "the name is empty or used twice".to_owned(),
                "names of their own",
            );
        }
        for regressor in &site.regressors {
            let Regressor { name, range, resolution, .. } = regressor;
            if !(range.is_none_or(|[from, to]| from < to && from.is_finite() && to.is_finite())
                && resolution.is_finite()
                && *resolution >= 0.0)
            {
                let problem = format!("range {range:?}, resolution {resolution}");
                return fault(
                    "regressor",
                    name,
                    problem,
                    "a range from a lesser to a larger number, a resolution of 0 or more",
                );
            }
        }
        let Some(channel) = &site.adds_to else { continue };
        if !data.channels().iter().any(|one| one.name == *channel) {
            let names: Vec<&str> = data.channels().iter().map(|one| one.name.as_str()).collect();
            return fault(
                "site",
                &site.name,
                format!("adds to {channel:?}"),
                &format!("one of the channels {}", names.join(", ")),
            );
        }
        let first = data.runs().first();
        let unknown = site
            .regressors
            .iter()
            .find(|regressor| first.is_none_or(|run| run.column(&regressor.name).is_none()));
        if let Some(unknown) = unknown {
            let columns = first.map_or(&[][..], |run| run.columns.as_slice());
            let names: Vec<&str> = columns.iter().map(|column| column.name.as_str()).collect();
            let expected = format!("a column of the data: time_s, {}", names.join(", "));
            return fault("regressor", &unknown.name, "is no column".to_owned(), &expected);
        }
    }
    Ok(())
}
