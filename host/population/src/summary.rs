//! The record of one session, `needle.summary/1`: one JSON document on one line, small and complete.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use time::Date;

/// Name and version of this form.
pub const SUMMARY_SCHEMA: &str = "needle.summary/1";

/// Summary of a session. A summary with `error` has no other content of the measurement. `S` are the names that come
/// back in every record: a reader of many of them leaves them in the text.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(bound(deserialize = "S: Deserialize<'de> + Ord"))]
pub struct Summary<S = String> {
    /// Name and version of this form.
    pub schema: String,
    /// Its folder, as it was given: each session once.
    pub session: String,
    /// Version of the program that wrote it.
    pub program: String,
    /// Name of the session.
    pub name: Option<String>,
    /// Day of the measurement, `2026-03-01`.
    pub date: Option<String>,
    /// Place of the measurement.
    pub site: Option<String>,
    /// Phantom, animal or patient.
    pub subject: Option<String>,
    /// Name of the rig.
    pub rig: Option<String>,
    /// Name of the needle.
    pub needle: Option<String>,
    /// Name of the tissue.
    pub tissue: Option<String>,
    /// Covariates by name: numbers or texts.
    #[serde(default)]
    pub covariates: BTreeMap<String, Value>,
    /// Why there is no result.
    pub error: Option<String>,
    /// Result of the session.
    pub result: Option<SessionResult<S>>,
}

/// A covariate's value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
// Not read as `untagged`: that fails for numbers where any package of a build has `serde_json/arbitrary_precision`.
#[serde(untagged, try_from = "serde_json::Value")]
pub enum Value {
    /// A number.
    Number(f64),
    /// A category.
    Text(String),
}

impl TryFrom<serde_json::Value> for Value {
    type Error = String;

    fn try_from(value: serde_json::Value) -> Result<Self, String> {
        match &value {
            serde_json::Value::Number(number) => number.as_f64().map(Self::Number),
            serde_json::Value::String(text) => Some(Self::Text(text.clone())),
            _ => None,
        }
        .ok_or_else(|| format!("covariate {value}, expected a number or a text"))
    }
}

/// Result of a session.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(bound(deserialize = "S: Deserialize<'de> + Ord"))]
pub struct SessionResult<S = String> {
    /// `adequate`, `named`, `ambiguous` or `unexplained`.
    pub verdict: String,
    /// `springs` or `body`: what the tissue was taken for.
    pub foundation: String,
    /// Foundation modulus K under the final model.
    pub k_kpa: f64,
    /// Its 95 % interval.
    pub k_ci95_kpa: [f64; 2],
    /// Logarithm of K in kilopascals; where competing effects leave K ambiguous, the middle of the interval.
    pub ln_k_kpa: f64,
    /// Its standard deviation, noise and model error together; where K is ambiguous, the distance to either end of the interval.
    pub ln_k_sd: f64,
    /// Logarithm of the modulus in kilopascals (K of springs, E of a body) of the model without effects, and its standard deviation.
    pub ln_modulus_without_effects: [f64; 2],
    /// Young's modulus, where the tissue was taken for a body.
    pub youngs_modulus_kpa: Option<f64>,
    /// Tip load, where there are insertions.
    pub tip_load_n: Option<f64>,
    /// Its 95 % interval.
    pub tip_load_ci95_n: Option<[f64; 2]>,
    /// Sizes of the discrepancy as multiples of those of an ordinary rig.
    pub discrepancy: BTreeMap<S, f64>,
    /// Noise, one standard deviation of a reading, by channel and unit.
    pub noise: BTreeMap<S, f64>,
    /// Effects that the session names by itself.
    pub named: Vec<NamedEffect>,
    /// Log evidence of each effect over the model without it.
    pub log_evidence: BTreeMap<S, f64>,
    /// Likelihood of the identifiable effects.
    pub amplitudes: Vec<Amplitude<S>>,
    /// Correlations of the information, thousandths, row by row below the diagonal.
    pub correlation_per_mille: Vec<i16>,
}

/// An effect that a session names by itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NamedEffect {
    /// Its id.
    pub id: String,
    /// Its parameters by name, and their intervals.
    pub parameters: BTreeMap<String, Interval>,
    /// Log evidence over the model without it.
    pub log_evidence: f64,
    /// Competing effects; itself among them.
    pub class: Vec<String>,
}

