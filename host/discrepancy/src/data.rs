//! Measurements: runs of named channels and known columns, and the choice of held-out runs.

use super::model::ModelFailure;
use serde::{Deserialize, Serialize};

/// Smallest number of readings of a channel that a fit needs.
const MIN_READINGS: usize = 16;

/// Values of one sensor in a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Channel {
    /// Name, the same in all runs.
    pub name: String,
    /// Unit, for reports.
    #[serde(default)]
    pub unit: String,
    /// One value per instant; NaN where the sensor has none.
    pub values: Vec<f64>,
    /// Relative standard deviations of the readings; their common scale is estimated. `None` if they are equal.
    #[serde(default)]
    pub sds: Option<Vec<f64>>,
}

/// Known values that the model does not predict: an input, a position, a regressor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Column {
    /// Name, the same in all runs.
    pub name: String,
    /// Unit, for reports.
    #[serde(default)]
    pub unit: String,
    /// One value per instant.
    pub values: Vec<f64>,
}

/// One experiment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Run {
    /// Name, for reports and messages.
    pub name: String,
    /// Instants in seconds, increasing.
    pub time_s: Vec<f64>,
    /// Channels that the model predicts.
    pub channels: Vec<Channel>,
    /// Columns of known values.
    #[serde(default)]
    pub columns: Vec<Column>,
    /// Whether the run is held out of all fits, to judge them.
    #[serde(default)]
    pub judges: bool,
}

impl Run {
    /// Values of a known column, `time_s` among them.
    pub fn column(&self, name: &str) -> Option<&[f64]> {
        if name == TIME {
            return Some(&self.time_s);
        }
        self.columns.iter().find(|column| column.name == name).map(|column| column.values.as_slice())
    }

    /// Values of a known column that a model needs.
    ///
    /// # Errors
    /// [`ModelFailure::Failed`] where there is none of this name.
    pub fn needed(&self, name: &str) -> Result<&[f64], ModelFailure> {
        self.column(name).ok_or_else(|| ModelFailure::Failed(format!("no column {name:?}")))
    }

    /// Values of a channel.
    pub fn channel(&self, name: &str) -> Option<&[f64]> {
        self.channels.iter().find(|channel| channel.name == name).map(|channel| channel.values.as_slice())
    }
}

/// Name of the column of times, which every run has.
pub const TIME: &str = "time_s";

/// Why data cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DataError {
    /// No run can be fitted.
    #[error("there is no run to fit: {0}; at least one run must not be held out")]
    NoRuns(&'static str),
    /// A run has other channels or columns than the first.
    #[error("run {run}: its {what} are {found}, those of run {first} {expected}")]
    Unlike {
        /// Name of the run.
        run: String,
        /// Name of the run that it is compared with.
        first: String,
        /// Channels or columns.
        what: &'static str,
        /// Names of this run.
        found: String,
        /// Names of the first.
        expected: String,
    },
    /// A name is used twice, or is empty.
    #[error("run {run}: the name {name:?} is empty or used twice")]
    Name {
        /// Name of the run.
        run: String,
        /// The name.
        name: String,
    },
    /// A column of another length.
    #[error("run {run}, {column}: {found} values for {expected} instants")]
    Length {
        /// Name of the run.
        run: String,
        /// Name of the channel or column.
        column: String,
        /// Its length.
        found: usize,
        /// Number of instants.
        expected: usize,
    },
    /// An impossible value.
    #[error("run {run}, {column}, reading {reading}: {value}; expected {expected}")]
    Value {
        /// Name of the run.
        run: String,
        /// Name of the channel or column.
        column: String,
        /// Number of the reading, from 1.
        reading: usize,
        /// The value.
        value: f64,
        /// Valid values.
        expected: &'static str,
    },
    /// Too little to fit.
    #[error("channel {channel}: {found} readings in the runs to fit; at least {MIN_READINGS} are needed")]
    TooFew {
        /// Name of the channel.
        channel: String,
        /// Number of readings.
        found: usize,
    },
    /// A channel does not vary.
    #[error("channel {channel} has one value only: there is nothing to explain")]
    Constant {
        /// Name of the channel.
        channel: String,
    },
}

/// Runs that have passed the checks.
#[derive(Debug, Clone, PartialEq)]
pub struct Data {
    runs: Vec<Run>,
}

impl Data {
    /// Takes runs with the same channels and columns.
    ///
    /// # Errors
    /// [`DataError`] with run, column and reading.
    pub fn new(runs: Vec<Run>) -> Result<Self, DataError> {
        let first = runs.first().ok_or(DataError::NoRuns("there are none at all"))?;
        if first.channels.is_empty() {
            return Err(DataError::NoRuns("they have no channel"));
        }
        if runs.iter().all(|run| run.judges) {
            return Err(DataError::NoRuns("all of them are held out"));
        }
        for run in &runs {
            check_names(run, first)?;
            check_values(run)?;
        }
        let data = Self { runs };
        for (channel, one) in data.channels().iter().enumerate() {
            let values: Vec<f64> = data.training().flat_map(|run| readings(run, channel)).collect();
            if values.len() < MIN_READINGS {
                return Err(DataError::TooFew { channel: one.name.clone(), found: values.len() });
            }
            if data.scale(channel) == 0.0 {
                return Err(DataError::Constant { channel: one.name.clone() });
            }
        }
        Ok(data)
    }

