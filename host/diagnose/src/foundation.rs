//! Uncertainty of the modulus including the discrepancy, and comparison of an elastic body with springs, without a search for
//! effects.
//!
//! Noise, everyday discrepancy and evidence are those of a diagnosis, so that `guide identify` and `guide diagnose` agree on the same
//! runs.

use super::draws::{Deviations, READINGS, Readings};
use super::known::{self, KnownParameter, Moved, Released};
use super::layout::Scale;
use super::posterior::Fitted;
use super::score::Scores;
use super::{DiagnoseError, Effect, Layout, Multiples, Noise, Noises, Session, Start, fit_start, runs_of};
use formats::session::FoundationKind;
use mechanics::Support;
use mechanics::effects::effect;
use readings::FitError;
use readings::draws::{DrawOptions, Draws};

/// Choice of the tissue's foundation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FoundationChoice {
    /// Independent springs (Winkler).
    Springs,
    /// An elastic body.
    Body,
    /// Both are fitted, and the evidence decides.
    #[default]
    Auto,
}

impl FoundationChoice {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Springs, Self::Body, Self::Auto];

    /// Its name in options.
    pub fn name(self) -> &'static str {
        match self {
            Self::Springs => "springs",
            Self::Body => "body",
            Self::Auto => "auto",
        }
    }
}

impl From<Option<FoundationKind>> for FoundationChoice {
    fn from(stated: Option<FoundationKind>) -> Self {
        match stated {
            None => Self::Auto,
            Some(FoundationKind::Springs) => Self::Springs,
            Some(FoundationKind::Body) => Self::Body,
        }
    }
}

/// A modulus from a fit with the discrepancy of a real rig.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DiscrepantModulus {
    /// Logarithm of the modulus in Pa: K of springs, E of a body.
    pub ln_pa: f64,
    /// Its standard deviation, noise and discrepancy together.
    pub sd_ln: f64,
    /// The stated quantity that contributes most to its variance, and the fraction of the variance that would vanish if that
    /// quantity were exactly known.
    pub rests_on: Option<(&'static str, f64)>,
}

impl DiscrepantModulus {
    /// The modulus as in a diagnosis that names no effect: its uncertainty is integrated over the sizes of the discrepancy.
    fn of(start: &Start) -> Self {
        let fitted = start.fitted.clone().over_sizes(&start.patterns);
        let rests_on = fitted.rests_on(&start.patterns).first().copied();
        Self { ln_pa: fitted.modulus_pa().0.ln(), sd_ln: fitted.sd(0), rests_on }
    }
}

/// The comparison of the two foundations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FoundationEvidence {
    /// Logarithm of the evidence of the body less that of the springs.
    pub gain: f64,
    /// Margin above which the body is chosen: springs are the simpler model.
    pub margin: f64,
    /// Young's modulus of the body.
    pub body: DiscrepantModulus,
    /// Log evidence of a modulus that varies with depth, on springs or in a body, over the better of the two with one modulus;
    /// 0 if the expected gain is below [`VARIED_NATS`].
    pub varied: f64,
}

/// Log evidence over springs above which a body is chosen.
pub const FOUNDATION_MARGIN: f64 = 2.0;
/// Effects by which the modulus may vary with depth.
pub(super) const VARIED: [&str; 2] = ["tissue.layers", "tissue.gradient"];
/// Smallest log evidence of a varying modulus at which the choice between the foundations with one modulus is not valid. The odds are then
/// 75: each of the two forms of variation has half of the prior probability of one modulus.
pub const VARIED_NATS: f64 = 5.0;
/// Largest number of rounds of the fit of a varying modulus.
const VARIED_ROUNDS: usize = 8;

impl FoundationEvidence {
    /// Whether the evidence chooses the body.
    pub fn is_for_body(self) -> bool {
        self.gain > self.margin
    }
}

/// Input of [`fit_with_discrepancy`].
pub struct DiscrepancyFitInput<'a> {
    /// Effects with the start values of their parameters.
    pub given: &'a [(&'static dyn Effect, Vec<f64>)],
    /// Priors of their parameters that replace those of the catalogue.
    pub known: &'a [KnownParameter],
    /// Sizes of the discrepancy relative to an ordinary rig, where they are larger.
    pub discrepancy: &'a Multiples,
    /// Poisson's ratio of a body to be compared with springs.
    pub body: Option<f64>,
    /// Settings of the draws from both posteriors.
    pub draws: Option<DrawOptions>,
}

/// Draws from the posterior of a modulus.
#[derive(Debug, Clone, PartialEq)]
pub struct ModulusDraws {
    /// Standardized logarithm of the modulus.
    pub standard_ln: Vec<f64>,
    /// Parameters of the effects, priors and readings.
    pub draws: Draws,
}

