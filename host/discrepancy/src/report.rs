//! The report of a diagnosis.

use super::judge::Judgement;
use super::regions::Region;
use serde::Serialize;

/// Verdict of a diagnosis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// No law is missing.
    Adequate,
    /// Laws are missing, and they explain the misfit completely.
    Explained,
    /// A law is missing, and the data cannot distinguish it from others.
    Ambiguous,
    /// Laws are missing, and a further misfit remains that no candidate describes.
    Partial,
    /// A misfit exists that no candidate describes.
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
    /// 95 % interval.
    pub ci95: [f64; 2],
}

/// A parameter of the model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ParameterReport {
    /// Estimate with the added laws, averaged over the final model and its rivals.
    #[serde(flatten)]
    pub estimate: Estimate,
    /// Estimate in the plain model.
    pub before: Estimate,
}

/// Name of a law.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LawName {
    /// Its site.
    pub site: String,
    /// Quantity on which it depends; `None` for a constant.
    pub regressor: Option<String>,
    /// Name of its form.
    pub form: &'static str,
    /// Formula.
    pub formula: String,
}

impl LawName {
    /// Id of the form `site/regressor/form`.
    pub fn id(&self) -> String {
        match &self.regressor {
            Some(regressor) => format!("{}/{regressor}/{}", self.site, self.form),
            None => format!("{}/{}", self.site, self.form),
        }
    }
}

/// An alternative to a law: another law, or two.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Rival {
    /// The law.
    #[serde(flatten)]
    pub law: LawName,
    /// A second law, if both are needed to replace the one.
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
    /// Whether it is named, that is, its probability is at least 95 %. Otherwise it is a member of a class.
    pub is_named: bool,
    /// Its probability, compared with its rivals and with the model without any of them.
    pub probability: f64,
    /// Logarithm of the odds of the model with it over the model without it.
    pub ln_odds: f64,
    /// Its parameters.
    pub values: Vec<Estimate>,
    /// Laws that the data cannot distinguish from it: as many as are needed for 95 % of the probability, together with it.
    pub rivals: Vec<Rival>,
    /// Test on held-out runs; `None` without such runs.
    pub held_out: Option<Judgement>,
}

/// A quantity of the sum of a site's laws.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PartReport {
    /// Estimate over the final model and its rivals, with the name of the site.
    #[serde(flatten)]
    pub estimate: Estimate,
    /// Whether it is named: with 95 % probability some law that contains it is missing, and its interval excludes zero.
    pub is_named: bool,
    /// Probability of such laws.
    pub probability: f64,
    /// Laws of the final model that contain it, as `site/regressor/form`.
    pub laws: Vec<String>,
}

/// A law that was tried and not added.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RefusedReport {
    /// The law.
    #[serde(flatten)]
    pub law: LawName,
    /// Logarithm of the odds of the model with it over the model without it.
    pub ln_odds: f64,
    /// Reason of the refusal.
    pub reason: String,
    /// Test on held-out runs, if this test is the reason.
    pub held_out: Option<Judgement>,
}

/// Root mean square of the residuals, before and after the laws were added.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Misfit {
    /// Residuals of the plain model.
    pub before: f64,
    /// Residuals with the added laws.
    pub after: f64,
    /// Root mean square of the measured values.
    pub measured: f64,
}

/// Noise as estimated by the fit.
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
    /// Noise; that of block means if a run has very many readings.
    pub noise: NoiseReport,
    /// Misfit in the runs that were fitted.
    pub training: Misfit,
    /// Misfit in the held-out runs.
    pub held_out: Option<Misfit>,
}

/// Estimated discrepancy at a site.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DiscrepancyReport {
    /// Site; `None` for the offsets of single runs.
    pub site: Option<String>,
    /// Regressor.
    pub regressor: Option<String>,
    /// Size: the effect on the channels, as a fraction of their standard deviation.
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
    /// Offsets: means over the data of the even part of the laws, comparable with an identification that has only a constant.
    pub offsets: Vec<PartReport>,
    /// Reversals: half of the change at a site when a motion is reversed, from signs of rates and slipping bristles. For a
    /// force it is the Coulomb friction, comparable with an identification that has only a sign.
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
    /// Whether the fits of the plain and of the final model have converged.
    pub is_settled: bool,
    /// Remarks on these results.
    pub notes: Vec<String>,
}