/// A value with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// The value.
    pub value: f64,
    /// Its interval.
    pub ci95: [f64; 2],
}

/// The Gaussian likelihood of one amplitude `t` of an effect, the modulus eliminated: `score t - information t^2 / 2`. `t` counts from
/// the neutral value, by the logarithm where `scale` is `log`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(bound(deserialize = "S: Deserialize<'de>"))]
pub struct Amplitude<S = String> {
    /// The effect's id.
    pub effect: S,
    /// The parameter's name, with its unit.
    pub parameter: S,
    /// Name and value of the parameter that is a place or a time.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub at: Option<(S, f64)>,
    /// `linear` or `log`.
    pub scale: S,
    /// The neutral value.
    pub neutral: f64,
    /// Whether values below the neutral one are possible.
    pub two_sided: bool,
    /// Standard deviation of the prior.
    pub prior_sd: f64,
    /// Derivative of the log likelihood at the neutral value.
    pub score: f64,
    /// Information.
    pub information: f64,
    /// Change of the logarithm of the modulus per unit.
    pub ln_k_slope: f64,
}

impl Summary {
    /// A record without a result.
    pub fn empty(session: String) -> Self {
        Self {
            schema: SUMMARY_SCHEMA.to_owned(),
            session,
            program: format!("guide {}", env!("CARGO_PKG_VERSION")),
            name: None,
            date: None,
            site: None,
            subject: None,
            rig: None,
            needle: None,
            tissue: None,
            covariates: BTreeMap::new(),
            error: None,
            result: None,
        }
    }
}

impl<S> Summary<S> {
    /// A label by its name: `site`, `subject`, `rig`, `needle`, `tissue`, `day`, `month`, or a covariate.
    pub fn label(&self, name: &str) -> Option<String> {
        match name {
            "site" => self.site.clone(),
            "subject" => self.subject.clone(),
            "rig" => self.rig.clone(),
            "needle" => self.needle.clone(),
            "tissue" => self.tissue.clone(),
            "day" => self.date.clone(),
            "month" => self.date.as_ref().and_then(|date| date.get(..7)).map(str::to_owned),
            _ => self.covariates.get(name).map(|value| match value {
                Value::Number(number) => format!("{number}"),
                Value::Text(text) => text.clone(),
            }),
        }
    }

    /// Day as a number of days, for drift.
    pub fn day(&self) -> Option<f64> {
        let iso = time::format_description::well_known::Iso8601::DATE;
        let date = Date::parse(self.date.as_deref()?, &iso).ok()?;
        Some(f64::from(date.to_julian_day()))
    }
}

/// The date of a number of days that [`Summary::day`] gave.
pub fn date_of(day: f64) -> Option<String> {
    Date::from_julian_day(day.round() as i32).ok().map(|date| date.to_string())
}

impl<S> SessionResult<S> {
    /// Without the likelihood of its parameters, the noise and the evidence; and the parameters, with the sizes of the discrepancy.
    pub(crate) fn apart(self) -> (SessionResult, Vec<Amplitude<S>>, BTreeMap<S, f64>) {
        let Self { verdict, foundation, k_kpa, k_ci95_kpa, ln_k_kpa, ln_k_sd, .. } = self;
        let Self { ln_modulus_without_effects, youngs_modulus_kpa, tip_load_n, tip_load_ci95_n, .. } = self;
        let Self { named, amplitudes, discrepancy, .. } = self;
        let less = SessionResult {
            verdict,
            foundation,
            k_kpa,
            k_ci95_kpa,
            ln_k_kpa,
            ln_k_sd,
            ln_modulus_without_effects,
            youngs_modulus_kpa,
            tip_load_n,
            tip_load_ci95_n,
            named,
            discrepancy: BTreeMap::new(),
            noise: BTreeMap::new(),
            log_evidence: BTreeMap::new(),
            amplitudes: Vec::new(),
            correlation_per_mille: Vec::new(),
        };
        (less, amplitudes, discrepancy)
    }
}

impl Amplitude {
    /// A value of the parameter in its own unit.
    pub fn outside(&self, amplitude: f64) -> f64 {
        if self.scale == "log" { self.neutral * amplitude.exp() } else { self.neutral + amplitude }
    }
}