impl ModulusDraws {
    /// Draws from the posterior from which the intervals are computed.
    fn of(start: &Start, modulus: &str, options: DrawOptions) -> Result<Self, FitError> {
        let fitted = start.fitted.clone().over_sizes(&start.patterns);
        let drawn = Deviations::new(vec![(1.0, &fitted)], options);
        let mut draws = Draws::new(options, "guide identify");
        fitted.layout.effects.iter().for_each(|effect| drawn.add_effect(*effect, &mut draws));
        drawn.add_stated(&fitted, &mut draws);
        let readings = Readings { runs: &start.runs, patterns: &start.patterns };
        readings.add_prior(&fitted, modulus, &mut draws)?;
        readings.add(&drawn, READINGS, &mut draws)?;
        Ok(Self { standard_ln: drawn.standard_ln_modulus(), draws })
    }
}

/// Fit with the discrepancy.
pub struct DiscrepancyFit {
    /// On springs.
    pub springs: DiscrepantModulus,
    /// In a body, where it was requested.
    pub body: Option<Result<FoundationEvidence, DiagnoseError>>,
    /// Parameters that have changed from their known values.
    pub moved: Vec<Moved>,
    /// Draws on springs and, if it was fitted, in a body.
    pub draws: Option<(ModulusDraws, Option<ModulusDraws>)>,
}

/// Fits springs, and a body if requested, to all runs of a session with the discrepancy. Known parameters that the runs
/// contradict become free.
///
/// # Errors
/// [`DiagnoseError`] if no run can be used or springs have no fit. The error of a body without a fit is in the result.
pub fn fit_with_discrepancy(
    session: &Session,
    input: &DiscrepancyFitInput<'_>,
) -> Result<DiscrepancyFit, DiagnoseError> {
    let (runs, _) = runs_of(session)?;
    let noise = Noise::of(&runs, &session.stated_noise());
    let effects = input.given.iter().map(|(effect, _)| *effect).collect();
    let mut layout = Layout::new(&session.rig, &runs, effects);
    layout.known = input.known.into();
    let noises = Noises { session: noise, reference: noise };
    let Released { start: springs, moved, .. } = known::released(&mut layout, |layout| {
        fit_start(layout, &runs, &noises, input.given, input.discrepancy)
    })?;
    let mut drawn_of_body = None;
    let body = input.body.map(|poisson| -> Result<_, DiagnoseError> {
        let body = springs.on(Support::Body { poisson, block: session.tissue.block() })?;
        let gain = body.fitted.log_evidence - springs.fitted.log_evidence;
        let best = gain.max(0.0);
        let of_springs = varied(&springs, VARIED_NATS + best)?;
        let of_body = varied(&body, VARIED_NATS + best - gain)?;
        let varied = of_springs.max(gain + of_body) - best;
        let modulus = DiscrepantModulus::of(&body);
        drawn_of_body =
            input.draws.map(|draws| ModulusDraws::of(&body, "youngs_modulus_kpa", draws)).transpose()?;
        Ok(FoundationEvidence { gain, margin: FOUNDATION_MARGIN, body: modulus, varied })
    });
    let of_springs = input.draws.map(|draws| ModulusDraws::of(&springs, "k_kpa", draws)).transpose()?;
    let draws = of_springs.map(|of_springs| (of_springs, drawn_of_body));
    Ok(DiscrepancyFit { springs: DiscrepantModulus::of(&springs), body, moved, draws })
}

/// Log evidence of a modulus that varies with depth over one modulus. A variation is fitted only if its score, which is that of a small
/// variation, is at least `needed`; without a fit the result is 0.
pub(super) fn varied(start: &Start, needed: f64) -> Result<f64, FitError> {
    let Start { runs, patterns, fitted } = start;
    let effects: Vec<&'static dyn Effect> = VARIED.into_iter().filter_map(effect).collect();
    let scores = Scores::of(&effects, fitted, runs, patterns)?.ranked();
    // If the fit started at large sizes, the discrepancy would continue to explain everything.
    let everyday = patterns.everyday();
    let sizes: Vec<f64> = fitted.sizes.iter().zip(everyday).map(|(size, most)| size.min(most)).collect();
    let promising = scores.iter().filter(|score| score.log_evidence >= needed);
    Ok(promising
        .filter_map(|score| {
            let mut values = fitted.values().to_vec();
            let infos = score.effect.parameters().iter().zip(score.starts.first()?);
            values.extend(infos.map(|(info, value)| Scale::of(info).inside(*value)));
            let layout = fitted.layout.with(score.effect);
            let fit = Fitted::new(&layout, runs, patterns, &values, &sizes, VARIED_ROUNDS).ok()?;
            Some(fit.log_evidence - fitted.log_evidence)
        })
        .fold(0.0, f64::max))
}
