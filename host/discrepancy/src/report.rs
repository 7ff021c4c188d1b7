//! The result as a document.

use super::judge::Judgement;
use super::regions::Region;
use serde::Serialize;

/// Verdict of a diagnosis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// No law is missing.
    Adequate,
    /// Laws are missing, and with them nothing is.
    Explained,
    /// A law is missing that the data do not tell from others.
    Ambiguous,
    /// Laws are missing, and something that none of the candidates describes.
    Partial,
    /// Something is missing that none of the candidates describes.
    Unexplained,
}

/// A number with its interval.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Estimate {
    /// Name.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Mean.
    pub value: f64,
    /// Standard deviation.
    pub sd: f64,
    /// Interval that holds it with 95 % probability.
    pub ci95: [f64; 2],
}

/// A parameter of the model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ParameterReport {
    /// In the model with the added laws, over the rivals of these.
    #[serde(flatten)]
    pub estimate: Estimate,
    /// In the plain model.
    pub before: Estimate,
}

/// Name of a law.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LawName {
    /// Its site.
    pub site: String,
    /// Quantity that it depends on; nothing for a constant.
    pub regressor: Option<String>,
    /// Name of its form.
    pub form: &'static str,
    /// Formula.
    pub formula: String,
}

impl LawName {
    /// As `site/regressor/form`.
    pub fn id(&self) -> String {
        match &self.regressor {
            Some(regressor) => format!("{}/{regressor}/{}", self.site, self.form),
            None => format!("{}/{}", self.site, self.form),
        }
    }
}

/// Another law, or two, in the place of one.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Rival {
    /// The law.
    #[serde(flatten)]
    pub law: LawName,
    /// A second law, where both are needed in the place of the one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub with: Option<LawName>,
    /// Its probability.
    pub probability: f64,
}

/// A law that was added.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TermReport {
    /// The law.
    #[serde(flatten)]
    pub law: LawName,
    /// Whether it has a name: its probability is above 95 %. Else it is one of a class.
    pub is_named: bool,
    /// Its probability, beside its rivals and the model without any of them.
    pub probability: f64,
    /// Logarithm of its odds over the model without it.
    pub ln_odds: f64,
    /// Its numbers.
    pub values: Vec<Estimate>,
    /// Laws that the data do not tell from it, with the other 95 %.
    pub rivals: Vec<Rival>,
    /// Judgement of held-out runs; nothing where none judge.
    pub held_out: Option<Judgement>,
}

/// A part of what the laws of a site add together.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PartReport {
    /// Over the final model and its rivals; its name is that of the site.
    #[serde(flatten)]
    pub estimate: Estimate,
    /// Whether it has a name: laws that have it are missing with 95 % probability, whichever of them, and its interval holds no zero.
    pub is_named: bool,
    /// Probability of such laws.
    pub probability: f64,
    /// Laws of the final model that have it, as `site/regressor/form`.
    pub laws: Vec<String>,
}

/// A law that was tried and not added.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RefusedReport {
    /// The law.
    #[serde(flatten)]
    pub law: LawName,
    /// Logarithm of its odds over the model without it.
    pub ln_odds: f64,
    /// Why.
    pub reason: String,
    /// Judgement of held-out runs, where these refuse it.
    pub held_out: Option<Judgement>,
}

/// Root mean square of residuals, before and after laws were added.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Misfit {
    /// Residuals of the plain model.
    pub before: f64,
    /// Residuals with the added laws.
    pub after: f64,
    /// Root mean square of what is measured.
    pub measured: f64,
}

/// Noise as the fit has found it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct NoiseReport {
    /// Standard deviation, in the channel's unit.
    pub sd: f64,
    /// Fraction of the variance that is correlated in time.
    pub correlated: f64,
    /// Time after which the correlation is 1/e.
    pub memory_s: f64,
}

/// A channel.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ChannelReport {
    /// Name.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Noise of means over blocks, where a run has very many readings.
    pub noise: NoiseReport,
    /// Misfit in the runs that were fitted.
    pub training: Misfit,
    /// Misfit in the runs that judge.
    pub held_out: Option<Misfit>,
}

/// Discrepancy that every model leaves at a site.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DiscrepancyReport {
    /// Site; nothing for offsets of single runs.
    pub site: Option<String>,
    /// Regressor.
    pub regressor: Option<String>,
    /// Its effect on the channels, as a fraction of their standard deviation.
    pub size: f64,
}

/// The result of a diagnosis.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// `discrepancy.diagnosis/1`.
    pub schema: &'static str,
    /// Verdict.
    pub verdict: Verdict,
    /// Regions where the plain model and the data differ.
    #[serde(rename = "where")]
    pub regions: Vec<Region>,
    /// Laws that were added.
    pub terms: Vec<TermReport>,
    /// Offsets: means over the data of what laws add to both signs of their regressors alike, as an identification with a constant alone has it.
    pub offsets: Vec<PartReport>,
    /// Sums of signs of rates and of slipping bristles: half of what a site changes by when a motion is reversed. Of a force it is Coulomb's
    /// friction, as an identification with a sign alone has it.
    pub reversals: Vec<PartReport>,
    /// Parameters of the model.
    pub parameters: Vec<ParameterReport>,
    /// Channels with their misfit.
    pub channels: Vec<ChannelReport>,
    /// Laws that were tried and not added, the likeliest first.
    pub refused: Vec<RefusedReport>,
    /// Regions where the final model and the data still differ.
    pub remaining: Vec<Region>,
    /// Sizes of the discrepancy.
    pub discrepancy: Vec<DiscrepancyReport>,
    /// Number of laws that were tried.
    pub candidates: usize,
    /// Whether all fits have come to their end.
    pub is_settled: bool,
    /// Remarks on these results.
    pub notes: Vec<String>,
}
