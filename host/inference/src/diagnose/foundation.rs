//! What the discrepancy leaves of the modulus, and an elastic body against springs, without any search for effects.
//!
//! Noise, everyday discrepancy and evidence are those of a diagnosis, so that `guide identify` and `guide diagnose` agree on the same
//! runs.

use super::posterior::Fitted;
use super::{
    DiagnoseError, Effect, FOUNDATION_MARGIN, Layout, Multiples, Noise, Noises, Session, Support, fit_start,
    runs_of,
};

/// A modulus from a fit in which the model is off by what every rig leaves behind any model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct DiscrepantModulus {
    /// Logarithm of the modulus in Pa: K of springs, E of a body.
    pub ln_pa: f64,
    /// Its standard deviation, noise and discrepancy together.
    pub sd_ln: f64,
}

impl DiscrepantModulus {
    fn of(fitted: &Fitted) -> Self {
        Self { ln_pa: fitted.modulus_pa().0.ln(), sd_ln: fitted.sd(0) }
    }
}

/// The comparison of the two foundations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FoundationEvidence {
    /// Logarithm of the evidence of the body less that of the springs.
    pub gain: f64,
    /// What it has to exceed for the body to be chosen: springs are the simpler model.
    pub margin: f64,
    /// Young's modulus of the body.
    pub body: DiscrepantModulus,
}

impl FoundationEvidence {
    /// Whether the evidence chooses the body.
    pub fn is_for_body(self) -> bool {
        self.gain > self.margin
    }
}

/// Input of [`fit_with_discrepancy`].
pub(crate) struct DiscrepancyFitInput<'a> {
    /// Effects with first values of their parameters.
    pub given: &'a [(&'static dyn Effect, Vec<f64>)],
    /// What of the discrepancy is larger than in an ordinary rig.
    pub discrepancy: &'a Multiples,
    /// Poisson's ratio of a body to be compared with springs.
    pub body: Option<f64>,
}

/// Springs, and where it is requested a body, fitted to all runs of a session beside the discrepancy.
///
/// # Errors
/// [`DiagnoseError`] where no run can be used or springs have no fit; beside the springs where the body has none.
pub(crate) fn fit_with_discrepancy(
    session: &Session,
    input: &DiscrepancyFitInput<'_>,
) -> Result<(DiscrepantModulus, Option<Result<FoundationEvidence, DiagnoseError>>), DiagnoseError> {
    let (runs, _) = runs_of(session)?;
    let noise = Noise::of(&runs, &session.stated_noise());
    let effects = input.given.iter().map(|(effect, _)| *effect).collect();
    let layout = Layout::new(&session.rig, &runs, effects);
    let noises = Noises { session: noise, reference: noise };
    let springs = fit_start(&layout, &runs, &noises, input.given, input.discrepancy)?;
    let evidence = |poisson: f64| -> Result<_, DiagnoseError> {
        let body = springs.on(Support::Body { poisson })?;
        let gain = body.fitted.log_evidence - springs.fitted.log_evidence;
        Ok(FoundationEvidence { gain, margin: FOUNDATION_MARGIN, body: DiscrepantModulus::of(&body.fitted) })
    };
    Ok((DiscrepantModulus::of(&springs.fitted), input.body.map(evidence)))
}