    /// All runs.
    pub fn runs(&self) -> &[Run] {
        &self.runs
    }

    /// The runs that are fitted.
    pub fn training(&self) -> impl Iterator<Item = &Run> {
        self.runs.iter().filter(|run| !run.judges)
    }

    /// The runs that are held out.
    pub fn held_out(&self) -> impl Iterator<Item = &Run> {
        self.runs.iter().filter(|run| run.judges)
    }

    /// The channels, as the first run has them.
    pub fn channels(&self) -> &[Channel] {
        self.runs.first().map_or(&[], |run| run.channels.as_slice())
    }

    /// Standard deviation of a channel around its mean over the runs that are fitted.
    pub fn scale(&self, channel: usize) -> f64 {
        let values: Vec<f64> = self.training().flat_map(|run| readings(run, channel)).collect();
        let count = values.len().max(1) as f64;
        let mean = values.iter().sum::<f64>() / count;
        (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count).sqrt()
    }
}

/// Readings of a channel, without the missing ones.
fn readings(run: &Run, channel: usize) -> impl Iterator<Item = f64> {
    let values = run.channels.get(channel).map_or(&[][..], |channel| channel.values.as_slice());
    values.iter().copied().filter(|value| value.is_finite())
}

fn channel_names(run: &Run) -> Vec<String> {
    run.channels.iter().map(|channel| channel.name.clone()).collect()
}

fn column_names(run: &Run) -> Vec<String> {
    run.columns.iter().map(|column| column.name.clone()).collect()
}

fn check_names(run: &Run, first: &Run) -> Result<(), DataError> {
    let pairs = [
        ("channels", channel_names(run), channel_names(first)),
        ("columns", column_names(run), column_names(first)),
    ];
    for (what, found, expected) in &pairs {
        if found != expected {
            return Err(DataError::Unlike {
                run: run.name.clone(),
                first: first.name.clone(),
                what,
                found: found.join(", "),
                expected: expected.join(", "),
            });
        }
    }
    let [(_, channels, _), (_, columns, _)] = pairs;
    let names: Vec<String> = channels.into_iter().chain(columns).chain([TIME.to_owned()]).collect();
    match names.iter().enumerate().find(|(i, name)| name.is_empty() || names[..*i].contains(name)) {
        Some((_, name)) => Err(DataError::Name { run: run.name.clone(), name: name.clone() }),
        None => Ok(()),
    }
}

fn check_length(run: &Run, column: &str, found: usize) -> Result<(), DataError> {
    let expected = run.time_s.len();
    if found == expected {
        return Ok(());
    }
    Err(DataError::Length { run: run.name.clone(), column: column.to_owned(), found, expected })
}

fn check_values(run: &Run) -> Result<(), DataError> {
    let fault = |column: &str, reading: usize, value: f64, expected: &'static str| DataError::Value {
        run: run.name.clone(),
        column: column.to_owned(),
        reading: reading + 1,
        value,
        expected,
    };
    if let Some((i, value)) = run.time_s.iter().enumerate().find(|(_, value)| !value.is_finite()) {
        return Err(fault(TIME, i, *value, "a finite number"));
    }
    if let Some(i) = run.time_s.windows(2).position(|pair| pair[1] <= pair[0]) {
        return Err(fault(TIME, i + 1, run.time_s[i + 1], "an instant after the one before"));
    }
    for channel in &run.channels {
        check_length(run, &channel.name, channel.values.len())?;
        if let Some((i, value)) = channel.values.iter().enumerate().find(|(_, value)| value.is_infinite()) {
            return Err(fault(&channel.name, i, *value, "a finite number, or NaN where there is no reading"));
        }
        let Some(sds) = &channel.sds else { continue };
        check_length(run, &format!("{} (sds)", channel.name), sds.len())?;
        if let Some((i, sd)) = sds.iter().enumerate().find(|(_, sd)| !(sd.is_finite() && **sd > 0.0)) {
            return Err(fault(&channel.name, i, *sd, "a standard deviation above 0"));
        }
    }
    for column in &run.columns {
        check_length(run, &column.name, column.values.len())?;
        if let Some((i, value)) = column.values.iter().enumerate().find(|(_, value)| !value.is_finite()) {
            return Err(fault(&column.name, i, *value, "a finite number"));
        }
    }
    Ok(())
}
